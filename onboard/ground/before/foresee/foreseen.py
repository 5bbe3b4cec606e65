"""What a planned motion determines, as a table of 80 columns with words under it."""

from math import isfinite

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from onboard.estimation.policy import HALF
from onboard.ground.before.foresee.plan import UNDETERMINED, Expected, Foreseen
from onboard.identification.standing import Level

_UNITS = {"kg": ("g", 1e3), "m": ("mm", 1e3), "kg m^2": ("g m²", 1e3)}
_ROUNDING = 1e-9  # of an interval: a value below it is zero


def render(found: Foreseen, motion: str) -> RenderableType:
    """The table.

    Args:
        found: by the bound.
        motion: in words: whose it is.
    """
    if not found.quantities and not found.parameters:
        return Text("nothing is held in this motion: there is nothing to determine")
    held = "" if found.payload is None else f", a payload of {1e3 * found.payload.mass_kg:.0f} g assumed"
    title = f"expected of {motion}{held}"
    numbers = (Column(one, justify="right", no_wrap=True) for one in ("assumed", "95 % interval", "of it, %"))
    table = Table(Column(no_wrap=True), *numbers, Column(no_wrap=True), box=SIMPLE_HEAD, pad_edge=False)
    for one in found.quantities:
        unit, factor = _UNITS.get(one.unit, (one.unit, 1.0))
        half = HALF * one.sigma
        value = 0.0 if abs(one.value) < _ROUNDING * half else one.value
        share = f"{100.0 * half / abs(value):.2g}" if value and one.unit != "m" else ""
        given = f"± {_short(factor * half)}" if isfinite(half) and one.why != UNDETERMINED else "—"
        shown = share if one.level is Level.GOOD else ""
        table.add_row(f"{one.name}, {unit}", _short(factor * value), given, shown, str(one.level))
    lines = [_listed(found.parameters, Level.GOOD, "determined"), _listed(found.parameters, Level.WEAK, "weak")]
    whole = [one for one in found.quantities if one.level is not Level.GOOD]
    by_reason: dict[str, list[str]] = {}
    for one in whole:
        by_reason.setdefault(one.why, []).append(one.name)
    lines += [f"weak, {why}: {', '.join(names)}" for why, names in by_reason.items()]
    lines += list(found.words)
    return Group(Text(title), *([table] if found.quantities else []), *(Text(line) for line in lines if line))


def _listed(parameters: tuple[Expected, ...], level: Level, word: str) -> str:
    """``determined (3 of 5, SI): ZZ_arm 0.25 ± 0.002, ...``; of the weak ones the names alone."""
    mine = [one for one in parameters if one.level is level]
    if not mine:
        return ""
    good = level is Level.GOOD
    said = [f"{one.name} {_short(one.value)} ± {_short(HALF * one.sigma)}" if good else one.name for one in mine]
    return f"{word} ({len(mine)} of {len(parameters)} parameters, SI): {', '.join(said)}"


def _short(value: float) -> str:
    """Three significant digits, without exponents where that is readable."""
    if 1e3 <= abs(value) < 1e5:
        return f"{value:.0f}"
    return f"{value:.3g}" if 1e-4 <= abs(value) < 1e5 or value == 0.0 else f"{value:.1e}"
