"""The filter on a free-flyer's flights, beside the maximum likelihood.

Both are shown against the same Cramer-Rao bound.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.identification import free_flyer as case
from onboard.dynamics.model.payload import BodyEstimate
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.ticks import FlightSignals
from onboard.estimation.errors import ConvergenceError
from onboard.ground.campaign.results import FlightResult
from onboard.identification.free_flyer.batch import FreeBase, MotionFit
from onboard.identification.free_flyer.prediction.imu_errors import ImuPrior
from onboard.identification.free_flyer.prediction.imu_prediction import ImuPredictor
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS, Ticks
from onboard.identification.free_flyer.recursion.recursive import MotionFilter

Floats = NDArray[np.float64]


class Inputs(NamedTuple):
    """What a method may take of a flight."""

    motion_fit: MotionFit
    online: MotionFilter
    ticks: Ticks


def ticks_of(signals: FlightSignals, first_s: float = 0.0) -> Ticks:
    """The flight as the recursive estimator takes it in."""
    n = len(signals.q)
    sigma = np.tile(np.concatenate([signals.rate_sigma, signals.specific_force_sigma]), (n, 1))
    measured = np.concatenate([signals.rate, signals.specific_force], axis=1)
    times = np.asarray(first_s + signals.period_s * np.arange(n), np.float64)
    exact = *np.zeros((2, n, 2, signals.q.shape[1])), np.zeros((n, 3, 0)), np.zeros((n, 0)), np.ones(n)
    return Ticks(times, signals.q, signals.dq, signals.ddq, measured, sigma, *exact)


def estimator(
    model: VehicleModel, signals: FlightSignals, covariance: dict[str, Floats], imu_prior: ImuPrior, held: bool
) -> MotionFilter:
    """One that knows nothing yet."""
    predictor = ImuPredictor(model, "imu_base", signals.period_s, signals.samples, covariance, imu_prior)
    return MotionFilter(predictor, case.PAYLOAD_SIGMA, held)


def likelihood(told: Inputs) -> BodyEstimate:
    """The maximum likelihood of the whole flight."""
    return told.motion_fit.fit().payload


def recursive(told: Inputs) -> BodyEstimate | None:
    """The estimator as it flies."""
    for first in range(0, len(told.ticks.time_s), BATCH_TICKS):
        told.online.update(told.ticks.part(slice(first, first + BATCH_TICKS)))
    told.online.finish()
    return told.online.estimate()


METHODS: dict[str, Callable[[Inputs], BodyEstimate | None]] = {"maximum likelihood": likelihood, "recursive": recursive}


def flight(seed: int, settings: dict[str, Any]) -> FlightResult:
    """One flight of ``bench/plans/noise.toml`` or ``recursive.toml``.

    Args:
        seed: of everything drawn.
        settings: ``payload``: kg, of ``BOXES``, or ``tool``: one of the workshop's, scaled; ``method``, of ``METHODS``;
            ``real``: with all that is wrong in real life, not noise alone.
    """
    real = bool(settings.get("real", False))
    body = case.grown_tool(seed) if settings["payload"] == "tool" else case.BOXES[settings["payload"]]
    recorded, model = case.record(body, real, seed), case.vehicle()
    signals, known = recorded.signals, case.priors(model, real)
    motion_fit = MotionFit(FreeBase(model, signals), "imu_base", case.PAYLOAD_SIGMA, *known)
    told = Inputs(motion_fit, estimator(model, signals, *known, held=True), ticks_of(signals))
    try:
        found = METHODS[settings["method"]](told)
    except ConvergenceError:
        found = None
    changes = ("change",) * len(told.online.changes)
    return FlightResult(case.answers(body, found, case.bound(motion_fit, model, recorded, body)), events=changes)
