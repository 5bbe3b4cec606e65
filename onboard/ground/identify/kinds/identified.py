"""Result of ``heft identify`` for one log: estimates with intervals, evidence, verdict, residuals.

Residuals are whitened, at the final estimate, on an even grid of ticks. A model that is right leaves them with unit
variance: by rows correlated over the smoothing kernel only, by maximum likelihood not at all.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard import config
from onboard.dynamics.model.inertia import elements
from onboard.dynamics.model.vehicle import STANDARD
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.policy import HALF
from onboard.ground.identify.kinds.throws import Throw, plain
from onboard.identification.free_flyer.before_capture import BeforeCapture
from onboard.identification.observability import ObservedDirections
from onboard.identification.quantities import Contribution, Findings, QuantityEstimate, Useful, sizes
from onboard.identification.rows.fitted_drawing import FittedLink
from onboard.identification.rows.held_out import HeldOut
from onboard.identification.rows.standard import LinkEstimate
from onboard.identification.standing import Level, Standing, standing
from onboard.identification.verdict import Evidence, Verdict, standings_of, verdict
from onboard.recording.reader import LogReader

MOST = 60_000  # rows that are kept: the first
Residuals = dict[str, FloatArray]  # by series, (ticks,) in sigmas; NaN where none was used


class LeftOver(NamedTuple):
    """Of an instrument, in its unit: N m of a torque."""

    rms: float  # of what is left over
    of_rms: float  # of what it read, both sides smoothed


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values * values)))


class KeptRows:
    """Rows of an identifier.

    Args:
        instruments: that make them, by name.
    """

    def __init__(self, instruments: Sequence[str]) -> None:
        self._instruments = instruments
        self._kept: list[tuple[FloatArray, NDArray[np.intp], FloatArray, FloatArray]] = []
        self._count = 0

    def keep(self, times_s: FloatArray, instrument: NDArray[np.intp], rows: FloatArray, sigma: FloatArray) -> None:
        """Rows ``[Y, y]`` (m, p + 1), whitened by ``sigma``, with their times and instruments, (m,) each."""
        if self._count < MOST:
            self._count += len(rows)
            self._kept.append((times_s, instrument, rows, sigma))

    def left_over(self, mean: FloatArray) -> dict[str, "LeftOver"]:
        """What base parameters ``mean`` (p,) leave of each instrument's readings, every row alike."""
        if not self._kept:
            return {}
        _, instrument, rows, sigma = (np.concatenate(part) for part in zip(*self._kept, strict=True))
        left, read = (part * sigma for part in (rows @ np.append(-mean, 1.0), rows[:, -1]))
        each = {name: instrument == number for number, name in enumerate(self._instruments)}
        return {name: LeftOver(_rms(left[mine]), _rms(read[mine])) for name, mine in each.items() if mine.any()}

    def residuals(self, mean: FloatArray, period_s: float) -> Residuals:
        """Of base parameters ``mean`` (p,), ticks ``period_s`` apart; rows of one instrument at a tick by number."""
        if not self._kept:
            return {}
        times_s, instrument, rows, _ = (np.concatenate(part) for part in zip(*self._kept, strict=True))
        left = rows @ np.append(-mean, 1.0)
        tick = np.round((times_s - times_s[0]) / period_s).astype(np.int64)
        tick -= tick.min()
        found: Residuals = {}
        for number, name in enumerate(self._instruments):
            at, values = tick[instrument == number], left[instrument == number]
            order = np.argsort(at, kind="stable")
            at, values = at[order], values[order]
            rank = np.arange(len(at)) - np.searchsorted(at, at)  # of several rows at a tick
            for k in range(int(rank.max(initial=-1)) + 1):
                series = _series(at[rank == k], values[rank == k], int(tick.max()) + 1)
                found[name if not rank.any() else f"{name} {k + 1}"] = series
        return found


def _series(tick: NDArray[np.int64], values: FloatArray, size: int) -> FloatArray:
    """Values at their ticks, (size,); NaN at the others."""
    series = np.full(size, np.nan)
    series[tick] = values
    return series


def by_axis(time_s: FloatArray, left: FloatArray, period_s: float, further: Sequence[str] = ()) -> Residuals:
    """Series of the base IMU's six axes, and of the lines of further instruments; none of what is not used at all.

    Args:
        time_s: of the ticks, (n,).
        left: their whitened residuals, (n, lines), gyro and accelerometer first; NaN where none was used.
        period_s: between ticks.
        further: names of the lines after the sixth.
    """
    tick = np.round((time_s - time_s[0]) / period_s).astype(np.int64)
    names = [*(f"{one} {axis}" for one in ("gyro", "accelerometer") for axis in "xyz"), *further]
    used = ((name, values) for name, values in zip(names, left.T, strict=True) if not np.isnan(values).all())
    return {name: _series(tick, values, int(tick[-1]) + 1) for name, values in used}


def autocorrelation(series: FloatArray, lags: int) -> FloatArray:
    """Normalised autocorrelation at lags 0 to ``lags``, over the pairs that are known; NaN where there are none."""
    known = np.isfinite(series)
    centred = np.where(known, series - series[known].mean() if known.any() else 0.0, 0.0)
    found = np.full(lags + 1, np.nan)
    for lag in range(min(lags, len(series) - 1) + 1):
        pairs = int(np.count_nonzero(known[lag:] & known[: len(series) - lag]))
        if pairs:
            found[lag] = float(centred[lag:] @ centred[: len(series) - lag]) / pairs
    return np.asarray(found / found[0] if found[0] > 0.0 else np.full(lags + 1, np.nan), np.float64)


def answers_of(
    names: Sequence[str],
    units: Sequence[str],
    values: FloatArray,
    sigma: FloatArray,
    supported: BoolArray,
    bound: FloatArray,
) -> tuple[QuantityEstimate, ...]:
    """Quantities by their sigmas, each array (n,); their intervals are those of normals."""
    half = HALF * sigma
    numbers = (of.tolist() for of in (values, sigma, values - half, values + half, supported, bound))
    return tuple(QuantityEstimate(*one) for one in zip(names, units, *numbers, strict=True))


def standings(answers: Iterable[QuantityEstimate], useful: Useful) -> dict[str, Standing]:
    """What each that the data determine is good for, by its name."""
    told = [one for one in answers if one.supported]
    size = sizes(told, useful)
    return {one.name: standing(one, Findings(), size.get(one.name)) for one in told}


class RunAnswer(NamedTuple):
    """A run of parabolic flights, and what it says by itself."""

    cut: dict[str, Any]  # its parabola, release, catch, bumps, motions
    state: str  # "identified", "pooled" (it determines too little by itself), "refused"
    reason: str
    answers: tuple[QuantityEstimate, ...]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        said = {"state": self.state, "reason": self.reason}
        return {**self.cut, **said, "quantities": [answer.as_json() for answer in self.answers]}


@dataclass(frozen=True)
class Identified:
    """Result for one log."""

    log: Path
    method: str
    answers: tuple[QuantityEstimate, ...]  # base parameters, only a held mass with a unit, then the quantities
    rows_used: int
    refused: dict[str, int]  # rows by reason
    damage: tuple[object, ...]
    verdict: Verdict
    throw: Throw | None = None
    held_out: HeldOut | None = None
    misfit: float | None = None  # of a maximum likelihood fit, over its degrees of freedom
    observability: ObservedDirections | None = None
    standings: Mapping[str, Standing] = field(default_factory=dict)  # of each answer that the data determine
    essential: tuple[str, ...] = ()  # base parameters that differ from zero
    as_read: dict[str, float] = field(default_factory=dict)  # base parameters of what instruments read, gains as stated
    links: tuple[LinkEstimate, ...] = field(default=())
    drawing: tuple[FittedLink, ...] = ()  # all but the payload, with sigmas that a vehicle file can state
    budget: Mapping[str, tuple[Contribution, ...]] = field(default_factory=dict)  # what makes each answer so wide
    left_over: Mapping[str, LeftOver] = field(default_factory=dict)  # by instrument, in its unit
    band_Hz: float | None = None  # noqa: N815  # which smoothed rows are of
    residuals: Residuals = field(default_factory=dict)  # whitened
    runs: tuple[RunAnswer, ...] = ()  # of parabolic flights
    before: BeforeCapture | None = None  # how a payload that was captured moved until then
    misread: bool = False  # the mapping of the recording has a mistake, which the verdict names

    def standing(self, answer: QuantityEstimate) -> Standing:
        """Level of one of its answers, and why."""
        own = self.standings.get(answer.name, Standing(Level.WEAK, "not determined by the data"))
        if self.verdict.level is Level.DO_NOT_USE and own.level is not Level.DO_NOT_USE:
            return Standing(Level.DO_NOT_USE, "; ".join(self.verdict.reasons))
        return own

    @property
    def supported(self) -> bool:
        """Whether the load or at least one requested quantity is determined."""
        if self.throw is not None:
            return self.throw.body is not None
        asked = [answer for answer in self.answers if answer.unit] or self.answers
        return any(answer.supported for answer in asked)

    @property
    def usable(self) -> bool:
        """Whether it is supported and the verdict is not ``do not use``."""
        return self.supported and self.verdict.level is not Level.DO_NOT_USE

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "log": str(self.log),
            "method": self.method,
            "verdict": {**self.verdict._asdict(), "text": self.verdict.text},
            "supported": self.supported,
            "rows_used": self.rows_used,
            "refused": self.refused,
            "damage": [str(one) for one in self.damage],
            "quantities": [one.as_json() | self.standing(one)._asdict() for one in self.answers],
            "held_out": _predictions(self.held_out),
            "misfit": self.misfit,
            "observable": _observability(self.observability),
            "budget": {name: [one._asdict() for one in parts] for name, parts in self.budget.items()},
            "left_over": {name: one._asdict() for name, one in self.left_over.items()},
            "band_Hz": self.band_Hz,
            "essential": list(self.essential),
            "links": [_link(one) for one in self.links],
            "drawing": [{"link": one.link, **one.stated} for one in self.drawing],
            "throw": self.throw.as_json() if self.throw else None,
            **({} if self.before is None else {"before_capture": _before(self.before)}),
            **({"runs": [run.as_json() for run in self.runs]} if self.runs else {}),
        }


def judged(
    log: LogReader,
    evidence: Evidence,
    answers: tuple[QuantityEstimate, ...] = (),
    method: str = config.PREDICTING.name,
    **more: Any,
) -> Identified:
    """Result for a log with the verdict on its evidence; ``more``: further fields."""
    known = log.path, method, answers, evidence.rows_used, dict(evidence.refused), log.damage, verdict(evidence)
    return Identified(*known, held_out=evidence.held_out, standings=standings_of(evidence), **more)


def _before(one: BeforeCapture) -> dict[str, Any]:
    """Velocity of its centre of mass against the gripper, and its rate in space; the gripper's axes."""
    sigma = one.sigma.tolist()
    return {
        "velocity_m_s": one.velocity_m_s.tolist(),
        "velocity_sigma_m_s": sigma[:3],
        "rate_rad_s": one.rate_rad_s.tolist(),
        "rate_sigma_rad_s": sigma[3:],
    }


def _predictions(held_out: HeldOut | None) -> dict[str, Any] | None:
    if held_out is None:
        return None
    parts = {"later_from_earlier": held_out.later, "earlier_from_later": held_out.earlier, "all_from_all": held_out.fit}
    return {name: prediction._asdict() for name, prediction in parts.items()}


def _observability(found: ObservedDirections | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {**found._asdict(), "condition": plain(found.condition), "undetermined": list(found.undetermined)}


def _link(one: LinkEstimate) -> dict[str, Any]:
    return {
        "link": one.link,
        "parameters": list(STANDARD),
        "mean": one.mean.tolist(),
        "covariance": one.covariance.tolist(),
        "sigmas_from_a_body": plain(one.away),
        "body": None
        if one.body is None
        else {
            "mass_kg": one.body.mass_kg,
            "centre_of_mass_m": one.body.centre_of_mass_m.tolist(),
            "inertia_kg_m2": elements(one.body.inertia_kg_m2).tolist(),
        },
    }
