"""The mechanics of one vehicle at one configuration, and of the motions that were asked for, as plain values.

Base parameters of an arm on each kind of base: Mayeda's closed forms (section 2.1.4) beside the numerical counts.

The payload is held throughout; joint torques without friction on a fixed base, the base's wrench alone on a free one
and on a level bed. Where the two differ, the arm's geometry is one of the exceptions of the closed form: an axis that
meets or is the next one, an offset of zero (``L_x = 0``).
"""

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from onboard import config
from onboard.dynamics.mechanics import nonholonomic, virtual_manipulator, workspace
from onboard.dynamics.mechanics.base_parameter_count import Count, fixed_base_count, free_base_count, plane_base_count
from onboard.dynamics.mechanics.chain import SerialChain, chain_of
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.mechanics.inverse_kinematics import TipMotion, follow, straight_line
from onboard.dynamics.mechanics.reaction import reaction
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.problem.identification import NAMING_SEED
from onboard.flight.estimate.problem.model import build_model
from onboard.regressor.base_parameters import SampledMotion, base_parameters
from onboard.regressor.rows import RowModel, base_force_rows, base_moment_rows, joint_torque_row

BASES = (BaseKind.FIXED, BaseKind.FREE, BaseKind.PLANAR)
Gravity = tuple[float, float, float]
FOLLOWED_M = 1e-3  # what the inverse kinematics keeps where the arm can (docs/mechanics.md, 2.94)


class Counted(NamedTuple):
    """Of one kind of base."""

    base: BaseKind
    rows: str  # what is measured, in words
    closed_form: Count | None  # None where it does not apply
    numerical: int


def closed_forms(chain: SerialChain, gravity_m_s2: Gravity) -> dict[BaseKind, Count]:
    """Counts in closed form by kind of base; empty where a joint is not revolute."""
    found = fixed_base_count(chain, np.array(gravity_m_s2)), free_base_count(chain), plane_base_count(chain)
    return {base: count for base, count in zip(BASES, found, strict=True) if count is not None}


def counted(urdf: str, model: VehicleModel) -> tuple[Counted, ...]:
    """Both counts for each kind of base that the vehicle's arm could stand on.

    Args:
        urdf: of the vehicle.
        model: read from it; its base link, payload link and gravity are used, its kind of base is not.
    """
    if not model.joints:
        return ()
    tip = model.spec.payload_link or model.joints[-1].name
    try:
        closed = closed_forms(chain_of(FloatingArm(model, tip)), model.spec.gravity_m_s2)
    except SignalError:  # a tree has no closed form
        closed = {}
    words = {BaseKind.FIXED: "joint torques", BaseKind.FREE: "base wrench", BaseKind.PLANAR: "base wrench x, y, yaw"}
    return tuple(
        Counted(base, words[base], closed.get(base), _numerical(VehicleModel(urdf, replace(model.spec, base=base))))
        for base in (BASES if model.spec.base_link in model.links else BASES[:1])  # a bench has no inertia to move with
    )


def _numerical(model: VehicleModel) -> int:
    if not model.spec.base.moves:
        rows = RowModel(model, [joint_torque_row(model, joint.name, friction=False) for joint in model.joints])
    else:
        rows = RowModel(model, [*base_force_rows(model), *base_moment_rows(model)])
    motion = SampledMotion.of(model.spec.base, model.spec.gravity_m_s2)
    return len(base_parameters(rows, np.random.default_rng(NAMING_SEED), motion, released=False).names)


class LineMotion(NamedTuple):
    """A tip's straight line at zero momentum, and what it costs with the base floating and with its attitude held."""

    motion: TipMotion
    error_m: float  # farthest that the tip is from the line
    base_turn_rad: float  # largest rotation of the base on the way
    joint_rate_rad_s: float  # largest
    wheel_momentum: FloatArray  # (m, 3) N m s, attitude held along the same joint motion (2.97)
    wheel_moment: FloatArray  # (m, 3) N m (2.23)

    @property
    def is_followed(self) -> bool:
        """Whether the tip stays on the line."""
        return self.error_m <= FOLLOWED_M


@dataclass
class Mechanics:
    """What ``heft mechanics`` says of a vehicle."""

    name: str
    tip: str
    q: FloatArray  # (n,)
    joints: tuple[str, ...]
    mass_kg: float
    centre_of_mass_m: FloatArray  # (3,) base axes, from the base frame's origin
    inertia: FloatArray  # (3, 3) D, about the centre of mass
    generalized_jacobian: FloatArray  # (6, n)
    fixed_jacobian: FloatArray  # (6, n)
    least_singular_value: float
    base_per_joint: FloatArray  # (3, n) rad of the base per rad of a joint, -D^-1 D_q
    virtual_links_m: FloatArray | None = None  # (n + 1, 3); None for an arm that is no chain
    counts: dict[str, str] = field(default_factory=dict)
    line: LineMotion | None = None
    turn: nonholonomic.Reorientation | None = None
    map: workspace.SingularityMap | None = None
    map_joints: tuple[str, str] | None = None

    def as_json(self) -> dict[str, Any]:
        """Plain values, SI units."""
        document: dict[str, Any] = {
            "vehicle": self.name,
            "tip": self.tip,
            "joints": dict(zip(self.joints, self.q.tolist(), strict=True)),
            "mass_kg": self.mass_kg,
            "centre_of_mass_m": self.centre_of_mass_m.tolist(),
            "inertia_about_centre_of_mass_kg_m2": self.inertia.tolist(),
            "generalized_jacobian": self.generalized_jacobian.tolist(),
            "fixed_base_jacobian": self.fixed_jacobian.tolist(),
            "least_singular_value_m": self.least_singular_value,
            "base_rotation_per_joint": self.base_per_joint.tolist(),
            "virtual_links_m": None if self.virtual_links_m is None else self.virtual_links_m.tolist(),
            "base_parameters": self.counts,
        }
        if self.line is not None:
            document["line"] = {
                "error_m": self.line.error_m,
                "base_turn_rad": self.line.base_turn_rad,
                "joint_rate_rad_s": self.line.joint_rate_rad_s,
                "wheel_momentum_N_m_s": float(np.linalg.norm(self.line.wheel_momentum, axis=1).max()),
                "wheel_moment_N_m": float(np.linalg.norm(self.line.wheel_moment, axis=1).max()),
                "time_s": self.line.motion.time_s.tolist(),
                "q": self.line.motion.q.tolist(),
            }
        if self.turn is not None:
            document["turn"] = {
                "cycles": self.turn.cycles,
                "error_rad": self.turn.error_rad,
                "swing_rad": self.turn.swing_rad.tolist(),
                "cycle": [self.turn.path(s)[0].tolist() for s in np.linspace(0.0, 1.0, 101)],
            }
        if self.map is not None:
            document["workspace"] = {
                "joints": self.map_joints,
                "reachable_m": self.map.reachable,
                "path_dependent_m": self.map.dependent,
                "path_independent_m": self.map.independent,
            }
        return document


def arm_of(vehicle: config.Vehicle, tip: str | None) -> FloatingArm:
    """The vehicle's arm with the URDF's parameters; the tip is the payload link where none is named.

    Raises:
        ConfigError, ModelError: the vehicle file and its URDF do not fit, or no such frame.
        ValueError: no tip is named and there is no payload link.
    """
    model = build_model(vehicle)
    if tip is None and model.spec.payload_link is None:
        raise ValueError("this vehicle has no payload_link; name the tip with --tip FRAME")
    return FloatingArm(model, str(tip or model.spec.payload_link))


def positions(model: VehicleModel, given: dict[str, float]) -> FloatArray:
    """Joint positions (n,) from some by name; zero for the others, or the middle of limits that leave zero out.

    Raises:
        UnknownFrameError: a name that is not a joint.
    """
    for name in given:
        model.joint(name)
    middle = [0.0 if j.low <= 0.0 <= j.high else 0.5 * (j.low + j.high) for j in model.joints]
    return np.array([given.get(joint.name, at) for joint, at in zip(model.joints, middle, strict=True)])


def analyse(name: str, arm: FloatingArm, tip: str, q: FloatArray) -> Mechanics:
    """The tables of one configuration.

    Raises:
        SignalError: joint positions of another shape.
    """
    D, D_q, _ = arm.reduced_inertia(q)
    joints = tuple(joint.name for joint in arm.vehicle.joints)
    of_tip = arm.generalized_jacobian(q), arm.tip_jacobian(q)[:, 6:], workspace.least_singular_value(arm, q)
    of_base = np.asarray(-np.linalg.solve(D, D_q), np.float64)
    mechanics = Mechanics(name, tip, q, joints, arm.mass_kg, arm.centre_of_mass(q), D, *of_tip, of_base)
    try:
        chain = chain_of(arm)
    except ValueError:  # a tree: the tables that need a chain stay out
        return mechanics
    mechanics.virtual_links_m = virtual_manipulator.virtual_links(chain, q)
    closed = closed_forms(chain, arm.vehicle.spec.gravity_m_s2)
    mechanics.counts = {str(base): f"{count.parameters} = {count.formula}" for base, count in closed.items()}
    return mechanics


def line(arm: FloatingArm, q: FloatArray, step_m: FloatArray, duration_s: float) -> LineMotion:
    """A straight line of the tip by ``step_m`` (3,), base axes, at zero momentum."""
    motion = follow(arm, q, straight_line(arm, q, step_m, duration_s), duration_s)
    period_s = float(motion.time_s[1] - motion.time_s[0])
    ddq = np.gradient(motion.dq, period_s, axis=0)
    momentum = np.array([arm.attitude_hold_momentum(*one) for one in zip(motion.q, motion.dq, strict=True)])
    states = zip(motion.q, motion.dq, ddq, strict=True)
    moment = np.array([reaction(arm, *one).wheel_moment for one in states])
    turn = max(float(np.linalg.norm(pin.log3(R))) for R in motion.attitude)
    error = float(np.linalg.norm(motion.error, axis=1).max())
    return LineMotion(motion, error, turn, float(np.abs(motion.dq).max()), momentum, moment)
