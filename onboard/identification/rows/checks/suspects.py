"""Hypotheses of errors of an arm on a fixed base, and, where its cells' scales are estimated, the answer under each.

Where scales are stated, hypotheses are weighed once rows contradict each other, and the likeliest are named.

Of each link but the payload, mass and inertia, either, the centre of mass, or all ten parameters may be off, or the
factor and the centre of mass (a part exchanged); of an encoder, or of all, the zero, the scale, the delay; of a cell,
of those of forces, of moments, or of all, the scale and the delay, and of a cell a step of its scale; the cells at a
frame may be turned in their mount, the base not level. All compete with "as stated" in one bank
(:mod:`onboard.identification.evidence.bank`), whose state is z: the errors of the prior, ``beta = beta_0 + G L z``, and
those of instruments, each over its stated sigma. z is found by Gauss and Newton from rows of kept ticks that are made
again about the likeliest hypothesis (:mod:`onboard.identification.rows.checks.remade`), since gains multiply masses
and angles turn gravity.

Rows are smoothed, so neighbours are correlated: a kept tick stands for the ticks up to the next kept one, but for no
more than are correlated. The noise of each row is the residual of the likeliest hypothesis, no smaller than stated;
outliers have Huber's weights.

Where scales are estimated the answer is the mixture of all that count, each with the mean and covariance that it has
by these rows. It takes the place of the recursion's, whose gains multiply masses that were not known yet when their
rows came. What noise of the regressor adds to the information of all rows is taken off that of those kept.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import ROUNDING, BoolArray, FloatArray, IndexArray
from onboard.estimation.policy import (
    AGAIN,
    DOUBT,
    LIKELY_SIZE,
    MISFIT_PART,
    MOST_SHARE,
    MOSTLY,
    ODDS,
    ODDS_OF_PART,
    READING,
    LIKELY_DELAY_s,
    contradicted_text,
    sigmas,
)
from onboard.estimation.recursive.consistency import NOISE_SIGMA
from onboard.identification.evidence.bank import Bank, Suspect, Weighed
from onboard.identification.evidence.bodies import ways
from onboard.identification.evidence.mixture import Known, Mixture
from onboard.identification.rows.checks.agreement import MOST_UNEXPLAINED
from onboard.identification.rows.checks.kept_ticks import KeptTicks, SmoothedTicks
from onboard.identification.rows.checks.remade import OF_MOTION, OF_READING, STEPS, RowsRemade
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.considered import Considered, Effect, rate_of
from onboard.identification.windows import SHORTEST
from onboard.regressor.base_parameters import BaseParameters
from onboard.regressor.rows import RowModel
from onboard.regressor.signals import Signals

_UNSTATED = 1e-3  # of the size of a suspect: sigma of an error of which the file states none
_ROUNDS, _SETTLED = 6, 0.1  # of Gauss and Newton; sigmas of the change in one
_HUBER, _FAR = sigmas(DOUBT), sigmas(READING)  # rows beyond weigh less (Huber 1964); contradict
_TINY = float(np.finfo(np.float64).tiny)
_OF_ENCODER: tuple[tuple[Effect, str, float], ...] = (
    ("joint_zero", "zero", LIKELY_SIZE),
    ("joint_scale", "scale", LIKELY_SIZE),
    ("joint_delay", "delay", LIKELY_DELAY_s),
)


def suspected(considered: Sequence[Considered], model: RowModel) -> tuple[Considered, ...]:
    """All errors of instruments that compete: those stated, and those of which nothing is stated, with a tiny sigma."""
    stated = [one for one in considered if one.sigma > 0.0 and one.row and one.effect in (*OF_MOTION, *OF_READING)]
    known = {(one.row, one.effect) for one in stated}
    asked: list[tuple[str, Effect, float, int | None]]
    asked = [(joint.name, effect, size, None) for joint in model.vehicle.joints for effect, _, size in _OF_ENCODER]
    asked += [(row.name, "delay", LIKELY_DELAY_s, None) for row in model.rows]
    estimated = [row for row, _ in model.scales]
    asked += [(row.name, "scale", LIKELY_SIZE, None) for k, row in enumerate(model.rows) if k not in estimated]
    asked += [(row.name, "step", LIKELY_SIZE, place) for row in model.rows for place in range(STEPS)]
    for axis in range(3):
        asked.append((model.vehicle.spec.base_link, "level", LIKELY_SIZE, axis))
        asked += [(frame, "turned", LIKELY_SIZE, axis) for frame in dict.fromkeys(row.frame for row in model.rows)]
    more = [
        Considered(f"{effect} of {row}", row, effect, _UNSTATED * size, axis=axis)
        for row, effect, size, axis in asked
        if (row, effect) not in known
    ]
    return (*stated, *more)


class RowSuspects:
    """Hypotheses about one model's rows.

    Args:
        model: the rows, of a fixed base, without motors.
        base: their base parameters.
        prior_root: L of the prior covariance of the standard parameters, (P, P).
        considered: errors that the recursion considers.

    Attributes:
        weighed: the hypotheses, once there are rows enough.
        answer: the base parameters by all hypotheses that count.
    """

    def __init__(
        self, model: RowModel, base: BaseParameters, prior_root: FloatArray, considered: Sequence[Considered]
    ) -> None:
        self._errors = suspected(considered, model)
        self._remade = RowsRemade(model, base, self._errors)
        self._kept, self._rows, self._weighed_at = KeptTicks(), np.zeros(2), np.zeros(2)
        half = base.grouping @ prior_root
        self._active = np.flatnonzero(half.any(axis=0))
        self._half, self._centre = half[:, self._active], base.value(model.chi)  # beta = centre + half z
        self._sigma = np.array([one.sigma for one in self._errors])
        self._each = np.concatenate([np.diag(prior_root)[self._active], self._sigma])
        every = [*self._links(model, prior_root), *self._instruments(model)]
        suspects = [one for one in every if np.abs(one.along).max() < 1.0 / ROUNDING]  # else exact
        self._bank = Bank(suspects, np.ones(len(self._active) + len(self._errors)))
        self._names = [row.name for row in model.rows]
        self._gain_of = {row: int(np.flatnonzero(base.independent == column)[0]) for row, column in model.scales}
        self._is_gain = np.isin(np.arange(len(self._centre)), list(self._gain_of.values()))
        self.weighed: Weighed | None = None
        self._left: Shares | None = None
        self.answer: Mixture | None = None

    @property
    def explanation(self) -> str:
        """What is likelier wrong than all as stated; empty where nothing is, or much is left over with it."""
        if self.weighed is None:
            return ""
        too_far, named = self.weighed.judged
        return "".join(too_far or named) if self.judged()[0] == too_far else ""

    def judged(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Reasons to refuse all estimates, and to doubt them."""
        if self.weighed is None or self._left is None:
            return (), ()
        against, doubts = map(list[str], self.weighed.judged)
        if contradicted := contradicted_text(self._left.far):
            against.append(contradicted)
        for name, share, noise in zip(self._names, self._left.of_read.tolist(), self._left.noise.tolist(), strict=True):
            if noise > MISFIT_PART and share > MOSTLY * MOST_UNEXPLAINED:
                said = f"{share:.0%} of what {name} reads is left over"
                (against if share > MOST_UNEXPLAINED else doubts).append(said)
        return tuple(against), tuple(doubts)

    def take(self, signals: Signals, at: IndexArray, attached: BoolArray, use: BoolArray, sigma: FloatArray) -> None:
        """Takes the rows of ticks in, those too that the recursion's residual gate refuses.

        Args:
            signals: all of them.
            at: ticks, (t,).
            attached: (t,) whether the payload is held.
            use: (t, m) which rows no other gate refuses.
            sigma: of these, with the noise of the motion and as Huber widens it, (r,).
        """
        weight = np.zeros(use.shape)
        weight[use] = sigma**-2
        measured = np.where(use, signals.measured[at], 0.0)
        rate = np.zeros_like(measured) if signals.measured_rate is None else signals.measured_rate[at]
        jerk = rate_of(signals, signals.ddq)[at]
        motion = signals.q[at], signals.dq[at], signals.ddq[at], jerk, signals.motion.specific_force_m_s2[at]
        self._kept.add(SmoothedTicks(signals.time_s[at], *motion, attached, measured, np.where(use, rate, 0.0), weight))
        held = use[attached].sum()
        self._rows += held, use.sum() - held

    def weigh(self, mean: FloatArray, correlation: float, seen: RowBlocks) -> None:
        """Weighs the hypotheses, if there are a fifth more rows than when they were.

        Args:
            mean: the recursion's estimate with all as stated, (p,): where Gauss and Newton begin.
            correlation: how many neighbouring rows say the same thing.
            seen: the recursion's rows: what noise of the motion adds to their information.
        """
        ticks = self._kept.ticks
        if ticks is None or len(ticks.time_s) < SHORTEST or (self._rows < AGAIN * self._weighed_at + 1.0).all():
            return
        self._weighed_at = self._rows.copy()
        alike = min(float(self._kept.every), correlation)
        share = alike * np.count_nonzero(ticks.weight) / self._rows.sum()
        ticks, lag = ticks._replace(weight=ticks.weight * alike), math.ceil(correlation / self._kept.every)
        n = len(self._active)
        about = np.zeros(n + len(self._errors))
        about[:n] = np.linalg.pinv(self._half) @ (mean - self._centre)
        noise = np.ones(ticks.weight.shape[1])
        for _ in range(_ROUNDS):
            A, b, left = self.equations(ticks, about, noise)
            P = np.asarray(np.linalg.inv(A + np.eye(len(A))), np.float64)
            weighed = self._bank.weigh((P @ b, P))
            before, louder = about, noise
            about, covariance = weighed.known(weighed.likeliest)
            noise = left.noise(about, noise, lag)
            moved = float((np.abs(about - before) / np.sqrt(np.diag(covariance))).max())
            if moved < _SETTLED and np.allclose(noise, louder, rtol=_SETTLED):
                break
        self.weighed, self._left = weighed, left.shares(about, noise)
        own = slice(0, n)
        off = covariance[own, own] @ self._attenuated(about[own], seen, share / noise)
        self.answer = weighed.mixed(lambda one: self._known(*weighed.known(one, own), off))

    def _known(self, z: FloatArray, P: FloatArray, off: FloatArray) -> Known:
        """Base parameters by the errors of their prior, z, corrected for noise of the motion by ``off``."""
        moved = self._half @ off
        doubt = NOISE_SIGMA**2 * np.outer(moved, moved)
        return self._centre + self._half @ z + moved, self._half @ P @ self._half.T + doubt

    def _attenuated(self, z: FloatArray, seen: RowBlocks, share: FloatArray) -> FloatArray:
        """``N z - n``, (n,), by which noise of the motion makes the right-hand side of z too small.

        N is what that noise adds to the information, n to the right-hand side; to first order the estimate is too small
        by its covariance times this.

        Args:
            z: errors of the prior.
            seen: the recursion's rows.
            share: of their information that kept ticks have, by row, (m,).
        """
        total = np.zeros(len(z))
        for row, part in enumerate(share.tolist()):
            N = self._noise_of_motion(seen, row)
            M, v = self._turning(row, z)
            total += part * (M.T @ (N @ (M @ z - v)))
        return total

    def _noise_of_motion(self, seen: RowBlocks, row: int) -> FloatArray:
        """What it adds to the normal equations of all rows of one kind, (p + 1, p + 1), the left-hand side last."""
        p = len(self._centre)
        parts = [seen.apart(*part)[1].sum(axis=0)[: p + 1, : p + 1] for part in seen.parts if part[1] == row]
        return np.asarray(sum(parts, np.zeros((p + 1, p + 1))), np.float64)

    def _turning(self, row: int, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How noise of the columns of one kind of row, (p + 1,), acts on derivatives and on what they are held against.

        A cell's scale has what it should read as its column, about this very estimate.

        Args:
            row: which.
            z: errors of the prior that rows are made about.

        Returns:
            (p + 1, n) and (p + 1,).
        """
        beta = self._centre + self._half @ z
        body, drawn = (np.append(np.where(self._is_gain, 0.0, one), -1.0) for one in (beta, self._centre))
        M = np.diag(np.append(np.where(self._is_gain, 0.0, 1.0), 0.0))[:, :-1]
        scale = 0.0
        if (at := self._gain_of.get(row)) is not None:
            scale = float(beta[at])
            M = (1.0 + scale) * M
            M[:, at] = body
        return M @ self._half, scale * body - (1.0 + scale) * drawn

    def equations(
        self, ticks: SmoothedTicks, z: FloatArray, noise: FloatArray
    ) -> tuple[FloatArray, FloatArray, "_Left"]:
        """Information and right-hand side of z about a value of it, and what another leaves over.

        Args:
            ticks: with the weights of independent rows.
            z: errors, each over its sigma.
            noise: variance of each row over that stated, (m,).
        """
        n = len(self._active)
        beta, errors = self._centre + self._half @ z[:n], self._sigma * z[n:]
        reading, slope = self._remade.at(ticks, beta, errors)
        p = len(beta)
        J = np.concatenate([slope[..., :p] @ self._half, slope[..., p:] * self._sigma], axis=2)
        r = ticks.measured - reading
        far = np.abs(r) * np.sqrt(ticks.weight / noise)
        weight = ticks.weight / noise * np.minimum(1.0, _HUBER / np.maximum(far, _HUBER))
        flat = J.reshape(-1, len(z))
        weighted = flat * weight.reshape(-1, 1)
        target = r + J @ z
        return weighted.T @ flat, weighted.T @ target.ravel(), _Left(J, target, ticks)

    def _links(self, model: RowModel, prior_root: FloatArray) -> Iterator[Suspect]:
        """Links that the rows show and that are not the payload."""
        vehicle = model.vehicle
        for number, link in enumerate(vehicle.links):
            own = slice(10 * number, 10 * number + 10)
            at, half = self._place(np.arange(own.start, own.stop)), prior_root[own, own]
            if link == vehicle.spec.payload_link or len(at) < 10 or np.linalg.matrix_rank(half) < 10:
                continue
            each = ways(model.chi[own], half)
            each += (np.hstack([each[0], each[3]]),)  # a part exchanged
            yield from (Suspect(link, at, way, ODDS_OF_PART / len(each)) for way in each)

    def _instruments(self, model: RowModel) -> Iterator[Suspect]:
        joints = [joint.name for joint in model.vehicle.joints]
        for effect, what, size in _OF_ENCODER:
            odds = ODDS_OF_PART / len(_OF_ENCODER)
            every = [self._places(joint, effect) for joint in joints]
            for joint, at in zip(joints, every, strict=True):
                yield self._alone(f"{what}_{joint}", at, size, odds)
            if len(joints) > 1:
                yield self._alone(f"{what}s of all joints", np.concatenate(every), size, odds)
        base = model.vehicle.spec.base_link
        yield self._alone(f"level of {base}", self._places(base, "level"), LIKELY_SIZE, ODDS_OF_PART)
        for frame in dict.fromkeys(row.frame for row in model.rows):
            yield self._alone(f"cells at {frame}", self._places(frame, "turned"), LIKELY_SIZE, ODDS_OF_PART)
        yield from self._cells(model)

    def _cells(self, model: RowModel) -> Iterator[Suspect]:
        names, columns = [row.name for row in model.rows], dict(model.scales)
        scales = [
            self._place([columns[k]]) if k in columns else self._places(name, "scale") for k, name in enumerate(names)
        ]
        odds = 1.0 / len(names)
        for name, scale in zip(names, scales, strict=True):
            yield self._scaled(name, scale, ODDS * odds)
            yield self._alone(name, self._places(name, "delay"), LIKELY_DELAY_s, ODDS_OF_PART * odds)
            for place in self._places(name, "step"):
                yield self._alone(f"a step of {name}", place[None], LIKELY_SIZE, ODDS * odds / STEPS)
        forces = np.array([any(row.projection[:3]) for row in model.rows])
        groups = {"all forces": forces, "all moments": ~forces} if 0 < forces.sum() < len(forces) else {}
        for name, some in {**groups, "all cells": np.full(len(forces), True)}.items():
            which = np.flatnonzero(some)
            if len(which) > 1:
                yield self._scaled(name, np.concatenate([scales[k] for k in which]), ODDS_OF_PART)
                delays = np.concatenate([self._places(names[k], "delay") for k in which])
                yield self._alone(name, delays, LIKELY_DELAY_s, ODDS_OF_PART, together=True)

    def _place(self, columns: Sequence[int] | IndexArray) -> IndexArray:
        """Of standard parameters in the state."""
        return np.flatnonzero(np.isin(self._active, columns))

    def _places(self, row: str, effect: Effect) -> IndexArray:
        """Of the errors of an instrument in the state."""
        mine = [(one.row, one.effect) == (row, effect) for one in self._errors]
        return len(self._active) + np.flatnonzero(mine)

    def _scaled(self, name: str, at: IndexArray, odds: float) -> Suspect:
        """Scales of cells, by one factor."""
        return Suspect(name, at, LIKELY_SIZE / self._each[at, None], odds)

    def _alone(self, name: str, at: IndexArray, size: float, odds: float, together: bool = False) -> Suspect:
        """Errors of instruments, each by itself or all by one value."""
        along = size / self._sigma[at - len(self._active)]
        return Suspect(name, at, along[:, None] if together else np.diag(along), odds)


class _Left(NamedTuple):
    """Rows about an estimate, to be held against another."""

    slope: FloatArray  # (t, m, n)
    target: FloatArray  # (t, m)
    ticks: SmoothedTicks

    def noise(self, z: FloatArray, before: FloatArray, lag: int) -> FloatArray:
        """Mean square of what is left over of each row, over its variance, (m,); none below one.

        What is alike for longer than the smoothing makes it, as a process of first order with the correlation r at
        the first lag that shares no samples, counts ``(1 + r) / (1 - r)`` times (Priestley, Spectral Analysis, 1981).

        Args:
            z: the estimate.
            before: what it was held for, (m,): what is far off by that counts as Huber has it.
            lag: ticks, between which the smoothing makes nothing alike.
        """
        left = self.target - self.slope @ z
        squares = np.minimum(left**2 * self.ticks.weight, _HUBER**2 * before)
        count = (self.ticks.weight > 0.0).sum(axis=0)
        each = np.sign(left) * np.sqrt(squares)
        alike = (each[lag:] * each[:-lag]).sum(axis=0) / np.maximum(squares[lag:].sum(axis=0), _TINY)
        alike = np.clip(alike - 2.0 / np.sqrt(np.maximum(count, 1)), 0.0, MOST_SHARE)
        loud = squares.sum(axis=0) / np.maximum(count, 1) * (1.0 + alike) / (1.0 - alike)
        return np.asarray(np.maximum(1.0, loud), np.float64)

    def shares(self, z: FloatArray, noise: FloatArray) -> "Shares":
        """What is left over, as shares."""
        weight, squares = self.ticks.weight, self._squares(z)
        mean = (self.ticks.measured * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), _TINY)
        read = ((self.ticks.measured - mean) ** 2 * weight).sum(axis=0)
        far = float((squares > _FAR**2 * noise).sum() / max((weight > 0.0).sum(), 1))
        return Shares(np.sqrt(squares.sum(axis=0) / np.maximum(read, _TINY)), noise, far)

    def _squares(self, z: FloatArray) -> FloatArray:
        return np.asarray((self.target - self.slope @ z) ** 2 * self.ticks.weight, np.float64)


class Shares(NamedTuple):
    """What the likeliest hypothesis leaves over."""

    of_read: FloatArray  # (m,) of what is read of each row, its changes alone
    noise: FloatArray  # (m,) variance of each row over that stated
    far: float  # of all rows, those farther off than any noise
