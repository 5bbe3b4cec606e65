"""A vehicle with a device of every kind, and the twins that stand at the other ends, in one process."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.records import Batch, Rows
from hil_sim.buses.in_process import in_process
from hil_sim.devices.canopen.arm_controller import ArmController
from hil_sim.devices.canopen.drive402 import Drive402
from hil_sim.devices.canopen.encoder406 import Encoder406
from hil_sim.devices.canopen.loadcell404 import LoadCell404
from hil_sim.devices.hx711 import Hx711Twin
from hil_sim.devices.i2c.as5048 import As5048aTwin, As5048bTwin
from hil_sim.devices.i2c.as5600 import As5600Twin
from hil_sim.devices.i2c.nau7802 import Nau7802Twin
from hil_sim.devices.inertial.bmi088 import Bmi088SpiTwin, Bmi088Twin
from hil_sim.devices.inertial.icm20948 import Icm20948Twin
from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from hil_sim.devices.network.net_box import HexBox, NetBox
from hil_sim.devices.network.ur_controller import UrController, rate
from hil_sim.devices.odrive import OdriveTwin
from hil_sim.devices.serial_line.dsc_load_cell import DscLoadCellTwin
from hil_sim.devices.serial_line.dynamixel import DynamixelTwin, asks
from hil_sim.devices.serial_line.modbus_load_cell import ModbusLoadCellTwin
from hil_sim.devices.serial_line.nimu import NimuTwin
from hil_sim.devices.serial_line.node_frame import FrameNode, NodeChannel, ValueType
from hil_sim.devices.serial_line.pose_tracker import PoseTrackerTwin
from hil_sim.devices.serial_line.qsb import QsbTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.devices.sync.sync_box import SyncBox
from hil_sim.devices.wrist.bota_ft import BotaTwin
from hil_sim.devices.wrist.robotous_rft import RftTwin
from hil_sim.scenario import bus_tables
from onboard import config
from onboard.flight.acquire.devices import OpenDevices, open_devices
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock, StairImu

FORCE_N = 12.5
TORQUE_N_M = 1.5
LINKS = 11
BOOT_MS = 1_000  # the slowest twin is up after half of it
DEVICES = Path(__file__).with_name("mixed.toml").read_text(encoding="utf-8")
_INERTIA = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


def force_n(time_s: float) -> float:
    """A force that rises slowly: a reading that repeats to the bit for seconds is a stuck one."""
    return FORCE_N + 0.02 * time_s


def dithered(mean: float, size: float) -> Callable[[float], float]:
    """A constant whose counts move, so that it does not look stuck."""
    return lambda time_s: mean + size * float(np.sin(2.0 * np.pi * 37.7 * time_s))


def urdf() -> str:
    """A chain of joints ``joint_1`` .. about z, on a body."""
    links = "".join(f'<link name="{name}">{_INERTIA}</link>' for name in ("body", *map(_link, range(1, LINKS + 1))))
    joints = "".join(
        f'<joint name="joint_{n}" type="continuous"><origin xyz="0.1 0 0"/><axis xyz="0 0 1"/>'
        f'<parent link="{_link(n - 1)}"/><child link="{_link(n)}"/></joint>'
        for n in range(1, LINKS + 1)
    )
    return f'<robot name="mixed">{links}{joints}</robot>'


def _link(number: int) -> str:
    return f"link_{number}" if number else "body"


def angle(joint: int) -> Callable[[float], float]:
    """Angle of a joint at a mission time, rad."""
    return lambda time_s: 0.2 * joint + 0.3 * float(np.sin(2.0 * time_s + joint))


def without(device: str) -> str:
    """The vehicle's devices but one."""
    before, own, after = DEVICES.partition(f"[device.{device}]")
    assert own
    return before + after[after.index("[device.") :]


def only(*devices: str) -> str:
    """The vehicle's file with these devices and no others."""
    tables = re.split(r"(?m)^(?=\[)", DEVICES)
    names = [found[1] if (found := re.match(r"\[+device\.(\w+)", table)) else "" for table in tables]
    assert set(devices) < set(names)
    if "wrist" not in devices:  # its channel tells the phase
        names[-1] = "estimation"
    return "".join(table for name, table in zip(names, tables, strict=True) if name in ("", *devices))


def vehicle(directory: Path, urls: dict[str, str], text: str = DEVICES) -> config.Vehicle:
    """The vehicle, its file in ``directory``."""
    (directory / "mixed.urdf").write_text(urdf(), encoding="utf-8")
    return config.parse(text, directory / "vehicle.toml").with_urls(urls)


class Cameras:
    """A tracker's: it sees the body drift along x without turning."""

    def poses(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        seen = np.zeros((len(times_s), 7))
        seen[:, 0], seen[:, 3] = 0.1 * times_s, 1.0
        return seen

    def noisy(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        return poses


class MixedWorld:
    """The twins on their buses, as a context; time is ``now_ns``.

    Args:
        directory: Where sockets are bound.
        text: The vehicle's file; on buses without a device of it nothing goes on.
        sync_box: Whether something outside makes pulses and SYNC.
        fsync: Whether the sync line reaches the IMU.

    Attributes:
        urls: Of every bus of the vehicle.
    """

    def __init__(self, directory: Path, text: str = DEVICES, *, sync_box: bool = True, fsync: bool = True) -> None:
        self.now_ns = START_NS
        tables = {
            "can_0": bus_tables.CanBusTable(kind="can"),  # the sync box is on it, and moves before those that it marks
            "i2c_1": bus_tables.I2cBusTable(kind="i2c"),
            "cell_lines": bus_tables.PairBusTable(kind="pair"),
            "sync_line": bus_tables.PulseLineTable(kind="pulse", channel="pulse"),
            "tty_imu": bus_tables.SerialBusTable(kind="serial"),
            "tty_joint": bus_tables.SerialBusTable(kind="serial", baud_rate=230_400),
            "tty_cell": bus_tables.SerialBusTable(kind="serial"),
            "tty_grip": bus_tables.SerialBusTable(kind="serial"),
            "tty_node": bus_tables.SerialBusTable(kind="serial", baud_rate=230_400),
            "tty_tracker": bus_tables.SerialBusTable(kind="serial", baud_rate=230_400),
            "tty_servos": bus_tables.SerialBusTable(kind="serial", baud_rate=1_000_000),
            "tty_wrist": bus_tables.SerialBusTable(kind="serial", baud_rate=460_800),
            "tty_finger": bus_tables.SerialBusTable(kind="serial", baud_rate=115_200),
            "odrives": bus_tables.CanBusTable(kind="can", bit_rate=250_000),
            "robot": bus_tables.TcpBusTable(kind="tcp"),
            "box": bus_tables.UdpBusTable(kind="udp"),
            "hex": bus_tables.UdpBusTable(kind="udp"),
            **dict.fromkeys(("spi_1", "spi_2"), bus_tables.SpiBusTable(kind="spi")),
            "i2c_2": bus_tables.I2cBusTable(kind="i2c"),
        }
        self._ports = in_process(tables, directory, lambda: self.now_ns, name=directory.name)
        loop = directory / "loop.sock"
        self.urls = {**self._ports.urls, "loop_out": f"gpio-out+unix://{loop}", "loop_in": f"gpio+unix://{loop}"}
        bus = self._ports.buses
        self.imu = Mpu6050Twin(StairImu(), RateClock(0.004), START_NS)
        self.qsb = QsbTwin(Analog(angle(3)), RateClock(), START_NS)
        self.node = FrameNode(_node_channels(), RateClock(-0.001), START_NS, node=7, line=LineFormat(230_400))
        bus["i2c_1"].add(self.imu)
        self.elbow_imu = Icm20948Twin(StairImu(), RateClock(-0.006), START_NS)
        bus["i2c_1"].add(self.elbow_imu)
        bus["i2c_1"].add(As5600Twin(Analog(angle(5)), START_NS, zero_count=77))
        bus["i2c_1"].add(As5048bTwin(Analog(angle(10)), START_NS, address=0x42, zero_count=5000))
        bus["i2c_2"].add(Bmi088Twin(StairImu(), (RateClock(0.005), RateClock(-0.004)), START_NS))
        bus["spi_2"].add(Bmi088SpiTwin(StairImu(), (RateClock(0.005), RateClock(-0.004)), START_NS))
        bus["spi_1"].add(As5048aTwin(Analog(angle(11)), START_NS, zero_count=16000))
        bus["i2c_1"].add(Nau7802Twin(Analog(force_n), RateClock(0.007), START_NS))
        bus["cell_lines"].add(Hx711Twin(Analog(force_n), RateClock(0.012), START_NS))
        self.encoder = Encoder406(1, Analog(angle(1)), START_NS, zero_count=1000)
        nodes = [
            self.encoder,
            LoadCell404(2, Analog(force_n), START_NS),
            ArmController(3, [(0.0, 1), (1.0, 2), (1.5, 4)], START_NS),
            Drive402(4, Analog(angle(2)), Analog(lambda t: TORQUE_N_M), START_NS),
        ]
        if sync_box:
            box = SyncBox(RateClock(), START_NS)
            nodes.append(box)
            for pin in (self.qsb.dig_io, self.node.sync_edge, bus["sync_line"].edge):
                box.connect_pin(pin)
            if fsync:
                box.connect_pin(self.imu.fsync)
                box.connect_pin(self.elbow_imu.fsync)
        for node in nodes:
            bus["can_0"].add(node)
        bus["tty_imu"].add(NimuTwin(StairImu(), RateClock(0.002), START_NS))
        bus["tty_joint"].add(self.qsb)
        bus["tty_cell"].add(ModbusLoadCellTwin(Analog(force_n), RateClock(), START_NS))
        bus["tty_grip"].add(DscLoadCellTwin(Analog(force_n), RateClock(), START_NS))
        bus["tty_node"].add(self.node)
        bus["tty_tracker"].add(PoseTrackerTwin(Cameras(), RateClock(), START_NS))
        wave, torque = Analog(angle(9)), Analog(dithered(TORQUE_N_M, 0.02))
        bus["odrives"].add(OdriveTwin(5, wave, torque, RateClock(1e-4), START_NS, turns=8.0, zero_rev=2.0**-8))
        self.palm = BotaTwin({4: (Analog(force_n), 30.0)}, RateClock(-2e-4), START_NS)
        bus["tty_wrist"].add(self.palm)
        bus["tty_finger"].add(RftTwin({3: (Analog(force_n), 30.0)}, RateClock(3e-4), START_NS))
        for identifier, zero in ((1, 2048), (2, 1000)):
            wave, torque = Analog(angle(5 + identifier)), Analog(dithered(TORQUE_N_M, 0.02))
            servo = DynamixelTwin(wave, torque, START_NS, identifier=identifier, zero_count=zero)
            bus["tty_servos"].add(servo, asks=asks)
        shown = {
            ("actual_q", 1): angle(8),
            ("actual_qd", 1): rate(Analog(angle(8))),
            ("actual_current", 1): dithered(0.1 * TORQUE_N_M, 0.02),
            ("ft_raw_wrench", 2): force_n,
        }
        self.robot = UrController(shown, RateClock(-3e-5), START_NS)
        bus["robot"].add(self.robot)
        counts = {1: lambda time_s: (1e6 * force_n(time_s), False)}
        self.hand = NetBox(counts, RateClock(4e-5), START_NS, rate_hz=500.0)
        bus["box"].add(self.hand)
        thumb = {0: lambda time_s: (1e4 * force_n(time_s), False)}
        bus["hex"].add(HexBox(thumb, RateClock(-3e-5), START_NS))
        self._moving = [bus for name, bus in self._ports.buses.items() if f'bus = "{name}"' in text]
        for _ in range(BOOT_MS):
            self.advance(MS)

    def __enter__(self) -> "MixedWorld":
        return self

    def __exit__(self, *_: object) -> None:
        self._ports.close()

    def clock(self) -> int:
        """CLOCK_MONOTONIC of this world, ns."""
        return self.now_ns

    def advance(self, ns: int) -> None:
        """Let time pass."""
        self.now_ns += ns
        for bus in self._moving:
            bus.advance(self.now_ns)

    def open(self, flying: config.Vehicle) -> OpenDevices:
        """The drivers of a vehicle on these buses."""
        return open_devices(flying, self.clock)

    def fly(self, opened: OpenDevices, seconds: float) -> dict[str, list[Rows]]:
        """Start the devices, pump them every millisecond, stop them: rows by channel."""
        heard: dict[str, list[Rows]] = {}

        def take(batches: list[Batch]) -> None:
            for channel, rows in batches:
                heard.setdefault(channel, []).append(rows)

        take(opened.problems)
        due_ns = {device.name: 0 for device in opened.devices}
        for device in opened.devices:
            take(device.start(self.now_ns))
        for _ in range(round(seconds * 1e3)):
            self.advance(MS)
            for device in opened.devices:
                if self.now_ns >= due_ns[device.name]:
                    take(device.pump(self.now_ns))
                    due_ns[device.name] = self.now_ns + device.period_ns
        for device in opened.devices:
            take(device.stop(self.now_ns))
        opened.close()
        return heard


def _node_channels() -> list[NodeChannel]:
    wave = Analog(angle(4))
    i32 = ValueType.I32
    return [
        NodeChannel("angle", "deg", i32, Analog(lambda t: float(np.degrees(wave.value(t)))), 1, -5),
        NodeChannel("force", "kg", i32, Analog(lambda t: force_n(t) / 9.80665), 1, -4),
        *(NodeChannel(f"gyro_{axis}", "deg/s", i32, Analog(dithered(1.0, 3e-4)), 1, -4) for axis in "xyz"),
        *(NodeChannel(f"accel_{axis}", "g", i32, Analog(dithered(0.5, 3e-5)), 1, -5) for axis in "xyz"),
        NodeChannel("mode", "1", ValueType.U8, Analog(lambda t: 3.0)),
    ]
