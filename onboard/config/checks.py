"""Checks across the tables of a vehicle file: references to names, and combinations of devices and methods."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from drivers.errors import DriverError
from drivers.transports import url
from onboard.config.errors import ConfigError
from onboard.config.vehicle import Vehicle
from onboard.devices.base import BusDevice

Fail = Callable[[list[str], str], NoReturn]

COMPULSORY = {"serial": "baud", "gpio": "line", "gpio-out": "line"}  # option of a URL, by its scheme
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
LONGEST_NAME = 32  # bytes of it in an event or a gap
RESERVED = {"event", "gap", "clock", "row", "estimate", "quantity", "tick", "health", "health_stream"}
OURS = ("event_", "recorder_", "recover_")  # prefixes of heft's own channels
FASTEST_HZ, SLOWEST_HZ = 50_000.0, 1e-4  # limits of a device's rate: the rings hold some seconds
PLAIN = re.compile(r"[^\W_][\w .+-]{0,63}")  # names used in file names


def check(vehicle: Vehicle) -> None:
    """Raise ConfigError for the first violation."""

    def fail(where: list[str], why: str) -> NoReturn:
        raise ConfigError(f"{vehicle.origin.place(where)}: {why}")

    _check_names(vehicle, fail)
    for name, device in vehicle.file.device.items():
        if isinstance(device, BusDevice):
            _check_device(vehicle, name, device, fail)
    for bus in vehicle.file.bus:
        _check_bus(vehicle, bus, fail)
    for name, device in vehicle.file.device.items():
        for where, why in device.problems(name, vehicle):
            fail(where, why)
    _check_channels(vehicle, fail)
    _check_roles(vehicle, fail)
    _check_rest(vehicle, fail)


def _check_names(vehicle: Vehicle, fail: Fail) -> None:
    told = vehicle.file.vehicle
    if not PLAIN.fullmatch(told.name):
        fail(["vehicle", "name"], f"{told.name!r} is to name files: use letters, digits, spaces and . _ + -")
    for name in told.essential:
        if name not in vehicle.file.device:
            fail(["vehicle", "essential"], f"no device {name!r}; there are: {', '.join(vehicle.file.device)}")
    if Path(told.urdf).name != told.urdf or "\0" in told.urdf:
        fail(["vehicle", "urdf"], f"{told.urdf!r} is a path; put the URDF beside the vehicle file and give its name")


def _check_bus(vehicle: Vehicle, bus: str, fail: Fail) -> None:
    on_bus = vehicle.devices_on(bus)
    types = {device.bus_type: type(device) for device in on_bus.values()}
    if len(types) > 1:
        fail(["bus", bus], f"bus {bus!r} has devices of {' and '.join(sorted(types))}; give each its own bus")
    for bus_type, one in types.items():
        try:
            parts = url.parse(vehicle.file.bus[bus].url, one.urls)
            if parts.kind in COMPULSORY:
                parts.integer(COMPULSORY[parts.kind])
        except DriverError as error:
            fail(["bus", bus, "url"], f"its devices are on {bus_type}: {error}")
        if not one.shares_bus and len(on_bus) > 1:
            text = f"bus {bus!r} has {', '.join(on_bus)}; {bus_type} has one device: give each its own bus"
            fail(["bus", bus], text)
        for where, why in one.bus_problems(bus, on_bus):
            fail(where, why)


def _check_device(vehicle: Vehicle, name: str, device: BusDevice, fail: Fail) -> None:
    buses = vehicle.file.bus
    if device.bus not in buses:
        fail(["device", name, "bus"], f"no bus {device.bus!r}; there are: {', '.join(buses)}")
    try:
        device.verify(name)
    except DriverError as error:
        fail(["device", name], f"{name!r}: {error}")


def _check_channels(vehicle: Vehicle, fail: Fail) -> None:
    owner: dict[str, str] = {}
    for name, device in vehicle.file.device.items():
        if not SLOWEST_HZ <= vehicle.rate_hz(name) <= FASTEST_HZ:
            text = f"{vehicle.rate_hz(name):g} samples a second; {SLOWEST_HZ:g} to {FASTEST_HZ:g} can be flown"
            fail(["device", name], f"{name!r} would make {text}: correct its rate or its period")
        for channel in device.channels(name):
            where = ["device", name]
            if not NAME.fullmatch(channel) or len(channel) > LONGEST_NAME:
                text = f"use a letter, then letters, digits and _, {LONGEST_NAME} at the most"
                fail(where, f"channel {channel!r} is not a name; {text}")
            if channel in RESERVED or channel.startswith(OURS):
                fail(where, f"channel {channel!r} is one of heft's own; rename the device")
            if owner.setdefault(channel, name) != name:
                fail(where, f"channel {channel!r} is that of {owner[channel]!r} too; rename one of them")


def _check_roles(vehicle: Vehicle, fail: Fail) -> None:
    devices = vehicle.file.device
    imus = [name for name, device in devices.items() if device.roles(name, 1.0).imus]
    if not imus and vehicle.file.vehicle.base != "fixed":
        fail(["device"], "no device is an IMU; the base's motion has to be measured: add one")
    lines: dict[str, str] = {}  # first of each kind
    for name, device in devices.items():
        if device.sync_line(name) is not None and lines.setdefault(device.kind, name) != name:
            text = f"{name!r} and {lines[device.kind]!r} are of one kind; a vehicle has one sync line"
            fail(["device", name], text)


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
    _check_realtime(vehicle, fail)
    _check_planar(vehicle, fail)
    _check_parabola(vehicle, fail)
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
        fail(
            ["vehicle", "urdf"],
            f"no file {vehicle.urdf_path}; put the URDF beside the vehicle file, or give it to heft identify --urdf-in",
        )


def _check_realtime(vehicle: Vehicle, fail: Fail) -> None:
    wanted = vehicle.file.realtime
    if wanted.recording_priority and wanted.recording_priority >= wanted.acquisition_priority:
        text = f"recording would delay acquisition (priority {wanted.acquisition_priority}): give it a lower one, or 0"
        fail(["realtime", "recording_priority"], text)


def _check_exiddm(vehicle: Vehicle, fail: Fail) -> None:
    file, settings = vehicle.file, vehicle.file.estimation
    where = ["estimation", "method"]
    if file.vehicle.base not in ("free", "planar"):
        fail(where, f'the base is {file.vehicle.base!r}; method "exiddm" is for base = "free" or "planar"')
    if file.vehicle.payload_link is None:
        fail(where, 'method "exiddm" estimates the payload; name its payload_link')
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
        fail(["free_body"], 'a free body is identified from rows; remove method = "exiddm"')


def _check_parabola(vehicle: Vehicle, fail: Fail) -> None:
    file, settings = vehicle.file, vehicle.file.estimation
    if file.parabola is None:
        return
    if file.vehicle.base != "free" or settings.method != "exiddm":
        fail(["parabola"], 'runs between hands are estimated with base = "free" and method = "exiddm"')
    if settings.carried:
        fail(["estimation", "carried"], "the runs of a flight are estimated together afterwards; remove carried")
    if not settings.exiddm.held_at_start:
        fail(["estimation", "exiddm", "held_at_start"], "in parabolas the payload is held from the start; remove it")


def _check_planar(vehicle: Vehicle, fail: Fail) -> None:
    file, settings = vehicle.file, vehicle.file.estimation
    if file.vehicle.base != "planar":
        if file.planar:
            fail(["planar"], f'the base is {file.vehicle.base!r}; pucks and a table need base = "planar"')
        return
    if settings.method != "exiddm":
        fail(["estimation", "method"], 'rows have no drag model: base = "planar" needs method = "exiddm"')
    if file.planar is None:
        fail(["vehicle", "base"], 'base = "planar" needs a section [planar] for the table and its pucks; add it')
    if settings.carried:
        fail(["estimation", "carried"], "a run on a table is estimated in one batch; remove carried")
    if settings.gates.joint_rate_min_rad_s:
        where = ["estimation", "gates", "joint_rate_min_rad_s"]
        fail(where, "joint_rate_min_rad_s does not apply to method exiddm; remove it")
    if not settings.exiddm.held_at_start and (settings.phases is None or settings.phases.payload_taken is None):
        where = ["estimation", "exiddm", "held_at_start"]
        fail(where, "captures on a table are not detected; give phases.payload_taken, or remove held_at_start")
