"""Wrenches on a vehicle's base: thrusters that burn along an axis of a frame of it, and disturbances unknown on board.

Both rise and fall within :data:`RISE_s` as sin^2, half of it before the stated time and half after.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.body import Solid
from hil_sim.plants.urdf_model import UrdfModel, matrix_of
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import Scenario

RISE_s = 0.02
_ACCELERATION_m_s2 = 0.01  # of the whole vehicle, where no force is given


class Span(NamedTuple):
    """A time in which something pushes."""

    from_s: float
    to_s: float

    def share(self, time_s: FloatArray) -> FloatArray:
        """Of its force, at times (n,)."""
        edges = (time_s - self.from_s) / RISE_s + 0.5, (self.to_s - time_s) / RISE_s + 0.5
        return np.asarray(np.prod([np.sin(0.5 * np.pi * np.clip(one, 0.0, 1.0)) ** 2 for one in edges], axis=0))

    def share_at(self, time_s: float) -> float:
        """Of its force, at a time."""
        if not self.from_s - RISE_s < time_s < self.to_s + RISE_s:
            return 0.0
        return float(self.share(np.array([time_s]))[0])


class Burn(NamedTuple):
    """A thruster that is on for a time."""

    frame: str
    span: Span
    force_n: float
    wrench: FloatArray  # (6,) of 1 N: force and moment about the base's origin, base axes


class UnknownWrench(NamedTuple):
    """A wrench that is unknown on board."""

    span: Span
    turns: bool  # with the base; else it keeps its direction in space
    force_n: FloatArray  # (3,) at the base's origin
    torque_n_m: FloatArray  # (3,)

    def push(self, turn: FloatArray) -> FloatArray:
        """Force on the base, world axes, and moment about its origin, base axes, (6,); ``turn``: base to world."""
        if self.turns:
            return np.concatenate([turn @ self.force_n, self.torque_n_m])
        return np.concatenate([self.force_n, turn.T @ self.torque_n_m])


class Jets:
    """What pushes the base.

    Args:
        scenario: with their devices and burns.
        model: of the vehicle.
        bodies: as built.

    Raises:
        ScenarioError: a burn of a frame that no thruster has, or of one that is not fixed to the base.
    """

    def __init__(self, scenario: Scenario, model: UrdfModel, bodies: Mapping[str, Solid]) -> None:
        mass_kg = sum(body.mass_kg for body in bodies.values())
        axes = dict[str, FloatArray]()
        for device in scenario.device.values():
            table = device.model_dump()
            sensor = scenario.sensor.get(str(table.get("measures")))
            if sensor is not None and sensor.quantity == "thrust":
                axes[str(table["at"])] = np.asarray(table["axis"], np.float64)
        self.frames = frozenset(axes)
        self.burns: list[Burn] = []
        for one in scenario.burn:
            if one.frame not in axes:
                raise ScenarioError(f"burn: no thruster is at {one.frame!r}; there are {', '.join(axes) or 'none'}")
            body = model.model.body(model.body(one.frame))
            if int(body.parentid[0]) != model.body(scenario.vehicle.base_link):
                raise ScenarioError(f"burn: {one.frame!r} is not fixed to {scenario.vehicle.base_link!r}; make it so")
            along = matrix_of(np.array(body.quat)) @ axes[one.frame]
            force = along / np.linalg.norm(along)
            wrench = np.concatenate([force, np.cross(np.array(body.pos), force)])
            size_n = _ACCELERATION_m_s2 * mass_kg if one.force_N is None else one.force_N
            self.burns.append(Burn(one.frame, Span(one.at_s, one.at_s + one.duration_s), size_n, wrench))
        self._unknown = [
            UnknownWrench(
                Span(one.at_s, np.inf if one.duration_s is None else one.at_s + one.duration_s),
                one.axes == "base",
                np.array(one.force_N),
                np.array(one.torque_N_m),
            )
            for one in scenario.wrench
        ]
        self.any = bool(self.burns or self._unknown)

    def force_n(self, frame: str, time_s: FloatArray) -> FloatArray:
        """Force of the thruster at a frame, (n,)."""
        out = np.zeros(len(time_s))
        for burn in self.burns:
            if burn.frame == frame:
                out += burn.force_n * burn.span.share(time_s)
        return out

    def push(self, time_s: float, turn: FloatArray) -> FloatArray:
        """Force on the base, world axes, and moment about its origin, base axes, (6,).

        Args:
            time_s: of the mission.
            turn: rotation from the base's axes to the world's.
        """
        out = np.zeros(6)
        for burn in self.burns:
            out += burn.force_n * burn.span.share_at(time_s) * burn.wrench
        out[:3] = turn @ out[:3]
        for one in self._unknown:
            out += one.span.share_at(time_s) * one.push(turn)
        return out
