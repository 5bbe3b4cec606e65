"""``heft identify``: recorded flights through the estimator that flies, and its last word on each.

For any vehicle these are the last quantities with their intervals, as the onboard QUANTITY channel carries them. For a
free body (``[free_body]`` in the vehicle file) the load is told from them, and loads of known truth are summed up.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from onboard import config
from onboard.flight.estimator import Estimator
from onboard.model.identify import Identifier
from onboard.offline import throws
from onboard.offline.feed import check_channels, feed
from onboard.offline.throws import Calibration, Summary, Throw
from onboard.recording.reader import LogReader

PER_KG_MM2 = 1e6


class Answer(NamedTuple):
    """The last QUANTITY of one name; numbers are NaN where the data do not support it."""

    name: str
    unit: str
    value: float
    sigma: float
    low: float
    high: float
    supported: bool

    def as_json(self) -> dict[str, Any]:
        """Plain values, None for what is no number."""
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in self._asdict().items()}


@dataclass(frozen=True)
class Identified:
    """One log's answer."""

    log: Path
    answers: tuple[Answer, ...]  # base parameters without a unit, then the quantities
    rows_used: int
    refused: dict[str, int]  # rows by reason
    damage: tuple[object, ...]
    throw: Throw | None

    @property
    def supported(self) -> bool:
        """Whether the log answers what the vehicle was flown for: its load, or at least one quantity."""
        if self.throw is not None:
            return self.throw.body is not None
        asked = [answer for answer in self.answers if answer.unit] or self.answers
        return any(answer.supported for answer in asked)

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "log": str(self.log),
            "supported": self.supported,
            "rows_used": self.rows_used,
            "refused": self.refused,
            "damage": [str(one) for one in self.damage],
            "quantities": [answer.as_json() for answer in self.answers],
            "throw": self.throw.as_json() if self.throw else None,
        }


@dataclass(frozen=True)
class Identification:
    """All logs' answers, and what they say together."""

    vehicle: config.Vehicle
    logs: tuple[Identified, ...]
    calibration: Calibration | None

    @property
    def supported(self) -> bool:
        """Whether every log answers."""
        return all(log.supported for log in self.logs)

    @property
    def damage(self) -> tuple[str, ...]:
        """What could not be read, with the log it is from."""
        return tuple(f"{log.log}: {one}" for log in self.logs for one in log.damage)

    @property
    def summaries(self) -> list[Summary]:
        """By load, where the truth is known."""
        return throws.summaries([log.throw for log in self.logs if log.throw is not None])

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "vehicle": self.vehicle.file.vehicle.name,
            "logs": [log.as_json() for log in self.logs],
            "loads": [summary.as_json() for summary in self.summaries],
            "calibration": self.calibration.as_json() if self.calibration else None,
        }


def identify(
    vehicle: config.Vehicle, logs: Sequence[Path], progress: Callable[[int], None] | None = None
) -> Identification:
    """Every log through an estimator of its own; throws that calibrate once more through one for all of their kind.

    Args:
        vehicle: that flew.
        logs: its logs.
        progress: is told how many logs are done.

    Raises:
        LogFormatError: a file that is no log.
        ChannelError: a log of another vehicle.
        LoadError: a log of a free body that no load, or more than one, goes by.
        ConfigError: the vehicle file does not fit its URDF.
    """
    readers = [LogReader(log) for log in logs]
    for reader in readers:
        check_channels(vehicle, reader)
    loads = [throws.load_of(vehicle, log) if vehicle.file.free_body else None for log in logs]
    calibration: dict[str, Identifier] = {}
    found = []
    for reader, load in zip(readers, loads, strict=True):
        found.append(_one(vehicle, reader, load))
        if load is not None and load.role != "load":
            again = Estimator(vehicle, calibration.get(load.role))
            calibration[load.role] = again.identifier
            for _ in feed(again, reader):
                pass
        if progress:
            progress(len(found))
    return Identification(vehicle, tuple(found), throws.calibrate(vehicle, calibration))


def _one(vehicle: config.Vehicle, log: LogReader, load: config.Load | None) -> Identified:
    estimator = Estimator(vehicle)
    last = None
    for channel, rows in feed(estimator, log):
        if channel == "quantity":
            last = rows
    answers = tuple(
        Answer(
            row["name"].decode(),
            row["unit"].decode(),
            float(row["value"]),
            float(row["sigma"]),
            float(row["low"]),
            float(row["high"]),
            bool(row["supported"]),
        )
        for row in (last if last is not None else ())
    )
    who = estimator.identifier
    refused = {str(reason.name).lower(): count for reason, count in who.refused.items() if count}
    load_found = throws.throw(vehicle, load, who, who.estimate() if who.rows_used else None) if load else None
    return Identified(log.path, answers, who.rows_used, refused, log.damage, load_found)


def render(found: Identification) -> RenderableType:
    """What people see; 80 columns are enough."""
    if not any(log.throw for log in found.logs):
        return Group(*(part for log in found.logs for part in (_quantities(log), _account(log))))
    parts: list[RenderableType] = []
    for name in dict.fromkeys(log.throw.load.name for log in found.logs if log.throw):
        parts.append(_throws([log for log in found.logs if log.throw and log.throw.load.name == name]))
    if found.summaries:
        parts.append(_summary(found.summaries))
    if found.calibration:
        rotor = found.calibration.rotor
        text = (
            f"calibration from the throws above: the rotor's inertia in {found.vehicle.file.vehicle.urdf} times "
            f"{rotor.factor:.4f} ± {rotor.sigma:.4f} (sigma), misfit {100 * rotor.misfit:.2f} %; for the vehicle file:"
        )
        parts += [Text(text), Text(f"\n{found.calibration.as_toml()}\n")]
    return Group(*parts)


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column(headings[0], no_wrap=True)
    for heading in headings[1:]:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _quantities(log: Identified) -> Table:
    table = _table(str(log.log), "", "unit", "value", "sigma", "95 % interval")
    for answer in log.answers:
        numbers = ("—", "", "not determined")
        if answer.supported:
            numbers = (f"{answer.value:.4g}", f"{answer.sigma:.1g}", f"{answer.low:.4g} .. {answer.high:.4g}")
        table.add_row(answer.name, answer.unit, *numbers)
    return table


def _account(log: Identified) -> Text:
    why = ", ".join(f"{count} {reason}" for reason, count in log.refused.items())
    return Text(f"{log.rows_used} rows used; left out: {why or 'none'}")


def _throws(logs: Sequence[Identified]) -> Table:
    """One load's throws."""
    stems = [log.log.stem for log in logs]
    heads = {stem[: stem.rfind("_") + 1] for stem in stems}  # all alike: said by the title already
    shared = len(heads.pop()) if len(heads) == 1 else 0
    load = next(log.throw.load for log in logs if log.throw)
    title = f"{load.name}, {1e3 * load.mass_kg:g} g: principal moments ± 95 %, kg mm²"
    table = _table(title, "", "I1", "I2", "I3", "err %")
    for log, stem in zip(logs, stems, strict=True):
        principal = log.throw.principal if log.throw else None
        if log.throw is None or principal is None:
            table.add_row(stem[shared:], "—", "not determined", "—", "")
            continue
        shown = [
            f"{PER_KG_MM2 * value:.1f} ± {PER_KG_MM2 * (high - value):.1f}"
            for value, high in zip(principal.moments, principal.high, strict=True)
        ]
        error = log.throw.error_percent
        table.add_row(stem[shared:], *shown, "" if error is None else f"{error:.2f}")
    if load.truth_kg_m2:
        table.add_section()
        table.add_row("truth", *(f"{PER_KG_MM2 * value:.1f}" for value in sorted(load.truth_kg_m2)), "")
    return table


def _summary(summaries: Sequence[Summary]) -> Table:
    title = "error of the principal moments, norm over norm of the truth"
    table = _table(title, "", "throws", "mean %", "bar", "worst %", "bar", "in interval")
    for one in summaries:
        mean_bar, worst_bar = (f"{bar:g}" for bar in one.load.bars_percent) if one.load.bars_percent else ("", "")
        throws_said = f"{one.throws}" if one.answered == one.throws else f"{one.answered} of {one.throws}"
        mean, worst = f"{one.mean_percent:.2f}", f"{one.worst_percent:.2f}"
        table.add_row(one.load.name, throws_said, mean, mean_bar, worst, worst_bar, f"{one.covered_percent:.0f} %")
    return table
