"""Writes a planned motion (a CSV of the joints, a scenario that flies it, numbers, a figure), or a library of them."""

import csv
import json
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import ParseError

from onboard import config
from onboard.config import text
from onboard.config.segments import FILE, Library, to_bytes
from onboard.ground.before.foresee.plan import Foreseen
from onboard.ground.before.planning.planning import PlannedMotion
from onboard.ground.before.planning.view import figure

MOTION, SCENARIO, NUMBERS, FIGURE = "motion.csv", "scenario.toml", "plan.json", "plan.svg"
_CSV_HZ = 100.0


def write(made: PlannedMotion | Library, tables: dict[str, Any], over: Path | None, directory: Path) -> list[Path]:
    """Write the files into a directory, which is made.

    Args:
        made: the motion, or a library, which is one file.
        tables: of the scenario that flies it beside its motion: ``sequence``, ``capture``.
        over: the scenario that was planned over; its other tables are kept.
        directory: for the files; those of an earlier plan are replaced.

    Raises:
        ConfigError: the scenario is not TOML.
        OSError: they cannot be written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    if isinstance(made, Library):
        (directory / FILE).write_bytes(to_bytes(made))
        return [directory / FILE]
    paths = [directory / name for name in (MOTION, SCENARIO, NUMBERS, FIGURE)]
    step = max(1, round(1.0 / (_CSV_HZ * (made.time_s[1] - made.time_s[0]))))
    with paths[0].open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time_s", *made.joints])
        for at, q in zip(made.time_s[::step].tolist(), made.q[::step].tolist(), strict=True):
            rows.writerow([f"{at:.6g}", *(f"{angle:.9g}" for angle in q)])
    paths[1].write_text(_scenario(tables, over), encoding="utf-8")
    paths[2].write_text(json.dumps(numbers(made), indent=1) + "\n", encoding="utf-8")
    figure(made, paths[3])
    return paths


def numbers(made: PlannedMotion | Library) -> dict[str, Any]:
    """The plan as JSON values, SI; of a library each segment at each payload, and its nearest limit."""
    if isinstance(made, Library):
        told = zip(made.names, made.durations_s, made.base_rate, made.excess, made.breaks, strict=True)
        keys = ("name", "duration_s", "base_rate_rad_s", "over_limit", "limit")
        segments = [dict(zip(keys, one, strict=True)) for one in told]
        return {"joints": made.joints, "masses_kg": made.masses, "segments": segments}
    return {
        "start_s": made.start_s,
        "end_s": made.end_s,
        "expected": _answers(made.expected),
        "expected_of_swings": _answers(made.expected_before),
        "weakest": made.weakest,
        "along": {
            "time_s": made.along_s.tolist(),
            "sigma": dict(zip(made.names, made.along_sigma.T.tolist(), strict=True)),
        },
        "evaluations": made.found.evaluations,
    }


def _answers(found: Foreseen) -> list[dict[str, Any]]:
    return [one._asdict() for one in (*found.quantities, *found.parameters)]


def _scenario(tables: dict[str, Any], over: Path | None) -> str:
    try:
        document = tomlkit.parse("" if over is None else text.read(over, "a scenario"))
    except ParseError as error:
        raise config.ConfigError(f"{over}: not TOML: {error}") from error
    document.setdefault("motion", tomlkit.table())
    document["motion"]["csv"] = MOTION  # beside the scenario
    for name, value in tables.items():
        document.pop(name, None)
        document.add(name, tomlkit.item(value))
    return tomlkit.dumps(document)
