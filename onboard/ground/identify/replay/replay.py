"""Recomputes the estimates from a log and compares them with those of the flight, bit for bit.

The TICK records name the rows consumed by each step of the onboard estimator; the same code gets the same rows in the
same steps. The outputs must be identical to the last bit, for any scheduling on board.
"""

import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from drivers.records import Batch, Rows
from onboard import config
from onboard.channels import tick_dtype
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.log.tables.progress import follow
from onboard.ground.log.tables.vehicle_file import require_kinds, vehicle_of
from onboard.recording.errors import ChannelError
from onboard.recording.reader import LogReader

SEQUENCED = np.dtype([("sequence", "<u8"), ("host_ns", "<i8")])
_COMPARED_AT_ONCE = 4096  # rows
_LONGEST_STEP_NS = 86_400 * 10**9  # of an estimator: it makes a hundred in a second
_UNANSWERED = 2  # last steps of an interrupted flight with a TICK in the log but no outputs


class Replay(NamedTuple):
    """Result of a replay."""

    identical: bool
    summary: str
    compared: dict[str, int]  # rows by channel
    damage: tuple[object, ...]


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
            self._waiting[batch.channel] = np.concatenate([waiting, batch.rows]) if len(waiting) else batch.rows
        return batch is not None

    def take(self, name: str, first: int, last: int) -> Rows:
        """Rows ``first..last`` (sequence numbers, both included) of one channel, as far as the log has them."""
        if name not in self._waiting:
            return np.empty(0, SEQUENCED)
        while not len(self._waiting[name]) or self._waiting[name]["sequence"][-1] < last:
            if not self.read_on():
                break
        rows = self._waiting[name]
        low = int(np.searchsorted(rows["sequence"], first))
        high = int(np.searchsorted(rows["sequence"], last, side="right"))
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


class _Said:
    """Comparison of recorded and recomputed rows of one channel, of many steps at a time."""

    def __init__(self, dtype: np.dtype[np.void]) -> None:
        self.recorded = self.same = 0
        self.until: int | None = None  # rows from here on are of an estimator that has not begun yet
        self.differs = False
        self._dtype = dtype
        self._said: list[Rows] = []  # not compared yet, or after the first difference
        self._again: list[Rows] = []
        self._held = 0  # rows that came since the last comparison

    @property
    def replayed(self) -> int:
        """Number of recomputed rows."""
        return self.same + sum(map(len, self._again))

    def add(self, said: Rows, again: Sequence[Rows] = ()) -> None:
        """Further rows, to be compared; after the first difference they are only counted."""
        self.recorded += len(said)
        self._said.append(said)
        self._again += again
        self._held += len(said)
        if self._held >= _COMPARED_AT_ONCE:
            self._compare()

    def _compare(self) -> None:
        said, again = _joined(self._said, self._dtype), _joined(self._again, self._dtype)
        self._said, self._again, self._held = [said], [again], 0
        count = min(len(said), len(again))
        count = count if self.until is None else min(count, self.until - self.same)
        if self.differs or not count:
            return
        if said.dtype != again.dtype:
            self.differs = True
            return
        equal = (_bytes(again[:count]) == _bytes(said[:count])).all(axis=1)
        self.differs = not equal.all()
        count = int(np.argmin(equal)) if self.differs else count
        self.same += count
        self._said, self._again = [said[count:]], [again[count:]]

    def forget(self, known: int) -> None:
        """Only the first ``known`` recomputed rows had been published before the estimator died."""
        self._compare()
        self._again = [self._again[0][: max(0, known - self.same)]]

    def end(self, answered_ns: int) -> None:
        """End of the flight: outputs of its last steps may be missing in the log."""
        self._compare()
        [said], [again] = self._said, self._again
        if len(again) and (again[len(said) :]["host_ns"] > answered_ns).all():
            again = again[: len(said)]
        self.differs |= len(said) + len(again) > 0


def _joined(parts: Sequence[Rows], dtype: np.dtype[np.void]) -> Rows:
    """The rows of some batches, (n,)."""
    some = [part for part in parts if len(part)]
    return some[0] if len(some) == 1 else np.concatenate(some) if some else np.empty(0, dtype)


def _bytes(rows: Rows) -> NDArray[np.uint8]:
    """The rows' fields as they lie in memory, (n, itemsize), what fills the gaps between them zeroed."""
    clean = np.zeros(len(rows), rows.dtype)
    for field in rows.dtype.names or ():
        clean[field] = rows[field]
    return clean.view(np.uint8).reshape(len(rows), rows.dtype.itemsize)


def replay(path: Path, progress: Progress | None = None) -> Replay:
    """Replay a log; ``progress`` counts its bytes.

    Raises:
        LogFormatError: it is no log.
        ConfigError: it carries no vehicle that can be used.
        ChannelError: its rows are not of the kind that this vehicle gives.
    """
    log = LogReader(path)
    restarts_ns = _restarts_ns(log)  # first: the vehicle then takes no pass of its own
    with tempfile.TemporaryDirectory() as directory:
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
            text = f"step {int(tick['sequence'])} of the estimator is {1e-9 * (now_ns - before_ns):.0f} s after the one"
            raise ChannelError(f"{text} before it: its time is altered; heft identify does without the steps")
        before_ns = now_ns
        yield EstimatorStep(now_ns, batches, 0 if tick["final"] else None, fresh, short, skipped_ns)


def _require_tick(dtype: np.dtype[np.void], count: int) -> None:
    """Raises ChannelError unless rows of ``tick`` are of this or an earlier version, for ``count`` channels."""
    wanted = tick_dtype(count)
    known = wanted.names or ()
    late = ("skipped_ns", "fresh")  # not in earlier versions
    fields = {name: dtype[name] for name in dtype.names or ()}
    if any(name not in fields and name not in late for name in known) or any(
        name in fields and fields[name] != wanted[name] for name in known
    ):
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
    outputs = estimator.outputs
    rows = Pass(log, [*estimator.inputs, "tick", *outputs])
    channels = {name: _Said(dtype) for name, dtype in outputs.items()}
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
    answered_ns = times_ns[0]
    for name, channel in channels.items():
        channel.add(rows.waiting(name))
        replayed = channel.replayed
        channel.end(answered_ns)
        if channel.differs:
            why = f"; {short}" if short else ""
            text = f"{name} differs from row {channel.same}: {channel.recorded} recorded, {replayed} replayed{why}"
            return Replay(False, text, {n: c.recorded for n, c in channels.items()}, log.damage)
    compared = {name: channel.recorded for name, channel in channels.items()}
    if not any(compared.values()):
        return Replay(False, "nothing to compare: the log has no output of an estimator", compared, log.damage)
    total = ", ".join(f"{count} {name}" for name, count in compared.items())
    return Replay(True, f"identical to the last bit: {total}", compared, log.damage)
