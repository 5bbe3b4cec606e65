"""Detection of a capture at an unknown time with instrument errors; false alarms over hours without one.

Every flight begins without a payload. At a random time a workshop tool of 1, 5 or 20 kg is captured that comes with
some velocity and rate of its own (1 sigma: 2 cm/s, 0.02 rad/s by axis; every third comes with none), the arm moving on.
A minute in which nothing happens is flown by MuJoCo once, as built for its seed, and sensed many times over, with other
errors and other noise each time, half of them with a payload held. Run ``python -m bench.captures``.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from bench import given
from bench.identification import free_flyer as case
from bench.identification.recursive import estimator, ticks_of
from bench.true_flights import free_flyer
from bench.true_flights.free_flyer_sensors import sample
from onboard.dynamics.ticks import FlightSignals, tick_signals
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS
from onboard.identification.free_flyer.recursion.recursive import MotionFilter

Floats = NDArray[np.float64]

MASSES = (1.0, 5.0, 20.0)
AFTER_s, QUIET_s, SENSED = 5.0, 60.0, 6


class Captured(NamedTuple):
    """What came of one capture."""

    delay_s: float  # of the first alarm after it; inf for none
    early: int  # alarms before it
    kinds: tuple[str, ...]
    mass_error: float  # relative, AFTER_s after it; NaN for no answer
    mass_sigma: float  # relative, as the estimator gives it


def _signals(flight: free_flyer.FreeFlightSignals, rng: np.random.Generator) -> FlightSignals:
    sampled = sample(flight, case.ERRORS, rng)
    return tick_signals(*sampled[:4], sampled[4:], case.SAMPLES_PER_TICK, case.SMOOTHING_s)


def _online(signals: FlightSignals, held: bool) -> MotionFilter:
    model = case.vehicle()
    return estimator(model, signals, *case.priors(model, True), held=held)


def capture(shape: free_flyer.Body, mass_kg: float, seed: int) -> Captured:
    """One flight with one capture."""
    rng = np.random.default_rng([seed, round(mass_kg)])
    base, arm = case.vehicle_as_built(rng)
    motion = free_flyer.JointMotion.draw(rng)
    at_s = rng.uniform(5.0, 15.0)
    softly = 0.0 if seed % 3 == 0 else 0.02
    payload = shape.grown(mass_kg)
    event = free_flyer.Capture(payload, at_s, softly * rng.standard_normal(3), softly * rng.standard_normal(3))
    flight = free_flyer.FreeFlight(motion, rng.uniform(-0.05, 0.05, 3), None, base, arm)
    flown = free_flyer.fly_with_capture(flight, event, at_s + AFTER_s + 0.3)
    signals = _signals(flown, rng)
    lost = round(0.5 * case.SMOOTHING_s / (case.SAMPLES_PER_TICK * flight.step_s))
    first_s = ((lost + 0.5) * case.SAMPLES_PER_TICK - 0.5) * flight.step_s  # middle of the first tick
    online, ticks = _online(signals, held=False), ticks_of(signals, first_s)
    last = int(np.searchsorted(ticks.time_s, at_s + AFTER_s))
    for first in range(0, last, BATCH_TICKS):
        online.update(ticks.part(slice(first, min(first + BATCH_TICKS, last))))
    online.finish()
    alarms = [change for change in online.changes if change.kind == "change"]
    after = [change.time_s - at_s for change in alarms if change.time_s > at_s]
    found = online.estimate()
    error = np.nan if found is None else found.body.mass_kg / mass_kg - 1.0
    sigma = np.nan if found is None else float(np.sqrt(found.covariance[0, 0])) / mass_kg
    kinds = tuple(change.kind for change in online.changes)
    return Captured(after[0] if after else np.inf, len(alarms) - len(after), kinds, error, sigma)


def quiet(shape: free_flyer.Body, mass_kg: float, seed: int) -> tuple[int, float]:
    """False alarms and hours of a flight in which nothing happens, sensed several times."""
    rng = np.random.default_rng([seed, 99])
    base, arm = case.vehicle_as_built(rng)
    held = seed % 2 == 0
    world = free_flyer.world(shape.grown(mass_kg) if held else None, base, arm)
    flight = free_flyer.fly(world, free_flyer.JointMotion.draw(rng), rng.uniform(-0.05, 0.05, 3), QUIET_s)
    alarms, hours = 0, 0.0
    for _ in range(SENSED):
        signals = _signals(flight, rng)
        online, ticks = _online(signals, held), ticks_of(signals)
        online.update(ticks)
        online.finish()
        alarms += sum(change.kind == "change" for change in online.changes)
        hours += len(ticks.time_s) * signals.period_s / 3600.0
    return alarms, hours


def run(arguments: argparse.Namespace) -> None:
    """As many captures of each mass as there are seeds, and two minutes of quiet for each."""
    shapes = case.tools(arguments.datasets / "workshop_tools")
    numbers = list(range(arguments.first, arguments.first + arguments.seeds))
    shaped = [shapes[seed % len(shapes)] for seed in numbers]
    print(f"\ncapture at an unknown time, {len(numbers)} flights a mass, mass {AFTER_s:g} s after it")
    print(f"{'kg':>4}{'found':>7}{'early':>7}{'delay p50':>11}{'p95':>7}{'max':>7}{'bar':>5}", end="")
    print(f"{'mass p50':>10}{'p95':>8}{'max':>8}{'bar':>5}{'sigma':>8}")
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for mass in MASSES:
            found = list(pool.map(capture, shaped, [mass] * len(shaped), numbers))
            delay = np.array([one.delay_s for one in found])
            error = np.abs([one.mass_error for one in found])
            answered = error[np.isfinite(error)]
            print(
                f"{mass:4g}{np.isfinite(delay).sum():7}{sum(one.early for one in found):7}{np.median(delay):9.2f} s"
                f"{np.percentile(delay, 95):7.2f}{delay.max():7.2f}{0.5:5}{100 * np.median(answered):9.2f}%"
                f"{100 * np.percentile(answered, 95):7.2f}%{100 * answered.max():7.2f}%{'5%':>5}"
                f"{100 * np.nanmedian([one.mass_sigma for one in found]):7.2f}%  "
                f"{len(error) - len(answered)} without an answer"
            )
            odd = [
                (seed, one.kinds)
                for seed, one in zip(numbers, found, strict=True)
                if one.kinds != ("change", "capture")
            ]
            if odd:
                print(f"     other than one capture: {odd}", flush=True)
        still = max(1, len(numbers) // 3)
        masses = [MASSES[seed % 3] for seed in numbers[:still]]
        told = list(pool.map(quiet, shaped[:still], masses, numbers[:still]))
    alarms, hours = sum(a for a, _ in told), sum(h for _, h in told)
    print(f"false alarms: {alarms} in {hours:.1f} h of flight, {alarms / hours:.2f} an hour (bar 1)")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--datasets", type=given.directory_with("workshop_tools/*"), default=given.DATASETS)
    run(parser.parse_args())


if __name__ == "__main__":
    main()
