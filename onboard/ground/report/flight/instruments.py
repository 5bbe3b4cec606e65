"""Figures of the streams as instruments: spectra of IMUs and load cells, sample-time jitter; and the jitter's table."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from onboard.estimation.arrays import FloatArray
from onboard.ground.drawing import html
from onboard.ground.drawing.gallery import Gallery
from onboard.ground.drawing.html import Cell
from onboard.ground.drawing.theme import CYCLE, label_lowest, subplots
from onboard.ground.report.flight.figures import legend
from onboard.ground.report.flight.flight_data import FlightData
from onboard.ground.report.flight.streams import SEGMENT, IntervalStatistics

_BINS = 120


def spectra_section(flight: FlightData, draw: Gallery) -> str:
    """Of the page; empty without an IMU or load cell."""
    return draw(
        spectra(flight),
        f"Amplitude spectral density of the samples as recorded (Welch: Hann windows of {SEGMENT} samples, half "
        "overlapping, without gaps), over the whole flight, so that the motion is in it below some hertz. Sensor axes.",
    )


def sample_times(flight: FlightData, draw: Gallery) -> str:
    """Section of the page: intervals between samples."""
    return jitter_table(flight) + draw(
        jitter(flight),
        "Intervals between neighbouring samples, less their median. Arrival: when the host had them, of an IMU with a "
        "FIFO many at once. Device's clock: by its tick at the fitted length, for streams that have it.",
    )


def spectra(flight: FlightData) -> Figure | None:
    """Amplitude spectral density of every IMU (gyro, accelerometer) and load cell."""
    panels: list[tuple[str, str, FloatArray, FloatArray, Sequence[str]]] = []
    cells = {cell.channel: cell.titled for cell in flight.roles.cells} if flight.roles else {}
    rates = {channel.name: channel.rate_hz for channel in flight.info.channels}
    for name, spectrum in flight.spectra.items():
        rate_hz = rates.get(name)
        if not spectrum.segments or not rate_hz:
            continue
        frequency, density = spectrum.density(rate_hz)
        if density.shape[1] == 6:
            gyro = np.degrees(density[:, :3])
            panels.append((f"{name}: angular rate", "deg/s/√Hz", frequency, gyro, "xyz"))
            panels.append((f"{name}: specific force", "m/s²/√Hz", frequency, density[:, 3:], "xyz"))
        elif name in cells:
            title, unit = cells[name]
            panels.append((title, f"{unit}/√Hz", frequency, density, (name,)))
    if not panels:
        return None
    figure, every = subplots(-(-len(panels) // 2), 2)
    for axes, (title, unit, frequency, density, labels) in zip(every, panels, strict=False):
        for column, label in enumerate(labels):
            axes.loglog(frequency, density[:, column], color=CYCLE[column], label=label, linewidth=0.9)
        axes.set_title(title)
        axes.set_ylabel(unit)
        _plain_ticks(axes.xaxis, axes.yaxis)
        axes.set_xlim(frequency[0], frequency[-1])
        if len(labels) > 1:
            legend(axes)
    label_lowest(every, len(panels), "frequency, Hz")
    return figure


def jitter(flight: FlightData) -> Figure | None:
    """How far each interval between samples is from their median, by arrival and by the device's clock."""
    names = [name for name, intervals in flight.intervals.items() if intervals.arrival() is not None]
    if not names:
        return None
    figure, every = subplots(-(-len(names) // 2), 2, height_in=1.15)
    for axes, name in zip(every, names, strict=False):
        arrival, sampled = flight.intervals[name].arrival(), _sampled(flight, name)
        assert arrival is not None
        found = [(1e-3 * (arrival.kept - arrival.median), "arrival", CYCLE[0])]
        if sampled is not None:
            found.append((1e-3 * (sampled.kept - sampled.median), "device's clock", CYCLE[1]))
        reach = max(1.0, *(float(np.percentile(np.abs(part), 99.5)) for part, _, _ in found))
        edges = np.linspace(-1.3 * reach, 1.3 * reach, _BINS + 1)
        for part, label, colour in found:
            counts, _ = np.histogram(np.clip(part, edges[0], edges[-1]), edges)
            share = np.maximum(counts, 0.5) / len(part)  # none: on the lower edge of a logarithmic axis
            axes.step(0.5 * (edges[1:] + edges[:-1]), share, where="mid", color=colour, label=label)
        axes.set_yscale("log")
        _plain_ticks(axes.yaxis)
        axes.set_ylim(0.5 / max(len(part) for part, _, _ in found), 2.0)
        axes.set_title(name)
        axes.set_ylabel("share")
        legend(axes)
    label_lowest(every, len(names), "interval less its median, µs")
    return figure


def jitter_table(flight: FlightData) -> str:
    """Intervals between samples of every stream, with nothing missing between them."""
    rows = []
    for name, intervals in flight.intervals.items():
        arrival, sampled = intervals.arrival(), _sampled(flight, name)
        if arrival is None:
            continue
        low, high = arrival.percentiles()
        line = [f"{1e-6 * arrival.median:.4f}", f"{1e-3 * arrival.rms:.1f}"]
        line += [f"{1e-3 * (low - arrival.median):+.1f} … {1e-3 * (high - arrival.median):+.1f}"]
        line += [f"{1e-6 * arrival.most:.3f}", "" if sampled is None else f"{1e-3 * sampled.rms:.1f}"]
        line += ["" if sampled is None else f"{1e-6 * sampled.most:.3f}"]
        rows.append([name, *map(Cell, line)])
    headings = ["stream", "median ms", "rms µs", "99 % within µs", "longest ms", "device's clock: rms µs", "longest ms"]
    return html.table(headings, rows)


def _sampled(flight: FlightData, name: str) -> IntervalStatistics | None:
    clock = flight.clocks.get(name)
    return None if clock is None else flight.intervals[name].sampled(float(clock[-1]["period_ns"]))


def _plain_ticks(*axes: Axis) -> None:
    """Powers of ten as numbers: they are no mathematics where names must not be."""
    for axis in axes:
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
