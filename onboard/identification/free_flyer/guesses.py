"""Initial guesses: of the payload, tried in order until one leads to a good fit; of the state at the first tick."""

import contextlib
from collections.abc import Callable, Iterator

import numpy as np

from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import RigidBody, sphere_radius_m
from onboard.estimation.arrays import FloatArray, finite
from onboard.estimation.errors import ConvergenceError
from onboard.identification.free_flyer.prediction.imu_prediction import RATE, ImuPredictor
from onboard.identification.free_flyer.prediction.ticks import Ticks

ROUGH_WIDTH_s = 0.3  # of the kernel that smooths the base's motion for a least squares on rows
WIDEST_s = 0.8  # of a kernel: 3 dB at 2.75 Hz, four times the fastest sweep of an arm, 0.6 Hz
FIRST_TICKS = 10  # for the initial rate
_POSE_TICKS = 100  # for the first pose


def _ball(mass_kg: float) -> RigidBody:
    """A homogeneous sphere that touches the payload frame's origin."""
    radius_m = sphere_radius_m(mass_kg)
    return RigidBody(mass_kg, np.array([0.0, 0.0, radius_m]), 0.4 * mass_kg * radius_m**2 * np.eye(3))


GUESSES = tuple(_ball(mass_kg) for mass_kg in (3.0, 0.5, 15.0))


def guesses(rough: Callable[[], RigidBody]) -> Iterator[RigidBody]:
    """A least squares on rows, and three spheres (chosen here).

    Args:
        rough: the least squares; skipped if its result is not a body.
    """
    with contextlib.suppress(SignalError, ConvergenceError):
        yield rough()
    yield from GUESSES


def first_state(predictor: ImuPredictor, ticks: Ticks, state: FloatArray, imu: int = 0) -> FloatArray | None:
    """A state, (p,), with the rate and the pose at the first tick by the first readings; None if it predicts no number.

    Args:
        predictor: of the instruments.
        ticks: in succession, :data:`FIRST_TICKS` + 2 of them at least.
        state: (p,).
        imu: whose readings.
    """
    state = state.copy()
    try:
        state[RATE] = first_rate(predictor, ticks, state, imu)
        state[predictor.moving] = first_pose(predictor, ticks, state)
    except np.linalg.LinAlgError:
        return None
    return state


def first_rate(predictor: ImuPredictor, ticks: Ticks, state: FloatArray, imu: int = 0) -> FloatArray:
    """Rate of the base at the first tick, (3,), by least squares on the first gyro readings, with all else of a state.

    Args:
        predictor: of the IMU.
        ticks: in succession, :data:`FIRST_TICKS` + 2 of them at least.
        state: (p,).
        imu: whose readings.
    """
    rate = slice(predictor.lines[imu].start, predictor.lines[imu].start + 3)
    state, some = state.copy(), ticks.part(slice(0, FIRST_TICKS + 2))
    seen = np.isfinite(some.measured[1:-1, rate]).all(axis=1)
    if not seen.any():
        return np.zeros(3)
    state[RATE] = predictor.imus[imu].R_BS @ some.measured[1:-1, rate][seen].mean(axis=0)
    predicted = predictor.predict(some.q, some.dq, some.ddq, state, some.cyclic, some.thrust)
    gap = some.measured[1:-1, rate] - predicted.values[:, rate]
    J = predicted.jacobian[seen, rate, RATE].reshape(-1, 3)
    return np.asarray(state[RATE] + _solved(J, gap[seen].ravel()), np.float64)


def first_pose(predictor: ImuPredictor, ticks: Ticks, state: FloatArray) -> FloatArray:
    """Attitude of the base, place and velocity of the centre of mass at the first tick, by least squares; (moving,).

    Args:
        predictor: of the tracker.
        ticks: in succession.
        state: (p,) all else, the rate included.
    """
    at, state = predictor.moving, state.copy()
    if not at.size:
        return state[at]
    some = ticks.part(slice(0, _POSE_TICKS + 2))
    lines = predictor.lines[-1]
    seen = np.isfinite(some.measured[1:-1, lines]).all(axis=1)
    state[at] = 0.0
    for _ in range(3 if seen.any() else 0):  # the attitude is linear, the place is once that is known
        predicted = predictor.predict(some.q, some.dq, some.ddq, state, some.cyclic, some.thrust)
        gap = (some.measured[1:-1, lines] - predicted.values[:, lines])[seen] / some.sigma[1:-1, lines][seen]
        J = predicted.jacobian[:, lines][seen][..., at] / some.sigma[1:-1, lines][seen][..., None]
        J = np.vstack([J.reshape(gap.size, -1), np.diag(1.0 / predictor.sigma[at])])
        state[at] += _solved(J, np.concatenate([gap.ravel(), -state[at] / predictor.sigma[at]]))
    return state[at]


def _solved(J: FloatArray, gap: FloatArray) -> FloatArray:
    """Least squares.

    Raises:
        LinAlgError: a number is not finite; of it LAPACK writes to the terminal.
    """
    if not finite([J, gap]).all():
        raise np.linalg.LinAlgError("the motion predicts no number")
    return np.asarray(np.linalg.lstsq(J, gap)[0], np.float64)
