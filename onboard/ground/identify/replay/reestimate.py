"""``heft replay --with``: estimates a flight with other settings and compares with the onboard estimates.

The new settings are a TOML file with only the keys that change; they override the vehicle file in the log. The
estimator makes the same steps as in flight, so that every difference is due to the settings.
"""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from rich.console import Group, RenderableType
from rich.progress import Progress
from rich.table import Table
from rich.text import Text

from onboard import config
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.identify.replay.replay import Pass, steps
from onboard.ground.log.tables.progress import follow
from onboard.ground.log.tables.vehicle_file import require_kinds, vehicle_of
from onboard.ground.log.views.summary import LogOverview, count_gates, plain_table, summary
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader

_ABSENT = "not set"


class SettingChange(NamedTuple):
    """One setting, by its dotted key."""

    key: str
    flown: str
    now: str


class Reestimate(NamedTuple):
    """Changed settings, onboard estimates, and new estimates."""

    changes: tuple[SettingChange, ...]
    flown: LogOverview
    now: LogOverview
    short: str  # inputs missing in the log
    damage: tuple[object, ...]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "changes": [change._asdict() for change in self.changes],
            "flown": self.flown.as_json(),
            "now": self.now.as_json(),
            "damage": [str(one) for one in self.damage],
        }


def reestimate(path: Path, settings: Path, progress: Progress | None = None) -> Reestimate:
    """Estimate the flight of ``path`` again, with ``settings`` put over those it was flown with.

    ``progress`` counts the bytes of the log.

    Raises:
        LogFormatError: it is no log.
        ConfigError: it carries no vehicle, or the settings do not fit.
        ChannelError: its rows are not of the kind that this vehicle gives.
        OSError: a file cannot be read.
    """
    log = LogReader(path)
    with TemporaryDirectory() as directory:
        flown = vehicle_of(log, Path(directory))
        over = config.tree_of(config.read(settings, "a file of settings"), str(settings))
        vehicle = config.parse_tree(config.laid_over(flown.tree, over), flown.path, config.Origin(str(settings)))
        if vehicle.channels != flown.channels:
            raise config.ConfigError(
                f"{settings} changes the devices' channels, which a flight that is over cannot; change [estimation], "
                "[free_body] or numbers of a device"
            )
        require_kinds(log, vehicle)
        estimator = Estimator(vehicle)
    now, short = LogOverview(), ""
    rows_of_log = Pass(log, [*estimator.inputs, "tick"])
    tell = follow(progress, "estimate", log)
    for step in steps(rows_of_log, estimator.inputs):
        tell()
        short = short or step.short
        for channel, rows in estimator.process(step.now_ns, step.batches, step.lag_ns, step.skipped_ns):
            if channel == "row":
                count_gates(now, rows["gate"])
            elif channel == "quantity":
                now.answers.update((printable(row["name"]), row) for row in rows)
    said = summary(log)
    said.clocks = {}
    return Reestimate(tuple(_changes(flown, vehicle)), said, now, short, log.damage)


def _changes(flown: config.Vehicle, now: config.Vehicle) -> Iterator[SettingChange]:
    old, new = (dict(_leaves(vehicle.file.model_dump())) for vehicle in (flown, now))
    for key in dict.fromkeys([*old, *new]):
        if old.get(key) != new.get(key):
            yield SettingChange(key, *(str(tree.get(key, _ABSENT)) for tree in (old, new)))


def _leaves(tree: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{before}{key}.")
        else:
            yield before + key, value


def render(found: Reestimate) -> RenderableType:
    """``found`` for a terminal."""
    changed = ", ".join(f"{change.key} {change.flown} -> {change.now}" for change in found.changes)
    parts: list[RenderableType] = [Text(f"changed: {changed or 'nothing'}"), _answers(found), _rows(found)]
    if found.short:
        parts.append(Text(f"not all that the estimator had is in the log: {found.short}", style="yellow"))
    return Group(*parts)


def _answers(found: Reestimate) -> Table:
    headings = "said on board", "95 % interval", "now", "95 % interval", "change %", "in sigmas"
    table = plain_table("quantity", *headings)
    for name in dict.fromkeys([*found.flown.answers, *found.now.answers]):
        flown, now = found.flown.answers.get(name), found.now.answers.get(name)
        if not any(row is not None and row["supported"] for row in (flown, now)):
            continue
        table.add_row(Text(name), *_answer(flown), *_answer(now), *_change(flown, now))
    return table


def _answer(row: np.void | None) -> tuple[str, str]:
    if row is None or not row["supported"]:
        return "", "not determined"
    return f"{row['value']:.6g}", f"{row['low']:.4g} .. {row['high']:.4g}"


def _change(flown: np.void | None, now: np.void | None) -> tuple[str, str]:
    if flown is None or now is None or not (flown["supported"] and now["supported"]):
        return "", ""
    step = float(now["value"] - flown["value"])
    percent = f"{100 * step / abs(float(flown['value'])):+.3f}" if flown["value"] else ""
    return percent, f"{step / float(flown['sigma']):+.2f}" if flown["sigma"] else ""


def _rows(found: Reestimate) -> Table:
    table = plain_table("rows", "on board", "now")
    table.add_row("used", *(f"{one.used:,} of {one.rows:,}" for one in (found.flown, found.now)))
    for reason in dict.fromkeys([*found.flown.refused, *found.now.refused]):
        counts = (f"{one.refused.get(reason, 0):,}" for one in (found.flown, found.now))
        table.add_row(f"refused: {reason.replace('_', ' ')}", *counts)
    return table
