"""How well samples of every kind are put on vehicle time: numbers, bars and physical limits.

Run ``python bench/timebase.py [--seeds 40] [--hour 3600] [--real]``. Simulated devices with drifting clocks, the real
drivers on simulated buses, and the timebase as the estimator asks it, 200 ms after the fact. There are no bodies in
this world: every sensor measures time, so that each sample says when it was taken. Clocks of the IMU and of the serial
devices warm up and cool down, 100 ppm a minute at their steepest.

``--real`` flies RockSat in real processes too (tier T1), where chip clocks tick in whole milliseconds of their own, and
so tell how far off a solution is.
"""

import argparse
import math
import sys
import tempfile
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from drivers.sync_pulse import code
from hil_sim.buses.in_process import in_process
from hil_sim.devices.encoder406 import Encoder406
from hil_sim.devices.modbus_load_cell import ModbusLoadCell
from hil_sim.devices.mpu6050 import Mpu6050
from hil_sim.devices.nimu import Nimu
from hil_sim.devices.node_frame import FrameNode, NodeChannel, ValueType
from hil_sim.devices.qsb import Qsb
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.devices.sync_box import SyncBox
from hil_sim.mission import open_in_process
from hil_sim.scenario.device_tables import CanBusTable, I2cBusTable, PulseLineTable, SerialBusTable
from onboard import config
from onboard.channels import CLOCK
from onboard.flight import hil
from onboard.flight.clocks import timebase_of
from onboard.flight.devices import open_devices
from onboard.recording.reader import LogReader
from onboard.timebase.clock import ClockState, DeviceClock, Mark
from onboard.timebase.pulse_train import PulseTrain

Floats = NDArray[np.float64]

START_NS = 7_000_000_000
MS = 1_000_000
LAG_NS = 200 * MS
STEEPEST_PER_S = 100e-6 / 60.0
WARMING_S = 600.0
COUNTS_PER_REVOLUTION = 500_000
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


class WarmingClock:
    """A chip's clock off by ``rate_error``, and by up to 160 ppm more or less as it warms up and cools down."""

    def __init__(self, rng: np.random.Generator, rate_limit: float, steepest_per_s: float = STEEPEST_PER_S) -> None:
        self._rate = 1.0 + rng.uniform(-rate_limit, rate_limit)
        self._turn = 2.0 * math.pi / WARMING_S
        self._swing = steepest_per_s / self._turn
        self._phase = rng.uniform(0.0, 2.0 * math.pi)

    def _chip_s(self, time_s: Floats) -> Floats:
        wave = np.cos(self._phase) - np.cos(self._phase + self._turn * time_s)
        return self._rate * time_s + self._swing / self._turn * wave

    def chip_ns(self, time_ns: int) -> int:
        """See ``hil_sim.sensing.analog.ChipClock``."""
        return round(1e9 * float(self._chip_s(np.array([(time_ns - START_NS) * 1e-9]))[0]))

    def time_ns(self, chip_ns: int) -> int:
        """See ``hil_sim.sensing.analog.ChipClock``."""
        return START_NS + round(1e9 * float(self.times_s(np.array([float(chip_ns)]))[0]))

    def times_s(self, chip_ns: Floats) -> Floats:
        """See ``hil_sim.sensing.analog.ChipClock``."""
        target_s = 1e-9 * chip_ns
        time_s = target_s / self._rate
        for _ in range(4):
            rate = self._rate + self._swing * np.sin(self._phase + self._turn * time_s)
            time_s = time_s - (self._chip_s(time_s) - target_s) / rate
        return np.asarray(time_s, np.float64)


class CountingImu:
    """Its accelerometer's x and y words count the samples; it remembers when each was taken."""

    def __init__(self) -> None:
        self._times_s = np.zeros(1 << 12)
        self._count = 0

    @property
    def times_s(self) -> Floats:
        """When each sample was taken, (n,), mission time."""
        return self._times_s[: self._count]

    def counts(
        self, times_s: Floats, accel_lsb_per_g: float, gyro_lsb_per_dps: float, dlpf_cfg: int
    ) -> NDArray[np.int16]:
        """See ``hil_sim.sensing.analog.ImuAnalog``."""
        del accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg
        number = self._count + np.arange(len(times_s))
        words = np.zeros((len(times_s), 7), np.int16)
        words[:, 0], words[:, 1] = number % 30_000, number // 30_000
        self._count += len(times_s)
        while self._count > len(self._times_s):
            self._times_s = np.concatenate([self._times_s, np.zeros_like(self._times_s)])
        self._times_s[number] = times_s
        return words

    def taken_ns(self, rows: Rows) -> Floats:
        """When rows (n,) were taken, after START_NS."""
        number = rows["accel_raw"][:, 0].astype(np.int64) + 30_000 * rows["accel_raw"][:, 1].astype(np.int64)
        return np.asarray(1e9 * self.times_s[number], np.float64)


class Hands:
    """A shaft that turns unevenly; it remembers when it was looked at, and what count it then had.

    The adapter counts from wherever it began. Few counts are ever looked at, so only one beginning fits many rows.
    """

    def __init__(self) -> None:
        self._seen: dict[int, float] = {}
        self._first: int | None = None

    def value(self, time_s: float) -> float:
        """Angle, rad."""
        angle = 0.5 * time_s + 0.3 * math.sin(time_s)
        self._seen.setdefault(round(angle * COUNTS_PER_REVOLUTION / math.tau), time_s)
        return angle

    def taken_ns(self, rows: Rows) -> Floats:
        """When rows (n,) were taken, after START_NS."""
        values = rows["value_raw"].tolist()
        if self._first is None:
            fits = [n for n in range(200_000) if all(value + n in self._seen for value in values)]
            assert len(fits) == 1, f"{len(fits)} beginnings fit {len(values)} rows"
            self._first = fits[0]
        return 1e9 * np.array([self._seen[value + self._first] for value in values])


class Elapsed:
    """An input that is the time."""

    def value(self, time_s: float) -> float:
        """Mission time, s."""
        return time_s

    def taken_ns(self, rows: Rows) -> Floats:
        """When rows (n,) were taken, after START_NS."""
        return 1e9 * rows["value_raw"] * rows["scale"]


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


class World:
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
        for pin in pins:
            box.connect_pin(lambda edge, high, pin=pin: None if uncut[0] <= edge < uncut[1] else pin(edge, high))
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
        imu = Mpu6050(analog, WarmingClock(rng, 0.01), START_NS)
        self._buses["i2c_1"].add(imu)
        self.taken["imu"] = analog.taken_ns
        self.imu = analog
        pins: list[Callable[[int, int], None]] = [imu.fsync, self._buses["sync_line"].edge]
        if everything:
            hands, elapsed, tip = Hands(), Elapsed(), CountingImu()
            qsb = Qsb(hands, WarmingClock(rng, 100e-6, 1e-8), START_NS)
            channels = [NodeChannel("angle", "rad", ValueType.I32, elapsed, 1, -6)]
            node = FrameNode(channels, WarmingClock(rng, 0.02), START_NS, node=7, line=LineFormat(230_400))
            self._buses["can_0"].add(Encoder406(1, elapsed, START_NS, counts_per_revolution=6_283_185))
            self._buses["tty_imu"].add(Nimu(tip, WarmingClock(rng, 100e-6, 1e-8), START_NS))
            self._buses["tty_joint"].add(qsb)
            self._buses["tty_cell"].add(ModbusLoadCell(elapsed, WarmingClock(rng, 100e-6), START_NS, capacity_n=1000.0))
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
        rows, times_ns = (part[~self.timebase.waited(channel, rows)] for part in (rows, times_ns))
        if not len(rows):
            return
        taken_ns = self.taken[channel](rows)
        errors = self.errors[channel]
        errors.at_s.append(taken_ns * 1e-9)
        errors.error_ns.append(times_ns - START_NS - taken_ns)
        errors.sigma_ns.append(np.full(len(rows), self.timebase.sigma_ns(channel, int(times_ns[-1]))))
        errors.trusted.append(np.full(len(rows), self.timebase.trusted(channel)))


CHANNELS = ("imu", "pulse", "sync", "shoulder", "tip", "elbow", "elbow_mark", "cell", "wrist_angle", "wrist_mark")


def fly(seed: int, seconds: float, *, everything: bool = False, **options: Any) -> World:
    """One flight."""
    with ExitStack() as stack:
        world = World(stack, seed, everything, **options)
        world.run(seconds, 1 if everything else options.get("poll_ms", 10))
        return world


def quantisation_limit_ns(world: World) -> float:
    """Error at the last edge of the best there is: all that the flags say, the rate unknown and known not to drift."""
    imu = world.imu.times_s
    period_ns, phase_ns = 1e9 * float(np.mean(np.diff(imu[-2000:]))), 1e9 * float(imu[-1])
    clock = DeviceClock(1e6, drift_per_s=0.0)
    edges = np.array(world.edges) - START_NS
    for edge_ns in edges[edges < 10e9].tolist():
        tick = math.ceil((edge_ns - phase_ns) / period_ns)
        clock.mark(Mark(tick - 1, tick, edge_ns, edge_ns))
    tick = clock.solution.reference_tick
    return float(clock.time_ns(np.array([tick]))[0]) - phase_ns - tick * period_ns


class Line(NamedTuple):
    """A line of the table."""

    what: str
    found: str
    bar: str
    limit: str = ""
    passed: bool | None = None


def show(line: Line) -> None:
    """Print a line."""
    verdict = {True: "yes", False: "NO", None: ""}[line.passed]
    print(f"{line.what:58}{line.found:>24}{line.bar:>16}{verdict:>5}  {line.limit}", flush=True)


def rms(values: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def imu(seeds: int, hour_s: float) -> None:
    """IMU with FSYNC flags."""
    worlds = [fly(seed, 10.6) for seed in range(seeds)]
    found = rms(np.concatenate([world.errors["imu"].of(10.0, 10.2)[0] for world in worlds]))
    limit = rms(np.array([quantisation_limit_ns(world) for world in worlds])) * 1e-3
    text = f"these flags, rate unknown, no drift: {limit:.1f} us rms"
    show(
        Line(
            f"IMU, 1 kHz, FSYNC, 1 % off, after 10 s: rms of {seeds} seeds",
            f"{found:.1f} us",
            "60 us",
            text,
            found <= 60,
        )
    )
    show(Line("  against the quantisation limit", f"{found / limit:.2f}", "1.5", "", found <= 1.5 * limit))
    long, sigma = fly(1000, hour_s, poll_ms=16).errors["imu"].of(10.0)
    worst = float(np.abs(long).max())
    show(
        Line(
            f"  worst of {hour_s:.0f} s from then on",
            f"{worst:.1f} us",
            "200 us",
            f"rms {rms(long):.1f} us",
            worst <= 200,
        )
    )
    show(Line("  inside 3 sigma", f"{100 * np.mean(np.abs(long) < 3 * sigma):.2f} %", "", f"sigma {rms(sigma):.0f} us"))


def field_devices(seeds: int, seconds: float = 40.0) -> None:
    """Everything else."""
    flights = [fly(100 + seed, seconds, everything=True) for seed in range(seeds)]

    def gathered(channel: str) -> tuple[Floats, Floats]:
        parts = [flight.errors[channel].of(10.0) for flight in flights]
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])

    jitter = "stamp of the edge: 3 us and an exponential of 2 us late"
    for channel, what, bar, limit in (
        ("elbow", "QSB, by the count it latches, joint at 0.2-0.8 rad/s: rms", 20.0, "a count is 16-60 us there"),
        ("wrist_angle", "node frames, clock 2 % off: rms", 20.0, jitter),
        ("shoulder", "CANopen node on SYNC: rms", 20.0, jitter),
    ):
        error, sigma = gathered(channel)
        stated = f"{limit}; sigma {rms(sigma):.1f} us, worst {np.abs(error).max():.0f} us"
        show(Line(what, f"{rms(error):.1f} us", f"{bar:.0f} us", stated, rms(error) <= bar))
    error, sigma = gathered("tip")
    show(Line("nIMU, by arrival alone: mean, spread about it", f"{error.mean():.0f}, {error.std():.0f} us", "",
              f"what it waits before it speaks is told by nobody; sigma {rms(sigma):.0f} us"))  # fmt: skip
    error, sigma = gathered("cell")
    show(Line("Modbus cell, by question and answer: mean, spread", f"{error.mean():.0f}, {error.std():.0f} us", "",
              f"bracket's sigma {rms(sigma):.0f} us; on top its own conversion, 0-3.3 ms old"))  # fmt: skip


def cut_line(seeds: int) -> None:
    """The pulse line cut for 60 s."""
    cut_s = (20.0, 80.0)
    flights = [fly(200 + seed, 86.0, cut_s=cut_s) for seed in range(seeds)]
    flights.append(fly(300, 86.0, everything=True, cut_s=cut_s))
    limit = "100 ppm a minute is 3 ms at the end"
    for channel in ("imu", "elbow", "wrist_angle", "shoulder"):
        parts = [flight.errors[channel].of(*cut_s) for flight in flights if channel in flight.errors]
        error, sigma = (np.concatenate(part) for part in zip(*parts, strict=True))
        share = 100 * float(np.mean(np.abs(error) < 3 * sigma))
        stated = f"{limit}; worst seen {np.abs(error).max():.0f} us, sigma {sigma.max():.0f} us then"
        what = f"line cut for 60 s, {channel} inside 3 sigma, {len(parts)} seeds"
        show(Line(what, f"{share:.2f} %", "99 %", stated, share >= 99))


def code_names(trials: int = 400) -> None:
    """How soon edges name themselves."""
    rng = np.random.default_rng(0)
    for missed in (0.0, 0.1, 0.3):
        after, wrong = [], 0
        for _ in range(trials):
            numbers = int(rng.integers(0, code.CODE_LENGTH - 60)) + np.arange(60)
            seen = numbers[rng.random(60) >= missed][:8]
            edges = code.sync_numbers()[seen] * 5e6 + code.dither_ns()[seen]
            edges = edges * (1.0 + rng.uniform(-5e-5, 5e-5)) + rng.exponential(5e3, 8)
            train = PulseTrain(5e6)
            names = [train.edge(edge) for edge in edges.astype(np.int64).tolist()]
            right = code.sync_numbers()[seen].tolist()
            wrong += sum(name is not None and name.sync_count != at for name, at in zip(names, right, strict=True))
            after.append(next((n for n, name in enumerate(names, 1) if name is not None), 99))
        found = " / ".join(f"{100 * np.mean(np.array(after) <= edges):.1f}" for edges in (4, 5, 6))
        what = f"edges named by the 4th / 5th / 6th seen, {missed:.0%} missed"
        show(Line(what, f"{found} %", "", f"named wrongly: {wrong}", None if missed else found.startswith("100.0")))


def solution_errors_us(log: Path, truth: dict[str, Any], channel: str, clock: str, grid_ns: float) -> Floats:
    """Errors of the locked solutions of a flight's log: samples fall on whole ``grid_ns`` of the device's own clock."""
    rows = [rows for _, rows in LogReader(log).batches() if rows.dtype == CLOCK]
    solutions = np.concatenate(rows)
    of_channel = (solutions["channel"] == channel.encode()) & (solutions["state"] == ClockState.LOCKED)
    part_ns = solutions["reference_tick"] % 1.0 * solutions["period_ns"]
    time_s = (solutions["reference_ns"] - part_ns - truth["start_ns"])[of_channel] * 1e-9
    own = truth["clock"][clock]
    chip_ns = 1e9 * time_s * (1.0 + own["rate_error"] + 0.5 * own["drift_per_s"] * time_s)
    off_ns = (chip_ns + 0.5 * grid_ns) % grid_ns - 0.5 * grid_ns
    return np.asarray(off_ns[time_s > 10.0 + time_s[0]] * 1e-3)


def real_processes(seed: int = 1) -> None:
    """RockSat in this process and in real ones."""
    vehicle = config.load(config.packaged("rocksat"))
    found: dict[tuple[str, str], Floats] = {}
    with tempfile.TemporaryDirectory() as directory:
        world, urls = open_in_process("rocksat", seed)
        with world:
            flights = {"T0": hil.fly_simulated(vehicle, world, urls, Path(directory) / "t0.mcap")}
        serve = ["-m", "hil_sim.serve", "rocksat", "--seed", str(seed)]
        flights["T1"] = hil.fly_realtime(vehicle, serve, Path(directory) / "t1.mcap")
        for tier, flown in flights.items():
            for channel, clock, grid_ns in (("imu_base", "imu_base", 1e6), ("can_sync", "sync_box", 5e6)):
                found[tier, channel] = solution_errors_us(flown.log, flown.truth, channel, clock, grid_ns)
    for channel, bar in (("imu_base", 60.0), ("can_sync", 20.0)):
        virtual, real = (rms(found[tier, channel]) for tier in ("T0", "T1"))
        what = f"RockSat, {channel}, solutions, rms: in one process, in real ones"
        show(Line(what, f"{virtual:.1f}, {real:.1f} us", f"{2 * bar:.0f} us", "twice the bar above", real <= 2 * bar))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40, help="of the IMU's first seconds")
    parser.add_argument("--hour", type=float, default=3600.0, help="length of the long flight, s")
    parser.add_argument("--field", type=int, default=3, help="flights of all devices")
    parser.add_argument("--real", action="store_true", help="fly RockSat in real processes too, a minute and a half")
    arguments = parser.parse_args()
    print(f"{'':58}{'found':>24}{'bar':>16}{'':5}  limit")
    code_names()
    imu(arguments.seeds, arguments.hour)
    field_devices(arguments.field)
    cut_line(max(3, arguments.seeds // 8))
    if arguments.real:
        real_processes()


if __name__ == "__main__":
    sys.exit(main())
