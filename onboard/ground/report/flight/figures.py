"""Figures of a flight: timeline, sensor signals, clocks."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from drivers.records import Rows, Severity
from onboard.estimation.arrays import FloatArray
from onboard.estimation.gates import GateReason
from onboard.ground.drawing.theme import COLOUR, CYCLE, WIDTH_IN, subplots
from onboard.ground.log.tables.phases import Phase
from onboard.ground.log.tables.thin import Trace
from onboard.ground.log.views.summary import reason_words
from onboard.ground.report.flight.flight_data import FlightData, SweepData
from onboard.recording.format.texts import printable
from onboard.timebase.clock import ClockState

STATE_COLOUR = {
    ClockState.ACQUIRING: COLOUR["idle"],
    ClockState.LOCKED: COLOUR["good"],
    ClockState.FLYWHEEL: COLOUR["warn"],
    ClockState.INVALID: COLOUR["bad"],
}
_LETTER_IN, _ENTRY_IN = 0.08, 0.47  # of a title or a legend
_LABEL_WIDTH = 0.035  # fraction of the time axis: shorter phases get no label


def timeline(flight: FlightData) -> Figure:
    """Timeline of phases, row use, clocks, gaps, warnings and errors."""
    lanes = _lanes(flight)
    longest = max((len(name) for name, _ in lanes), default=0)
    figure, [axes] = subplots(height_in=0.25 * max(1, len(lanes)), left_in=0.3 + 0.073 * longest)
    duration_s = max(flight.info.duration_s, 1e-9)
    axes.set_xlim(0.0, duration_s)
    axes.set_ylim(max(1, len(lanes)), 0)
    axes.set_yticks(np.arange(len(lanes)) + 0.5, [name for name, _ in lanes])
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("time since the first record, s")
    for lane, (_, spans) in enumerate(lanes):
        for start_s, end_s, colour, text in spans:
            width = max(end_s - start_s, 0.0015 * duration_s)
            axes.add_patch(Rectangle((start_s, lane + 0.14), width, 0.72, color=colour, linewidth=0))
            if text and width > _LABEL_WIDTH * duration_s:
                style: Any = {"ha": "center", "va": "center", "fontsize": 8, "color": COLOUR["paper"], "clip_on": True}
                axes.text(start_s + 0.5 * width, lane + 0.5, text, **style)
    return figure


LabelledSpan = tuple[float, float, str, str]  # start, end [s], colour, text


def _lanes(flight: FlightData) -> list[tuple[str, list[LabelledSpan]]]:
    lanes: list[tuple[str, list[LabelledSpan]]] = []
    if flight.phases:
        lanes.append(("phase", [_phase_span(flight, phase) for phase in flight.phases]))
    if flight.changes:
        ends_s = [float(flight.seconds(told_ns)) for told_ns, _ in flight.changes[1:]] + [flight.info.duration_s]
        held = [
            (float(flight.seconds(told_ns)), end_s, COLOUR["d"] if kind == "capture" else COLOUR["idle"], kind)
            for (told_ns, kind), end_s in zip(flight.changes, ends_s, strict=True)
        ]
        lanes.append(("payload, as noticed", held))
    if flight.gates is not None:
        at_s = flight.seconds(flight.gates["vehicle_ns"])
        used = (flight.gates["gate"] == 0).any(axis=1)
        lanes.append(("rows used", _runs(at_s, used, COLOUR["good"])))
        for reason in (r for r in GateReason if flight.gate_counts.get(int(r))):
            refused = (flight.gates["gate"] & int(reason) != 0).any(axis=1)
            lanes.append((f"refused: {reason_words(reason)}", _runs(at_s, refused, COLOUR["idle"])))
    for name, rows in sorted(flight.clocks.items()):
        states = _states(rows, flight.seconds(rows["host_ns"]), flight.info.duration_s)
        lanes.append((f"clock {name}", states))
    troubles: dict[str, list[LabelledSpan]] = {}
    for rows in flight.gaps:
        for row in rows:
            end_s = float(flight.seconds(row["host_ns"]))
            span = (end_s - float(row["duration_ns"]) * 1e-9, end_s, COLOUR["bad"], "")
            troubles.setdefault(f"gap {printable(row['channel'])}", []).append(span)
    for rows in flight.events:
        for row in rows:
            at = float(flight.seconds(row["host_ns"]))
            colour = COLOUR["bad"] if row["severity"] >= Severity.ERROR else COLOUR["warn"]
            troubles.setdefault(f"fault {printable(row['source'])}", []).append((at, at, colour, ""))
    lanes += sorted(troubles.items())
    if flight.truth and flight.truth.get("faults"):
        end_s = flight.info.duration_s
        injected = [
            (f["start_s"], end_s if f.get("end_s") is None else f["end_s"], COLOUR["warn"], str(f["kind"]))
            for f in flight.truth["faults"]
        ]
        lanes.append(("injected", injected))
    return lanes


def _phase_span(flight: FlightData, phase: Phase) -> LabelledSpan:
    start_s, end_s = (float(flight.seconds(t)) for t in (phase.start_ns, phase.end_ns))
    colour = COLOUR["a"] if phase.sweep else COLOUR["d"] if phase.name == "release" else COLOUR["idle"]
    return start_s, end_s, colour, phase.name.replace("phase ", "")


def _runs(at_s: np.ndarray, flags: np.ndarray, colour: str) -> list[LabelledSpan]:
    """Intervals in which ``flags`` (n,) are true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    last = len(at_s) - 1
    return [(at_s[a], at_s[min(b, last)], colour, "") for a, b in edges.reshape(-1, 2)]


def _states(rows: Rows, at_s: FloatArray, end_s: float) -> list[LabelledSpan]:
    """Intervals in which a clock, of rows at times (n,), was in one state."""
    spans: list[LabelledSpan] = []
    for start, end, state in zip(at_s, np.append(at_s[1:], end_s), rows["state"], strict=True):
        colour = STATE_COLOUR[ClockState(int(state))]
        since = spans.pop()[0] if spans and spans[-1][2] == colour else start
        spans.append((since, end, colour, ""))
    return spans


def shade(axes: Axes, flight: FlightData) -> None:
    """Tint the sweeps in a plot over the whole flight."""
    for phase in flight.phases:
        if phase.sweep or phase.name == "release":
            colour = COLOUR["a"] if phase.sweep else COLOUR["d"]
            start_s, end_s = flight.seconds(np.array([phase.start_ns, phase.end_ns]))
            axes.axvspan(start_s, end_s, color=colour, alpha=0.08, linewidth=0)
    axes.set_xlim(0.0, max(flight.info.duration_s, 1e-9))


def draw(axes: Axes, trace: Trace, column: int, label: str, colour: str, factor: float = 1.0) -> None:
    """Plot the mean of each bin as a line and its range as a band."""
    low, mean, high = (factor * part[:, column] for part in (trace.low, trace.mean, trace.high))
    axes.plot(trace.time_s, mean, color=colour, label=label, linewidth=1.0)
    if np.nanmax(high - low, initial=0.0) > 0.0:
        axes.fill_between(trace.time_s, low, high, color=colour, alpha=0.22, linewidth=0)


def joints_and_cells(flight: FlightData) -> Figure | None:
    """Every joint and every load cell over the whole flight (as figure 4.39)."""
    panels = _joint_and_cell_channels(flight)
    if not panels:
        return None
    figure, every = subplots(len(panels), height_in=1.2, sharex=True)
    for number, (axes, (channel, name, unit, factor)) in enumerate(zip(every, panels, strict=True)):
        draw(axes, flight.traces[channel], 0, name, CYCLE[number % len(CYCLE)], factor)
        axes.set_title(name)
        axes.set_ylabel(unit)
        if unit == "N" and (reach := _sweep_reach(flight, channel, factor)):
            axes.set_ylim(*reach)
            axes.set_title(f"{name} (scaled to the sweeps)")
        _mark_flagged(axes, flight, channel)
        shade(axes, flight)
    every[-1].set_xlabel("time, s")
    return figure


def _sweep_reach(flight: FlightData, channel: str, factor: float) -> tuple[float, float] | None:
    """Range of a signal over the sweeps, where the whole flight has a far larger one (blows at end stops)."""
    inside = [sweep.traces[channel] for sweep in flight.sweeps if channel in sweep.traces]
    whole = flight.traces[channel]
    if not inside or not np.isfinite(whole.mean).any():
        return None
    low = factor * min(float(np.nanmin(trace.low, initial=np.inf)) for trace in inside)
    high = factor * max(float(np.nanmax(trace.high, initial=-np.inf)) for trace in inside)
    everything = factor * float(np.nanmax(whole.high) - np.nanmin(whole.low))
    if not 0.0 < 4.0 * (high - low) < everything:
        return None
    return low - 0.2 * (high - low), high + 0.2 * (high - low)


def _joint_and_cell_channels(flight: FlightData) -> list[tuple[str, str, str, float]]:
    """Channel, label, display unit, factor to it."""
    if flight.roles is None:
        return []
    found = []
    for joint in flight.roles.joints:
        shown = ("rad/s", 1.0) if joint.is_rate else ("deg", np.degrees(1.0))
        found.append((joint.channel, f"{joint.joint}: {joint.channel}", *shown))
    found += [(cell.channel, *cell.titled, 1.0) for cell in flight.roles.cells]
    return [one for one in found if one[0] in flight.traces]


def _mark_flagged(axes: Axes, flight: FlightData, channel: str) -> None:
    at_s = flight.flagged.get(channel)
    if at_s is not None:
        top = axes.get_xaxis_transform()
        [marks] = axes.plot(at_s, np.full(len(at_s), 0.97), "x", color=COLOUR["bad"], transform=top)
        legend(axes, [marks], ["not usable"])


def sweeps(flight: FlightData) -> Figure | None:
    """Joint and load cell over each sweep, in one axes (as figures 4.50, 4.51)."""
    channels = _joint_and_cell_channels(flight)
    shown = [sweep for sweep in flight.sweeps if sweep.traces and sweep.moving]
    if not channels or not shown:
        return None
    figure, every = subplots(-(-len(shown) // 2), 2)
    for axes, sweep in zip(every, shown, strict=False):
        _sweep(axes, flight, sweep, channels)
    for axes in every[len(shown) :]:
        axes.set_visible(False)
    return figure


def _sweep(axes: Axes, flight: FlightData, sweep: SweepData, channels: Iterable[tuple[str, str, str, float]]) -> None:
    axes.set_title(sweep.phase.name)
    other: Axes | None = None
    for number, (channel, _, unit, factor) in enumerate(channels):
        if channel not in sweep.traces:
            continue
        target, colour = axes, CYCLE[number % len(CYCLE)]
        if unit == "N":
            target = other = other or second_axis(axes, unit)
        else:
            axes.set_ylabel(unit)
        draw(target, sweep.traces[channel], 0, channel, colour, factor)
    start_s, end_s = flight.seconds(np.array([sweep.phase.start_ns, sweep.phase.end_ns]))
    axes.set_xlim(start_s, end_s)


def second_axis(axes: Axes, label: str) -> Axes:
    """Second axes over the same time with its own scale at the right."""
    other = axes.twinx()
    other.grid(visible=False)
    other.spines["right"].set_visible(True)
    other.set_ylabel(label)
    return other


def legend(axes: Axes, *entries: Any, **style: Any) -> None:
    """Legend above the axes, right of the title; inside them where both do not fit beside each other."""
    handles, labels = entries if entries else axes.get_legend_handles_labels()
    if not len(handles):
        return
    room_in = axes.get_position().width * WIDTH_IN - _LETTER_IN * len(axes.get_title(loc="left"))
    needed_in = sum(_ENTRY_IN + _LETTER_IN * len(str(label)) for label in labels)
    if needed_in < room_in:
        axes.legend(handles, labels, loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=8, borderaxespad=0.0, **style)
    else:
        axes.legend(handles, labels, loc="upper right", ncols=2, frameon=True, framealpha=0.85, **style)


def imu(flight: FlightData, name: str, rotation: np.ndarray | None) -> Figure:
    """Specific force and angular rate of an IMU, in base axes where ``rotation`` is known (as figures 4.46, 4.52).

    The band is the range of the samples in a bin, rotated as an interval (an upper bound).
    """
    trace = flight.traces[name]
    figure, [force, rate] = subplots(2, sharex=True)
    for axes, columns, unit, what in (
        (force, slice(3, 6), "m/s²", "specific force (a − g)"),
        (rate, slice(0, 3), "deg/s", "angular rate"),
    ):
        factor = 1.0 if columns.start else np.degrees(1.0)
        shown = turned(trace, columns, rotation)
        for axis, colour in zip(range(3), CYCLE, strict=False):
            draw(axes, shown, axis, "xyz"[axis], colour, factor)
        axes.set_title(f"{name}: {what}, {'base' if rotation is not None else 'sensor'} axes")
        axes.set_ylabel(unit)
        legend(axes)
        shade(axes, flight)
    rate.set_xlabel("time, s")
    return figure


def turned(trace: Trace, columns: slice, rotation: np.ndarray | None) -> Trace:
    """Three columns in other axes: means exactly, ranges as rotated intervals."""
    low, mean, high = (part[:, columns] for part in (trace.low, trace.mean, trace.high))
    if rotation is None:
        return Trace(trace.time_s, low, mean, high)
    centre = mean @ rotation.T
    half = 0.5 * (high - low) @ np.abs(rotation).T
    middle = 0.5 * (high + low) @ rotation.T
    return Trace(trace.time_s, middle - half, centre, middle + half)


def magnitudes(flight: FlightData, names: Sequence[str]) -> Figure:
    """Magnitude of the specific force of several IMUs, which needs no common axes (as figures 4.27, 4.29)."""
    figure, [axes] = subplots()
    for number, name in enumerate(names):
        trace, colour = flight.traces[name], CYCLE[number % len(CYCLE)]
        axes.plot(trace.time_s, np.linalg.norm(trace.mean[:, 3:6], axis=1), color=colour, label=name)
    axes.set_ylabel("m/s²")
    axes.set_xlabel("time, s")
    legend(axes)
    shade(axes, flight)
    return figure


def clocks(said: Mapping[str, Rows], start_ns: int, duration_s: float) -> Figure | None:
    """Each clock's residuals and sigma, its rate, and its state over the flight.

    Args:
        said: CLOCK rows by clock.
        start_ns: host time that the axis counts from.
        duration_s: of the flight.
    """
    if not said:
        return None
    figure, every = subplots(len(said), 2, sharex=True)
    for pair, (name, rows) in zip(zip(every[::2], every[1::2], strict=True), sorted(said.items()), strict=True):
        _clock(pair, name, rows, (rows["host_ns"] - start_ns) * 1e-9, duration_s)
    for axes in every[-2:]:
        axes.set_xlabel("time, s")
    return figure


def _clock(pair: tuple[Axes, Axes], name: str, rows: Rows, at_s: FloatArray, duration_s: float) -> None:
    error, rate = pair
    known = np.isin(rows["state"], [ClockState.LOCKED, ClockState.FLYWHEEL])
    error.set_title(name)
    if not known.any():
        _never_locked(pair)
    elif "residual_ns" in (rows.dtype.names or ()):
        marks = rows["residual_ns"][known] * 1e-3
        error.plot(at_s[known], marks, ".", color=COLOUR["idle"], markersize=2.5, label="residual")
        error.axhline(0.0, color=COLOUR["faint"], linewidth=0.6)
    else:
        error.set_ylim(bottom=0.0)
    error.plot(at_s[known], rows["residual_rms_ns"][known] * 1e-3, color=CYCLE[0], label="rms")
    error.plot(at_s[known], rows["sigma_ns"][known] * 1e-3, color=CYCLE[1], label="sigma")
    error.set_ylabel("µs")
    if known.any():
        _open(error, 1e-3)
        legend(error)
    period = rows["period_ns"][known]
    if len(period):
        last = float(period[-1])
        ppm = (period / last - 1) * 1e6
        sigma = rows["sigma_period_ns"][known] / last * 1e6
        rate.plot(at_s[known], ppm, color=CYCLE[0])
        rate.fill_between(at_s[known], ppm - 2 * sigma, ppm + 2 * sigma, color=CYCLE[0], alpha=0.22, linewidth=0)
        settled = len(ppm) // 3
        reach = max(2.5 * float(np.abs(ppm[settled:]).max(initial=0.0)), 4 * float(sigma[-1]), 1e-3)
        rate.set_ylim(-reach, reach)
        rate.set_title(f"{name}: tick, about {last * 1e-3:.4f} µs")
    rate.set_ylabel("ppm")
    for start_s, end_s, colour, _ in _states(rows, at_s, duration_s):
        for axes in pair:
            axes.axvspan(start_s, end_s, ymin=0.0, ymax=0.03, color=colour, linewidth=0)
    for axes in pair:
        axes.set_xlim(0.0, max(duration_s, 1e-9))


def _never_locked(pair: tuple[Axes, Axes]) -> None:
    for axes in pair:
        axes.set_yticks([])
        axes.text(0.5, 0.5, "no solution: it never locked", transform=axes.transAxes, ha="center", va="center")


def _open(axes: Axes, least: float) -> None:
    """Widen a vertical range that spans less than ``least``: rounding is not to fill the axes."""
    low, high = axes.get_ylim()
    if high - low < least:
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - 0.5 * least, middle + 0.5 * least)
