"""From vehicle.toml to open buses with drivers on them. A bus that cannot be opened is reported; the others fly."""

from collections.abc import Callable
from typing import NamedTuple, Protocol

from drivers import transports
from drivers.canopen_pdo.bus import CanopenBus
from drivers.canopen_pdo.cia404 import Cia404Config
from drivers.canopen_pdo.cia406 import Cia406Config
from drivers.canopen_pdo.mapped_object import CanopenObjectConfig
from drivers.canopen_pdo.sync import SyncConfig
from drivers.device import Device
from drivers.errors import DriverError
from drivers.mpu6050.device import Mpu6050
from drivers.mpu6050.registers import Mpu6050Config
from drivers.records import Batch, Severity, event
from drivers.sync_pulse.device import SyncPulse
from onboard import config

Clock = Callable[[], int]
CanNode = Cia406Config | Cia404Config | CanopenObjectConfig


class Port(Protocol):
    """What every port has."""

    def close(self) -> None:
        """Give the bus back."""


class OpenDevices(NamedTuple):
    """Devices by bus, the ports under them, and what could not be opened."""

    by_bus: dict[str, list[Device]]
    ports: list[Port]
    problems: list[Batch]

    @property
    def devices(self) -> list[Device]:
        """All of them."""
        return [device for devices in self.by_bus.values() for device in devices]

    def close(self) -> None:
        """Close the ports, after the devices were stopped."""
        for port in self.ports:
            port.close()


def open_devices(vehicle: config.Vehicle, clock: Clock) -> OpenDevices:
    """Open every bus that has devices, and make their drivers. ``clock`` is CLOCK_MONOTONIC, ns."""
    opened = OpenDevices({}, [], [])
    for bus, section in vehicle.file.bus.items():
        on_bus = vehicle.devices_on(bus)
        if not on_bus:
            continue
        try:
            devices, port = _open(on_bus, section.url, bus, clock)
        except (DriverError, OSError) as error:
            names = ", ".join(on_bus)
            text = f"{section.url}: {error}; without {names}"
            opened.problems.append(event(clock(), Severity.ERROR, "bus_failed", bus, text))
            continue
        opened.by_bus[bus] = devices
        opened.ports.append(port)
    return opened


def _open(on_bus: dict[str, config.BusDevice], url: str, bus: str, clock: Clock) -> tuple[list[Device], Port]:
    kinds = list(on_bus.values())
    if all(isinstance(device, config.Mpu6050Device) for device in kinds):
        i2c = transports.open_i2c(url, clock)
        imus = {name: device for name, device in on_bus.items() if isinstance(device, config.Mpu6050Device)}
        return [Mpu6050(name, i2c, _mpu6050(device)) for name, device in imus.items()], i2c
    if all(isinstance(device, config.SyncPulseDevice) for device in kinds):
        line = transports.open_pulse(url, clock)
        return [SyncPulse(name, line) for name in on_bus], line
    can = transports.open_can(url, clock)
    sync = next((n, d) for n, d in on_bus.items() if isinstance(d, config.CanopenSyncDevice))
    nodes = [node for name, device in on_bus.items() if (node := _can_node(name, device)) is not None]
    return [CanopenBus(can, nodes, SyncConfig(sync[0], sync[1].period_ms), name=bus)], can


def _mpu6050(device: config.Mpu6050Device) -> Mpu6050Config:
    return Mpu6050Config(
        address=device.address,
        sample_rate_hz=device.sample_rate_hz,
        accel_range_g=device.accel_range_g,
        gyro_range_deg_s=device.gyro_range_deg_s,
        filter_code=device.filter_code,
        poll_period_ms=device.poll_period_ms,
    )


def _can_node(name: str, device: config.BusDevice) -> CanNode | None:
    match device:
        case config.Cia406Device():
            return Cia406Config(name, device.node, device.counts_per_revolution)
        case config.Cia404Device():
            return Cia404Config(name, device.node, device.capacity_N)
        case config.CanopenObjectDevice():
            return CanopenObjectConfig(
                name,
                device.node,
                tpdo=device.tpdo,
                byte_offset=device.byte_offset,
                format=device.format,
                index=device.index,
                subindex=device.subindex,
                unit=device.unit,
                scale=device.scale,
            )
        case _:
            return None
