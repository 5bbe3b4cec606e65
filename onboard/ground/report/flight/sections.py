"""Sections of a report: verdicts and estimates, timeline, signals, regression, clocks, events."""

from collections.abc import Iterator
from html import escape

import numpy as np

from drivers.records import Severity
from onboard.dynamics.model.errors import ModelError
from onboard.estimation.gates import GateReason
from onboard.ground.drawing import html, theme
from onboard.ground.drawing.gallery import Gallery
from onboard.ground.drawing.html import Cell
from onboard.ground.log.views.summary import reason_words
from onboard.ground.report.flight import answers, arm, figures, instruments
from onboard.ground.report.flight.base_rate import base_rate
from onboard.ground.report.flight.base_rate import draw as draw_base_rate
from onboard.ground.report.flight.compared import Compared, compared, truths_of
from onboard.ground.report.flight.flight_data import FlightData
from onboard.ground.report.flight.health import health
from onboard.ground.report.flight.sweeps import by_sweep
from onboard.recording.format.texts import printable
from onboard.timebase.clock import ClockState

_EVENTS_SHOWN = 40
_ENDED = {
    ClockState.ACQUIRING: "never had marks enough for a solution: its samples have no vehicle time",
    ClockState.FLYWHEEL: "had no marks it could use at the end of the log: its time is extrapolated at the last rate",
    ClockState.INVALID: "was not to be trusted at the end of the log: extrapolated for too long",
}


def document(flight: FlightData) -> str:
    """The whole page."""
    with theme.figures():
        draw = Gallery()
        sections = list(_sections(flight, draw))
        return html.page(f"{flight.name}: {flight.info.path.name}", _head(flight), sections, draw.packed())


def _sections(flight: FlightData, draw: Gallery) -> Iterator[tuple[str, str]]:
    truths = truths_of(flight)
    found = compared(flight)
    yield "Answers", _answers(found)
    yield "Timeline", _timeline(flight, draw)
    yield (
        "Encoder and load cell",
        draw(
            figures.joints_and_cells(flight),
            "Joint angles and load cells over the whole flight; sweeps are tinted. A load cell that end stops load far "
            "more than the sweeps do is scaled to the sweeps. Times are of arrival, which is some "
            "milliseconds after the sample. Red crosses: samples marked unusable by their device or a range limit.",
        )
        + draw(figures.sweeps(flight), "The same in the same colours, sweep by sweep."),
    )
    yield "Accelerations and rates", _imus(flight, draw)
    yield "Spectra", instruments.spectra_section(flight, draw)
    yield "Arm", arm.section(flight, draw)
    yield "Base rate", base_rate_section(flight, draw)
    yield "Torque and acceleration", _torques(flight, draw)
    yield "Sweep by sweep", by_sweep(flight, draw, truths)
    yield (
        "Convergence",
        draw(
            answers.convergence(flight, truths, quantities=True),
            "Onboard estimates with their 95 % interval, from the time they are determined by the data. Dashed: truth.",
        )
        + draw(answers.convergence(flight, truths, quantities=False), "Base parameters that the data determine."),
    )
    yield "Clocks", _clocks(flight, draw)
    yield "Sample times", instruments.sample_times(flight, draw)
    yield "Channels", _channels(flight)
    yield "Health", health(flight.health)
    yield "Events", _events(flight)
    yield "Provenance", _provenance(flight)


def _head(flight: FlightData) -> str:
    about = flight.info
    when = about.metadata.get("flight", {}).get("wall_clock_ns")
    size = f"{about.size_bytes / 1e6:.1f} MB"
    facts = [about.path.name, f"{about.duration_s:.1f} s", f"{about.rows:,} records", size]
    if when:
        facts.insert(1, f"{np.datetime64(int(when), 'ns').astype('datetime64[s]')} UTC")
    head = f"<h1>{escape(flight.name)}</h1>\n" + html.paragraph(" · ".join(facts), "sub")
    masses = [one for one in compared(flight) if one.supported and one.unit == "kg"]
    cards = [_card(one) for one in [one for one in masses if one.published] or masses][:6]
    if cards:
        head += f'<div class="cards">\n{"".join(cards)}</div>\n'
    return head + html.verdicts(_verdicts(flight)) + "".join(html.paragraph(note, "note") for note in flight.notes)


def _card(one: Compared) -> str:
    unit, factor = answers.shown_unit(one.unit, one.value)
    width = factor * (one.high - one.low)
    value, low, high = (answers.digits(factor * x, width) for x in (one.value, one.low, one.high))
    lowest, highest = (answers.digits(factor * x, width) for x in (one.low_999, one.high_999))
    more = [f"95 %: {low} … {high} {unit}", f"99.9 %: {lowest} … {highest} {unit}"]
    if one.truth is not None:
        truth = answers.digits(factor * one.truth, width)
        more.append(f"truth {truth} {unit}, error {one.error(' %')}")
    return html.card(one.label, value, unit, more)


def _verdicts(flight: FlightData) -> Iterator[tuple[str, str]]:
    about = flight.info
    asked = compared(flight)
    answered = [one for one in asked if one.supported]
    if asked:
        kind = "good" if len(answered) == len(asked) else "warn" if answered else "bad"
        yield kind, f"{len(answered)} of {len(asked)} quantities are determined by the data."
    inside = [one.covered for one in answered if one.covered is not None]
    if inside:
        kind = "good" if all(inside) else "warn"
        yield kind, f"{sum(inside)} of {len(inside)} intervals hold the truth."
    missing = sum(channel.missing for channel in about.channels)
    if about.unexplained:
        yield "bad", f"{about.unexplained:,} records are missing without a gap record."
    elif missing:
        exact = "" if any(channel.about for channel in about.channels) else ", which counted them"
        yield "warn", f"{missing:,} records are missing, all of them covered by gap records{exact}."
    else:
        yield "good", "No record is missing between the first and the last of any channel."
    loud = {Severity.ERROR: ("bad", "errors"), Severity.WARNING: ("warn", "warnings")}
    for severity, (kind, word) in loud.items():
        if count := about.event_counts.get(severity, 0):
            yield kind, f"{count} {word}; see Events."
    if about.damage:
        lost = sum(one.end - one.start for one in about.damage)
        yield "bad", f"The log is damaged in {len(about.damage)} places ({lost:,} bytes); the readable part is shown."
    else:
        yield "good", "The log is intact: every checksum is right."
    for name, rows in sorted(flight.clocks.items()):
        state = ClockState(int(rows[-1]["state"]))
        if state is not ClockState.LOCKED:
            yield "warn", f"The clock of {name} {_ENDED[state]}."


def _answers(found: list[Compared]) -> str:
    rows = []
    for one in found:
        unit, factor = answers.shown_unit(one.unit, one.value if one.supported else 0.0)
        width = factor * (one.high - one.low)
        known = one.truth is not None
        line: list[object] = [one.label, Cell(answers.digits(factor * one.truth, width) if known and one.truth else "")]
        if one.supported:
            span = f"{answers.digits(factor * one.low, width)} … {answers.digits(factor * one.high, width)}"
            line += [Cell(answers.digits(factor * one.value, width)), Cell(span), unit]
            line += [Cell(one.error())]
            line += ["" if one.covered is None else Cell(*(("yes", "good") if one.covered else ("no", "bad")))]
        else:
            line += ["", "no answer", unit, "", ""]
        published = Cell("" if one.published is None else f"{factor * one.published:.1f}")
        rows.append([*line, published, Cell(one.standing, "long")])
    headings = ["quantity", "truth", "heft", "95 % interval", "unit", "error %", "holds truth", "published", "level"]
    keep = [0, *(n for n in range(1, len(headings)) if any(str(row[n]) for row in rows))]
    return html.table([headings[n] for n in keep], ([row[n] for n in keep] for row in rows))


def _timeline(flight: FlightData, draw: Gallery) -> str:
    keys = [
        ("a", "sweep"), ("idle", "other phase, or refused"), ("good", "used, or locked"),
        ("warn", "flywheel, or warning"), ("bad", "lost, or error"),
    ]  # fmt: skip
    legend = "".join(f'<span class="key" style="background: var(--{c})"></span>{escape(t)}' for c, t in keys)
    body = draw(figures.timeline(flight), "What happened when.") + f'<p class="note">{legend}</p>\n'
    if flight.rows_total:
        refused = ", ".join(
            f"{reason_words(reason)} {flight.gate_counts[int(reason)]:,}"
            for reason in GateReason
            if flight.gate_counts.get(int(reason))
        )
        used = f"{flight.rows_used:,} of {flight.rows_total:,} rows went into the estimate."
        body += html.paragraph(f"{used} Refused, a row perhaps for several reasons: {refused or 'none'}.")
    return body


def _imus(flight: FlightData, draw: Gallery) -> str:
    names = [name for name, trace in flight.traces.items() if trace.mean.shape[1] == 6]
    imus = flight.roles.imus if flight.roles else ()
    frames = {one.channels[0]: one.frame for one in imus if len(one.channels) == 1}
    body = ""
    for name in names:
        rotation = None
        if flight.model is not None and name in frames:
            try:
                rotation, _ = flight.model.pose_in_base(frames[name])
            except ModelError:
                rotation = None  # on a moving link: no constant rotation to the base
        body += draw(
            figures.imu(flight, name, rotation),
            "Unfiltered. Line: mean of each bin of time, band: extent of its samples. An accelerometer measures "
            "specific force: free fall reads zero, and the offset is still in.",
        )
    if len(names) > 1:
        body += draw(figures.magnitudes(flight, names), "Magnitude of the specific force of every IMU.")
    return body


def base_rate_section(flight: FlightData, draw: Gallery) -> str:
    """The measured rate of a free base and the predicted one; empty where it cannot be predicted."""
    found = base_rate(flight)
    if found is None:
        return ""
    rms = ", ".join(f"{value:.3f}" for value in np.degrees(found.rms))
    swing = ", ".join(f"{value:.1f}" for value in np.degrees(np.ptp(found.measured, axis=0)))
    return draw(
        draw_base_rate(found),
        "Predicted from joints, the vehicle as drawn and the payload as said last. Left of the dashed line momentum "
        f"and gyro offset are fitted; right of it nothing is: rms {rms} deg/s in x, y, z, of swings of {swing}.",
    )


def _torques(flight: FlightData, draw: Gallery) -> str:
    if flight.identifier is None or flight.roles is None:
        return ""
    rows = [row.name for row in flight.identifier.model.rows]
    body = ""
    for cell in flight.roles.cells:
        if cell.name in rows:
            unit, factor = cell.keys.shown
            body += draw(
                answers.torque_and_acceleration(flight, answers.Side(rows.index(cell.name), unit, factor)),
                f"{cell.name}: both sides of the rows, through the same smoothing kernel, on vehicle time. The line is "
                "a straight fit to the rows used; the estimator's rows also carry the base's motion and the offset. "
                "Ticks with a saturated sample are left out.",
            )
    return body


def _clocks(flight: FlightData, draw: Gallery) -> str:
    if not flight.clocks:
        return ""
    rows = []
    for name, said in sorted(flight.clocks.items()):
        last = said[-1]
        state = ClockState(int(last["state"]))
        kind = {ClockState.LOCKED: "good", ClockState.FLYWHEEL: "warn"}.get(state, "bad")
        numbers = [f"{last['period_ns'] * 1e-3:.4f}"]
        numbers += [f"{last[key] * 1e-3:.1f}" for key in ("sigma_ns", "residual_rms_ns")]
        numbers += [f"{last['marks']:,}", f"{last['rejected']:,}"]
        rows.append([name, Cell(state.name.lower(), kind), *map(Cell, numbers)])
    caption = (
        "Left: how far pulse marks lie from the fitted line, and what the fit says of itself. An IMU says in which "
        "sample a pulse fell, no more: its marks lie up to half a sample about the line, 0.29 of a sample rms, and the "
        "line that all of them allow is known that much better. Right: the fitted length of a tick against its last "
        "value, with two sigma. The strip below: green locked, amber flywheel, red invalid."
    )
    table = html.table(["clock", "state", "tick µs", "sigma µs", "residual µs", "marks", "rejected"], rows)
    return table + draw(figures.clocks(flight.clocks, flight.info.start_ns, flight.info.duration_s), caption)


def _channels(flight: FlightData) -> str:
    rows = []
    for channel in flight.info.channels:
        rate = "" if channel.rate_hz is None else f"{channel.rate_hz:.2f}"
        lost = Cell(f"{channel.unexplained:,}", "n bad" if channel.unexplained else "n")
        counts = [Cell(f"{channel.missing:,}"), Cell(f"{'about ' if channel.about else ''}{channel.gaps:,}")]
        whole, flagged = Cell(f"{channel.rows:,}"), Cell(f"{channel.flagged:,}")
        rows.append([channel.name, channel.record, whole, Cell(rate), *counts, lost, flagged])
    return html.table(["channel", "record", "rows", "Hz", "missing", "in gaps", "unexplained", "flagged"], rows)


def _events(flight: FlightData) -> str:
    rows = [row for rows in flight.events for row in rows]
    shown = []
    for row in rows[:_EVENTS_SHOWN]:
        severity = int(row["severity"])
        kind, word = ("bad", "error") if severity >= Severity.ERROR else ("warn", "warning")
        source, code, text = (printable(row[field]) for field in ("source", "code", "text"))
        at_s = f"{float(flight.seconds(row['host_ns'])):.3f}"
        shown.append([Cell(at_s), Cell(word, kind), source, code, Cell(text, "long")])
    more = html.paragraph(f"And {len(rows) - _EVENTS_SHOWN} more: heft info.") if len(rows) > _EVENTS_SHOWN else ""
    table = html.table(["time s", "", "source", "code", "what"], shown)
    return table + more if shown else html.paragraph("No warning and no error.")


def _provenance(flight: FlightData) -> str:
    rows = [[name, key, value] for name, items in flight.info.metadata.items() for key, value in items.items()]
    rows += [["file", name, f"{size:,} bytes"] for name, size in flight.info.attachments.items()]
    body = html.table(["", "", ""], rows)
    if flight.vehicle is not None:
        text = escape(flight.vehicle.text)
        body += f"<details><summary>{escape(flight.vehicle.path.name)}</summary><pre>{text}</pre></details>\n"
    return body
