"""What the noise of the joints does to a prediction.

From the momentum equation of :mod:`onboard.dynamics.free_flight` with eta = 0: the error of the base's twist is
``-C^-1 M`` times that of the joint rates, the error of its acceleration the same times that of the joint accelerations.
Products of rates are neglected.
"""

from collections.abc import Sequence

import numpy as np

from onboard.dynamics.bodies import Bodies
from onboard.dynamics.cut_wrench import CutWrench
from onboard.dynamics.joint_errors import JointErrors
from onboard.dynamics.kinematics import chain_motion, cross
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.spatial import times
from onboard.estimation.arrays import FloatArray
from onboard.identification.exiddm.prediction.further import PlacedImu

_POSTURE_TICKS = 10  # over which the arm's posture is constant


class JointNoise:
    """Of one vehicle.

    Args:
        vehicle: the model.
        joint_errors: what lies beyond each joint.
        imus: of the base, whose lines come first.
        cells: of the arm, whose lines follow.
        lines: of all instruments.
    """

    def __init__(
        self,
        vehicle: VehicleModel,
        joint_errors: JointErrors,
        imus: Sequence[PlacedImu],
        cells: Sequence[CutWrench],
        lines: Sequence[slice],
    ) -> None:
        self._vehicle, self._joint_errors = vehicle, joint_errors
        self._imus, self._cells, self._lines = list(imus), list(cells), list(lines)

    def of(self, q: FloatArray, joint_sigma: FloatArray, chi: FloatArray) -> FloatArray:
        """One sigma of it, (n, m).

        Args:
            q: joint positions, (n, joints).
            joint_sigma: of joint rates and accelerations, (n, 2, joints).
            chi: standard parameters of all links.
        """
        if not joint_sigma.any():
            return np.zeros((len(q), self._lines[-1].stop))
        effect = self.effect(q[::_POSTURE_TICKS], chi)
        variance = np.einsum("njkm,nkj->nm", effect[np.arange(len(q)) // _POSTURE_TICKS] ** 2, joint_sigma**2)
        return np.asarray(np.sqrt(variance), np.float64)

    def effect(self, q: FloatArray, chi: FloatArray) -> FloatArray:
        """Of an error of one in the rate and in the acceleration of each joint, (n, joints, 2, lines)."""
        chain = chain_motion(self._vehicle, q, *np.zeros((2, *q.shape)))
        bodies, S = Bodies.of(chain.links, chi), chain.screws
        momenta = times(self._joint_errors.beyond(bodies).inertia, S)  # (n, joints, 6)
        twist = -momenta @ np.asarray(np.linalg.inv(bodies.composite), np.float64).swapaxes(1, 2)
        effect = np.zeros((*q.shape, 2, self._lines[-1].stop))
        for imu, own in zip(self._imus, self._lines, strict=False):
            force = twist[..., :3] + cross(twist[..., 3:], imu.p_BoSo_B)
            effect[:, :, 0, own.start : own.start + 3] = twist[..., 3:] @ imu.R_BS
            effect[:, :, 1, own.start + 3 : own.stop] = force @ imu.R_BS
        for cut, own in zip(self._cells, self._lines[len(self._imus) :], strict=False):
            effect[:, :, 1, own.start] = cut.of_joint_accelerations(bodies, S, twist)
        return effect
