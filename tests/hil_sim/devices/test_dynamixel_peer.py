"""ROBOTIS' own dynamixel-sdk, unmodified, as master of simulated servos over a pseudo-terminal, in real time."""

import math
import time

import pytest

from hil_sim.buses.serial_bus import SerialBus
from hil_sim.buses.serial_port import PtySerial
from hil_sim.devices.serial_line.dynamixel import DynamixelTwin, asks
from hil_sim.devices.serial_line.dynamixel_servo import DynamixelServo
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import Fault, FaultPlan
from hil_sim.plants.drives.servo_axis import ServoAxis
from tests.hil_sim.devices.serial_bench import RealTime
from tests.hil_sim.devices.twin_bench import Analog

sdk = pytest.importorskip("dynamixel_sdk", reason="deploy/requirements-test.lock has it")

POSITIONS = {1: 1000, 2: 2048, 7: 4000}


class Master:
    """The SDK's port and packet handler.

    It is told of an adapter that may hold an answer back for 1 s, as the other end is a thread beside other work. With
    the 16 ms of a USB adapter the answer to a question that was given up was taken for that to the next one: a status
    packet does not say what it answers.
    """

    def __init__(self, path):
        sdk.port_handler.LATENCY_TIMER = 1000.0
        self.port, self.packets = sdk.PortHandler(path), sdk.PacketHandler(2.0)
        assert self.port.setBaudRate(1_000_000)

    def call(self, name, *arguments):
        """A call of the packet handler, without its result code."""
        *answer, result, error = getattr(self.packets, name)(self.port, *arguments)
        assert result == sdk.COMM_SUCCESS, self.packets.getTxRxResult(result)
        return *answer, error


@pytest.fixture
def arm(tmp_path):
    """Three servos and a master; the last servo is overloaded."""
    start_ns = time.monotonic_ns()
    terminal = PtySerial(tmp_path / "tty")
    bus = SerialBus(terminal)
    for identifier, position in POSITIONS.items():
        angle = (position - 2048) * math.tau / 4096
        tripped = [Fault("trip", "servo", 0.0001)] if identifier == 7 else []
        twin = DynamixelTwin(
            Analog(lambda t, angle=angle: angle),
            Analog(lambda t: -0.89),
            start_ns,
            identifier=identifier,
            line=LineFormat(1_000_000),
            faults=FaultPlan(tripped, start_ns).of("servo"),
        )
        bus.add(twin, asks=asks)
    bus.advance(start_ns)
    with RealTime(bus):
        master = Master(str(tmp_path / "tty"))
        yield master
        master.port.closePort()
    terminal.close()


def test_it_pings_reads_and_writes(arm):
    assert arm.call("ping", 1) == (1020, 0)
    position, error = arm.call("read4ByteTxRx", 2, 132)
    assert (abs(position - POSITIONS[2]) <= 2, error) == (True, 0)
    assert arm.call("read1ByteTxRx", 1, 9) == (250, 0)
    assert arm.call("write1ByteTxRx", 1, 65, 1) == (0,)
    assert arm.call("read1ByteTxRx", 1, 65) == (1, 0)
    assert arm.call("write1ByteTxRx", 1, 9, 0) == (7,)  # the EEPROM is locked
    assert arm.call("write4ByteTxRx", 1, 116, 512) == (0,)


def test_it_sees_the_hardware_error(arm):
    bits, error = arm.call("read1ByteTxRx", 7, 70)
    assert (bits, error) == (0x20, 0x80)
    assert "Hardware error" in arm.packets.getRxPacketError(error)


def test_it_finds_all_by_a_broadcast_ping(arm):
    for _ in range(5):
        found, result = arm.packets.broadcastPing(arm.port)
        if result == sdk.COMM_SUCCESS and set(found) == set(POSITIONS):
            break
    assert found == {identifier: [1020, 45] for identifier in POSITIONS}


@pytest.mark.parametrize("fast", [False, True])
def test_it_reads_all_at_once(arm, fast):
    group = sdk.GroupSyncRead(arm.port, arm.packets, 126, 10)
    for identifier in POSITIONS:
        assert group.addParam(identifier)
    read = group.fastSyncRead if fast else group.txRxPacket
    assert read() == sdk.COMM_SUCCESS
    for identifier, position in POSITIONS.items():
        assert group.isAvailable(identifier, 132, 4)
        assert abs(group.getData(identifier, 132, 4) - position) <= 2
        current = group.getData(identifier, 126, 2)
        assert current == (0 if identifier == 7 else (1 << 16) + round(-0.5 / 2.69e-3))


@pytest.fixture
def driven(tmp_path):
    """Two servos that turn as commanded, and a master."""
    start_ns = time.monotonic_ns()
    terminal = PtySerial(tmp_path / "tty")
    bus = SerialBus(terminal)
    axes = {identifier: ServoAxis(0.0, inertia_kg_m2=0.02, torque_n_m=4.1, brake_n_m=0.0) for identifier in (1, 2)}
    for identifier, axis in axes.items():
        bus.add(DynamixelServo(axis, start_ns, identifier=identifier, line=LineFormat(1_000_000)), asks=asks)
    bus.advance(start_ns)
    with RealTime(bus):
        master = Master(str(tmp_path / "tty"))
        yield master, axes
        master.port.closePort()
    terminal.close()


def reached(master, identifier, goal, seconds=8.0):
    """Whether a servo says that it is at its goal within a time."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        position, _ = master.call("read4ByteTxRx", identifier, 132)
        if abs(position - goal) <= 20:
            return True
    return False


def test_it_drives_servos_by_sync_write_within_their_limits(driven):
    master, axes = driven
    for identifier in axes:
        assert master.call("write4ByteTxRx", identifier, 48, 2400) == (0,)
        assert master.call("write4ByteTxRx", identifier, 112, 60) == (0,)
        assert master.call("write1ByteTxRx", identifier, 64, 1) == (0,)
        assert master.call("write4ByteTxRx", identifier, 48, 3000) == (7,)  # the EEPROM is locked
        assert master.call("write4ByteTxRx", identifier, 116, 2401) == (6,)
    group = sdk.GroupSyncWrite(master.port, master.packets, 116, 4)
    for identifier, goal in ((1, 2300), (2, 1800)):
        assert group.addParam(identifier, list(goal.to_bytes(4, "little")))
    for _ in range(3):
        assert group.txPacket() == sdk.COMM_SUCCESS
    assert reached(master, 1, 2300)
    assert reached(master, 2, 1800)
    assert 0.1 < axes[1].fastest_rad_s < 2.0
    assert master.call("write1ByteTxRx", 1, 64, 0) == (0,)
    assert master.call("read1ByteTxRx", 1, 64) == (0, 0)


def test_it_is_stopped_by_the_watchdog_of_a_servo_and_clears_it(driven):
    master, _ = driven
    assert master.call("write1ByteTxRx", 1, 64, 1) == (0,)
    assert master.call("write1ByteTxRx", 1, 98, 5) == (0,)
    time.sleep(0.4)
    assert master.call("read1ByteTxRx", 1, 98) == (255, 0)
    assert master.call("write4ByteTxRx", 1, 116, 2200) == (4,)
    assert master.call("read1ByteTxRx", 1, 64) == (1, 0)  # it holds
    assert master.call("write1ByteTxRx", 1, 98, 0) == (0,)
    assert master.call("write4ByteTxRx", 1, 116, 2200) == (0,)
    assert reached(master, 1, 2200)
