"""Result table of ``heft hil``: the onboard estimates beside true and published values.

The numbers are the last onboard estimates, read from the log without recomputation; which of them are compared says
:mod:`onboard.ground.identify.mission.answered`.
"""

import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from drivers import records
from onboard import config
from onboard.channels import NUMBERS
from onboard.flight.hil import Flown
from onboard.flight.store.flight_log import VEHICLE_ATTACHMENT
from onboard.ground.identify import runs_view
from onboard.ground.identify.mission import accounts, own_mission
from onboard.ground.identify.mission.answered import SECTIONS, answered, error, error_told, published_of
from onboard.ground.log.tables.vehicle_file import vehicle_of
from onboard.ground.log.views.standing import answers_of
from onboard.recording.format.errors import LogFormatError
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader

Result = dict[str, Any]
_SHOWN = dict(zip(("masses", "centres", "inertias", "parameters", "motions"), SECTIONS, strict=True))


def last_answers(log: LogReader) -> dict[str, dict[str, Any]]:
    """The last QUANTITY of each name in a log; empty if there is no estimate."""
    last: dict[bytes, np.void] = {}
    for _, rows in log.batches(["quantity"]) if "quantity" in log.channels else ():
        _note_answers(last, rows)
    return answers_of({printable(name): row for name, row in last.items()})


def _note_answers(last: dict[bytes, np.void], rows: records.Rows) -> None:
    newest = rows[-256:]
    last |= zip(newest["name"].tolist(), newest, strict=True)


def result(flown: Flown, flew: config.Vehicle | None = None, log: LogReader | None = None) -> Result:
    """Everything the table shows, as plain JSON values.

    Args:
        flown: the flight.
        flew: the vehicle, for a log that has lost its head.
        log: the flight's, where more of it is read afterwards.

    Raises:
        LogFormatError: the log does not say what flew, and it is not given.
    """
    log = LogReader(flown.log) if log is None else log
    seen = accounts.Seen(flown.produced, int(flown.truth["start_ns"]))
    last, events = dict[bytes, np.void](), list[np.void]()
    for batch in log.batches():  # all that is wanted of it in one pass
        seen.see(batch)
        if batch.channel == "quantity":
            _note_answers(last, batch.rows)
        elif batch.rows.dtype == records.EVENT:
            events.extend(batch.rows)
    answers = answers_of({printable(name): row for name, row in (last | dict(flown.answers)).items()})
    is_told = VEHICLE_ATTACHMENT in log.attachments
    if not is_told and flew is None:
        raise LogFormatError(f"{log.path} has lost its head, and with it what flew; heft recover shows what is left")
    flown_runs, is_published = list[Result](), bool(flown.truth["published"])
    with tempfile.TemporaryDirectory() as directory:
        vehicle = vehicle_of(log, Path(directory)) if is_told or flew is None else flew
        name, phases = vehicle.file.vehicle.name, vehicle.file.estimation.phases
        told = phases is not None and phases.payload_taken is not None
        if own_mission.is_estimated_afterwards(vehicle):
            answers, flown_runs = own_mission.after_the_run(vehicle, log)
        true = own_mission.true_values(vehicle, flown.truth)
        published = published_of(name) if is_published else {}
        rows = answered(vehicle, answers, true, published)
    shown = {key: [_compared(row, answers) for row in rows[section]] for key, section in _SHOWN.items()}
    asked = shown["masses"] if is_published else [row for key in shown if key != "motions" for row in shown[key]]
    enough = all if is_published else any
    counted = seen.accounts()
    return {
        "vehicle": name,
        "title": published.get("title", f"{name}: rehearsed"),
        "seed": flown.truth["seed"],
        "log": str(flown.log),
        **shown,
        "channels": {name: account.as_json() for name, account in counted.items()},
        "identified": enough(one["supported"] for one in asked),
        "accounted": all(account.is_whole for account in counted.values()),
        "accounts": accounts.render(counted),
        "events": _troubles(events, flown.troubles),
        "runs": runs_view.compared(flown_runs, flown.truth),
        "capture": _capture(events, flown.truth, told=told),
    }


def _compared(row: Result, answers: dict[str, Result]) -> Result:
    answer, true = answers.get(row["quantity"]), float(row["value"])
    supported = answer is not None and answer["supported"]
    made = {**row, "value": None, "truth": true, "supported": supported}
    made |= {key: "" if answer is None else answer[key] for key in ("standing", "leans")}
    if answer is not None and supported:
        told = {key: answer[key] for key in ("value", "low", "high", "sigma")}
        made |= {key: answer[key] for key in (*NUMBERS, "drawn", "unit")}
        made["our_error_percent"], made["our_error_sigmas"] = error(**told, truth=true)
        made["covered"] = answer["low"] <= true <= answer["high"]
    return made


def _capture(events: Iterable[np.void], truth: dict[str, Any], *, told: bool) -> dict[str, Any] | None:
    """Mission time [s] of a capture and of its detection, which the change before it is; None without a capture.

    ``told``: a phase says when the payload is taken.
    """
    if not truth.get("capture_s"):
        return None
    said, detected_ns = list[float](), 0
    for row in events:
        if row["code"] == b"change":
            detected_ns = int(row["host_ns"])
        elif row["code"] == b"capture":
            said.append(1e-9 * ((detected_ns or int(row["host_ns"])) - truth["start_ns"]))
            detected_ns = 0
    return {"true_s": truth["capture_s"], "said_s": said, "told": told}


def _troubles(events: Iterable[np.void], of_recorder: Iterable[str]) -> list[str]:
    """Warnings and errors, as sentences; those of the recorder first, which a log on a full disk does not have."""
    first = [f"recorder: {text}" for text in of_recorder]
    every = (
        f"{printable(row['source'])}: {printable(row['text'])}"
        for row in events
        if row["severity"] >= records.Severity.WARNING
    )
    return first + [text for text in every if text not in first]


def render(table: Result) -> RenderableType:
    """The table for a terminal of 80 columns."""
    title = f"{table['title']} (seed {table['seed']})"
    published = any("identified_g" in row for row in table["masses"])
    theirs = ("publ.", "err %") if published else ()
    made = runs_view.of_numbers(title, "", "truth", *theirs, "heft", "95 % interval", "err %")
    for section in _SHOWN:
        for row in table[section]:
            if section == "motions" and not row["supported"]:
                continue  # said below the table
            theirs = ("", "") if published else ()
            if "identified_g" in row:
                theirs = f"{row['identified_g']:.1f}", f"{row['error_percent']:.2f}"
            truth = f"{row['factor'] * row['truth']:.{row['digits']}f}"
            made.add_row(f"{row['label']}, {row['shown_in']}", truth, *theirs, *_ours(row))
        made.add_section()
    lines: list[Text] = []
    if (capture := table["capture"]) and capture["told"]:
        lines.append(Text(f"captured at {capture['true_s']:.2f} s, given to the estimator by the phase"))
    elif capture:
        noticed = ", ".join(f"{at_s:.2f} s" for at_s in capture["said_s"]) or "no"
        lines.append(Text(f"captured at {capture['true_s']:.2f} s, unknown to the estimator; detected: {noticed}"))
    rows = [row for section in _SHOWN for row in table[section]]
    leaning = [row for row in rows if published or row["shown_in"] in ("kg", "g")]  # of the others: --json, report
    for field, otherwise, those in (("standing", "not answered", rows), ("leans", "", leaning)):
        said: dict[str, list[str]] = {}
        for row in those:
            said.setdefault(row[field] or otherwise, []).append(row["label"])
        lines += [Text(f"{', '.join(labels)}: {text}") for text, labels in said.items() if text]
    troubles = [Text(f"! {text}", style="yellow") for text in table["events"][:8]]
    if len(table["events"]) > len(troubles):
        troubles.append(Text(f"! and {len(table['events']) - len(troubles)} more: heft info", style="yellow"))
    return Group(made, *lines, *runs_view.render(table["runs"]), *map(Text, table["accounts"]), *troubles)


def _ours(row: dict[str, Any]) -> tuple[str, str, str]:
    if not row["supported"] or not np.isfinite(row["value"]):
        return "—", "not determined", ""
    value, low, high = (f"{row['factor'] * row[key]:.{row['digits']}f}" for key in ("value", "low", "high"))
    return value, f"{low} .. {high}", error_told(row["our_error_percent"], row["our_error_sigmas"])
