"""Base parameters of an arm on each kind of base: Mayeda's closed forms (section 2.1.4) beside the numerical counts.

The payload is held throughout; joint torques without friction on a fixed base, the base's wrench alone on a free one
and on a level bed. Where the two differ, the arm's geometry is one of the exceptions of the closed form: an axis that
meets or is the next one, an offset of zero (``L_x = 0``).
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from onboard.dynamics.mechanics.base_parameter_count import (
    Count,
    fixed_base_count,
    free_base_count,
    planar_base_count,
)
from onboard.dynamics.mechanics.chain import SerialChain, chain_of
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.flight.estimate.problem.identification import NAMING_SEED
from onboard.regressor.base_parameters import SampledMotion, base_parameters
from onboard.regressor.rows import RowModel, base_force_rows, base_moment_rows, joint_torque_row

BASES = (BaseKind.FIXED, BaseKind.FREE, BaseKind.PLANAR)
Gravity = tuple[float, float, float]


class Counted(NamedTuple):
    """Of one kind of base."""

    base: BaseKind
    rows: str  # what is measured, in words
    closed_form: Count | None  # None where it does not apply
    numerical: int


def closed_forms(chain: SerialChain, gravity_m_s2: Gravity) -> dict[BaseKind, Count]:
    """Counts in closed form by kind of base; empty where a joint is not revolute."""
    found = fixed_base_count(chain, np.array(gravity_m_s2)), free_base_count(chain), planar_base_count(chain)
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
