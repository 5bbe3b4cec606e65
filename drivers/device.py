"""What a runner needs to know of a device: its name, when to call it, and that it never raises for a bus fault."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from drivers.records import Batch


class Device(Protocol):
    """A device (or a bus full of them) that turns what its port says into records.

    ``start``, ``pump`` and ``stop`` never raise for what a bus or a device does: a fault is an ``event`` batch, lost
    samples are a ``gap`` batch, and the device goes on trying. Time is an argument: ``now_ns`` is CLOCK_MONOTONIC of
    the call, and it only decides deadlines; rows carry the stamps of their port.
    """

    @property
    def name(self) -> str:
        """The name under which it reports events."""

    @property
    def period_ns(self) -> int:
        """Time between two pumps; 0: as soon as it returns, for it waits on its port up to ``timeout_s``.

        To be asked before every pump: a device whose port fails cannot wait on it and asks for a pause here.
        """

    def start(self, now_ns: int) -> list[Batch]:
        """Begin setting the device up. Setting up goes on in ``pump``."""

    def pump(self, now_ns: int, timeout_s: float = 0.0) -> list[Batch]:
        """Take what the device has to give. Waits up to ``timeout_s`` where the port can wait."""

    def stop(self, now_ns: int) -> list[Batch]:
        """Silence the device and take what is left, so that what it made is recorded or named as a gap."""


class SelfTestResult(Protocol):
    """How a device's own test came out."""

    @property
    def worst(self) -> float:
        """Largest deviation from what the factory measured, relative."""


@runtime_checkable
class SelfTesting(Protocol):
    """A device that can test itself before it is started, at rest."""

    @property
    def name(self) -> str:
        """As of :class:`Device`."""

    def self_test(self, wait: Callable[[float], object]) -> SelfTestResult:
        """Test it; ``wait`` lets that many seconds pass.

        Raises:
            ConfigurationError: this one cannot be tested.
            DriverError: it failed, or could not be reached.
        """
