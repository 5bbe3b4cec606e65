"""The media, smbus2 in front of simulated slaves, python-can's virtual channel, pulse datagrams."""

import errno
import fcntl
import os
import socket
import struct

import can
import pytest
import smbus2

from drivers.ports import CanFrame
from drivers.transports import open_can
from hil_sim.buses.can_virtual import VirtualCan, install_can
from hil_sim.buses.i2c_dev import install_i2c
from hil_sim.buses.in_process import in_process
from hil_sim.buses.media import CanBus, EdgeDatagrams, I2cBus, PulseLine
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.twin_bench import BUSES, MS, START_NS, SmallMission

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
    """A link that keeps what it is given, and sends what it is told."""

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


def test_wire_time_of_a_fourteen_byte_burst():
    assert 380_000 < I2cBus.transfer_ns(1, 14) < 400_000  # about 156 bits at 400 kHz
    assert I2cBus.transfer_ns(0, 0, 100_000) == 110_000  # START, address, NACK, STOP


def small_bus(link, seed=0, faults=(), **options):
    mission, bus = SmallMission(), CanBus(link, seed=seed, **options)
    bus.inject(FaultPlan(faults, START_NS).of("can_0"))
    mission.attach(i2c=I2cBus(), can=bus, pulse=PulseLine(Sink()), start_ns=START_NS)
    return mission, bus


def received(link):
    return [frame for (frames,) in link.got for frame in frames]


def test_frames_arrive_a_few_microseconds_after_their_end_in_order():
    link = Sink()
    mission, bus = small_bus(link)
    mission.advance(START_NS + 1000 * MS)
    frames = received(link)
    assert len(frames) == bus.delivered == 200 + 2  # SYNC 0 to 199, and SYNC 200 is still on the wire; two boot-ups
    late_us = [(f.host_ns - START_NS) % (5 * MS) / 1e3 for f in frames if f.identifier == 0x080]
    assert 109 < min(late_us) < sum(late_us) / len(late_us) < 125
    stamps = [f.host_ns for f in frames]
    assert stamps == sorted(set(stamps))


def test_what_the_host_sends_is_offered_at_the_time_of_its_last_step():
    link = Sink()
    mission, bus = small_bus(link)
    mission.advance(START_NS + 102 * MS)
    link.got.clear()
    link.out = [(0x601, bytes.fromhex("4000100000000000"))]
    mission.advance(START_NS + 104 * MS)
    (answer,) = received(link)
    assert answer.data == bytes.fromhex("4300100096010200")
    assert 0.7 * MS < answer.host_ns - (START_NS + 102 * MS) < 1.3 * MS
    assert bus.due_ns == START_NS + 105 * MS


@pytest.mark.parametrize(("cob_id", "syncs"), [(0x080, 150), (0x701, 200), (0, 150)])
def test_frames_dropped_by_plan(cob_id, syncs):
    link = Sink()
    mission, bus = small_bus(link, faults=[Fault("frame_drop", "can_0", 0.25, 0.5, cob_id)])
    mission.advance(START_NS + 999 * MS)
    assert sum(f.identifier == 0x080 for f in received(link)) == syncs
    assert bus.dropped == 200 - syncs


def test_same_seed_same_bytes_however_time_is_cut():
    def flight(step_ms, seed):
        link = Sink()
        mission, _ = small_bus(link, seed)
        for ms in range(step_ms, 1001, step_ms):
            mission.advance(START_NS + ms * MS)
        return received(link)

    assert flight(1, 5) == flight(10, 5) == flight(1000, 5) != flight(10, 6)


def test_virtual_channel_keeps_stamps_and_ignores_what_is_not_a_base_frame():
    far = VirtualCan("heft-test")
    with can.Bus("heft-test", interface="virtual", preserve_timestamps=True) as near:
        near.send(can.Message(arbitration_id=0x601, data=b"\x40", is_extended_id=False))
        near.send(can.Message(arbitration_id=0x601, data=b"\x41", is_extended_id=True))
        near.send(can.Message(arbitration_id=0x601, is_remote_frame=True, dlc=2, is_extended_id=False))
        assert far.take() == [(0x601, b"\x40"), (0x601, 2)]
        far.give([CanFrame(123_456_789_012, 0x182, b"\x01\x02")])
        message = near.recv(0)
        assert (message.arbitration_id, bytes(message.data), message.is_extended_id) == (0x182, b"\x01\x02", False)
        assert round(message.timestamp * 1e9) == 123_456_789_012
    far.close()


def test_a_port_in_this_process_gets_the_frames_themselves_and_in_order_with_what_is_none(clock):
    frames = [CanFrame(123_456_789_012 + k, 0x182, bytes([k])) for k in range(5)]
    far = VirtualCan("heft-frames")
    with install_can(), can.Bus("heft-frames", interface="virtual", preserve_timestamps=True) as near:
        port, messages = open_can("can+virtual://heft-frames?timestamps=monotonic", clock), []
        far.give(frames[:2])
        assert port.receive(0.0) == frames[:2]
        assert port.receive(0.0) == []
        far.give(frames[2:3])
        far.give_error(123_456_789_020, 0x40)
        far.give(frames[3:4])
        assert [(f.host_ns, f.identifier, f.is_error) for f in port.receive(0.0)] == [
            (frames[2].host_ns, 0x182, False),
            (123_456_789_020, 0x40, True),
            (frames[3].host_ns, 0x182, False),
        ]
        clock.now_ns = 123_456_789_013
        far.give(frames[:2])
        port.mute()
        far.give(frames[4:])
        assert port.receive(0.0) == frames[:2]
        while (message := near.recv(0.01)) is not None:  # another reader, by python-can's own way
            messages.append(message)
        assert [round(message.timestamp * 1e9) for message in messages if not message.is_error_frame] == [
            frame.host_ns for frame in (*frames[:4], *frames[:2], frames[4])
        ]
        assert bytes(messages[0].data) == b"\0"
        far.unplug()
        with pytest.raises(OSError, match="pulled out"):
            port.receive(0.0)
        port.close()
    far.close()


def test_edges_as_datagrams(tmp_path):
    path = tmp_path / "edges.sock"
    link = EdgeDatagrams(path)
    link.give(1, 1)  # nobody is there yet
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(path))
        link.give(-5, 2)
        assert receiver.recv(64) == struct.pack("<qI", -5, 2)
    link.give(2, 3)  # nobody is there any more
    assert link.lost == 2
    link.close()


def test_a_full_receiver_loses_edges_and_blocks_nobody(tmp_path):
    path = tmp_path / "edges.sock"
    link = EdgeDatagrams(path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(path))
        for k in range(2000):
            link.give(k, k)
    assert 0 < link.lost < 2000
    link.close()


def test_in_process_end_to_end_is_the_same_each_time(tmp_path):
    def flight(name):
        mission, now = SmallMission(), [START_NS]
        edges_path = tmp_path / f"{name}"
        edges_path.mkdir()
        with in_process(BUSES, edges_path, lambda: now[0], name=name, seed=3) as buses:
            mission.plug(buses.buses, START_NS)
            assert buses.urls["i2c_1"] == f"i2c:///dev/i2c-{name}-i2c_1"
            assert buses.urls["can_0"] == f"can+virtual://{name}_can_0?timestamps=monotonic"
            assert buses.urls["sync_line"] == f"gpio+unix://{edges_path}/sync_line.sock"
            with (
                smbus2.SMBus(buses.urls["i2c_1"].removeprefix("i2c://")) as i2c,
                can.Bus(f"{name}_can_0", interface="virtual", preserve_timestamps=True) as bus,
                socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as edges,
            ):
                edges.bind(buses.urls["sync_line"].removeprefix("gpio+unix://"))
                edges.setblocking(False)
                i2c.i2c_rdwr(smbus2.i2c_msg.write(0x68, [0x6B, 0x01]))
                i2c.i2c_rdwr(smbus2.i2c_msg.write(0x68, [0x1A, 0x0A]))
                i2c.i2c_rdwr(smbus2.i2c_msg.write(0x68, [0x23, 0xF8]))
                i2c.i2c_rdwr(smbus2.i2c_msg.write(0x68, [0x6A, 0x40]))
                log = []
                for step in range(100):
                    now[0] += 10 * MS
                    mission.advance(now[0])
                    if step == 20:
                        bus.send(can.Message(arbitration_id=0, data=[1, 0], is_extended_id=False))
                    count = int.from_bytes(bytes(i2c.read_i2c_block_data(0x68, 0x72, 2)), "big")
                    read = smbus2.i2c_msg.read(0x68, count)
                    i2c.i2c_rdwr(smbus2.i2c_msg.write(0x68, [0x74]), read)
                    log.append(bytes(read))
                    while (message := bus.recv(0)) is not None:
                        log.append((message.timestamp, message.arbitration_id, bytes(message.data)))
                    try:
                        while True:
                            log.append(edges.recv(64))
                    except BlockingIOError:
                        continue
                assert buses.ports["sync_line"].counts()["edges_without_receiver"] == 0
                return log, mission.produced()

    (log, produced), (again, _) = flight("one"), flight("two")
    assert log == again
    assert (
        sum(len(entry) for entry in log if isinstance(entry, bytes) and len(entry) != 12) == 14 * produced["imu_base"]
    )
    assert sum(len(entry) == 12 for entry in log if isinstance(entry, bytes)) == 7
    assert sum(entry[1] == 0x281 for entry in log if isinstance(entry, tuple)) == produced["joint_1"] > 150
    assert abs(produced["imu_base"] - 1003) <= 1
