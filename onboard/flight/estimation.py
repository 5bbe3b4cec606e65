"""The estimation worker: rings in, rings out, and a TICK record of what each step consumed, so that replay is exact."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from drivers import records
from drivers.records import Batch, Rows, Severity, event
from onboard import channels, config
from onboard.flight import rings
from onboard.flight.estimator import Estimator
from onboard.flight.publisher import Publisher
from onboard.ring import RingReader

SUFFIX = "_estimation"


def estimation_channels(estimator: Estimator) -> dict[str, np.dtype[np.void]]:
    """Channels that the estimation worker writes."""
    return {
        **estimator.outputs,
        "tick": channels.tick_dtype(len(estimator.inputs)),
        "event" + SUFFIX: records.EVENT,
    }


class EstimationWorker:
    """Steps an :class:`Estimator` over rings."""

    def __init__(self, estimator: Estimator, inputs: Mapping[str, RingReader], publisher: Publisher) -> None:
        self._estimator, self._inputs, self._publisher = estimator, inputs, publisher
        self._ticks = 0

    @classmethod
    def over_rings(cls, vehicle: config.Vehicle, directory: Path) -> "EstimationWorker":
        """A worker of its own process: builds the estimator, writes the rings of its channels in ``directory``."""
        estimator = Estimator(vehicle)
        publisher = Publisher(rings.create(directory, vehicle, estimation_channels(estimator)), SUFFIX)
        return cls(estimator, rings.readers(directory, estimator.inputs), publisher)

    def step(self, now_ns: int) -> None:
        """Consume what the devices have said since the last step."""
        self._step(now_ns, None)

    def finish(self, now_ns: int) -> None:
        """The last step: nothing more will arrive, so rows are made up to the last sample."""
        self._step(now_ns, 0)

    def _step(self, now_ns: int, lag_ns: int | None) -> None:
        batches: dict[str, Rows] = {}
        said: list[Batch] = []
        for name in self._estimator.inputs:
            batches[name], lost = self._inputs[name].read()
            if lost:
                text = f"{lost} rows overran the ring before the estimator read them"
                said.append(event(now_ns, Severity.WARNING, "estimator_overrun", name, text))
        self._publisher.publish([self._tick(now_ns, batches, final=lag_ns is not None), *said])
        self._publisher.publish(self._estimator.process(now_ns, batches, lag_ns))

    def _tick(self, now_ns: int, batches: Mapping[str, Rows], *, final: bool) -> Batch:
        row = np.zeros(1, channels.tick_dtype(len(batches)))
        row["sequence"], row["host_ns"], row["final"] = self._ticks, now_ns, final
        for column, rows in enumerate(batches.values()):
            row["consumed"][0, column] = len(rows)
            if len(rows):
                row["first_sequence"][0, column] = rows["sequence"][0]
                row["last_sequence"][0, column] = rows["sequence"][-1]
        self._ticks += 1
        return Batch("tick", row)
