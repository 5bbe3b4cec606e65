"""How well samples of every kind are put on vehicle time: numbers, bars and physical limits.

Run ``python -m bench.timebase [--seeds 40] [--hour 3600] [--real]``. Simulated devices with drifting clocks, the real
drivers on simulated buses (``clock_world.py``), and the timebase as the estimator asks it, 200 ms after the fact.

``--real`` flies RockSat in real processes too (tier T1), where chip clocks tick in whole milliseconds of their own, and
so tell how far off a solution is.
"""

import argparse
import math
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.clock_sensors import START_NS, Floats
from bench.clock_world import ClockWorld, fly
from drivers.sync_pulse import code
from hil_sim.mission import open_in_process
from onboard import config
from onboard.channels import CLOCK
from onboard.flight import hil
from onboard.recording.reader import LogReader
from onboard.timebase.clock import ClockState, DeviceClock, Mark
from onboard.timebase.pulse_train import PulseTrain


def quantisation_limit_ns(world: ClockWorld) -> float:
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


class Figure(NamedTuple):
    """A line of the table."""

    what: str
    found: str
    bar: str
    limit: str = ""
    passed: bool | None = None


def show(line: Figure) -> None:
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
        Figure(
            f"IMU, 1 kHz, FSYNC, 1 % off, after 10 s: rms of {seeds} seeds",
            f"{found:.1f} us",
            "60 us",
            text,
            found <= 60,
        )
    )
    show(Figure("  against the quantisation limit", f"{found / limit:.2f}", "1.5", "", found <= 1.5 * limit))
    long, sigma = fly(1000, hour_s, poll_ms=16).errors["imu"].of(10.0)
    worst = float(np.abs(long).max())
    show(
        Figure(
            f"  worst of {hour_s:.0f} s from then on",
            f"{worst:.1f} us",
            "200 us",
            f"rms {rms(long):.1f} us",
            worst <= 200,
        )
    )
    show(
        Figure("  inside 3 sigma", f"{100 * np.mean(np.abs(long) < 3 * sigma):.2f} %", "", f"sigma {rms(sigma):.0f} us")
    )


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
        show(Figure(what, f"{rms(error):.1f} us", f"{bar:.0f} us", stated, rms(error) <= bar))
    error, sigma = gathered("tip")
    show(Figure("nIMU, by arrival alone: mean, spread about it", f"{error.mean():.0f}, {error.std():.0f} us", "",
              f"the device's delay before sending is unknown; sigma {rms(sigma):.0f} us"))  # fmt: skip
    error, sigma = gathered("cell")
    show(Figure("Modbus cell, by question and answer: mean, spread", f"{error.mean():.0f}, {error.std():.0f} us", "",
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
        show(Figure(what, f"{share:.2f} %", "99 %", stated, share >= 99))


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
        show(Figure(what, f"{found} %", "", f"named wrongly: {wrong}", None if missed else found.startswith("100.0")))


def solution_errors_us(log: Path, truth: dict[str, Any], channel: str, clock: str, grid_ns: float) -> Floats:
    """Errors of the locked solutions of a flight's log: samples fall on whole ``grid_ns`` of the device's clock."""
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
        show(Figure(what, f"{virtual:.1f}, {real:.1f} us", f"{2 * bar:.0f} us", "twice the bar above", real <= 2 * bar))


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
    main()
