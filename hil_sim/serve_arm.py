"""The driven arm of a vehicle in a process of its own, in real time: what ``heft fly --arm`` can be tried on.

    python -m hil_sim.serve_arm VEHICLE.toml --directory DIR [--at JOINT=RAD] [--fault KIND:DEVICE:START:END[:VALUE]]

Reads the file as a document of its own: every cia402 device with ``driven = true`` is a servo drive on the CAN bus (a
Lawicel adapter on a pseudo-terminal), with the producer of SYNC and, where the file has a sync line, its pulse. A joint
stands where ``--at`` says, else where the motion of ``[drive]`` begins, else at 0. Its motor has the URDF's effort and
moves a tenth of it in kg m2. Other devices are not there. The first JSON line gives the URL of each bus; the last, on
SIGTERM, SIGINT or after ``--seconds``, where each joint has been (rad) and how fast (rad/s).
"""

import argparse
import math
import sys
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil_sim.arm_rig import Arm, RigMotor, travels
from hil_sim.buses.media import CanBus, PulseLine
from hil_sim.buses.realtime import MissionServer
from hil_sim.faults import FaultPlan, parse
from hil_sim.plants import urdf_drawing
from hil_sim.scenario.bus_tables import BusTable, CanBusTable, PulseLineTable
from hil_sim.scenario.tables import ScenarioError
from hil_sim.serve import do_not_wait, motion_starts, open_sockets, say, stops_on_signals

_BIT_RATE = 1_000_000
_EFFORT_N_M, _PER_EFFORT = 30.0, 0.1


def motors(path: Path, file: dict[str, Any], at: dict[str, float]) -> list[RigMotor]:
    """The driven joints of a vehicle file.

    Args:
        path: Of the file.
        file: Its tables.
        at: Where joints stand, rad, by name.

    Raises:
        ScenarioError: there is none, or the URDF does not have its joint.
    """
    drawing = urdf_drawing.read((path.parent / file["vehicle"]["urdf"]).read_text(encoding="utf-8"), "the URDF")
    stands = motion_starts(path, file) | at
    joints = []
    for name, device in file.get("device", {}).items():
        if device.get("kind") != "cia402" or not device.get("driven"):
            continue
        joint = drawing.joints.get(device["joint"])
        if joint is None:
            raise ScenarioError(f"device.{name}: the URDF has no moving joint {device['joint']!r}; correct it")
        effort = joint.effort if math.isfinite(joint.effort) and joint.effort > 0.0 else _EFFORT_N_M
        counts, zero = int(device["counts_per_revolution"]), int(device.get("zero_count", 0))
        reverse = device.get("gain", 1.0) < 0.0
        angle = stands.get(joint.name, 0.0)
        joints.append(RigMotor(name, int(device["node"]), angle, counts, zero, reverse, effort, _PER_EFFORT * effort))
    if not joints:
        raise ScenarioError(f"{path} has no cia402 device with driven = true; nothing could be driven")
    return joints


def _buses(file: dict[str, Any]) -> tuple[dict[str, BusTable], str, str | None, float]:
    """Tables of the CAN bus and of the sync line; their names; the SYNC period, ms."""
    devices = file["device"].values()
    sync = next(device for device in devices if device.get("kind") == "canopen_sync")
    line = next((device["bus"] for device in devices if device.get("kind") == "sync_pulse"), None)
    tables: dict[str, BusTable] = {sync["bus"]: CanBusTable(kind="can", bit_rate=_BIT_RATE)}
    if line is not None:
        tables[line] = PulseLineTable(kind="pulse", channel="pulse")
    return tables, sync["bus"], line, float(sync["period_ms"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve one arm; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m hil_sim.serve_arm", description="Serve a driven arm in real time.")
    parser.add_argument("vehicle", type=Path, help="vehicle.toml")
    parser.add_argument("--directory", type=Path, required=True, help="where the terminal and the socket are to be")
    parser.add_argument("--at", action="append", default=[], metavar="JOINT=RAD", help="where a joint stands")
    parser.add_argument("--fault", action="append", default=[], help="KIND:DEVICE:START:END[:VALUE], repeatable")
    parser.add_argument("--seconds", type=float, default=3600.0, help="how long it is there (default 3600)")
    options = parser.parse_args(arguments)
    try:
        file = tomllib.loads(options.vehicle.read_text(encoding="utf-8"))
        at = {name: float(value) for name, _, value in (text.partition("=") for text in options.at)}
        joints = motors(options.vehicle, file, at)
        tables, can, line, period_ms = _buses(file)
        faults = [parse(text) for text in options.fault]
    except (OSError, ValueError, KeyError, StopIteration) as error:
        parser.error(f"{options.vehicle}: {error or 'no canopen_sync device'}")
    stops = stops_on_signals()
    do_not_wait()
    with open_sockets(tables, options.directory) as ports:
        start_ns = time.monotonic_ns()
        plan = FaultPlan(faults, start_ns)
        arm = Arm(joints, plan, start_ns, round(1e6 * period_ms), start_ns + round(1e9 * options.seconds))
        bus, pulses = ports.buses[can], None if line is None else ports.buses[line]
        assert isinstance(bus, CanBus)
        assert pulses is None or isinstance(pulses, PulseLine)
        arm.plug(bus, pulses)
        bus.inject(plan.of(can))
        plan.check_all_taken()
        say({**ports.urls, "start_ns": start_ns})
        server = MissionServer(ports, time.monotonic_ns)
        server.run(arm, lambda: bool(stops))
        say({**travels(arm.drives), "server": server.summary()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
