"""Motors: rotor inertia, viscous and Coulomb friction at the joints coupled to a motor.

A motor's rate is ``dq_m = sum_j r_j dq_j``; by virtual work its torque acts on joint j times ``r_j``, so that its
three columns are ``r_j [ddq_m, dq_m, z_m]`` in the row of joint j's torque (the wrist of the Staubli TX series, whose
last motor is coupled to the joint before it). Coulomb friction z_m is the sign of the rate, or
Dahl's: ``dz = dx / length (1 - z sign(dx))``, which reverses over a few lengths of motion.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.errors import UnknownFrameError
from onboard.estimation.arrays import FloatArray

COLUMNS = ("Ia", "Fv", "Fc")  # kg m^2, N m s/rad, N m
_SETTLED = 5.0  # lengths of motion after which Dahl's friction depends on its start by 0.7 % (exp(-5))


class Motor(NamedTuple):
    """A motor, its columns named ``Ia_<name>``, ``Fv_<name>``, ``Fc_<name>``."""

    name: str
    ratios: tuple[tuple[str, float], ...]  # joint, motor rate per joint rate; 1: motor quantities at the joint
    presliding_rad: float = 0.0  # Dahl's length; zero: friction is the sign of the rate


def ratios_of(motor: Motor, joints: Sequence[str]) -> FloatArray:
    """Motor rate per joint rate, (joints,); ``dq_m = ratios @ dq``.

    Raises:
        UnknownFrameError: a joint that is not there.
    """
    found = np.zeros(len(joints))
    for joint, ratio in motor.ratios:
        if joint not in joints:
            raise UnknownFrameError(f"motor {motor.name!r} turns with {joint!r}; joints are {', '.join(joints)}")
        found[joints.index(joint)] = ratio
    return found


class CoulombFriction:
    """Coulomb friction of motors divided by its level (Dahl 1968), tick by tick.

    Args:
        motors: at least one.
        joints: names, in the order of the signals.
    """

    def __init__(self, motors: Sequence[Motor], joints: Sequence[str]) -> None:
        self._ratios = np.array([ratios_of(motor, joints) for motor in motors])  # (k, joints)
        self._length = np.array([motor.presliding_rad for motor in motors])
        self._z, self._x = np.zeros(len(motors)), np.full(len(motors), np.nan)
        self._moved = np.zeros(len(motors))  # lengths

    def follow(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Friction at n ticks that follow those before, (n, motors), between -1 and 1.

        NaN while unknown: Dahl's, until the motor has moved by five of its lengths. A tick that is not
        finite does not change it. Between ticks the motion is assumed monotonic.

        Args:
            q: joint positions, (n, joints).
            dq: joint rates, (n, joints).
        """
        dahl = self._length > 0.0
        x: FloatArray = q @ self._ratios.T
        found: FloatArray = np.nan_to_num(np.sign(dq @ self._ratios.T))
        for tick, position in enumerate(x):
            if np.isfinite(position).all():
                steps = np.nan_to_num(position - self._x)[dahl] / self._length[dahl]
                end = np.sign(steps)
                self._z[dahl] = end + (self._z[dahl] - end) * np.exp(-np.abs(steps))
                self._moved[dahl] += np.abs(steps)
                self._x = position
            found[tick, dahl] = np.where(self._moved < _SETTLED, np.nan, self._z)[dahl]
        return found
