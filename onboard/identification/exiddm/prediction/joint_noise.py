"""What the noise of the joints does to a prediction, and to an estimate.

From the momentum equation of :mod:`onboard.dynamics.free_flight` with eta = 0: the error of the base's twist is
``-C^-1 M`` times that of the joint rates, the error of its acceleration the same times that of the joint accelerations.
Products of rates are neglected.

The noise is in a prediction and in its derivatives alike (errors in variables). With E(x) what one error of a joint
does to a line of sigma R, it adds ``sum (dE/dx)' s^2 E / R^2`` to the gradient ``J' r`` of predicted less measured, and
an estimate of covariance P is off by -P times that (Fuller, Measurement Error Models, 1987, section 3.2), mostly
towards a light payload. s is the noise of the joints' samples as it is, without an inflation. Every product is taken of
predictions with an error of one joint's rate or acceleration, each in its turn, of lines of forces and moments alone.
(Encoders' noise added to flights once and twice more moved masses by two thirds of that. Lines of rates are left out:
an error that lasts for a batch or longer changes the momentum that is carried on, which noise does not, and 3 to 100
times as much as noise came of it.)

An estimate is corrected by that, with the doubt in the power of stated noise as its sigma.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.cut_wrench import CutWrench
from onboard.dynamics.joint_errors import JointErrors
from onboard.dynamics.kinematics import Bodies, chain_motion, cross
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.spatial import times
from onboard.estimation.arrays import FloatArray
from onboard.estimation.recursive.consistency import NOISE_SIGMA
from onboard.identification.exiddm.prediction.further import PlacedImu
from onboard.identification.exiddm.prediction.ticks import BATCH_TICKS

NOISE_KEY = "noise_rad of the joints"  # what an estimate leans on that is corrected for noise


class NoiseCorrection(NamedTuple):
    """Of k estimates."""

    shift: FloatArray  # (k,)
    sigma: FloatArray  # (k,) of that, all of them together

    @property
    def covariance(self) -> FloatArray:
        """(k, k)."""
        return np.outer(self.sigma, self.sigma)


def correction_of(covariance: FloatArray, added: FloatArray) -> NoiseCorrection:
    """For the noise of the joints.

    Args:
        covariance: of k estimates with all p parameters, (k, p).
        added: what it adds to the gradient, (p,).
    """
    shift = covariance @ added
    return NoiseCorrection(shift, NOISE_SIGMA * shift)


def in_turn(sigma: FloatArray, at_a_time: int, begin: int) -> FloatArray:
    """Errors of one joint's rate or acceleration at each tick, the next one's after a batch, (n, 2, joints).

    They are so large that their squares, summed over all turns, are those of all errors together.

    Args:
        sigma: (n, 2, joints).
        at_a_time: ticks of a batch.
        begin: the number of the first turn.
    """
    n, turns = len(sigma), sigma[0].size
    at, turn = np.arange(n), (begin + np.arange(n) // at_a_time) % turns
    errors = np.zeros((n, turns))
    errors[at, turn] = math.sqrt(turns) * sigma.reshape(n, turns)[at, turn]
    return errors.reshape(sigma.shape)


class JointNoise:
    """Of one vehicle.

    Args:
        vehicle: the model.
        joint_errors: what lies beyond each joint.
        imus: of the base, whose lines come first.
        cells: of the arm, whose lines follow.
        lines: of all instruments.
        free: along which the base moves, of a twist's six.
    """

    def __init__(
        self,
        vehicle: VehicleModel,
        joint_errors: JointErrors,
        imus: Sequence[PlacedImu],
        cells: Sequence[CutWrench],
        lines: Sequence[slice],
        free: Sequence[int] = range(6),
    ) -> None:
        self._vehicle, self._joint_errors = vehicle, joint_errors
        self._imus, self._cells, self._lines, self._free = list(imus), list(cells), list(lines), list(free)

    def of(self, q: FloatArray, chi: FloatArray, *joint_sigma: FloatArray) -> list[FloatArray]:
        """One sigma of it, (n, m), for each of some sigmas of the joints.

        Args:
            q: joint positions, (n, joints).
            chi: standard parameters of all links.
            joint_sigma: of joint rates and accelerations, (n, 2, joints) each.
        """
        if not any(one.any() for one in joint_sigma):
            return [np.zeros((len(q), self._lines[-1].stop)) for _ in joint_sigma]
        squares = self.effect(q[::BATCH_TICKS], chi)[np.arange(len(q)) // BATCH_TICKS] ** 2
        return [np.sqrt(np.einsum("njkm,nkj->nm", squares, one**2)) for one in joint_sigma]

    def effect(self, q: FloatArray, chi: FloatArray) -> FloatArray:
        """Of an error of one in the rate and in the acceleration of each joint, (n, joints, 2, lines)."""
        chain = chain_motion(self._vehicle, q, *np.zeros((2, *q.shape)))
        bodies, S = Bodies.of(chain.links, chi), chain.screws
        momenta = times(self._joint_errors.beyond(bodies).inertia, S)  # (n, joints, 6)
        twist, along = np.zeros_like(momenta), np.ix_(range(len(q)), self._free, self._free)
        inverse = np.asarray(np.linalg.inv(bodies.composite[along]), np.float64).swapaxes(1, 2)
        twist[..., self._free] = -momenta[..., self._free] @ inverse
        effect = np.zeros((*q.shape, 2, self._lines[-1].stop))
        for imu, own in zip(self._imus, self._lines, strict=False):
            force = twist[..., :3] + cross(twist[..., 3:], imu.p_BoSo_B)
            effect[:, :, 0, own.start : own.start + 3] = twist[..., 3:] @ imu.R_BS
            effect[:, :, 1, own.start + 3 : own.stop] = force @ imu.R_BS
        for cut, own in zip(self._cells, self._lines[len(self._imus) :], strict=False):
            effect[:, :, 1, own.start] = cut.of_joint_accelerations(bodies, S, twist)
        return effect
