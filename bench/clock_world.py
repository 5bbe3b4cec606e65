"""Devices with drifting clocks, drivers and a timebase: the flights that ``bench/timebase.py`` judges.

There are no bodies in this world: every sensor measures time (``clock_sensors.py``), so that each sample says when it
was taken.
"""

import tempfile
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.clock_sensors import START_NS, CountingImu, Elapsed, Floats, Hands, WarmingClock
from drivers.records import Rows
from hil_sim.buses.in_process import in_process
from hil_sim.devices.canopen.encoder406 import Encoder406
from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from hil_sim.devices.serial_line.modbus_load_cell import ModbusLoadCellTwin
from hil_sim.devices.serial_line.nimu import NimuTwin
from hil_sim.devices.serial_line.node_frame import FrameNode, NodeChannel, ValueType
from hil_sim.devices.serial_line.qsb import QsbTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.devices.sync.sync_box import SyncBox
from hil_sim.scenario.bus_tables import CanBusTable, I2cBusTable, PulseLineTable, SerialBusTable
from onboard import config
from onboard.flight.acquire.devices import open_devices
from onboard.flight.clocks import timebase_of

MS = 1_000_000
LAG_NS = 200 * MS
_INERTIA = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
URDF = (
    '<robot name="clocks">'
    + "".join(f'<link name="link_{n}">{_INERTIA}</link>' for n in range(4))
    + "".join(
        f'<joint name="joint_{n}" type="continuous"><axis xyz="0 0 1"/><parent link="link_{n - 1}"/>'
        f'<child link="link_{n}"/></joint>'
        for n in (1, 2, 3)
    )
    + "</robot>"
)
VEHICLE = """
[vehicle]
name = "clocks"
urdf = "clocks.urdf"
base = "prescribed"
base_link = "link_0"
payload_link = "link_3"

[bus.i2c_1]
url = "i2c:///dev/i2c-1"
[bus.sync_line]
url = "gpio:///dev/gpiochip0?line=17"

[device.imu]
kind = "mpu6050"
bus = "i2c_1"
frame = "link_0"
poll_period_ms = {poll_ms}
accel_noise_m_s2 = 0.09
gyro_noise_rad_s = 2e-3
[device.pulse]
kind = "sync_pulse"
bus = "sync_line"
sync_period_ms = 5
"""
FIELD = """
[bus.can_0]
url = "can+socketcan://can0?bitrate=500000"
[bus.tty_imu]
url = "serial:///dev/ttyUSB0?baud=115200"
[bus.tty_joint]
url = "serial:///dev/ttyUSB1?baud=230400"
[bus.tty_cell]
url = "serial:///dev/ttyUSB2?baud=115200"
[bus.tty_node]
url = "serial:///dev/ttyUSB3?baud=230400"

[device.sync]
kind = "canopen_sync"
bus = "can_0"
period_ms = 5
delay_ms = 0.110
[device.shoulder]
kind = "cia406"
bus = "can_0"
node = 1
joint = "joint_1"
counts_per_revolution = 6283185
noise_rad = 1e-6
[device.tip]
kind = "nimu"
bus = "tty_imu"
frame = "link_3"
sample_rate_hz = 150
accel_noise_m_s2 = 0.02
gyro_noise_rad_s = 2e-3
magnetometer = false
[device.elbow]
kind = "qsb"
bus = "tty_joint"
joint = "joint_2"
counts_per_revolution = 500000
noise_rad = 4e-6
[device.cell]
kind = "modbus_load_cell"
bus = "tty_cell"
frame = "joint_2"
axis = [0.0, 0.0, 1.0]
measures = "moment"
capacity_N = 1000.0
noise_N = 0.001
unit = "N"
scale = 0.001
sample_period_ms = 10
[device.wrist]
kind = "node_frame"
bus = "tty_node"
node = 7
tick_hz = 1000000
rate_hz = 200
[[device.wrist.channel]]
name = "angle"
role = "joint"
joint = "joint_3"
noise_rad = 1e-6
"""


@dataclass
class Errors:
    """What became of one channel."""

    at_s: list[Floats] = field(default_factory=list)
    error_ns: list[Floats] = field(default_factory=list)
    sigma_ns: list[Floats] = field(default_factory=list)
    trusted: list[NDArray[np.bool_]] = field(default_factory=list)

    def of(self, first_s: float, last_s: float = np.inf) -> tuple[Floats, Floats]:
        """Errors and sigmas [us] of samples taken in a stretch of time, where the clock was trusted."""
        at, error, sigma = (np.concatenate(part) for part in (self.at_s, self.error_ns, self.sigma_ns))
        which = (at >= first_s) & (at < last_s) & np.concatenate(self.trusted)
        return error[which] * 1e-3, sigma[which] * 1e-3


class ClockWorld:
    """Devices, drivers and a timebase.

    Args:
        seed: of everything random.
        everything: the whole field of devices, and not just an IMU.
        poll_ms: time between two polls of the IMU.
        cut_s: when the pulse line is cut, from and to.
    """

    def __init__(
        self, stack: ExitStack, seed: int, everything: bool, poll_ms: int = 10, cut_s: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        rng = np.random.default_rng(seed)
        self.now_ns = START_NS
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="clocks_")))
        tables: dict[str, Any] = {
            "can_0": CanBusTable(kind="can"),
            "i2c_1": I2cBusTable(kind="i2c"),
            "sync_line": PulseLineTable(kind="pulse", channel="pulse"),
        }
        speeds = {"tty_imu": 115_200, "tty_joint": 230_400, "tty_cell": 115_200, "tty_node": 230_400}
        if everything:
            tables |= {name: SerialBusTable(kind="serial", baud_rate=speed) for name, speed in speeds.items()}
        ports = in_process(tables, directory, lambda: self.now_ns, name=f"clocks{seed}", seed=seed)
        stack.callback(ports.close)
        self._buses: dict[str, Any] = dict(ports.buses)
        text = VEHICLE.format(poll_ms=poll_ms) + (FIELD if everything else "")
        (directory / "clocks.urdf").write_text(URDF, encoding="utf-8")
        vehicle = config.parse(text, directory / "vehicle.toml")
        self.timebase = timebase_of(vehicle)
        self.taken: dict[str, Callable[[Rows], Floats]] = {}
        pins = self._plug(rng, everything)
        box = SyncBox(WarmingClock(rng, 50e-6, 1e-9), START_NS, first_sync=int(rng.integers(0, 1_400_000)))
        self._buses["can_0"].add(box)
        uncut = [START_NS + round(1e9 * s) for s in cut_s]

        def edge_unless_cut(pin: Callable[[int, int], None], edge: int, high: int) -> None:
            if not uncut[0] <= edge < uncut[1]:
                pin(edge, high)

        for pin in pins:
            box.connect_pin(partial(edge_unless_cut, pin))
        self.edges: list[int] = []
        box.connect_pin(lambda edge, high: self.edges.append(edge))
        opened = open_devices(vehicle.with_urls(ports.urls), lambda: self.now_ns)
        stack.callback(opened.close)
        self._devices = opened.devices
        self._due_ns = {device.name: 0 for device in opened.devices}
        self._waiting: dict[str, list[Rows]] = {}
        self._fresh: dict[str, list[Rows]] = {}
        self.errors: dict[str, Errors] = {name: Errors() for name in self.taken}
        for _ in range(1000 if everything else 0):
            self._advance(MS)

    def _plug(self, rng: np.random.Generator, everything: bool) -> list[Callable[[int, int], None]]:
        analog = CountingImu()
        imu = Mpu6050Twin(analog, WarmingClock(rng, 0.01), START_NS)
        self._buses["i2c_1"].add(imu)
        self.taken["imu"] = analog.taken_ns
        self.imu = analog
        pins: list[Callable[[int, int], None]] = [imu.fsync, self._buses["sync_line"].edge]
        if everything:
            hands, elapsed, tip = Hands(), Elapsed(), CountingImu()
            qsb = QsbTwin(hands, WarmingClock(rng, 100e-6, 1e-8), START_NS)
            channels = [NodeChannel("angle", "rad", ValueType.I32, elapsed, 1, -6)]
            node = FrameNode(channels, WarmingClock(rng, 0.02), START_NS, node=7, line=LineFormat(230_400))
            self._buses["can_0"].add(Encoder406(1, elapsed, START_NS, counts_per_revolution=6_283_185))
            self._buses["tty_imu"].add(NimuTwin(tip, WarmingClock(rng, 100e-6, 1e-8), START_NS))
            self._buses["tty_joint"].add(qsb)
            self._buses["tty_cell"].add(
                ModbusLoadCellTwin(elapsed, WarmingClock(rng, 100e-6), START_NS, capacity_n=1000.0)
            )
            self._buses["tty_node"].add(node)
            pins += [qsb.dig_io, node.sync_edge]
            self.taken |= {"elbow": hands.taken_ns, "tip": tip.taken_ns}
            self.taken |= dict.fromkeys(("shoulder", "cell", "wrist_angle"), elapsed.taken_ns)
        return pins

    def _advance(self, ns: int) -> None:
        self.now_ns += ns
        for bus in self._buses.values():
            bus.advance(self.now_ns)

    def run(self, seconds: float, step_ms: int, estimate_ms: int = 50) -> None:
        """Fly for so long: devices every ``step_ms``, the timebase every ``estimate_ms``."""
        for device in self._devices:
            self._take(device.start(self.now_ns))
        for step in range(1, round(seconds * 1e3 / step_ms) + 1):
            self._advance(step_ms * MS)
            for device in self._devices:
                if self.now_ns >= self._due_ns[device.name]:
                    self._take(device.pump(self.now_ns))
                    self._due_ns[device.name] = self.now_ns + device.period_ns
            if step % max(1, estimate_ms // step_ms) == 0:
                self._estimate()

    def _take(self, batches: Iterable[tuple[str, Rows]]) -> None:
        for channel, rows in batches:
            self._fresh.setdefault(channel, []).append(rows)

    def _estimate(self) -> None:
        fresh = {channel: np.concatenate(rows) for channel, rows in self._fresh.items() if channel in CHANNELS}
        self._fresh.clear()
        self.timebase.update(self.now_ns, fresh)
        for channel in self.taken:
            if channel in fresh:
                self._waiting.setdefault(channel, []).append(fresh[channel])
            waiting = self._waiting.get(channel, [])
            while waiting and int(waiting[0]["host_ns"][-1]) < self.now_ns - LAG_NS:
                self._judge(channel, waiting.pop(0))

    def _judge(self, channel: str, rows: Rows) -> None:
        times_ns = self.timebase.time_ns(channel, rows)
        if times_ns is None:
            return
        if (waited := self.timebase.waited(channel, rows)) is not None:
            rows, times_ns = rows[~waited], times_ns[~waited]
        if not len(rows):
            return
        taken_ns = self.taken[channel](rows)
        errors = self.errors[channel]
        errors.at_s.append(taken_ns * 1e-9)
        errors.error_ns.append(times_ns - START_NS - taken_ns)
        errors.sigma_ns.append(np.full(len(rows), self.timebase.sigma_ns(channel, int(times_ns[-1]))))
        errors.trusted.append(np.full(len(rows), self.timebase.trusted(channel)))


CHANNELS = ("imu", "pulse", "sync", "shoulder", "tip", "elbow", "elbow_mark", "cell", "wrist_angle", "wrist_mark")


def fly(seed: int, seconds: float, *, everything: bool = False, **options: Any) -> ClockWorld:
    """One flight."""
    with ExitStack() as stack:
        world = ClockWorld(stack, seed, everything, **options)
        world.run(seconds, 1 if everything else options.get("poll_ms", 10))
        return world
