"""Time until a mass is known: a flight that asks for its motions, beside the swings of the rehearsal.

    python -m bench.asking [--seeds 3] [--goal "mass 1 %"] [--rate 0.4] [--only NAME ...] [--directory DIR]

DYMAFLEX in the generic world with payloads of 0.5, 5 and 30 kg, and a planar arm of two joints. A library of segments
is planned for each vehicle once, with ``--rate`` as the limit of the base's rate; the swings are as large as keeps the
same limit with the payload that is held (which no flight knows beforehand), or as a rehearsal draws them (``--free``).
Printed, by seed: time from the capture until half of the mass's 95 % interval is as wanted for a second, the interval
at the end, the largest rate of the base, and what the flight said where it gave up. Last, the CPU time of a choice, and
of making one segment's derivatives again.
"""

import argparse
import contextlib
import io
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil_sim.devices.vehicle_file import rehearsal
from hil_sim.mission import Mission
from onboard.channels import Act
from onboard.cli import main
from onboard.config import named, packaged
from onboard.config.segments import read
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.asking import Asking
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.before.foresee.plan import plan_of
from onboard.ground.before.planning.bound import TICK_HZ, FreeBound
from onboard.ground.log.tables import truth
from onboard.identification.exiddm.online import ExiddmIdentifier
from onboard.identification.exiddm.segment_choice import Asked, choose
from onboard.recording.reader import LogReader

OWN = Path(__file__).resolve().parents[1] / "tests" / "flight" / "own"
FEW = ("--starts", "2", "--iterations", "2")  # of the search, for each segment
SEQUENCE = """
[capture]
earliest_s = 3.0
latest_s = 3.8
[[sequence]]
phase = 0
action = "hold"
duration_s = 5.0
[[sequence]]
phase = 1
action = "swing"
duration_s = {seconds}
swing = {swing}
"""
HELD_s, CAUGHT_s = 5.0, 3.4  # when the swings begin, and the payload is caught in the middle
HALF = 1.959964  # of a 95 % interval, in standard deviations
SWING = 0.35  # of a rehearsal, where nothing else is said


class Case(NamedTuple):
    """A vehicle, the payload, and the masses that segments are planned for."""

    vehicle: str
    mass_kg: float
    masses: str


CASES = {
    "dymaflex_0.5_kg": Case("dymaflex", 0.5, "0.5,2,8,32"),
    "dymaflex_5_kg": Case("dymaflex", 5.0, "0.5,2,8,32"),
    "dymaflex_30_kg": Case("dymaflex", 30.0, "0.5,2,8,32"),
    "planar_arm_1_kg": Case("planar_arm", 1.0, "0.3,1,3"),
}


class Answers(NamedTuple):
    """Of one flight."""

    took_s: float  # from the capture; nan: never
    percent: float  # half of the interval at the end
    segments: int
    why: str
    rate: float  # of the base with the payload held, the largest, rad/s


def prepared(directory: Path, case: Case, rate: float) -> tuple[Path, Path]:
    """The vehicle file, and its library of segments."""
    path, made = packaged(case.vehicle), directory / f"{case.vehicle}_segments"
    if case.vehicle == "planar_arm":
        path = directory / case.vehicle / "vehicle.toml"
        if not path.exists():
            main(["init", str(path.parent), "--base", "free", "--urdf", str(OWN / "planar_arm.urdf")])
    (directory / "limits.toml").write_text(f"base_rate_rad_s = {rate}\n")
    if not made.exists():
        (directory / "middle.toml").write_text(
            f"payload.mass_kg = [5.0, 5.0]\n{SEQUENCE.format(seconds=30.0, swing=SWING)}"
        )
        asked = [
            "plan",
            str(path),
            "--segments",
            "--masses",
            case.masses,
            "--limits",
            str(directory / "limits.toml"),
            *FEW,
        ]
        main([*asked, "--scenario", str(directory / "middle.toml"), "-o", str(made)])
    return path, made / "segments.npz"


def flown(log: Path, goal: float, asked: bool) -> Answers:
    """What a log tells."""
    reader = LogReader(log)
    quantity = reader.read("quantity")
    mass = quantity[quantity["name"] == b"m_payload"]
    half = np.where(mass["supported"] != 0, 0.5 * (mass["high"] - mass["low"]) / np.abs(mass["value"]), np.inf)
    caught_s = float((truth.read(log) or {})["capture_s"])
    at_s = 1e-9 * (mass["host_ns"] - float((truth.read(log) or {})["start_ns"])) - caught_s
    rows = reader.read("row")
    held = 1e-9 * (rows["vehicle_ns"] - float((truth.read(log) or {})["start_ns"])) > caught_s + 1.0
    rates = np.linalg.norm(rows["measured"][held, :3], axis=1)
    rate = float(np.nanmax(rates))
    percent = 100.0 * float(half[-1])
    if asked:
        requests = reader.read("request")
        met = requests[requests["act"] == Act.MET]
        took_s = (
            1e-9 * (met["host_ns"][0] - float((truth.read(log) or {})["start_ns"])) - caught_s if len(met) else np.nan
        )
        events = reader.read("event_estimation")
        why = [row["text"].decode() for row in events if row["code"] == b"goal_why"]
        return Answers(took_s, percent, int((requests["act"] == Act.SEGMENT).sum()), why[-1] if why else "", rate)
    fine = np.convolve(half <= goal, np.ones(10), "valid") >= 10
    return Answers(float(at_s[np.argmax(fine) + 9]) if fine.any() else np.nan, percent, 0, "", rate)


class Swings(NamedTuple):
    """The swings of a rehearsal as a seed draws them, and their bound."""

    bound: FreeBound
    moved: FloatArray  # angle, rate, acceleration, (3, n, joints)

    @classmethod
    def of(cls, path: Path, scenario: Path, seed: int) -> "Swings":
        """Those of a scenario of :data:`SEQUENCE`."""
        coarse = named(str(path)).with_row_rate(TICK_HZ)
        plan = plan_of(coarse, Mission(rehearsal(path, scenario), seed).planned(1.0 / TICK_HZ))
        first = int(np.searchsorted(plan.time_s, HELD_s - 1e-9))
        return cls(FreeBound(coarse, plan, first), np.stack([plan.q, plan.dq, plan.ddq])[:, first:])

    def at(self, size: float) -> FloatArray:
        """So many times as large."""
        own = size * self.moved
        own[0] = self.moved[0, 0] + size * (self.moved[0] - self.moved[0, 0])
        return own

    def rate(self, size: float) -> float:
        """Of the base, the largest, rad/s."""
        rates = self.bound.base(self.at(size), 1.0 / TICK_HZ).rate_rad_s
        return float(np.linalg.norm(rates, axis=1).max())

    def largest(self, rate: float, most: float) -> float:
        """The size, ``most`` at most, at which the base turns at ``rate`` at most."""
        least = 0.0
        if self.rate(most) <= rate:
            return most
        for _ in range(10):
            middle = 0.5 * (least + most)
            least, most = (middle, most) if self.rate(middle) <= rate else (least, middle)
        return least

    def known(self, size: float, mass_kg: float, goal: float) -> str:
        """By the bound: when half of the mass's interval is as wanted, from the capture, and what it is at the end."""
        ticks, sigma = self.bound.along(self.at(size))
        half = HALF * sigma[:, 0] / mass_kg
        fine = ticks[half <= goal] / TICK_HZ + HELD_s - CAUGHT_s
        took = f"{fine[0]:5.1f} s" if fine.size else "  never"
        return f"size {size:.2f}, {self.rate(size):.2f} rad/s: {took}, {100.0 * half[-1]:.2f} % at the end"


def limited(path: Path, write: Callable[[float], Path], seed: int, rate: float) -> Path:
    """The scenario whose swings turn the base at ``rate`` at most, as its seed draws them."""
    swing = SWING
    for _ in range(3):  # the program shrinks large swings by itself
        swing = min(1.0, swing * Swings.of(path, write(swing), seed).largest(rate, 4.0))
    return write(swing)


def foresee(directory: Path, name: str, seed: int, asked: argparse.Namespace) -> None:
    """Print what swings would tell by the bound: as drawn, and as small as the limit has them."""
    case = CASES[name]
    scenario, own = directory / f"{name}_foreseen.toml", SEQUENCE.format(seconds=asked.seconds, swing=SWING)
    scenario.write_text(f"payload.mass_kg = [{case.mass_kg}, {case.mass_kg}]\n{own}")
    swings = Swings.of(packaged(case.vehicle), scenario, seed)
    goal = float(asked.goal.split()[1]) / 100.0
    told = [swings.known(size, case.mass_kg, goal) for size in (1.0, swings.largest(asked.rate, 1.0))]
    print(f"{name:16s} {seed:3d}  " + "   ".join(told), flush=True)


def fly(directory: Path, name: str, seed: int, asked: bool, goal: str, seconds: float, rate: float, free: bool) -> Path:
    """The log of a flight, flown where it is not there yet."""
    case = CASES[name]
    path, segments = prepared(directory, case, rate)
    log = directory / f"{name}_{seed}_{'asked' if asked else 'free_swings' if free else 'swings'}.mcap"
    if not log.exists():

        def write(swing: float) -> Path:
            scenario = directory / f"{name}.toml"
            own = SEQUENCE.format(seconds=seconds, swing=swing)
            scenario.write_text(f"payload.mass_kg = [{case.mass_kg}, {case.mass_kg}]\n{own}")
            return scenario

        scenario = write(SWING) if asked or free else limited(path, write, seed, rate)
        if asked:
            how = ["hil", case.vehicle if case.vehicle == "dymaflex" else str(path), "--until", goal]
            how += ["--segments", str(segments), "--most", str(2.0 * seconds)]
        else:
            how = ["hil", str(path)]
        main([*how, "--seed", str(seed), "--scenario", str(scenario), "--log", str(log)])
    return log


def timed(log: Path, directory: Path) -> tuple[float, float, int]:
    """Median ms of CPU of a choice among all segments, of one linearisation, and the number of segments."""
    from onboard.ground.log.tables.vehicle_file import vehicle_of  # noqa: PLC0415

    vehicle = vehicle_of(LogReader(log), directory)
    estimator, library = Estimator(vehicle), read(vehicle.segments_path or directory)
    own = Asking(vehicle, library, estimator.online, estimator.model)
    assert isinstance(estimator.online, ExiddmIdentifier)
    exiddm = estimator.online.exiddm
    exiddm.state, exiddm.covariance, exiddm.held = np.zeros(len(library.unknowns)), own._prior, True
    exiddm.state[3:13] = [5.0, 0.0, 0.0, 0.4, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1]
    choices, made = [], []
    roots = [np.asarray(one, np.float64) for one in library.roots[:, 0]]
    for _ in range(2 * len(library.names)):
        start_s = time.process_time()
        own._linearise(exiddm)
        made.append(time.process_time() - start_s)
        start_s = time.process_time()
        asked = Asked(np.eye(10), np.ones(10))
        choose(own._prior, roots, library.durations_s, asked, np.arange(len(roots)))
        choices.append(time.process_time() - start_s)
    return 1e3 * float(np.median(choices)), 1e3 * float(np.median(made)), len(roots)


def run() -> None:
    """Fly, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--goal", default="mass 1 %")
    parser.add_argument("--seconds", type=float, default=30.0, help="of the swings; twice that for asking")
    parser.add_argument("--rate", type=float, default=0.4, help="limit of the base's rate, rad/s, for the segments")
    parser.add_argument("--foresee", action="store_true", help="swings by the bound only, nothing is flown (packaged)")
    parser.add_argument("--free", action="store_true", help="swings that keep no limit")
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--directory", type=Path, default=Path("asking"))
    asked = parser.parse_args()
    asked.directory.mkdir(parents=True, exist_ok=True)
    share = float(asked.goal.split()[1]) / 100.0
    for name in asked.only:
        for seed in range(1, asked.seeds + 1):
            if asked.foresee:
                foresee(asked.directory, name, seed, asked)
                continue
            told = []
            for asks in (True, False):
                with contextlib.redirect_stdout(io.StringIO()):
                    log = fly(asked.directory, name, seed, asks, asked.goal, asked.seconds, asked.rate, asked.free)
                told.append(flown(log, share, asks))
            one, other = told
            print(
                f"{name:16s} {seed:3d}  asked {one.took_s:6.1f} s {one.percent:6.2f} % {one.rate:.2f} rad/s "
                f"{one.segments:2d} segments   "
                f"swings {other.took_s:6.1f} s {other.percent:6.2f} % {other.rate:.2f} rad/s  {one.why}",
                flush=True,
            )
    if asked.foresee:
        return
    log = asked.directory / f"{asked.only[-1]}_1_asked.mcap"
    choice_ms, made_ms, count = timed(log, asked.directory)
    print(f"a choice among {count} segments: {choice_ms:.1f} ms; one segment linearised again: {made_ms:.1f} ms")


if __name__ == "__main__":
    run()
