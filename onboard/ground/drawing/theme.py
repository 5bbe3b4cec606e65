"""matplotlib figures to SVG that takes its colours and its font from the page: light, dark and print by CSS alone.

matplotlib is given a colour of its own for each role, and these are replaced by CSS variables in the SVG.
"""

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from cycler import cycler
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

WIDTH_IN = 9.2
COLOUR = {  # by role: those of the light page in page.css; no two are alike, so each can be found in an SVG
    "ink": "#16191d",
    "faint": "#6a727d",
    "grid": "#e4e7eb",
    "paper": "#ffffff",
    "a": "#1f66b0",
    "b": "#c2570c",
    "c": "#2a8a4a",
    "d": "#8a3fa8",
    "e": "#7d6b1e",
    "f": "#0f8390",
    "g": "#b0307a",
    "h": "#5b6472",
    "bad": "#c3232b",
    "good": "#2f9e5b",
    "warn": "#d98e04",
    "idle": "#aab2bd",
    "true": "#b5123f",
}
CYCLE = [COLOUR[role] for role in "abcdefgh"]

_SETTINGS: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "heft",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "text.color": COLOUR["ink"],
    "text.parse_math": False,  # a name with two dollar signs is a name
    "axes.edgecolor": COLOUR["faint"],
    "axes.labelcolor": COLOUR["ink"],
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.titlecolor": COLOUR["ink"],
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.prop_cycle": cycler(color=CYCLE),
    "axes.formatter.useoffset": False,
    "figure.facecolor": "none",
    "grid.color": COLOUR["grid"],
    "grid.linewidth": 0.7,
    "xtick.color": COLOUR["faint"],
    "ytick.color": COLOUR["faint"],
    "xtick.labelcolor": COLOUR["ink"],
    "ytick.labelcolor": COLOUR["ink"],
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.2,
    "path.simplify_threshold": 0.3,
}


@contextmanager
def figures() -> Iterator[None]:
    """Figures made inside look like the page."""
    with rc_context(_SETTINGS):
        yield


_TOP_IN, _BOTTOM_IN, _GAP_IN, _BESIDE_IN, _RIGHT_IN = 0.3, 0.45, 0.52, 1.3, 0.55


def subplots(
    rows: int = 1, columns: int = 1, height_in: float = 1.3, left_in: float = 0.75, **keywords: Any
) -> tuple[Figure, list[Axes]]:
    """A figure of the page's width with ``rows`` x ``columns`` axes, each ``height_in`` high.

    Margins are fixed: laying out by the size of the labels takes longer than drawing.
    """
    height = _TOP_IN + rows * height_in + (rows - 1) * _GAP_IN + _BOTTOM_IN
    right_in = _RIGHT_IN if columns > 1 else 0.1
    figure = Figure(figsize=(WIDTH_IN, height))
    axes = figure.subplots(rows, columns, squeeze=False, **keywords)
    figure.subplots_adjust(
        left=left_in / WIDTH_IN,
        right=1.0 - right_in / WIDTH_IN,
        bottom=_BOTTOM_IN / height,
        top=1.0 - _TOP_IN / height,
        hspace=_GAP_IN / height_in,
        wspace=_BESIDE_IN * columns / (WIDTH_IN - left_in - right_in - (columns - 1) * _BESIDE_IN),
    )
    return figure, list(axes.flat)


def label_lowest(every: list[Axes], shown: int, text: str) -> None:
    """Hide the axes after the first ``shown`` of two columns, and label the lowest of both."""
    for axes in every[shown:]:
        axes.set_visible(False)
    for axes in every[max(0, shown - 2) : shown]:
        axes.set_xlabel(text)


def svg(figure: Figure, title: str, prefix: str) -> str:
    """``figure`` as an SVG element to stand in a page that holds others.

    Args:
        figure: made under :func:`figures`.
        title: for who cannot see it.
        prefix: of its ids, another one for each figure of a page.
    """
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r"<[^>]+>", lambda tag: re.sub(r"(\d+\.\d\d)\d+", r"\1", tag[0]), text)
    text = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'(\bid="|url\(#|xlink:href="#)', rf"\g<1>{prefix}-", text)
    for role, colour in COLOUR.items():
        text = text.replace(colour, f"var(--{role})")
    text = re.sub(r" font-family: [^;]*;", "", text)
    head, _, rest = text.partition(">")
    head = re.sub(r' (?:width|height)="[^"]*"', "", head)
    return f'{head} role="img"><title>{title}</title>{rest}'
