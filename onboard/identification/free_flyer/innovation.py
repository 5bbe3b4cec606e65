"""Whitened innovations of a batch of ticks, and tests of these and of the corrections that they make.

Innovations have the covariance ``S = H P H' + 1 = L L'``, lines by instrument (see ``fusion``).

Their misfit by instrument is chi-squared over its degrees of freedom, 1 for a consistent filter. There are two values
per instrument since the last window: the mean over all batches, and the worst block of batches as far as it exceeds
chance. A fault that the filter adapts to causes large innovations for a short time only, which a mean over a flight
hides. ``misfit_by_instrument`` of a whole flight, whose blocks are given and of any size, uses the same
:func:`beyond_chance`; here blocks are cut as batches come, and only their sums are kept.

The filter's corrections are held against their stated sigmas, once for each state: each by itself, except constants
that the bank of hypotheses covers in every direction; and all together.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dtrtrs
from scipy.special import chdtri

from onboard.estimation.arrays import SINGULAR, BoolArray, FloatArray, IndexArray
from onboard.estimation.errors import SingularError
from onboard.estimation.maximum_likelihood import OPEN
from onboard.estimation.policy import DOUBT, of_each
from onboard.identification.corrections import DOUBTFUL, Together, expected_sigma, refused_from, together
from onboard.identification.evidence.bank import Weighed
from onboard.identification.evidence.mixture import Known
from onboard.identification.free_flyer.fusion import Accusation, Fusion
from onboard.identification.free_flyer.prediction.further import OF_FRICTION, FurtherCell
from onboard.identification.free_flyer.prediction.imu_prediction import DRIFT_MEMORY_s, ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import LineNoise, NoiseCorrection
from onboard.identification.free_flyer.prediction.ticks import TickPrediction
from onboard.identification.free_flyer.suspects import Believed, Rivals

_BLOCK = 600  # degrees of freedom; a mean over them scatters by 6 %
_BLOCKS = 1e4  # of an hour: one a second of each of three instruments


def beyond_chance(squares: float, freedom: int) -> float:
    """A chi-squared sum over what a block of an hour exceeds by chance: above 1, it counts."""
    return squares / float(chdtri(freedom, of_each(DOUBT, _BLOCKS)))


class InnovationMisfit:
    """Sums of squares of whitened innovations by instrument."""

    def __init__(self) -> None:
        self._sums: dict[str, tuple[float, int]] = {}
        self._blocks: dict[str, tuple[float, int]] = {}
        self._worst: dict[str, float] = {}

    def forget(self) -> None:
        """Clear the sums after a reset of the filter."""
        self._sums, self._blocks, self._worst = {}, {}, {}

    def add(self, instrument: str, squares: float, freedom: int) -> None:
        """Takes in one batch: ``r' S^-1 r`` of an instrument's innovation r, and the number of elements of r."""
        total, seen = self._sums.get(instrument, (0.0, 0))
        self._sums[instrument] = total + squares, seen + freedom
        total, seen = self._blocks.get(instrument, (0.0, 0))
        block = total + squares, seen + freedom
        if block[1] >= _BLOCK:
            self._worst[instrument] = max(self._worst.get(instrument, 0.0), beyond_chance(*block))
            block = 0.0, 0
        self._blocks[instrument] = block

    def by_instrument(self) -> Mapping[str, float]:
        """The larger of mean and worst block, expected 1; empty before the first batch."""
        return {
            instrument: max(total / freedom, self._worst.get(instrument, 0.0))
            for instrument, (total, freedom) in self._sums.items()
        }


_MOST_TOLD = 256  # batches whose errors wait to be taken out


class TickBatch(NamedTuple):
    """Ticks of a batch."""

    predicted: TickPrediction
    measured: FloatArray  # (b, lines)
    noise: LineNoise
    time_s: FloatArray  # (b,)
    correction: NoiseCorrection  # of the state


class ReferenceErrors(NamedTuple):
    """Prediction errors of the reference IMU, (b, 6): gyro, accelerometer."""

    time_s: FloatArray  # (b,)
    error: FloatArray  # measured less predicted
    sigma: FloatArray  # of the error; NaN where it was not measured
    used: BoolArray  # (b,)


class Innovation(NamedTuple):
    """Of a batch; lines that were not measured are zero."""

    W: FloatArray  # L^-1 H P
    e: FloatArray  # L^-1 (measured less predicted)
    L: FloatArray
    steps: FloatArray  # L^-1 H D, (lines, m): what steps in flight would add
    corrected_e: FloatArray  # ``e`` at the state from which what noise of the joints has done is taken out
    doubt: FloatArray  # L^-1 H C, (lines, r), C a root of what its covariance is larger by than the filter's
    ticks: int

    def judged(self, step: Believed | None) -> "Innovation":
        """With ``e`` and ``L`` of what is to be tested: without noise of the joints, and given a step not followed."""
        H, e = self.doubt, self.corrected_e
        if step is not None:
            G = self.steps[:, [*step.which]]
            H, e = np.hstack([H, G @ step.root]), e - G @ step.size
        if not H.size:
            return self
        K = np.linalg.cholesky(np.eye(len(H)) + H @ H.T)
        return self._replace(e=dtrtrs(K, e, lower=True)[0], L=self.L @ K)

    def first(self, lines: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """``W``, ``corrected_e`` and ``steps`` of so many lines."""
        return self.W[:lines], self.corrected_e[:lines], self.steps[:lines]

    def corrected(self, lines: int, state: FloatArray, covariance: FloatArray) -> Known:
        """State, (p,), and covariance, (p, p), with so many lines taken in."""
        W, e = self.W[:lines], self.e[:lines]
        less = W.T @ W
        return state + W.T @ e, np.subtract(covariance, less, out=less)

    @property
    def of_reference(self) -> FloatArray:
        """``e`` of the reference IMU, which comes first, (b, 6)."""
        return self.e[: 6 * self.ticks].reshape(-1, 6)


class Innovations:
    """Makes and judges the innovations of one filter.

    Args:
        predictor: of its instruments.
        fusion: which of them it uses.
        rivals: what may not be as stated; its constants are not held against what is stated one by one.

    Attributes:
        told: errors of the batches since they were last taken out.
    """

    def __init__(self, predictor: ImuPredictor, fusion: Fusion, rivals: Rivals) -> None:
        self._fusion, self._predictor, self._lines, self._rivals = fusion, predictor, predictor.lines, rivals
        self._steps = rivals.steps
        self.told: deque[ReferenceErrors] = deque(maxlen=_MOST_TOLD)
        each_alone = (predictor.of_each[0], *predictor.of_further)  # held against one by one
        self._alone = [np.setdiff1d(each, rivals.at) for each in each_alone]
        self._farthest = refused_from(sum(len(each) for each in self._alone))
        self._friction = {  # of torques: what it is multiplied by cannot be negative
            k: [at for at in predictor.of_each[k] if predictor.names[at].startswith(OF_FRICTION)]
            for k, one in enumerate(predictor.further, 1)
            if isinstance(one, FurtherCell) and one.friction is not None
        }

    def of(self, batch: TickBatch, there: BoolArray, order: Sequence[int], covariance: FloatArray) -> Innovation:
        """Of a batch's lines, those of each instrument together.

        Args:
            batch: the ticks.
            there: which lines are to be used, (b, lines).
            order: of the instruments.
            covariance: of the state, (p, p).

        Raises:
            SingularError: no motion follows from the state, or the noise of the measurements is lost in the rounding of
                what its covariance makes of them, or the covariance is none any more.
        """
        if not batch.predicted.moderate:
            raise SingularError("the joints' signals are nonsense; no motion follows")
        rows, p = self._fusion.rows(order, len(there)), len(covariance)
        r = (batch.measured - batch.predicted.values) / batch.noise.sigma
        H = batch.predicted.jacobian.reshape(r.size, p).take(rows, 0)
        H /= batch.noise.sigma.ravel()[rows, None]
        if not there.all():
            r[~there], H[~there.ravel()[rows]] = 0.0, 0.0
        steps = self._steps.changed.D
        columns = np.hstack([steps, batch.correction.shift[:, None], batch.correction.most])
        known = np.empty((p + 1 + columns.shape[1], r.size))  # transposed: LAPACK's order
        PH = np.matmul(covariance, H.T, out=known[:p])
        known[p] = r.ravel()[rows]
        np.matmul(columns.T, H.T, out=known[p + 1 :])
        S = H @ PH
        at = np.argsort(rows).reshape(r.shape)
        S[at[:, :, None], at[:, None]] += batch.noise.together(there)
        if not S.diagonal().max() < SINGULAR:  # as with NaN
            raise SingularError("the state says nothing of what is measured; it has to be estimated anew")
        try:
            L = np.asarray(np.linalg.cholesky(S), np.float64)
        except np.linalg.LinAlgError as error:
            raise SingularError("the state's covariance is none any more; it has to be estimated anew") from error
        solved = dtrtrs(L.T, known.T, lower=False, trans=True, overwrite_b=True)[0]
        e, end = solved[:, p], p + 1 + steps.shape[1]
        of_steps, moved, doubt = solved[:, p + 1 : end], solved[:, end], solved[:, end + 1 :]
        return Innovation(solved[:, :p], e, L, of_steps, e - moved, doubt, len(there))

    def agreeing(
        self,
        batch: TickBatch,
        there: BoolArray,
        covariance: FloatArray,
        both: tuple[Innovation, Innovation],
        misfit: InnovationMisfit,
        step: Believed | None,
    ) -> tuple[Innovation, int]:
        """Innovation with instruments that contradict those before them at the end, and how many lines to use.

        ``both``: it and, of it, what is to be tested.
        """
        fusion, order, refused = self._fusion, self._fusion.order, list[int]()
        innovation, judged = both
        while (bad := fusion.improbable(order, judged.e, there, refused)) is not None:
            refused.append(bad)
            if bad not in fusion.left_out:
                order = [k for k in order if k != bad] + [bad]
                innovation = self.of(batch, there, order, covariance)
                judged = innovation.judged(step)
        seen = np.array([there[:, own].any() for own in self._lines])
        used = 0
        for k in order:
            if k in refused or k in fusion.left_out:
                continue
            own = self._lines[k]
            first, used = used, used + len(there) * (own.stop - own.start)
            if k != fusion.reference and seen[k]:
                e = judged.e[first:used]
                misfit.add(fusion.names[k], float(e @ e), int(there[:, own].sum()))
        fusion.judged(refused, seen)
        return innovation, used

    def contradicting(self, state: FloatArray, covariance: FloatArray) -> Accusation | None:
        """An instrument in use that contradicts the others.

        Args:
            state: (p,) after a batch.
            covariance: of that.
        """
        fusion, predictor = self._fusion, self._predictor
        if (refused := fusion.refused) is not None:
            misled = refused.instrument in fusion.imus and self.misled(state)
            return refused._replace(batches=0) if misled else refused
        stated, too_far = stated_after(predictor, fusion.running_s), self._rivals.weighed(state, covariance).too_far
        for k, own in enumerate(self._alone):
            if k in fusion.left_out or fusion.imus == [k]:
                continue
            beyond = (np.abs(state[own]) > self._farthest * stated[own]).any() or self._drives(k, state, covariance)
            if beyond or fusion.names[k] == too_far:
                return Accusation(k, 0, for_good=True)
        return None

    def _drives(self, torque: int, state: FloatArray, covariance: FloatArray) -> bool:
        """Whether the friction or the rotor's inertia of a joint's torque is negative by more than chance."""
        at = self._friction.get(torque)
        return at is not None and bool((state[at] < -self._farthest * np.sqrt(covariance[at, at])).any())

    def misled(self, state: FloatArray) -> bool:
        """Whether a correction is larger than stated: an instrument has been wrong for longer than it shows.

        Args:
            state: (p,); what is left out does not count.
        """
        stated = stated_after(self._predictor, self._fusion.running_s)
        known = np.isfinite(stated) & (stated > 0.0)
        known[self._rivals.freed_at] = False  # taken for far less certain than stated
        for k in self._fusion.left_out:
            known[self._predictor.of_each[k]] = False
        return bool((np.abs(state[known]) > DOUBTFUL * stated[known]).any())

    def freed(self, prior: tuple[FloatArray, FloatArray], instrument: int | None) -> tuple[FloatArray, FloatArray]:
        """A mean, (p,), and covariance, (p, p), with errors of an instrument, if one is named, of any size."""
        mean, covariance = prior
        if instrument is not None:
            at, covariance = self._predictor.of_each[instrument], covariance.copy()
            covariance[at, at] += (OPEN * self._predictor.sigma[at]) ** 2
        return mean, covariance

    def of_batch(self, batch: TickBatch, there: BoolArray, covariance: FloatArray) -> Innovation:
        """The first of a batch, which is reported: nothing is left out of it yet; see :meth:`of`."""
        innovation = self.of(batch, there, self._fusion.order, covariance)
        own, lines = self._lines[self._fusion.reference], 6 * innovation.ticks
        L, sigma = innovation.L[:lines, :lines], batch.noise.sigma[:, own]
        wide = np.where(there[:, own], np.sqrt(np.einsum("ij,ij->i", L, L)).reshape(-1, 6) * sigma, np.nan)
        error = (batch.measured - batch.predicted.values)[:, own]
        self.told.append(ReferenceErrors(batch.time_s, error, wide, there[:, own.start].copy()))
        return innovation

    def judge(self, innovation: Innovation, there: BoolArray, misfit: InnovationMisfit) -> FloatArray:
        """Add chi-squared of the reference IMU, of each of its instruments and of both together, to the misfit.

        Returns:
            The reference's whitened innovation at the ticks that were used, gyro then accelerometer, (6 u,).
        """
        if self.told:
            self.told[-1].used[:] = there[:, self._lines[self._fusion.reference].start]
        lines = 6 * innovation.ticks
        rows = np.arange(lines).reshape(-1, 6)[there[:, self._lines[self._fusion.reference].start]]
        e = innovation.e[rows.ravel()]
        if not rows.size:
            return e
        misfit.add(self._fusion.names[self._fusion.reference], float(e @ e), e.size)
        for instrument, own in (("gyro", rows[:, :3].ravel()), ("accelerometer", rows[:, 3:].ravel())):
            L = innovation.L[own, :lines]
            r = L @ innovation.e[:lines]
            misfit.add(instrument, float(r @ np.linalg.solve(L @ L.T, r)), r.size)
        return e


class Corrections(NamedTuple):
    """Corrections of what is in use, in two measures."""

    known: IndexArray  # places in the state of those with a stated sigma, of which each is held
    in_stated: FloatArray  # their sizes in these
    steady: IndexArray  # places of those of them that do not change during the flight
    in_told: FloatArray  # their sizes in sigmas of what the data tell of each
    at_once: Together  # all that do not change, the weighed ones too


class HeldAgainst:
    """Holds the corrections against what is stated.

    Args:
        predictor: states it.
        fusion: what is in use.
        weighed: places in the state of what is not to be held against anything one by one.
    """

    def __init__(self, predictor: ImuPredictor, fusion: Fusion, weighed: IndexArray) -> None:
        self._predictor, self._fusion, self._weighed = predictor, fusion, weighed
        self._of: tuple[Weighed, list[int]] | None = None
        self._told: Corrections | None = None

    def of(self, weighed: Weighed) -> Corrections:
        """The corrections if the likeliest hypothesis is true, but of what it says is wrong."""
        left_out, of = self._fusion.left_out, self._of
        if self._told is None or of is None or of[0] is not weighed or of[1] != left_out:
            self._of, self._told = (weighed, [*left_out]), self._hold(weighed)
        return self._told

    def _hold(self, weighed: Weighed) -> Corrections:
        (state, covariance), suspect = weighed.known(weighed.likeliest), weighed.likeliest.suspect
        predictor, stated = self._predictor, stated_after(self._predictor, self._fusion.running_s)
        known = np.isfinite(stated) & (stated > 0.0)
        for k in self._fusion.left_out:
            known[predictor.of_each[k]] = False
        if suspect is not None:
            known[suspect.at] = False
        steady = known.copy()
        steady[[*(k for pair in predictor.biases for k in pair), *(k for k, _ in predictor.wandering)]] = False
        at = steady.nonzero()[0]
        sigma, P = stated[at], covariance.take(at, 0).take(at, 1)
        P /= sigma[:, None] * sigma
        in_all = together(state[at] / sigma, P)
        known[self._weighed] = steady[self._weighed] = False
        every, each = known.nonzero()[0], steady.nonzero()[0]
        in_told = state[each] / expected_sigma(stated[each] ** 2, covariance[each, each])
        return Corrections(every, state[every] / stated[every], each, in_told, in_all)


def stated_after(predictor: ImuPredictor, time_s: float) -> FloatArray:
    """What is stated of all constants after so long a flight, (p,): a bias drifts by its drift's sigma all the time."""
    stated, (biases, drifts) = predictor.stated.copy(), np.array(predictor.biases, np.intp).reshape(-1, 2).T
    stated[biases] = np.hypot(predictor.sigma[biases], max(time_s, DRIFT_MEMORY_s) * predictor.sigma[drifts])
    return stated
