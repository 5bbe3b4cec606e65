"""``heft devices`` lists what is on the buses of this computer, and tries one of them on the desk (``--test``)."""

import argparse
import time
from typing import TYPE_CHECKING, Any

from onboard.cli import common

if TYPE_CHECKING:
    from onboard import config
    from onboard.flight.check.scan import ScannedBus


def add(commands: common.Commands) -> None:
    """Make the command known."""
    devices = commands.add_parser(
        "devices",
        help="what is on the buses of this computer, and the lines of vehicle.toml that read it",
        description="Looks at I2C chips and CANopen nodes without setting anything up, and lists serial adapters; asks "
        "who is on a serial line or at an address that --url names (servos, Modbus, a UR controller). A CAN interface "
        "must be up: ip link set can0 up type can bitrate 500000. --test runs a device for two minutes at rest: "
        "rate, gaps, noise against what is stated, clock, self test.",
    )
    devices.add_argument(
        "--url", action="append", default=[], help="look at this bus alone; with --vehicle BUS=URL; repeatable"
    )
    devices.add_argument("--test", metavar="WHAT", help="a kind that answers on a bus, or a device of --vehicle")
    devices.add_argument("--vehicle", help="of --test: its vehicle.toml, or the name of a packaged vehicle")
    devices.add_argument("--seconds", type=float, metavar="S", help="that --test runs (default 120)")
    common.add_json(devices)
    devices.set_defaults(command=_devices)


def _devices(arguments: argparse.Namespace) -> int:
    if arguments.test is not None:
        return _test(arguments)
    if arguments.vehicle is not None or arguments.seconds is not None:
        raise ValueError("--vehicle and --seconds are of --test: add it, with a device of the file")
    from drivers.transports import serial_adapters
    from onboard.ground.before.init import seen

    buses = _scanned(arguments.url)
    adapters = [] if arguments.url else serial_adapters()
    out = common.console()
    for bus in buses:
        out.print(bus.url, markup=False, highlight=False, style="bold")
        lines = [f"  {one.where:8s} {one.what}" + (f" -> {one.kind}" if one.kind else "") for one in bus.found]
        for line in lines or [f"  {bus.problem or 'nothing answers'}"]:
            out.print(line, markup=False, highlight=False)
    for adapter in adapters:
        out.print(adapter.url, markup=False, highlight=False, style="bold")
        out.print(f"  {adapter.what}", markup=False, highlight=False)
    if not buses and not adapters:
        out.print("no I2C bus, CAN interface or serial adapter: enable them (raspi-config, ip link), or give --url")
    text = seen.tables({bus.url: [(one.kind, one.number) for one in bus.found if one.kind] for bus in buses})
    if text:
        out.print("\nlines for vehicle.toml, with the joints, frames and numbers yours:\n")
        out.print(text, markup=False, highlight=False, soft_wrap=True)
    as_json = [{**bus._asdict(), "found": [answer._asdict() for answer in bus.found]} for bus in buses]
    common.write_json(arguments.json, {"buses": as_json, "serial": adapters, "vehicle_toml": text})
    return common.OK


def _scanned(urls: list[str]) -> "list[ScannedBus]":
    from onboard.flight.check import scan

    buses: list[ScannedBus] = []
    for url in urls or scan.urls():
        with common.busy(f"looking at {url}"):
            buses.append(scan.scan(url, time.monotonic_ns, time.sleep))
    return buses


def _test(arguments: argparse.Namespace) -> int:
    from onboard.flight.check import desk
    from onboard.flight.supervise import workers

    seconds: float = desk.SECONDS if arguments.seconds is None else arguments.seconds
    if not 0.0 < seconds <= 3600.0:
        raise ValueError(f"--seconds {seconds:g}: give the length of the test, up to an hour")
    vehicle, names = _of_file(arguments) if arguments.vehicle is not None else _on_bus(arguments)
    with common.busy(f"{', '.join(names)} at rest for {seconds:g} s: do not touch"):
        tests = desk.desk_tests(vehicle, names, time.monotonic_ns, time.sleep, workers.run_for, seconds)
    for test in tests:
        common.show(desk.render(test))
    common.write_json(arguments.json, {"tests": [_as_json(test) for test in tests]})
    return common.NOT_READY if any(test.problems for test in tests) else common.OK


def _as_json(test: Any) -> dict[str, Any]:
    signals = [one._asdict() for one in test.signals]
    return {**test.seen._asdict(), **test._asdict(), "seen": None, "signals": signals}


def _of_file(arguments: argparse.Namespace) -> "tuple[config.Vehicle, list[str]]":
    """A vehicle's device of that name, or all of that kind, with what is on their buses."""
    from onboard.devices.base import BusDevice
    from onboard.flight.check import desk

    vehicle = common.with_urls(common.load_vehicle(arguments.vehicle), arguments.url)
    there = {name: one.kind for name, one in vehicle.file.device.items() if isinstance(one, BusDevice)}
    names = [name for name, kind in there.items() if arguments.test in (name, kind)]
    if not names:
        raise ValueError(
            f"{vehicle.label} has no device or kind {arguments.test!r} on a bus; there are: {', '.join(there)}"
        )
    return desk.alone(vehicle, names), names


def _on_bus(arguments: argparse.Namespace) -> "tuple[config.Vehicle, list[str]]":
    """All of that kind that answer on the buses, by the tables that ``heft init`` would write."""
    from drivers import transports
    from drivers.transports.url import parse
    from onboard import config
    from onboard.devices.base import BusDevice
    from onboard.devices.buses import ComponentDevice
    from onboard.devices.registry import DEVICES
    from onboard.ground.before.init import seen

    kind: str = arguments.test
    section = DEVICES.get(kind)
    if section is None or not issubclass(section, BusDevice) or not section.new_keys:
        known = ", ".join(name for name, one in DEVICES.items() if issubclass(one, BusDevice) and one.new_keys)
        raise ValueError(
            f"--test {kind}: no kind that can be tried without a vehicle file (--vehicle); there are: {known}"
        )
    found: dict[str, list[tuple[str, int]]] = {}
    is_line = not section.urls.keys() <= transports.I2C_URLS.keys() | transports.CAN_URLS.keys()
    if is_line and not arguments.url:
        line = section.new_url or f"serial:///dev/ttyUSB0?baud={section.new_baud}"
        raise ValueError(f"--test {kind}: say where it is, --url '{line}'")
    if is_line and section.answering is None:
        parts = range(1, 7 if issubclass(section, ComponentDevice) else 2)
        found = {url: [(kind, part) for part in parts] for url in arguments.url if parse(url, section.urls)}
    else:
        for bus in _scanned(arguments.url):
            there = [(one.kind, one.number) for one in bus.found if one.kind in (kind, "canopen_sync")]
            found |= {bus.url: there} if any(what == kind for what, _ in there) else {}
    if not found:
        raise ValueError(f"no {kind} answers on a bus: check its power and wiring, or give its bus by --url")
    vehicle = config.devices_alone(seen.tables(found), f"tables of {kind}")
    return vehicle, [name for name, one in vehicle.file.device.items() if one.kind == kind]
