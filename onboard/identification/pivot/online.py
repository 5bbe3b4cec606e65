"""Answers of a body on a pivot while it turns: the fit of all ticks so far, repeated as their number grows."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from onboard.dynamics.model.errors import SignalError
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.errors import EstimationError
from onboard.estimation.gates import ReasonArray
from onboard.estimation.policy import AGAIN, HALF, INTERVAL, MOSTLY
from onboard.identification.corrections import contradicted, doubtful, expected_sigma, misfit_texts, together
from onboard.identification.free_flyer.prediction.ticks import Ticks, ticks_of
from onboard.identification.pivot.fit import BODY, PivotModel
from onboard.identification.quantities import (
    SUPPORTED_SHRINKAGE,
    Causes,
    Contribution,
    DrawingTolerance,
    Estimate,
    Findings,
    QuantityEstimate,
)
from onboard.identification.rows.free_body import FREE_BODY
from onboard.identification.table.run import TableRun
from onboard.identification.windows import WindowedFit
from onboard.regressor.signals import Signals

_FIRST_TICKS = 200  # of the first fit
_MOST_TICKS = 12_000  # 40 MB of derivatives at once
CHECKED = MOSTLY * DrawingTolerance().inertia  # sigma of a wheel's scale by the data alone, at most
TOLD = "of what the motion tells"
UNCHECKED = "nothing checks the stated inertia of {}: set a known mass on for a while, shake others while it runs fast"


class PivotQuantities(NamedTuple):
    """The quantities of a fit."""

    mean: FloatArray  # (q,)
    covariance: FloatArray  # (q, q) widened
    along: FloatArray  # (q, unknowns) covariance with all unknowns, as stated
    freedom: float


class PivotRun(TableRun):
    """An :class:`onboard.identification.online.OnlineIdentifier` of a body on a pivot.

    Its quantities are the offset of the centre of mass from the pivot, m, inertia about the pivot, and how far each
    balance mass is to go along its axis to bring the offset to zero.

    Args:
        model: predicts the IMU.
        base: its link.
        balance: mass and axis, base axes, of each balance mass by name.
        keys: what states the sigma of each of the model's unknowns; empty for those of the body.
    """

    def __init__(
        self, model: PivotModel, base: str, balance: Mapping[str, tuple[float, Sequence[float]]], keys: Sequence[str]
    ) -> None:
        super().__init__(base)
        self.model, self._causes = model, Causes(keys, model.sigma)
        self._scales = np.flatnonzero([name.startswith("scale_") for name in model.names[BODY:]])
        self.quantity_names = (*FREE_BODY, *(f"move_{name}" for name in balance))
        self._units = ("m",) * 3 + ("kg m^2",) * 6 + ("m",) * len(balance)
        moves = np.array([m * np.asarray(a) / np.linalg.norm(a) for m, a in balance.values()]).reshape(-1, 3)
        self._weights = np.zeros((BODY + len(balance), BODY))
        self._weights[:BODY] = np.diag([*[1.0 / model.mass_kg] * 3, *[1.0] * 6])
        self._weights[BODY:, :3] = -np.linalg.pinv(moves.T)
        self._ticks, self._held = list[Ticks](), list[BoolArray]()
        self._count, self._next = 0, _FIRST_TICKS
        self.found: WindowedFit | None = None
        self.failure = ""

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        """Gates new ticks, and takes them in; a fit is made where they are enough more."""
        found = super().update(signals, attached, excluded)
        if self._count < _MOST_TICKS:
            self.take(ticks_of(signals, np.where(found == 0, signals.measured, np.nan)), attached)
            if self._count >= self._next:
                self._fit()
        return found

    def take(self, ticks: Ticks, held: BoolArray) -> None:
        """Ticks that are gated, for the next fit."""
        self._ticks.append(ticks)
        self._held.append(held)
        self._count += len(ticks.time_s)

    @property
    def taken(self) -> tuple[Ticks, BoolArray]:
        """All ticks so far, and whether something was held at each."""
        return Ticks.joined(self._ticks), np.concatenate(self._held)

    def wait(self) -> None:
        """No fit before the last one."""
        self._next = _MOST_TICKS + 1

    def finish(self) -> None:
        """The fit of all ticks."""
        if self._count:
            self._fit()

    def _fit(self) -> None:
        self._next = max(self._next, round(AGAIN * self._count))
        ticks, held = self.taken
        self._ticks, self._held = [ticks], [held]
        start = None if self.found is None else self.found.fit.x[: self.found.globals]
        try:
            self.found, self.failure = self.model.fit(ticks, held, start), ""
            self.rows_used = self.found.rows
        except (EstimationError, SignalError) as error:
            self.found, self.failure = None, str(error)

    def foresee(self, ticks: Ticks, held: BoolArray, rate: FloatArray) -> None:
        """Go on as if these ticks had been fitted and the drawing were true (:meth:`PivotModel.bound`)."""
        self.found, self.failure = self.model.bound(ticks, held, rate), ""
        self.rows_used = self.found.rows

    def quantities_of(self, mass_kg: float, body: FloatArray) -> FloatArray:
        """Its quantities, (q,), of a body of that mass, by first moment and inertia about the pivot, (9,)."""
        found: FloatArray = self._weights @ body
        found[:3] *= self.model.mass_kg / mass_kg
        return found

    def answers(self) -> PivotQuantities | None:
        """The quantities; None before there is a fit."""
        if self.found is None:
            return None
        body, P = self.model.body(self.found.fit.x), self.found.fit.covariance[:, : self.found.globals]
        along = self._weights @ P[:BODY]
        covariance = self.found.wider * along[:, :BODY] @ self._weights.T
        return PivotQuantities(self._weights @ body, covariance, along, self.found.noise.freedom)

    def estimate(self) -> Estimate:
        """State and quantities; unsupported before there is a fit."""
        found, p = self.answers(), len(self.parameter_names)
        numbers, prior = np.full((5, p), np.nan), self.model.sigma[:BODY]
        quantities = [(np.nan,) * 5] * len(self.quantity_names)
        leans = [""] * len(quantities)
        if found is not None and self.found is not None:
            times = float(stdtrit(found.freedom, 0.5 + 0.5 * INTERVAL) / HALF)
            wide = np.sqrt(self._weights**2 @ prior**2)
            sigma = times * np.sqrt(np.diag(found.covariance))
            rows = np.array([found.mean, sigma, found.mean - HALF * sigma, found.mean + HALF * sigma, sigma / wide])
            quantities = [tuple(one) for one in rows.T.tolist()]
            leans = list(self._causes.said(self._causes.effects(found.along), sigma, np.abs(found.mean)))
            body = self.model.body(self.found.fit.x)
            own = times * np.sqrt(self.found.wider * np.diag(self.found.fit.covariance)[:BODY])
            numbers[:, 1:] = [body, own, body - HALF * own, body + HALF * own, own / prior]
        supported = np.asarray(numbers[4] <= SUPPORTED_SHRINKAGE, np.bool_)
        note = self.failure or "not determined by the data so far"
        made, each = list[QuantityEstimate](), zip(self.quantity_names, self._units, quantities, leans, strict=True)
        for name, unit, (value, spread, low, high, s), lean in each:
            told = name, unit, value, spread, low, high, s <= SUPPORTED_SHRINKAGE
            made.append(QuantityEstimate(*told, leans=lean, shrinkage=s, note=note))
        known = numbers[0], numbers[1], numbers[2], numbers[3], supported
        return Estimate(self.parameter_names, *known, tuple(made), self.rows_used, dict(self.refused))

    def budget(self) -> dict[str, tuple[Contribution, ...]]:
        """What the sigma of each quantity is made of, by its name; empty before there is a fit."""
        found = self.answers()
        if found is None:
            return {}
        sigma = np.array([one.sigma for one in self.estimate().quantities])
        return dict(
            zip(self.quantity_names, self._causes.budget(self._causes.effects(found.along), sigma), strict=True)
        )

    def bounds(self) -> FloatArray:
        """Sigma of each quantity at the stated noise alone (Cramér-Rao), (q,); NaN before there is a fit."""
        found = self.answers()
        if found is None:
            return np.full(len(self.quantity_names), np.nan)
        return np.asarray(np.sqrt(np.maximum((found.along[:, :BODY] * self._weights).sum(axis=1), 0.0)), np.float64)

    def residuals(self) -> tuple[FloatArray, FloatArray]:
        """Times of the ticks fitted, (n,), and what the fit leaves of each line, whitened, (n, 6)."""
        if self.found is None:
            return np.zeros(0), np.zeros((0, 6))
        return self.model.residuals(self._ticks[0], self._held[0], self.found.fit.x)

    def findings(self) -> Findings:
        """What is left over of a sensor, and corrections larger than stated."""
        if self.found is None:
            return Findings()
        x, sigma = self.found.fit.x[BODY : self.found.globals], self.model.sigma[BODY:]
        left = self.found.fit.covariance[BODY : self.found.globals, BODY : self.found.globals] / np.outer(sigma, sigma)
        in_told = x / sigma / expected_sigma(np.ones(len(x)), np.diag(left), self.found.wider)
        each, of_all, unchecked = dict(zip(self.model.names[BODY:], in_told.tolist(), strict=True)), {}, list[str]()
        if (scales := self._scales).size:
            of_wheels, size = left[np.ix_(scales, scales)], float(np.linalg.norm(sigma[scales]))
            mean = sigma[scales] / size  # of all wheels, one stated sigma
            own = float(mean @ of_wheels @ mean)
            common = float(x[scales].sum() / size)
            of_all["the wheels' inertia"] = float(common / expected_sigma(np.ones(1), np.array([own]))[0])
            unchecked = self._unchecked(sigma[scales], np.append(np.diag(of_wheels), own))
        all_of_them = together(x / sigma, left)
        bad, doubts = list(contradicted(each | of_all) or all_of_them.refused()), list(doubtful(each, TOLD))
        doubts += [*doubtful(of_all, TOLD), *all_of_them.doubted(), *unchecked]
        larger, large = misfit_texts(zip(("gyro", "accelerometer"), self.found.by_sensor, strict=True))
        return Findings((*bad, *larger), (*doubts, *large))

    def _unchecked(self, sigma: FloatArray, share: FloatArray) -> list[str]:
        """Which wheels' scales the data tell too little of, together or one by one: the stated ones are not checked.

        Args:
            sigma: stated, (w,).
            share: variances of their errors after the fit, of each and of all together, in stated ones, (w + 1,).
        """
        stated = np.append(sigma, np.linalg.norm(sigma) / sigma.size)
        wide = stated * np.sqrt(share / np.maximum(1.0 - share, np.finfo(np.float64).eps)) > CHECKED
        names = [self.model.names[BODY + k].removeprefix("scale_") for k in self._scales]
        kept = names if wide[-1] else [name for name, one in zip(names, wide[:-1], strict=True) if one]
        return [UNCHECKED.format(", ".join(kept))] if kept else []
