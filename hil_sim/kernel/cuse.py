"""A character device served from Python through ``/dev/cuse``.

Numbers and structures are those of ``uapi/linux/fuse.h`` (protocol 7.37, Linux 6.1). One request is read, one reply
written, both in a single call. With CUSE_UNRESTRICTED_IOCTL the kernel hands over an ioctl with its bare argument; a
device that needs the caller's memory answers with the areas it needs, and the kernel repeats the request with their
bytes: no state is kept in between. 32-bit callers are refused, because their structures differ.
"""

import errno
import heapq
import os
import select
import struct
from collections.abc import Callable, Sequence
from enum import Enum, auto
from typing import Final, NamedTuple, Protocol

from hil_sim.faults import NEVER

_OPEN, _READ, _WRITE, _RELEASE, _FLUSH = 14, 15, 16, 18, 25
_INTERRUPT, _DESTROY, _IOCTL, _CUSE_INIT = 36, 38, 39, 4096
_IN_HEADER: Final = struct.Struct("<IIQQIIII")  # length, opcode, unique, node, uid, gid, pid, padding
_OUT_HEADER: Final = struct.Struct("<IiQ")  # length, -errno, unique
_INIT_IN: Final = struct.Struct("<IIII")  # major, minor, unused, flags
_INIT_OUT: Final = struct.Struct("<IIIIIIII40x")  # major, minor, unused, flags, max_read, max_write, dev_major, minor
_OPEN_OUT: Final = struct.Struct("<QII")  # handle, flags, padding
_IO_IN: Final = struct.Struct("<QQIIQII")  # handle, offset, size, flags, lock owner, open flags, padding
_WRITE_OUT: Final = struct.Struct("<II")  # size, padding
_HANDLE: Final = struct.Struct("<Q")
_IOCTL_IN: Final = struct.Struct("<QIIQII")  # handle, flags, command, argument, input size, output size
_IOCTL_OUT: Final = struct.Struct("<iIII")  # result, flags, input areas, output areas
_AREA: Final = struct.Struct("<QQ")
_UNRESTRICTED_IOCTL: Final = 1 << 0  # CUSE_UNRESTRICTED_IOCTL
_IOCTL_COMPAT, _IOCTL_RETRY = 1 << 0, 1 << 2
_DIRECT_IO, _NONSEEKABLE = 1 << 0, 1 << 2
_MAJOR, _MINOR = 7, 37
_MAX_IO: Final = 1 << 16
_NEXT_ROUND_S: Final = 0.001
_REQUEST_BYTES: Final = _IN_HEADER.size + _IO_IN.size + (1 << 17)  # the largest request: 32 pages of ioctl input


class Area(NamedTuple):
    """Memory of the calling program."""

    address: int
    size: int


class Ask(NamedTuple):
    """An ioctl that needs ``inputs`` and will fill ``outputs``: the kernel repeats the request with them."""

    inputs: Sequence[Area]
    outputs: Sequence[Area] = ()


class Done(NamedTuple):
    """A call that has succeeded: its return value, what it reads, and when it returns (0: at once)."""

    result: int
    data: bytes = b""
    due_ns: int = 0


class Failed(NamedTuple):
    """A call that has failed: its errno, and when it returns (0: at once)."""

    code: int
    due_ns: int = 0


class Later(NamedTuple):
    """A call that takes effect at an instant, passed to ``act``, which is called once."""

    act: Callable[[int], Done | Failed]


class CharacterDevice(Protocol):
    """A device file. ``handle`` identifies the open file; methods must not raise."""

    def open(self, handle: int) -> None:
        """A program opened the file."""

    def release(self, handle: int) -> None:
        """The last descriptor of an open file is closed."""

    def read(self, handle: int, count: int) -> Later | Done | Failed:
        """``read(2)``."""

    def write(self, handle: int, data: bytes) -> Later | Done | Failed:
        """``write(2)``; ``result`` is the number of bytes taken."""

    def ioctl(self, handle: int, command: int, argument: int, data: bytes, room: int) -> Later | Done | Failed | Ask:
        """``ioctl(2)``; ``data`` holds the bytes of the areas asked for, ``room`` is the size of those to be filled."""


class _Kind(Enum):
    READ = auto()
    WRITE = auto()
    IOCTL = auto()


class CuseNode:
    """``/dev/NAME``, which exists while this object is open.

    Call ``receive``, then read the clock, then ``advance``, so that no call takes effect before it was made.

    Args:
        name: Of the node, ``i2c-9``.
        device: What it does.
        cuse: The kernel's end; None: no kernel, the caller hands requests to ``handle`` and takes ``replies``.

    Attributes:
        abandoned: Replies whose caller had gone.

    Raises:
        OSError: ``cuse`` cannot be opened: no such module, or no right to it.
    """

    def __init__(self, name: str, device: CharacterDevice, cuse: str | None = "/dev/cuse") -> None:
        self.abandoned = 0
        self._name = name
        self._device = device
        self._handles = 0
        self._order = 0
        self._waiting: list[tuple[int, _Kind, Later]] = []
        self._replies: list[tuple[int, int, bytes]] = []
        self._asked = False
        self._fd = None if cuse is None else os.open(cuse, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    @property
    def files(self) -> list[int]:
        """Descriptors that wake the loop when they become readable."""
        return [] if self._fd is None else [self._fd]

    @property
    def due_ns(self) -> int:
        """When the next reply is to be given."""
        return self._replies[0][0] if self._replies else NEVER

    def receive(self) -> None:
        """Take all requests that wait.

        After an answer that asks for memory the kernel's next request follows at once, and is waited for.

        Raises:
            OSError: The kernel took the device away.
        """
        if self._fd is None:
            return
        while True:
            try:
                request = os.read(self._fd, _REQUEST_BYTES)
            except BlockingIOError:
                if not (self._asked and select.select([self._fd], [], [], _NEXT_ROUND_S)[0]):
                    return
                self._asked = False
                continue
            except FileNotFoundError:  # the caller was killed while its request waited
                continue
            self._asked = False
            self.handle(request)
            self._give(0)

    def advance(self, now_ns: int) -> None:
        """Let the calls received take effect now, and give the replies that are due."""
        waiting, self._waiting = self._waiting, []
        for unique, kind, later in waiting:
            self._finish(unique, kind, later.act(now_ns))
        self._give(now_ns)

    def close(self) -> None:
        """Take the node away: programs that hold it open get ENOTCONN."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None

    def replies(self, now_ns: int) -> list[bytes]:
        """Replies that are due, in order."""
        due = []
        while self._replies and self._replies[0][0] <= now_ns:
            due.append(heapq.heappop(self._replies)[2])
        return due

    def handle(self, request: bytes) -> None:
        """Take one request of the kernel."""
        length, opcode, unique, *_ = _IN_HEADER.unpack_from(request)
        body = request[_IN_HEADER.size : length]
        if opcode == _IOCTL:
            self._ioctl(unique, body)
        elif opcode == _READ:
            handle, _, size, *_ = _IO_IN.unpack_from(body)
            self._take(unique, _Kind.READ, self._device.read(handle, size))
        elif opcode == _WRITE:
            handle, _, size, *_ = _IO_IN.unpack_from(body)
            self._take(unique, _Kind.WRITE, self._device.write(handle, body[_IO_IN.size : _IO_IN.size + size]))
        elif opcode == _OPEN:
            self._handles += 1
            self._device.open(self._handles)
            self._reply(unique, 0, _OPEN_OUT.pack(self._handles, _DIRECT_IO | _NONSEEKABLE, 0))
        elif opcode == _RELEASE:
            self._device.release(_HANDLE.unpack_from(body)[0])
            self._reply(unique, 0)
        elif opcode == _CUSE_INIT:
            self._init(unique, body)
        elif opcode in (_FLUSH, _DESTROY):
            self._reply(unique, 0)
        elif opcode != _INTERRUPT:  # the interrupted call ends by itself
            self._reply(unique, errno.ENOSYS)

    def _init(self, unique: int, body: bytes) -> None:
        major, minor, *_ = _INIT_IN.unpack_from(body)
        if major != _MAJOR:
            self._reply(unique, errno.EPROTO)
            return
        settings = _INIT_OUT.pack(_MAJOR, min(minor, _MINOR), 0, _UNRESTRICTED_IOCTL, _MAX_IO, _MAX_IO, 0, 0)
        self._reply(unique, 0, settings + b"DEVNAME=" + self._name.encode() + b"\0")

    def _ioctl(self, unique: int, body: bytes) -> None:
        handle, flags, command, argument, size, room = _IOCTL_IN.unpack_from(body)
        if flags & _IOCTL_COMPAT:
            self._reply(unique, errno.ENOTTY)
            return
        data = body[_IOCTL_IN.size : _IOCTL_IN.size + size]
        done = self._device.ioctl(handle, command, argument, data, room)
        if isinstance(done, Ask):
            areas = b"".join(_AREA.pack(*area) for area in (*done.inputs, *done.outputs))
            head = _IOCTL_OUT.pack(0, _IOCTL_RETRY, len(done.inputs), len(done.outputs))
            self._reply(unique, 0, head + areas)
            self._asked = True
        else:
            self._take(unique, _Kind.IOCTL, done)

    def _take(self, unique: int, kind: _Kind, done: Later | Done | Failed) -> None:
        if isinstance(done, Later):
            self._waiting.append((unique, kind, done))
        else:
            self._finish(unique, kind, done)

    def _finish(self, unique: int, kind: _Kind, done: Done | Failed) -> None:
        if isinstance(done, Failed):
            self._reply(unique, done.code, due_ns=done.due_ns)
            return
        head = b""
        if kind is _Kind.IOCTL:
            head = _IOCTL_OUT.pack(done.result, 0, 0, 0)
        elif kind is _Kind.WRITE:
            head = _WRITE_OUT.pack(done.result, 0)
        self._reply(unique, 0, head + done.data, done.due_ns)

    def _reply(self, unique: int, code: int, data: bytes = b"", due_ns: int = 0) -> None:
        self._order += 1
        reply = _OUT_HEADER.pack(_OUT_HEADER.size + len(data), -code, unique) + data
        heapq.heappush(self._replies, (due_ns, self._order, reply))

    def _give(self, now_ns: int) -> None:
        if self._fd is None:
            return
        for reply in self.replies(now_ns):
            try:
                os.write(self._fd, reply)
            except FileNotFoundError:
                self.abandoned += 1
