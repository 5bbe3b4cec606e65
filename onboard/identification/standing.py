"""Level of one quantity: good, weak or do not use, with its reason."""

from enum import StrEnum
from typing import NamedTuple

from onboard.identification.quantities import Findings, QuantityEstimate, Size, is_positive, too_wide


class Level(StrEnum):
    """From best to worst."""

    GOOD = "good"
    WEAK = "weak"
    DO_NOT_USE = "do not use"


LEVELS = tuple(Level)  # by their number in QUANTITY


class Standing(NamedTuple):
    """Level of one quantity and its reason."""

    level: Level
    why: str = ""

    def after(self, found: Findings) -> "Standing":
        """With what was found of all quantities; what a good one leans on is not said of a weak one."""
        if found.against:
            return Standing(Level.DO_NOT_USE, "; ".join(found.against))
        if found.doubts and self.level is not Level.DO_NOT_USE:
            return Standing(Level.WEAK, "; ".join([*([self.why] if self.level is Level.WEAK else []), *found.doubts]))
        if found.widened and self.level is Level.GOOD:
            return Standing(Level.GOOD, "; ".join([*([self.why] if self.why else []), *found.widened]))
        return self

    @property
    def text(self) -> str:
        """``weak: its interval contains zero``."""
        return f"{self.level}: {self.why}" if self.why else str(self.level)


def standing(quantity: QuantityEstimate, findings: Findings, size: Size | None = None) -> Standing:
    """Level of a quantity, in flight and afterwards.

    *Do not use*: a finding refuses all estimates, also those that the data do not determine, or the interval of a mass
    or moment of inertia lies below zero. *Weak*: the data do not determine it; its interval contains zero, or is
    too wide for its ``size``; a finding weakens it. The text of a good one says which calibrations it leans on.
    """
    if not quantity.supported:
        return Standing(Level.WEAK, quantity.note).after(findings)
    reasons = []
    if is_positive(quantity.name, quantity.unit):
        if quantity.high <= 0.0:
            return Standing(Level.DO_NOT_USE, "it cannot be negative: check signs and units").after(findings)
        if quantity.low <= 0.0:
            reasons.append("its interval contains zero")
    if not reasons and (wide := too_wide(quantity, size)):
        reasons.append(wide)
    own = Standing(Level.WEAK, "; ".join(reasons)) if reasons else Standing(Level.GOOD, quantity.leans)
    return own.after(findings)
