"""Verdict on an estimate: good, weak or do not use, with reasons.

The rules, from worst to best; every applicable reason is listed:

- *do not use*: no row could be used, or the estimator failed; more than one row in twenty contradicts the others; the
  estimate explains less than 70 % of the measured signal, and noise does not explain the rest; the estimate is five
  sigmas or more from any physically possible body; no requested quantity is determined; one half of the motion is
  predicted from the other no better than without an estimate, beyond the effect of noise; a fitted correction of an
  instrument lies five stated sigmas out.
- *weak*: a requested quantity is not determined (it is named), or not known well enough
  (:mod:`onboard.identification.quantities`); one half predicts the other with an error above 50 %; a correction lies
  three sigmas out; the log is too short to hold out a half.
- *good*: none of these. Stated sigmas that the rows contradict and that are taken wider are named with any level, and
  so are rows refused because a reading repeats, where these are more than one in twenty.

Whether noise explains a residual follows from the whitened residual sum, corrected for the correlation of neighbouring
rows: above four times the number of rows it is not noise. This alone is not a reason for refusal: friction and gears
leave more than noise, and the jackknife intervals include it.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from onboard.estimation.policy import MISFIT_PART, MISFIT_REFUSED, MOST_CONTRADICTED, MOSTLY
from onboard.identification.corrections import doubtful, refused_from, too_large
from onboard.identification.quantities import Findings
from onboard.identification.rows.checks.agreement import MOST_UNEXPLAINED
from onboard.identification.rows.checks.prediction import HeldOutFit
from onboard.identification.rows.held_out import HeldOut
from onboard.identification.standing import Level, Standing

_JUMPED = "the angle of a joint jumps between two samples; nothing is used from there until it jumps back"
TOO_SHORT = "too short to be checked on motion that was not used"


class Verdict(NamedTuple):
    """A level and its reasons."""

    level: Level
    reasons: tuple[str, ...]
    weak: tuple[str, ...]  # requested quantities that are not determined

    @property
    def text(self) -> str:
        """``weak in these directions: I_yy, I_zz; ...``."""
        directions = f" in these directions: {', '.join(self.weak)}" if self.weak and self.level is Level.WEAK else ""
        reasons = "; ".join(self.reasons)
        return self.level + directions + (f"{';' if directions else ':'} {reasons}" if reasons else "")


class Evidence(NamedTuple):
    """Input of a verdict."""

    rows_used: int
    refused: Mapping[str, int]  # rows by reason
    asked: Mapping[str, bool]  # what was asked for, and whether the data determine it
    held_out: HeldOut | None
    correlation: float = 1.0  # how many neighbouring rows say the same thing: the square of the sigmas' inflation
    failure: str = ""  # why the estimator gave up
    away: Mapping[str, float] = MappingProxyType({})  # by link: sigmas from what was found to a body
    misfit: float | None = None  # of a maximum likelihood fit: residual sum over its degrees of freedom
    findings: Findings = Findings()  # about all quantities
    standings: Mapping[str, Standing] = MappingProxyType({})  # of what was asked and is determined
    corrections: Mapping[str, float] = MappingProxyType({})  # fitted to the instruments: by name, in stated sigmas
    unchecked: str = TOO_SHORT  # why nothing is held out, where it is not


def verdict(evidence: Evidence) -> Verdict:
    """The rules at the head of this file."""
    found = evidence.findings
    if not evidence.rows_used and not evidence.failure:
        why = ", ".join(f"{count} {reason}" for reason, count in evidence.refused.items())
        return Verdict(Level.DO_NOT_USE, (f"no row could be used ({why or 'there was none'})",), tuple(evidence.asked))
    if evidence.failure:
        beside = (*found.against, *found.doubts, *_jumped(evidence), *found.widened)
        return Verdict(Level.DO_NOT_USE, (evidence.failure, *beside), tuple(evidence.asked))
    weak = tuple(name for name, determined in evidence.asked.items() if not determined)
    of_all = _of_all(evidence)
    of_one = {name: one for name, one in evidence.standings.items() if evidence.asked.get(name)}
    bad = [*of_all.against, *_together(of_one, Level.DO_NOT_USE)]
    if len(weak) == len(evidence.asked):
        bad.append("the motion determines nothing that was asked; move more, and every joint")
    reasons = [*of_all.doubts, *_together(of_one, Level.WEAK)]
    level = Level.DO_NOT_USE if bad else Level.WEAK if weak or reasons else Level.GOOD
    return Verdict(level, (*bad, *reasons, *of_all.widened, *_repeated(evidence)), weak)


def standings_of(evidence: Evidence) -> dict[str, Standing]:
    """Level of each determined quantity with what the verdict says of all, as on board."""
    of_all = _of_all(evidence)
    return {name: one.after(of_all) for name, one in evidence.standings.items()}


def _of_all(evidence: Evidence) -> Findings:
    """What concerns all quantities: contradictions, prediction of one half from the other, corrections."""
    against = [*_contradictions(evidence), *evidence.findings.against]
    doubts = [*evidence.findings.doubts, *_jumped(evidence), *doubtful(evidence.corrections)]
    held_out = evidence.held_out
    if held_out is None:
        doubts += [evidence.unchecked] * bool(evidence.unchecked)
    elif beyond := [one for one in (held_out.later, held_out.earlier) if _beyond_noise(one, evidence)]:
        off = max(beyond).relative_error
        said = f"a half of the motion predicted from the other is off by {off:.0%}"
        if off >= 1.0:  # as much as there is to be predicted
            against.append(said)
        elif off >= MOSTLY:
            doubts.append(said)
    return Findings(tuple(against), tuple(doubts), evidence.findings.widened)


def _jumped(evidence: Evidence) -> list[str]:
    return [_JUMPED] * bool(evidence.refused.get("jumped"))


def _contradictions(evidence: Evidence) -> list[str]:
    said = []
    fit = evidence.held_out.fit if evidence.held_out is not None else None
    if fit is not None and fit.relative_error > MOST_UNEXPLAINED and _beyond_noise(fit, evidence):
        said.append(
            f"no body explains what was measured: {fit.relative_error:.0%} of it is left over; check signs, frames and "
            "units, and the sensors against each other"
        )
    for link, away in evidence.away.items():
        if away > refused_from(len(evidence.away)):
            far = f"{away:.0f} sigmas from any body" if away < np.inf else "no body is near it"
            said.append(f"the estimate of {link} cannot exist: {far}; check signs and units")
    said += too_large(evidence.corrections)
    if evidence.misfit is not None and evidence.misfit > MISFIT_REFUSED:
        said.append(
            f"no body explains what was measured: {evidence.misfit:.1f} times the noise is left over; check signs, "
            "frames and units, and the sensors against each other"
        )
    return said


def _repeated(evidence: Evidence) -> list[str]:
    """Remarks, at any level, on rows that were refused because a reading repeats."""
    stuck = evidence.refused.get("stuck", 0)
    share = stuck / (evidence.rows_used + stuck)
    if share <= MOST_CONTRADICTED:
        return []
    return [
        f"{share:.0%} of the rows were refused, as a reading repeats where it must change; if that is how it was "
        "recorded, give its device repeats = true"
    ]


def _together(standings: Mapping[str, Standing], level: Level) -> list[str]:
    """Quantities of a level by their reason: ``m, I_xx: its interval contains zero``."""
    names: dict[str, list[str]] = {}
    for name, one in standings.items():
        if one.level is level:
            names.setdefault(one.why, []).append(name)
    return [f"{', '.join(of)}: {why}" for why, of in names.items()]


def _beyond_noise(prediction: HeldOutFit, evidence: Evidence) -> bool:
    return prediction.misfit * evidence.correlation > MISFIT_PART
