"""Actuators of a free-flyer's base: reaction wheels that hold its attitude, and thrusters.

The attitude control knows the true attitude and rate. Its law is smooth, also at the largest torque of a wheel's motor.
"""

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.body import Solid


class Wheel(NamedTuple):
    """A balanced rotor on an axis of the base."""

    name: str
    axis: FloatArray  # (3,) unit, base axes
    position_m: FloatArray  # (3,)
    body: Solid
    start_rad_s: float

    @staticmethod
    def of(
        name: str,
        axis: Sequence[float],
        position_m: Sequence[float],
        mass_kg: float,
        inertia_kg_m2: tuple[float, float],
        start_rad_s: float,
    ) -> "Wheel":
        """``inertia_kg_m2``: about the axis, and across it."""
        a = np.asarray(axis, np.float64) / np.linalg.norm(axis)
        axial, across = inertia_kg_m2
        tensor = across * np.eye(3) + (axial - across) * np.outer(a, a)
        return Wheel(name, a, np.asarray(position_m, np.float64), Solid(mass_kg, np.zeros(3), tensor), start_rad_s)


class Pulse(NamedTuple):
    """A thruster that is on for a time."""

    from_s: float
    to_s: float
    force_n: FloatArray  # (3,) on the base, base axes
    position_m: FloatArray  # (3,)
    thruster: str = ""  # the device that tells it


class Hold(NamedTuple):
    """Attitude control: torque of each wheel's motor by angle and rate of the base about its axis."""

    spring_n_m_rad: float
    damper_n_m_s: float
    torque_n_m: float  # at most


class Actuators(NamedTuple):
    """Wheels and thrusters; without ``hold`` the wheels spin freely."""

    wheels: tuple[Wheel, ...] = ()
    hold: Hold | None = None
    pulses: tuple[Pulse, ...] = ()

    @property
    def any(self) -> bool:
        """Whether there are any."""
        return bool(self.wheels or self.pulses)

    def spin_up(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """The wheels as they turn at the release."""
        data.qvel[self._degrees(model)] = [wheel.start_rad_s for wheel in self.wheels]

    def thrust_n(self, thruster: str, time_s: FloatArray) -> FloatArray:
        """Force of a thruster along its own direction, (n,)."""
        on = [p for p in self.pulses if p.thruster == thruster]
        each = [np.linalg.norm(p.force_n) * ((time_s >= p.from_s) & (time_s < p.to_s)) for p in on]
        return np.asarray(np.sum(each, axis=0), np.float64)

    def rates(self, model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
        """Of the wheels against the base, (w,)."""
        return np.asarray(data.qvel[self._degrees(model)], np.float64)

    def forces(self, model: mujoco.MjModel, data: mujoco.MjData, time_s: float) -> FloatArray:
        """Generalised forces, (v,); of the base world axes, then base axes."""
        out = np.zeros(model.nv)
        if self.hold is not None and self.wheels:
            axes = np.stack([wheel.axis for wheel in self.wheels])
            w, x, y, z = data.qpos[3:7]
            angle = 2.0 * np.copysign(1.0, w) * np.array([x, y, z])
            wanted = axes @ (self.hold.spring_n_m_rad * angle + self.hold.damper_n_m_s * data.qvel[3:6])
            most = self.hold.torque_n_m
            out[self._degrees(model)] = most * np.tanh(wanted / most)
        for pulse in self.pulses:
            if pulse.from_s <= time_s < pulse.to_s:
                turn = np.zeros(9)
                mujoco.mju_quat2Mat(turn, data.qpos[3:7])
                out[:3] += turn.reshape(3, 3) @ pulse.force_n
                out[3:6] += np.cross(pulse.position_m, pulse.force_n)
        return out

    def _degrees(self, model: mujoco.MjModel) -> list[int]:
        return [int(model.joint(wheel.name).dofadr[0]) for wheel in self.wheels]


NO_ACTUATORS = Actuators()
