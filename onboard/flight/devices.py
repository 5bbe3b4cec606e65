"""From vehicle.toml to open buses with drivers on them. A bus that cannot be opened is reported; the others fly.

A serial port comes and goes with its adapter, so its device opens it, and reports when it cannot.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol, TypeVar

from drivers import transports
from drivers.canopen_pdo.bus import CanopenBus
from drivers.device import Device
from drivers.dsc_load_cell.device import DscLoadCell
from drivers.errors import DriverError
from drivers.modbus_load_cell.device import ModbusLoadCell
from drivers.mpu6050.device import Mpu6050
from drivers.nimu.device import Nimu
from drivers.node_frame.device import NodeFrame
from drivers.qsb.device import Qsb
from drivers.records import Batch, Severity, event
from drivers.sync_pulse.device import SyncPulse
from drivers.sync_pulse.generator import PulseGenerator
from drivers.transports.url import parse
from onboard import config
from onboard.config import BusType

Clock = Callable[[], int]


class Port(Protocol):
    """What every port has."""

    def close(self) -> None:
        """Give the bus back."""


class OpenDevices(NamedTuple):
    """Devices by bus, the ports under them by bus, and what could not be opened."""

    by_bus: dict[str, list[Device]]
    ports: dict[str, list[Port]]
    problems: list[Batch]

    @property
    def devices(self) -> list[Device]:
        """All of them."""
        return [device for devices in self.by_bus.values() for device in devices]

    def close_bus(self, bus: str) -> None:
        """Close a bus's ports, right after its devices were stopped: what comes then is for nobody."""
        for port in self.ports.pop(bus, []):
            port.close()

    def close(self) -> None:
        """Close what is open yet."""
        for bus in list(self.ports):
            self.close_bus(bus)


P = TypeVar("P", bound=Port)


class _Bus(NamedTuple):
    """A bus to be opened: what is on it, and who takes its ports."""

    vehicle: config.Vehicle
    name: str
    clock: Clock
    ports: list[Port]

    @property
    def url(self) -> str:
        return self.vehicle.file.bus[self.name].url

    @property
    def devices(self) -> dict[str, Any]:
        """By name; config.BusDevice of the kinds that ``OPEN`` sends here."""
        return self.vehicle.devices_on(self.name)

    def own(self, port: P) -> P:
        self.ports.append(port)
        return port


def open_devices(vehicle: config.Vehicle, clock: Clock) -> OpenDevices:
    """Open every bus that has devices, and make their drivers. ``clock`` is CLOCK_MONOTONIC, ns."""
    opened = OpenDevices({}, {}, [])
    for name in vehicle.file.bus:
        bus = _Bus(vehicle, name, clock, [])
        if not bus.devices:
            continue
        try:
            opened.by_bus[name] = OPEN[next(iter(bus.devices.values())).bus_type](bus)
        except (DriverError, OSError) as error:
            for port in bus.ports:
                port.close()
            text = f"{bus.url}: {error}; without {', '.join(bus.devices)}"
            opened.problems.append(event(clock(), Severity.ERROR, "bus_failed", name, text))
            continue
        opened.ports[name] = bus.ports
    return opened


def _open_i2c(bus: _Bus) -> list[Device]:
    port = bus.own(transports.open_i2c(bus.url, bus.clock))
    return [Mpu6050(name, port, device.settings(name)) for name, device in bus.devices.items()]


def _open_can(bus: _Bus) -> list[Device]:
    port = bus.own(transports.open_can(bus.url, bus.clock))
    sync_name, sync = bus.vehicle.sync_on(bus.name)
    nodes = {name: device for name, device in bus.devices.items() if isinstance(device, config.CanopenNode)}
    guards = {device.node: device.guard for device in nodes.values() if device.guard is not None}
    settings = [device.settings(name) for name, device in nodes.items()]
    return [CanopenBus(port, settings, sync.settings(sync_name), bus.name, list(guards.values()))]


def _open_serial(bus: _Bus) -> list[Device]:
    baud = parse(bus.url, transports.SERIAL_URLS).integer("baud")
    (name, device), *_ = bus.devices.items()
    settings = device.at_baud(name, baud) if device.kind == "modbus_load_cell" else device.settings(name)
    return [SERIAL[device.kind](name, partial(transports.open_serial, bus.url), bus.clock, settings)]


def _open_pulse(bus: _Bus) -> list[Device]:
    port = bus.own(transports.open_pulse(bus.url, bus.clock))
    return [SyncPulse(name, port) for name in bus.devices]


def _open_pulse_output(bus: _Bus) -> list[Device]:
    (name, device), *_ = bus.devices.items()
    line = bus.own(transports.open_pulse_output(bus.url, bus.clock))
    can = None
    if device.sync_bus is not None:
        can = bus.own(transports.open_can(bus.vehicle.file.bus[device.sync_bus].url, bus.clock))
    return [PulseGenerator(name, line, bus.clock, device.settings(name), can)]


SERIAL: dict[str, Callable[..., Device]] = {
    "nimu": Nimu,
    "qsb": Qsb,
    "modbus_load_cell": ModbusLoadCell,
    "dsc_load_cell": DscLoadCell,
    "node_frame": NodeFrame,
}
OPEN: dict[BusType, Callable[[_Bus], list[Device]]] = {
    BusType.I2C: _open_i2c,
    BusType.CAN: _open_can,
    BusType.SERIAL: _open_serial,
    BusType.PULSE: _open_pulse,
    BusType.PULSE_OUTPUT: _open_pulse_output,
}
