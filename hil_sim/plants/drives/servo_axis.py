"""One joint with motor, gear and brake as a rigid body: what a drive's torque does to it.

Inertia, Coulomb and viscous friction, a torque that has an end, a brake that holds without current, and mechanical
stops. The drive is asked for a torque every millisecond (semi-implicit Euler); with none it is the brake that acts.
What hangs on the joint does not act back: its inertia is that of a motor behind a large gear.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, Protocol

STEP_S: Final = 1e-3
KEPT: Final = 512  # steps that can be asked for
_ROUNDING_RAD_S: Final = 1e-3  # of Coulomb friction

Controller = Callable[[float, float], float | None]
"""Torque [N m] on the joint at a time [s] and a rate of the joint [rad/s]; None: no current."""


class DriveJoint(Protocol):
    """What a drive has of the joint that it moves; :class:`ServoAxis` says what each is."""

    controller: Controller | None
    inertia_kg_m2: float
    largest_n_m: float
    torque_n_m: float
    lowest_rad: float
    highest_rad: float
    fastest_rad_s: float

    @property
    def rate_rad_s(self) -> float:
        """Rate at the newest step."""

    @property
    def newest_s(self) -> float:
        """Time of the newest step."""

    def advance(self, time_s: float) -> None:
        """Compute up to ``time_s``, and the step after it."""

    def angle_rad(self, time_s: float) -> float:
        """Angle at ``time_s``, up to half a second ago."""

    def motor_n_m(self, time_s: float) -> float:
        """Torque of the motor at ``time_s``, up to half a second ago."""


class Stepped:
    """Angles that are computed in steps of :data:`STEP_S`; a controller that a step asks may look at them.

    Args:
        angles_rad: At time 0.
    """

    def __init__(self, angles_rad: Sequence[float]) -> None:
        self._count, self._is_stepping = 0, False  # number of the newest step
        self._past = deque([angles_rad], KEPT)

    @property
    def newest_s(self) -> float:
        """Time of the newest step."""
        return self._count * STEP_S

    def advance(self, time_s: float) -> None:
        """Compute up to ``time_s``, and the step after it."""
        while not self._is_stepping and self._count * STEP_S < time_s + 1e-9:
            self._is_stepping = True
            self._step()
            self._is_stepping = False

    def _step(self) -> None:
        raise NotImplementedError

    def _angle_rad(self, place: int, time_s: float) -> float:
        """Angle at a place at ``time_s``, up to half a second ago."""
        self.advance(time_s)
        at = max(time_s / STEP_S, 0.0)
        last = min(math.floor(at), self._count - 1)
        back = last - self._count - 1  # index from the end of the past
        if -back > len(self._past):
            return self._past[0][place]
        before, after = self._past[back][place], self._past[back + 1][place]
        return before + (at - last) * (after - before)


class ServoAxis(Stepped):
    """One joint, at rest at time 0.

    Args:
        angle_rad: Where it stands.
        inertia_kg_m2: Of motor, gear and load, about the joint.
        torque_n_m: Largest torque of the motor, at the joint.
        brake_n_m: Torque of the brake.
        coulomb_n_m: Dry friction.
        viscous_n_m_s: Viscous friction, N m / (rad/s).

    Attributes:
        controller: The drive that gives the torque.
        lowest_rad, highest_rad: Ends of where it has ever been.
        fastest_rad_s: Largest rate it ever had.
        torque_n_m: Of the motor in the last step; 0 without current.
    """

    def __init__(
        self,
        angle_rad: float = 0.0,
        *,
        inertia_kg_m2: float = 1.0,
        torque_n_m: float = 30.0,
        brake_n_m: float = 30.0,
        coulomb_n_m: float = 0.3,
        viscous_n_m_s: float = 0.5,
    ) -> None:
        super().__init__([angle_rad])
        self.controller: Controller | None = None
        self.inertia_kg_m2, self.largest_n_m = inertia_kg_m2, torque_n_m
        self._brake_n_m, self._coulomb_n_m, self._viscous_n_m_s = brake_n_m, coulomb_n_m, viscous_n_m_s
        self._angle, self._rate, self.torque_n_m = angle_rad, 0.0, 0.0
        self.lowest_rad = self.highest_rad = angle_rad
        self.fastest_rad_s = 0.0

    @property
    def rate_rad_s(self) -> float:
        """Rate at the newest step."""
        return self._rate

    def angle_rad(self, time_s: float) -> float:
        """Angle at ``time_s``, up to half a second ago."""
        return self._angle_rad(0, time_s)

    def motor_n_m(self, time_s: float) -> float:
        """Torque of the motor in the step at ``time_s``, or in the newest."""
        self.advance(time_s)
        return self.torque_n_m

    def _step(self) -> None:
        time_s, rate = self._count * STEP_S, self._rate
        torque = None if self.controller is None else self.controller(time_s, rate)
        friction = self._coulomb_n_m * math.tanh(rate / _ROUNDING_RAD_S) + self._viscous_n_m_s * rate
        if torque is None:
            self.torque_n_m = 0.0
            slower = (self._brake_n_m * STEP_S) / self.inertia_kg_m2
            rate = math.copysign(max(abs(rate) - slower, 0.0), rate)
        else:
            self.torque_n_m = min(max(torque, -self.largest_n_m), self.largest_n_m)
            rate += (self.torque_n_m - friction) * STEP_S / self.inertia_kg_m2
        angle = self._angle + rate * STEP_S
        self._angle, self._rate = angle, rate
        self.lowest_rad, self.highest_rad = min(self.lowest_rad, angle), max(self.highest_rad, angle)
        self.fastest_rad_s = max(self.fastest_rad_s, abs(rate))
        self._count += 1
        self._past.append([angle])


class AxisAngle:
    """Angle of an axis, as an input of a device."""

    def __init__(self, axis: DriveJoint) -> None:
        self._axis = axis

    def value(self, time_s: float) -> float:
        """See ``ScalarAnalog``."""
        return self._axis.angle_rad(time_s)


class AxisTorque:
    """Torque of an axis's motor, at the joint, as an input of a device; ``sensed``: with what it makes of that."""

    def __init__(self, axis: DriveJoint, sensed: Callable[[float, float], float] | None = None) -> None:
        self._axis, self._sensed = axis, sensed

    def value(self, time_s: float) -> float:
        """See ``ScalarAnalog``."""
        torque = self._axis.motor_n_m(time_s)
        return torque if self._sensed is None else self._sensed(torque, time_s)
