"""A free-floating base: motion from the joints and the initial angular momentum."""

from collections.abc import Mapping

import numpy as np

from onboard.dynamics.free_flight import BasePrediction, predict_base
from onboard.dynamics.kinematics import first_ticks, link_motions
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.ticks import FlightSignals
from onboard.estimation.arrays import FloatArray
from onboard.estimation.maximum_likelihood import ITERATIONS
from onboard.identification.free_flyer.batch import MotionFit, Schedule, checked
from onboard.identification.free_flyer.guesses import FIRST_TICKS, ROUGH_WIDTH_s
from onboard.identification.free_flyer.prediction.imu_errors import CERTAIN, ImuPrior
from onboard.identification.free_flyer.prediction.parameters import Unknowns
from onboard.regressor.free_rows import rough_payload


class FreeBase:
    """:class:`onboard.identification.free_flyer.batch.BaseModel` without an external wrench.

    Args:
        vehicle: with a payload link.
        signals: the flight.

    Raises:
        SignalError: shapes that do not fit, or joints that are not finite.
    """

    def __init__(self, vehicle: VehicleModel, signals: FlightSignals) -> None:
        self.vehicle, self.signals = vehicle, checked(signals)
        self._motions = link_motions(vehicle, signals.q, signals.dq, signals.ddq)
        self.start = Unknowns(tuple(f"momentum_{axis}" for axis in "xyz"), np.full(3, np.nan))
        self.others: Mapping[str, Unknowns] = {}
        self.of_a_run: tuple[str, ...] = ()
        self.schedule = Schedule(len(signals.q) // 8, ITERATIONS)

    def predict(
        self, start: FloatArray, chi: FloatArray, others: Mapping[str, FloatArray], links: tuple[int, ...], ticks: int
    ) -> BasePrediction:
        """See :func:`onboard.dynamics.free_flight.predict_base`."""
        return predict_base(first_ticks(self._motions, ticks), self.signals.period_s, chi, start, links)

    def first_state(self, chi: FloatArray, rate_B: FloatArray) -> FloatArray:
        """Momentum from the first gyro readings, to which the rate is affine.

        Raises:
            SignalError: no tick among the first has an IMU.
        """
        base = self.predict(np.zeros(3), chi, {}, (), FIRST_TICKS)
        gap = rate_B[:FIRST_TICKS] - base.rate
        seen = np.isfinite(gap).all(axis=1)
        if not seen.any():
            raise SignalError(f"none of the first {FIRST_TICKS} ticks has an IMU; begin the flight where it has")
        return np.asarray(np.linalg.lstsq(base.d_rate[seen, :, :3].reshape(-1, 3), gap[seen].ravel())[0], np.float64)

    def rough_payload(self, imu_frame: str, payload_sigma: FloatArray) -> RigidBody:
        """See :func:`onboard.regressor.free_rows.rough_payload`."""
        return rough_payload(self.vehicle, imu_frame, self.signals, ROUGH_WIDTH_s, payload_sigma)


def free_fit(
    vehicle: VehicleModel,
    imu_frame: str,
    signals: FlightSignals,
    payload_sigma: FloatArray,
    link_covariance: Mapping[str, FloatArray],
    imu_prior: ImuPrior = CERTAIN,
) -> MotionFit:
    """The fit of a free flight; arguments and errors as :class:`FreeBase` and :class:`MotionFit` have them."""
    return MotionFit(FreeBase(vehicle, signals), imu_frame, payload_sigma, link_covariance, imu_prior)
