"""What stays identifiable without something, as a table beside what everything would give."""

from math import isfinite

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from onboard.estimation.policy import HALF
from onboard.ground.before.foresee.contingency import Contingency
from onboard.ground.before.foresee.plan import UNDETERMINED, Expected
from onboard.identification.standing import Level

_STYLE = {Level.GOOD: "green", Level.WEAK: "yellow"}


def render(found: Contingency, motion: str) -> RenderableType:
    """The table.

    Args:
        found: by the bound.
        motion: in words: whose it is.
    """
    head = [Text(f"without {', '.join(found.lost)}, by {motion}"), *(Text(f"  {words}") for words in found.words)]
    if found.left is None:
        return Group(*head, Text(f"nothing can be determined: {found.why}", "red"))
    name, without = (Column(heading, no_wrap=True) for heading in ("", "without"))
    headings = ("assumed", "95 %, with all", "95 %, without", "wider by")
    numbers = (Column(heading, justify="right", no_wrap=True) for heading in headings)
    table = Table(name, *numbers, without, box=SIMPLE_HEAD, pad_edge=False)
    reasons: dict[str, list[str]] = {}
    for whole, left in found.pairs():
        unit = f", {whole.unit}" if whole.unit else ""
        ratio = "" if left is None or not _known(left) or not _known(whole) else f"{left.sigma / whole.sigma:.2f}"
        word = Text("gone", "red") if left is None else Text(str(left.level), _STYLE.get(left.level, "red"))
        table.add_row(f"{whole.name}{unit}", f"{whole.value:.4g}", _half(whole), _half(left), ratio, word)
        if left is not None and left.level is not Level.GOOD:
            reasons.setdefault(left.why, []).append(left.name)
    lines = [Text(f"weak, {why}: {', '.join(names)}") for why, names in reasons.items()]
    return Group(*head, table, *lines, *(Text(words) for words in found.left.words))


def _known(one: Expected) -> bool:
    return isfinite(one.sigma) and one.why != UNDETERMINED


def _half(one: Expected | None) -> str:
    return "—" if one is None or not _known(one) else f"± {HALF * one.sigma:.3g}"
