"""A free-floating vehicle with an arm: momentum map, tip Jacobian, generalized Jacobian (Umetani and Yoshida).

With no external wrench the momentum about the centre of mass is constant in inertial space, so the base moves when the
joints do: ``A_b(q) nu_b + A_m(q) dq = h`` (2.87-2.90). Eliminating the base's twist from the tip's, ``J_b nu_b + J_m
dq``, leaves ``P_dot = J*(q) dq + P_dot_0`` with ``J* = J_m - J_b A_b^-1 A_m`` (2.91-2.93): the Jacobian of an arm whose
base floats. The dissertation takes linear and angular momentum of the base apart; here both are in one 6 x 6 block.
"""

import numpy as np
import pinocchio as pin

from onboard.dynamics.model.errors import SignalError, UnknownFrameError
from onboard.dynamics.model.vehicle import FREE_FLYER_NV, VehicleModel
from onboard.estimation.arrays import FloatArray


class FloatingArm:
    """A vehicle with one set of inertial parameters and a tip; each method is one configuration.

    Args:
        vehicle: the model.
        tip: link, joint or frame whose motion is asked for.
        chi: standard parameters of all links, (10 x links,); those of the URDF where not given.

    Attributes:
        joints: number of joints, n.
        mass_kg: of the whole vehicle.

    Raises:
        UnknownFrameError: no such frame.
        SignalError: parameters of another shape, or a vehicle without mass.
    """

    def __init__(self, vehicle: VehicleModel, tip: str, chi: FloatArray | None = None) -> None:
        self.vehicle, self.joints = vehicle, len(vehicle.joints)
        self.model: pin.Model = vehicle.model.copy()
        values = vehicle.chi if chi is None else np.asarray(chi, np.float64)
        if values.shape != vehicle.chi.shape:
            raise SignalError(f"{len(vehicle.links)} links have {vehicle.chi.size} parameters, not {values.shape}")
        bodies = [pin.Inertia.Zero() for _ in range(self.model.njoints)]
        for link, own in zip(vehicle.links, values.reshape(-1, 10), strict=True):
            frame = self.model.frames[vehicle.frame_id(link)]
            if own[0] > 0.0:
                bodies[frame.parentJoint] += frame.placement.act(pin.Inertia.FromDynamicParameters(own))
        for index, body in enumerate(bodies):
            self.model.inertias[index] = body
        self.mass_kg = float(sum(body.mass for body in bodies[1:]))
        if not self.mass_kg > 0.0:
            raise SignalError("the vehicle has no mass; give its links <inertial> elements")
        self.tip = vehicle.frame_id(tip)
        if self.model.frames[self.tip].parentJoint <= 1:
            raise UnknownFrameError(f"frame {tip!r} is fixed in the base; name a frame that an arm's joint moves")
        self._data = self.model.createData()
        self._configuration = pin.neutral(self.model)

    def configuration(self, q: FloatArray) -> FloatArray:
        """Pinocchio's configuration vector for joint positions (n,), the base at the origin of its own axes."""
        if q.shape != (self.joints,):
            raise SignalError(f"{self.joints} joints need ({self.joints},) positions, not {q.shape}")
        full = self._configuration.copy()
        for joint, value in zip(self.vehicle.joints, q, strict=True):
            at = slice(joint.q_index, joint.q_index + joint.q_size)
            full[at] = value if joint.q_size == 1 else (np.cos(value), np.sin(value))
        return np.asarray(full, np.float64)

    def inverse_dynamics(self, configuration: FloatArray, nu: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Wrench on the base and joint torques, (6 + n,), by recursive Newton-Euler; base axes, no gravity (2.110)."""
        return np.array(pin.rnea(self.model, self._data, configuration, nu, acceleration))

    def momentum_map(self, q: FloatArray) -> FloatArray:
        """``A(q)``, (6, 6 + n): linear momentum, and angular momentum about the centre of mass, per velocity (2.87)."""
        return np.array(pin.computeCentroidalMap(self.model, self._data, self.configuration(q)))

    def centre_of_mass(self, q: FloatArray) -> FloatArray:
        """Of the whole vehicle, (3,) m, from the base frame's origin."""
        return np.array(pin.centerOfMass(self.model, self._data, self.configuration(q)))

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """``H(q)``, (6 + n, 6 + n), symmetric: kinetic energy is ``nu' H nu / 2`` (2.99)."""
        H = np.array(pin.crba(self.model, self._data, self.configuration(q)))
        upper = np.triu(H)
        return np.asarray(upper + np.triu(H, 1).T, np.float64)

    def reduced_inertia(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """``D (3, 3), D_q (3, n), D_qq (n, n)`` about the centre of mass: H with translation eliminated (2.35)."""
        H = self.mass_matrix(q)
        left = H[3:, 3:] - H[3:, :3] @ H[:3, 3:] / self.mass_kg
        return left[:3, :3], left[:3, 3:], left[3:, 3:]

    def tip_pose(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """``(R_BT (3, 3), p_BT (3,))`` of the tip in the base, m."""
        pin.framesForwardKinematics(self.model, self._data, self.configuration(q))
        placement = self._data.oMf[self.tip]
        return np.array(placement.rotation), np.array(placement.translation)

    def tip_jacobian(self, q: FloatArray) -> FloatArray:
        """``[J_b J_m]``, (6, 6 + n): the tip's twist, base axes, at the tip's origin (2.84-2.86)."""
        aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return np.array(pin.computeFrameJacobian(self.model, self._data, self.configuration(q), self.tip, aligned))

    def base_motion(self, q: FloatArray, dq: FloatArray, momentum: FloatArray | None = None) -> FloatArray:
        """The base's twist, (6,), for joint rates and a momentum about the centre of mass, (6,), base axes (2.90)."""
        A = self.momentum_map(q)
        h = np.zeros(6) if momentum is None else momentum
        return np.asarray(np.linalg.solve(A[:, :FREE_FLYER_NV], h - A[:, FREE_FLYER_NV:] @ dq), np.float64)

    def generalized_jacobian(self, q: FloatArray) -> FloatArray:
        """``J*``, (6, n): the tip's twist in inertial space per joint rate at zero momentum, base axes (2.93)."""
        J, A = self.tip_jacobian(q), self.momentum_map(q)
        base = np.linalg.solve(A[:, :FREE_FLYER_NV], A[:, FREE_FLYER_NV:])
        return np.asarray(J[:, FREE_FLYER_NV:] - J[:, :FREE_FLYER_NV] @ base, np.float64)

    def tip_drift(self, q: FloatArray, momentum: FloatArray) -> FloatArray:
        """``P_dot_0``, (6,): the tip's twist that a momentum gives while the joints rest (2.91)."""
        J, A = self.tip_jacobian(q), self.momentum_map(q)
        return np.asarray(J[:, :FREE_FLYER_NV] @ np.linalg.solve(A[:, :FREE_FLYER_NV], momentum), np.float64)

    def attitude_hold_momentum(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Angular momentum, (3,) N m s, that reaction wheels take so that the base keeps its attitude (2.97, 2.98).

        The base still translates: linear momentum stays zero.
        """
        A = self.momentum_map(q)
        velocity = self.base_velocity_attitude_held(q, dq)
        return np.asarray(-(A[3:, :3] @ velocity + A[3:, FREE_FLYER_NV:] @ dq), np.float64)

    def base_velocity_attitude_held(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """Velocity of the base frame's origin, (3,) m/s, where wheels hold the attitude and linear momentum is zero."""
        A = self.momentum_map(q)
        return np.asarray(-np.linalg.solve(A[:3, :3], A[:3, FREE_FLYER_NV:] @ dq), np.float64)
