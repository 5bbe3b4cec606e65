"""From vehicle.toml to open buses with drivers on them. A bus that cannot be opened is reported; the others fly.

A serial port comes and goes with its adapter, so its device opens it, and reports when it cannot.
"""

from typing import NamedTuple

from drivers.device import Device
from drivers.errors import DriverError
from drivers.records import Batch, Severity, event
from onboard import config
from onboard.devices.base import Clock, Closable, OpeningBus


class OpenDevices(NamedTuple):
    """Devices by bus, the ports under them by bus, and what could not be opened."""

    by_bus: dict[str, list[Device]]
    ports: dict[str, list[Closable]]
    problems: list[Batch]

    @property
    def devices(self) -> list[Device]:
        """All of them."""
        return [device for devices in self.by_bus.values() for device in devices]

    def close_bus(self, bus: str) -> None:
        """Close a bus's ports, right after its devices were stopped: later frames are discarded."""
        for port in self.ports.pop(bus, []):
            port.close()

    def close(self) -> None:
        """Close what is open yet."""
        for bus in list(self.ports):
            self.close_bus(bus)


def open_devices(vehicle: config.Vehicle, clock: Clock) -> OpenDevices:
    """Open every bus that has devices, and make their drivers. ``clock`` is CLOCK_MONOTONIC, ns."""
    opened = OpenDevices({}, {}, [])
    for name in vehicle.buses:
        if vehicle.devices_on(name):
            opened.problems.extend(open_bus(vehicle, name, clock, opened))
    return opened


def open_bus(vehicle: config.Vehicle, name: str, clock: Clock, opened: OpenDevices) -> list[Batch]:
    """Open one bus and put its devices and ports into ``opened``; an event that says why if it cannot be opened."""
    bus = OpeningBus(name, vehicle.devices_on(name), vehicle, clock, [])
    try:
        devices = next(iter(bus.devices.values())).open_on(bus)
    except (DriverError, config.ConfigError, OSError) as error:
        for port in bus.ports:
            port.close()
        text = f"{bus.url}: {error}; without {', '.join(bus.devices)}"
        return [event(clock(), Severity.ERROR, "bus_failed", name, text)]
    opened.ports[name], opened.by_bus[name] = bus.ports, devices
    return []
