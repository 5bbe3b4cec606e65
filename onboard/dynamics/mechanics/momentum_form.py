"""Rate of a floating base as a function of its joints and a momentum, ``w = J(q) eta - k(q, dq)``, derived three ways.

The ExIDDM sums the links' wrench and momentum columns, linear in the standard parameters (3.5-3.8); the virtual
manipulator's way takes the chain's geometry alone: barycentric vectors and reduced inertia (2.24-2.37), ``J = D^-1``,
``k = D^-1 D_q dq``; the generalized Jacobian's takes the momentum map ``A_b nu_b + A_m dq = h`` (2.87-2.93). They are
the same physics, so a difference between them is a mistake in one, and what all of them leave of a measured motion is
in the parameters or in the outside world.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from onboard.dynamics.kinematics import Bodies, chain_motion, turned
from onboard.dynamics.mechanics import barycentric
from onboard.dynamics.mechanics.chain import chain_of
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.vehicle import FREE_FLYER_NV, VehicleModel
from onboard.estimation.arrays import FloatArray


class Method(StrEnum):
    """Derivation of the base's motion."""

    EXIDDM = "exiddm"
    VIRTUAL_MANIPULATOR = "virtual_manipulator"
    GENERALIZED_JACOBIAN = "generalized_jacobian"


class MomentumForm(NamedTuple):
    """``w = inverse @ eta - still`` at n ticks, base axes, eta about the centre of mass."""

    inverse: FloatArray  # (n, 3, 3) J, 1 / (kg m^2)
    still: FloatArray  # (n, 3) k, rad/s

    def on_a_level_bed(self) -> "MomentumForm":
        """The same where the base can only slide and turn about its z: yaw alone, the other moments from the table."""
        inertia = np.linalg.inv(self.inverse)
        coupling = turned(np.asarray(inertia, np.float64), self.still)
        inverse, still = np.zeros_like(self.inverse), np.zeros_like(self.still)
        inverse[:, 2, 2] = 1.0 / inertia[:, 2, 2]
        still[:, 2] = coupling[:, 2] / inertia[:, 2, 2]
        return MomentumForm(inverse, still)


def momentum_form(
    vehicle: VehicleModel, chi: FloatArray, method: Method, q: FloatArray, dq: FloatArray
) -> MomentumForm:
    """Rate of the base per momentum and joint motion (2.24-2.37, 2.87-2.93, 3.5-3.8).

    Args:
        vehicle: the model, with a joint at least.
        chi: standard parameters of all links, (10 x links,).
        method: derivation.
        q: joint positions, (n, joints).
        dq: their rates, (n, joints).

    Raises:
        SignalError: by the virtual manipulator, an arm that is no chain of revolute joints.
    """
    if method is Method.EXIDDM:
        bodies = Bodies.of(chain_motion(vehicle, q, dq, np.zeros_like(q)).links, chi)
        inverse = np.asarray(np.linalg.inv(bodies.composite), np.float64)[:, 3:]
        return MomentumForm(inverse[:, :, 3:], turned(inverse, bodies.relative_momentum))
    arm = FloatingArm(vehicle, vehicle.spec.payload_link or vehicle.joints[-1].name, chi)
    if method is Method.GENERALIZED_JACOBIAN:
        A = np.array([arm.momentum_map(one) for one in q])  # (n, 6, 6 + joints)
        inverse = np.asarray(np.linalg.inv(A[:, :, :FREE_FLYER_NV]), np.float64)[:, 3:]
        return MomentumForm(inverse[:, :, 3:], turned(inverse, turned(A[:, :, FREE_FLYER_NV:], dq)))
    chain = chain_of(arm)
    reduced = [barycentric.reduced_inertia(chain, one) for one in q]
    inverse = np.asarray(np.linalg.inv(np.array([one.D for one in reduced])), np.float64)
    return MomentumForm(inverse, turned(inverse, turned(np.array([one.D_q for one in reduced]), dq)))
