"""What the noise of the joints does to a prediction, and to an estimate.

From the momentum equation of :mod:`onboard.dynamics.free_flight` with eta = 0: the error of the base's twist is
``-C^-1 M`` times that of the joint rates, the error of its acceleration the same times that of the joint accelerations.
Products of rates are neglected.

The noise is in a prediction and in its derivatives alike (errors in variables). With E(x) what errors of the joints do
to a tick's lines, over their noise (:class:`LineNoise`), it adds ``g = sum (dE/dx)' E`` to the gradient ``J' r`` of
predicted less measured, and ``N = sum (dE/dx)' (dE/dx)`` to its information (Fuller, Measurement Error Models, 1987,
section 3.2): an estimate is off, mostly towards a light payload. The errors are those of the joints' samples as they
are, without an inflation. The products are taken of predictions with errors of all joints at once, of which those of
two joints cancel (:func:`at_once`). The functions of an encoder's cyclic errors have the noise too, as they are of the
angle that is read: without them, forces moved a payload by twice what it was off by. An error of a rate that lasts
would turn the momentum that is carried on, which noise does not: a payload that was off by none moved by 10 sigmas.

What is estimated without it is the root of an unbiased estimating equation: the gradient less g, of which the slopes
are ``K = H - N``, H the information of the lines, and of which the covariance is

    V = K + c N + NOISE_SIGMA^2 g g'

c by what products of noise scatter more than their mean (:attr:`NoiseAdded.scattering`), the last term by the doubt in
the power of stated noise. The lines then tell as much as ``K V^-1 K``: the information of an estimating equation
(Godambe, An optimum property of regular maximum likelihood estimation, 1960), the inverse of the sandwich covariance.
g is that at the estimate as it is now, ``g_k + N_k (x - x_k)`` of a batch k whose estimate was x_k: taken as it was,
a payload that is right "changed" after its estimate had moved.

Mean and covariance are those of the prior with a Gaussian likelihood of this information, so that they are a pair that
evidence can be computed of. Along a direction of which nearly all information is noise both go back to the prior.
In a whole flight, where steps are weighed by the gradients of its blocks, the mean is the root itself, prior and lines
together, and its covariance ``(1 - P N)^-1 (P + (c - 1) P N P) (1 - N P)^-1`` (:func:`root_of`).

The effect is computed in ``onboard/native/src/noise.c``, of one tick in each batch.

Lines have noise of their own, and that of the joints, one of whose errors is in all lines of a tick. Taken for
independent, along some directions of the payload the gradient scattered by two to four times its variance.
Whitened by a Cholesky root, the first lines stay as they are but for their size: what an IMU's lines have in common
with a cell's is taken off the cell's.
"""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

from onboard.dynamics.cut_wrench import CutWrench
from onboard.dynamics.joint_errors import JointErrors
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import ROUNDING, BoolArray, FloatArray, eigen
from onboard.estimation.recursive.consistency import MOST_NOISE, NOISE_SIGMA
from onboard.identification.evidence.mixture import Known
from onboard.identification.free_flyer.prediction.further import PlacedImu
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS
from onboard.native import library, structures

NOISE_KEY = "noise_rad of the joints"  # what an estimate leans on that is corrected for noise
NOISELESS = 1e-3  # of the variance of a line, or of a parameter's information: what noise below that does is left out

PRODUCT = 2.0  # variance of the product of two equal normal deviates, over that of two independent ones (Isserlis 1918)


class NoiseAdded(NamedTuple):
    """What noise of the joints has added, summed over lines."""

    gradient: FloatArray  # (p,) at the state that it is of: summed over batches, at zero of what lasts
    information: FloatArray  # (p, p); (0, 0): nothing
    scatter: float = 0.0  # by what the gradient's variance is more than the information, over that, summed over ticks
    ticks: int = 0
    of_lines: FloatArray | float = 0.0  # (p,) information of the lines on each by itself, noise in it

    @property
    def scattering(self) -> float:
        """Variance of what it adds to the gradient, over what it adds to the information."""
        return 1.0 + self.scatter / max(self.ticks, 1)

    @staticmethod
    def none(size: int) -> "NoiseAdded":
        """Nothing, of p parameters."""
        return NoiseAdded(np.zeros(size), np.zeros((0, 0)))

    def plus(self, other: "NoiseAdded") -> "NoiseAdded":
        """Both."""
        if not (self.information.size and other.information.size):
            return self if self.information.size else other
        sums = self.gradient + other.gradient, self.information + other.information
        of_lines = self.of_lines + other.of_lines
        return NoiseAdded(*sums, self.scatter + other.scatter, self.ticks + other.ticks, of_lines)

    def moved(self, by: FloatArray) -> "NoiseAdded":
        """The same at a state that is so far away, (p,)."""
        return self._replace(gradient=self.gradient + self.information @ by) if self.information.size else self

    def but_for(self, part: slice, at: FloatArray) -> "NoiseAdded":
        """What it has added to the others, where a part of the state, (p,), is another one from now on."""
        own = np.zeros_like(at)
        own[part] = at[part]
        gradient, information = self.moved(own).gradient.copy(), self.information.copy()
        gradient[part], information[part], information[:, part] = 0.0, 0.0, 0.0
        return self._replace(gradient=gradient, information=information)


class NoiseCorrection(NamedTuple):
    """Of k estimates."""

    shift: FloatArray  # (k,)
    sigma: FloatArray  # (k,) of that, all of them together
    root: FloatArray  # (k, r) of what the covariance is larger by, as there is noise in the information
    most: FloatArray  # (k, s) columns of it, but for those that hardly make it larger

    @property
    def covariance(self) -> FloatArray:
        """What it adds to that of the estimates, (k, k)."""
        return np.outer(self.sigma, self.sigma) + self.root @ self.root.T

    def part(self, which: slice) -> "NoiseCorrection":
        """Of some of them."""
        return NoiseCorrection(*(one[which] for one in self))


def correction_of(
    known: Known, added: NoiseAdded, sigma: FloatArray, released: FloatArray | None = None
) -> NoiseCorrection:
    """For the noise of the joints.

    Args:
        known: mean, (p,), of a prior whose mean is zero, and covariance, (p, p), of all p parameters.
        added: what noise has added.
        sigma: stated, of each, (p,); NaN where nothing is.
        released: root of the information that a wider prior has less than that, (p, r).
    """
    x, P = known
    B, share = _directions(P, added)
    B, share = B[:, counts := share > NOISELESS], share[counts]
    first = P @ added.gradient
    if not len(share):
        return NoiseCorrection(first, NOISE_SIGMA * first, none := np.zeros((len(x), 0)), none)
    noise = first @ B / share  # the gradient is B times this
    G, lines = _of_lines_alone(known, B, share, sigma, released)
    G, Q = eigen(0.5 * (G + G.T))  # shares of noise in the information of the lines alone
    lines, here, noise = Q.T @ lines, Q.T @ (B.T @ x), Q.T @ noise
    B, share = B @ Q, Q.T * share @ Q
    # H - K V^-1 K = B lost B', and K V^-1 times the score is that and B scores: where all is noise, and where it is not
    lost, scores, left, k = np.diag(1.0 / G), -lines / G, noise - here, np.flatnonzero(G < 1.0)
    one = np.eye(len(k))
    V = added.scattering * one + NOISE_SIGMA**2 * np.outer(noise[k], noise[k])
    by = V @ np.linalg.inv(one + G[k, None] * (V - one))
    lost[k[:, None], k] = V + one - (by * G[k]) @ V
    scores[k] = left[k] - by @ (lines[k] + G[k] * left[k])
    more = np.linalg.solve(np.eye(len(G)) - lost @ share, lost)
    more, PB = 0.5 * (more + more.T), P @ B  # the covariance is larger by P B more B' P
    rest = first - PB @ noise
    shift = rest + PB @ (more @ here + scores + more @ (share @ scores))
    doubt, other = np.zeros(len(G)), (noise + B.T @ shift)[k]  # gradient and slopes that another power would add
    doubt[k] = other - by @ (G[k] * other)
    doubt = rest + PB @ (doubt + more @ (share @ doubt))
    values, R = eigen(more)
    root = PB @ R * np.sqrt(np.maximum(values, 0.0))
    most = values * np.einsum("ij,ij->j", R, share @ R) > NOISELESS
    return NoiseCorrection(shift, NOISE_SIGMA * doubt, root, root[:, most])


def _of_lines_alone(
    known: Known, B: FloatArray, share: FloatArray, sigma: FloatArray, released: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """``G = B' H^-1 B``, (r, r), without the prior F F', and B' of the lines' own estimate, (r,).

    By ``H^-1 = P + P F (1 - F' P F)^-1 F' P`` (Woodbury). Arguments: see :func:`correction_of`, :func:`_directions`.
    """
    x, P = known
    has = np.isfinite(sigma) & (sigma > 0.0)
    PF, x_F = P[:, has] / sigma[has], x[has] / sigma[has]
    S = PF[has] / sigma[has, None]
    if released is not None:
        R = _root_less(sigma[has, None] * released[has])
        PF, x_F, S = PF @ R, R @ x_F, R @ S @ R
    Y = PF.T @ B
    left, by = (1.0 + ROUNDING) * np.eye(len(S)) - S, np.column_stack([Y, x_F])  # positive but for rounding
    told, failed = dposv(left, by, lower=True)[1:] if len(S) else (by, 0)
    told = np.linalg.solve(left, by) if failed else told
    return np.diag(share) + Y.T @ told[:, :-1], np.asarray(B.T @ x + Y.T @ told[:, -1], np.float64)


def _root_less(by: FloatArray) -> FloatArray:
    """Symmetric root of one less ``by by'``, which is at most one, (k, k)."""
    taken, V = eigen(by.T @ by)
    V, taken = V[:, some := taken > ROUNDING], taken[some]
    by = by @ V / np.sqrt(taken)
    return np.asarray(np.eye(len(by)) + by * (np.sqrt(np.maximum(1.0 - taken, 0.0)) - 1.0) @ by.T, np.float64)


def root_of(covariance: FloatArray, added: NoiseAdded, sigma: FloatArray) -> NoiseCorrection:
    """To the root of the estimating equation without noise, with the prior: there the blocks' gradients sum to its own.

    Args:
        covariance: of all p parameters, (p, p).
        added: what noise has added.
        sigma: stated, of each, (p,); NaN where nothing is.
    """
    B, share = _directions(covariance, added)
    along = covariance @ B / np.sqrt(share)
    gain = 1.0 / (1.0 - np.minimum(share, MOST_NOISE))
    stated = np.nansum((along / sigma[:, None]) ** 2, axis=0)  # information along each direction before the flight
    scattered = (1.0 + (added.scattering - 1.0) * share) * gain**2 - 1.0
    root = along * np.sqrt(np.where(share < MOST_NOISE, scattered, 1.0 / np.maximum(stated, 1e-12)))
    moved = gain * share * (along.T @ added.gradient)
    shift = covariance @ added.gradient + along @ moved
    doubt = shift + along @ (moved * (1.0 + gain * share))
    return NoiseCorrection(shift, NOISE_SIGMA * doubt, root, root)


def _directions(P: FloatArray, added: NoiseAdded) -> tuple[FloatArray, FloatArray]:
    """B, (p, r), of which ``B B'`` is the information of noise, and ``B' P B``, (r,): its shares in all there is."""
    diagonal = added.information.diagonal()
    counts = (diagonal > NOISELESS * added.of_lines) | (diagonal * P.diagonal()[: len(diagonal)] > NOISELESS)
    at = np.flatnonzero(counts & (diagonal > 0.0))
    values, V = eigen(added.information[at[:, None], at])
    V = V * np.sqrt(np.maximum(values, 0.0))
    share, U = eigen(V.T @ P[at[:, None], at] @ V)
    B = np.zeros((len(P), int((own := share > ROUNDING * share.max(initial=0.0)).sum())))
    B[at] = V @ U[:, own]
    return B, share[own]


def at_once(sigma: FloatArray, first: int) -> FloatArray:
    """Errors of all joints' rates and accelerations, one sigma each, (n, 2, joints), whose products sum to nothing.

    Their signs are Walsh functions (Walsh 1923) of the tick, which change within every two ticks: noise of a rate is
    the change of an angle's, and its sum is next to nothing.

    Args:
        sigma: (n, 2, joints).
        first: number of the first tick.
    """
    tick, every = first + np.arange(len(sigma))[:, None], np.arange(sigma[0].size)
    signs = np.where(np.bitwise_count(tick & (2 * every + 1)) % 2, -1.0, 1.0)
    return np.asarray(signs.reshape(sigma.shape) * sigma, np.float64)


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

    def by_joint(self, q: FloatArray, chi: FloatArray, *joint_sigma: FloatArray) -> list[FloatArray]:
        """What one sigma of each joint's rate and acceleration does, (n, 2 joints, m), for each of some sigmas.

        Args:
            q: joint positions, (n, joints).
            chi: standard parameters of all links.
            joint_sigma: of joint rates and accelerations, (n, 2, joints) each.
        """
        n, joints = len(q), self._joints
        if not any(one.any() for one in joint_sigma):
            return [np.zeros((n, 2 * joints, self._lines)) for _ in joint_sigma]
        at = library.given(q, n, joints)[::BATCH_TICKS].copy()
        cuts = library.pointers([cut.compiled for cut in self._cuts])
        errors = library.pointers([cut.errors.compiled for cut in self._cuts])
        given = at, library.given(chi, 10 * self._links)
        arguments = cuts, errors, len(at), *(library.address(part) for part in given)
        out = np.empty((len(at), joints, 2, self._lines))
        library.call("heft_joint_noise", ctypes.byref(self._compiled), *arguments, out=out)
        effects = out.reshape(len(at), 2 * joints, -1).repeat(BATCH_TICKS, axis=0)[:n]
        sigmas = (library.given(one, n, 2, joints).swapaxes(1, 2).reshape(n, -1, 1) for one in joint_sigma)
        return [effects * sigma for sigma in sigmas]


class LineNoise(NamedTuple):
    """Of n ticks and m lines."""

    sigma: FloatArray  # (n, m) all together
    by_joint: FloatArray  # (n, 2 joints, m) by one sigma of each joint's rate and acceleration

    @staticmethod
    def of(own: FloatArray, by_joint: FloatArray) -> "LineNoise":
        """Of that of each line by itself, (n, m), and that of the joints."""
        return LineNoise(np.hypot(own, sigma_of(by_joint)), by_joint)

    @staticmethod
    def alone(sigma: FloatArray) -> "LineNoise":
        """Of lines that have nothing in common, (n, m)."""
        return LineNoise(sigma, np.zeros((len(sigma), 0, sigma.shape[1])))

    def part(self, which: slice) -> "LineNoise":
        """Of some ticks."""
        return LineNoise(self.sigma[which], self.by_joint[which])

    def together(self, use: BoolArray) -> FloatArray:
        """Covariance of a tick's lines over their sigmas, (n, m, m); those not in use, (n, m), are by themselves."""
        share = np.divide(self.by_joint, self.sigma[:, None], out=np.zeros(self.by_joint.shape), where=use[:, None])
        covariance = share.swapaxes(1, 2) @ share
        at = np.arange(self.sigma.shape[1])
        covariance[:, at, at] = 1.0
        return np.asarray(covariance, np.float64)

    def whitening(self, use: BoolArray) -> FloatArray:
        """What the lines of a tick are multiplied by, (n, m, m); zero of those not in use, (n, m)."""
        inverse = np.linalg.inv(np.linalg.cholesky(self.together(use)))
        return np.divide(inverse, self.sigma[:, None], out=np.zeros_like(inverse), where=use[:, None] & use[:, :, None])


def sigma_of(by_joint: FloatArray) -> FloatArray:
    """Of each line, (n, m), by what one sigma of each joint does to it, (n, 2 joints, m)."""
    return np.asarray(np.sqrt(np.einsum("njm,njm->nm", by_joint, by_joint)), np.float64)
