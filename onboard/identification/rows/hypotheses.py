"""Parallel identifiers, one per hypothesis (a wrong instrument, a false release); selects the consistent one.

Each redundant instrument (two cells about one axis) is left out by one identifier. A reported release doubles them:
with the payload released, and still held. Rules:

- An identifier is *contradicted* when its own findings refuse its estimate.
- While the one with all instruments, as reported, is not contradicted, it is selected; its intervals hold what an error
  of a gain does that the others show (:mod:`onboard.identification.rows.checks.agreement`). Where two that each leave
  one instrument out differ by more than 3.1 sigmas of the stated errors it is doubtful, and from 4.8 on one of these
  instruments is wrong. This stays so when they draw nearer: rows of the wrong instrument are not forgotten.
- Then each that leaves an instrument out and is not contradicted is weighed by its answers on parts that the drawing
  knows, as nothing else distinguishes two gains. If a single identifier remains it is selected and its left-out
  instrument named; of several the answer is the mixture, and all are named.
- Where the one with all instruments is contradicted by its own rows, and without exactly one instrument nothing is
  doubtful while all others are contradicted too, that one is selected and its left-out instrument named.
- A release is accepted, or rejected, when the evidence of the rows (:mod:`onboard.identification.rows.likelihood`)
  leaves less than the policy's least weight to the other, one report in a hundred being false beforehand. Where
  instruments are redundant, of those hypotheses that find nothing doubtful, and where these agree.
"""

import copy
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.gates import GateReason, ReasonArray
from onboard.estimation.policy import DOUBLINGS, HALF, LEAST_WEIGHT, ODDS
from onboard.identification.corrections import doubtful_from, refused_from
from onboard.identification.evidence.mixture import REPORTED, Mixture
from onboard.identification.online import Change
from onboard.identification.quantities import Estimate, Findings, QuantityEstimate
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.likelihood import nats
from onboard.identification.standing import Level, standing
from onboard.identification.windows import SHORTEST
from onboard.regressor.signals import Signals


def mixed(estimates: Sequence[Estimate], weights: FloatArray) -> Estimate:
    """Mean, sigma and intervals of the mixture of Gaussians that have the intervals of the estimates.

    What one of them does not determine is not supported. Names, notes and counts of rows are the first's.

    Args:
        estimates: of the same parameters and quantities.
        weights: probability of each, (k,), of sum one.
    """
    first = estimates[0]
    parameters = _Mixed([(one.mean, one.low, one.high) for one in estimates], weights)
    supported = np.all([one.supported for one in estimates], axis=0)
    columns = ("value", "low", "high")
    numbers = [[np.array([getattr(q, name) for q in one.quantities]) for name in columns] for one in estimates]
    of_quantities = _Mixed([(mean, low, high) for mean, low, high in numbers], weights)
    quantities = [
        of_quantities.quantity(k, [one.quantities[k] for one in estimates]) for k in range(len(first.quantities))
    ]
    told = parameters.sigma, parameters.low, parameters.high, supported, tuple(quantities)
    return Estimate(first.names, parameters.mean, *told, first.rows_used, first.refused)


class _Mixed:
    """Of means with the ends of their intervals, (n,) of each of k estimates; NaN where one of these is not finite."""

    def __init__(self, each: Sequence[tuple[FloatArray, FloatArray, FloatArray]], weights: FloatArray) -> None:
        means = np.array([mean for mean, _, _ in each])
        halves = np.array([np.maximum(high - mean, mean - low) for mean, low, high in each])
        self._determined = np.isfinite(means).all(axis=0) & np.isfinite(halves).all(axis=0)
        n, one = means.shape[1], np.where(self._determined, means, 0.0)
        variances = np.where(self._determined, (halves / HALF) ** 2, 1.0)
        mixture = Mixture(weights, one, variances[:, :, None] * np.eye(n))
        mean, covariance = mixture.known
        lower, upper, *self._outer = mean + mixture.ends(np.eye(n), REPORTED)
        self.mean, self.sigma = self._or_nan(mean), self._or_nan(np.sqrt(np.diag(covariance)))
        self.low, self.high = self._or_nan(lower), self._or_nan(upper)

    def _or_nan(self, numbers: FloatArray) -> FloatArray:
        return np.where(self._determined, numbers, np.nan)

    def quantity(self, k: int, of_each: Sequence[QuantityEstimate]) -> QuantityEstimate:
        """The k-th; whatever else it has, notes say, is of the estimate that determines it least."""
        least = min(of_each, key=lambda one: (one.supported, -one.shrinkage))
        if not least.supported:
            return least
        mean, sigma, low, high = (float(part[k]) for part in (self.mean, self.sigma, self.low, self.high))
        ends = float(self._outer[0][k]), float(self._outer[1][k])
        return least._replace(value=mean, sigma=sigma, low=low, high=high, own_outer=ends)


class Member(NamedTuple):
    """Hypothesis of one identifier."""

    left_out: str = ""  # an instrument
    still_held: bool = False  # the reported release did not happen


_AS_TOLD = Member()


def has_happened(evidence: Sequence[tuple[float, bool]]) -> bool | None:
    """Whether a reported release happened; None: that is not decided.

    Args:
        evidence: nats for it over that it did not happen, with no instrument or one left out, and whether these count:
            not where a finding is against the likelier of the two, as they include a wrong instrument's rows.
    """
    log_odds = [nats - np.log(ODDS) for nats, counts in evidence if counts]
    found = {bool(odds > 0.0) for odds in log_odds if abs(odds) > -np.log(LEAST_WEIGHT)}
    return found.pop() if len(found) == 1 else None


class Hypotheses:
    """Several identifiers by rows as a single :class:`onboard.identification.online.OnlineIdentifier`.

    Args:
        make: makes an identifier; all are alike, but for the rows that they are given.
        redundant: instruments that measure the same as another.
    """

    def __init__(self, make: Callable[[], Identifier], redundant: Sequence[str] = ()) -> None:
        self._members = {member: make() for member in (_AS_TOLD, *(Member(name) for name in redundant))}
        self._chosen = _AS_TOLD
        self._findings = Findings()
        self._judged = 0
        self._told_rows: int | None = None  # rows used when a release was reported that is not judged yet
        self._released = False  # a release was accepted: what was released does not come back
        self._contradiction = ""  # between two that leave one instrument out each: it stays
        self._mixed = dict[Member, float]()  # weights of those that may be right; empty: the selected one is
        self._news: list[Change] = []

    @property
    def chosen(self) -> Identifier:
        """The selected identifier."""
        return self._members[self._chosen]

    @property
    def row_names(self) -> tuple[str, ...]:
        """Of the columns of ``measured``."""
        return self.chosen.row_names

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Of the base parameters."""
        return self.chosen.parameter_names

    @property
    def quantity_names(self) -> tuple[str, ...]:
        """Of what is reported besides."""
        return self.chosen.quantity_names

    @property
    def rows_used(self) -> int:
        """Of the selected identifier."""
        return self.chosen.rows_used

    @property
    def innovation(self) -> FloatArray:
        """Of the selected identifier."""
        return self.chosen.innovation

    @property
    def refused(self) -> dict[GateReason, int]:
        """Of the selected identifier."""
        return self.chosen.refused

    def update(
        self, signals: Signals, attached: BoolArray, excluded: ReasonArray, otherwise: BoolArray | None = None
    ) -> ReasonArray:
        """Takes the rows of new ticks in.

        Args:
            signals: as for :meth:`Identifier.update`.
            attached: (n,) whether the payload is held, as reported.
            excluded: (n,) reasons.
            otherwise: (n,) the same if the first reported release did not happen.

        Returns:
            (n, rows) reasons of the selected identifier.
        """
        other = attached if otherwise is None else otherwise
        if self._told_rows is None and not self._released and (other != attached).any():
            self._divide()
        names = self.row_names
        own = np.zeros((len(excluded), len(names)), np.int64) if signals.refused is None else signals.refused
        found: ReasonArray | None = None
        for member, identifier in self._members.items():
            left = np.array([name == member.left_out for name in names]) * np.int64(GateReason.LEFT_OUT)
            seen = signals._replace(refused=own | left)
            reasons = identifier.update(seen, other if member.still_held else attached, excluded)
            if member == self._chosen:
                found = reasons
        assert found is not None
        if abs(self.rows_used - self._judged) >= SHORTEST:
            self._judge()
            self._judged = self.rows_used
        return found

    def finish(self) -> None:
        """Judge all rows: no more come."""
        for identifier in self._members.values():
            identifier.finish()
        if self.rows_used >= SHORTEST:
            self._judge()

    def estimate(self) -> Estimate:
        """Of the selected identifier, or the mixture of those that may be right."""
        if self._mixed:
            estimates = [self._members[member].estimate() for member in self._mixed]
            return mixed(estimates, np.array([*self._mixed.values()]))
        return self.chosen.estimate()

    def findings(self) -> Findings:
        """Findings of the selected identifier, and the instrument left out."""
        return self._findings

    def triangle(self) -> FloatArray:
        """Of the selected identifier."""
        return self.chosen.triangle()

    def news(self) -> tuple[Change, ...]:
        """Instruments left out or restored, and releases rejected, since the last call."""
        news, self._news = tuple(self._news), []
        return news

    def _divide(self) -> None:
        """Handles a reported release: adds a copy of each identifier for which it did not happen."""
        self._told_rows = self.rows_used
        self._members |= {
            # the model does not change: it is shared, and a checkpoint refers to it by its place
            member._replace(still_held=True): copy.deepcopy(identifier, {id(identifier.model): identifier.model})
            for member, identifier in self._members.items()
        }

    def _judge(self) -> None:
        findings = {member: identifier.findings() for member, identifier in self._members.items()}
        if self._told_rows is not None and abs(self.rows_used - self._told_rows) >= 2 * SHORTEST:
            self._judge_release(findings)
        as_told = findings[_AS_TOLD]
        others = [member for member in findings if member.left_out and not member.still_held]
        sigmas, apart = self._apart([member for member in self._members if member.left_out])
        if sigmas > refused_from(DOUBLINGS):
            self._contradiction = apart
        weights = self._weights([member for member in others if not findings[member].against])
        chosen, said, self._mixed = _AS_TOLD, as_told, {}
        if self._contradiction and len(weights) > 1:
            self._mixed = weights
            likely = ", ".join(f"{one.left_out} {weight:.2g}" for one, weight in weights.items())
            apart = f"{self._contradiction}; probability of being wrong: {likely}"
            doubts = [apart, *(doubt for member in weights for doubt in findings[member].doubts)]
            said = Findings(doubts=tuple(dict.fromkeys(doubts)))
        elif weights and (self._contradiction or as_told.against):
            likeliest = next(iter(weights))
            if self._contradiction or (len(weights) == 1 and self._is_clean(likeliest, findings[likeliest])):
                chosen = likeliest
                said = findings[chosen].plus(doubts=[f"without {chosen.left_out}, which contradicts the others"])
        elif self._contradiction:
            said = as_told.plus(against=[self._contradiction])
        elif sigmas > doubtful_from(1):
            said = as_told.plus(doubts=[apart])
        if chosen != self._chosen:
            name = chosen.left_out or self._chosen.left_out
            self._note("left_out" if chosen.left_out else "taken_back", name)
        self._chosen, self._findings = chosen, said

    def _weights(self, members: Sequence[Member]) -> dict[Member, float]:
        """Probability of each, one of them being right, by its answers on what the drawing knows; likeliest first."""
        drawn = [self._members[member].drawn for member in members]
        each = np.exp(-0.5 * (np.array(drawn) - min(drawn, default=0.0)))
        weights = dict(zip(members, (each / each.sum()).tolist(), strict=True))
        some = {member: weight for member, weight in weights.items() if weight > LEAST_WEIGHT}
        return {member: weight / sum(some.values()) for member, weight in sorted(some.items(), key=lambda one: -one[1])}

    def _is_clean(self, member: Member, findings: Findings) -> bool:
        """Whether no finding refuses any of its estimates or makes them doubtful."""
        quantities = self._members[member].estimate().quantities
        return not (findings.against or findings.doubts) and all(
            standing(quantity, findings).level is not Level.DO_NOT_USE for quantity in quantities
        )

    def _judge_release(self, findings: dict[Member, Findings]) -> None:
        """Accepts or rejects the reported release, or leaves it undecided."""
        told, evidence = [member for member in findings if not member.still_held], list[tuple[float, bool]]()
        for member in told:
            held = member._replace(still_held=True)
            as_told, as_held = self._members[member], self._members[held]
            better = nats(as_told.rows_seen, as_held.rows_seen, as_told.correlation)
            likelier = member if better > 0.0 else held
            evidence.append((better, len(told) == 1 or self._is_clean(likelier, findings[likelier])))
        accepted = has_happened(evidence)
        if accepted is None:
            return
        if not accepted:
            self._note("release_contradicted", "the arm moves as before")
        kept = {
            member._replace(still_held=False): identifier
            for member, identifier in self._members.items()
            if member.still_held is not accepted
        }
        findings.clear()
        findings |= {member: identifier.findings() for member, identifier in kept.items()}
        self._members, self._told_rows, self._released = kept, None, accepted
        if not accepted:
            self._contradiction, self._mixed = "", {}  # they were of answers that took the release for true

    def _apart(self, members: Sequence[Member]) -> tuple[float, str]:
        """Most sigmas between answers of two that leave one instrument out each, and the sentence that names these."""
        estimates = {one: self._members[one].stated_estimate() for one in members if not one.still_held}
        most = 0.0, ""
        for k, (one, first) in enumerate(estimates.items()):
            for other, second in list(estimates.items())[k + 1 :]:
                for a, b in zip(first.quantities, second.quantities, strict=True):
                    sigmas = abs(a.value - b.value) / float(np.hypot(a.sigma, b.sigma))
                    if a.supported and b.supported and sigmas > most[0]:
                        told = f"{one.left_out} and {other.left_out} contradict each other: {a.name} is "
                        most = sigmas, told + f"{b.value:.4g} or {a.value:.4g} {a.unit}"
        return most

    def _note(self, kind: str, what: str) -> None:
        self._news.append(Change(kind, np.nan, np.nan, np.nan, what))
