"""Findings about an estimate by rows that its intervals do not cover: reasons to doubt or to refuse it."""

from collections.abc import Sequence
from typing import Protocol

from onboard.estimation.recursive.consistency import JackknifeEstimate
from onboard.identification.corrections import doubtful, too_large
from onboard.identification.quantities import Findings, Quantity
from onboard.identification.rows.checks.agreement import InstrumentFit, judged_between, judged_fit
from onboard.identification.rows.checks.suspects import RowSuspects
from onboard.identification.rows.grasped import GraspedPayload
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.considered import Considered
from onboard.identification.rows.stated_errors.drawing import judged_drawing
from onboard.identification.rows.stated_errors.fitted_corrections import Fitted
from onboard.identification.rows.stated_errors.stated import ByErrors, Taken


class _Judged(Protocol):
    """What is judged of an identifier by rows."""

    quantities: tuple[Quantity, ...]
    considered: tuple[Considered, ...]
    payload: GraspedPayload | None
    seen: RowBlocks

    @property
    def suspects(self) -> RowSuspects | None: ...
    @property
    def of_gravity(self) -> tuple[tuple[str, ...], tuple[str, ...]]: ...
    @property
    def contradicted(self) -> str: ...
    @property
    def taken(self) -> Taken: ...
    @property
    def by_errors(self) -> ByErrors | None: ...
    @property
    def correlation(self) -> float: ...
    @property
    def fitted_errors(self) -> Fitted | None: ...
    def block_jackknife(self, exact: bool = False) -> JackknifeEstimate: ...
    def fits(self) -> tuple[InstrumentFit, ...]: ...
    def contradiction(self, jackknife: JackknifeEstimate) -> str: ...


def found(of: _Judged) -> Findings:
    """Reasons to refuse all estimates of an identifier or to weaken them, and remarks that go with any level."""
    said = against, doubts, told = list[str](), list[str](), [] if of.suspects else list(of.taken.said)
    if of.suspects is None and of.contradicted:
        against.append(of.contradicted)
    jackknife = of.block_jackknife()
    judged: list[tuple[Sequence[str], ...]]
    if of.suspects is None:
        fits = of.fits()
        judged = [*(judged_fit(fit, of.correlation) for fit in fits), judged_between(fits)]
        if (by := of.by_errors) is not None and by.doubted is not None:
            name = of.seen.instruments[by.doubted]
            doubts.append(f"{name} contradicts the others by more than its noise, and hardly counts")
    else:
        judged = [of.suspects.judged()]
    judged.append(of.of_gravity)
    judged += [judged_drawing(quantity, jackknife, of.considered) for quantity in of.quantities]
    errors = of.fitted_errors
    judged.append(((errors.misread,) if errors and errors.misread else (),))
    in_sigmas = errors.in_sigmas if errors else {}
    judged.append((too_large(in_sigmas), doubtful(in_sigmas)))
    for texts, more in (pair for one in judged for pair in zip(said, one, strict=False)):
        texts.extend(more)
    if of.payload and not of.suspects and (why := of.contradiction(jackknife)):
        against.append(why)
    return Findings(tuple(against), tuple(doubts), tuple(told))
