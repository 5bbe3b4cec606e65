"""``/dev/i2c-N`` for smbus2 in this process: replaces its ``ioctl``, ``os.open`` and ``os.close`` by simulated slaves.

smbus2 is unmodified, including the structures it passes to the kernel; only its three kernel functions are replaced,
and only for the registered paths. Numbers are those of ``uapi/linux/i2c-dev.h`` and ``uapi/linux/i2c.h``. An SMBus
block read asks the slave for 33 bytes, as an adapter without length-byte support would.
"""

import ctypes
import errno
import fcntl
import os
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol, Self

from smbus2 import smbus2

_SLAVE, _TENBIT, _FUNCS, _SLAVE_FORCE = 0x0703, 0x0704, 0x0705, 0x0706
_RDWR, _PEC, _SMBUS, _RETRIES, _TIMEOUT = 0x0707, 0x0708, 0x0720, 0x0701, 0x0702
_QUICK, _BYTE, _BYTE_DATA, _WORD_DATA, _PROC_CALL, _BLOCK_DATA = 0, 1, 2, 3, 4, 5
_BLOCK_PROC_CALL, _I2C_BLOCK_DATA = 7, 8
_M_RD: Final = 0x0001
_BLOCK_MAX: Final = 32
_MAX_MESSAGES: Final = 42
_MAX_MESSAGE_BYTES: Final = 8192
_FUNC_I2C: Final = 0x0000_0001
_FUNC_SMBUS: Final = 0x0FFF_0000  # every size, process calls and block reads included
_FUNC_BLOCK_PROC_CALL: Final = 0x0000_8000


class I2cTarget(Protocol):
    """An I2C bus or slave that performs transfers."""

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        """START, write, repeated START, read, STOP; raises OSError with the kernel's errno."""


def _fail(code: int) -> OSError:
    return OSError(code, os.strerror(code))


class _Adapter:
    """One ``/dev/i2c-N``: turns ioctl requests into transfers."""

    def __init__(self, target: I2cTarget, clock: Callable[[], int]) -> None:
        self._target = target
        self._clock = clock

    def ioctl(self, slaves: dict[int, int], fd: int, request: int, argument: Any) -> int:
        if request == _FUNCS:
            argument.value = _FUNC_I2C | _FUNC_SMBUS | _FUNC_BLOCK_PROC_CALL
        elif request in (_SLAVE, _SLAVE_FORCE):
            if not 0 <= argument <= 0x7F:
                raise _fail(errno.EINVAL)
            slaves[fd] = argument
        elif request == _RDWR:
            self._rdwr(argument)
        elif request == _SMBUS:
            self._smbus(slaves[fd], argument)
        elif request in (_RETRIES, _TIMEOUT):
            pass
        elif request in (_TENBIT, _PEC):
            if argument:
                raise _fail(errno.EINVAL)
        else:
            raise _fail(errno.ENOTTY)
        return 0

    def _transfer(self, address: int, write: bytes, read_count: int) -> bytes:
        return self._target.transfer(address, write, read_count, self._clock())

    def _rdwr(self, argument: Any) -> None:
        if not 0 < argument.nmsgs <= _MAX_MESSAGES:
            raise _fail(errno.EINVAL)
        messages = [(each.addr, each.flags, each.len, each.buf) for each in argument.msgs[: argument.nmsgs]]
        if max(length for _, _, length, _ in messages) > _MAX_MESSAGE_BYTES:
            raise _fail(errno.EINVAL)
        k = 0
        while k < len(messages):
            address, flags, length, buffer = messages[k]
            write = b""
            if not flags & _M_RD:
                write = ctypes.string_at(buffer, length)
                k += 1
                joined = k < len(messages) and messages[k][1] & _M_RD and messages[k][0] == address
                if not joined:
                    self._transfer(address, write, 0)
                    continue
                length, buffer = messages[k][2:]
            data = self._transfer(address, write, length)
            ctypes.memmove(buffer, data, length)
            k += 1

    def _smbus(self, address: int, argument: Any) -> None:
        reads, command, size, data = argument.read_write == 1, argument.command, argument.size, argument.data.contents
        register = bytes([command])
        if size == _QUICK:
            self._transfer(address, b"", 0)
        elif size == _BYTE:
            if reads:
                data.byte = self._transfer(address, b"", 1)[0]
            else:
                self._transfer(address, register, 0)
        elif size == _BYTE_DATA:
            if reads:
                data.byte = self._transfer(address, register, 1)[0]
            else:
                self._transfer(address, register + bytes([data.byte]), 0)
        elif size == _WORD_DATA:
            if reads:
                data.word = int.from_bytes(self._transfer(address, register, 2), "little")
            else:
                self._transfer(address, register + data.word.to_bytes(2, "little"), 0)
        elif size == _PROC_CALL:
            answer = self._transfer(address, register + data.word.to_bytes(2, "little"), 2)
            data.word = int.from_bytes(answer, "little")
        else:
            self._smbus_block(address, register, size, reads=reads, data=data)

    def _smbus_block(self, address: int, register: bytes, size: int, *, reads: bool, data: Any) -> None:
        length = data.block[0]
        if size not in (_BLOCK_DATA, _BLOCK_PROC_CALL, _I2C_BLOCK_DATA):
            raise _fail(errno.EINVAL)
        with_length = size in (_BLOCK_DATA, _BLOCK_PROC_CALL)
        sends = size == _BLOCK_PROC_CALL or not reads
        if (sends or not with_length) and not 0 < length <= _BLOCK_MAX:
            raise _fail(errno.EINVAL)
        write = register
        if sends:
            write += bytes([length] if with_length else []) + bytes(data.block[1 : length + 1])
        if not reads and size != _BLOCK_PROC_CALL:
            self._transfer(address, write, 0)
            return
        answer = self._transfer(address, write, _BLOCK_MAX + 1 if with_length else length)
        if with_length:
            length, answer = answer[0], answer[1:]
            if not 0 < length <= _BLOCK_MAX:
                raise _fail(errno.EPROTO)
        data.block[0] = length
        data.block[1 : length + 1] = list(answer[:length])


class _Kernel:
    """Replaces the ``os`` module inside smbus2, and keeps the open descriptors."""

    O_RDWR = os.O_RDWR

    def __init__(self) -> None:
        self.adapters: dict[str, _Adapter] = {}
        self._open: dict[int, _Adapter] = {}
        self._slaves: dict[int, int] = {}

    def open(self, path: str, flags: int) -> int:
        adapter = self.adapters.get(path)
        if adapter is None:
            return os.open(path, flags)
        fd = os.open(os.devnull, flags)  # a descriptor number not in use
        self._open[fd] = adapter
        self._slaves[fd] = 0
        return fd

    def close(self, fd: int) -> None:
        self._open.pop(fd, None)
        self._slaves.pop(fd, None)
        os.close(fd)

    def ioctl(self, fd: int, request: int, argument: Any) -> int:
        adapter = self._open.get(fd)
        if adapter is None:
            status: int = fcntl.ioctl(fd, request, argument)
            return status
        return adapter.ioctl(self._slaves, fd, request, argument)


_kernel: Final = _Kernel()


class InstalledI2c:
    """A path at which smbus2 finds a simulated bus, until ``uninstall`` or the end of the ``with`` block."""

    def __init__(self, path: str) -> None:
        self.path = path

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.uninstall()

    def uninstall(self) -> None:
        """Remove the path; after the last one, smbus2's own ``ioctl`` and ``os`` are restored."""
        _kernel.adapters.pop(self.path, None)
        if not _kernel.adapters:
            vars(smbus2).update(ioctl=fcntl.ioctl, os=os)


class _Several:
    def __init__(self, slaves: Sequence[I2cTarget]) -> None:
        self._slaves = slaves

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        """Offer the transfer to each slave; the first that acknowledges answers."""
        refusal = _fail(errno.EREMOTEIO)
        for slave in self._slaves:
            try:
                return slave.transfer(address, write, read_count, now_ns)
            except OSError as error:
                refusal = error
        raise refusal


def install_i2c(path: str, slaves: I2cTarget | Sequence[I2cTarget], clock: Callable[[], int]) -> InstalledI2c:
    """Serve ``path`` by simulated slaves for every ``smbus2.SMBus(path)`` of this process.

    Args:
        path: For example ``/dev/i2c-1``; it need not exist, and is hidden if it does.
        slaves: A bus, or the slaves on it.
        clock: ``CLOCK_MONOTONIC`` ns, or a virtual clock; read once per transfer.

    Raises:
        ValueError: a bus is already installed at this path.
    """
    if path in _kernel.adapters:
        raise ValueError(f"A simulated bus is at {path} already; uninstall it first.")
    target = _Several(slaves) if isinstance(slaves, Sequence) else slaves
    _kernel.adapters[path] = _Adapter(target, clock)
    vars(smbus2).update(ioctl=_kernel.ioctl, os=_kernel)
    return InstalledI2c(path)
