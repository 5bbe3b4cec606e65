"""Hypotheses of errors of an arm on a fixed base, and the answer under each.

The answer is theirs once something is likelier wrong, and explains all rows: with it no more is left over than is
doubted of noise. Else there is no answer where a share of the rows contradicts the others, and the likeliest hypotheses
are named.

All suspects (:mod:`onboard.identification.rows.checks.suspected`) compete with "as stated" in one bank
(:mod:`onboard.identification.evidence.bank`), whose state is z: the errors of the prior, ``beta = beta_0 + G L z``, and
those of instruments, each over its stated sigma. z is found by Gauss and Newton about the likeliest hypothesis, since
gains multiply masses and angles turn gravity. The noise of each row is the residual of that hypothesis, no smaller than
stated. Equations are the sums over all rows (:mod:`onboard.identification.rows.stated_errors.all_rows`), and what these
are beyond linear where angles are likelier wrong (:mod:`onboard.identification.rows.checks.beyond_linear`). Where that
explains nothing, and all as stated leaves more over than noise, they are rows of kept ticks that are made again
(:mod:`onboard.identification.rows.checks.remade`), those included that the recursion refuses. These have errors that
the sums do not have, of delays, steps, mounts, and angles that are far off. Where by the sums nothing is likelier
wrong, but what is stated had to be taken wider (:mod:`onboard.identification.rows.stated_errors.stated`), they answer,
too, where no more than noise is left over, or to refuse: a gripper that is heavier than it was weighed is to most
motions the same as cells that all read too much.

The answer is the mixture of all hypotheses that count, each with the mean and covariance that it has by these rows, in
place of the recursion's. Where another hypothesis is likeliest than when they were weighed before, it is a mixture of
both answers.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from onboard.dynamics.model.errors import SignalError
from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray
from onboard.estimation.policy import (
    AGAIN,
    MISFIT_PART,
    MISFIT_REFUSED,
    MOSTLY,
    contradicted_text,
)
from onboard.estimation.recursive.rls import SquareRootRls
from onboard.identification.evidence.bank import Hypothesis, Weighed
from onboard.identification.evidence.mixture import Known, Mixture
from onboard.identification.rows.checks.agreement import MOST_UNEXPLAINED
from onboard.identification.rows.checks.beyond_linear import BeyondLinear
from onboard.identification.rows.checks.gravity import judged_gravity
from onboard.identification.rows.checks.remade import KeptTicks, RowsRemade, SmoothedTicks
from onboard.identification.rows.checks.suspected import ErrorState
from onboard.identification.rows.checks.tick_rows import Shares, TickRows
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.all_rows import ROUNDS, SETTLED, explained
from onboard.identification.rows.stated_errors.considered import Considered, ConsideredErrors, rate_of
from onboard.identification.rows.stated_errors.equations import ErrorEquations
from onboard.identification.rows.stated_errors.stated import Taken
from onboard.identification.windows import SHORTEST
from onboard.regressor.base_parameters import BaseParameters
from onboard.regressor.rows import RowModel
from onboard.regressor.signals import Signals


class _Estimated(Protocol):
    """What is weighed of a recursion."""

    seen: RowBlocks
    errors: ConsideredErrors

    @property
    def rls(self) -> SquareRootRls: ...
    @property
    def correlation(self) -> float: ...
    @property
    def taken(self) -> Taken: ...


class RowSuspects:
    """Hypotheses about one model's rows.

    Args:
        model: the rows, of a fixed base.
        base: their base parameters.
        prior_root: L of the prior covariance of the standard parameters, (P, P).
        considered: errors that the recursion considers.
        gravity_m_s2: of the place, where an IMU reads it of the base.

    Attributes:
        weighed: the hypotheses, once there are rows enough.
        answer: the base parameters by all hypotheses that count.
        unseen: while all as stated is likeliest, of each other that counts its probability, and what it does to
            the mean of the base parameters, (p,), and adds to their covariance, (p, r), as a root.
        explains: whether something is likelier wrong than all as stated, and all rows are explained by it.
    """

    def __init__(
        self,
        model: RowModel,
        base: BaseParameters,
        prior_root: FloatArray,
        considered: Sequence[Considered],
        gravity_m_s2: float = 0.0,
    ) -> None:
        self._gravity_m_s2, self._considered = gravity_m_s2, considered
        self._errors = errors = ErrorState(model, base, prior_root, considered)
        self._of_all_rows = ErrorState(model, base, prior_root, considered, remade=False)
        self._remade = RowsRemade(model, base, errors.of_instruments)
        self._all_remade = RowsRemade(model, base, self._of_all_rows.of_instruments)
        self._kept, self._rows, self._weighed_at = KeptTicks(), np.zeros(2), np.zeros(2)
        self._half, self._centre, self._n = errors.half(prior_root), errors.centre, errors.parameters
        self._of_weighed = errors
        self._names = [row.name for row in model.rows]
        self.weighed: Weighed | None = None
        self._left: Shares | None = None
        self.answer: Mixture | None = None
        self.unseen: tuple[tuple[float, FloatArray, FloatArray], ...] = ()
        self._before: tuple[str, Mixture] | None = None  # likeliest of the last weighing, and the answer by it alone
        self.explains, self._misfit = False, math.inf  # with all as stated

    @property
    def of_gravity(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Reasons to refuse all estimates, and to doubt them, by how much of it an IMU reads."""
        if self._kept.ticks is None or not self._gravity_m_s2:
            return (), ()
        return judged_gravity(self._kept.ticks.force, self._gravity_m_s2, self._considered)

    @property
    def explanation(self) -> str:
        """What is likelier wrong than all as stated; empty where nothing is, or much is left over with it of others."""
        if self.weighed is None:
            return ""
        suspect, errors = self.weighed.likeliest.suspect, self._of_weighed.of_instruments
        own = {errors[k].row for k in suspect.at - self._n if k >= 0} if suspect else set[str]()
        left = self._left is not None and (
            bool(contradicted_text(self._left.far))
            or any(is_most and name not in own for name, _, is_most in self._left_over())
        )
        return "" if left else "".join(sum(self.weighed.judged, ())[:1])

    def _left_over(self) -> Iterator[tuple[str, float, bool]]:
        """Rows of which the likeliest hypothesis leaves much over, the share, and whether it is too much."""
        if self._left is not None:
            for name, share, noise in zip(self._names, self._left.of_read, self._left.noise, strict=True):
                if noise > MISFIT_PART and share > MOSTLY * MOST_UNEXPLAINED:
                    yield name, float(share), bool(share > MOST_UNEXPLAINED)

    def judged(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Reasons to refuse all estimates, and to doubt them."""
        if self.weighed is None:
            return (), ()
        against, doubts = map(list[str], self.weighed.judged)
        if self._left is None:
            return tuple(against), tuple(doubts)
        if contradicted := contradicted_text(self._left.far):
            against.append(contradicted)
        for name, share, is_most in self._left_over():
            (against if is_most else doubts).append(f"{share:.0%} of what {name} reads is left over")
        return tuple(against), tuple(doubts)

    def take(
        self,
        signals: Signals,
        at: IndexArray,
        attached: BoolArray,
        use: BoolArray,
        sigma: FloatArray,
        noise: FloatArray | None = None,
    ) -> None:
        """Takes the rows of ticks in, those too that the recursion's residual gate refuses.

        Args:
            signals: all of them.
            at: ticks, (t,).
            attached: (t,) whether the payload is held.
            use: (t, m) which rows no other gate refuses.
            sigma: of these, with the noise of the motion and as Huber widens it, (r,).
            noise: of the motion, (t, 3 j + 3), see :class:`SmoothedTicks`; none where not given.
        """
        weight = np.zeros(use.shape)
        weight[use] = sigma**-2
        measured = np.where(use, signals.measured[at], 0.0)
        rate = np.zeros_like(measured) if signals.measured_rate is None else signals.measured_rate[at]
        jerk = rate_of(signals, signals.ddq)[at]
        cyclic = np.zeros((len(signals.q), 3, 0)) if signals.cyclic is None else signals.cyclic
        friction = np.zeros((len(signals.q), 0)) if signals.friction is None else signals.friction
        motion = signals.q[at], signals.dq[at], signals.ddq[at], jerk, cyclic[at], friction[at]
        if noise is None:
            noise = np.zeros((len(at), 3 * signals.q.shape[1] + 3))
        rows = attached, measured, np.where(use, rate, 0.0), weight, noise
        self._kept.add(SmoothedTicks(signals.time_s[at], *motion, signals.motion.specific_force_m_s2[at], *rows))
        held = use[attached].sum()
        self._rows += held, use.sum() - held

    def go_on(self, of: _Estimated, contradicted: bool) -> None:
        """Weighs the hypotheses anew where there are a fifth more rows than when they were.

        Args:
            of: the recursion.
            contradicted: whether it leaves out more rows than good data hold that contradict the others. What explains
                the other rows has to explain these, too.
        """
        ticks = self._kept.ticks
        if ticks is None or len(ticks.time_s) < SHORTEST or (self._rows < AGAIN * self._weighed_at + 1.0).all():
            return
        self._weighed_at, mean = self._rows.copy(), of.rls.solve().mean
        self._weigh_all(of, mean, ticks)
        likeliest = self.weighed.names[:1] if self.weighed else ()
        by_all = self.weighed, self.answer, self._of_weighed
        beyond = self._left is not None  # rows, what is linear in the errors of the likeliest
        is_noise = self._misfit <= 1.0 and not (likeliest or contradicted or of.taken.said)
        if not (self.explains or is_noise):
            # of rows that contradict each other the recursion has those that agree with the first
            self._weigh(ticks, self._centre if contradicted else mean, of.correlation)
            self.explains = bool(self.weighed and self.weighed.contradicts) and not self.judged()[0]
            if not (likeliest or contradicted):
                if of.taken.said:  # nothing is likelier wrong, but what is stated is taken wider for these rows
                    self.explains = bool(self.explanation) and (bool(self.judged()[0]) or self._is_noise())
                if not self.explains:
                    (self.weighed, self.answer, self._of_weighed), self._left = by_all, None
        elif contradicted and not beyond:
            self._weigh(ticks, mean, of.correlation)
            self.explains = bool(self.weighed and self.weighed.names[:1] == likeliest) and not self.judged()[0]
            self.answer = by_all[1]
        self._remember()

    def _is_noise(self) -> bool:
        """Whether no more is left over of each row than is doubted of noise, and of how alike it is."""
        return self._left is not None and bool((self._left.noise <= MISFIT_PART * MISFIT_REFUSED).all())

    def _remember(self) -> None:
        """Lets the answer cover that of the weighing before, where another hypothesis was likeliest by that.

        Rows that no hypothesis explains, of a reading that is late for a while, may make any of them likeliest while
        few of these are in. Further rows have to say the same before it answers alone.
        """
        before, self._before = self._before, None
        if self.explains and self.weighed is not None and self.answer is not None:
            suspect = self.weighed.likeliest.suspect
            self._before = suspect.name if suspect else "", self.answer
            if before is not None and before[0] != self._before[0]:
                self.answer = self.answer.or_else(before[1])

    def _weigh(self, ticks: SmoothedTicks, mean: FloatArray, correlation: float) -> None:
        """Weighs the hypotheses by the ticks that are kept.

        Args:
            ticks: these.
            mean: the recursion's estimate with all as stated, (p,): where Gauss and Newton begin.
            correlation: how many neighbouring rows say the same thing.
        """
        half, n = self._half, self._n
        rows = self._rows_of(self._remade, half, self._errors, ticks, correlation)
        about = np.zeros(n + len(self._errors.sigma))
        about[:n] = np.linalg.pinv(half) @ (mean - self._centre)
        noise = np.ones(ticks.weight.shape[1])
        A, b, left = rows.equations(about, noise)
        for further in reversed(range(ROUNDS)):
            P = np.asarray(np.linalg.inv(A + np.eye(len(A))), np.float64)
            weighed = self._errors.bank.weigh((P @ b, P))
            before, louder = about, noise
            about, covariance = weighed.known(weighed.likeliest)
            noise = left.noise(about, noise)
            moved = float((np.abs(about - before) / np.sqrt(np.diag(covariance))).max())
            if not further or (moved < SETTLED and np.allclose(noise, louder, rtol=SETTLED)):
                break
            try:
                A, b, left = rows.equations(about, noise)
            except (np.linalg.LinAlgError, SignalError):  # Gauss and Newton have gone where no motion is
                break
        self.weighed, self._of_weighed, self._left = weighed, self._errors, left.shares(about, noise)
        self.answer = weighed.mixed(lambda one: self._of_base(half, *weighed.known(one, slice(0, n))))

    def _rows_of(
        self, remade: RowsRemade, half: FloatArray, errors: ErrorState, ticks: SmoothedTicks, correlation: float
    ) -> TickRows:
        """Of kept ticks, with the weights of independent rows."""
        alike, lag = min(float(self._kept.every), correlation), math.ceil(correlation / self._kept.every)
        alone = ticks._replace(weight=ticks.weight * alike)
        return TickRows(remade, half, self._centre, errors.sigma, alone, lag)

    def _weigh_all(self, of: _Estimated, mean: FloatArray, ticks: SmoothedTicks) -> None:
        """The same by the sums over all rows.

        Rows of before the estimate settled are left out, for what errors do to them was made at another one.

        Args:
            of: the recursion, and its prior as wide as it is taken.
            mean: its estimate, (p,).
            ticks: those that are kept.
        """
        errors, own = self._of_all_rows, slice(0, self._n)
        half, seen = errors.half(of.taken.prior_root), of.seen
        since_s = of.errors.settled_s(seen, mean, suspected=True)
        rows = ErrorEquations(seen, errors.of(half, self._names), of.correlation, since_s)
        self.explains, self._left, self._misfit, self.unseen = False, None, math.inf, ()
        if not rows.share:
            return
        x = np.append(np.linalg.pinv(half) @ (mean - errors.centre), np.zeros(len(errors.sigma)))
        try:
            weighed, more, self._misfit = explained(rows, errors.bank, x, lambda weighed: not errors.moves(weighed))
        except np.linalg.LinAlgError:  # Gauss and Newton have gone where rows are not linear
            return
        self.weighed, self._of_weighed, self.explains = weighed, errors, more is not None
        if not weighed.names:
            every = [one for one in weighed.counting if one.suspect is not None]
            effects = zip(every, (weighed.effect(one, own) for one in every), strict=True)
            self.unseen = tuple((one.weight, half @ shift, half @ root) for one, (shift, root) in effects)
        if more is None:
            return
        beyond: BeyondLinear | None = None
        if errors.moves(weighed):
            late = ticks.time_s >= np.array(since_s)[ticks.attached.astype(int)]
            kept = self._rows_of(self._all_remade, half, errors, ticks.at(late), of.correlation)
            beyond = BeyondLinear(self._all_remade, errors.of_instruments, kept, mean)
            x, _ = beyond.of(weighed.known(weighed.likeliest), weighed.likeliest.suspect)
            left = kept.left(x)
            self._left = left.shares(x, left.noise(x, np.ones(ticks.weight.shape[1])))
            self.explains = not self.judged()[0] and bool((self._left.noise <= MISFIT_PART).all())
            if not self.explains:
                return

        def base(one: Hypothesis) -> Known:
            z, P = weighed.known(one) if beyond is None else beyond.of(weighed.known(one), one.suspect)
            return self._of_base(half, z[own], P[own, own])

        self.answer = weighed.mixed(base).wider(np.asarray(half @ more[own, own] @ half.T, np.float64))

    def _of_base(self, half: FloatArray, z: FloatArray, P: FloatArray) -> Known:
        """Base parameters by errors of their prior."""
        return self._centre + half @ z, np.asarray(half @ P @ half.T, np.float64)
