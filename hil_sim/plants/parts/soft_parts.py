"""Springs in a vehicle: joints that give way between drive and link, and a mass that swings in the base.

A joint's drive, with its encoder, moves as commanded; the link is turned further by its bend, on which a spring and a
damper act, and neither within the joint's play. The swinging mass is a point on a spring about the base's centre of
mass, without a moment of its own; on a level table it moves along the table. All are states beside the base's motion,
integrated with it.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.body import Solid
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import Scenario

_LARGEST_STEP = 2.2  # of a Runge-Kutta scheme of fourth order, in radians of the fastest mode; 2.8 is its limit
_STIFF_Hz, _STIFF_RATIO = 20.0, 0.1  # of joints that have play and are not said to be flexible


class Slosh(NamedTuple):
    """A part of the base's mass that swings."""

    mass_kg: float
    stiffness_N_m: float  # noqa: N815
    damping_N_s_m: float  # noqa: N815
    anchor_m: FloatArray  # (3,) base axes


class SoftParts:
    """The springs' state: bends of the joints and their rates, then place and velocity of the mass, world axes.

    Args:
        frequency_Hz: of each joint's bend, all else as it stands at the start; none: stiff joints.
        damping_ratio: of these.
        slosh: the swinging mass, if any.
        gap_rad: of each joint's play, at the start and at the end, (2, j); none of it where not given.
        duration_s: of the motion, in which the play grows.

    Attributes:
        duration_s: as above.
        state: (s,) where the vehicle stands.
        stiffness_N_m_rad: of each joint; empty before ``start``.
    """

    def __init__(
        self,
        frequency_Hz: FloatArray,
        damping_ratio: float,
        slosh: Slosh | None,
        gap_rad: FloatArray | None = None,
        duration_s: float = 1.0,
    ) -> None:
        self._frequency, self._ratio, self.slosh = frequency_Hz, damping_ratio, slosh
        self.joints = len(frequency_Hz)
        self._gap, self.duration_s = np.zeros((2, self.joints)) if gap_rad is None else gap_rad, duration_s
        self.state = np.zeros(2 * self.joints + (0 if slosh is None else 6))
        self.stiffness_N_m_rad = self.damping_N_m_s_rad = np.zeros(0)

    def start(self, inertia: FloatArray, load_n_m: FloatArray, anchor: tuple[FloatArray, FloatArray]) -> None:
        """Set springs and state at rest.

        Args:
            inertia: that each joint's bend accelerates, (j,).
            load_n_m: torque of each joint at rest, (j,).
            anchor: place and velocity of the mass's anchor, world axes.
        """
        if self.joints:
            w = 2.0 * np.pi * self._frequency
            self.stiffness_N_m_rad, self.damping_N_m_s_rad = w**2 * inertia, 2.0 * self._ratio * w * inertia
            self.state[: self.joints] = -load_n_m / self.stiffness_N_m_rad - 0.5 * self._gap[0] * np.sign(load_n_m)
        if self.slosh is not None:
            self.state[2 * self.joints :] = np.concatenate(anchor)

    def require(self, inertia: FloatArray, step_s: float) -> None:
        """Check that a Runge-Kutta step is short enough for the fastest mode of the joints.

        Args:
            inertia: of the joints while the base gives way, (j, j).
            step_s: of the integration.

        Raises:
            ScenarioError: it is not.
        """
        if not self.joints:
            return
        fastest = float(
            np.sqrt(np.linalg.eigvals(np.linalg.solve(inertia, np.diag(self.stiffness_N_m_rad))).real.max())
        )
        if fastest * step_s > _LARGEST_STEP:
            raise ScenarioError(
                f"joints with these springs swing at {fastest / (2.0 * np.pi):.0f} Hz together, too fast for steps of "
                f"{1e3 * step_s:g} ms; give [physics] a smaller integration_steps, or [flexibility] lower frequencies"
            )

    def bend(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of the joints and its rate, (j,) each; zeros of none."""
        return state[: self.joints], state[self.joints : 2 * self.joints]

    def torque(self, state: FloatArray, time_s: float) -> FloatArray:
        """Of the springs on the links, (j,): none while a bend is within its joint's play."""
        bend, rate = self.bend(state)
        half = 0.5 * (self._gap[0] + min(1.0, time_s / self.duration_s) * (self._gap[1] - self._gap[0]))
        beyond = bend - np.clip(bend, -half, half)
        touches = (beyond != 0.0) | (half == 0.0)
        return np.asarray(-self.stiffness_N_m_rad * beyond - self.damping_N_m_s_rad * rate * touches, np.float64)

    def pull(self, state: FloatArray, anchor: tuple[FloatArray, FloatArray], *, level: bool) -> FloatArray:
        """Force of the spring on the mass, world axes, (3,)."""
        assert self.slosh is not None
        at, velocity = state[2 * self.joints :].reshape(2, 3)
        force = self.slosh.stiffness_N_m * (anchor[0] - at) + self.slosh.damping_N_s_m * (anchor[1] - velocity)
        return force * [1.0, 1.0, 0.0] if level else force

    def rates(self, state: FloatArray, bend_rad_s2: FloatArray, pull_n: FloatArray) -> FloatArray:
        """Derivative of the state, (s,)."""
        parts = [state[self.joints : 2 * self.joints], bend_rad_s2]
        if self.slosh is not None:
            parts += [state[2 * self.joints + 3 :], pull_n / self.slosh.mass_kg]
        return np.concatenate(parts)


def springs(
    scenario: Scenario, bodies: Mapping[str, Solid], joints: Sequence[str], rng: np.random.Generator
) -> tuple[SoftParts | None, dict[str, Solid]]:
    """What of a scenario is not stiff, and its base without the mass that swings.

    Args:
        scenario: its ``[flexibility]``, ``[backlash]`` and ``[slosh]``.
        bodies: links as built.
        joints: their names.
        rng: draws the frequencies.

    Raises:
        ScenarioError: more swings than the base weighs, or a joint that is not there.
    """
    flexible, play, table = scenario.flexibility, scenario.backlash, scenario.slosh
    frequency, ratio, gap = np.zeros(0), 0.0, np.zeros((2, len(joints)))
    if play is not None:
        if play.joint not in joints:
            raise ScenarioError(f"backlash.joint: the joints are {', '.join(joints)}")
        gap[:, joints.index(play.joint)] = np.multiply(1e-3, play.gap_mrad)
        frequency, ratio = np.full(len(joints), _STIFF_Hz), _STIFF_RATIO
    if flexible is not None:
        frequency, ratio = rng.uniform(*flexible.frequency_Hz, len(joints)), flexible.damping_ratio
    duration_s = sum(step.duration_s for step in scenario.sequence)
    if table is None:
        return (SoftParts(frequency, ratio, None, gap, duration_s) if frequency.size else None), {}
    name = scenario.vehicle.base_link
    base = bodies.get(name)
    if base is None or table.mass_kg >= base.mass_kg:
        raise ScenarioError(f"slosh.mass_kg: {name} weighs {0.0 if base is None else base.mass_kg:.3g} kg; give less")
    rate = 2.0 * np.pi * table.frequency_Hz
    of_spring = table.mass_kg * rate**2, 2.0 * table.damping_ratio * table.mass_kg * rate
    swings = Slosh(table.mass_kg, *of_spring, base.centre_of_mass_m)
    left = Solid(base.mass_kg - table.mass_kg, base.centre_of_mass_m, base.inertia_kg_m2)
    return SoftParts(frequency, ratio, swings, gap, duration_s), {name: left}


def full_inertia(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    """Inertia matrix at the pose in ``data``, (v, v)."""
    out = np.zeros((model.nv, model.nv))
    for row, unit in zip(out, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    return out


def bent_inertia(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> FloatArray:
    """Inertia of the joints' bends at the pose in ``data``; a base of so many freedoms gives way, (j, j)."""
    data.qacc[:] = 0.0
    mujoco.mj_inverse(model, data)
    M = full_inertia(model, data)
    return M[base:, base:] - M[base:, :base] @ np.linalg.solve(M[:base, :base], M[:base, base:]) if base else M
