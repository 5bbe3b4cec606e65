"""Result of ``heft identify`` for one log: estimates with intervals, evidence, verdict."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from onboard import config
from onboard.dynamics.model.inertia import elements
from onboard.dynamics.model.vehicle import STANDARD
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.policy import HALF
from onboard.ground.identify.kinds.residuals import LeftOver, Residuals
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
