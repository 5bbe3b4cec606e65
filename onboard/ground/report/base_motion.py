"""Table and figure of :class:`onboard.ground.identify.base_motion.flown.Predicted` (as figures 4.14 and 4.15)."""

from pathlib import Path

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from onboard.ground.drawing.theme import CYCLE, figures, subplots
from onboard.ground.identify.base_motion.flown import Predicted
from onboard.ground.report.flight.base_rate import common, rates
from onboard.ground.report.flight.figures import legend

_DEGREES = float(np.degrees(1.0))
_DASHES = {0: "-", 1: (0, (6, 3)), 2: (0, (2, 3))}  # curves on one another stay distinguishable


def render(found: Predicted) -> RenderableType:
    """The errors as a table."""
    one = next(iter(found.found.values()))
    begin, middle, end = one.time_s[0], one.time_s[one.fitted], one.time_s[-1]
    payload = "payload held" if found.held else "nothing held"
    swing = " ".join(f"{_DEGREES * x:.3g}" for x in one.swing)
    headings = ("rms x y z, deg/s", "worst, deg/s", "turned, deg", "off at the end, deg", "off at most, deg")
    numbers = (Column(heading, justify="right") for heading in headings)
    table = Table(Column("predicted by", no_wrap=True), *numbers, box=None, pad_edge=False)
    for method, rate in found.found.items():
        angle, off = rate.turned()
        cells = _DEGREES * np.array([np.abs(rate.error).max(), angle[-1], off[-1], off.max()])
        rms = " ".join(f"{_DEGREES * x:.3g}" for x in rate.rms)
        table.add_row(method, rms, *(f"{x:.3g}" for x in cells))
    said = f"{found.vehicle}: base rate from {middle:.1f} to {end:.1f} s, {payload}; parameters {found.parameters}"
    fitted = f"momentum and gyro offset fitted from {begin:.1f} to {middle:.1f} s; measured swing x y z {swing} deg/s"
    refused = [Text(f"{method}: {why}") for method, why in found.refused.items()]
    return Group(Text(said), Text(fitted), Text(), table, *refused)


def draw(found: Predicted, path: Path) -> None:
    """The rates about each axis, what is left of them, and the angle by which the prediction is off; SVG or PNG."""
    with figures():
        figure, every = subplots(5, height_in=1.15, sharex=True)
        one = next(iter(found.found.values()))
        for axis, axes in enumerate(every[:3]):
            rates(axes, one, axis)
            for k, (method, rate) in enumerate(found.found.items()):
                shown = _DEGREES * rate.predicted[:, axis]
                axes.plot(rate.time_s, shown, color=CYCLE[k], linewidth=1.1, linestyle=_DASHES[k % 3], label=method)
        legend(every[0])
        for k, rate in enumerate(found.found.values()):
            error, off = np.linalg.norm(rate.error, axis=1), rate.turned()[1]
            time_s = rate.time_s[rate.fitted :]
            every[3].plot(time_s, _DEGREES * error, color=CYCLE[k], linewidth=0.9, linestyle=_DASHES[k % 3])
            every[4].plot(time_s, _DEGREES * off, color=CYCLE[k], linewidth=1.1, linestyle=_DASHES[k % 3])
        every[3].set_title("gyro less prediction, size")
        every[3].set_ylabel("deg/s")
        every[4].set_title("angle between measured and predicted attitude, since the fitted part")
        every[4].set_ylabel("deg")
        common(every, one)
        figure.savefig(path, facecolor="white", dpi=120)
