"""Acquisition worker: pumps every device and publishes its rows to rings, without waiting for other workers.

A device that cannot be started is reported and left out; the others continue.
"""

from collections.abc import Callable, Mapping, Sequence

from drivers.device import Coalesces, Device, Rests
from drivers.errors import DriverError
from drivers.records import Batch, Severity, event
from onboard.flight.acquire.arming import Arming
from onboard.flight.acquire.publisher import ExpectedChannel, Publisher, joined


class Acquisition:
    """Steps a set of devices. The simulated runner calls :meth:`step`; in the real one each bus has a thread.

    Args:
        devices: what is pumped.
        publisher: takes their batches.
        arming: arms their drives; without it nothing is driven.
        undisturbed: nothing fails on their buses, so that a device that rests need not be pumped to find that out.
    """

    def __init__(
        self,
        devices: Sequence[Device],
        publisher: Publisher,
        arming: Arming | None = None,
        *,
        undisturbed: bool = False,
    ) -> None:
        self._publisher, self._arming = publisher, arming
        self.devices = list(devices)
        self._due_ns = dict.fromkeys((device.name for device in devices), 0)
        self._later = {each.name: later for each in devices if (later := _later(each, undisturbed)) is not None}
        self._held: list[Batch] = []  # of steps that did not hand over

    def start(self, now_ns: int) -> None:
        """Set every device up; those that fail are dropped, with an event that says why."""
        self.devices = [device for device in self.devices if self.start_device(device, now_ns)]

    def start_device(self, device: Device, now_ns: int) -> bool:
        """Set one device up; returns whether it may be pumped."""
        try:
            self._publisher.publish(device.start(now_ns))
        except (DriverError, OSError) as error:
            self._publisher.publish([event(now_ns, Severity.ERROR, "device_failed", device.name, str(error))])
            return False
        if self._arming is not None:
            self._publisher.publish(self._arming.started(device, now_ns))
        return True

    def pump(self, device: Device, now_ns: int, timeout_s: float) -> None:
        """Pump one device and publish its batches."""
        self._publisher.publish(self._pumped(device, now_ns, timeout_s))

    def _pumped(self, device: Device, now_ns: int, timeout_s: float) -> list[Batch]:
        batches = device.pump(now_ns, timeout_s)
        if self._arming is not None:
            self._arming.see(batches)
            batches += self._arming.hear(device, now_ns)
        return batches

    def step(self, now_ns: int, *, hand_over: bool = True, handed_over_at: Callable[[int], int] = int) -> None:
        """Pump every device that is due, without waiting.

        Args:
            now_ns: CLOCK_MONOTONIC.
            hand_over: publish what was found; else it waits for a step that does.
            handed_over_at: when rows found at a time are handed over; of the polls before it a device that rests, or
                coalesces, needs the last one only.
        """
        for device in self.devices:
            name = device.name
            if now_ns < self._due_ns[name]:
                continue
            self._held += self._pumped(device, now_ns, 0.0)
            period_ns = device.period_ns
            due_ns = now_ns + (period_ns or 1)
            if name in self._later:
                later_ns = min(self._later[name](now_ns), handed_over_at(due_ns))
                due_ns = max(due_ns, later_ns - (later_ns - now_ns) % (period_ns or 1))
            self._due_ns[name] = due_ns
        if hand_over:
            self._hand_over()

    def idle_until(self) -> int:
        """Before when no step pumps a device, CLOCK_MONOTONIC."""
        return min((self._due_ns[device.name] for device in self.devices), default=0)

    def _hand_over(self) -> None:
        if self._held:
            held, self._held = self._held, []
            self._publisher.publish(joined(held))

    def stop_device(self, device: Device, now_ns: int) -> None:
        """Stop one device and publish its last batches."""
        try:
            self._publisher.publish(device.stop(now_ns))
        except (DriverError, OSError) as error:
            self._publisher.publish([event(now_ns, Severity.ERROR, "stop_failed", device.name, str(error))])

    def stop(self, now_ns: int) -> None:
        """Stop every device."""
        self._hand_over()
        for device in self.devices:
            self.stop_device(device, now_ns)
        self.finish(now_ns)

    def expect(self, channels: Mapping[str, ExpectedChannel], since_ns: int) -> None:
        """Record what ``channels`` miss from ``since_ns`` to their first row as gaps."""
        self._publisher.expect(channels, since_ns)

    def finish(self, now_ns: int) -> None:
        """Last call, when every device was stopped: what was expected and never came is a gap."""
        self._publisher.finish(now_ns)

    def report(self, batches: list[Batch]) -> None:
        """Publish batches of the app itself."""
        self._publisher.publish(batches)


def _later(device: Device, undisturbed: bool) -> Callable[[int], int] | None:
    """When a device that was pumped at a time needs the next pump at the latest; None: when it is due."""
    if undisturbed and isinstance(device, Rests):
        return device.rests_until
    return (lambda now_ns: now_ns + device.coalesces_ns) if isinstance(device, Coalesces) else None
