"""Result table of ``heft hil``: the onboard estimates beside true and published values.

The numbers are the last onboard estimates, read from the log without recomputation. The packaged vehicle's
``published.toml`` lists what is compared: masses (``row``), centres of mass (``centre``) and ``inertia``, each with its
display unit and, if there is one, the published value. Of any other vehicle all that it answers is compared, base
parameters of rows (``parameter``) among it (:mod:`onboard.offline.views.own_mission`).
"""

import tempfile
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drivers import records
from onboard import config
from onboard.flight.hil import Flown
from onboard.offline.estimate_again import runs_view
from onboard.offline.tables.truth import Truth
from onboard.offline.tables.vehicle_file import vehicle_of
from onboard.offline.views import accounts, own_mission
from onboard.offline.views.standing import leans_on, shown
from onboard.recording.reader import LogReader
from onboard.recording.texts import printable

Result = dict[str, Any]


def last_answers(log: LogReader) -> dict[str, dict[str, Any]]:
    """The last QUANTITY of each name in a log; empty if there is no estimate."""
    last: dict[bytes, np.void] = {}
    for _, rows in log.batches(["quantity"]) if "quantity" in log.channels else ():
        _note_answers(last, rows)
    return _answers(last)


def _note_answers(last: dict[bytes, np.void], rows: records.Rows) -> None:
    newest = rows[-256:]
    last |= zip(newest["name"].tolist(), newest, strict=True)


def _answers(last: dict[bytes, np.void]) -> dict[str, dict[str, Any]]:
    return {
        printable(name): {
            "value": float(row["value"]),
            "low": float(row["low"]),
            "high": float(row["high"]),
            "sigma": float(row["sigma"]),
            "unit": printable(row["unit"]),
            "supported": bool(row["supported"]),
            "standing": shown(row),
            "leans": leans_on(row),
            "drawn": float(row["drawn"]) if "drawn" in (row.dtype.names or ()) else 0.0,
        }
        for name, row in last.items()
    }


def result(flown: Flown) -> Result:
    """Everything the table shows, as plain JSON values."""
    log = LogReader(flown.log)
    seen = accounts.Seen(flown.produced, int(flown.truth["start_ns"]))
    last, events = dict[bytes, np.void](), list[np.void]()
    for batch in log.batches():  # all that is wanted of it in one pass
        seen.see(batch)
        if batch.channel == "quantity":
            _note_answers(last, batch.rows)
        elif batch.rows.dtype == records.EVENT:
            events.extend(batch.rows)
    name, answers = log.metadata["flight"]["vehicle"], _answers(last)
    flown_runs, is_published = list[Result](), bool(flown.truth["published"])
    with tempfile.TemporaryDirectory() as directory:
        vehicle = vehicle_of(log, Path(directory))
        phases = vehicle.file.estimation.phases
        told = phases is not None and phases.payload_taken is not None
        if own_mission.is_estimated_afterwards(vehicle):
            answers, flown_runs = own_mission.after_the_run(vehicle, log)
        if is_published:
            published = _published(name, vehicle, flown.truth)
        else:
            published = {"title": f"{name}: rehearsed", **own_mission.compared(vehicle, answers, flown.truth)}
    masses, centres, inertias, parameters, motions = (
        [_compared(shown | row, answers, flown.truth) for row in published.get(section, [])]
        for section, shown in _SHOWN.items()
    )
    every = (*masses, *centres, *inertias, *parameters)
    counted = seen.accounts()
    return {
        "vehicle": name,
        "title": published["title"],
        "seed": flown.truth["seed"],
        "log": str(flown.log),
        "masses": masses,
        "centres": centres,
        "inertias": inertias,
        "parameters": parameters,
        "motions": motions,
        "channels": {name: account.as_json() for name, account in counted.items()},
        "identified": all(one["supported"] for one in masses)
        if is_published
        else any(one["supported"] for one in every),
        "accounted": all(account.is_whole for account in counted.values()),
        "accounts": accounts.render(counted),
        "events": _troubles(events),
        "runs": runs_view.compared(flown_runs, flown.truth),
        "capture": _capture(events, flown.truth, told=told),
    }


def _published(name: str, vehicle: config.Vehicle, truth: Truth) -> Result:
    """What was published of a packaged vehicle, beside what is true of the one that was flown."""
    published = tomllib.loads(config.packaged(name).with_name("published.toml").read_text(encoding="utf-8"))
    true = own_mission.true_values(vehicle, truth)
    given = {
        section: [row | {"value": true[row["quantity"]]} for row in rows]
        for section, rows in published.items()
        if isinstance(rows, list)
    }
    return published | given


def _compared(row: dict[str, Any], answers: dict[str, dict[str, Any]], truth: dict[str, Any]) -> dict[str, Any]:
    answer = answers.get(row["quantity"])
    supported = answer is not None and answer["supported"]
    true = float(row["value"] if "value" in row else truth["quantities"][row["quantity"]])
    standing = "" if answer is None else answer["standing"]
    leans = "" if answer is None else answer["leans"]
    made: dict[str, Any] = {**row, "value": None, "truth": true, "supported": supported}
    made |= {"standing": standing, "leans": leans}
    if answer is not None and supported:
        made |= {key: answer[key] for key in ("value", "low", "high", "sigma", "drawn", "unit")}
        made["our_error_percent"] = 100 * (answer["value"] / true - 1) if true and not row.get("absolute") else None
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


def _troubles(events: Iterable[np.void]) -> list[str]:
    """Warnings and errors, as sentences."""
    return [
        f"{printable(row['source'])}: {printable(row['text'])}"
        for row in events
        if row["severity"] >= records.Severity.WARNING
    ]


def render(table: Result) -> RenderableType:
    """The table for a terminal of 80 columns."""
    title = f"{table['title']} (seed {table['seed']})"
    published = any("identified_g" in row for row in table["masses"])
    made = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    made.add_column("", no_wrap=True)
    for heading in ("truth", *(("publ.", "err %") if published else ()), "heft", "95 % interval", "err %"):
        made.add_column(heading, justify="right", no_wrap=True)
    for section in ("masses", "centres", "inertias", "parameters", "motions"):
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
        lines.append(Text(f"captured at {capture['true_s']:.2f} s, told to the estimator by the phase"))
    elif capture:
        noticed = ", ".join(f"{at_s:.2f} s" for at_s in capture["said_s"]) or "no"
        lines.append(Text(f"captured at {capture['true_s']:.2f} s, unknown to the estimator; detected: {noticed}"))
    rows = [*table["masses"], *table["centres"], *table["inertias"], *table["parameters"], *table["motions"]]
    for field, otherwise in (("standing", "not answered"), ("leans", "")):
        said: dict[str, list[str]] = {}
        for row in rows:
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
    percent = row["our_error_percent"]
    a_share = percent is not None and abs(row["truth"]) > _NOTHING * (row["high"] - row["low"])
    return value, f"{low} .. {high}", f"{percent:+.2f}" if a_share else ""


_NOTHING = 0.05  # of an interval: of a truth so near zero an error is no share
_SHOWN: dict[str, dict[str, Any]] = {
    "row": {"shown_in": "g", "factor": 1e3, "digits": 1},
    "centre": {"shown_in": "mm", "factor": 1e3, "digits": 2},
    "inertia": {"shown_in": "g m²", "factor": 1e3, "digits": 3},
    "parameter": {},
    "motion": {},
}
