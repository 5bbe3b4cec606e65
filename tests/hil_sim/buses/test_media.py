"""The simulated I2C bus with smbus2 in front of simulated slaves."""

import errno
import fcntl
import os

import pytest
import smbus2

from hil_sim.buses.i2c_dev import install_i2c
from hil_sim.buses.media import CanBus, I2cBus, PulseLine
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.twin_bench import MS, START_NS, SmallMission

PATH = "/dev/i2c-test"


class Memory:
    """256 registers behind an address; the first byte written is the register."""

    address = 0x50

    def __init__(self):
        self.cells = bytearray(range(256))
        self.pointer = 0
        self.log = []

    def advance(self, now_ns):
        self.log.append(("advance", now_ns))

    def transfer(self, address, write, read_count, now_ns):
        self.log.append((address, bytes(write), read_count, now_ns))
        if write:
            self.pointer = write[0]
            self.cells[self.pointer : self.pointer + len(write) - 1] = write[1:]
        return bytes(self.cells[self.pointer : self.pointer + read_count])


@pytest.fixture
def memory():
    return Memory()


@pytest.fixture
def master(memory, clock):
    bus = I2cBus()
    bus.add(memory)
    with install_i2c(PATH, bus, clock), smbus2.SMBus(PATH) as master:
        yield master


# smbus2


def test_adapter_offers_what_the_tests_below_use(master):
    func = smbus2.I2cFunc
    wanted = func.I2C | func.SMBUS_QUICK | func.SMBUS_BYTE | func.SMBUS_BYTE_DATA | func.SMBUS_WORD_DATA
    wanted |= func.SMBUS_PROC_CALL | func.SMBUS_BLOCK_DATA | func.SMBUS_I2C_BLOCK | func.SMBUS_BLOCK_PROC_CALL
    assert master.funcs & wanted == wanted
    assert not master.funcs & func.SMBUS_PEC
    with pytest.raises(OSError, match="PEC"):
        master.enable_pec()


def test_quick_and_byte(master, memory, clock):
    now_ns = clock()
    master.write_quick(0x50)
    master.write_byte(0x50, 0x21)
    assert master.read_byte(0x50) == 0x21
    assert memory.log == [(0x50, b"", 0, now_ns), (0x50, b"\x21", 0, now_ns), (0x50, b"", 1, now_ns)]


def test_byte_data_and_word_data(master, memory):
    master.write_byte_data(0x50, 0x10, 0xAB)
    assert master.read_byte_data(0x50, 0x10) == 0xAB
    master.write_word_data(0x50, 0x20, 0xBEEF)
    assert memory.cells[0x20:0x22] == b"\xef\xbe"
    assert master.read_word_data(0x50, 0x20) == 0xBEEF
    assert [entry[1:3] for entry in memory.log] == [
        (b"\x10\xab", 0),
        (b"\x10", 1),
        (b"\x20\xef\xbe", 0),
        (b"\x20", 2),
    ]


def test_process_call(master, memory):
    assert master.process_call(0x50, 0x30, 0x1234) == 0x1234
    assert memory.log[-1][1:3] == (b"\x30\x34\x12", 2)


def test_i2c_block(master, memory):
    master.write_i2c_block_data(0x50, 0x40, [1, 2, 3])
    assert memory.log[-1][1:3] == (b"\x40\x01\x02\x03", 0)
    assert master.read_i2c_block_data(0x50, 0x40, 3) == [1, 2, 3]
    assert len(master.read_i2c_block_data(0x50, 0x40, 32)) == 32


def test_smbus_block(master, memory):
    master.write_block_data(0x50, 0x60, [7, 8])
    assert memory.log[-1][1:3] == (b"\x60\x02\x07\x08", 0)
    assert master.read_block_data(0x50, 0x60) == [7, 8]
    assert master.block_process_call(0x50, 0x70, [5, 6, 7]) == [5, 6, 7]
    memory.cells[0x60] = 33
    with pytest.raises(OSError, match="Protocol") as caught:
        master.read_block_data(0x50, 0x60)
    assert caught.value.errno == errno.EPROTO


def test_combined_transfer_is_one_transfer(master, memory):
    write, read = smbus2.i2c_msg.write(0x50, [0x10]), smbus2.i2c_msg.read(0x50, 100)
    master.i2c_rdwr(write, read)
    assert bytes(read) == bytes(range(0x10, 0x10 + 100))
    assert [entry[:3] for entry in memory.log] == [(0x50, b"\x10", 100)]


def test_messages_that_do_not_belong_together(master, memory):
    read = smbus2.i2c_msg.read(0x50, 1)
    master.i2c_rdwr(smbus2.i2c_msg.write(0x50, [1, 2]), smbus2.i2c_msg.write(0x50, [3]), read)
    again = smbus2.i2c_msg.read(0x50, 2)
    master.i2c_rdwr(again)
    assert [entry[1:3] for entry in memory.log] == [(b"\x01\x02", 0), (b"\x03", 1), (b"", 2)]


@pytest.mark.parametrize(
    "messages",
    [
        [smbus2.i2c_msg.read(0x50, 8193)],
        [smbus2.i2c_msg.write(0x50, [0])] * 43,
    ],
)
def test_limits_of_i2c_dev(master, messages):
    with pytest.raises(OSError, match="Invalid") as caught:
        master.i2c_rdwr(*messages)
    assert caught.value.errno == errno.EINVAL


def test_the_largest_that_i2c_dev_takes(master, memory):
    read = smbus2.i2c_msg.read(0x50, 8192)
    master.i2c_rdwr(read)
    assert memory.log == [(0x50, b"", 8192, memory.log[0][3])]
    master.i2c_rdwr(*[smbus2.i2c_msg.write(0x50, [0])] * 42)
    assert len(memory.log) == 43


@pytest.mark.parametrize(
    "write", [lambda m: m.write_block_data(0x50, 0, []), lambda m: m.write_i2c_block_data(0x50, 0, [])]
)
def test_an_empty_block_is_refused(master, write):
    with pytest.raises(OSError, match="Invalid"):
        write(master)


def test_nobody_at_the_address(master):
    with pytest.raises(OSError, match="Remote") as caught:
        master.read_byte_data(0x51, 0)
    assert caught.value.errno == errno.EREMOTEIO


def test_unknown_requests_and_addresses(master):
    ioctl = smbus2.smbus2.ioctl
    for request, argument, code in ((0x0703, 0x80, errno.EINVAL), (0x0704, 1, errno.EINVAL), (0x1234, 0, errno.ENOTTY)):
        with pytest.raises(OSError, match=r".") as caught:
            ioctl(master.fd, request, argument)
        assert caught.value.errno == code
    assert ioctl(master.fd, 0x0702, 10) == 0  # I2C_TIMEOUT
    assert ioctl(master.fd, 0x0706, 0x50) == 0  # I2C_SLAVE_FORCE


def test_other_files_are_left_to_the_kernel(master):
    with pytest.raises(FileNotFoundError):
        smbus2.SMBus("/dev/i2c-that-is-not-there")
    with pytest.raises(OSError, match="ioctl"):
        smbus2.SMBus(os.devnull)


def test_uninstall_gives_smbus2_its_own_back(memory, clock):
    first, second = install_i2c(PATH, [memory], clock), install_i2c(PATH + "2", [memory], clock)
    with pytest.raises(ValueError, match="already"):
        install_i2c(PATH, [memory], clock)
    first.uninstall()
    with smbus2.SMBus(PATH + "2") as master:
        assert master.read_byte_data(0x50, 3) == 3
    with pytest.raises(FileNotFoundError):
        smbus2.SMBus(PATH)
    second.uninstall()
    assert smbus2.smbus2.ioctl is fcntl.ioctl
    assert smbus2.smbus2.os is os


def test_several_slaves_without_a_bus(clock):
    imus = [SmallMission() for _ in range(2)]
    for mission in imus:
        mission.attach(i2c=I2cBus(), can=CanBus(Sink()), pulse=PulseLine(Sink()), start_ns=0)
    imus[1].imu.address = 0x69
    with install_i2c(PATH, [mission.imu for mission in imus], clock), smbus2.SMBus(PATH) as master:
        master.write_byte_data(0x69, 0x19, 7)
        assert (master.read_byte_data(0x68, 0x19), master.read_byte_data(0x69, 0x19)) == (0, 7)
        with pytest.raises(OSError, match="Remote"):
            master.read_byte(0x6A)


# Media


class Sink:
    """A link that keeps what it is given, and sends what it is given to send."""

    listening = True

    def __init__(self):
        self.out, self.got = [], []

    def take(self):
        out, self.out = self.out, []
        return out

    def give(self, *what):
        self.got.append(what)
        return True


def test_i2c_bus_counts_and_refuses(memory):
    bus = I2cBus()
    bus.add(memory)
    with pytest.raises(ValueError, match="0x50 is taken"):
        bus.add(Memory())
    bus.inject(FaultPlan([Fault("nack", "i2c_1", 1.0, 2.0, errno.ETIMEDOUT)], START_NS).of("i2c_1"))
    assert bus.transfer(0x50, b"\x05", 1, START_NS) == b"\x05"
    with pytest.raises(OSError, match="timed out"):
        bus.transfer(0x50, b"\x05", 1, START_NS + 1000 * MS)
    bus.transfer(0x50, b"\x05", 1, START_NS + 2000 * MS)
    with pytest.raises(OSError, match="Remote"):
        bus.transfer(0x51, b"", 0, START_NS)
    assert (bus.transfers, bus.refused) == (4, 2)
    with pytest.raises(FaultError):
        bus.inject(FaultPlan([Fault("off", "i2c_1", 1.0)], START_NS).of("i2c_1"))
