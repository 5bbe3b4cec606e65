"""Recomputes the estimates from a log and compares them with those of the flight, bit for bit.

The TICK records name the rows consumed by each step of the onboard estimator; the same code gets the same rows in the
same steps. On the same computer the outputs must be identical to the last bit, for any scheduling on board. Another
processor, or another version of NumPy, adds up in another order: then the answers must agree to rounding, and all that
is no number must be the same.

``heft replay --with`` estimates a flight with other settings and compares with the onboard estimates. The new settings
are a TOML file with only the keys that change; they override the vehicle file in the log. The estimator makes the same
steps as in flight, so that every difference is due to the settings.
"""

import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from rich.console import Group, RenderableType
from rich.progress import Progress
from rich.table import Table
from rich.text import Text
from threadpoolctl import threadpool_limits

from drivers.records import Batch, Rows
from onboard import config
from onboard.channels import tick_dtype
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.store.flight_log import computed_on
from onboard.ground.identify.replay.comparison import Comparison, joined
from onboard.ground.log.tables.progress import follow
from onboard.ground.log.tables.vehicle_file import require_kinds, vehicle_of
from onboard.ground.log.views.summary import LogOverview, count_gates, plain_table, summary
from onboard.recording.format.errors import ChannelError
from onboard.recording.format.texts import printable
from onboard.recording.reader import LogReader

SEQUENCED = np.dtype([("sequence", "<u8"), ("host_ns", "<i8")])
AGREE_sigmas = 1e-6  # between an answer of the flight and one computed elsewhere; rounding makes 1e-9
_LONGEST_STEP_NS = 86_400 * 10**9  # of an estimator: it makes a hundred in a second
_UNANSWERED = 2  # last steps of an interrupted flight with a TICK in the log but no outputs


class Replay(NamedTuple):
    """Result of a replay."""

    identical: bool
    summary: str
    compared: dict[str, int]  # rows by channel
    damage: tuple[object, ...]
    farthest_sigmas: float = 0.0  # between a supported answer and the recorded one; infinite: more than numbers differ
    elsewhere: tuple[str, ...] = ()  # in what this computer differs from the one that computed the log

    @property
    def agrees(self) -> bool:
        """Whether the outputs are the same, to rounding where they were computed on another computer."""
        return self.identical or (bool(self.elsewhere) and self.farthest_sigmas <= AGREE_sigmas)


class Pass:
    """One pass over a log: rows of several channels, buffered until requested."""

    def __init__(self, log: LogReader, channels: Iterable[str]) -> None:
        known = [name for name in channels if name in log.channels]
        self._waiting: dict[str, Rows] = {name: np.empty(0, log.channels[name]) for name in known}
        self._batches: Iterator[Batch] = log.batches(known)

    def read_on(self) -> bool:
        """Read one more batch; False at the end of the log."""
        batch = next(self._batches, None)
        if batch is not None:
            waiting = self._waiting[batch.channel]
            self._waiting[batch.channel] = joined([waiting, batch.rows], batch.rows.dtype)
        return batch is not None

    def take(self, name: str, first: int, last: int) -> Rows:
        """Rows ``first..last`` (sequence numbers, both included) of one channel, as far as the log has them."""
        if name not in self._waiting:
            return np.empty(0, SEQUENCED)
        while not len(self._waiting[name]) or self._waiting[name]["sequence"][-1] < last:
            if not self.read_on():
                break
        rows = self._waiting[name]
        low = int(rows["sequence"].searchsorted(np.uint64(first)))
        high = int(rows["sequence"].searchsorted(np.uint64(last), side="right"))
        self._waiting[name] = rows[high:]
        return rows[low:high]

    def following(self, name: str) -> Iterator[np.void]:
        """Every row of one channel to the end of the log."""
        while name in self._waiting:
            rows = self._waiting[name]
            if len(rows):
                self._waiting[name] = rows[1:]
                yield rows[0]
            elif not self.read_on():
                return

    def waiting(self, name: str) -> Rows:
        """Take the buffered rows of one channel."""
        rows = self._waiting.get(name)
        if rows is None:
            return np.empty(0, SEQUENCED)
        self._waiting[name] = rows[:0]
        return rows


def replay(path: Path, progress: Progress | None = None) -> Replay:
    """Replay a log; ``progress`` counts its bytes.

    Raises:
        LogFormatError: it is no log.
        ConfigError: it carries no vehicle that can be used.
        ChannelError: its rows are not of the kind that this vehicle gives.
    """
    log = LogReader(path, kept=1.0)
    restarts_ns = _restarts_ns(log)  # first: the vehicle then takes no pass of its own
    with tempfile.TemporaryDirectory() as directory, threadpool_limits(1, user_api="blas"):  # as onboard.cli.main
        return _replay(log, vehicle_of(log, Path(directory)), restarts_ns, follow(progress, "replay", log))


class EstimatorStep(NamedTuple):
    """What a step of the onboard estimator consumed, by channel."""

    now_ns: int
    batches: dict[str, Rows]
    lag_ns: int | None
    fresh: bool  # a new estimator began with it
    short: str  # missing inputs; empty if complete
    skipped_ns: int  # left out before it


def steps(rows: Pass, channels: tuple[str, ...]) -> Iterator[EstimatorStep]:
    """The steps of the estimator in a flight, from the TICK records.

    Args:
        rows: a pass over the flight's log, with these channels and ``tick``.
        channels: what the estimator consumed, in its order.

    Raises:
        ChannelError: the rows of ``tick`` are no such records, or one is a day from the one before it.
    """
    before_ns: int | None = None
    for tick in rows.following("tick"):
        _require_tick(tick.dtype, len(channels))
        batches: dict[str, Rows] = {}
        short = ""
        consumed = zip(
            channels, *(tick[k].tolist() for k in ("consumed", "first_sequence", "last_sequence")), strict=True
        )
        for name, count, first, last in consumed:
            if not count:
                continue
            batches[name] = rows.take(name, first, last)
            if len(batches[name]) != count:
                short = short or f"{name}: {count - len(batches[name])} rows of {first}..{last} are not in the log"
        fresh = "fresh" in (tick.dtype.names or ()) and bool(tick["fresh"])
        skipped_ns = int(tick["skipped_ns"]) if "skipped_ns" in (tick.dtype.names or ()) else 0
        now_ns = int(tick["host_ns"])
        if before_ns is not None and not 0 <= now_ns - before_ns - skipped_ns < _LONGEST_STEP_NS:
            text = (
                f"step {int(tick['sequence'])} of the estimator is {1e-9 * (now_ns - before_ns):.0f} s after the step"
            )
            raise ChannelError(f"{text} before it: its time is altered; heft identify does without the steps")
        before_ns = now_ns
        yield EstimatorStep(now_ns, batches, 0 if tick["final"] else None, fresh, short, skipped_ns)


def _require_tick(dtype: np.dtype[np.void], count: int) -> None:
    """Raises ChannelError unless rows of ``tick`` are of this or an earlier version, for ``count`` channels."""
    wanted, there = tick_dtype(count), dtype.names or ()
    late = ("skipped_ns", "fresh")  # not in earlier versions
    if any(dtype[name] != wanted[name] if name in there else name not in late for name in wanted.names or ()):
        raise ChannelError("the rows of 'tick' are none of this vehicle's estimator; heft identify does without them")


def _restarts_ns(log: LogReader) -> list[int]:
    """When an estimator began anew in place of one that died."""
    try:
        ticks = log.read("tick")
    except ChannelError:
        return []
    anew = ticks["fresh"] != 0 if "fresh" in (ticks.dtype.names or ()) else np.zeros(len(ticks), np.bool_)
    return [int(at_ns) for at_ns in ticks["host_ns"][anew]]


def _published_before(log: LogReader, restarts_ns: Sequence[int], outputs: Iterable[str]) -> deque[dict[str, int]]:
    """Rows of each output before each of the restarts."""
    times = {name: log.read(name)["host_ns"] for name in outputs} if restarts_ns else {}
    return deque({name: int((at < now_ns).sum()) for name, at in times.items()} for now_ns in restarts_ns)


def _replay(log: LogReader, vehicle: config.Vehicle, restarts_ns: Sequence[int], tell: Callable[[], None]) -> Replay:
    require_kinds(log, vehicle)
    estimator = Estimator(vehicle)
    made_since = {"innovation"} - log.channels.keys()  # a log of a heft before it
    outputs = {name: dtype for name, dtype in estimator.outputs.items() if name not in made_since}
    rows = Pass(log, [*estimator.inputs, "tick", *outputs])
    channels = {name: Comparison(dtype) for name, dtype in outputs.items()}
    short = ""
    times_ns: deque[int] = deque([-1], maxlen=_UNANSWERED + 1)
    begun = _published_before(log, restarts_ns, outputs)
    for name, channel in channels.items():
        channel.until = begun[0][name] if begun else None
    for step in steps(rows, estimator.inputs):
        tell()
        times_ns.append(step.now_ns)
        if step.fresh:  # replaces one that died, whose last outputs may be missing
            said = begun.popleft()
            for name, channel in channels.items():
                channel.forget(said[name])
                channel.until = begun[0][name] if begun else None
            estimator = Estimator(vehicle)
            estimator.go_on_from(said)
        short = short or step.short
        again: dict[str, list[Rows]] = {name: [] for name in outputs}
        for name, made in estimator.process(step.now_ns, step.batches, step.lag_ns, step.skipped_ns):
            if name in again:
                again[name].append(made)
        for name, channel in channels.items():
            channel.add(rows.waiting(name), again[name])
    while rows.read_on():
        pass
    for name, channel in channels.items():
        channel.add(rows.waiting(name))
        channel.end(times_ns[0])
    return judged(channels, elsewhere(log.metadata), short, log.damage)


def judged(
    channels: Mapping[str, Comparison], elsewhere: tuple[str, ...], short: str, damage: tuple[object, ...]
) -> Replay:
    """What the comparison of all channels comes to; ``short`` is input that the log lacks."""
    compared = {name: channel.recorded for name, channel in channels.items()}
    total = ", ".join(f"{count} {name}" for name, count in compared.items())
    if not any(compared.values()):
        return Replay(False, "nothing to compare: the log has no output of an estimator", compared, damage)
    different = {name: channel for name, channel in channels.items() if channel.differs_from is not None}
    if not different:
        return Replay(True, f"identical to the last bit: {total}", compared, damage)
    farthest = max(channel.farthest_sigmas for channel in different.values())
    found = Replay(False, "", compared, damage, farthest, elsewhere)
    answers = f"answers of the flight and of this replay are at most {farthest:.1g} sigmas apart"
    computers = "".join(f"\n  {difference}" for difference in elsewhere)
    if found.agrees:
        text = f"the same to rounding: {total}; {answers}. The log was computed elsewhere:{computers}"
        return found._replace(summary=text)
    name, channel = next(iter(different.items()))
    text = f"{name} differs from row {channel.differs_from}: {channel.recorded} recorded, {channel.replayed} replayed"
    text += f"; {short}" if short else f"; {answers}" if farthest < float("inf") else ""
    return found._replace(summary=text + (f". The log was computed elsewhere:{computers}" if elsewhere else ""))


def elsewhere(metadata: Mapping[str, Mapping[str, str]]) -> tuple[str, ...]:
    """In what this computer differs from the one whose log says this of itself, of what numbers depend on."""
    here, there = computed_on(), {**metadata.get("flight", {}), **metadata.get("versions", {})}
    return tuple(
        f"{name}: {there[name]} in the log, {value} here" if name in there else f"{name}: the log does not say"
        for name, value in here.items()
        if there.get(name) != value
    )


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
