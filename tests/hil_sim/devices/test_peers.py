"""Drivers and masters that know nothing of us, against the twins."""

import contextlib
import sys
import threading
import time

import can
import canopen
import pytest
import smbus2

from drivers.ports import CanFrame
from hil_sim.buses.can.slcan import SlcanAdapter
from hil_sim.buses.can.virtual import VirtualCan
from hil_sim.buses.i2c_dev import install_i2c
from hil_sim.buses.media import CanBus, I2cBus, PulseLine
from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from tests.hil_sim.devices.serial_bench import RealTime
from tests.hil_sim.devices.twin_bench import MS, START_NS, FlatImu, RateClock, SmallMission, StairImu


class Nobody:
    def give(self, edge_ns, line_sequence):
        """Edges are not looked at here."""
        return True


# mpu6050-raspberrypi on smbus2


@pytest.fixture
def raspberry(monkeypatch):
    monkeypatch.setitem(sys.modules, "smbus", smbus2)
    module = pytest.importorskip("mpu6050")
    return module.mpu6050


class Slow:
    """A clock on which every look takes as long as a byte read on a 100 kHz bus."""

    def __init__(self):
        self.now_ns = START_NS

    def __call__(self):
        self.now_ns += 400_000
        return self.now_ns


def words(accel_g=(0, 0, 0), celsius=36.53, dps=(0, 0, 0)):
    return [*(round(16384 * a) for a in accel_g), round((celsius - 36.53) * 340), *(round(131 * r) for r in dps)]


@pytest.fixture
def raspberry_on(raspberry):
    installed, opened = [], []

    def make(analog):
        chip, clock = Mpu6050Twin(analog, RateClock(), START_NS), Slow()
        installed.append(install_i2c("/dev/i2c-1", [chip], clock))
        opened.append(raspberry(0x68, bus=1))
        clock.now_ns += 10 * MS
        return opened[-1], chip

    yield make
    for sensor in opened:
        sensor.bus.close()
    for one in installed:
        one.uninstall()


def test_raspberry_reads_si_values(raspberry_on):
    sensor, _ = raspberry_on(FlatImu(words((0.5, -1.0, 0.25), 25.0, (10.0, -200.0, 0.5))))
    accel = sensor.get_accel_data(g=True)
    assert [accel[axis] for axis in "xyz"] == pytest.approx([0.5, -1.0, 0.25], abs=1e-4)
    gyro = sensor.get_gyro_data()
    assert [gyro[axis] for axis in "xyz"] == pytest.approx([10.0, -200.0, 0.5], abs=0.01)
    assert sensor.get_temp() == pytest.approx(25.0, abs=0.01)


def test_raspberry_sets_ranges_and_filter(raspberry_on):
    analog = StairImu()
    sensor, _ = raspberry_on(analog)
    sensor.set_accel_range(sensor.ACCEL_RANGE_8G)
    sensor.set_gyro_range(sensor.GYRO_RANGE_1000DEG)
    sensor.set_filter_range(sensor.FILTER_BW_42)
    assert sensor.read_accel_range() == 8
    assert sensor.read_gyro_range() == 1000
    sensor.get_accel_data()
    assert analog.calls[-1][1:] == (4096.0, 32.8, 3)


def test_raspberry_tears_words_as_it_does_on_a_chip(raspberry_on):
    class Edge(FlatImu):
        """Just below and just above a carry, sample by sample."""

        def counts(self, times_s, *setting):
            counts = super().counts(times_s, *setting)
            counts[(times_s * 1e3).round().astype(int) % 2 == 0] = 0x0100
            return counts

    sensor, _ = raspberry_on(Edge([0x00FF] * 7))
    sensor.set_filter_range(sensor.FILTER_BW_188)  # 1 kHz
    read = {sensor.read_i2c_word(0x3B) for _ in range(50)}
    assert read > {0x00FF, 0x0100}
    assert read & {0x0000, 0x01FF}


# canopen.RemoteNode on the virtual channel, our nodes pumped in real time


class Bench:
    """Our nodes on a virtual channel, pumped in real time from ``power_up`` on, and canopen's network on it."""

    def __init__(self, mission, link, net):
        self.mission, self.net = mission, net
        self._link, self._running = link, contextlib.ExitStack()

    def power_up(self, *nodes):
        """Returns when these nodes have sent their boot-up messages: heard here, for canopen forgets earlier ones."""
        heard = self.boots(*nodes)
        start_ns = time.monotonic_ns()
        pulse = PulseLine(Nobody())
        self.mission.attach(i2c=I2cBus(), can=CanBus(self._link), pulse=pulse, start_ns=start_ns)
        self._running.enter_context(RealTime(self.mission))
        assert all(boot.wait(10) for boot in heard)

    def boots(self, *nodes):
        """Events that the next boot-up of each node sets."""
        heard = []
        for node in nodes:
            boot = threading.Event()
            self.net.subscribe(0x700 + node.id, lambda _, data, __, boot=boot: boot.set() if data == b"\0" else None)
            heard.append(boot)
        return heard

    def close(self):
        self.net.disconnect()
        self._running.close()
        self._link.close()


@pytest.fixture
def bench():
    net = canopen.Network()
    bench = Bench(SmallMission(60.0), VirtualCan("peer"), net)
    net.connect(interface="virtual", channel="peer")
    yield bench
    bench.close()


def dictionary():
    od = canopen.ObjectDictionary()

    def variable(name, index, sub, kind, access="rw"):
        entry = canopen.objectdictionary.ODVariable(name, index, sub)
        entry.data_type, entry.access_type, entry.pdo_mappable = kind, access, True
        return entry

    u8, u16, u32, i32 = (
        getattr(canopen.objectdictionary, t) for t in ("UNSIGNED8", "UNSIGNED16", "UNSIGNED32", "INTEGER32")
    )
    for name, index, kind in (
        ("Device type", 0x1000, u32),
        ("Producer heartbeat time", 0x1017, u16),
        ("Position", 0x6004, u32),
        ("Cyclic timer", 0x6200, u16),
    ):
        od.add_object(variable(name, index, 0, kind))
    channel = canopen.objectdictionary.ODArray
    for name, index, kind in (("Process value", 0x9130, i32), ("Status", 0x6150, u8), ("Decimals", 0x6132, u8)):
        array = channel(name, index)
        array.add_member(variable(f"{name} 1", index, 1, kind))
        od.add_object(array)
    for number in (0, 1):
        record = canopen.objectdictionary.ODRecord(f"TPDO {number + 1} communication", 0x1800 + number)
        for sub, kind in ((0, u8), (1, u32), (2, u8), (3, u16), (5, u16), (6, u8)):
            record.add_member(variable(f"Parameter {sub}", 0x1800 + number, sub, kind))
        od.add_object(record)
        record = canopen.objectdictionary.ODRecord(f"TPDO {number + 1} mapping", 0x1A00 + number)
        for sub in range(9):
            record.add_member(variable(f"Object {sub}", 0x1A00 + number, sub, u8 if sub == 0 else u32))
        od.add_object(record)
    return od


def test_canopen_master_configures_starts_and_reads(bench):
    joint, cell = (bench.net.add_node(canopen.RemoteNode(number, dictionary())) for number in (1, 2))
    bench.power_up(joint, cell)
    assert joint.sdo["Device type"].raw == 0x0002_0196
    assert cell.sdo["Device type"].raw == 0x0002_0194
    assert cell.sdo["Decimals"][1].raw == 4
    with pytest.raises(canopen.SdoAbortedError) as caught:
        joint.sdo.upload(0x2345, 0)
    assert caught.value.code == 0x06020000
    with pytest.raises(canopen.SdoAbortedError) as caught:
        joint.sdo["Position"].raw = 1
    assert caught.value.code == 0x06010002

    joint.sdo["Cyclic timer"].raw = 0
    joint.sdo["Producer heartbeat time"].raw = 50
    for pdo in (joint.tpdo[1], joint.tpdo[2], cell.tpdo[1]):
        pdo.read()
    assert joint.tpdo[2].cob_id == 0x281
    assert [v.index for v in cell.tpdo[1].map] == [0x9130, 0x6150]
    joint.tpdo[2].trans_type = 2  # every second SYNC
    joint.tpdo[2].save()

    positions, forces = [], []
    joint.tpdo[2].add_callback(lambda message: positions.append(message["Position"].raw))
    cell.tpdo[1].add_callback(lambda message: forces.append(message["Process value.Process value 1"].raw))
    bench.net.nmt.state = "OPERATIONAL"
    assert joint.nmt.wait_for_heartbeat(2) == "OPERATIONAL"
    deadline = time.monotonic() + 5
    while len(forces) < 40 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert len(forces) >= 40
    assert abs(len(positions) - len(forces) / 2) <= 3
    assert set(forces) == {15_000}
    assert positions == sorted(positions)
    assert positions[0] > 1000
    assert bench.mission.joint.produced >= len(positions)


def test_canopen_remaps_a_pdo(bench):
    cell = bench.net.add_node(canopen.RemoteNode(2, dictionary()))
    bench.power_up(cell)
    cell.tpdo[1].read()
    cell.tpdo[1].clear()
    cell.tpdo[1].add_variable(0x6150, 1)
    cell.tpdo[1].add_variable(0x9130, 1)
    cell.tpdo[1].enabled = True
    cell.tpdo[1].save()
    got = threading.Event()
    cell.tpdo[1].add_callback(lambda message: got.set())
    cell.nmt.state = "OPERATIONAL"
    assert got.wait(5)
    assert bytes(cell.tpdo[1].data) == b"\x00" + (15_000).to_bytes(4, "little")


def test_canopen_resets_a_node(bench):
    joint = bench.net.add_node(canopen.RemoteNode(1, dictionary()))
    bench.power_up(joint)
    (again,) = bench.boots(joint)
    joint.nmt.state = "RESET"
    assert again.wait(10)


# python-can's slcan on the adapter


@pytest.fixture
def adapter():
    adapter = SlcanAdapter()
    yield adapter
    adapter.close()


def open_slcan(adapter, **options):
    return can.Bus(adapter.path, interface="slcan", bitrate=500_000, sleep_after_open=0, **options)


def receive_all(bus):
    got = []
    while (message := bus.recv(0.05)) is not None:
        got.append((message.arbitration_id, bytes(message.data)))
    return got


def test_slcan_opens_sends_and_receives(adapter):
    with open_slcan(adapter) as bus:
        assert adapter.take() == []
        assert adapter.is_open
        bus.send(can.Message(arbitration_id=0x601, data=bytes.fromhex("4000100000000000"), is_extended_id=False))
        bus.send(can.Message(arbitration_id=0x000, data=b"\x01\x00", is_extended_id=False))
        bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
        assert adapter.take() == [(0x601, bytes.fromhex("4000100000000000")), (0, b"\x01\x00"), (0x080, b"")]
        frames = [CanFrame(k, 0x180 + k, bytes(range(k % 9))) for k in range(200)]
        adapter.give(frames)
        assert receive_all(bus) == [frame[1:3] for frame in frames]
        assert adapter.lost == 0
    adapter.take()
    assert not adapter.is_open


def test_slcan_asks_for_version_and_serial_number(adapter):
    with open_slcan(adapter) as bus, answering(adapter):
        assert bus.get_version(2) == (10, 13)
        assert bus.get_serial_number(2) == "HIL0"


def test_slcan_at_another_bit_rate_hears_nothing(adapter):
    with can.Bus(adapter.path, interface="slcan", bitrate=250_000, sleep_after_open=0) as bus:
        adapter.take()
        adapter.give([CanFrame(0, 0x80, b"\x01")])
        bus.send(can.Message(arbitration_id=0x601, data=b"\x00", is_extended_id=False))
        assert adapter.take() == []
        assert receive_all(bus) == []


def test_slcan_listens_only(adapter):
    with open_slcan(adapter, listen_only=True) as bus:
        adapter.take()
        bus.send(can.Message(arbitration_id=0x601, data=b"\x00", is_extended_id=False))
        assert adapter.take() == []
        adapter.give([CanFrame(0, 0x80, b"\x01")])
        assert receive_all(bus) == [(0x80, b"\x01")]


def test_slcan_a_client_that_comes_back_hears_nothing_old(adapter):
    with open_slcan(adapter):
        adapter.take()
        adapter.give([CanFrame(0, 0x80, b"\x01")] * 50)
    adapter.take()
    assert adapter.hung_up
    adapter.give([CanFrame(0, 0x80, b"\x02")] * 50)
    with open_slcan(adapter) as bus:
        adapter.take()
        assert not adapter.hung_up
        adapter.give([CanFrame(0, 0x80, b"\x03")])
        assert receive_all(bus) == [(0x80, b"\x03")]


@contextlib.contextmanager
def answering(adapter):
    """The adapter's own loop, for a client that waits for an answer."""
    stop = threading.Event()

    def loop():
        while not stop.is_set():
            adapter.take()
            time.sleep(0.001)

    thread = threading.Thread(target=loop)
    thread.start()
    yield
    stop.set()
    thread.join()
