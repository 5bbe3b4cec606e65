"""The servo of a drive: what it wants of the axis, and the torque that brings it there; radians of the joint.

A position gain over a rate controller with an integral, and the rate of the demand fed forward. The demand is a line
from target to target (cyclic), a trapezoid of rate (profile), a ramp to standstill, or stands.
"""

import math
from collections import deque
from collections.abc import Callable
from typing import Final

from hil_sim.plants.drives.servo_axis import STEP_S, DriveJoint

_POSITION_GAIN, _RATE_GAIN, _RATE_INTEGRAL = 30.0, 200.0, 40.0  # 1/s
_STANDSTILL: Final = 2e-3  # rad/s


class ServoLoop:
    """The loop of one axis.

    Args:
        axis: What it moves.
        measured: What the encoder says at a time [s], rad.

    Attributes:
        demand: Where the axis is wanted, rad; ``rate``: how fast the demand moves, rad/s.
        target: Of a profile that is under way; None without.
    """

    def __init__(self, axis: DriveJoint, measured: Callable[[float], float]) -> None:
        self.demand = self.rate = 0.0
        self.target: float | None = None
        self._axis, self._measured, self._integral = axis, measured, 0.0
        self._line = (0.0, 0.0, 0.0)  # time, from, to
        self._told: deque[tuple[float, float]] = deque(maxlen=64)  # times, and targets that the loop has not reached

    @property
    def stands(self) -> bool:
        """Whether the demand does not move."""
        return abs(self.rate) < _STANDSTILL

    def stand(self) -> None:
        """The demand is where the axis is."""
        time_s = self._axis.newest_s
        self.demand, self.rate, self._integral = self._measured(time_s), 0.0, 0.0
        self._line, self.target = (time_s, self.demand, self.demand), None
        self._told.clear()

    def go_to(self, time_s: float, target: float) -> None:
        """The demand is to be at ``target`` one interpolation period after ``time_s``, which the loop may be behind."""
        self._told.append((time_s, target))

    def follow_line(self, time_s: float, period_s: float) -> None:
        """A step of the cyclic mode."""
        while self._told and time_s >= self._told[0][0]:
            at_s, target = self._told.popleft()
            self._line = at_s, self._on_line(at_s, period_s), target
        before, self.demand = self.demand, self._on_line(time_s, period_s)
        self.rate = (self.demand - before) / STEP_S

    def _on_line(self, time_s: float, period_s: float) -> float:
        at_s, start, end = self._line
        return start + min(max((time_s - at_s) / period_s, 0.0), 1.0) * (end - start)

    def _leave_line(self) -> None:
        """The demand moves otherwise: a line that follows begins where it is then."""
        self._line = 0.0, self.demand, self.demand

    def follow_profile(self, fastest: float, acceleration: float, deceleration: float) -> None:
        """A step of the profile mode; rad/s, rad/s2."""
        left = 0.0 if self.target is None else self.target - self.demand
        wanted = math.copysign(min(fastest, math.sqrt(2.0 * deceleration * abs(left))), left)
        most = STEP_S * (acceleration if abs(wanted) > abs(self.rate) else deceleration)
        self.rate += min(max(wanted - self.rate, -most), most)
        self.demand += self.rate * STEP_S
        if self.target is not None and abs(self.target - self.demand) <= abs(self.rate) * STEP_S + 1e-9:
            self.demand, self.rate, self.target = self.target, 0.0, None
        self._leave_line()

    def slow_down(self, deceleration: float) -> None:
        """A step of a ramp to standstill; rad/s2."""
        self.rate = math.copysign(max(abs(self.rate) - deceleration * STEP_S, 0.0), self.rate)
        self.demand += self.rate * STEP_S
        self._leave_line()

    def torque(self, time_s: float, rate_rad_s: float) -> float:
        """Torque on the joint, N m, for the rate that is measured."""
        wanted = self.rate + _POSITION_GAIN * (self.demand - self._measured(time_s))
        error = wanted - rate_rad_s
        most = self._axis.largest_n_m / (self._axis.inertia_kg_m2 * _RATE_GAIN)
        self._integral = min(max(self._integral + _RATE_INTEGRAL * error * STEP_S, -most), most)
        return self._axis.inertia_kg_m2 * _RATE_GAIN * (error + self._integral)
