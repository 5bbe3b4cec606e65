"""Interface between plants and the sensors and mission that read them.

A plant computes true signals on a grid ``t_k = k h`` of mission time. Its arrays have full length from the start and
are filled as it advances; sensors read only rows already computed. Those that nobody reads any more are given back.
"""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

from hil_sim.arrays import FloatArray
from hil_sim.plants.motions.motion import Program
from hil_sim.scenario.tables import ScenarioError

Axis = tuple[float, float, float]
Z: Axis = (0.0, 0.0, 1.0)  # that of a flange's joint


class NotYetComputedError(RuntimeError):
    """A sensor was asked for a time not yet computed."""


class ForgottenError(RuntimeError):
    """A sensor was asked for a time whose rows were given back."""


class Inertial(NamedTuple):
    """True input of an IMU at its place, in its design axes."""

    specific_force_m_s2: FloatArray  # (n, 3): a - g, in free fall the acceleration itself
    rate_rad_s: FloatArray  # (n, 3): row k belongs to t_k - ``rate_late`` h
    rate_late: float


class Plant(ABC):
    """Moving bodies. ``at`` names a place; a plant with one place of a kind uses "".

    Attributes:
        step_s: grid step h.
        chunk: rows computed at a time.
        rows: rows of the whole mission.
        count: rows computed so far; whole chunks.
        program: commanded sequence of the arm.
        forgotten: rows before this one are zeros.
    """

    step_s: float
    chunk: int
    rows: int
    count: int
    program: Program
    forgotten: int = 0

    @abstractmethod
    def inertial(self, at: str) -> Inertial:
        """Motion at an IMU's place.

        Raises:
            ScenarioError: no such place (also raised by the methods below).
        """

    @abstractmethod
    def angle_rad(self, at: str) -> FloatArray:
        """Angle of a joint, (n,)."""

    @abstractmethod
    def moment_n_m(self, at: str, axis: Axis = Z) -> FloatArray:
        """Moment in a flange about an axis of it, on everything beyond it, (n,)."""

    @abstractmethod
    def force_n(self, at: str) -> FloatArray:
        """Force in a flange, its axes, on everything beyond it, (n, 3)."""

    @abstractmethod
    def servo_torque_n_m(self, at: str) -> FloatArray:
        """Torque of a joint's servo, (n,)."""

    def wheel_rate_rad_s(self, at: str) -> FloatArray:
        """Speed of a reaction wheel against the base, (n,)."""
        raise ScenarioError(f"there is no reaction wheel {at!r} in this plant; take its device out")

    def thrust_n(self, at: str) -> FloatArray:
        """Force of a thruster, (n,)."""
        raise ScenarioError(f"there is no thruster {at!r} in this plant; take its device out")

    def pose(self, at: str) -> FloatArray:
        """Position, m, and attitude, a quaternion (w, x, y, z), of a frame in inertial axes, (n, 7)."""
        raise ScenarioError(f"nothing tracks {at!r} in this plant; take its device out")

    @abstractmethod
    def truth(self) -> dict[str, Any]:
        """True values for comparison with estimates: scalars, text, lists and arrays, SI units."""

    @abstractmethod
    def _run_chunk(self) -> None:
        """Compute the next chunk of rows."""

    def advance(self, time_s: float, ahead_s: float = 0.0) -> None:
        """Compute until ``time_s`` (mission time) can be interpolated; at the end of the mission the last row stays.

        Args:
            time_s: when the devices are.
            ahead_s: how much more is computed when something must be: nothing that a device does moves a plant, and
                sensors are quicker with many rows at once.
        """
        wanted = min(self.rows, int(max(0.0, time_s) / self.step_s) + 4)
        if self.count >= wanted:
            return
        wanted = min(self.rows, wanted + int(ahead_s / self.step_s))
        while self.count < wanted:
            self._run_chunk()

    def forget(self, before: int) -> None:  # noqa: B027 - a hook that may be left as it is
        """Rows before ``before`` are not read any more: give them back where that was made possible."""

    def require(self, time_s: float) -> None:
        """Check that ``time_s`` can be interpolated.

        Raises:
            NotYetComputedError: it lies ahead of the plant.
            ForgottenError: it lies before what is kept.
        """
        if self.forgotten and time_s < self.forgotten * self.step_s:
            raise ForgottenError(
                f"the truth of mission time {time_s:.6f} s is not kept any more, only that from "
                f"{self.forgotten * self.step_s:.6f} s on; let Mission keep more"
            )
        if self.count < self.rows and time_s / self.step_s >= self.count - 3:
            raise NotYetComputedError(
                f"mission time {time_s:.6f} s is ahead of the plant, which stands at {self.count * self.step_s:.6f} s; "
                "advance the mission first"
            )
