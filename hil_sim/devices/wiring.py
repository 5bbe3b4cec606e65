"""Checks that the tables of a scenario refer to existing and matching sensors, clocks and buses."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

from hil_sim.devices.emulator import Emulator
from hil_sim.scenario.bus_tables import BusTable, SerialBusTable
from hil_sim.scenario.sensor_tables import ClockTable, SensorTable


def problems(
    buses: Mapping[str, BusTable],
    devices: Mapping[str, Emulator],
    sensors: Mapping[str, SensorTable],
    clocks: Mapping[str, ClockTable],
) -> Iterator[str]:
    """Yield each wiring error as a sentence with the remedy."""
    wanted = {clock for name, device in devices.items() for clock in device.clocks(name)}
    for clock in sorted(wanted - clocks.keys()):
        yield f"no [clock.{clock}] says how right that oscillator is; add it"
    for clock in sorted(clocks.keys() - wanted):
        yield f"clock.{clock} belongs to no device; the clocks here are: {_listed(wanted)}"
    for name, device in devices.items():
        for signal in device.signals(name).values():
            sensor = sensors.get(signal.sensor)
            if sensor is None:
                yield f"device.{name} measures {signal.sensor!r}; the sensors here are: {_listed(sensors)}"
            elif sensor.quantity not in signal.quantities:
                yield f"device.{name}: a {device.kind} does not measure {sensor.quantity}; name another sensor"
        if device.bus is not None:
            yield from _plugged(f"device.{name}.bus", device.bus, buses, device.needs)
            line = buses.get(device.bus)
            if isinstance(line, SerialBusTable) and device.baud_rates and line.baud_rate not in device.baud_rates:
                rates = ", ".join(map(str, device.baud_rates))
                yield f"bus.{device.bus}.baud_rate: a {device.kind} comes up with {rates}, not {line.baud_rate}"
        if device.drives is not None:
            yield from _plugged(f"device.{name}.line", device.drives, buses, "pulse")
    if sum(device.drives is not None for device in devices.values()) > 1:
        yield "there are several sync boxes; keep the first and remove the others"
    for (bus, place), count in Counter((device.bus, device.place) for device in devices.values()).items():
        if bus is not None and count > 1:
            yield f"bus {bus}: {count} devices are {place}; move either, or give it another"


def _plugged(key: str, bus: str, buses: Mapping[str, BusTable], kind: str) -> Iterator[str]:
    if bus not in buses:
        yield f"{key}: no bus {bus!r}; there are: {_listed(buses)}"
    elif buses[bus].kind != kind:
        yield f"{key}: {bus} is of kind {buses[bus].kind!r} and this goes on a bus of kind {kind!r}; name another bus"


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none"
