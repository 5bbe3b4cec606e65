"""Estimation worker: reads rings, writes estimates to rings, and records the rows of each step (TICK) for exact replay.

A worker whose process died is taken over by another one: it loads the newest checkpoint, repeats the steps of the later
TICK records, publishes the outputs not yet published, and continues; the log is the same as without the failure. If
that is impossible (rows no longer in the rings, or the same rows have killed two processes), a new estimator without
data continues after the last consumed row; its first TICK is marked ``fresh``, and an event gives the reason.
"""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from drivers import records
from drivers.records import Batch, Rows, Severity, event
from onboard import channels, config
from onboard.devices.base import BusDevice
from onboard.flight.acquire.publisher import Publisher
from onboard.flight.estimate.checkpoint import Checkpoint, Checkpoints
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.hand_over import HandOver
from onboard.flight.estimate.shedding import LATE_NS, to_skip_ns
from onboard.flight.estimate.state import StateError, UnwrittenParts
from onboard.flight.store import rings
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.quantities import MOST_ALSO
from onboard.ring import RingReader, RingWriter

SUFFIX = "_estimation"
CHECKPOINT_NS = 2_000_000_000  # from one to the next, at the most
CHECKPOINT_CPU_NS = 60_000_000  # of steps, which a restart would have to do again
CHECKPOINT_SHARE = 0.1  # of the CPU time of steps: a checkpoint costs 2 to 20 ms, as the estimator's state is large
LONGEST_STEP_NS = 500_000_000  # of the devices' rows; a step of many seconds holds up the next


def estimation_channels(estimator: Estimator) -> dict[str, np.dtype[np.void]]:
    """Channels that the estimation worker writes."""
    return {**estimator.outputs, "tick": channels.tick_dtype(len(estimator.inputs)), "event" + SUFFIX: records.EVENT}


def answer_rates_hz(estimator: Estimator) -> dict[str, float]:
    """How often rows of the estimation worker's channels come, at most."""
    settings = estimator.vehicle.file.estimation
    steps_hz = 1e3 / settings.step_ms
    answers = len(estimator.online.parameter_names) + len(estimator.online.quantity_names) + MOST_ALSO
    return {
        "tick": steps_hz,
        "clock": steps_hz * len(estimator.inputs),
        "row": settings.row_rate_hz,
        "estimate": steps_hz,
        "quantity": steps_hz * answers,
    }


def create_rings(directory: Path, estimator: Estimator) -> dict[str, RingWriter]:
    """Open the writing ends of the estimation worker's channels in ``directory``."""
    return rings.create(directory, estimator.vehicle, estimation_channels(estimator), answer_rates_hz(estimator))


class EstimationWorker:
    """Steps an :class:`Estimator` over rings.

    Args:
        estimator: as it is after ``ticks`` steps.
        inputs: by channel, at the first row that it has not consumed.
        publisher: of its answers.
        ticks: steps done.
        fresh: it has learned nothing, in place of one that died.
        reached_ns: time of the last step done.
    """

    def __init__(
        self,
        estimator: Estimator,
        inputs: Mapping[str, RingReader],
        publisher: Publisher,
        ticks: int = 0,
        *,
        fresh: bool = False,
        reached_ns: int | None = None,
    ) -> None:
        self.estimator, self._inputs, self._publisher = estimator, inputs, publisher
        self.period_ns = round(estimator.vehicle.file.estimation.step_ms * 1e6)
        self.ticks, self._fresh = ticks, fresh
        self._reached_ns, self._late = reached_ns, False
        self._longest_ns = max(LONGEST_STEP_NS, 2 * self.period_ns)
        self._left_out_ns, self._left_out_rows = 0, 0
        self._hand_over = None if estimator.vehicle.hand_over is None else HandOver(estimator.vehicle)
        self._kept = set[str]()  # channels of which no row is left out
        for name, device in estimator.vehicle.file.device.items():
            tells_changes = isinstance(device, BusDevice) and device.tells_changes
            if tells_changes or estimator.vehicle.rate_hz(name) * self.period_ns <= 1e9:
                self._kept.update(device.channels(name))

    def step(self, now_ns: int) -> None:
        """Consume the records since the last step; if they span more than 0.5 s, the oldest 0.5 s of them."""
        said, skipped_ns = self._shed(now_ns)
        until_ns = self._until(now_ns)
        behind_ns = now_ns - until_ns
        if not self._late and behind_ns > LATE_NS:
            text = f"{1e-9 * behind_ns:.1f} s behind the devices: the computer is busy; it works that off in steps"
            said.append(event(until_ns, Severity.WARNING, "estimator_late", "estimation", text))
        elif self._late and not behind_ns:
            said.append(event(until_ns, Severity.INFO, "estimator_in_time", "estimation", "caught up"))
        self._late = behind_ns > LATE_NS or (self._late and behind_ns > 0)
        self._step(until_ns, None, said, cut=behind_ns > 0, skipped_ns=skipped_ns)

    def _shed(self, now_ns: int) -> tuple[list[Batch], int]:
        """Leave out rows that there is no time for; the events that report it, and the time skipped [ns]."""
        if self._reached_ns is None or not (skip_ns := to_skip_ns(now_ns - self._reached_ns)):
            return [], 0
        self._reached_ns += skip_ns
        self._left_out_ns += skip_ns
        for name in self.estimator.inputs:
            if name not in self._kept:
                rows, lost = self._read(name, self._reached_ns)
                self._left_out_rows += len(rows) + lost
        text = (
            f"cannot keep up: too late by {1e-9 * skip_ns:.1f} s, goes on after that; "
            f"{self._left_out_rows} rows of {1e-9 * self._left_out_ns:.1f} s left out in all"
        )
        return [event(self._reached_ns, Severity.WARNING, "estimator_skips", "estimation", text)], skip_ns

    def finish(self, now_ns: int, over: Callable[[], bool] = lambda: False) -> None:
        """The last steps: nothing more will arrive, so rows are made up to the last sample.

        Args:
            now_ns: time of the call.
            over: whether the time for that is over; the answer of the last step is the answer then.
        """
        while (until_ns := self._until(now_ns)) < now_ns:
            if over():
                left = f"{1e-9 * (now_ns - (self._reached_ns or now_ns)):.1f} s"
                text = f"the last {left} of the flight are not taken in: the computer is busy; heft identify does"
                said = event(now_ns, Severity.WARNING, "estimator_unfinished", "estimation", text)
                self._publisher.publish([said])
                return
            self._step(until_ns, None, [], cut=True)
        self._step(now_ns, 0, [], cut=False)

    def _until(self, now_ns: int) -> int:
        """Up to when a step at ``now_ns`` consumes: a step over many seconds would take as long as it makes late."""
        return now_ns if self._reached_ns is None else min(now_ns, self._reached_ns + self._longest_ns)

    def _step(self, now_ns: int, lag_ns: int | None, said: list[Batch], *, cut: bool, skipped_ns: int = 0) -> None:
        self._reached_ns = now_ns
        batches: dict[str, Rows] = {}
        for name in self.estimator.inputs:
            batches[name], lost = self._read(name, now_ns if cut else None)
            if lost:
                text = f"{lost} rows overran the ring before the estimator read them"
                said.append(event(now_ns, Severity.WARNING, "estimator_overrun", name, text))
        self._publisher.publish([self._tick(now_ns, batches, skipped_ns, final=lag_ns is not None), *said])
        made = self.estimator.process(now_ns, batches, lag_ns, skipped_ns)
        self._publisher.publish(made)
        if self._hand_over is not None:
            self._publisher.publish(self._hand_over.step(now_ns, made))
        if isinstance(self.estimator.online, MotionIdentifier):
            self.estimator.online.work()

    def _read(self, name: str, until_ns: int | None) -> tuple[Rows, int]:
        """Rows of an input up to ``until_ns``, all of them where it is None, and how many were lost."""
        rows, lost = self._inputs[name].read()
        if until_ns is None or not len(rows) or rows["host_ns"][-1] <= until_ns:
            return rows, lost
        kept = int(np.searchsorted(np.maximum.accumulate(rows["host_ns"]), until_ns, side="right"))
        self._inputs[name].seek_after(int(rows["sequence"][kept]) - 1)
        return rows[:kept], lost

    def _tick(self, now_ns: int, batches: Mapping[str, Rows], skipped_ns: int, *, final: bool) -> Batch:
        row = np.zeros(1, channels.tick_dtype(len(batches)))
        row["sequence"], row["host_ns"], row["final"], row["fresh"] = self.ticks, now_ns, final, self._fresh
        row["skipped_ns"] = skipped_ns
        for column, rows in enumerate(batches.values()):
            row["consumed"][0, column] = len(rows)
            if len(rows):
                row["first_sequence"][0, column] = rows["sequence"][0]
                row["last_sequence"][0, column] = rows["sequence"][-1]
        self.ticks += 1
        self._fresh = False
        return Batch("tick", row)


def _build(vehicle: config.Vehicle) -> tuple[Estimator, UnwrittenParts]:
    estimator = Estimator(vehicle)
    return estimator, UnwrittenParts(estimator)


class DurableEstimation:
    """The estimation worker of a process that may die: takes over from one that did, and leaves checkpoints.

    Args:
        vehicle: what flies.
        directory: the flight's rings.
        now_ns: time of the call.
        built: an estimator that has not made a step, and its places, where they have been made before.
        cpu_ns: CPU time of this process.
    """

    def __init__(
        self,
        vehicle: config.Vehicle,
        directory: Path,
        now_ns: int,
        built: tuple[Estimator, UnwrittenParts] | None = None,
        cpu_ns: Callable[[], int] = lambda: 0,
    ) -> None:
        self._cpu_ns, self._saved_cpu_ns, self._cost_ns = cpu_ns, cpu_ns(), 0
        estimator, places = built or _build(vehicle)
        self._directory, self._checkpoints = directory, Checkpoints(directory, places)
        self._rings = create_rings(directory, estimator)
        self._publisher = Publisher(self._rings, SUFFIX)
        self._inputs = rings.readers(directory, estimator.inputs)
        ticks = self._rings["tick"].newest()
        self._worker = EstimationWorker(estimator, self._inputs, self._publisher)
        restored, self._saved_ns = False, now_ns
        if len(ticks):
            self._worker, restored = self._take_over(vehicle, ticks, now_ns)
        if not restored:
            self._save(now_ns)

    def step(self, now_ns: int) -> None:
        """See :meth:`EstimationWorker.step`."""
        self._worker.step(now_ns)
        if now_ns - self._saved_ns >= CHECKPOINT_NS or self._costly():
            self._save(now_ns)

    def _costly(self) -> bool:
        """Whether the steps since the last checkpoint have cost so much that it is time for another."""
        return self._cpu_ns() - self._saved_cpu_ns > max(CHECKPOINT_CPU_NS, self._cost_ns / CHECKPOINT_SHARE)

    def finish(self, now_ns: int, over: Callable[[], bool] = lambda: False) -> None:
        """See :meth:`EstimationWorker.finish`."""
        self._worker.finish(now_ns, over)

    def _save(self, now_ns: int) -> None:
        self._saved_ns = now_ns
        events = self._rings["event" + SUFFIX].published
        positions = {name: reader.position for name, reader in self._inputs.items()}
        self._put(now_ns, Checkpoint(self._worker.ticks, events, positions, self._worker.estimator))

    def _put(self, now_ns: int, checkpoint: Checkpoint) -> None:
        began_ns = self._cpu_ns()
        try:
            self._checkpoints.save(checkpoint)
        except (OSError, StateError) as error:
            text = f"no checkpoint of the estimator: {error}"
            self._publisher.publish([event(now_ns, Severity.WARNING, "no_checkpoint", "estimation", text)])
        self._saved_cpu_ns = self._cpu_ns()
        self._cost_ns = self._saved_cpu_ns - began_ns

    def _take_over(self, vehicle: config.Vehicle, ticks: Rows, now_ns: int) -> tuple[EstimationWorker, bool]:
        """A worker that goes on after the last of ``ticks``, and whether it has the state of the dead one."""
        done, reached_ns = int(ticks["sequence"][-1]) + 1, int(ticks["host_ns"][-1])
        checkpoint, why = None, "it left no checkpoint, or restoring it has killed another"
        try:
            checkpoint = self._checkpoints.load()
        except StateError as error:
            why = f"its checkpoint cannot be used ({error})"
        if checkpoint is not None:
            why = self._redo(checkpoint, ticks, now_ns)
        for column, (name, reader) in enumerate(self._inputs.items()):
            consumed = ticks[ticks["consumed"][:, column] > 0]
            if len(consumed):
                reader.seek_after(int(consumed["last_sequence"][-1, column]))
            elif checkpoint is not None:
                reader.position = checkpoint.positions[name]
        if checkpoint is not None and not why:
            self._checkpoints.taken_over()
            estimator = checkpoint.estimator
            return EstimationWorker(estimator, self._inputs, self._publisher, done, reached_ns=reached_ns), True
        estimator, places = _build(vehicle)
        self._checkpoints = Checkpoints(self._directory, places)
        estimator.go_on_from({name: self._rings[name].published for name in estimator.outputs})
        text = f"the estimator died; {why}: it restarts without data"
        self._publisher.publish([event(now_ns, Severity.ERROR, "estimator_anew", "estimation", text)])
        worker = EstimationWorker(estimator, self._inputs, self._publisher, done, fresh=True, reached_ns=reached_ns)
        return worker, False

    def _redo(self, checkpoint: Checkpoint, ticks: Rows, now_ns: int) -> str:
        """Do the steps after ``checkpoint`` again; why that cannot be done, empty where it was.

        Where they are costly it leaves checkpoints on the way, so that a process that is killed meanwhile has not
        worked in vain. They name the events and positions of the first one: lower bounds are enough.
        """
        if ticks["sequence"][0] > checkpoint.ticks:
            return f"steps from {checkpoint.ticks} to {ticks['sequence'][0]} are no longer in the rings"
        held = {name: ring.read()[0] for name, ring in self._inputs.items()}
        event_ring = self._rings["event" + SUFFIX]
        said = event_ring.newest()
        said = said[said["sequence"] >= checkpoint.events]
        for tick in ticks[ticks["sequence"] >= checkpoint.ticks]:
            batches = {}
            for column, (name, rows) in enumerate(held.items()):
                numbers = rows["sequence"]
                first, last = tick["first_sequence"][column], tick["last_sequence"][column]
                batches[name] = rows[(numbers >= first) & (numbers <= last)] if tick["consumed"][column] else rows[:0]
                if len(batches[name]) != tick["consumed"][column]:
                    return f"{name}: rows {first} to {last} of step {tick['sequence']} are not in the rings"
            again = checkpoint.estimator.process(
                int(tick["host_ns"]), batches, 0 if tick["final"] else None, int(tick["skipped_ns"])
            )
            self._publisher.publish(self._unsaid(batch, said) for batch in again)
            if self._costly():
                self._put(now_ns, checkpoint._replace(ticks=int(tick["sequence"]) + 1))
        return ""

    def _unsaid(self, batch: Batch, said: Rows) -> Batch:
        """Rows of ``batch`` that did not reach their ring before the process died; ``said``: the events that did."""
        if batch.channel in self._worker.estimator.outputs:
            # every row of these channels is in the ring, so its number is its place
            known = self._rings[batch.channel].published - int(batch.rows["sequence"][0])
            return batch._replace(rows=batch.rows[max(0, known) :])
        same = [(said[field] == batch.rows[field]) for field in ("host_ns", "code", "source", "text")]
        return batch._replace(rows=batch.rows[: 0 if np.all(same, axis=0).any() else None])
