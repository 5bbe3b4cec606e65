"""What the noise of the joints does to a prediction, and to an estimate.

From the momentum equation of :mod:`onboard.dynamics.free_flight` with eta = 0: the error of the base's twist is
``-C^-1 M`` times that of the joint rates, the error of its acceleration the same times that of the joint accelerations.
Products of rates are neglected.

The noise is in a prediction and in its derivatives alike (errors in variables). With E(x) what one error of a joint
does to a line of sigma R, it adds ``sum (dE/dx)' s^2 E / R^2`` to the gradient ``J' r`` of predicted less measured, and
an estimate of covariance P is off by -P times that (Fuller, Measurement Error Models, 1987, section 3.2), mostly
towards a light payload. s is the noise of the joints' samples as it is, without an inflation. Every product is taken of
predictions with an error of one joint's rate or acceleration, each in its turn. The functions of an encoder's cyclic
errors have it too, as they are of the angle that is read: without them, forces moved a payload by twice what it was off
by. An error of a rate that lasts would turn the momentum that is carried on, which noise does not: a payload that was
off by none moved by 10 sigmas.

An estimate is corrected by that, with the doubt in the power of stated noise as its sigma. The noise is in the
information too, where it adds ``N = sum (dE/dx)' s^2 (dE/dx) / R^2``, and so in the gradient at the corrected estimate:
the correction is ``(1 - P N)^-1 P`` times that of the gradient, and the covariance ``(1 - P N)^-1 P (1 - N P)^-1``.
A direction of which nearly all information is noise is known by what is stated alone.

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
from onboard.estimation.recursive.consistency import MOST_NOISE, NOISE_SIGMA
from onboard.identification.free_flyer.prediction.further import PlacedImu
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS
from onboard.native import library, structures

NOISE_KEY = "noise_rad of the joints"  # what an estimate leans on that is corrected for noise
NOISELESS = 1e-3  # of the variance of a line, or of a parameter's information: what noise below that does is left out


class NoiseAdded(NamedTuple):
    """What noise of the joints has added, summed over lines."""

    gradient: FloatArray  # (p,)
    information: FloatArray  # (p, p); (0, 0): nothing

    @staticmethod
    def none(size: int) -> "NoiseAdded":
        """Nothing, of p parameters."""
        return NoiseAdded(np.zeros(size), np.zeros((0, 0)))

    def plus(self, other: "NoiseAdded") -> "NoiseAdded":
        """Both."""
        if not (self.information.size and other.information.size):
            return self if self.information.size else other
        return NoiseAdded(self.gradient + other.gradient, self.information + other.information)

    def but_for(self, part: slice) -> "NoiseAdded":
        """What it has added to the others, where a part of the state is another one from now on."""
        gradient, information = self.gradient.copy(), self.information.copy()
        gradient[part], information[part], information[:, part] = 0.0, 0.0, 0.0
        return NoiseAdded(gradient, information)


class NoiseCorrection(NamedTuple):
    """Of k estimates."""

    shift: FloatArray  # (k,)
    sigma: FloatArray  # (k,) of that, all of them together
    root: FloatArray  # (k, r) of what the covariance is larger by, as there is noise in the information

    @property
    def covariance(self) -> FloatArray:
        """What it adds to that of the estimates, (k, k)."""
        return np.outer(self.sigma, self.sigma) + self.root @ self.root.T

    def part(self, which: slice) -> "NoiseCorrection":
        """Of some of them."""
        return NoiseCorrection(*(one[which] for one in self))


def correction_of(covariance: FloatArray, added: NoiseAdded, sigma: FloatArray) -> NoiseCorrection:
    """For the noise of the joints.

    Args:
        covariance: of all p parameters, (p, p).
        added: what noise has added.
        sigma: stated, of each, (p,); NaN where nothing is.
    """
    diagonal = added.information.diagonal()
    at = np.flatnonzero(diagonal * covariance.diagonal()[: len(diagonal)] > NOISELESS)
    values, V = np.linalg.eigh(added.information[np.ix_(at, at)])
    B = V * np.sqrt(np.maximum(values, 0.0))
    across = covariance[:, at] @ B
    share, U = np.linalg.eigh(B.T @ across[at])
    known = (share := np.maximum(share, 0.0)) < MOST_NOISE
    along, gain = across @ U, 1.0 / (1.0 - np.minimum(share, MOST_NOISE))
    stated = np.nansum((along / sigma[:, None]) ** 2, axis=0)  # information along each direction before the flight
    more = np.where(known, gain * (2.0 + gain * share), 1.0 / np.maximum(stated, 1e-12))

    def without(x: FloatArray) -> FloatArray:
        return np.asarray(x + along @ (gain * (U.T @ (B.T @ x[at]))), np.float64)

    shift = without(covariance @ added.gradient)
    return NoiseCorrection(shift, NOISE_SIGMA * without(shift), along * np.sqrt(more))


def in_turn(sigma: FloatArray, at_a_time: int, begin: int) -> FloatArray:
    """Errors of one joint's rate or acceleration at each tick, the next one's after a batch, (n, 2, joints).

    They are so large that their squares, summed over all turns, are those of all errors together, and change their sign
    in the middle of a batch: noise of a rate is the change of an angle's, and its sum is next to nothing.

    Args:
        sigma: (n, 2, joints).
        at_a_time: ticks of a batch.
        begin: the number of the first turn.
    """
    n, turns = len(sigma), sigma[0].size
    at, turn = np.arange(n), (begin + np.arange(n) // at_a_time) % turns
    errors = np.zeros((n, turns))
    size = np.where(2 * (at % at_a_time) < at_a_time, math.sqrt(turns), -math.sqrt(turns))
    errors[at, turn] = size * sigma.reshape(n, turns)[at, turn]
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
