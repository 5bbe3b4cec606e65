"""The recursive non-linear ExIDDM on the flights of the cases ``noise`` and ``real``, beside the maximum likelihood.

Both are shown against the same Cramer-Rao bound; on the flights of ``noise`` so is the UKF of filterpy,
which goes on from the same windows with the same prediction. The time of a tick is the median over batches, from joints
and IMU means to updated estimate and covariance; the windows solved at the beginning are given apart.
"""

import argparse
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray

from bench.identification import free_flyer as case
from hil_sim.plants import free_flyer
from onboard.dynamics.inertia import RigidBody
from onboard.dynamics.payload import BodyEstimate, body_estimate
from onboard.dynamics.ticks import FlightSignals
from onboard.dynamics.vehicle import VehicleModel
from onboard.identification.exiddm.bounded_work import BATCH_TICKS
from onboard.identification.exiddm.free_base import free_exiddm
from onboard.identification.exiddm.imu_errors import ImuPrior
from onboard.identification.exiddm.imu_prediction import ImuPredictor
from onboard.identification.exiddm.recursive import RecursiveExiddm, SOLVED_AT_s
from onboard.identification.exiddm.ticks import Ticks

Floats = NDArray[np.float64]


UNSCENTED_FROM = round(SOLVED_AT_s[-1] * 500.0 / case.SAMPLES_PER_TICK)  # ticks: the windows are solved


class Flown(NamedTuple):
    """One flight's answers and times."""

    likelihood: case.Outcome
    recursive: case.Outcome
    unscented: case.Outcome | None
    tick_s: float  # median
    unscented_tick_s: float
    windows_s: tuple[float, ...]
    parameters: int
    changes: int


def ticks_of(signals: FlightSignals, first_s: float = 0.0) -> Ticks:
    """The flight as the recursive estimator takes it in."""
    n = len(signals.q)
    sigma = np.tile(np.concatenate([signals.rate_sigma, signals.specific_force_sigma]), (n, 1))
    measured = np.concatenate([signals.rate, signals.specific_force], axis=1)
    times = np.asarray(first_s + signals.period_s * np.arange(n), np.float64)
    exact = np.zeros((n, 2, signals.q.shape[1])), np.zeros((n, 3, 0))
    return Ticks(times, signals.q, signals.dq, signals.ddq, measured, sigma, *exact)


def estimator(
    model: VehicleModel, signals: FlightSignals, covariance: dict[str, Floats], imu_prior: ImuPrior, held: bool
) -> RecursiveExiddm:
    """One that knows nothing yet."""
    predictor = ImuPredictor(model, "imu_base", signals.period_s, signals.samples, covariance, imu_prior)
    return RecursiveExiddm(predictor, case.PAYLOAD_SIGMA, held)


def unscented(online: RecursiveExiddm, ticks: Ticks) -> tuple[BodyEstimate, float]:
    """The UKF of filterpy over the rest of a flight, from where ``online`` is, and its median time of a tick."""
    assert online.state is not None
    predictor, p = online.predictor, len(online.state)
    points = MerweScaledSigmaPoints(p, 1e-2, 2.0, 3.0 - p)
    width = 6 * BATCH_TICKS
    peer = UnscentedKalmanFilter(p, width, 1.0, lambda x: x, lambda x, dt: x, points)
    peer.x, peer.P, peer.Q, peer.R = online.state.copy(), online.covariance.copy(), np.zeros((p, p)), np.eye(width)
    times = []
    for first in range(0, len(ticks.time_s) - BATCH_TICKS - 1, BATCH_TICKS):
        begun = time.perf_counter()
        part = ticks.part(slice(first, first + BATCH_TICKS + 2))
        joints, sigma = (part.q, part.dq, part.ddq), part.sigma[1:-1]

        def shown(x: Floats, joints=joints, sigma=sigma) -> Floats:  # type: ignore[no-untyped-def]
            return np.asarray((predictor.predict(*joints, x).values / sigma).ravel(), np.float64)

        peer.predict()
        peer.update((part.measured[1:-1] / sigma).ravel(), hx=shown)
        peer.predict(fx=lambda x, dt, joints=joints: predictor.predict(*joints, x).state)
        times.append(time.perf_counter() - begun)
    return body_estimate(peer.x[3:13], peer.P[3:13, 3:13]), float(np.median(times)) / BATCH_TICKS


def fly(body: free_flyer.Body, real: bool, seed: int) -> Flown:
    """One flight through both."""
    recorded = case.record(body, real, seed)
    model = case.vehicle()
    known = case.priors(model, real)
    exiddm = free_exiddm(model, "imu_base", recorded.signals, case.PAYLOAD_SIGMA, *known)
    found = exiddm.fit()
    least = case.bound(exiddm, model, recorded, body)
    none = RigidBody(np.nan, np.full(3, np.nan), np.full((3, 3), np.nan))
    misfit = found.misfit
    online = estimator(model, recorded.signals, *known, held=True)
    ticks = ticks_of(recorded.signals)
    times = []
    peer: case.Outcome | None = None
    peer_tick_s = np.nan
    for first in range(0, len(ticks.time_s), BATCH_TICKS):
        if first == UNSCENTED_FROM and not real:
            online.finish()
            told, peer_tick_s = unscented(online, ticks.part(slice(first - 2, None)))
            peer = case.judged(body, told, least, np.nan, none)
        begun = time.perf_counter()
        online.update(ticks.part(slice(first, first + BATCH_TICKS)))
        times.append(time.perf_counter() - begun)
    online.finish()
    answer = online.estimate()
    if answer is None:
        answer = BodyEstimate(none, np.full((10, 10), np.nan))
    windows = sorted(times)[-3:]
    return Flown(
        case.judged(body, found.payload, least, misfit, none),
        case.judged(body, answer, least, np.nan, none),
        peer,
        float(np.median(times[50:])) / BATCH_TICKS,
        peer_tick_s,
        tuple(windows),
        len(online.predictor.names),
        len(online.changes),
    )


def _print(title: str, flown: Sequence[Flown], limits: Sequence[float] | None) -> None:
    case.print_table(f"{title}; maximum likelihood", [one.likelihood for one in flown], limits)
    case.print_table(f"{title}; recursive", [one.recursive for one in flown], limits)
    peers = [one.unscented for one in flown if one.unscented is not None]
    if peers:
        case.print_table(f"{title}; filterpy's UKF", peers, limits)
        print(f"a tick {1e6 * np.median([one.unscented_tick_s for one in flown]):.0f} us")
    tick_us = 1e6 * np.median([one.tick_s for one in flown])
    windows = 1e3 * np.median([one.windows_s for one in flown], axis=0)
    print(
        f"a tick {tick_us:.0f} us with {flown[0].parameters} parameters in batches of {BATCH_TICKS} (bar 100); windows "
        f"at the start {', '.join(f'{ms:.0f}' for ms in windows)} ms; {sum(one.changes for one in flown)} false alarms"
    )


def run(arguments: argparse.Namespace) -> None:
    """Both cases."""
    with ProcessPoolExecutor(arguments.jobs) as pool:
        body = case.BOXES[5]
        noise = list(pool.map(partial(fly, body, False), case.seeds(arguments)))
        bodies = case.grown_tools(arguments)
        real = list(pool.map(fly, bodies, [True] * len(bodies), case.seeds(arguments)))
    _print("noise only, 5 kg", noise, None)
    _print("real-life errors, workshop tools of 1 to 20 kg", real, (2.0, 5.0, 6.0))
