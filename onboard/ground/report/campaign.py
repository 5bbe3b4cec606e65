"""``heft campaign report``: a campaign as a page: coverage, errors, what drives them, faults and their outcomes."""

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import norm

from onboard.estimation.policy import INTERVAL
from onboard.ground.campaign.results import Outcome
from onboard.ground.campaign.statistics import NO_FAULT, Effect, Share, Summary
from onboard.ground.campaign.store import Content, Store
from onboard.ground.drawing import html, theme
from onboard.ground.drawing.gallery import Gallery
from onboard.ground.drawing.html import Cell
from onboard.ground.drawing.theme import COLOUR, CYCLE, label_lowest, subplots
from onboard.ground.report.flight.figures import legend

_MOST_DRAWN = 16  # quantities
_EDGES = np.linspace(-5.0, 5.0, 41)
_MOST_TOLD = 8  # flights with confident nonsense at the head of the page
_CLEAR = 0.01  # chance below which a factor is named
_KINDS = {Outcome.RIGHT: "good", Outcome.WEAK: "", Outcome.DO_NOT_USE: "warn", Outcome.LEANS: "warn"}
_COVERAGE = (
    "Share of truths inside their 95 % interval, with its 95 % band (binomial, exact). The band of an honest interval "
    "holds 95 %, the dashed line."
)
_WHITENED = "Errors divided by their sigmas, those beyond 5 at the edge, beside the normal distribution."
_EFFECTS = (
    "By least squares on the design: the part of the variance of the errors, and of the size of their scatter, that "
    "the factor alone explains, and the chance that flights without any effect would show as much (F test)."
)
_MATRIX = (
    "Answers by the fault of their flight (of two faults, under each) and by what they are: confident nonsense is said "
    "as determined while the truth lies beyond its 99.9 % interval; wrong, unseen is the same where no instrument on "
    "board can show it."
)


def write(found: Summary, content: Content, store: Store, output: Path, levels: Mapping[str, Summary]) -> None:
    """Write the page of a campaign, as far as it is flown.

    Args:
        found: of all flights.
        content: of the campaign.
        store: of its results.
        output: the page.
        levels: the same of the flights of some, by what they are.

    Raises:
        OSError: it cannot be written.
    """
    draw = Gallery()
    failed = store.failures(content.items)
    with theme.figures():
        sections = [
            ("Answers", _answers(found) + draw(_coverage(found), _COVERAGE)),
            *((f"Answers, {level}", _answers(of)) for level, of in levels.items()),
            ("Errors", draw(_distributions(found), _WHITENED)),
            ("Faults and outcomes", _matrix(found)),
            ("What drives the errors", _effects(found)),
            ("Farthest answers", _farthest(found, store)),
            ("Failures", _failures(failed, store)),
            ("Plan", f'<pre class="scroll">{escape(content.plan)}</pre>\n'),
        ]
        head = f"<h1>{escape(content.name)}</h1>\n{_cards(found, content, len(failed))}"
        head += html.verdicts(_verdicts(found, len(failed)))
        text = html.page(f"campaign {content.name}", head, sections, draw.packed())
    html.write(output, text)


def _cards(found: Summary, content: Content, failed: int) -> str:
    whole = f"of {len(content.items):,} planned"
    wrong = len(found.wrong_flights)
    cards = html.card("flights", f"{found.flights:,}", "", [whole, f"{failed} failed", f"code {content.revision}"])
    cards += html.card("confident nonsense", f"{len(found.nonsense):,}", "answers", [f"in {wrong} flights"])
    inside, shown = (sum(one.covered[k] for one in found.errors) for k in (0, 1))
    told = f"{100 * inside / shown:.1f}" if shown else "none"
    cards += html.card("truths inside 95 %", told, "%" if shown else "", [f"{inside:,} of {shown:,} answers"])
    if found.detected_once.whole:
        late = f"{np.median(found.late_s):.2f} s, worst {max(found.late_s):.2f} s" if found.late_s else "none"
        part = f"{found.detected_once.part} of {found.detected_once.whole}"
        cards += html.card("captures detected once", part, "", [f"after {late}"])
    return f'<div class="cards">{cards}</div>\n'


def _verdicts(found: Summary, failed: int) -> list[tuple[str, str]]:
    wrong = found.wrong_flights
    told = [("bad", f"confidently wrong: {text}") for _, text in wrong[:_MOST_TOLD]]
    if len(wrong) > _MOST_TOLD:
        told.append(("bad", f"and {len(wrong) - _MOST_TOLD} more flights, among the farthest answers"))
    if not wrong:
        told.append(("good", "no answer is confidently wrong"))
    for errors in found.errors:
        if errors.covered.whole and not errors.covered.low <= INTERVAL <= errors.covered.high:
            narrow = "too narrow" if errors.covered.share < INTERVAL else "wider than they need be"
            told.append(("warn", f"{errors.quantity}: intervals are {narrow}: {errors.covered.text} inside"))
    if found.accounted.part < found.accounted.whole:
        told.append(("bad", f"samples are unaccounted for in {found.accounted.whole - found.accounted.part} flights"))
    if failed:
        told.append(("bad", f"flights that failed: {failed}"))
    if not found.flights:
        told = [("warn", "no flight is done yet")]
    return told


def _answers(found: Summary) -> str:
    rows = []
    for one in found.errors:
        numbers = (one.p95, one.rms, one.mean, one.worst, one.sigma, one.drawn, one.in_sigma, one.in_bound)
        formats = (*[".3g"] * 2, "+.3g", *[".3g"] * 3, ".2f", ".2f")
        cells = [Cell("" if np.isnan(v) else format(v, f)) for v, f in zip(numbers, formats, strict=True)]
        answered = Cell(f"{one.answered:,} of {one.flights:,}")
        rows.append([one.quantity, one.shown_in, answered, *cells, Cell(one.covered.text, _kind(one.covered))])
    headings = ["quantity", "in", "answered", "p95", "rms", "mean", "worst", "sigma", "of it drawn"]
    headings += ["rms / sigma", "rms / bound", "inside 95 % (band)"]
    keep = [n for n in range(len(headings)) if n < 3 or any(str(row[n]) not in ("", "0") for row in rows)]
    return html.table([headings[n] for n in keep], [[row[n] for n in keep] for row in rows], listed=True)


def _kind(covered: Share) -> str:
    return "n" if not covered.whole or covered.low <= INTERVAL <= covered.high else "n warn"


def _coverage(found: Summary) -> Figure | None:
    shown = [one for one in found.errors if one.covered.whole][:_MOST_DRAWN]
    if not shown:
        return None
    figure, (axes,) = subplots(1, 1, height_in=0.4 + 0.22 * len(shown), left_in=1.9)
    at = np.arange(len(shown))[::-1]
    for place, one in zip(at, shown, strict=True):
        colour = CYCLE[0] if one.covered.low <= INTERVAL <= one.covered.high else COLOUR["warn"]
        axes.plot([100 * one.covered.low, 100 * one.covered.high], [place] * 2, color=colour, linewidth=2.0)
        axes.plot([100 * one.covered.share], [place], "o", color=colour, markersize=5)
    axes.axvline(100 * INTERVAL, linestyle="--", color=COLOUR["true"])
    axes.set_yticks(at, [one.quantity for one in shown])
    axes.set_ylim(-0.6, len(shown) - 0.4)
    axes.set_xlim(min(80.0, 100 * min(one.covered.low for one in shown) - 2.0), 100.5)
    axes.set_xlabel("truths inside their 95 % interval, %")
    return figure


def _distributions(found: Summary) -> Figure | None:
    shown = [one for one in found.errors if len(one.whitened) > 1][:_MOST_DRAWN]
    if not shown:
        return None
    figure, every = subplots((len(shown) + 1) // 2, 2, height_in=1.0)
    middle, width = 0.5 * (_EDGES[1:] + _EDGES[:-1]), float(_EDGES[1] - _EDGES[0])
    for axes, one in zip(every, shown, strict=False):
        counts, _ = np.histogram(np.clip(one.whitened, _EDGES[0], _EDGES[-1]), _EDGES)
        axes.bar(middle, counts / (len(one.whitened) * width), width, color=CYCLE[0], label="flights")
        axes.plot(middle, norm.pdf(middle), "--", color=COLOUR["true"], label="normal")
        axes.set_title(f"{one.quantity}, {len(one.whitened)} answers")
    every[0].set_ylim(top=1.5 * every[0].get_ylim()[1])  # room for the legend
    legend(every[0])
    label_lowest(every, len(shown), "error, sigmas")
    return figure


def _matrix(found: Summary) -> str:
    if not found.outcomes:
        return ""
    every = [one for one in Outcome if any(counter[one] for counter in found.outcomes.values())]
    shown = [*every, *([] if Outcome.NONSENSE in every else [Outcome.NONSENSE])]
    rows = []
    for fault, counter in found.outcomes.items():
        cells = []
        for one in shown:
            kind = "bad" if one is Outcome.NONSENSE else _KINDS.get(one, "")
            cells.append(Cell(counter[one] or "", f"n {kind}".strip() if counter[one] else "n"))
        name = "no fault" if fault == NO_FAULT else fault
        wrong = found.nonsense_of.get(fault, 0)
        rows.append([name, Cell(found.flights_of.get(fault, 0)), *cells, Cell(wrong or "", "n bad" if wrong else "n")])
    headings = ["fault", "flights", *map(str, shown), "flights with nonsense"]
    return html.paragraph(_MATRIX) + html.table(headings, rows)


def _effects(found: Summary) -> str:
    told = [one for one in found.effects if min(one.shifts_chance, one.spreads_chance) < _CLEAR]
    if not found.effects:
        return ""
    rows = [[one.quantity, one.factor, *_effect(one)] for one in told or found.effects]
    none = "" if told else html.paragraph(f"No factor has an effect with a chance below {100 * _CLEAR:g} %.")
    headings = ["quantity", "factor", "of the errors, %", "chance", "of their scatter, %", "chance"]
    return html.paragraph(_EFFECTS) + none + html.table(headings, rows)


def _effect(one: Effect) -> list[Cell]:
    cells = []
    for share, chance in ((one.shifts, one.shifts_chance), (one.spreads, one.spreads_chance)):
        cells += [Cell(f"{100 * share:.1f}"), Cell(f"{chance:.1g}", "n warn" if chance < _CLEAR else "n")]
    return cells


def _farthest(found: Summary, store: Store) -> str:
    rows = []
    for one in dict.fromkeys((*found.nonsense, *found.worst)):
        kind = "bad" if one.outcome == Outcome.NONSENSE else ""
        half = Cell(f"{one.half_widths:.2f}", f"n {kind}".strip())
        faults = ", ".join(one.faults)
        error = Cell(f"{one.error:+.3g} {one.shown_in}".rstrip())
        log = _log(one.flight, store)
        rows.append([one.what, one.quantity, error, half, one.outcome, faults, log])
    headings = ["flight", "quantity", "error", "half-widths of 99.9 %", "outcome", "faults", "log, or flight"]
    told = "A flight without a log is flown again, and keeps it, with: heft campaign PLAN --again FLIGHT"
    return html.table(headings, rows) + html.paragraph(told) if rows else ""


def _log(flight: str, store: Store) -> str:
    path = store.log_of(flight)
    return str(path) if path is not None else flight


def _failures(failed: Mapping[str, Mapping[str, Any]], store: Store) -> str:
    rows = []
    for flight, told in failed.items():
        last = str(told["error"]).strip().splitlines()[-1:] or [""]
        rows.append([told["what"], Cell(last[0], "bad"), _log(flight, store)])
    return html.table(["flight", "why", "log, or flight"], rows)
