"""Recursive identification: smoothed signals in, base parameters and quantities with intervals out.

``chi = [arm, payload]``: rows made while the payload is held carry both links' columns, rows made without it carry the
arm's only. One recursive least squares over both gives the arm, the payload and their sum, with their covariance. A
quantity is reported as *supported* only if the data, not the prior, determine it.
"""

from collections.abc import Sequence

import numpy as np

from onboard.dynamics.model.errors import SignalError
from onboard.estimation.arrays import BoolArray, FloatArray, finite
from onboard.estimation.gates import GateReason, ReasonArray, ResidualGate, count_refused, none_refused
from onboard.estimation.policy import AGAIN, HALF, contradicted_text
from onboard.estimation.recursive import jackknives
from onboard.estimation.recursive.consistency import JackknifeEstimate
from onboard.estimation.recursive.least_squares import RecursiveLeastSquares
from onboard.estimation.recursive.rls import SquareRootRls
from onboard.identification.online import Change
from onboard.identification.quantities import SUPPORTED_FREEDOM, SUPPORTED_SHRINKAGE, Estimate, Findings, Quantity
from onboard.identification.rows.checks.agreement import InstrumentFit, but_gains, instrument_fits, with_stated
from onboard.identification.rows.checks.prediction import prediction, without_unknown
from onboard.identification.rows.checks.suspects import RowSuspects
from onboard.identification.rows.found import found
from onboard.identification.rows.grasped import contradiction, grasped_payload
from onboard.identification.rows.likelihood import RowsSeen
from onboard.identification.rows.row_blocks import RowBlocks, instrument_of
from onboard.identification.rows.stated_errors.considered import Considered, ConsideredErrors, Start, check, of_motion
from onboard.identification.rows.stated_errors.drawing import Unstated, answered, off_drawing, unstated
from onboard.identification.rows.stated_errors.fitted_corrections import Fitted, FittedCorrections
from onboard.identification.rows.stated_errors.stated import ByErrors, Stated, StatedSigmas, Taken
from onboard.identification.rows.stated_errors.whitening import NoisyRows, Whitening
from onboard.regressor.base_parameters import BaseParameters
from onboard.regressor.noise import RowNoise
from onboard.regressor.rows import BaseMotion, RowModel
from onboard.regressor.signals import Signals

_SEEN_SHARE = 0.4  # of a jackknife block: two kernels
_APART_s = 1e6  # between rows with the payload and those of another recording: no block, and no period, holds both


class Identifier:
    """Recursive identification of a vehicle's base parameters from smoothed signals.

    Args:
        model: the rows.
        base: its base parameters.
        prior_root: L of the covariance ``L L'`` of the standard parameters about ``model.chi``, (P, P).
        block_s: first block length of the jackknife covariance; five kernel widths or more.
        quantities: what to report besides the base parameters.
        considered: considered parameters.
        residual_sigma: threshold of the residual gate.
        huber_sigma: innovations beyond so many sigmas weigh less (Huber); none do, where not given.
        imu_frame: whose axes and place the noise of the base's motion is given for; the base link's where not given.
        start: warm start; default: the prior.
        whitening: of the rows' noise, for a base that is not free; none is whitened where not given.
        stated: what states the sigma of each standard parameter, (P,). Where given, for a base that is not free, it is
            taken as wide as the rows ask (:mod:`onboard.identification.rows.stated_errors.stated`).
        recorded_apart: rows with the payload and those without are of different recordings.
        suspects: weighs what may not be as stated; nothing is, where not given.

    Attributes:
        recursion: of the rows.
        payload: what is held, where its rows can tell all of it.
        innovation: of the last update, (n, rows): measured less what the rows before let expect, over its sigma, as the
            residual gate judges it; NaN where another gate left the row out.
        about: parameters by an earlier pass through the same rows, (p,). Their sigmas and what errors do to them are
            computed at these; where not given, at the estimate so far, by which a body that has hardly moved yet has
            next to no inertia, and its rows next to no noise.
        batch_ticks: ticks whose rows are gated and made linear with one estimate before they update it; at most.

    Raises:
        UnknownFrameError: something considered that the model lacks, or an IMU frame that the base lacks.
        RowError: see :mod:`onboard.estimation`.
    """

    batch_ticks = 64

    def __init__(
        self,
        model: RowModel,
        base: BaseParameters,
        prior_root: FloatArray,
        block_s: float,
        quantities: Sequence[Quantity] = (),
        considered: Sequence[Considered] = (),
        residual_sigma: float = 6.0,
        huber_sigma: float | None = None,
        imu_frame: str | None = None,
        start: Start | None = None,
        whitening: Whitening | None = None,
        stated: Sequence[Stated] = (),
        recorded_apart: bool = False,
        suspects: RowSuspects | None = None,
    ) -> None:
        rows = [row.name for row in model.rows]
        check(considered, model)
        self.model, self.base = model, base
        self.quantities, self.considered = tuple(quantities), tuple(considered)
        self.whitening, self._recorded_apart = whitening, recorded_apart
        self._bank = suspects
        p = len(base.names)
        known = np.where(base.grouping.any(axis=0), 0.0, model.chi)  # in no base parameter: known, or no matter
        self._fold = model.fold(np.column_stack([np.eye(len(model.names))[:, base.independent], known]))
        self.payload = grasped_payload(model, base)
        self._weights = np.vstack([np.eye(p), *(q.weights for q in self.quantities)])  # of all that is reported, (r, p)
        self.recursion = RecursiveLeastSquares(p, len(self.considered), block_s)
        self._as_stated = Taken.of(self.rls, considered, base, prior_root, model.chi)
        self.rls.prior(*(start or (base.value(model.chi), self._as_stated.covariance)))
        self.gate = ResidualGate(residual_sigma, huber=huber_sigma)
        self._noise = RowNoise(model, self._fold, imu_frame or model.vehicle.spec.base_link)
        self.rows_used, self._inflation, self.innovation = 0, 1.0, np.zeros((0, len(rows)))
        self.refused = none_refused()
        instruments = tuple(dict.fromkeys(instrument_of(name) for name in rows))
        self._instrument = np.array([instruments.index(instrument_of(name)) for name in rows], np.intp)
        self.about: FloatArray | None = None
        self._estimated: tuple[tuple[int, int], Estimate] | None = None  # the last one, and what it is of
        free = model.vehicle.spec.base.falls  # elsewhere the scale of the only reading cannot be separated from a mass
        # of a free base columns of errors are of the rows' own noise
        self.seen = RowBlocks(p, _SEEN_SHARE * block_s, instruments, 0 if free else len(self.considered))
        self._of_motion = of_motion(considered)
        of_errors = p, considered, block_s, [joint.name for joint in model.vehicle.joints], start and start.sensitivity
        self._corrections = FittedCorrections(*of_errors) if free and self._of_motion else None
        self.fits_errors = self._corrections is not None
        self.errors = ConsideredErrors(considered, model, self._fold, p)
        if self._of_motion:
            self.errors.remember(start)
        self._corrected: tuple[int, Fitted] | None = None  # rows used, and the corrections that they give
        self._fitted: tuple[int, tuple[InstrumentFit, ...]] | None = None  # rows used, how each instrument stands
        self._stated: StatedSigmas | None = None
        if stated and not free and start is None:
            alone = {instrument_of(row.name) for row in model.rows if row.friction_joint}  # nobody else reads friction
            cells = [k for k, name in enumerate(instruments) if name not in alone]
            of_file = stated, considered, instruments, base, self._as_stated, cells
            self._stated = StatedSigmas(*of_file, estimates=not model.vehicle.spec.base.moves)
        self._taken: tuple[int, Taken] | None = None  # rows used, and what is taken for granted of what is stated
        self._is_over = False  # no more rows come

    @property
    def row_names(self) -> tuple[str, ...]:
        """Of the columns of ``measured``."""
        return tuple(row.name for row in self.model.rows)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Of the base parameters."""
        return self.base.names

    @property
    def quantity_names(self) -> tuple[str, ...]:
        """Of what is reported besides: the quantities, then the payload where the rows can tell it."""
        return (*(quantity.name for quantity in self.quantities), *(self.payload.names if self.payload else ()))

    def triangle(self) -> FloatArray:
        """Square-root information ``[R z]`` of all parameters, considered ones included, (s, s)."""
        return self.rls.state().triangle

    def news(self) -> tuple[Change, ...]:
        """Empty: rows do not detect changes of the payload."""
        return ()

    @property
    def rls(self) -> SquareRootRls:
        """The recursive least squares."""
        return self.recursion.rls

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        """Processes the rows of new ticks.

        Args:
            signals: at the new ticks.
            attached: (n,) whether the payload is held.
            excluded: (n,) reasons of the gates that look at ticks; 0 where the tick may be used.

        Returns:
            (n, rows) reasons: those given, ``GAP`` for a row that is not finite, ``RESIDUAL`` for one that contradicts
            the estimate.

        Raises:
            SignalError: shapes that do not fit.
        """
        n, m = signals.measured.shape
        if m != len(self.model.rows) or signals.sigma.shape != (n, m) or excluded.shape != (n,):
            raise SignalError(f"{m} measured rows a tick for {len(self.model.rows)} in the model; give as many")
        found = np.repeat(np.asarray(excluded, np.int64)[:, None], m, axis=1)
        found |= 0 if signals.refused is None else signals.refused
        whole = finite([signals.q, signals.dq, signals.ddq, *signals.motion])
        if signals.noise is not None:
            self._inflation = signals.noise.inflation
            whole &= finite(signals.noise[:6])
        found[~whole] |= GateReason.GAP
        found[~(np.isfinite(signals.measured) & np.isfinite(signals.sigma))] |= GateReason.GAP
        self.innovation = np.full((n, m), np.nan)
        for first in range(0, n, self.batch_ticks):
            self._batch(signals, attached, found, slice(first, first + self.batch_ticks))
        count_refused(self.refused, found)
        if self._bank is not None:
            self._bank.go_on(self, bool(self.contradicted))
        return found

    @property
    def suspects(self) -> RowSuspects | None:
        """Those whose answer takes the place of the recursion's, if there are."""
        return self._bank if self._bank is not None and self._bank.explains else None

    @property
    def of_gravity(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Reasons to refuse all estimates, and to doubt them, by what an IMU reads of a base that stands."""
        return self._bank.of_gravity if self._bank is not None else ((), ())

    def finish(self) -> None:
        """Judge all rows, and not a fifth less: no more come."""
        self._is_over, self._estimated = True, None
        jackknives.forget(self)

    def _is_due(self, rows: int) -> bool:
        """Whether what is costly, and was done with so many rows, is to be done again."""
        return not rows <= self.rows_used < (rows + 1 if self._is_over else AGAIN * rows)

    def _batch(self, signals: Signals, attached: BoolArray, found: ReasonArray, part: slice) -> None:
        reasons = found[part]
        ticks = np.flatnonzero((reasons == 0).any(axis=1))
        if ticks.size == 0:
            return
        at, use = ticks + part.start, reasons[ticks] == 0  # (t,), (t, m)
        motion = BaseMotion(*(v[at] for v in signals.motion))
        joints = signals.q[at], signals.dq[at], signals.ddq[at]
        z = None if signals.friction is None else signals.friction[at]
        Y = self.model.regressor(*joints, motion, attached[at], fold=self._fold, friction=z)
        asked = signals, at, use, attached
        rows = self.errors.biased(Y[..., :-1][use], self.base.names, asked, self.about, self.rls)  # (r, p)
        y, sigma = (signals.measured[at] - Y[..., -1])[use], signals.sigma[at][use]  # (r,)
        doubt, effect = None, np.zeros((len(y), 0))
        if signals.noise is not None:
            mean = self.rls.solve().mean if self.about is None else self.about
            changes, group = self._noise.changes(signals, signals.noise, at, attached)
            doubt = changes[group][use]  # (r, s, p + 1)
            effect = (doubt @ [*mean, -1.0]) * signals.noise.inflation
            sigma = np.sqrt(sigma**2 + np.einsum("rs,rs->r", effect, effect))
        innovation, spread = self.recursion.innovation(rows, y, sigma)
        verdict = self.gate.check(innovation, spread)
        kept = verdict == 0
        sigma = sigma * (widening := self.gate.widening(innovation, spread))
        which, column = np.nonzero(use)
        reasons[ticks[which], column] |= verdict
        self.innovation[at[which], column] = innovation / spread
        if self._bank is not None:
            noise = signals.noise and self._noise.of_joints_and_force(signals.noise, at)
            self._bank.take(signals, at, attached[at], use, sigma, noise)
        if not kept.any():
            return
        use[use] = kept
        tick, row = np.nonzero(use)  # (r,) of each row
        times = signals.time_s[at][tick]
        rows, y, sigma = rows[kept], y[kept], sigma[kept]
        doubt = None if doubt is None else doubt[kept]
        # Of a free base with these rows taken in, as the estimate before them may be the prior's.
        about = self.rls if self._corrections is None else self.rls.tried(rows, y, sigma)
        mean = about.solve().mean if self.about is None else self.about
        noisy = NoisyRows(rows, y, self.errors.factors(*asked), sigma, signals.sigma[at][use] * widening[kept], doubt)
        if self.whitening is not None:
            noisy = self.whitening.filter(signals, at, use, noisy, effect[kept], widening[kept])
        rows, y, C, sigma, own, doubt = self.errors.at(noisy, attached[at][tick], mean)
        self.recursion.add(times + _APART_s * self._recorded_apart * attached[at][tick], rows, y, sigma, C, doubt)
        of = times, attached[at][tick], self._instrument[row]
        self.seen.add(*of, rows, y, sigma, own, doubt, C, mean, self.errors.noise(signals, at[tick], doubt, mean))
        if self._corrections is not None and noisy.C is not None:
            self._corrections.add(times, rows, y, sigma, noisy.C, doubt, mean)
        self.rows_used += y.size

    def findings(self) -> Findings:
        """Findings about the estimates that their intervals do not contain."""
        return found(self)

    def contradiction(self, jackknife: JackknifeEstimate) -> str:
        """Reason why the rows contradict the prior; empty where that is taken as wide as they ask."""
        if self.suspects is not None:
            return next(iter(self.suspects.judged()[0]), "")
        drawn = self.base.value(self.model.chi), self._as_stated.covariance
        return "" if self._stated else contradiction(self.base.names, jackknife, *drawn)

    @property
    def taken(self) -> Taken:
        """What is stated of the parameters and gains, as wide as the rows asked when it was last looked at."""
        if self._stated is None or not self.rows_used:
            return self._as_stated
        if self._taken is None or self._is_due(self._taken[0]):
            mean = self.recursion.least_squares()
            asked = self.seen, mean, self._inflation**2, self.errors.settled_s(self.seen, mean)
            self._taken = self.rows_used, self._stated.taken(self._as_stated, *asked)
        return self._taken[1]

    @property
    def by_errors(self) -> ByErrors | None:
        """The answer with errors of recorded torques estimated beside it, where there is one."""
        return self.taken.answer

    def fits(self) -> tuple[InstrumentFit, ...]:
        """How each instrument's rows stand to the estimate of all; gains as stated, or as the answer has them."""
        if self._fitted is None or self._is_due(self._fitted[0]):
            mean, drawn = self._recursions(False).mean, self.base.value(self.model.chi)
            taken = self.taken.by(self.rls)
            plain, prior = taken.rls.solve().mean, taken.rls.prior_equations()[0]
            bodies = drawn, without_unknown(self.model, self.base), self.base.of_bodies
            asked = mean, plain, *bodies, prior, self._inflation**2, self._recorded_apart
            causes = self.considered[: self.seen.considered]
            friction = {k: one.axis for k, one in enumerate(causes) if one.effect == "held_friction"}
            since_s = self.errors.settled_s(self.seen, mean) if self.by_errors else (-np.inf, -np.inf)  # as it has them
            sigma = taken.considered[: len(causes)]
            with_gains = self.by_errors and not self._recorded_apart  # between recordings their steps are looked for
            beside = sigma if with_gains else but_gains(sigma, causes), friction, since_s
            self._fitted = self.rows_used, with_stated(instrument_fits(self.seen, *asked, *beside), self.considered)
        return self._fitted[1]

    @property
    def correlation(self) -> float:
        """How many neighbouring rows say the same thing: the square of their sigmas' inflation."""
        return self._inflation**2

    @property
    def rows_seen(self) -> RowsSeen:
        """All rows so far, those included that contradict the estimate, and what is drawn."""
        taken, refused = self.taken.by(self.rls), self.refused[GateReason.RESIDUAL] * self.gate.threshold**2
        return RowsSeen.of(taken.rls, taken.considered, refused, self.drawn)

    @property
    def drawn(self) -> float:
        """Sum of squares, in sigmas, of what is found of parts that the drawing knows."""
        return off_drawing(self.quantities, self.block_jackknife())

    def unstated(self, jackknife: JackknifeEstimate) -> Unstated:
        """What errors that no key states do to the estimate: suspected steps, and scales off the drawing."""
        steps = [] if self.suspects else [one for fit in self.fits() for one in fit.suspected]
        body, prior = np.where(self.base.of_bodies, jackknife.mean, 0.0), self.taken.rls.prior_equations()[0]
        return Unstated.of(steps, unstated(self.quantities, jackknife, self.seen, body, prior))

    @property
    def fitted_errors(self) -> Fitted | None:
        """The considered errors after the rows; None where these are not fitted, but as stated."""
        if self._corrections is None:
            return None
        if self._corrected is None or self._corrected[0] != self.rows_used:
            mean = self.block_jackknife(exact=True).mean
            left = prediction(self.seen, self.model, self.base, mean).relative_error
            self._corrected = self.rows_used, self._corrections.fitted(*self.rls.prior_equations(), left, mean)
        return self._corrected[1]

    def block_jackknife(self, exact: bool = False) -> JackknifeEstimate:
        """The estimate of the base parameters with its block-jackknife covariance; ``exact``: nothing considered.

        Considered errors that the rows tell are as large as they are fitted, the others as stated.
        """
        made = self._recursions(exact)
        if exact:
            return made
        if self.suspects:
            return made if self.suspects.answer is None else made.instead(self.suspects.answer)
        if (by := self.by_errors) is None:
            return made
        return made.instead(by.known.beside(self._bank.unseen if self._bank else ()), by.shares)

    def _recursions(self, exact: bool) -> JackknifeEstimate:
        return jackknives.last(self, exact, self._block_jackknife)

    def _block_jackknife(self, exact: bool) -> JackknifeEstimate:
        taken = self.taken.by(self.rls)
        self.errors.restate(taken.rls)
        fitted = None if exact else self.fitted_errors
        sigma = taken.considered * (not exact) if fitted is None else fitted.root
        return JackknifeEstimate(taken.rls, self.recursion.blocks, sigma, scale=fitted and fitted.noise)

    def bounds(self) -> FloatArray:
        """Sigma of each base parameter and quantity at the stated noise alone (Cramer-Rao), (p + quantities,)."""
        jackknife = self.block_jackknife()
        weights = np.vstack([self._weights, *([self.payload.weights(jackknife)] if self.payload else [])])
        return np.asarray(np.sqrt(jackknife.formal_variance(weights)), np.float64)

    def estimate(self) -> Estimate:
        """Base parameters and quantities with two-sided 95 % intervals."""
        of = (self.rows_used, self.refused[GateReason.RESIDUAL])
        if self._estimated is None or self._estimated[0] != of:
            self._estimated = of, self._estimate(True)
        return self._estimated[1]._replace(refused=dict(self.refused))

    def stated_estimate(self) -> Estimate:
        """The same with 95 % intervals of the stated errors alone: no suspected step, no scale off the drawing."""
        return self._estimate(False)

    @property
    def contradicted(self) -> str:
        """Why no answer is to be used: rows that contradict the others, and what explains them; empty where few do."""
        return contradicted_text(self._share(GateReason.RESIDUAL), then=self._bank.explanation if self._bank else "")

    def _share(self, reason: GateReason) -> float:
        """Of the rows, but for those left out for other reasons, that was left out for this one."""
        return self.refused[reason] / max(self.rows_used + self.refused[reason], 1)

    def _estimate(self, with_unstated: bool) -> Estimate:
        jackknife = self.block_jackknife()
        p, weights = len(self.base.names), self._weights
        interval, prior = jackknife.combination(weights), self.taken.covariance
        spread = np.sqrt((weights @ prior * weights).sum(axis=1))
        shrinkage = np.maximum(interval.sigma, np.sqrt(jackknife.formal_variance(weights))) / spread
        supported = (shrinkage <= SUPPORTED_SHRINKAGE) & (interval.degrees_of_freedom >= SUPPORTED_FREEDOM)
        supported &= self.suspects is None or not self.suspects.judged()[0]
        unstated = self.unstated(jackknife) if with_unstated else Unstated.of([], np.zeros((0, p)))
        unsaid = unstated.sigma(weights)
        half = np.hypot(interval.high - interval.mean, HALF * unsaid)
        sigmas, lows, highs = np.hypot(interval.sigma, unsaid), interval.mean - half, interval.mean + half
        numbers = np.column_stack([interval.mean, sigmas, lows, highs, shrinkage])[p:]
        each = zip(self.quantities, numbers, supported[p:], jackknife.causes(weights)[p:], strict=True)
        quantities = [
            answered(quantity, own, bool(fine), cause, self.considered, jackknife.mean)
            for quantity, own, fine, cause in each
        ]
        quantities = [one.as_far(far) for one, far in zip(quantities, interval.far[p:].tolist(), strict=True)]
        if self.payload:
            why = (not self.suspects and self.contradicted) or self.contradiction(jackknife)
            quantities += self.payload.quantities(jackknife, prior, unstated, why, self._share(GateReason.SATURATED))
        told = sigmas[:p], lows[:p], highs[:p], supported[:p], tuple(quantities)
        of_rows = self.rows_used, dict(self.refused)
        return Estimate(self.base.names, jackknife.mean, *told, *of_rows, far=interval.far[:p])
