"""Figures of the estimates: torque and acceleration, masses by sweep, convergence."""

import math
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from drivers.records import Rows
from onboard.estimation.arrays import FloatArray
from onboard.estimation.gates import GateReason
from onboard.ground.drawing.theme import COLOUR, CYCLE, label_lowest, subplots
from onboard.ground.report.flight.alone import Alone
from onboard.ground.report.flight.figures import legend, second_axis, shade
from onboard.ground.report.flight.flight_data import FlightData, SweepData
from onboard.recording.format.texts import printable

_LINES = 4  # sweeps per axes
GRAM = {"kg": ("g", 1e3), "kg m^2": ("g m²", 1e3), "kg m": ("g m", 1e3)}


def digits(value: float, width: float) -> str:
    """``value`` with two digits of an interval ``width`` wide."""
    decimals = 0 if width <= 0 or not math.isfinite(width) else max(0, 1 - math.floor(math.log10(width)))
    return f"{value:z.{decimals}f}"


def shown_unit(unit: str, size: float) -> tuple[str, float]:
    """Display unit and factor for a value of ``size``."""
    if unit in GRAM and abs(size) < 1.0:
        return GRAM[unit]
    return unit.replace("^2", "²"), 1.0


_UNITS = {"M": "kg", "X": "kg m²", "Y": "kg m²", "Z": "kg m²", "Ia": "kg m²", "scale": "relative", "zero": "m/s²"}


def base_unit(name: str, flight: FlightData) -> str:
    """Unit of a base parameter by its name (:class:`onboard.regressor.rows.RowModel`); empty where not known."""
    kind, _, of = name.partition("_")
    if kind in ("MX", "MY", "MZ"):
        return "kg m"
    if kind in ("Fv", "Fc"):
        joints = flight.model.joints if flight.model is not None else ()
        turns = all(joint.revolute for joint in joints if joint.name == of.removesuffix("_R"))
        torque, rate = ("N m", "rad") if turns else ("N", "m")
        return torque if kind == "Fc" else f"{torque} s/{rate}"
    if kind == "bias":
        return _bias_unit(of.removesuffix("_R"), flight)
    return _UNITS.get(kind, _UNITS.get(kind[:1], "") if len(kind) == 2 else "")


def _bias_unit(row: str, flight: FlightData) -> str:
    cells = {cell.name for cell in (flight.roles.cells if flight.roles else ())}  # a moment is a force on a lever
    return "N m" if row.startswith(("torque", "base_moment")) and row not in cells else "N"


class Side(NamedTuple):
    """Measured side of one row of the regression: its index in ROW, unit, and factor from the logged number."""

    row: int
    unit: str
    factor: float


def torque_and_acceleration(flight: FlightData, side: Side) -> Figure | None:
    """Measured side of a row and the joint's acceleration, sweep by sweep (as figures 4.53 to 4.56)."""
    shown = [sweep for sweep in flight.sweeps if sweep.moving and sweep.rows is not None and len(sweep.rows)]
    if not shown:
        return None
    figure, every = subplots(len(shown), 2, width_ratios=[2.1, 1.0])
    for sweep, over_time, against in zip(shown, every[::2], every[1::2], strict=True):
        _over_time(over_time, flight, sweep, side, first=sweep is shown[0])
        _against(against, sweep, side, first=sweep is shown[0])
    every[-2].set_xlabel("time, s")
    every[-1].set_xlabel("joint acceleration, rad/s²")
    return figure


def _over_time(axes: Axes, flight: FlightData, sweep: SweepData, side: Side, *, first: bool) -> None:
    assert sweep.rows is not None
    at_s = flight.seconds(sweep.rows["vehicle_ns"])
    other = second_axis(axes, "rad/s²")
    measured, _ = _measured(sweep.rows, side)
    [one] = axes.plot(at_s, measured, color=CYCLE[1])
    [two] = other.plot(at_s, sweep.rows["joint_rad_s2"][:, -1], color=CYCLE[0])
    axes.set_title(sweep.phase.name)
    axes.set_ylabel(side.unit)
    axes.set_xlim(at_s[0], at_s[-1])
    if first:
        legend(axes, [one, two], ["measured", "joint acceleration (right)"])


def _measured(rows: Rows, side: Side) -> tuple[FloatArray, NDArray[np.bool_]]:
    """The measured side, and which rows were used; rows with a saturated sample under the kernel are left out."""
    gate = rows["gate"][:, side.row]
    measured: FloatArray = side.factor * rows["measured"][:, side.row]
    return np.where(gate & GateReason.SATURATED, np.nan, measured), gate == 0


def _against(axes: Axes, sweep: SweepData, side: Side, *, first: bool) -> None:
    assert sweep.rows is not None
    x = sweep.rows["joint_rad_s2"][:, -1]
    y, used = _measured(sweep.rows, side)
    axes.plot(x[~used], y[~used], ".", color=COLOUR["idle"], markersize=2, label="refused")
    axes.plot(x[used], y[used], ".", color=CYCLE[1], markersize=2, label="used")
    axes.set_ylabel(side.unit)
    if used.sum() > 2:
        slope, level = np.polyfit(x[used], y[used], 1)
        ends = np.array([x[used].min(), x[used].max()])
        axes.plot(ends, slope * ends + level, color=COLOUR["ink"], linewidth=0.8)
        text = f"slope {slope:.3f} g m²" if side.unit == "mN m" else f"slope {slope:.4g} {side.unit} s²/rad"
        axes.text(0.04, 0.95, text, transform=axes.transAxes, va="top", fontsize=8.5)
    if first:
        legend(axes, markerscale=4)


def by_sweep(flight: FlightData, found: dict[str, list[Alone]], truths: dict[str, float]) -> Figure | None:
    """Each quantity estimated by every sweep alone, over its course and at its end (as figures 4.57 to 4.60).

    Args:
        flight: the flight.
        found: estimates by sweep name.
        truths: known true values by quantity, SI.
    """
    names = list(dict.fromkeys(one.name for answers in found.values() for one in answers if one.unit))
    if not names:
        return None
    figure, every = subplots(-(-len(names) // 2), 2)
    for axes, name in zip(every, names, strict=False):
        mine = [(sweep, one) for sweep, answers in found.items() for one in answers if one.name == name]
        unit, factor = shown_unit(mine[0][1].unit, mine[0][1].value[-1])
        if len(mine) > _LINES:
            _ends(axes, flight, [one for _, one in mine], factor)
        for sweep, one in mine if len(mine) <= _LINES else ():
            at_s = flight.seconds(one.at_ns)
            [line] = axes.plot(at_s, factor * one.value, ".-", markersize=4, label=sweep)
            low, high = factor * one.low, factor * one.high
            axes.fill_between(at_s, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
        ends = [factor * end[-1] for _, one in mine for end in (one.low, one.high)]
        _frame(axes, [factor * one.value[-1] for _, one in mine], ends)
        _truth(axes, truths.get(name), factor)
        axes.set_title(name)
        axes.set_ylabel(unit)
        legend(axes)
    label_lowest(every, len(names), "time, s")
    return figure


def _ends(axes: Axes, flight: FlightData, found: list[Alone], factor: float) -> None:
    """Final estimates of many sweeps."""
    at_s = [float(flight.seconds(one.at_ns[-1])) for one in found]
    value, low, high = (
        factor * np.array([part[-1] for part in parts]) for parts in zip(*(one[3:] for one in found), strict=True)
    )
    axes.errorbar(at_s, value, [value - low, high - value], fmt=".", color=CYCLE[0], elinewidth=1.0, label="each sweep")


def _frame(axes: Axes, values: list[float], ends: list[float]) -> None:
    """Set the vertical range so that the last intervals fill a third of it."""
    middle, reach = float(np.mean(values)), max(abs(end - float(np.mean(values))) for end in ends)
    if np.isfinite(reach) and reach > 0.0:
        axes.set_ylim(middle - 3 * reach, middle + 3 * reach)


def _truth(axes: Axes, value: float | None, factor: float) -> None:
    if value is not None:
        axes.axhline(factor * value, color=COLOUR["true"], linestyle="--", linewidth=1.0, label="truth")


def convergence(flight: FlightData, truths: dict[str, float], *, quantities: bool) -> Figure | None:
    """Onboard estimates with their 95 % band, from the time they are determined.

    Args:
        flight: the flight.
        truths: known true values by quantity, SI.
        quantities: plot the quantities; else the base parameters.
    """
    names = [
        name
        for name, rows in flight.quantities.items()
        if bool(rows[-1]["supported"]) and bool(rows[-1]["unit"]) is quantities
    ]
    if not names:
        return None
    figure, every = subplots(-(-len(names) // 2), 2, height_in=1.15)
    for axes, name in zip(every, names, strict=False):
        rows = flight.quantities[name]
        rows = rows[rows["supported"] != 0]
        unit, factor = shown_unit(printable(rows["unit"][-1]), float(rows["value"][-1]))
        at_s = flight.seconds(rows["vehicle_ns"])
        axes.fill_between(at_s, factor * rows["low"], factor * rows["high"], color=CYCLE[0], alpha=0.22, linewidth=0)
        axes.plot(at_s, factor * rows["value"], color=CYCLE[0])
        last = rows[-1]
        _frame(axes, [factor * last["value"]], [factor * last["low"], factor * last["high"]])
        _truth(axes, truths.get(name), factor)
        shade(axes, flight)
        axes.set_title(f"{name}, {unit or base_unit(name, flight)}".removesuffix(", "))
    label_lowest(every, len(names), "time, s")
    return figure
