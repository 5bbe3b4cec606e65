"""What no single table can tell: names that must point at something, and devices that must go together."""

import re
from collections import Counter
from collections.abc import Callable, Mapping
from typing import NoReturn

from drivers import transports
from drivers.errors import DriverError
from drivers.transports import url
from onboard.config.devices import (
    AccelChannel,
    BusDevice,
    BusType,
    CanopenNode,
    CanopenObjectDevice,
    CanopenSyncDevice,
    GyroChannel,
    ImuDevice,
    NodeFrameDevice,
    PpsDevice,
    PulseGeneratorDevice,
    SyncPulseDevice,
)
from onboard.config.errors import ConfigError, line_of
from onboard.config.vehicle import Vehicle

Fail = Callable[[list[str], str], NoReturn]

URLS: dict[BusType, Mapping[str, tuple[str, ...]]] = {
    BusType.I2C: transports.I2C_URLS,
    BusType.CAN: transports.CAN_URLS,
    BusType.SERIAL: transports.SERIAL_URLS,
    BusType.PULSE: transports.PULSE_URLS,
    BusType.PULSE_OUTPUT: transports.PULSE_OUTPUT_URLS,
}
COMPULSORY = {"serial": "baud", "gpio": "line", "gpio-out": "line"}  # option of a URL, by its scheme
SHARED = {BusType.I2C, BusType.CAN}  # buses that carry several devices
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
LONGEST_NAME = 32  # bytes of it in an event or a gap
RESERVED = {"event", "gap", "clock", "row", "estimate", "quantity", "tick"}


def check(vehicle: Vehicle) -> None:
    """Raise ConfigError for the first thing that does not fit."""

    def fail(where: list[str], why: str) -> NoReturn:
        raise ConfigError(f"{vehicle.path}:{line_of(vehicle.text, where)}: {why}")

    for name, device in vehicle.file.device.items():
        if isinstance(device, BusDevice):
            _check_device(vehicle, name, device, fail)
    for bus in vehicle.file.bus:
        _check_bus(vehicle, bus, fail)
    for name, device in vehicle.file.device.items():
        if isinstance(device, PulseGeneratorDevice) and device.sync_bus is not None:
            _check_sync_bus(vehicle, name, device.sync_bus, device.sync_period_ms, fail)
    _check_channels(vehicle, fail)
    _check_roles(vehicle, fail)
    _check_rest(vehicle, fail)


def _check_bus(vehicle: Vehicle, bus: str, fail: Fail) -> None:
    on_bus = vehicle.devices_on(bus)
    kinds = {device.bus_type for device in on_bus.values()}
    if len(kinds) > 1:
        fail(["bus", bus], f"bus {bus!r} has devices of {' and '.join(sorted(kinds))}; give each its own bus")
    for kind in kinds:
        try:
            parts = url.parse(vehicle.file.bus[bus].url, URLS[kind])
            if parts.kind in COMPULSORY:
                parts.integer(COMPULSORY[parts.kind])
        except DriverError as error:
            fail(["bus", bus, "url"], f"its devices are on {kind}: {error}")
        if kind not in SHARED and len(on_bus) > 1:
            fail(["bus", bus], f"bus {bus!r} has {', '.join(on_bus)}; {kind} has one device: give each its own bus")
    if kinds == {BusType.CAN}:
        _check_can(vehicle, bus, fail)
    addresses = Counter(getattr(device, "address", None) for device in on_bus.values())
    for name, device in on_bus.items():
        if device.bus_type is BusType.I2C and addresses[getattr(device, "address", None)] > 1:
            fail(["device", name], f"{name!r} shares its I2C address; set AD0 of one and give it the other address")


def _check_can(vehicle: Vehicle, bus: str, fail: Fail) -> None:
    on_bus = vehicle.devices_on(bus)
    syncs = [name for name, device in on_bus.items() if isinstance(device, CanopenSyncDevice)]
    if len(syncs) != 1:
        first = next(iter(on_bus))
        fail(["device", first], f"bus {bus!r} has {len(syncs)} canopen_sync devices; it needs one")
    by_node: dict[int, tuple[str, CanopenNode]] = {}
    profiles: dict[int, str] = {}
    for name, device in on_bus.items():
        if not isinstance(device, CanopenNode):
            continue
        other, first_of_node = by_node.setdefault(device.node, (name, device))
        if device.guard != first_of_node.guard:
            fail(["device", name], f"{name!r} and {other!r} are one node; give both the same supervision")
        if not isinstance(device, CanopenObjectDevice) and profiles.setdefault(device.node, name) != name:
            text = f"{name!r} and {profiles[device.node]!r} are both node {device.node}; a node has one profile"
            fail(["device", name, "node"], f"{text}: give each its number, or take a canopen_object")


def _check_device(vehicle: Vehicle, name: str, device: BusDevice, fail: Fail) -> None:
    buses = vehicle.file.bus
    if device.bus not in buses:
        fail(["device", name, "bus"], f"no bus {device.bus!r}; there are: {', '.join(buses)}")
    try:
        device.settings(name)
        if isinstance(device, CanopenNode):
            device.guard  # noqa: B018 - it refuses what guarding does not have
    except DriverError as error:
        fail(["device", name], f"{name!r}: {error}")


def _check_sync_bus(vehicle: Vehicle, name: str, sync_bus: str, sync_period_ms: float, fail: Fail) -> None:
    buses = vehicle.file.bus
    where = ["device", name, "sync_bus"]
    cans = [bus for bus in buses if any(d.bus_type is BusType.CAN for d in vehicle.devices_on(bus).values())]
    if sync_bus not in cans:
        fail(where, f"no CAN bus {sync_bus!r} with devices; there are: {', '.join(cans) or 'none'}")
    period_ms = vehicle.sync_on(sync_bus)[1].period_ms
    if period_ms != sync_period_ms:
        fail(["device", name, "sync_period_ms"], f"bus {sync_bus!r} has period_ms = {period_ms:g}; give the same here")
    if buses[sync_bus].url.startswith("can+slcan:"):
        text = f"the adapter of bus {sync_bus!r} can be opened once, and its nodes are read through it"
        fail(where, f"{text}; use can+socketcan")


def _check_channels(vehicle: Vehicle, fail: Fail) -> None:
    owner: dict[str, str] = {}
    for name, device in vehicle.file.device.items():
        for channel in device.channels(name):
            where = ["device", name]
            if not NAME.fullmatch(channel) or len(channel) > LONGEST_NAME:
                text = f"use a letter, then letters, digits and _, {LONGEST_NAME} at the most"
                fail(where, f"channel {channel!r} is no name; {text}")
            if channel in RESERVED or channel.startswith("event_"):
                fail(where, f"channel {channel!r} is one of heft's own; rename the device")
            if owner.setdefault(channel, name) != name:
                fail(where, f"channel {channel!r} is that of {owner[channel]!r} too; rename one of them")


def _check_roles(vehicle: Vehicle, fail: Fail) -> None:
    devices = vehicle.file.device
    imus = [name for name, device in devices.items() if isinstance(device, ImuDevice)]
    for name, device in devices.items():
        if not isinstance(device, NodeFrameDevice):
            continue
        axes = Counter((c.role, c.axis) for c in device.channel if isinstance(c, GyroChannel | AccelChannel))
        if axes:
            imus.append(name)
            if len(axes) != 6 or max(axes.values()) > 1:
                fail(["device", name], f"{name!r} is an IMU by parts; give gyro x, y, z and accel x, y, z, each once")
            if device.frame is None:
                fail(["device", name], f"{name!r} has gyro and accel channels; give the frame that they measure in")
        elif device.frame is not None:
            fail(["device", name, "frame"], f"{name!r} has no gyro or accel channels; leave frame out")
    if not imus and vehicle.file.vehicle.base != "fixed":
        fail(["device"], "no device is an IMU; the base's motion has to be measured: add one")
    for kind in (SyncPulseDevice, PpsDevice):
        lines = [name for name, device in devices.items() if isinstance(device, kind)]
        if len(lines) > 1:
            fail(["device", lines[1]], f"{lines[1]!r} and {lines[0]!r} are of one kind; a vehicle has one sync line")


def _check_rest(vehicle: Vehicle, fail: Fail) -> None:
    file = vehicle.file
    phases = file.estimation.phases
    channels = vehicle.channels
    if phases and "value_raw" not in (channels[phases.channel].names or () if phases.channel in channels else ()):
        listed = ", ".join(channel for channel, records in channels.items() if "unit" in (records.names or ()))
        what = f"no channel {phases.channel!r} with values"
        fail(["estimation", "phases", "channel"], f"{what}; there are: {listed or 'none'}")
    if file.free_body and file.vehicle.base != "free":
        fail(["free_body"], f'the base is {file.vehicle.base!r}; a free body needs base = "free"')
    _check_planar(vehicle, fail)
    if file.estimation.method == "exiddm":
        _check_exiddm(vehicle, fail)
    if file.estimation.method == "instrumental":
        where = ["estimation", "method"]
        if file.vehicle.base != "free":
            fail(where, f'the base is {file.vehicle.base!r}; method "instrumental" is for base = "free"')
        if set(file.estimation.base_rows) != {"force", "moment"}:
            fail(where, 'method "instrumental" needs base_rows = ["force", "moment"]')
    for index, load in enumerate(file.free_body.load if file.free_body else ()):
        if load.role == "proof" and load.truth_kg_m2 is None:
            fail(["free_body", "load", str(index), "role"], "a proof body must be known; give truth_kg_m2")
    if not vehicle.urdf_path.is_file():
        fail(["vehicle", "urdf"], f"no file {vehicle.urdf_path}; put the URDF beside the vehicle file")


def _check_exiddm(vehicle: Vehicle, fail: Fail) -> None:
    file, settings = vehicle.file, vehicle.file.estimation
    where = ["estimation", "method"]
    if file.vehicle.base not in ("free", "planar"):
        fail(where, f'the base is {file.vehicle.base!r}; method "exiddm" is for base = "free" or "planar"')
    if file.vehicle.payload_link is None:
        fail(where, 'method "exiddm" finds the payload; name its payload_link')
    others = {
        "base_rows": settings.base_rows,
        "masses": settings.masses,
        "zero": settings.zero,
        "zero_force_sigma_m_s2": settings.zero_force_sigma_m_s2,
        "nuisance": settings.nuisance,
    }
    for key, given in others.items():
        if given:
            fail(["estimation", key], f"{key} is for the methods of rows; leave it out")
    if settings.phases and settings.phases.payload_taken is not None and settings.exiddm.held_at_start:
        fail(["estimation", "phases", "payload_taken"], "nothing is held before it; give exiddm.held_at_start = false")
    if file.free_body:
        fail(["free_body"], 'a free body is told from rows; leave method = "exiddm" out')


def _check_planar(vehicle: Vehicle, fail: Fail) -> None:
    file, settings = vehicle.file, vehicle.file.estimation
    if file.vehicle.base != "planar":
        if file.planar:
            fail(["planar"], f'the base is {file.vehicle.base!r}; pucks and a table need base = "planar"')
        return
    if settings.method != "exiddm":
        fail(["estimation", "method"], 'rows know nothing of drag: base = "planar" needs method = "exiddm"')
    if file.planar is None:
        fail(["vehicle", "base"], 'base = "planar" needs a section [planar] for the table and its pucks; add it')
    if settings.carried:
        fail(["estimation", "carried"], "a run on a table is estimated as a whole; leave carried out")
    if settings.gates.joint_rate_min_rad_s:
        where = ["estimation", "gates", "joint_rate_min_rad_s"]
        fail(where, "a slow arm is as good as a fast one where its motion is predicted; leave joint_rate_min_rad_s out")
    if not settings.exiddm.held_at_start and (settings.phases is None or settings.phases.payload_taken is None):
        where = ["estimation", "exiddm", "held_at_start"]
        fail(where, "nobody finds a capture on a table; give phases.payload_taken, or leave held_at_start out")
