"""A base on an air-bearing table: its motion from joints, initial velocity, drag and tilt, and what is known of these.

Drag depends on velocity, which is not measured but predicted (:mod:`onboard.dynamics.air_bearing`).
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from onboard.dynamics.air_bearing import SAGS, PlanarDrag, PlanarRun, predict_run
from onboard.dynamics.free_flight import BasePrediction
from onboard.dynamics.joint_errors import EncoderReadings
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import possible_body
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.spatial import times
from onboard.dynamics.ticks import FlightSignals
from onboard.estimation.arrays import FloatArray
from onboard.identification.free_flyer.batch import Schedule, checked
from onboard.identification.free_flyer.guesses import ROUGH_WIDTH_s
from onboard.identification.free_flyer.prediction.imu_errors import CERTAIN, ImuPrior
from onboard.identification.free_flyer.prediction.parameters import EXACT_GEOMETRY, GeometryPrior, Unknowns
from onboard.identification.windows import STAGES_s
from onboard.regressor.free_rows import measured_base

PATIENT = 200  # iterations at the end: velocity and drag form a curved valley
NO_MULTIPLES: FloatArray = np.zeros(0)


class DragPrior(NamedTuple):
    """Standard deviations of a puck's drag coefficients about zero."""

    viscous_N_s_m: float  # noqa: N815
    coulomb_N: float  # noqa: N815


class AirBearingPrior(NamedTuple):
    """Standard deviations of the unknowns of a run besides payload and links."""

    velocity_m_s: float  # at the start, of each axis
    rate_rad_s: float
    pucks: Mapping[str, DragPrior]  # by frame, fixed in the base
    tilt_m_s2: float  # gravity along the table
    sag: float = 0.0  # logarithm of what all drags change by over the run
    imu: ImuPrior = CERTAIN
    geometry: GeometryPrior = EXACT_GEOMETRY  # its joints


class AirBearingBase:
    """:class:`onboard.identification.free_flyer.batch.BaseModel` of a base on air-bearing pucks.

    Args:
        vehicle: on an air-bearing table, with a payload link.
        signals: the run.
        prior: sigmas of the further unknowns.
        offsets: of each joint from its place in the drawing, (joints, 3), m, in the axes of its frame at zero.

    Raises:
        SignalError: another kind of base, shapes that do not fit, or joints that are not finite.
        UnknownFrameError: a puck that the URDF does not have.
    """

    def __init__(
        self, vehicle: VehicleModel, signals: FlightSignals, prior: AirBearingPrior, offsets: FloatArray | None = None
    ) -> None:
        if vehicle.spec.base is not BaseKind.PLANAR:
            raise SignalError(f"the base is {vehicle.spec.base}; one on an air-bearing table is needed")
        self.vehicle, self.signals, self.prior = vehicle, checked(signals), prior
        self._run = PlanarRun(vehicle, signals, offsets)
        self._pucks = np.array([vehicle.pose_in_base(frame)[1][:2] for frame in prior.pucks]).reshape(-1, 2)
        state = np.array([prior.velocity_m_s, prior.velocity_m_s, prior.rate_rad_s])
        self.start = Unknowns(("velocity_x", "velocity_y", "rate_z"), state)
        drags = tuple(f"{kind}_{frame}" for frame in prior.pucks for kind in ("Fv", "Fc"))
        self.others: Mapping[str, Unknowns] = {
            "drag": Unknowns(drags, np.array([sigma for puck in prior.pucks.values() for sigma in puck])),
            "sag": Unknowns(tuple(f"sag_{degree}" for degree in range(1, SAGS + 1)), np.full(SAGS, prior.sag)),
            "tilt": Unknowns(("tilt_x", "tilt_y"), np.full(2, prior.tilt_m_s2)),
        }
        # tilt: along the base's axes at the first tick; what the supply does in one half it does not in the other
        self.of_a_run: tuple[str, ...] = ("tilt", *(("drag", "sag") if prior.sag else ()))
        early = min(len(signals.q), round(STAGES_s[0] / signals.period_s))
        self.schedule = Schedule(early, PATIENT)

    def predict(
        self, start: FloatArray, chi: FloatArray, others: Mapping[str, FloatArray], links: tuple[int, ...], ticks: int
    ) -> BasePrediction:
        """See :func:`onboard.dynamics.air_bearing.predict_run`."""
        viscous, coulomb = others["drag"].reshape(-1, 2).T
        drag = PlanarDrag(self._pucks, viscous, coulomb, tuple(others["sag"].tolist()))
        return predict_run(self._run, start, chi, drag, others["tilt"], links, ticks).base

    def first_state(self, chi: FloatArray, rate_B: FloatArray) -> None:
        """None: the gyro gives no velocity."""

    def coarser(self, ticks: int) -> "AirBearingBase":
        """The same run by means of so many ticks."""
        return AirBearingBase(self.vehicle, self.signals.coarser(ticks), self.prior)

    def with_errors(self, errors: FloatArray, since: int = 0, multiples: FloatArray = NO_MULTIPLES) -> "AirBearingBase":
        """The same run if the joints had these errors, (joints, 6), in the order of :data:`JOINT_ERRORS`.

        Args:
            errors: that are taken out.
            since: the tick from which on the encoders have theirs; places are of all ticks.
            multiples: of the functions of cyclic errors that these are, (m,).
        """
        signals, of = self.signals, np.array(self.prior.geometry.cyclic_joints(self.vehicle), np.intp)
        cyclic = np.zeros((len(signals.q), 3, len(of))) if signals.cyclic is None else signals.cyclic
        read = EncoderReadings(signals.q, signals.dq, signals.ddq, signals.period_s, cyclic)
        motions = zip((signals.q, signals.dq, signals.ddq), read.corrected(errors, multiples, of), strict=False)
        q, dq, ddq = (np.concatenate([before[:since], after[since:]]) for before, after in motions)
        return AirBearingBase(self.vehicle, signals._replace(q=q, dq=dq, ddq=ddq), self.prior, errors[:, :3])

    def rough_payload(self, imu_frame: str, payload_sigma: FloatArray) -> RigidBody:
        """Payload by plain least squares on rows without drag: a biased initial guess.

        Raises:
            SignalError: a mass that is not positive, or ticks that are too long.
        """
        Y, y = table_rows(self.vehicle, imu_frame, self.signals, self._run, ROUGH_WIDTH_s)
        if not y.size:
            raise SignalError("the ticks are too long for a kernel that smooths the base's motion")
        mean, noise = np.zeros(10), 1.0
        for _ in range(3):
            information = Y.T @ Y / noise + np.diag(1.0 / payload_sigma**2)
            covariance = np.asarray(np.linalg.inv(information), np.float64)
            mean = covariance @ (Y.T @ y) / noise
            noise = float(np.mean((y - Y @ mean) ** 2))
        return possible_body(mean, covariance)


def table_rows(
    vehicle: VehicleModel, imu_frame: str, signals: FlightSignals, run: PlanarRun, width_s: float
) -> tuple[FloatArray, FloatArray]:
    """Rows ``y = Y chi_payload`` of force x, y and moment z without drag: Y (3 v, 10), y (3 v,).

    The equation of :mod:`onboard.dynamics.air_bearing` with d = 0, at the measured motion.

    Args:
        vehicle: with a payload link.
        imu_frame: the IMU's frame.
        signals: the run.
        run: its joints.
        width_s: of the kernel that smooths the base's motion.
    """
    base = measured_base(vehicle, imu_frame, signals, width_s)
    whole = np.isfinite(base.specific_force).all(axis=1) & np.isfinite(base.acceleration).all(axis=1)
    w = base.rate[whole, 2]
    basis = np.column_stack([base.specific_force[whole, :2], base.acceleration[whole, 2], np.ones(len(w)), w, w * w])
    own, chi = vehicle.payload_columns(), vehicle.chi.copy()
    chi[own] = 0.0
    Y = np.einsum("mijp,mj->mip", run.columns((own.start // 10,))[::2][whole], basis)
    return Y.reshape(-1, 10), -times(run.wrench(chi, ())[::2][whole], basis).ravel()
