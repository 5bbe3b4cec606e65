"""Base of devices that stream frames of several numbers, unasked: a SCALAR channel a number, numbered in step."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from drivers.errors import ConfigurationError
from drivers.records import SCALAR, Rows
from drivers.serial_line.device import Channels, Clock, OpenPort, SerialDevice

COMPONENTS = (
    "force along x",
    "force along y",
    "force along z",
    "moment about x",
    "moment about y",
    "moment about z",
)  # of a wrench


class StreamedNumber(Protocol):
    """What a channel says of itself."""

    @property
    def channel(self) -> str:
        """Its name."""

    @property
    def unit(self) -> str:
        """SI."""


@dataclass(frozen=True)
class StreamConfig:
    """How a stream is read.

    Attributes:
        rate_hz: Frames a second.
        poll_period_ms: How often the port is read; 0: the port waits.
        silence_ms: Time without a frame after which the port is reopened, and the instrument set up anew.
    """

    rate_hz: float
    poll_period_ms: float = 2.0
    silence_ms: float = 1000.0


class WrenchChannel(NamedTuple):
    """A channel of SCALAR rows: which component, 0 to 2 force along x, y, z, 3 to 5 moment about them, or another."""

    channel: str
    component: int
    unit: str


Channel_t = TypeVar("Channel_t", bound=StreamedNumber)


class ScalarStream(SerialDevice, Generic[Channel_t]):
    """Numbers of one sensor as SCALAR rows; all of a frame have its number.

    Args:
        name: Source of its events.
        channels: At least one, with different names.
        open_port: Opens its port.
        clock: CLOCK_MONOTONIC, ns.
        config: How it is read.

    Raises:
        ConfigurationError: No channel, or two with the same name.
    """

    def __init__(
        self, name: str, channels: Sequence[Channel_t], open_port: OpenPort, clock: Clock, config: StreamConfig
    ) -> None:
        super().__init__(name, open_port, clock, config.poll_period_ms, config.silence_ms)
        self._channels = {one.channel: one for one in channels}
        if not channels or len(self._channels) < len(channels):
            raise ConfigurationError(
                f"{name}: channels {[each.channel for each in channels]}: give them different names"
            )
        self._frame_ns = 1e9 / config.rate_hz
        self._next = 0  # number of the next row, if none is lost before it
        self._was_down = False  # the port was closed since the last frame
        self._status = 0  # of the sensor

    @property
    def channels(self) -> Channels:
        """See ``SerialDevice``."""
        return dict.fromkeys(self._channels, SCALAR)

    def _closed(self, now_ns: int) -> None:
        self._was_down = True

    def _rows(self, one: Channel_t, host_ns: int, numbers: ArrayLike, ticks: ArrayLike) -> Rows:
        """Rows of a channel, without values: (n,)."""
        rows = np.zeros(np.size(numbers), SCALAR)
        rows["sequence"], rows["tick"], rows["host_ns"] = numbers, ticks, host_ns
        rows["unit"] = one.unit.encode()
        return rows

    def _lose(self, host_ns: int, lost: int, cause: str = "", *, counted: bool = False) -> None:
        """So many frames are missing before the next one."""
        if lost <= 0:
            return
        cause = cause or ("port_lost" if self._was_down else "frames_lost")
        for channel in self._channels:
            last, duration_ns = self._next + lost - 1, round(lost * self._frame_ns)
            self._report.gap(host_ns, channel, self._next, last, duration_ns, cause, counted=counted)
        self._next += lost

    def _lose_at_end(self, now_ns: int, last_ns: int) -> None:
        """At a stop: what is missing since the last frame, which came at ``last_ns``."""
        silent_ns = now_ns - last_ns
        if self._was_down or self._misses_its_end(silent_ns, self._frame_ns):
            self._lose(now_ns, int(silent_ns / self._frame_ns))
