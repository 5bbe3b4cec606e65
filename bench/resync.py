"""Flights rescued: an IMU log and an encoder log of two recorders without a common pulse, aligned and identified.

Run ``python -m bench.resync``. Every seed is a parabola of its own, recorded as the dissertation recorded its own
(section 4.4): the IMU has times; the encoder log has none, runs up to 2 % off its nominal rate and starts at an unknown
time. MuJoCo is the truth, the IMU has real errors (its own delay of 0.1 ms, 1 sigma, counts as an error of the offset).
Bars: offset within 1 ms and rate within 50 ppm in 95 % of the seeds; error of the rescued payload at most 1.5 times
that of the same flight synchronised.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from bench.identification.free_flyer import BOXES, ERRORS, IMU_PRIOR, PAYLOAD_SIGMA, vehicle
from bench.true_flights import free_flyer
from bench.true_flights.free_flyer import COUNTS_PER_TURN
from bench.true_flights.free_flyer_sensors import sample
from onboard.dynamics.ticks import FlightSignals, tick_signals
from onboard.estimation.errors import ConvergenceError
from onboard.ground.log.rescue.fit_clocks import RecordedPair, coarse_clocks, rescue
from onboard.identification.free_flyer.batch import FreeBase, MotionFit, PayloadFit
from onboard.identification.free_flyer.prediction.imu_errors import ImuPrior
from onboard.timebase.resync import ResyncError

Floats = NDArray[np.float64]

DURATION_S, ENCODERS_S = 20.0, 16.0
RATE_LIMIT = 0.02
PAYLOAD_KG = 5


class ResyncFlight(NamedTuple):
    """One flight."""

    why: str  # it could not be rescued; empty where it was
    offset_s: float  # worst error over the flight
    rate: float
    sigmas: float  # error of the offset in the middle, over what was stated
    rescued: Floats  # (3,) errors of mass (relative), centre of mass (m), inertia (relative, norm)
    synchronised: Floats  # (3,)


def _error(found: PayloadFit, truth: free_flyer.Body) -> Floats:
    body = found.payload.body
    return np.array(
        [
            abs(body.mass_kg / truth.mass_kg - 1.0),
            np.linalg.norm(body.centre_of_mass_m - truth.centre_of_mass_m),
            np.linalg.norm(body.inertia_kg_m2 - truth.inertia_kg_m2) / np.linalg.norm(truth.inertia_kg_m2),
        ]
    )


def fly(seed: int) -> ResyncFlight:
    """One parabola, both ways."""
    rng, model, body = np.random.default_rng(seed), vehicle(), BOXES[PAYLOAD_KG]

    def build(signals: FlightSignals, imu_prior: ImuPrior) -> MotionFit:
        return MotionFit(FreeBase(model, signals), "imu_base", PAYLOAD_SIGMA, {}, imu_prior)

    motion = free_flyer.JointMotion.draw(rng)
    flight = free_flyer.fly(free_flyer.world(body), motion, rng.uniform(-0.05, 0.05, 3), DURATION_S)
    imu = sample(flight, ERRORS, rng)
    rate, first_s = rng.uniform(-RATE_LIMIT, RATE_LIMIT), rng.uniform(0.3, DURATION_S - ENCODERS_S - 0.3)
    own_s = 2e-3 * np.arange(float(int(ENCODERS_S / (2e-3 * (1.0 + rate)))))
    true_s = first_s + (1.0 + rate) * own_s
    count = 2.0 * np.pi / COUNTS_PER_TURN
    angle = (np.floor(motion.at(true_s)[0] / count) + 0.5) * count
    sigma = imu.rate_sigma_rad_s, imu.specific_force_sigma_m_s2
    recorded = RecordedPair(imu.time_s, imu.rate_rad_s, imu.specific_force_m_s2, sigma, own_s, angle)
    shared = (imu.time_s >= true_s[0]) & (imu.time_s <= true_s[-1])
    of_joints = imu.time_s[shared], imu.angle_rad[shared]
    of_base = imu.rate_rad_s[shared], imu.specific_force_m_s2[shared]
    synchronised = build(tick_signals(*of_joints, *of_base, sigma, 5, 0.1), IMU_PRIOR).fit()
    try:
        found = rescue(recorded, coarse_clocks(model, recorded, RATE_LIMIT), build, IMU_PRIOR)
    except (ResyncError, ConvergenceError) as error:
        return ResyncFlight(str(error), np.nan, np.nan, np.nan, np.full(3, np.nan), _error(synchronised, body))
    off_s = found.clock.reference_s(own_s) - true_s
    slope = (off_s[-1] - off_s[0]) / (true_s[-1] - true_s[0])
    middle = float(off_s[len(off_s) // 2]) / np.hypot(found.clock.sigma_offset_s, ERRORS.delay_s)
    return ResyncFlight("", np.abs(off_s).max(), slope, middle, _error(found.found, body), _error(synchronised, body))


def main() -> None:
    """Print the figures beside their bars."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    with ProcessPoolExecutor(arguments.jobs) as pool:
        flown = list(pool.map(fly, range(1, arguments.seeds + 1)))
    for seed, one in enumerate(flown, 1):
        if one.why:
            print(f"seed {seed}: {one.why}")
    offset_ms, rate_ppm = (np.array([getattr(one, name) for one in flown]) for name in ("offset_s", "rate"))
    offset_ms, rate_ppm = 1e3 * offset_ms, 1e6 * np.abs(rate_ppm)
    good = 100.0 * np.mean((offset_ms <= 1.0) & (rate_ppm <= 50.0))
    print(f"{len(flown)} parabolas: offset within 1 ms and rate within 50 ppm in {good:.0f} % (bar 95 %)")
    for name, values in (("worst offset, ms", offset_ms), ("rate, ppm", rate_ppm)):
        told = ", ".join(
            f"{label} {value:.3f}"
            for label, value in zip(("median", "p95", "most"), np.nanpercentile(values, (50, 95, 100)), strict=True)
        )
        print(f"  {name}: {told}")
    spread = np.sqrt(np.nanmean(np.square([one.sigmas for one in flown])))
    print(f"  rms error of the offset in stated sigmas, the IMU's own delay included: {spread:.2f}")
    rescued, synchronised = (np.array([getattr(one, name) for one in flown]) for name in ("rescued", "synchronised"))
    both = np.isfinite(rescued[:, 0])
    units = (("mass, %", 100.0), ("centre of mass, mm", 1e3), ("inertia, %", 100.0))
    for column, (name, factor) in enumerate(units):
        mine, theirs = (factor * np.sqrt(np.mean(part[both, column] ** 2)) for part in (rescued, synchronised))
        print(f"  {name}: rms {mine:.4f} rescued, {theirs:.4f} synchronised, ratio {mine / theirs:.2f} (bar 1.5)")


if __name__ == "__main__":
    main()
