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

The effect is computed in ``onboard/native/src/noise.c``, of one tick in each batch.
"""

import ctypes
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.cut_wrench import CutWrench
from onboard.dynamics.joint_errors import JointErrors
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.estimation.recursive.consistency import NOISE_SIGMA
from onboard.identification.exiddm.prediction.further import PlacedImu
from onboard.identification.exiddm.prediction.ticks import BATCH_TICKS
from onboard.native import library, structures

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
        self._joints, self._links, self._lines = len(vehicle.joints), len(vehicle.links), lines[-1].stop
        frames, moves = np.array([np.append(one.R_BS, one.p_BoSo_B) for one in imus]), np.zeros(6)
        moves[list(free)] = 1.0
        parts = vehicle.tree.compiled, joint_errors.beyond_links, frames, moves
        self._compiled, self._cuts = structures.NoiseStruct(len(imus), len(cells), self._lines, *parts), list(cells)

    def of(self, q: FloatArray, chi: FloatArray, *joint_sigma: FloatArray) -> list[FloatArray]:
        """One sigma of it, (n, m), for each of some sigmas of the joints.

        Args:
            q: joint positions, (n, joints).
            chi: standard parameters of all links.
            joint_sigma: of joint rates and accelerations, (n, 2, joints) each.
        """
        if not any(one.any() for one in joint_sigma):
            return [np.zeros((len(q), self._lines)) for _ in joint_sigma]
        n, count, joints = len(q), len(joint_sigma), self._joints
        sigma = [library.given(one, n, 2, joints) for one in joint_sigma]
        given = library.given(q, n, joints), library.given(chi, 10 * self._links), np.stack(sigma)
        cuts = library.pointers([cut.compiled for cut in self._cuts])
        errors = library.pointers([cut.errors.compiled for cut in self._cuts])
        numbers, pointers = (n, BATCH_TICKS, count), (library.address(part) for part in given)
        arguments = cuts, errors, *numbers, *pointers
        out = np.empty((count, n, self._lines))
        return list(library.call("heft_joint_noise", ctypes.byref(self._compiled), *arguments, out=out))
