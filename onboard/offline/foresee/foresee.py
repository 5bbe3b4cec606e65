"""The bound of a planned motion, by the vehicle's method and base."""

from onboard import config
from onboard.offline.foresee.free import foresee_free
from onboard.offline.foresee.plan import Foreseen, Plan
from onboard.offline.foresee.planar import foresee_planar
from onboard.offline.foresee.rows import foresee_rows


def foresee(vehicle: config.Vehicle, plan: Plan, *, coarse: bool = False) -> Foreseen:
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
    if vehicle.file.planar is not None:
        return foresee_planar(vehicle, plan)
    if vehicle.file.estimation.method == "exiddm":
        return foresee_free(vehicle, plan)
    return foresee_rows(vehicle, plan, coarse=coarse)
