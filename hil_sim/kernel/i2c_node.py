"""``/dev/i2c-N`` on simulated wires; behaves like the kernel's ``i2c-dev.c`` and ``i2c-core-smbus.c``.

Structures and numbers are those of ``uapi/linux/i2c.h`` and ``uapi/linux/i2c-dev.h`` on a 64-bit machine. A call
returns after its transfers' time on real wires; transfers are serialised. Errors carry the errno of the bus. SMBus
block reads fetch 33 bytes, like an adapter that cannot stop at the length byte. Not supported: packet error codes,
10-bit addresses, protocol mangling.
"""

import errno
import struct
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, Protocol

from hil_sim.kernel.cuse import Area, Ask, Done, Failed, Later

_RETRIES, _TIMEOUT, _SLAVE, _TENBIT = 0x0701, 0x0702, 0x0703, 0x0704
_FUNCS, _SLAVE_FORCE, _RDWR, _PEC, _SMBUS = 0x0705, 0x0706, 0x0707, 0x0708, 0x0720
_QUICK, _BYTE, _BYTE_DATA, _WORD_DATA, _PROC_CALL, _BLOCK_DATA = 0, 1, 2, 3, 4, 5
_I2C_BLOCK_BROKEN, _BLOCK_PROC_CALL, _I2C_BLOCK_DATA = 6, 7, 8
_FUNC_I2C, _FUNC_SMBUS_BLOCK_PROC_CALL = 0x0000_0001, 0x0000_8000
_FUNC_SMBUS: Final = 0x0FFF_0000  # QUICK to I2C_BLOCK, reads and writes, block reads included
_M_RD: Final = 0x0001
_MAX_MESSAGES: Final = 42
_MAX_MESSAGE_BYTES: Final = 8192
_BLOCK_MAX: Final = 32
_FUNCTIONS: Final = struct.Struct("<Q")
_RDWR_DATA: Final = struct.Struct("<QI4x")  # struct i2c_rdwr_ioctl_data: messages, how many
_MESSAGE: Final = struct.Struct("<HHH2xQ")  # struct i2c_msg: address, flags, length, buffer
_SMBUS_DATA: Final = struct.Struct("<BB2xIQ")  # struct i2c_smbus_ioctl_data: read, command, size, data
_DATA_BYTES: Final = {_BYTE: 1, _BYTE_DATA: 1, _WORD_DATA: 2, _PROC_CALL: 2}
_BLOCK_BYTES: Final = _BLOCK_MAX + 2  # union i2c_smbus_data


class I2cWires(Protocol):
    """The bus behind the node: ``hil_sim.buses.media.I2cBus``."""

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        """START, write, repeated START, read, STOP; raises OSError with the kernel's errno."""


class _Transfer(NamedTuple):
    address: int
    write: bytes
    read_count: int


class _More(Exception):  # noqa: N818 - a request, not an error
    """The call needs more of the caller's memory."""


class _CallerMemory:
    """Areas of the caller's memory passed by the kernel, read in the order requested."""

    def __init__(self, data: bytes, room: int) -> None:
        self._data = data
        self._room = room
        self._taken = 0
        self.inputs: list[Area] = []
        self.outputs: list[Area] = []

    def take(self, inputs: Sequence[Area], outputs: Sequence[Area] = ()) -> bytes:
        """Bytes of ``inputs``, with ``outputs`` ready to be filled. Raises _More when they are not there yet."""
        start = self._taken
        self._taken += sum(area.size for area in inputs)
        self.inputs += inputs
        self.outputs += outputs
        if self._taken > len(self._data) or sum(area.size for area in self.outputs) > self._room:
            raise _More
        return self._data[start : self._taken]


class I2cNode:
    """A ``CharacterDevice``: each open file has its own slave address.

    Args:
        bus: What answers.
        bit_rate: Of the wires, bit/s.
    """

    def __init__(self, bus: I2cWires, bit_rate: int = 400_000) -> None:
        self._bus = bus
        self._bit_rate = bit_rate
        self._slaves: dict[int, int] = {}
        self._free_ns = 0

    def open(self, handle: int) -> None:
        """A program opened the node; its slave address is 0 until it is set."""
        self._slaves[handle] = 0

    def release(self, handle: int) -> None:
        """It closed it."""
        self._slaves.pop(handle, None)

    def read(self, handle: int, count: int) -> Later:
        """START, address+R, ``count`` bytes (8192 at most), STOP."""
        count = min(count, _MAX_MESSAGE_BYTES)
        return self._later([_Transfer(self._slaves[handle], b"", count)], count)

    def write(self, handle: int, data: bytes) -> Later:
        """START, address+W, ``data`` (8192 bytes at most), STOP."""
        data = data[:_MAX_MESSAGE_BYTES]
        return self._later([_Transfer(self._slaves[handle], data, 0)], len(data))

    def ioctl(self, handle: int, command: int, argument: int, data: bytes, room: int) -> Later | Done | Failed | Ask:
        """The requests of i2c-dev; ENOTTY for others."""
        memory = _CallerMemory(data, room)
        try:
            if command == _RDWR:
                return self._rdwr(argument, memory)
            if command == _SMBUS:
                return self._smbus(self._slaves[handle], argument, memory)
            return self._setting(handle, command, argument, memory)
        except _More:
            return Ask(memory.inputs, memory.outputs)

    def _setting(self, handle: int, command: int, argument: int, memory: _CallerMemory) -> Done | Failed:
        if command == _FUNCS:
            memory.take((), [Area(argument, _FUNCTIONS.size)])
            return Done(0, _FUNCTIONS.pack(_FUNC_I2C | _FUNC_SMBUS | _FUNC_SMBUS_BLOCK_PROC_CALL))
        if command in (_SLAVE, _SLAVE_FORCE) and argument <= 0x7F:
            self._slaves[handle] = argument
            return Done(0)
        if command in (_RETRIES, _TIMEOUT) or (command in (_TENBIT, _PEC) and not argument):
            return Done(0)
        return Failed(errno.EINVAL if command in (_SLAVE, _SLAVE_FORCE, _TENBIT, _PEC) else errno.ENOTTY)

    def _later(
        self, transfers: Sequence[_Transfer], result: int = 0, answer: Callable[[bytes], bytes | None] = bytes
    ) -> Later:
        """All transfers, one after the other, until one fails; ``answer`` makes what is read into the reply."""

        def act(now_ns: int) -> Done | Failed:
            read = b""
            for transfer in transfers:
                start_ns = max(now_ns, self._free_ns)
                try:
                    read += self._bus.transfer(*transfer, now_ns)
                except OSError as error:
                    self._free_ns = start_ns + self._wire_ns(0, 0)  # address byte, no acknowledgement, STOP
                    return Failed(error.errno or errno.EIO, self._free_ns)
                self._free_ns = start_ns + self._wire_ns(len(transfer.write), transfer.read_count)
            data = answer(read)
            return Failed(errno.EPROTO, self._free_ns) if data is None else Done(result, data, self._free_ns)

        return Later(act)

    def _wire_ns(self, write_count: int, read_count: int) -> int:
        """Time on the wires: nine bits a byte, an address for each direction, START, repeated START, STOP."""
        writes, reads = bool(write_count or not read_count), bool(read_count)
        bits = 1 + writes * (10 + 9 * write_count) + reads * (10 + 9 * read_count)
        return bits * 1_000_000_000 // self._bit_rate

    def _rdwr(self, argument: int, memory: _CallerMemory) -> Later | Failed:
        address, n = _RDWR_DATA.unpack(memory.take([Area(argument, _RDWR_DATA.size)]))
        if not 0 < n <= _MAX_MESSAGES:
            return Failed(errno.EINVAL)
        messages = list(_MESSAGE.iter_unpack(memory.take([Area(address, n * _MESSAGE.size)])))
        if any(length > _MAX_MESSAGE_BYTES for _, _, length, _ in messages):
            return Failed(errno.EINVAL)
        if any(flags & ~_M_RD for _, flags, _, _ in messages):
            return Failed(errno.EOPNOTSUPP)
        written = memory.take(
            [Area(buffer, length) for _, flags, length, buffer in messages if length and not flags],
            [Area(buffer, length) for _, flags, length, buffer in messages if length and flags],
        )
        return self._later(_joined(messages, written), n)

    def _smbus(self, address: int, argument: int, memory: _CallerMemory) -> Later | Failed:
        reads, command, size, pointer = _SMBUS_DATA.unpack(memory.take([Area(argument, _SMBUS_DATA.size)]))
        if reads > 1 or size > _I2C_BLOCK_DATA:
            return Failed(errno.EINVAL)
        if size == _QUICK or (size == _BYTE and not reads):
            write = b"" if size == _QUICK else bytes([command])
            return self._later([_Transfer(address, write, 0)])
        if not pointer:
            return Failed(errno.EINVAL)
        union = [Area(pointer, _DATA_BYTES.get(size, _BLOCK_BYTES))]
        both_ways = size in (_PROC_CALL, _BLOCK_PROC_CALL)
        gives = both_ways or not reads or size == _I2C_BLOCK_DATA  # the last: its length is the caller's
        fills = both_ways or bool(reads)
        given = memory.take(union if gives else [], union if fills else [])
        if size == _I2C_BLOCK_BROKEN:  # as before Linux 2.6.23, and as libi2c still does: a read is of 32 bytes
            size, given = _I2C_BLOCK_DATA, given or bytes([_BLOCK_MAX])
        if size not in _DATA_BYTES:
            return self._smbus_block(address, command, size, given, fills=fills)
        register = b"" if size == _BYTE else bytes([command])
        return self._later([_Transfer(address, register + given, union[0].size if fills else 0)])

    def _smbus_block(self, address: int, command: int, size: int, given: bytes, *, fills: bool) -> Later | Failed:
        """``given`` is the caller's union, length first; empty for a block read."""
        if given and not 0 < given[0] <= _BLOCK_MAX:
            return Failed(errno.EINVAL)
        if size == _I2C_BLOCK_DATA:  # the length does not travel over the wires
            length = given[0]
            if fills:
                transfer = _Transfer(address, bytes([command]), length)
                return self._later([transfer], answer=lambda read: bytes([length]) + read)
            return self._later([_Transfer(address, bytes([command]) + given[1 : length + 1], 0)])
        write = bytes([command]) + (given[: given[0] + 1] if given else b"")
        if fills:
            return self._later([_Transfer(address, write, _BLOCK_MAX + 1)], answer=_counted)
        return self._later([_Transfer(address, write, 0)])


def _counted(read: bytes) -> bytes | None:
    """A block whose first byte is its length; None where that is no length."""
    return read[: read[0] + 1] if 0 < read[0] <= _BLOCK_MAX else None


def _joined(messages: Sequence[tuple[int, int, int, int]], written: bytes) -> list[_Transfer]:
    """Messages as transfers: a write and the read that follows it from the same slave are one, by a repeated START."""
    transfers: list[_Transfer] = []
    open_write = False
    for address, flags, length, _ in messages:
        if flags and open_write and transfers[-1].address == address:
            transfers[-1] = transfers[-1]._replace(read_count=length)
        elif flags:
            transfers.append(_Transfer(address, b"", length))
        else:
            transfers.append(_Transfer(address, written[:length], 0))
            written = written[length:]
        open_write = not flags
    return transfers
