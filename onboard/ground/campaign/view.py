"""A campaign on the terminal: its plan before it is flown, what failed, and its numbers when it is over."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from onboard.ground.campaign.design import Item
from onboard.ground.campaign.results import Outcome
from onboard.ground.campaign.statistics import Summary

MOST_SHOWN = 20


def listed(items: Mapping[str, Item], done: Iterable[str]) -> RenderableType:
    """Every flight of a plan, with its address and whether it is done."""
    had = set(done)
    table = Table(box=None, pad_edge=False)
    for heading in ("flight", "", "what"):
        table.add_column(heading, no_wrap=heading != "what", overflow="fold")
    for address, item in items.items():
        table.add_row(address, "done" if address in had else "", item.text)
    return table


def failures(failed: Mapping[str, Mapping[str, Any]]) -> RenderableType:
    """The last line of each failure, with its address."""
    lines = []
    for address, told in list(failed.items())[:MOST_SHOWN]:
        last = str(told["error"]).strip().splitlines()[-1:] or ["no reason given"]
        lines.append(Text(f"{address}: {told['what']}: {last[0]}"))
    if len(failed) > MOST_SHOWN:
        lines.append(Text(f"and {len(failed) - MOST_SHOWN} more"))
    return Group(*lines)


def summed(found: Summary) -> RenderableType:
    """Errors, coverage, outcomes, and each answer that is confidently wrong."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("", no_wrap=True)
    bounds = ("in bound",) if any(np.isfinite(one.in_bound) for one in found.errors) else ()
    for heading in ("answered", "p95", "rms", "mean", "worst", "sigma", "drawn", "in sigma", *bounds, "inside 95 %"):
        table.add_column(heading, justify="right", no_wrap=True)
    for one in found.errors:
        numbers = (one.p95, one.rms, one.mean, one.worst, one.sigma, one.drawn, one.in_sigma, one.in_bound)
        formats = (*[".3f"] * 2, "+.3f", *[".3f"] * 3, ".2f", ".2f")
        told = ["" if np.isnan(v) else format(v, f) for v, f in zip(numbers, formats, strict=True)]
        unit = f", {one.shown_in}" if one.shown_in else ""
        shown = told if bounds else told[:-1]
        table.add_row(Text(one.quantity + unit), f"{one.answered} of {one.flights}", *shown, one.covered.text)
    counts = [f"{found.answers[one]} {one}" for one in Outcome if found.answers[one]]
    lines = [f"{found.flights} flights; answers: {', '.join(counts) or 'none'}"]
    if found.detected_once.whole:
        late = f" after {np.median(found.late_s):.2f} s, {max(found.late_s):.2f} s at worst" if found.late_s else ""
        lines.append(f"capture reported, once: {found.detected_once.part} of {found.detected_once.whole}{late}")
    if found.accounted.whole:
        lines.append(f"every sample accounted for: {found.accounted.part} of {found.accounted.whole}")
    wrong = found.wrong_flights
    lines += [f"NONSENSE: {flight} {text}" for flight, text in wrong[:MOST_SHOWN]]
    if len(wrong) > MOST_SHOWN:
        lines.append(f"and {len(wrong) - MOST_SHOWN} more flights with nonsense")
    return Group(table, *map(Text, lines))
