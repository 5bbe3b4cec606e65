"""Result table of ``heft hil``: the onboard estimates beside true and published values.

The numbers are the last onboard estimates, read from the log without recomputation. The packaged vehicle's
``published.toml`` lists what is compared: masses (``row``), centres of mass (``centre``) and ``inertia``, each with its
display unit and, if there is one, the published value.
"""

import tomllib
from collections.abc import Iterator
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drivers import records
from onboard import config
from onboard.flight.hil import Flown
from onboard.offline.views.standing import shown
from onboard.recording.reader import LogReader

Result = dict[str, Any]


def last_answers(log: LogReader) -> dict[str, dict[str, Any]]:
    """The last QUANTITY of each name in a log; empty if there is no estimate."""
    answers: dict[str, dict[str, Any]] = {}
    for _, rows in log.batches(["quantity"]) if "quantity" in log.channels else ():
        for row in rows[-256:]:
            answers[row["name"].decode()] = {
                "value": float(row["value"]),
                "low": float(row["low"]),
                "high": float(row["high"]),
                "sigma": float(row["sigma"]),
                "unit": row["unit"].decode(),
                "supported": bool(row["supported"]),
                "standing": shown(row),
                "drawn": float(row["drawn"]) if "drawn" in row.dtype.names else 0.0,
            }
    return answers


def result(flown: Flown) -> Result:
    """Everything the table shows, as plain JSON values."""
    log = LogReader(flown.log)
    name = log.metadata["flight"]["vehicle"]
    published = tomllib.loads(config.packaged(name).with_name("published.toml").read_text(encoding="utf-8"))
    answers = last_answers(log)
    masses, centres, inertias = (
        [_compared(shown | row, answers, flown.truth) for row in published.get(section, [])]
        for section, shown in _SHOWN.items()
    )
    channels = dict(_accounts(log, flown.produced))
    return {
        "vehicle": name,
        "title": published["title"],
        "seed": flown.truth["seed"],
        "log": str(flown.log),
        "masses": masses,
        "centres": centres,
        "inertias": inertias,
        "channels": channels,
        "identified": all(mass["supported"] for mass in masses),
        "accounted": all(c["recorded"] + c["missing"] == c["produced"] for c in channels.values()),
        "events": _troubles(log),
        "capture": _capture(log, flown.truth),
    }


def _compared(row: dict[str, Any], answers: dict[str, dict[str, Any]], truth: dict[str, Any]) -> dict[str, Any]:
    answer = answers.get(row["quantity"])
    supported = answer is not None and answer["supported"]
    true = float(truth[row["truth"]] if "truth" in row else truth["quantities"][row["quantity"]])
    standing = "" if answer is None else answer["standing"]
    made: dict[str, Any] = {**row, "truth": true, "supported": supported, "standing": standing}
    if answer is not None and supported:
        made |= {key: answer[key] for key in ("value", "low", "high", "sigma", "drawn", "unit")}
        made["our_error_percent"] = 100 * (answer["value"] / true - 1) if true else None
        made["covered"] = answer["low"] <= true <= answer["high"]
    return made


def _accounts(log: LogReader, produced: dict[str, int]) -> Iterator[tuple[str, dict[str, int]]]:
    """Samples produced, recorded, and in GAP records, for each channel of the devices."""
    recorded = dict.fromkeys(produced, 0)
    missing = dict.fromkeys(produced, 0)
    for channel, rows in log.batches():
        if channel in recorded:
            recorded[channel] += len(rows)
        elif rows.dtype == records.GAP:
            for row in rows:
                missing[row["channel"].decode()] += int(row["last_missing"] - row["first_missing"]) + 1
    for name, count in produced.items():
        yield name, {"produced": count, "recorded": recorded[name], "missing": missing[name]}


def _capture(log: LogReader, truth: dict[str, Any]) -> dict[str, Any] | None:
    """Mission time [s] of a capture and of its detection; None without a capture."""
    if not truth.get("capture_s"):
        return None
    said = [row for _, rows in log.batches() if rows.dtype == records.EVENT for row in rows[rows["code"] == b"capture"]]
    return {"true_s": truth["capture_s"], "said_s": [1e-9 * (int(row["host_ns"]) - truth["start_ns"]) for row in said]}


def _troubles(log: LogReader) -> list[str]:
    """Warnings and errors, as sentences."""
    return [
        f"{row['source'].decode()}: {row['text'].decode()}"
        for _, rows in log.batches()
        if rows.dtype == records.EVENT
        for row in rows[rows["severity"] >= records.Severity.WARNING]
    ]


def render(table: Result) -> RenderableType:
    """The table for a terminal of 80 columns."""
    title = f"{table['title']} (seed {table['seed']})"
    published = any("identified_g" in row for row in table["masses"])
    made = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    made.add_column("", no_wrap=True)
    for heading in ("truth", *(("publ.", "err %") if published else ()), "heft", "95 % interval", "err %"):
        made.add_column(heading, justify="right", no_wrap=True)
    for section in ("masses", "centres", "inertias"):
        for row in table[section]:
            theirs = ("", "") if published else ()
            if "identified_g" in row:
                theirs = f"{row['identified_g']:.1f}", f"{row['error_percent']:.2f}"
            truth = f"{row['factor'] * row['truth']:.{row['digits']}f}"
            made.add_row(f"{row['label']}, {row['shown_in']}", truth, *theirs, *_ours(row))
        made.add_section()
    lines: list[Text] = []
    if capture := table["capture"]:
        noticed = ", ".join(f"{at_s:.2f} s" for at_s in capture["said_s"]) or "no"
        lines.append(Text(f"captured at {capture['true_s']:.2f} s, unknown to the estimator; detected: {noticed}"))
    counted = ", ".join(
        f"{name} {c['recorded']}" + (f" (and {c['missing']} missing)" if c["missing"] else "")
        for name, c in table["channels"].items()
    )
    standings: dict[str, list[str]] = {}
    for row in (*table["masses"], *table["centres"], *table["inertias"]):
        standings.setdefault(row["standing"] or "not answered", []).append(row["label"])
    lines += [Text(f"{', '.join(labels)}: {standing}") for standing, labels in standings.items()]
    verdict = "every sample accounted for" if table["accounted"] else "SAMPLES UNACCOUNTED FOR"
    troubles = [Text(f"! {text}", style="yellow") for text in table["events"][:8]]
    if len(table["events"]) > len(troubles):
        troubles.append(Text(f"! and {len(table['events']) - len(troubles)} more: heft info", style="yellow"))
    return Group(made, *lines, Text(f"{verdict}: {counted}"), *troubles)


def _ours(row: dict[str, Any]) -> tuple[str, str, str]:
    if not row["supported"] or not np.isfinite(row["value"]):
        return "—", "not determined", ""
    value, low, high = (f"{row['factor'] * row[key]:.{row['digits']}f}" for key in ("value", "low", "high"))
    percent = row["our_error_percent"]
    return value, f"{low} .. {high}", "" if percent is None else f"{percent:+.2f}"


_SHOWN: dict[str, dict[str, Any]] = {
    "row": {"shown_in": "g", "factor": 1e3, "digits": 1},
    "centre": {"shown_in": "mm", "factor": 1e3, "digits": 2},
    "inertia": {"shown_in": "g m²", "factor": 1e3, "digits": 3},
}
