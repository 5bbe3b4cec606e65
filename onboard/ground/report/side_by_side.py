"""``heft compare --report``: flights side by side as a page, each quantity with its intervals, mean and trend."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from onboard.estimation.policy import HALF
from onboard.ground.drawing import html, theme
from onboard.ground.drawing.gallery import Gallery
from onboard.ground.drawing.html import Cell
from onboard.ground.drawing.theme import COLOUR, CYCLE, label_lowest, subplots
from onboard.ground.log.views.compare import DISAGREE, ComparedQuantity, FlightComparison, interval

_CAPTION = (
    "Each flight's last answer with its 95 % interval, in the order flown. Line and band: the mean of all, weighted by "
    "the variances; no surer than a flight is, for errors of calibration are common to all. Dashed: the straight line "
    "through three flights or more, and what the 95 % interval of its slope allows."
)


def write(found: FlightComparison, output: Path) -> None:
    """Write the page of ``found``.

    Raises:
        OSError: it cannot be written.
    """
    draw = Gallery()
    with theme.figures():
        sections = [("Flights", _flights(found)), ("Answers", _answers(found) + draw(_figure(found), _CAPTION))]
        head = "<h1>Flights side by side</h1>\n" + html.verdicts(_verdicts(found))
        text = html.page("flights side by side", head, sections, draw.packed())
    html.write(output, text)


def _verdicts(found: FlightComparison) -> list[tuple[str, str]]:
    told = []
    for one in found.quantities:
        unit = f" {one.unit}" if one.unit else ""
        if one.chance is not None and one.chance < DISAGREE:
            told.append(f"{one.name}: the flights disagree; a single value would scatter so in {one.chance:.2g} of all")
        if one.trend is not None and abs(one.trend[0]) > HALF * one.trend[1]:
            told.append(f"{one.name} changes by {interval(*one.trend, sign='+')}{unit} from a flight to the next")
    several = sum(one.chance is not None for one in found.quantities)
    good = f"{several} quantities that several flights answered: all agree, none has a trend"
    return [("warn", text) for text in told] or [("good", good)]


def _flights(found: FlightComparison) -> str:
    rows = []
    for number, flight in enumerate(found.flights, 1):
        missing = Cell(f"{flight.about.unexplained:,}") if flight.about.unexplained else Cell("-")
        used = Cell(f"{flight.said.used:,} of {flight.said.rows:,}")
        rows.append([Cell(number), flight.path.name, Cell(f"{flight.about.duration_s:.2f}"), missing, used])
    return html.table(["", "log", "length, s", "unexplained", "rows used"], rows)


def _answers(found: FlightComparison) -> str:
    rows = []
    for one in found.quantities:
        each = [Cell(interval(value, sigma)) for value, sigma in zip(one.value, one.sigma, strict=True)]
        together = Cell(interval(one.mean, one.sigma_mean))
        trend = Cell("" if one.trend is None else interval(*one.trend, sign="+"))
        differ = one.chance is not None and one.chance < DISAGREE
        agree = Cell("disagree", "warn") if differ else "" if one.chance is None else "agree"
        rows.append([one.name, one.unit, together, trend, agree, *each])
    numbers = [str(number) for number in range(1, len(found.flights) + 1)]
    return html.table(["quantity", "unit", "together", "change a flight", "", *numbers], rows)


def _figure(found: FlightComparison) -> Figure | None:
    shown = [one for one in found.quantities if np.isfinite(one.mean)]
    if not shown:
        return None
    figure, every = subplots((len(shown) + 1) // 2, 2)
    for axes, one in zip(every, shown, strict=False):
        _draw(axes, one)
    label_lowest(every, len(shown), "flight")
    return figure


def _draw(axes: Axes, one: ComparedQuantity) -> None:
    at, value, sigma = np.arange(1, len(one.value) + 1), np.array(one.value), np.array(one.sigma)
    known = np.isfinite(value)
    low, high = one.mean - HALF * one.sigma_mean, one.mean + HALF * one.sigma_mean
    ends = [at[0] - 0.4, at[-1] + 0.4]
    axes.fill_between(ends, [low] * 2, [high] * 2, color=COLOUR["idle"], alpha=0.35, linewidth=0)
    axes.plot(ends, [one.mean] * 2, color=COLOUR["idle"], linewidth=1.0)
    if one.trend is not None:
        weight = 1.0 / sigma[known] ** 2
        middle = float(np.sum(weight * at[known]) / np.sum(weight))
        x = np.array([ends[0], middle, ends[1]])
        line, half = one.mean + one.trend[0] * (x - middle), HALF * one.trend[1] * np.abs(x - middle)
        axes.fill_between(x, line - half, line + half, color=COLOUR["true"], alpha=0.12, linewidth=0)
        axes.plot(x, line, "--", color=COLOUR["true"])
    axes.errorbar(at[known], value[known], HALF * sigma[known], fmt="o", color=CYCLE[0], markersize=4)
    axes.set_title(one.name)
    axes.set_ylabel(one.unit)
    axes.set_xlim(ends[0], ends[1])
    axes.set_xticks(at[:: max(1, len(at) // 10)])
