"""The motion of a trial: from rest at a posture and back to it, every joint at its own frequency.

``q_i(t) = q_i(0) + a_i sin^2(pi t / T) sin(2 pi k_i t / T)``: position, rate and acceleration are continuous at both
ends, so that trials follow each other without a jump. A rest follows, in which the arm settles.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray

CYCLES = (1, 2, 1, 2, 3)  # k_i, from the first joint on, then again
_SWING_RAD = 0.35
_OF_SPEED, _OF_EFFORT = 0.5, 0.2  # largest share of the joint's speed; of its torque, by the model
_SAMPLES = 201


class JointLimits(NamedTuple):
    """Of the joints, (n,) each: rad, rad, rad/s, N m."""

    low: FloatArray
    high: FloatArray
    speed: FloatArray
    effort: FloatArray


class Motion(NamedTuple):
    """A motion of ``duration_s``, then rest of ``rest_s``.

    Attributes:
        start_rad: (n,).
        amplitude_rad: (n,); the sign is the direction.
    """

    start_rad: FloatArray
    amplitude_rad: FloatArray
    duration_s: float
    rest_s: float

    @property
    def seconds(self) -> float:
        """Of the trial."""
        return self.duration_s + self.rest_s

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, rate and acceleration at times (m,) of the trial; (m, n) each."""
        w = np.pi / self.duration_s
        t = np.clip(time_s, 0.0, self.duration_s)[:, None]
        k = 2.0 * w * np.resize(CYCLES, len(self.start_rad))
        # sin^2(w t) = (1 - cos(2 w t)) / 2
        e, de, dde = 0.5 - 0.5 * np.cos(2 * w * t), w * np.sin(2 * w * t), 2 * w * w * np.cos(2 * w * t)
        s, ds, dds = np.sin(k * t), k * np.cos(k * t), -k * k * np.sin(k * t)
        inside = ((time_s >= 0.0) & (time_s <= self.duration_s))[:, None]
        a = self.amplitude_rad
        return (
            self.start_rad + a * e * s,
            np.where(inside, a * (de * s + e * ds), 0.0),
            np.where(inside, a * (dde * s + 2.0 * de * ds + e * dds), 0.0),
        )


def fitted(start_rad: FloatArray, limits: JointLimits, inertia: FloatArray, duration_s: float, rest_s: float) -> Motion:
    """A motion within the limits: smaller where a joint's range, speed or torque asks for it.

    Args:
        start_rad: where the arm stands, (n,).
        limits: of the joints.
        inertia: of the arm there by the model, (n, n) kg m^2.
        duration_s: of the motion.
        rest_s: after it.

    Raises:
        ValueError: a joint that stands outside its limits, or at the end of them.
    """
    room = np.minimum(limits.high - start_rad, start_rad - limits.low)
    if not (room > 0.0).all():
        raise ValueError(f"joint {int(np.argmin(room)) + 1} stands outside its limits; bring the arm inside them")
    unit = Motion(start_rad, np.ones(len(start_rad)), duration_s, rest_s)
    _, dq, ddq = unit.at(np.linspace(0.0, duration_s, _SAMPLES))
    amplitude = np.minimum(_SWING_RAD, 0.8 * room)
    amplitude = np.minimum(amplitude, _OF_SPEED * limits.speed / np.abs(dq).max(axis=0))
    asked = np.abs(amplitude * ddq @ inertia.T).max(axis=0)
    return unit._replace(amplitude_rad=amplitude * min(1.0, float((_OF_EFFORT * limits.effort / asked).min())))
