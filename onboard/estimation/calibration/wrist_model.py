"""What a wrist force-torque sensor reads of a tool in static poses, and how that depends on the unknowns.

The model and its symbols stand at the head of :mod:`onboard.estimation.calibration.wrist`, which fits it.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray, hat
from onboard.estimation.calibration.rotations import rotation_vector, turn

FIRST_MOMENT, MOUNTING, TILT, SCALES, CROSS = slice(1, 4), slice(4, 7), slice(7, 9), slice(9, 15), slice(15, 45)
UNKNOWNS = 45  # the mass is the first
_OFF = np.array([1, 2, 3, 5, 6, 7])  # elements of X that are not on its diagonal
_AXES = np.arange(6)
_EYE, _AS_IS = np.eye(3), np.eye(6)
_HATS = hat(_EYE)  # of the axes
REACH_m = 0.05  # moment over force at a transducer's limits: 0.03 to 0.1 m of those that arms carry
# Of scales and cross-talk, (36,): the reading, what of (m d, p x d) is taken, and times what.
_READING = np.concatenate([_AXES, _OFF // 3, 3 + _OFF // 3, np.repeat(_AXES, 3)])
_TAKEN = np.concatenate([_AXES, _OFF % 3, 3 + _OFF % 3, np.tile([3, 4, 5], 3), np.tile([0, 1, 2], 3)])
_TIMES = np.repeat([1.0, 1.0 / REACH_m, REACH_m], [18, 9, 9])
_ORDER = np.argsort(6 * _READING + _TAKEN).reshape(6, 6)  # by row and column of all that is taken
_WAYS = np.zeros((UNKNOWNS, 6, 3, 4))  # of scales and cross-talk: what they do with d, by mass and first moment
_WAYS[np.arange(SCALES.start, UNKNOWNS), _READING] = (
    np.concatenate([np.multiply.outer(_EYE, [1.0, 0.0, 0.0, 0.0]), np.insert(_HATS.transpose(1, 2, 0), 0, 0.0, axis=2)])
)[_TAKEN] * _TIMES[:, None, None]
_BY_BODY = _WAYS.reshape(-1, 4)
_LEVEL = [np.delete(np.eye(3), axis, axis=1) for axis in range(3)]


class Priors(NamedTuple):
    """What is known before.

    Attributes:
        gravity_m_s2: (3,) in base axes.
        scale: 1 sigma of an axis' scale, relative.
        tilt_rad: 1 sigma of the base's tilt about each horizontal axis.
        mounting_rad: 1 sigma of the sensor's mounting about each axis.
    """

    gravity_m_s2: FloatArray
    scale: float
    tilt_rad: float
    mounting_rad: float
    spreads: tuple[float, ...] = (1.0,) * 6  # of the axes' scales, over ``scale``


class Linearisation(NamedTuple):
    """Where the model is linearised."""

    mass: float
    first_moment: FloatArray  # (3,)
    mounting: FloatArray  # (3, 3) M
    tilt: FloatArray  # (2,) rad, about the base's axes that are not gravity's
    scales: FloatArray  # (6,)
    cross: FloatArray  # (30,) X of forces and of moments without their diagonals, X' of forces and of moments

    @property
    def levers(self) -> tuple[FloatArray, FloatArray]:
        """Readings by m d and by p x d, (6, 3) each: 1 + S + X, and X' with L."""
        both = _AS_IS + (np.concatenate([self.scales, self.cross]) * _TIMES).take(_ORDER)
        return both[:, :3], both[:, 3:]

    @property
    def sensitivity(self) -> FloatArray:
        """Readings by gravity in sensor axes, (6, 3)."""
        of_weight, of_moment = self.levers
        return self.mass * of_weight + of_moment @ hat(self.first_moment)


def predicted(R: FloatArray, state: Linearisation, prior: Priors) -> FloatArray:
    """Readings without zeros, (n, 6)."""
    return np.asarray(_in_frame(R, state, prior) @ (state.sensitivity @ state.mounting).T, np.float64)


def jacobian(R: FloatArray, state: Linearisation, prior: Priors) -> FloatArray:
    """Of the readings by the unknowns, (n, 6, 45); mounting and tilt by small turns."""
    by = linearised(state, prior)[1].transpose(1, 0, 2) @ elements(R).T  # (6, 45, n)
    return np.asarray(np.moveaxis(by, -1, 0), np.float64)


def linearised(state: Linearisation, prior: Priors) -> tuple[FloatArray, FloatArray]:
    """:func:`predicted` and :func:`jacobian` by the elements of R', of which both are linear: (6, 9), (45, 6, 9)."""
    level = _level(prior.gravity_m_s2)
    down = _tilted(state, level) @ prior.gravity_m_s2
    d = (state.mounting[:, :, None] * down).reshape(3, 9)  # gravity in sensor axes
    (of_weight, of_moment), p = state.levers, hat(state.first_moment)
    A = state.mass * of_weight + of_moment @ p
    by = (_BY_BODY @ [state.mass, *state.first_moment.tolist()]).reshape(UNKNOWNS, 6, 3)  # by d
    by[0] = of_weight
    np.matmul(of_moment, _HATS, out=by[FIRST_MOMENT])  # p x d = -d x p
    np.matmul(A, _HATS, out=by[MOUNTING])
    J = (by.reshape(-1, 3) @ d).reshape(UNKNOWNS, 6, 9)
    tilts = -(A @ state.mounting)[:, :, None] * (hat(down) @ level).T[:, None, None]  # (2, 6, 3, 3)
    J[TILT] = tilts.reshape(2, 6, 9)
    return A @ d, J


def elements(R: FloatArray) -> FloatArray:
    """Of R', row by row, (n, 9)."""
    return R.transpose(0, 2, 1).reshape(-1, 9)


def _in_frame(R: FloatArray, state: Linearisation, prior: Priors) -> FloatArray:
    """Gravity in the axes of the frame whose pose is given, (n, 3)."""
    down = _tilted(state, _level(prior.gravity_m_s2)) @ prior.gravity_m_s2
    return np.asarray(R.transpose(0, 2, 1) @ down, np.float64)


def _tilted(state: Linearisation, level: FloatArray) -> FloatArray:
    """The turn of the base by its tilt about two axes (3, 2), (3, 3)."""
    return turn(level @ state.tilt)


def _level(gravity: FloatArray) -> FloatArray:
    """The two axes that a base tilts about, (3, 2): not the one nearest to gravity."""
    return _LEVEL[int(np.abs(gravity).argmax())]


def values_of(state: Linearisation) -> FloatArray:
    """The unknowns, (45,); of the mounting the rotation vector."""
    mounting = rotation_vector(state.mounting)
    return np.concatenate([[state.mass], state.first_moment, mounting, state.tilt, state.scales, state.cross])


def moved(state: Linearisation, step: FloatArray) -> Linearisation:
    """A state after a step of the unknowns, (45,)."""
    M = turn(step[MOUNTING]) @ state.mounting
    own = state.first_moment + step[FIRST_MOMENT], M, state.tilt + step[TILT], state.scales + step[SCALES]
    return Linearisation(float(state.mass + step[0]), *own, state.cross + step[CROSS])
