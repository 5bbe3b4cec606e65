"""A planned motion as words and as a figure."""

from pathlib import Path

import numpy as np
from matplotlib.ticker import NullFormatter
from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from onboard.config.segments import Library
from onboard.ground.before.foresee import foreseen
from onboard.ground.before.planning.planning import PlannedMotion
from onboard.ground.drawing.theme import CYCLE, figures, subplots
from onboard.ground.report.flight.figures import legend

_MOST_PERCENT = 200.0  # interval, in per cent of the quantity, from which on it counts as unknown


def render(made: PlannedMotion | Library) -> RenderableType:
    """What is expected, how much narrower than of the swings, and what is known least; or a library's segments."""
    if isinstance(made, Library):
        return _segments(made)
    before = {answer.name: answer.sigma for answer in made.expected_before.answers}
    gains = [
        f"{answer.name} {answer.sigma / before[answer.name]:.2f}"
        for answer in made.expected.answers
        if answer.name in made.asked and 0.0 < before.get(answer.name, 0.0) < np.inf
    ]
    lines = [made.weakest]
    if made.untold:
        lines.append(f"no motion of this vehicle tells: {', '.join(made.untold)}")
    if gains:
        lines.append(f"width of its interval over that of the swings in its place: {', '.join(gains)}")
    return Group(foreseen.render(made.expected, "the planned motion"), *(Text(line) for line in lines))


def _segments(made: Library) -> RenderableType:
    """The segments, with what they make of the base and their nearest limit at the lightest and heaviest payload."""
    columns = [Column("segment", no_wrap=True)]
    for mass in (made.masses[0], made.masses[-1]):
        columns += [Column(f"{mass:.3g} kg", justify="right"), Column(no_wrap=True)]
    title = "largest rate of the base, rad/s, and the nearest limit"
    table = Table(*columns, box=None, pad_edge=False, title=title, title_justify="left")
    for k, name in enumerate(made.names):
        cells = []
        for m in (0, -1):
            over = 100.0 * (1.0 + made.excess[k, m])
            cells += [f"{made.base_rate[k, m]:.3f}", f"{made.breaks[k][m]} {over:.0f} %"]
        table.add_row(name, *cells)
    return table


def figure(made: PlannedMotion, path: Path) -> None:
    """Draw the joints' angles, and how the sigmas fall while the arm moves, as an SVG file."""
    with figures():
        drawn, (angles, sigmas) = subplots(2, 1, 2.2)
        inside = (made.time_s >= made.start_s - 2.0) & (made.time_s <= made.end_s + 2.0)
        for k, name in enumerate(made.joints):
            angles.plot(made.time_s[inside], made.q[inside, k], label=name, color=CYCLE[k % len(CYCLE)])
        angles.axvspan(made.start_s, made.end_s, alpha=0.06, color=CYCLE[0], lw=0)
        angles.set_title("joints, rad or m; shaded: planned")
        legend(angles)
        time_s = made.start_s + made.along_s
        for k, name in enumerate(made.names):
            share = 100.0 * made.along_sigma[:, k] / made.scales[k]
            sigmas.semilogy(time_s, share, label=name, color=CYCLE[k % len(CYCLE)], ls="-" if k < len(CYCLE) else "--")
        sigmas.set_xlim(angles.get_xlim())
        sigmas.set_ylim(top=_MOST_PERCENT)
        sigmas.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        sigmas.yaxis.set_minor_formatter(NullFormatter())
        sigmas.set_title("expected sigma, % of its size (mass, radius of gyration, half the inertia's trace)")
        sigmas.legend(loc="lower left")
        sigmas.set_xlabel("mission time, s")
        drawn.savefig(path, facecolor="white")
