"""The servos of a line that are driven: rounds as ticks of their player, their transfers in turn, their Sync Writes."""

from collections.abc import Iterator

from drivers.dynamixel.drive import DynamixelAxis, DynamixelAxisConfig, RequestRounds
from drivers.dynamixel.packet import Block, sync_write_request
from drivers.dynamixel.registers import DrivenState, DynamixelTiming
from drivers.errors import ConfigurationError
from drivers.play.player import Player, PlayerConfig
from drivers.reporter import Reporter


class DrivenLine:
    """The servos of a line that are driven, between the line and their player.

    Args:
        play: What is played.
        timing: How the servos are asked.
        report: Where events and rows go.

    Attributes:
        player: Their master.

    Raises:
        ConfigurationError: The line has no period, or waits too long for an answer.
    """

    def __init__(self, play: PlayerConfig[DynamixelAxisConfig], timing: DynamixelTiming, report: Reporter) -> None:
        if not timing.sample_period_ms:
            raise ConfigurationError("servos that are driven have goals at even times: give sample_period_ms")
        if timing.timeout_ms > 0.5 * play.sync_limit_ms:
            half = f"half of [drive] sync_limit_ms = {play.sync_limit_ms:g}, or less"
            raise ConfigurationError(f"timeout_ms = {timing.timeout_ms:g}: give {half}: a stop may wait so long")
        self._rounds = RequestRounds(round(1e6 * timing.sample_period_ms), round(1e6 * play.sync_limit_ms))
        own = self._rounds, play.heartbeat_ms, play.is_profile, report
        self._axes = {axis.drive.id: DynamixelAxis(axis, *own) for axis in play.axes}
        self.player = Player(play, list(self._axes.values()), self._rounds, report)
        self._turn = 0  # whose transfer is next

    def transfer(self) -> tuple[int, int, int, bytes] | None:
        """ID, address, bytes to be read, bytes to be written: what a servo is to be asked now, each in turn."""
        for _ in self._axes:
            self._turn = (self._turn + 1) % len(self._axes)
            identifier, axis = list(self._axes.items())[self._turn]
            if axis.transfer is not None:
                axis.asked(axis.transfer)
                return identifier, *axis.transfer
        return None

    def packets(self) -> Iterator[bytes]:
        """Sync Writes that are due: servos that are to have as many bytes at one address share one."""
        blocks: dict[tuple[int, int], dict[int, bytes]] = {}
        for identifier, axis in self._axes.items():
            if (pending := axis.take_pending()) is not None:
                address, data = pending
                blocks.setdefault((address, len(data)), {})[identifier] = data
        for (address, _), by_id in blocks.items():
            yield sync_write_request(address, by_id)

    def forget(self) -> None:
        """Nothing can be sent now: what was due is not sent later."""
        for axis in self._axes.values():
            axis.forget()

    def round(self, asked_ns: int, host_ns: int) -> None:
        """Some servo has answered a round."""
        self._rounds.answered(asked_ns, host_ns)

    def on_block(self, identifier: int, host_ns: int, error: int, said: DrivenState) -> None:
        """What a servo answered in a round."""
        if identifier in self._axes:
            self._axes[identifier].on_round(host_ns, error, said)

    def found(self, identifier: int) -> None:
        """A servo has said who it is."""
        if identifier in self._axes:
            self._axes[identifier].found()

    def answered(self, block: Block) -> None:
        """The answer to a servo's transfer."""
        self._axes[block.identifier].answered(block)

    def lost(self, identifier: int) -> None:
        """A servo is silent."""
        if identifier in self._axes:
            self._axes[identifier].lost()

    def on_torque(self, identifier: int, is_on: bool) -> None:
        """A servo's Torque Enable."""
        if identifier in self._axes:
            self._axes[identifier].on_torque(is_on)
