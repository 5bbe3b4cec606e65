"""Clock specifications of channels, given by a device's module and used by the timebase."""

from typing import NamedTuple

from drivers.sync_pulse.code import SHORTEST_INTERVAL


class SampledChannel(NamedTuple):
    """A channel with a sample clock of its own that flags sync pulses (an IMU)."""

    period_ns: float


class MarkedChannel(NamedTuple):
    """A channel with a clock of its own that stamps sync pulses, in channel ``marks``.

    ``latches_counts``: its ticks are coarse, and the count latched on the edge refines them.
    """

    period_ns: float
    marks: str
    latches_counts: bool = False


class FreeChannel(NamedTuple):
    """A channel with a timer of its own and no marks; ``delay_ns``: from sample to arrival, waiting for a poll too.

    ``tolerance``: largest relative error of ``period_ns``.
    """

    period_ns: float
    delay_ns: float = 0.0
    delay_sigma_ns: float = 0.0
    tolerance: float = 0.06


class PolledChannel(NamedTuple):
    """A polled channel: ``tick`` is the time of the request, ``host_ns`` of the answer; their times on the wire."""

    question_ns: float = 0.0
    answer_ns: float = 0.0


class ProducerChannel(NamedTuple):
    """SYNC messages; each pulse of the line rises in the period of one."""

    period_ns: float
    delay_ns: float  # a SYNC frame on the wire: nodes sample at its end


class FollowerChannel(NamedTuple):
    """A channel whose ticks are those of channel ``sync``: the SYNCs of its bus, another channel of its device."""

    sync: str


class RecordedChannel(NamedTuple):
    """A channel of an imported recording: its host stamps are its times."""

    sigma_ns: float


ChannelClock = (
    SampledChannel | MarkedChannel | FreeChannel | PolledChannel | ProducerChannel | FollowerChannel | RecordedChannel
)


class SyncLine(NamedTuple):
    """The channel of the line's edges.

    ``coded``: with the published code, ``period_ns`` is that of SYNC; else of the pulses. ``late_ns``: typical largest
        latency of the kernel's stamp.
    """

    channel: str
    period_ns: float = 5e6
    coded: bool = True
    late_ns: int = 25_000

    @property
    def shortest_interval_ns(self) -> float:
        """Between two pulses."""
        return self.period_ns * (SHORTEST_INTERVAL - 1 if self.coded else 1)
