"""What the player of a CAN bus plays, checked."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.canopen_pdo.play.drive_axis import CYCLIC, AxisConfig
from drivers.errors import ConfigurationError


@dataclass(frozen=True)
class PlayerConfig:
    """What is played, and how.

    Attributes:
        axes: The drives, in the order of the columns.
        ticks: SYNCs from the start of the motion to each row, rising, (n,).
        counts: Target of each drive, (n, axes).
        mode: ``drive_axis.CYCLIC``, with a row for each SYNC, or ``PROFILE``, whose rows are way points.
        heartbeat_ms: How long the drives do without our heartbeat.
        sync_limit_ms: Longest time without SYNC, or without an answer of a drive.
        master: Our node number, of the heartbeat.
        name: Of the motion, for messages.
        segments: Further motions by name, a row for each SYNC, from the motion's last row and back to it.
    """

    axes: tuple[AxisConfig, ...]
    ticks: NDArray[np.int64]
    counts: NDArray[np.int64]
    mode: int = CYCLIC
    heartbeat_ms: int = 100
    sync_limit_ms: float = 25.0
    master: int = 127
    name: str = "motion"
    segments: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not 1 <= self.master <= 127 or any(axis.drive.node == self.master for axis in self.axes):
            raise ConfigurationError(f"master node {self.master}: a number of 1..127 that no drive has")
        if self.counts.shape != (len(self.ticks), len(self.axes)) or len(self.ticks) < 2 or not self.axes:
            raise ConfigurationError(f"{self.name}: {self.counts.shape} targets for {len(self.axes)} drives: two rows")
        for name, counts in self.segments.items():
            if self.mode != CYCLIC or counts.ndim != 2 or np.abs(counts[[0, -1]] - self.counts[-1]).max() > 1:
                raise ConfigurationError(
                    f"{name}: segments are cyclic, from where {self.name} ends and back: correct it"
                )
        columns = np.concatenate([self.counts, *self.segments.values()]).T
        for axis, column in zip(self.axes, columns, strict=True):
            if column.min() < axis.low or column.max() > axis.high:
                raise ConfigurationError(f"{self.name}: {axis.drive.name} would leave its limits: correct the motion")
