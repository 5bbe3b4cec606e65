"""The timebase over whole streams: an IMU that flags pulses, SYNCs on a bus of unknown latency, and their pulses."""

import numpy as np
import pytest

from drivers import records
from drivers.sync_pulse import code
from onboard.timebase.clock import ClockState
from onboard.timebase.timebase import FollowerChannel, ProducerChannel, SampledChannel, SyncLine, Timebase
from tests.timebase.streams import Fleet

SYNC_NS = 5_000_000
STAMPS = np.dtype([("tick", "<u8"), ("host_ns", "<i8")])
STEP_NS = 50_000_000


def at_ticks(*ticks: int) -> np.ndarray:
    """Rows of these ticks."""
    rows = np.zeros(len(ticks), STAMPS)
    rows["tick"] = ticks
    return rows


class Bench:
    """True clocks, and what the recorders would say of them."""

    def __init__(self, rng: np.random.Generator, imu_rate_error: float = 0.007, latency_ns: int = 200_000) -> None:
        self.rng = rng
        self.start_ns = 50_000_000_000
        self.period_ns = 1e6 * (1 + imu_rate_error)
        self.phase_ns = float(rng.uniform(0, 1e6))
        self.latency_ns = latency_ns
        numbers = code.sync_numbers()[:2000]
        self.edges = self.start_ns + numbers * SYNC_NS + code.dither_ns()[:2000]
        self.timebase = Timebase(
            {"imu": SampledChannel(1e6), "sync": ProducerChannel(SYNC_NS, 110_000.0), "joint": FollowerChannel("sync")},
            SyncLine("pulse", SYNC_NS),
        )
        self.clocks: list[np.ndarray] = []

    def sample_ns(self, tick: float) -> float:
        return self.start_ns + self.phase_ns + tick * self.period_ns

    def run(self, seconds: float, silent: tuple[float, float] = (np.inf, np.inf), first_sync: int = 37) -> None:
        """Step the timebase; in the ``silent`` stretch no pulse reaches anybody."""
        tick = 0
        sync = first_sync
        for now in range(self.start_ns + STEP_NS, self.start_ns + int(seconds * 1e9), STEP_NS):
            batches = {}
            quiet = [self.start_ns + s * 1e9 for s in silent]
            heard = (self.edges < quiet[0]) | (self.edges > quiet[1])
            edges = self.edges[heard & (self.edges >= now - STEP_NS) & (self.edges < now)]
            pulses = np.zeros(len(edges), records.PULSE)
            pulses["edge_ns"] = edges + self.rng.integers(0, 5000, len(edges))
            pulses["host_ns"] = now
            batches["pulse"] = pulses
            last = int((now - self.start_ns - self.phase_ns) // self.period_ns)
            rows = np.zeros(last + 1 - tick, records.IMU)
            rows["tick"] = np.arange(tick, last + 1)
            rows["host_ns"] = now + int(self.rng.integers(0, 300_000))
            starts = np.array([self.sample_ns(t - 1) for t in rows["tick"].tolist()])
            for edge in self.edges[heard & (self.edges >= now - 2 * STEP_NS) & (self.edges < now)]:
                rows["sync"][(starts < edge) & (edge <= starts + self.period_ns)] = 1
            batches["imu"] = rows
            tick = last + 1
            number = (now - self.start_ns - self.latency_ns) // SYNC_NS
            syncs = np.zeros(max(0, number + 1 - sync), records.CAN_SYNC)
            syncs["tick"] = np.arange(sync, number + 1) - first_sync
            syncs["sync_counter"] = np.arange(sync, number + 1) % 240 + 1
            late = self.latency_ns + self.rng.exponential(50_000, len(syncs))
            syncs["host_ns"] = self.start_ns + np.arange(sync, number + 1) * SYNC_NS + late
            batches["sync"] = syncs
            sync = max(sync, number + 1)
            self.clocks.append(self.timebase.update(now, batches))


@pytest.mark.parametrize("rate_error", [-0.01, 0.0, 0.003, 0.01])
def test_every_channel_is_on_vehicle_time_after_ten_seconds(rng: np.random.Generator, rate_error: float) -> None:
    bench = Bench(rng, rate_error)
    bench.run(10.0)
    ticks = (9000, 9500)
    imu = bench.timebase.time_ns("imu", at_ticks(*ticks))
    assert imu is not None
    a_quarter_of_a_sample = 250_000
    assert np.abs(imu - [bench.sample_ns(t) for t in ticks]).max() < a_quarter_of_a_sample
    joint = bench.timebase.time_ns("joint", at_ticks(1500))
    assert joint is not None
    twenty_microseconds = 20_000
    assert abs(int(joint[0]) - (bench.start_ns + (1500 + 37) * SYNC_NS + 110_000)) < twenty_microseconds
    assert bench.timebase.trusted("imu")
    assert bench.timebase.trusted("joint")


@pytest.mark.parametrize("latency_ms", [0.2, 3.0, 16.0, 40.0])
def test_the_latency_of_the_bus_shifts_nothing(rng: np.random.Generator, latency_ms: float) -> None:
    """A USB adapter with a 16 ms timer hands SYNCs over three periods late; the counter says which they were."""
    bench = Bench(rng, latency_ns=int(latency_ms * 1e6))
    bench.run(6.0)
    joint = bench.timebase.time_ns("joint", at_ticks(900))
    assert joint is not None
    assert bench.timebase.trusted("joint")
    assert abs(int(joint[0]) - (bench.start_ns + (900 + 37) * SYNC_NS + 110_000)) < 20_000


def test_a_silent_line_flywheels_and_says_so(rng: np.random.Generator) -> None:
    bench = Bench(rng)
    bench.run(25.0, silent=(10.0, 20.0))
    states = [int(row["state"]) for rows in bench.clocks for row in rows if row["channel"] == b"imu"]
    assert 2 in states  # flywheel
    assert states[-1] == 1
    times = bench.timebase.time_ns("imu", at_ticks(24_000))
    assert times is not None
    assert abs(times[0] - bench.sample_ns(24_000)) < 250_000


def test_without_pulses_arrival_stamps_serve_and_are_not_called_trusted(rng: np.random.Generator) -> None:
    bench = Bench(rng)
    bench.run(5.0, silent=(0.0, 100.0))
    times = bench.timebase.time_ns("imu", at_ticks(4000))
    assert times is not None
    three_milliseconds = 3e6
    assert abs(times[0] - bench.sample_ns(4000)) < three_milliseconds
    assert not bench.timebase.trusted("imu")
    assert bench.timebase.sigma_ns("imu", int(times[0])) > 50_000


def test_before_anything_is_known_nothing_is_said(rng: np.random.Generator) -> None:
    bench = Bench(rng)
    assert bench.timebase.time_ns("imu", at_ticks(0)) is None
    assert bench.timebase.time_ns("joint", at_ticks(0)) is None
    assert np.isinf(bench.timebase.sigma_ns("imu", 0))


@pytest.mark.parametrize(
    "cycle", [0, 1, *(pytest.param(one, marks=pytest.mark.campaign) for one in (2, 7)), 14]
)  # between the others
def test_a_line_first_heard_hours_after_its_start_gives_the_same_clock(cycle: int) -> None:
    """The code repeats after 2.07 h: which SYNC a pulse belongs to follows from the SYNC that came about then."""
    fleet = Fleet(11, 1000 + cycle * code.CODE_LENGTH)
    fleet.run(120, lambda _: None)
    assert fleet.states["sync"] is ClockState.LOCKED
    assert abs(fleet.error_ns("sync")) < 20_000


def test_a_pps_of_somebody_else_marks_what_needs_no_code() -> None:
    fleet = Fleet(12)
    fleet.edges = fleet.start_ns + 123_456_789 + np.arange(40) * 1_000_000_000
    fleet.timebase = Timebase(fleet.channels, SyncLine("pulse", 1e9, coded=False))
    fleet.run(500, lambda _: None)
    for name, bar_ns in (("imu", 500e3), ("node", 20e3), ("qsb", 60e3), ("sync", 400e3)):
        assert fleet.states[name] is ClockState.LOCKED, name
        assert abs(fleet.error_ns(name)) < bar_ns, name


def test_without_a_line_everything_runs_on_arrival_stamps() -> None:
    fleet = Fleet(13)
    fleet.timebase = Timebase(fleet.channels, None)
    fleet.run(200, lambda _: None)
    for name in fleet.PERIOD_NS:
        assert fleet.states[name] is ClockState.LOCKED
        assert abs(fleet.error_ns(name)) < 5 * fleet.timebase.sigma_ns(name, fleet.start_ns + 200 * STEP_NS) + 1e6


@pytest.mark.parametrize("sync_period_ms", [1.1, 2.2, 22.0])  # 20, 10 and 1 pulses a second
def test_every_base_rate_of_the_code_is_good(sync_period_ms: float) -> None:
    fleet = Fleet(14, sync_ns=round(sync_period_ms * 1e6))
    fleet.run(max(120, round(6 * sync_period_ms)), lambda _: None)
    for name in ("imu", "node", "qsb", "sync"):
        assert fleet.states[name] is ClockState.LOCKED, name
        assert abs(fleet.error_ns(name)) < 500e3, name


def test_samples_have_no_time_while_their_clock_is_contradicted() -> None:
    fleet = Fleet(15)
    fleet.run(200, lambda _: None)
    rows = np.zeros(1, records.SCALAR)
    rows["tick"], rows["host_ns"] = 1000, fleet.start_ns
    assert fleet.timebase.time_ns("node", rows) is not None
    fleet.timebase._sources["node"].clock.suspect(40e6)
    assert fleet.timebase.time_ns("node", rows) is None
