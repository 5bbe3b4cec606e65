"""Wire times and frames of the simulated CAN bus, python-can's virtual channel, edges as datagrams."""

import socket
import struct

import can
import pytest
import smbus2
from can.interfaces.virtual import VirtualBus

from drivers.ports import CanFrame
from drivers.transports import open_can
from hil_sim.buses.can.virtual import VirtualCan, install_can
from hil_sim.buses.in_process import in_process
from hil_sim.buses.media import CanBus, EdgeDatagrams, I2cBus, PulseLine
from hil_sim.faults import Fault, FaultPlan
from tests.hil_sim.buses.test_media import Sink
from tests.hil_sim.devices.twin_bench import BUSES, MS, START_NS, SmallMission


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


def test_where_twins_are_asked_before_each_read_none_waits_for_more(clock, monkeypatch):
    far, looks, due = VirtualCan("heft-looks"), [], [CanFrame(123_456_789_012, 0x182, b"\1")]
    far.tell_looks(lambda: looks.append(far.give(due[len(looks) : len(looks) + 1])))
    with install_can():
        port = open_can("can+virtual://heft-looks?timestamps=monotonic", clock)
        looks.clear()
        monkeypatch.setattr(VirtualBus, "_recv_internal", lambda *_: pytest.fail("it waits on the host's clock"))
        assert port.receive(60.0) == due
        assert port.receive(60.0) == []
        port.close()
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
