"""Checks across the tables of a vehicle file: references to names, and combinations of devices and methods."""

import difflib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from drivers.errors import DriverError
from drivers.transports import url
from onboard.config.errors import ConfigError
from onboard.config.methods import PREDICTING, Prediction
from onboard.config.vehicle import Vehicle
from onboard.devices.base import BusDevice
from onboard.dynamics.model.bases import BASES
from onboard.dynamics.model.urdf_check import impossible, inertial_of, require_flyable
from onboard.dynamics.model.urdf_reading import Drawing, DrawingError, shortened

Fail = Callable[[list[str], str], NoReturn]

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
LONGEST_NAME = 32  # bytes of it in an event or a gap
RESERVED = {"event", "gap", "clock", "row", "estimate", "quantity", "tick", "health", "health_stream"}
OURS = ("event_", "recorder_", "recover_")  # prefixes of heft's channels
FASTEST_HZ, SLOWEST_HZ = 50_000.0, 1e-4  # limits of a device's rate: the rings hold some seconds
PLAIN = re.compile(r"[^\W_][\w .+-]{0,63}")  # names used in file names


def check(vehicle: Vehicle) -> None:
    """Raise ConfigError for the first violation."""
    fail = _fail_of(vehicle)
    _check_names(vehicle, fail)
    check_devices(vehicle)
    _check_channels(vehicle, fail)
    _check_roles(vehicle, fail)
    _check_rest(vehicle, fail)


def check_devices(vehicle: Vehicle) -> None:
    """Raise ConfigError for the first violation of buses and devices by themselves."""
    fail = _fail_of(vehicle)
    for name, device in vehicle.file.device.items():
        if isinstance(device, BusDevice):
            _check_device(vehicle, name, device, fail)
    for bus in vehicle.file.bus:
        _check_bus(vehicle, bus, fail)
    for name, device in vehicle.file.device.items():
        for where, why in device.problems(name, vehicle):
            fail(where, why)


def with_urls(vehicle: Vehicle, urls: dict[str, str]) -> Vehicle:
    """The same vehicle with other bus URLs.

    Raises:
        ConfigError: no such bus, or a URL that its devices cannot be on.
    """
    if unknown := sorted(set(urls) - set(vehicle.buses)):
        raise ConfigError(f"{vehicle.label} has no bus {unknown[0]!r}; there are: {', '.join(vehicle.buses)}")
    made = vehicle.with_urls(urls)
    for bus in urls:
        _check_bus(made, bus, _fail_of(made))
    return made


def _fail_of(vehicle: Vehicle) -> Fail:
    def fail(where: list[str], why: str) -> NoReturn:
        raise ConfigError(f"{vehicle.origin.place(where)}: {why}")

    return fail


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
        fail(["bus", bus], f"bus {bus!r} has devices of {' and '.join(sorted(types))}; give each a bus")
    for bus_type, one in types.items():
        try:
            url.parse(vehicle.file.bus[bus].url, one.urls)
        except DriverError as error:
            fail(["bus", bus, "url"], f"its devices are on {bus_type}: {error}")
        if not one.shares_bus and len(on_bus) > 1:
            text = f"bus {bus!r} has {', '.join(on_bus)}; {bus_type} has a single device: give each a bus"
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
                fail(where, f"channel {channel!r} is heft's; rename the device")
            if owner.setdefault(channel, name) != name:
                fail(where, f"channel {channel!r} is that of {owner[channel]!r} too; rename either")


def _check_roles(vehicle: Vehicle, fail: Fail) -> None:
    devices = vehicle.file.device
    imus = [name for name, device in devices.items() if device.roles(name, 1.0).imus]
    if not imus and vehicle.file.vehicle.base_kind.moves and vehicle.file.body is None:
        fail(["device"], "no device is an IMU; the base's motion has to be measured: add an IMU")
    lines: dict[str, str] = {}  # first of each kind
    for name, device in devices.items():
        if device.sync_line(name) is not None and lines.setdefault(device.kind, name) != name:
            text = f"{name!r} and {lines[device.kind]!r} are of the same kind; a vehicle has a single sync line"
            fail(["device", name], text)


_SECTIONS = {  # by key: the kind of base that it is of
    "free_body": ("a free body needs", "free"),
    "parabola": ("runs between hands need", "free"),
    "pivot": ("a bearing needs", "pivot"),
    "planar": ("pucks and a table need", "planar"),
    "body": ("a body without joints needs", "planar"),
}


def _check_rest(vehicle: Vehicle, fail: Fail) -> None:
    file = vehicle.file
    phases = file.estimation.phases
    channels = vehicle.channels
    if phases and "value_raw" not in (channels[phases.channel].names or () if phases.channel in channels else ()):
        listed = ", ".join(channel for channel, records in channels.items() if "unit" in (records.names or ()))
        what = f"no channel {phases.channel!r} with values"
        fail(["estimation", "phases", "channel"], f"{what}; there are: {listed or 'none'}")
    for key, (what, base) in _SECTIONS.items():
        if getattr(file, key) is not None and file.vehicle.base != base:
            fail([key], f'the base is {file.vehicle.base!r}; {what} base = "{base}"')
    _check_realtime(vehicle, fail)
    _check_telemetry(vehicle, fail)
    _check_planar(vehicle, fail)
    _check_pivot(vehicle, fail)
    _check_body(vehicle, fail)
    _check_parabola(vehicle, fail)
    if file.estimation.predicts:
        _check_predicted(vehicle, fail)
    for index, load in enumerate(file.free_body.load if file.free_body else ()):
        if load.role == "proof" and load.truth_kg_m2 is None:
            fail(["free_body", "load", str(index), "role"], "a proof body must be known; give truth_kg_m2")
    if not vehicle.urdf_path.is_file():
        fail(
            ["vehicle", "urdf"],
            f"no file {vehicle.urdf_path}; put the URDF beside the vehicle file, or give it to heft identify --urdf-in",
        )
    _check_drawing(vehicle, fail)


def _check_drawing(vehicle: Vehicle, fail: Fail) -> None:
    """The URDF, and the vehicle file's entries for its links and joints."""
    told, label, flies = vehicle.file.vehicle, str(vehicle.urdf_path), not vehicle.is_recorded
    try:
        drawing = require_flyable(vehicle.urdf_text, told.base_kind, told.payload_link, label, simulated=flies)
    except DrawingError as error:
        raise ConfigError(str(error)) from error
    if told.base_link != drawing.root:
        fail(
            ["vehicle", "base_link"], f"base_link {told.base_link!r}: the root of the URDF is {drawing.root!r}; name it"
        )
    moves = any(joint.moves for joint in drawing.joints.values())
    if told.base_kind.falls and not (moves or vehicle.file.free_body or vehicle.file.parabola):
        what = "no joint of the URDF moves, and a body that tumbles shows only the ratios of its moments of inertia"
        fail(["vehicle", "urdf"], f"{what}; docs/free_body.md says what else shows their scale, or its mass")
    named = [(["vehicle", "payload_link"], told.payload_link)] if told.payload_link is not None else []
    for where, name in (*named, *_frames(vehicle.tree.get("device"), ["device"])):
        if name not in drawing.links and name not in drawing.joints:
            is_joint = where[-1] == "joint"
            known = [one.name for one in drawing.joints.values() if one.moves] if is_joint else list(drawing.links)
            near = difflib.get_close_matches(name, known, 1, 0.5)
            meant = f"did you mean {near[0]!r}?" if near else f"its {'moving joints' if is_joint else 'links'} are"
            fail(where, f"{where[-1]} {name!r} is not in the URDF; {meant} {'' if near else shortened(known)}".rstrip())
    for name in vehicle.file.link:
        if name not in drawing.links:
            fail(["link", name], f"the URDF has no link {name!r}; it has {shortened(drawing.links)}")
        if why := _impossible(vehicle, drawing, name):
            fail(["link", name], f"link {name!r} {why}")


def _frames(node: Any, where: list[str]) -> Iterator[tuple[list[str], str]]:
    """Names of links and joints in the tables of devices."""
    for key, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        at = [*where, str(key)]
        if key in ("joint", "frame") and isinstance(value, str):
            yield at, value
        else:
            yield from _frames(value, at)


def _impossible(vehicle: Vehicle, drawing: Drawing, link: str) -> str:
    """Why a link cannot be as it was measured, or as it was measured in part and drawn besides."""
    own, drawn = vehicle.file.link[link], inertial_of(drawing.links[link])
    if own.inertia_kg_m2 is None or (own.mass_kg is None and drawn is None):
        return ""
    xx, xy, yy, xz, yz, zz = own.inertia_kg_m2
    mass_kg = own.mass_kg if own.mass_kg is not None or drawn is None else drawn.mass_kg
    return impossible(float(mass_kg or 0.0), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def _check_realtime(vehicle: Vehicle, fail: Fail) -> None:
    wanted = vehicle.file.realtime
    if wanted.recording_priority and wanted.recording_priority >= wanted.acquisition_priority:
        text = f"recording would delay acquisition (priority {wanted.acquisition_priority}): give it less, or 0"
        fail(["realtime", "recording_priority"], text)


def _check_telemetry(vehicle: Vehicle, fail: Fail) -> None:
    taken: dict[int, str] = {}
    for kind, apid in vehicle.file.telemetry.apids.items():
        if taken.setdefault(apid, kind) != kind:
            fail(["telemetry", f"{kind}_apid"], f"APID {apid} is that of {taken[apid]} packets too; give it another")


def _check_predicted(vehicle: Vehicle, fail: Fail) -> None:
    file, settings = vehicle.file, vehicle.file.estimation
    where = ["estimation", "method"]
    if file.vehicle.base not in {*Prediction}:
        known = " or ".join(f'"{kind}"' for kind in BASES if kind in {*Prediction})
        fail(where, f'the base is {file.vehicle.base!r}; method "{PREDICTING.name}" is for base = {known}')
    if file.vehicle.payload_link is None and file.vehicle.base != "pivot" and file.body is None:
        fail(where, f'method "{PREDICTING.name}" estimates the payload; name its payload_link')
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
        fail(["free_body"], f'a free body is identified from rows; remove method = "{PREDICTING.name}"')


def _check_parabola(vehicle: Vehicle, fail: Fail) -> None:
    file, settings = vehicle.file, vehicle.file.estimation
    if file.parabola is None:
        return
    if not settings.predicts:
        fail(["parabola"], f'runs between hands are estimated with method = "{PREDICTING.name}"')
    if settings.carried:
        fail(["estimation", "carried"], "the runs of a flight are estimated together afterwards; remove carried")
    if not settings.exiddm.held_at_start:
        fail(["estimation", "exiddm", "held_at_start"], "in parabolas the payload is held from the start; remove it")


def _check_pivot(vehicle: Vehicle, fail: Fail) -> None:
    file, settings = vehicle.file, vehicle.file.estimation
    if file.vehicle.base != "pivot":
        return
    if not settings.predicts:
        fail(["estimation", "method"], f'base = "pivot" is predicted: it needs method = "{PREDICTING.name}"')
    if not settings.imu_prior.gyro_bias_rad_s:
        where = ["estimation", "imu_prior", "gyro_bias_rad_s"]
        fail(
            where,
            'with base = "pivot" a gyro without bias is hardly meant; say how well it is known, 0.01 if it is not',
        )
    if settings.carried:
        fail(["estimation", "carried"], "a run on a pivot is estimated by itself; remove carried")


def _check_body(vehicle: Vehicle, fail: Fail) -> None:
    file = vehicle.file
    if file.body is None:
        return
    if file.planar is not None:
        fail(["planar"], "a run of a body without joints has its table in [body]; remove either")
    for kind, many in (("recorded_thruster", True), ("recorded_pose", False)):
        own = [name for name, device in file.device.items() if device.kind == kind]
        if not own or (len(own) > 1 and not many):
            fail(
                ["device"],
                f"[body] needs {'a device' if many else 'a single device'} of kind {kind!r}; there are {len(own)}",
            )
    if other := [name for name, one in file.device.items() if not one.kind.startswith("recorded_")]:
        fail(["device", other[0], "kind"], "a body without joints is identified from recordings; use recorded kinds")


def _check_planar(vehicle: Vehicle, fail: Fail) -> None:
    file, settings = vehicle.file, vehicle.file.estimation
    if file.vehicle.base != "planar":
        return
    if not settings.predicts:
        fail(["estimation", "method"], f'rows have no drag model: base = "planar" needs method = "{PREDICTING.name}"')
    if file.planar is None and file.body is None:
        fail(["vehicle", "base"], 'base = "planar" needs a section: [planar] with an arm, [body] without; add it')
    if settings.carried:
        fail(["estimation", "carried"], "a run on a table is estimated in a single batch; remove carried")
    if settings.gates.joint_rate_min_rad_s:
        where = ["estimation", "gates", "joint_rate_min_rad_s"]
        fail(where, "joint_rate_min_rad_s does not apply to a predicted base; remove it")
    if not settings.exiddm.held_at_start and (settings.phases is None or settings.phases.payload_taken is None):
        where = ["estimation", "exiddm", "held_at_start"]
        fail(where, "captures on a table are not detected; give phases.payload_taken, or remove held_at_start")
