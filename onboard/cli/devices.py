"""``heft devices`` lists what is on the buses of this computer, and the vehicle.toml lines that read it."""

import argparse
import time
from typing import TYPE_CHECKING

from onboard.cli.common import OK, Commands, add_json, busy, console, write_json

if TYPE_CHECKING:
    from onboard.flight.check.scan import Bus


def add(commands: Commands) -> None:
    """Make the command known."""
    devices = commands.add_parser(
        "devices",
        help="what is on the buses of this computer, and the lines of vehicle.toml that read it",
        description="Looks at I2C chips and CANopen nodes without setting anything up, and lists serial adapters. "
        "A CAN interface must be up: ip link set can0 up type can bitrate 500000.",
    )
    devices.add_argument("--url", action="append", default=[], help="look at this bus alone, repeatable")
    add_json(devices)
    devices.set_defaults(command=_devices)


def _devices(arguments: argparse.Namespace) -> int:
    from drivers.transports import serial_adapters
    from onboard.flight.check import scan
    from onboard.ground.before.init import seen

    buses: list[Bus] = []
    for url in arguments.url or scan.urls():
        with busy(f"looking at {url}"):
            buses.append(scan.scan(url, time.monotonic_ns, time.sleep))
    adapters = [] if arguments.url else serial_adapters()
    out = console()
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
    as_json = [{**bus._asdict(), "found": [one._asdict() for one in bus.found]} for bus in buses]
    write_json(arguments.json, {"buses": as_json, "serial": adapters, "vehicle_toml": text})
    return OK
