"""What devices with a network connection of their own have in common: one twin for all tables, start-up, counting."""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Generic, Self, TypeVar

from hil_sim.devices.powered import Latency, PoweredTwin
from hil_sim.faults import CLOCK_KINDS, INPUT_KINDS, NO_FAULTS, DeviceFaults, FaultKind, FaultyClock
from hil_sim.sensing.analog import ChipClock

Place = TypeVar("Place")


class NetworkedTwin(PoweredTwin, Generic[Place]):
    """A ``NetworkDevice`` that sends samples, each by the timer ``sample``, which :meth:`_send` transmits.

    Args:
        inputs: What it measures, by place.
        clock: Its oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        latency_ns: From a sample to its sending.
        jitter_ns: Mean of an exponential time more.
        seed: Of the jitter.
        faults: What breaks.

    Raises:
        FaultError: a fault that it cannot have.
    """

    boot_ns: ClassVar[int]  # from the return of its supply
    draws: ClassVar[int]  # beside the seed
    fault_kinds: ClassVar[tuple[FaultKind, ...]] = ()  # beside those of all

    def __init__(
        self,
        inputs: Mapping[Place, Any],
        clock: ChipClock,
        start_ns: int,
        *,
        latency_ns: int = 400_000,
        jitter_ns: int = 50_000,
        seed: int = 0,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        own = (FaultKind.OFF, FaultKind.RESET, FaultKind.GARBAGE, *self.fault_kinds)
        faults.require(*own, *INPUT_KINDS, *CLOCK_KINDS)
        self._latency_ns = latency_ns
        self._latency = Latency(latency_ns, jitter_ns, seed, self.draws)
        self.listens = True
        self.leader = self
        self._inputs = dict(inputs)
        self._clock = FaultyClock(clock, faults)
        self._transmit: Callable[[bytes, int], None] = lambda data, ready_ns: None
        self._powered_chip_ns = 0
        self._sent = deque[tuple[bytes, int]]()  # samples under way, and their numbers since power-up
        self._counted: int | None = None  # number of the last one that was delivered
        self._samples = 0
        super().__init__(start_ns, faults)

    @property
    def produced(self) -> int:
        """Samples that it had to say from the first delivered to the last; those that were not, included."""
        return self.leader._samples

    def join(self, other: Self) -> None:
        """Take over the inputs and faults of another table of the same device."""
        other.leader = self
        self._inputs |= other._inputs
        self._take_over(other)

    def plug_in(self, transmit: Callable[[bytes, int], None]) -> None:
        """See ``NetworkDevice``."""
        self._transmit = transmit

    def connected(self) -> None:
        """See ``NetworkDevice``: nothing goes to the client before."""
        self._sent.clear()
        self._stop("sample")

    def delivered(self, data: bytes) -> None:
        """See ``NetworkDevice``."""
        if not any(sent is data for sent, _ in self._sent):
            return  # it is no sample
        sent, number = self._sent.popleft()
        while sent is not data:  # it was lost
            sent, number = self._sent.popleft()
        self._samples += 1 if self._counted is None else number - self._counted
        self._counted = number

    def _send(self, data: bytes, number: int, ready_ns: int) -> None:
        self._sent.append((data, number))
        self._transmit(data, ready_ns)

    def _active(self, kind: FaultKind, now_ns: int) -> bool:
        return self._faults.active(kind, now_ns) is not None

    # For PoweredTwin

    def _gain_power(self, now_ns: int) -> None:
        self._powered_chip_ns = self._clock.chip_ns(now_ns)
        self._counted = None
        self._at("boot", now_ns + (self.boot_ns if now_ns > self._start_ns else 0), self._booted)

    def _lose_power(self, now_ns: int) -> None:
        self.listens = False
        self.connected()
        super()._lose_power(now_ns)

    def _booted(self, now_ns: int) -> None:
        self.listens = True
