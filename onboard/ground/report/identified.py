"""``heft identify --report``: the identification of logs as a page, with the whitened residuals."""

from collections.abc import Iterator
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from onboard.estimation.gates import GateReason
from onboard.estimation.policy import HALF
from onboard.ground.drawing import html, theme
from onboard.ground.drawing.gallery import Gallery
from onboard.ground.drawing.html import Cell
from onboard.ground.drawing.theme import COLOUR, CYCLE, subplots
from onboard.ground.identify.identify import Identification
from onboard.ground.identify.kinds.identified import Identified, Residuals, autocorrelation
from onboard.ground.log.views.summary import reason_words
from onboard.ground.report.flight.figures import legend
from onboard.identification.standing import Level

_LAGS = 60
_EDGES = np.linspace(-5.0, 5.0, 61)
_KIND = {Level.GOOD: "good", Level.WEAK: "warn", Level.DO_NOT_USE: "bad"}
_CAPTION = (
    "Residuals divided by their sigmas. Left: their histogram beside the normal distribution that they should have. "
    "Right: their autocorrelation over ticks, and the band that holds 95 % of a white series. Signals smoothed "
    "before the rows are made correlate over the kernel; the intervals allow for that by blocks of time. By maximum "
    "likelihood they are wider by what the residuals are above their sigmas."
)


def write(found: Identification, output: Path) -> None:
    """Write the page of ``found``.

    Raises:
        OSError: it cannot be written.
    """
    draw = Gallery()
    with theme.figures():
        sections = [section for log in found.logs for section in _sections(log, draw)]
        name = found.vehicle.file.vehicle.name
        head = f"<h1>{escape(name)}: identified</h1>\n"
        head += html.verdicts((_KIND[log.verdict.level], f"{log.log.name}: {log.verdict.text}") for log in found.logs)
        text = html.page(f"{name}: identified", head, sections, draw.packed())
    html.write(output, text)


def _sections(log: Identified, draw: Gallery) -> Iterator[tuple[str, str]]:
    rows = []
    for one in log.answers:
        numbers = [f"{value:.5g}" if one.supported else "" for value in (one.value, one.low, one.high)]
        told = str(log.standing(one).level) if one.supported else "not determined"
        rows.append([one.name, Cell(numbers[0]), Cell(" … ".join(numbers[1:]).strip(" …")), one.unit, told])
    refused = ", ".join(f"{reason_words(GateReason[name.upper()])} {count:,}" for name, count in log.refused.items())
    used = html.paragraph(f"{log.rows_used:,} rows used, by {log.method}. Refused: {refused or 'none'}.")
    if log.held_out is not None:
        parts = log.held_out.later, log.held_out.earlier, log.held_out.fit
        later, earlier, fit = (f"{100 * one.relative_error:.2f} %" for one in parts)
        used += html.paragraph(f"Later half from earlier {later}, earlier from later {earlier}, all from all {fit}.")
    headings = ["quantity", "value", "95 % interval", "unit", "level"]
    yield log.log.name, used + html.table(headings, rows) + residual_section(log.residuals, draw)


def residual_section(residuals: Residuals, draw: Gallery) -> str:
    """Figure and table of whitened residuals; a sentence where none were kept."""
    shown = {name: series for name, series in residuals.items() if np.isfinite(series).sum() > 1}
    if not shown:
        return html.paragraph("No residuals: nothing was fitted.")
    rows = []
    for name, series in shown.items():
        known = series[np.isfinite(series)]
        beyond = 100.0 * float(np.mean(np.abs(known) > 3.0))
        line = [f"{len(known):,}", f"{known.mean():+.3f}", f"{np.sqrt(np.mean(known**2)):.3f}", f"{beyond:.2f}"]
        rows.append([name, *map(Cell, [*line, f"{autocorrelation(series, 1)[1]:+.3f}"])])
    table = html.table(["residuals of", "number", "mean", "rms", "beyond 3 sigma, %", "correlation, next tick"], rows)
    return table + draw(draw_residuals(shown), _CAPTION)


def draw_residuals(residuals: Residuals) -> Figure:
    """Histogram and autocorrelation of each series, (ticks,) in sigmas."""
    figure, every = subplots(len(residuals), 2, height_in=1.15)
    middle = 0.5 * (_EDGES[1:] + _EDGES[:-1])
    for left, right, (name, series) in zip(every[::2], every[1::2], residuals.items(), strict=True):
        known = series[np.isfinite(series)]
        counts, _ = np.histogram(np.clip(known, _EDGES[0], _EDGES[-1]), _EDGES)
        width = float(_EDGES[1] - _EDGES[0])
        left.step(middle, counts / (len(known) * width), where="mid", color=CYCLE[0], label="residuals")
        left.plot(middle, norm.pdf(middle), "--", color=COLOUR["true"], label="normal")
        left.set_title(name)
        legend(left)
        band = HALF / np.sqrt(len(known))
        right.fill_between([0, _LAGS], [-band] * 2, [band] * 2, color=COLOUR["idle"], alpha=0.35, linewidth=0)
        right.plot(np.arange(_LAGS + 1), autocorrelation(series, _LAGS), ".-", color=CYCLE[0], markersize=4)
        right.set_title(f"{name}: autocorrelation")
        right.set_ylim(-1.05, 1.05)
    every[-2].set_xlabel("sigmas")
    every[-1].set_xlabel("lag, ticks")
    return figure
