"""The bound of a planned motion, by the vehicle's method and base."""

import numpy as np

from onboard import config
from onboard.ground.before.foresee.free import foresee_free
from onboard.ground.before.foresee.pivot import foresee_pivot
from onboard.ground.before.foresee.plan import Expected, Foreseen, MotionPlan
from onboard.ground.before.foresee.rows import foresee_rows
from onboard.identification.standing import LEVELS

_MOST_TICKS = 100_000  # of all motions of the base


def foresee(vehicle: config.Vehicle, plan: MotionPlan, *, coarse: bool = False) -> Foreseen:
    """What a vehicle can determine with a planned motion.

    Args:
        vehicle: its file.
        plan: the motion, at the estimator's ticks.
        coarse: the ticks are fewer than the estimator's, and stand for as many as it has.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
        SignalError: a motion with which nothing can be predicted.
        EstimationError: something that nothing tells.
    """
    if vehicle.prediction is config.Prediction.PLANAR:
        from onboard.ground.before.foresee.table import foresee_table  # noqa: PLC0415 - it brings in heft identify

        return foresee_table(vehicle, plan)
    if vehicle.prediction is not config.Prediction.ROWS:
        return (foresee_pivot if vehicle.prediction is config.Prediction.PIVOT else foresee_free)(vehicle, plan)
    most = max(1, _MOST_TICKS // len(plan.time_s))  # of a long motion each is as telling as the next
    return _over(foresee_rows(vehicle, plan.by_base()[:most], coarse=coarse))


def _over(found: list[Foreseen]) -> Foreseen:
    """Of several motions of the base that are all as likely: sigmas are rms of theirs, so that errors over them are."""
    first = found[0]
    if len(found) == 1:
        return first
    quantities, parameters = (
        tuple(_rms(of) for of in zip(*each, strict=True))
        for each in ([one.quantities for one in found], [one.parameters for one in found])
    )
    return first._replace(quantities=quantities, parameters=parameters)


def _rms(of: tuple[Expected, ...]) -> Expected:
    """One quantity over all motions; weak where most leave it weak."""
    sigmas = np.array([one.sigma for one in of])
    told = sigmas[np.isfinite(sigmas)]
    by_level = sorted(of, key=lambda one: LEVELS.index(one.level))
    middle = by_level[len(of) // 2]
    return of[0]._replace(
        sigma=float(np.sqrt(np.mean(told**2))) if told.size else np.nan, level=middle.level, why=middle.why
    )
