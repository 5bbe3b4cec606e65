"""Protocol between a runner and a device: name, pump period, ``start``/``pump``/``stop`` that return batches."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from drivers.records import Batch

COALESCED_NS = 50_000_000  # of what a port stamps itself, read at once


class Device(Protocol):
    """A device (or a bus of devices) that turns bytes from its port into records.

    ``start``, ``pump`` and ``stop`` do not raise on faults of a bus or a device: a fault is an ``event`` batch, lost
        samples are a ``gap`` batch, and the device retries. ``now_ns`` is CLOCK_MONOTONIC of the call and is used for
        deadlines only; rows carry the stamps of their port.
    """

    @property
    def name(self) -> str:
        """Source name of its events."""

    @property
    def period_ns(self) -> int:
        """Time between two pumps, ns; 0: call ``pump`` again at once, it waits on its port up to ``timeout_s``.

        Read it before every pump: it is non-zero while a port fails and cannot be waited on.
        """

    def start(self, now_ns: int) -> list[Batch]:
        """Begin the set-up, which continues in ``pump``."""

    def pump(self, now_ns: int, timeout_s: float = 0.0) -> list[Batch]:
        """Read the device and return its batches. Waits up to ``timeout_s`` if the port can wait."""

    def stop(self, now_ns: int) -> list[Batch]:
        """Stop the device and read the rest, so that every sample made is a row or part of a gap."""


@runtime_checkable
class Rests(Protocol):
    """A device that knows until when it will neither send a frame nor emit an event by itself."""

    @property
    def name(self) -> str:
        """As of :class:`Device`."""

    def rests_until(self, now_ns: int) -> int:
        """CLOCK_MONOTONIC until which a pump would only hand over the rows that it found; ``now_ns`` if it may do more.

        It holds as long as its bus carries what it is set up to carry, and nothing of it is lost.
        """


@runtime_checkable
class Coalesces(Protocol):
    """A device whose rows bear the stamps of its port, so that what comes within some time may be read at once."""

    @property
    def coalesces_ns(self) -> int:
        """Time whose rows are read at once by a pump that waits, and between two pumps that do not, ns; 0: none."""


@runtime_checkable
class Hurried(Protocol):
    """A device that holds one sample only, and loses it where the next one comes first."""

    @property
    def within_ns(self) -> int:
        """Longest time between two pumps that loses none, ns."""


class SelfTestResult(Protocol):
    """Result of a built-in self test."""

    @property
    def worst(self) -> float:
        """Largest relative deviation from the factory trim."""


@runtime_checkable
class SelfTesting(Protocol):
    """A device with a built-in self test, to be run at rest before the start."""

    @property
    def name(self) -> str:
        """As of :class:`Device`."""

    def self_test(self, wait: Callable[[float], object]) -> SelfTestResult:
        """Run the self test; ``wait`` sleeps for that many seconds.

        Raises:
            ConfigurationError: it cannot be tested.
            DriverError: the test failed, or the device did not answer.
        """
