"""Drives torques of a control law over the drives of a CAN bus (CiA 402 mode 10), and stops them all when it must.

Armed, it beats, enables the drives with torque zero where they stand, and then asks the law for torques once a SYNC, as
soon as every drive has answered it; they are in force from the next SYNC on. A SYNC that a drive does not answer in
time has no torques of its own: those of the last one stay. It watches on every pump what the player of positions
watches too (:meth:`Axis.unwell`), the state and mode of every drive and its rate. Whatever is wrong becomes a
quick stop of all drives, once; so does a law that says why it ends.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from drivers.canopen_pdo.play.drive_axis import CYCLIC, CYCLIC_TORQUE, PROFILE, Cia402AxisConfig, DriveAxis
from drivers.canopen_pdo.sync import SyncCounter
from drivers.errors import ConfigurationError
from drivers.play.master import DriveMaster, MasterState
from drivers.play.player import Player, PlayerConfig
from drivers.records import Severity
from drivers.reporter import Reporter

Law = Callable[[int, Sequence[int]], Sequence[int] | str]
"""Torques in thousandths of the rated ones, for the SYNC number and the counts at it; or why to stop."""


@dataclass(frozen=True)
class TorqueConfig:
    """What is driven, and by which law.

    Attributes:
        axes: The drives, in the order of the law's counts and torques.
        law: Asked once a SYNC.
        heartbeat_ms: How long the drives do without our heartbeat.
        sync_limit_ms: Longest time without SYNC, or without an answer of a drive.
    """

    axes: tuple[Cia402AxisConfig, ...]
    law: Law
    heartbeat_ms: int = 100
    sync_limit_ms: float = 25.0

    def __post_init__(self) -> None:
        if not self.axes:
            raise ConfigurationError("a law of torques without a drive: name a drive")


class TorqueMaster(DriveMaster[DriveAxis]):
    """The master of one CAN bus, in the player's place; arguments and attributes as :class:`DriveMaster` has."""

    SENDS: ClassVar = "torque"
    STOPPED_AS: ClassVar = Severity.WARNING  # a law says so at the end of its trials, too

    def __init__(self, config: TorqueConfig, axes: Sequence[DriveAxis], sync: SyncCounter, report: Reporter) -> None:
        super().__init__(config, axes, sync, report)
        self.config = config

    @property
    def is_running(self) -> bool:
        """Whether the law is asked for torques."""
        return self.state is MasterState.PLAYING

    @property
    def has_stopped(self) -> bool:
        """Whether it has ended for good."""
        return self.state is MasterState.STOPPED

    def _started(self) -> None:
        """The law is asked from the next SYNC on."""

    def _go_on(self) -> None:
        if self.state is MasterState.ENABLING:
            self._enable()
        else:
            self._ask()

    def _ask(self) -> None:
        tick = self._ticks.tick
        answered = all(axis.heard_ns >= self._ticks.host_ns for axis in self.axes)
        if tick is None or tick == self._sent_tick or not answered:
            return
        self._sent_tick = tick
        torques = self.config.law(tick, [axis.position or 0 for axis in self.axes])
        if isinstance(torques, str):
            self.stop(torques)
            return
        for axis, torque in zip(self.axes, torques, strict=True):
            axis.torque(torque)


Play = PlayerConfig[Cia402AxisConfig] | TorqueConfig


def master_of(
    play: Play, sync: SyncCounter, send: Callable[[int, bytes], None], report: Reporter
) -> DriveMaster[DriveAxis]:
    """The master of the drives of a CAN bus.

    Args:
        play: What its drives are driven by.
        sync: Numbers the SYNCs of this bus.
        send: Sends a frame (COB-ID, data); does not raise on bus faults.
        report: Where events and rows go.
    """
    mode = CYCLIC_TORQUE if isinstance(play, TorqueConfig) else PROFILE if play.is_profile else CYCLIC
    axes = [DriveAxis(axis, mode, sync, play.heartbeat_ms, send, report) for axis in play.axes]
    if isinstance(play, TorqueConfig):
        return TorqueMaster(play, axes, sync, report)
    return Player(play, axes, sync, report)
