"""The CUSE node and its i2c-dev without a kernel: the test plays fs/fuse/file.c, and holds the caller's memory.

Structures are typed here from uapi/linux/fuse.h, i2c.h and i2c-dev.h. In the guest the real kernel does the same:
tests/kernel/test_i2c_node.py.
"""

import errno
import os
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_sim.kernel.cuse import CuseNode
from hil_sim.kernel.i2c_node import I2cNode

IN_HEADER, OUT_HEADER = struct.Struct("<IIQQIIII"), struct.Struct("<IiQ")
IOCTL_IN, IOCTL_OUT = struct.Struct("<QIIQII"), struct.Struct("<iIII")
OPEN, READ, WRITE, RELEASE, INTERRUPT, IOCTL, POLL, CUSE_INIT = 14, 15, 16, 18, 36, 39, 40, 4096
UNRESTRICTED, RETRY = 1 << 1, 1 << 2
I2C_SLAVE, I2C_FUNCS, I2C_RDWR, I2C_SMBUS = 0x703, 0x705, 0x707, 0x720
RD = 1
BYTE, BYTE_DATA, WORD_DATA, PROC_CALL, BLOCK_DATA, BLOCK_BROKEN, BLOCK_PROC_CALL, I2C_BLOCK = 1, 2, 3, 4, 5, 6, 7, 8
CHIP = 0x68
FAST_BIT_NS = 2_500


class Wires:
    """A bus with one slave that answers with counting bytes; keeps what it was asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[int, bytes, int, int]] = []
        self.answer: bytes | None = None
        self.code = errno.EREMOTEIO

    def transfer(self, address: int, write: bytes, read_count: int, now_ns: int) -> bytes:
        self.asked.append((address, write, read_count, now_ns))
        if address != CHIP:
            raise OSError(self.code, os.strerror(self.code))
        return self.answer[:read_count] if self.answer is not None else bytes(k & 0xFF for k in range(read_count))


class Kernel:
    """The other end of /dev/cuse, and a program with memory."""

    def __init__(self, wires: Wires) -> None:
        self.node = CuseNode("i2c-9", I2cNode(wires, 400_000), cuse=None)
        self.memory = bytearray(1 << 16)
        self.now_ns = 1_000_000_000
        self.returned_ns = 0
        self.rounds = 0
        self.unique = 0

    def ask(self, opcode: int, body: bytes = b"") -> tuple[int, bytes]:
        """One request: errno and what stands behind the header of the reply."""
        self.unique += 2
        length = IN_HEADER.size + len(body)
        self.node.handle(IN_HEADER.pack(length, opcode, self.unique, 0, 0, 0, 1, 0) + body)
        self.node.advance(self.now_ns)
        self.returned_ns = self.now_ns if self.node.due_ns >= 1 << 60 else self.node.due_ns
        (reply,) = self.node.replies(1 << 60)
        size, error, unique = OUT_HEADER.unpack_from(reply)
        assert (size, unique) == (len(reply), self.unique)
        assert -512 < error <= 0  # what fuse_dev_do_write takes
        return -error, reply[OUT_HEADER.size :]

    def open(self) -> int:
        code, body = self.ask(OPEN, struct.pack("<II", os.O_RDWR, 0))
        handle, flags, _ = struct.unpack("<QII", body)
        assert (code, flags) == (0, 0b101)  # FOPEN_DIRECT_IO: no page cache; FOPEN_NONSEEKABLE
        return int(handle)

    def ioctl(self, handle: int, command: int, argument: int) -> int:
        """The ioctl's return value, through as many rounds as fuse_do_ioctl allows; raises OSError."""
        inputs: list[tuple[int, int]] = []
        outputs: list[tuple[int, int]] = []
        for self.rounds in range(1, 6):
            data = b"".join(bytes(self.memory[base : base + size]) for base, size in inputs)
            room = sum(size for _, size in outputs)
            head = IOCTL_IN.pack(handle, UNRESTRICTED, command, argument, len(data), room)
            code, body = self.ask(IOCTL, head + data)
            if code:
                raise OSError(code, os.strerror(code))
            result, flags, n_in, n_out = IOCTL_OUT.unpack_from(body)
            rest = body[IOCTL_OUT.size :]
            if not flags & RETRY:
                assert len(rest) <= room
                for base, size in outputs:
                    part, rest = rest[:size], rest[size:]
                    self.memory[base : base + len(part)] = part
                return int(result)
            assert n_in + n_out <= 256  # FUSE_IOCTL_MAX_IOV
            areas = list(struct.iter_unpack("<QQ", rest))
            assert len(areas) == n_in + n_out
            inputs, outputs = areas[:n_in], areas[n_in:]
        raise AssertionError("the device never has enough")

    def put(self, address: int, data: bytes) -> int:
        self.memory[address : address + len(data)] = data
        return address

    def rdwr(self, handle: int, *messages: tuple[int, int, bytes | int]) -> list[bytes]:
        """I2C_RDWR of (address, flags, bytes to write or how many to read); what was read."""
        table, buffer = b"", 0x4000
        reads = []
        for address, flags, content in messages:
            length = content if isinstance(content, int) else len(content)
            if isinstance(content, bytes):
                self.put(buffer, content)
            else:
                reads.append((buffer, length))
            table += struct.pack("<HHHxxQ", address, flags, length, buffer)
            buffer += length
        self.put(0x200, table)
        self.put(0x100, struct.pack("<QI4x", 0x200, len(messages)))
        assert self.ioctl(handle, I2C_RDWR, 0x100) == len(messages)
        return [bytes(self.memory[base : base + size]) for base, size in reads]

    def smbus(self, handle: int, read: bool, command: int, size: int, union: bytes | None) -> bytes:
        """I2C_SMBUS; the caller's union afterwards."""
        pointer = 0 if union is None else self.put(0x300, union.ljust(34, b"\xee"))
        self.put(0x100, struct.pack("<BBxxIQ", read, command, size, pointer))
        assert self.ioctl(handle, I2C_SMBUS, 0x100) == 0
        return bytes(self.memory[0x300:0x322])


@pytest.fixture
def wires() -> Wires:
    return Wires()


@pytest.fixture
def kernel(wires: Wires) -> Kernel:
    return Kernel(wires)


@pytest.fixture
def handle(kernel: Kernel) -> int:
    handle = kernel.open()
    assert kernel.ioctl(handle, I2C_SLAVE, CHIP) == 0
    return handle


def test_the_node_introduces_itself(kernel: Kernel) -> None:
    code, body = kernel.ask(CUSE_INIT, struct.pack("<IIII", 7, 37, 0, 0))
    major, _minor, _, flags, max_read, max_write, dev_major, dev_minor = struct.unpack_from("<8I", body)
    assert (code, major, flags, dev_major, dev_minor) == (0, 7, 1, 0, 0)
    assert min(max_read, max_write) > 8192
    assert body[72:] == b"DEVNAME=i2c-9\0"  # struct cuse_init_out has 72 bytes
    assert kernel.ask(CUSE_INIT, struct.pack("<IIII", 8, 0, 0, 0))[0] == errno.EPROTO


def test_what_a_node_need_not_know_is_refused_and_an_interrupt_is_left(kernel: Kernel) -> None:
    assert kernel.ask(POLL, bytes(24))[0] == errno.ENOSYS
    kernel.node.handle(IN_HEADER.pack(48, INTERRUPT, 9, 0, 0, 0, 1, 0) + bytes(8))
    assert kernel.node.replies(1 << 60) == []


def test_a_write_and_the_read_after_it_are_one_transfer(kernel: Kernel, wires: Wires, handle: int) -> None:
    assert kernel.rdwr(handle, (CHIP, 0, b"\x3b"), (CHIP, RD, 3)) == [b"\0\1\2"]
    assert wires.asked == [(CHIP, b"\x3b", 3, kernel.now_ns)]
    assert kernel.rounds == 4  # argument, messages, buffers, done


def test_other_messages_are_transfers_of_their_own(kernel: Kernel, wires: Wires, handle: int) -> None:
    messages = (CHIP, 0, b"\x19\x07"), (CHIP, 0, b"\x75"), (CHIP, RD, 1), (CHIP, RD, 2), (CHIP, 0, b"")
    assert kernel.rdwr(handle, *messages) == [b"\0", b"\0\1"]
    assert [asked[:3] for asked in wires.asked] == [
        (CHIP, b"\x19\x07", 0),
        (CHIP, b"\x75", 1),
        (CHIP, b"", 2),
        (CHIP, b"", 0),
    ]


def test_a_read_of_another_slave_is_not_joined(kernel: Kernel, wires: Wires, handle: int) -> None:
    with pytest.raises(OSError, match="Remote"):
        kernel.rdwr(handle, (CHIP, 0, b"\x75"), (0x40, RD, 1))
    assert [asked[:3] for asked in wires.asked] == [(CHIP, b"\x75", 0), (0x40, b"", 1)]


@pytest.mark.parametrize(
    ("read", "size", "union", "expected", "left"),
    [
        (False, 0, None, (b"", 0), None),
        (True, 0, None, (b"", 0), None),
        (False, BYTE, None, (b"\x75", 0), None),
        (True, BYTE, b"", (b"", 1), b"\0"),
        (False, BYTE_DATA, b"\xab", (b"\x75\xab", 0), b"\xab"),
        (True, BYTE_DATA, b"", (b"\x75", 1), b"\0\xee"),
        (False, WORD_DATA, b"\x34\x12", (b"\x75\x34\x12", 0), b"\x34\x12"),
        (True, WORD_DATA, b"", (b"\x75", 2), b"\0\1\xee"),
        (False, PROC_CALL, b"\x34\x12", (b"\x75\x34\x12", 2), b"\0\1\xee"),
        (False, BLOCK_DATA, b"\2\xaa\xbb", (b"\x75\2\xaa\xbb", 0), b"\2\xaa\xbb"),
        (False, I2C_BLOCK, b"\2\xaa\xbb", (b"\x75\xaa\xbb", 0), b"\2\xaa\xbb"),
        (True, I2C_BLOCK, b"\3", (b"\x75", 3), b"\3\0\1\2\xee"),
        (False, BLOCK_BROKEN, b"\2\xaa\xbb", (b"\x75\xaa\xbb", 0), b"\2\xaa\xbb"),
        (True, BLOCK_BROKEN, b"", (b"\x75", 32), bytes([32, *range(32)]) + b"\xee"),
    ],
)
def test_every_smbus_size(
    kernel: Kernel,
    wires: Wires,
    handle: int,
    read: bool,
    size: int,
    union: bytes | None,
    expected: tuple[bytes, int],
    left: bytes | None,
) -> None:
    after = kernel.smbus(handle, read, 0x75, size, union)
    assert [asked[:3] for asked in wires.asked] == [(CHIP, *expected)]
    if left is not None:
        assert after.startswith(left)


@pytest.mark.parametrize(
    ("size", "union", "write"), [(BLOCK_DATA, b"", b"\x75"), (BLOCK_PROC_CALL, b"\1\xcc", b"\x75\1\xcc")]
)
def test_a_block_read_keeps_as_many_bytes_as_its_first_one_says(
    kernel: Kernel, wires: Wires, handle: int, size: int, union: bytes, write: bytes
) -> None:
    wires.answer = bytes([4, *range(100, 132)])
    after = kernel.smbus(handle, True, 0x75, size, union)
    assert after[:5] == bytes([4, 100, 101, 102, 103])
    assert after[5] == 0xEE  # memory behind it is the caller's
    assert wires.asked[0][:3] == (CHIP, write, 33)
    for length in (0, 33):
        wires.answer = bytes([length, *range(32)])
        with pytest.raises(OSError, match=r".") as caught:
            kernel.smbus(handle, True, 0x75, size, union)
        assert caught.value.errno == errno.EPROTO


@pytest.mark.parametrize(
    ("read", "size", "union"),
    [
        (True, BYTE, None),
        (False, I2C_BLOCK, b"\0"),
        (False, BLOCK_DATA, b"\x21"),
        (True, I2C_BLOCK, b"\x21"),
        (False, 9, b""),
    ],
)
def test_smbus_requests_that_make_no_sense(
    kernel: Kernel, wires: Wires, handle: int, read: bool, size: int, union: bytes | None
) -> None:
    with pytest.raises(OSError, match=r".") as caught:
        kernel.smbus(handle, read, 0x75, size, union)
    assert caught.value.errno == errno.EINVAL
    assert wires.asked == []


@pytest.mark.parametrize(
    ("command", "argument", "code"),
    [(I2C_SLAVE, 0x80, errno.EINVAL), (0x706, 0x80, errno.EINVAL), (0x704, 1, errno.EINVAL), (0x7FF, 0, errno.ENOTTY)],
)
def test_settings_that_the_adapter_does_not_have(
    kernel: Kernel, handle: int, command: int, argument: int, code: int
) -> None:
    with pytest.raises(OSError, match=r".") as caught:
        kernel.ioctl(handle, command, argument)
    assert caught.value.errno == code


def test_messages_and_reads_that_no_adapter_offers(kernel: Kernel, wires: Wires, handle: int) -> None:
    with pytest.raises(OSError, match=r".") as mangled:
        kernel.rdwr(handle, (CHIP, 0x4000, b"\x75"))  # I2C_M_NOSTART
    kernel.put(0x100, struct.pack("<BBxxIQ", 2, 0x75, BYTE_DATA, 0x300))  # neither read nor write
    with pytest.raises(OSError, match=r".") as neither:
        kernel.ioctl(handle, I2C_SMBUS, 0x100)
    assert (mangled.value.errno, neither.value.errno) == (errno.EOPNOTSUPP, errno.EINVAL)
    assert wires.asked == []


def test_a_32_bit_program_is_refused(kernel: Kernel, handle: int) -> None:
    compat = IOCTL_IN.pack(handle, UNRESTRICTED | 1, I2C_SLAVE, CHIP, 0, 0)
    assert kernel.ask(IOCTL, compat)[0] == errno.ENOTTY


@pytest.mark.parametrize("code", [errno.EREMOTEIO, errno.ENXIO, errno.ETIMEDOUT])
def test_errors_of_the_bus_keep_their_errno(kernel: Kernel, wires: Wires, handle: int, code: int) -> None:
    wires.code = code
    with pytest.raises(OSError, match=r".") as caught:
        kernel.rdwr(handle, (0x40, 0, b"\x75"), (0x40, RD, 1))
    assert caught.value.errno == code
    assert kernel.returned_ns - kernel.now_ns == 11 * FAST_BIT_NS  # START, address, no acknowledgement, STOP


def test_a_call_returns_when_the_wires_are_free(kernel: Kernel, handle: int) -> None:
    kernel.rdwr(handle, (CHIP, 0, b"\x3b"), (CHIP, RD, 14))
    wire_ns = (1 + 10 + 9 + 10 + 14 * 9) * FAST_BIT_NS
    assert kernel.returned_ns - kernel.now_ns == wire_ns
    kernel.now_ns += 1_000  # another one, while the first is still on the wires
    before_ns = kernel.now_ns
    kernel.rdwr(handle, (CHIP, 0, b"\x3b"), (CHIP, RD, 14))
    assert kernel.returned_ns - before_ns == 2 * wire_ns - 1_000


def test_a_call_takes_effect_at_advance_and_not_when_it_is_received(wires: Wires) -> None:
    node = CuseNode("i2c-9", I2cNode(wires), cuse=None)
    node.handle(IN_HEADER.pack(48, OPEN, 2, 0, 0, 0, 1, 0) + bytes(8))
    node.handle(IN_HEADER.pack(80, READ, 4, 0, 0, 0, 1, 0) + struct.pack("<QQIIQII", 1, 0, 1, 0, 0, 0, 0))
    assert wires.asked == []
    node.advance(5_000)
    assert wires.asked == [(0, b"", 1, 5_000)]


def test_read_and_write_go_to_the_slave_of_their_file(kernel: Kernel, wires: Wires, handle: int) -> None:
    other = kernel.open()
    assert kernel.ioctl(other, I2C_SLAVE, 0x40) == 0

    def io(opcode: int, file: int, size: int, data: bytes = b"") -> tuple[int, bytes]:
        return kernel.ask(opcode, struct.pack("<QQIIQII", file, 0, size, 0, 0, 0, 0) + data)

    assert io(WRITE, handle, 2, b"\x6b\x01") == (0, struct.pack("<II", 2, 0))
    assert io(READ, handle, 4) == (0, b"\0\1\2\3")
    assert io(READ, other, 4)[0] == errno.EREMOTEIO
    assert len(io(READ, handle, 20_000)[1]) == 8192
    assert io(WRITE, handle, 9_000, bytes(9_000))[1] == struct.pack("<II", 8192, 0)
    assert [(address, len(write), count) for address, write, count, _ in wires.asked] == [
        (CHIP, 2, 0),
        (CHIP, 0, 4),
        (0x40, 0, 4),
        (CHIP, 0, 8192),
        (CHIP, 8192, 0),
    ]
    assert kernel.ask(RELEASE, struct.pack("<QIIQ", other, 0, 0, 0)) == (0, b"")


def outcome(kernel: Kernel, handle: int, command: int, argument: int) -> int:
    """The errno; 0 where it succeeds."""
    try:
        kernel.ioctl(handle, command, argument)
    except OSError as error:
        return error.errno or -1
    return 0


@given(
    command=st.sampled_from([I2C_SLAVE, I2C_FUNCS, I2C_RDWR, I2C_SMBUS, 0x701, 0x704, 0x708, 0x7FF]),
    argument=st.integers(0, 0x8000),
    head=st.binary(min_size=16, max_size=64),
    more=st.binary(min_size=16, max_size=64),
)
def test_whatever_a_program_hands_over_the_call_ends(command: int, argument: int, head: bytes, more: bytes) -> None:
    kernel = Kernel(Wires())
    handle = kernel.open()
    kernel.memory[:] = (more * (len(kernel.memory) // len(more) + 1))[: len(kernel.memory)]
    pointer = int.from_bytes(head[:8], "little") % 0x8000  # an address that the caller has
    kernel.put(argument, pointer.to_bytes(8, "little") + bytes([head[8] % 50, 0, 0, 0]) + head[12:])
    codes = {errno.EINVAL, errno.EREMOTEIO, errno.EOPNOTSUPP, errno.ENOTTY, errno.EPROTO}
    assert outcome(kernel, handle, command, argument) in codes | {0}
