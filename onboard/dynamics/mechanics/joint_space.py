"""Dynamics of an arm in the space of its joints, the base left to itself: ``H*(q) ddq + c*(q, dq) = tau``.

The rows of the base in the equations of motion say that nothing acts on it, ``H_bb a_b + H_bm ddq + c_b = 0``; what is
left of the joints' rows when they are eliminated is the arm's inertia, ``H* = H_mm - H_mb H_bb^-1 H_bm`` (2.99,
2.110). The momentum is taken to be zero, ``H_bb nu_b + H_bm dq = 0`` (2.90): no gyro is asked. A base on a level table
has three of the six rows, one that stands none, and gravity.
"""

import numpy as np

from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.vehicle import FREE_FLYER_NV
from onboard.estimation.arrays import FloatArray


class JointSpace:
    """The dynamics; each method is one configuration.

    Args:
        arm: with its inertial parameters.
    """

    def __init__(self, arm: FloatingArm) -> None:
        self.arm = arm
        spec = arm.vehicle.spec
        self._free = np.array(spec.base.moves if spec.base.floats else (), np.intp)
        self._held = np.zeros(FREE_FLYER_NV + arm.joints)
        if spec.base.in_gravity:
            self._held[:3] = -np.asarray(spec.gravity_m_s2)
            self._held[self._free] = 0.0

    def inertia(self, q: FloatArray) -> FloatArray:
        """``H*(q)``, (n, n), at joint positions (n,)."""
        H, b = self.arm.mass_matrix(q), FREE_FLYER_NV
        across = H[self._free, b:]
        return np.asarray(H[b:, b:] - across.T @ np.linalg.solve(H[np.ix_(self._free, self._free)], across), np.float64)

    def at_rest(self, q: FloatArray) -> FloatArray:
        """Joint torques, (n,) N m, that hold the arm at ``q``, (n,): against gravity, where there is some."""
        nothing = np.zeros(len(q))
        return self.torque(q, nothing, nothing)

    def torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Joint torques, (n,) N m, that accelerate the arm by ``ddq``, (n,)."""
        H, b, free = self.arm.mass_matrix(q), FREE_FLYER_NV, self._free
        own, across = H[np.ix_(free, free)], H[free, b:]
        nu, acceleration = np.concatenate([np.zeros(b), dq]), self._held.copy()
        nu[free] = -np.linalg.solve(own, across @ dq)
        acceleration[b:] = ddq
        configuration = self.arm.configuration(q)
        wrench = self.arm.inverse_dynamics(configuration, nu, acceleration)[free]
        acceleration[free] = -np.linalg.solve(own, wrench)
        return self.arm.inverse_dynamics(configuration, nu, acceleration)[b:]
