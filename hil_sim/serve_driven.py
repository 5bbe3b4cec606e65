"""A vehicle with servo drives in its joints and all of its sensors, in a process of its own, in real time.

    python -m hil_sim.serve_driven VEHICLE.toml --directory DIR [--over SCENARIO] [--segments NPZ] [--seed N] [...]

What ``heft fly VEHICLE.toml --arm`` can be tried on, from the first set point to the answer: every device with
``driven = true`` is a servo drive, every other device what a rehearsal makes of it, and all of them feel one vehicle,
which floats, slides or stands as its file says and holds its payload from the start. Joints stand where the motion of
``[drive]`` begins, else in the posture of the segments that the flight may ask for, else where the scenario says. The
first JSON line gives the URL of each bus; the last, on SIGTERM, SIGINT or after ``--seconds``, what is true and where
each joint has been.
"""

import argparse
import sys
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil_sim.arm_rig import Wired, travels
from hil_sim.buses.realtime import MissionServer
from hil_sim.devices.registry import for_vehicle
from hil_sim.devices.vehicle_file import rehearsal
from hil_sim.driven_flight import DrivenFlight
from hil_sim.faults import parse
from hil_sim.scenario.tables import ScenarioError
from hil_sim.serve import do_not_wait, motion_starts, open_sockets, say, stops_on_signals


def world(
    path: Path, over: Path | None, seed: int, seconds: float, faults: Sequence[str] = (), segments: Path | None = None
) -> DrivenFlight:
    """The world of a vehicle file.

    Args:
        path: of the file.
        over: a scenario file whose tables lie over the rehearsal's, or None.
        seed: of everything drawn.
        seconds: how long it is there.
        faults: ``KIND:DEVICE:START:END[:VALUE]``.
        segments: motions that the flight computer may ask for, in place of those of ``[mission]``.

    Raises:
        ScenarioError: no driven joint, or something that cannot be simulated.
        FaultError: a fault that its device cannot have.
    """
    file = tomllib.loads(path.read_text(encoding="utf-8"))
    devices = file.get("device", {})
    driven = {name: device for name, device in devices.items() if device.get("driven")}
    if not driven:
        raise ScenarioError(f"{path} has no device with driven = true; nothing could be driven")
    turning = {name: device["joint"] for name, device in driven.items() if for_vehicle(device["kind"]).turns_axis}
    wired = [_wired(name, device) for name, device in driven.items() if name not in turning]
    motion = _starts(path, file, segments)
    action = "asked" if "segments" in motion else "hold"
    lasts = {"sequence": [{"phase": 0, "action": action, "duration_s": seconds}], "motion": motion}
    scenario = rehearsal(path, over, lasts)
    can = devices[wired[0].name]["bus"] if wired else ""
    return DrivenFlight(scenario, seed, wired, can, [parse(text) for text in faults], turning)


def _wired(name: str, device: dict[str, Any]) -> Wired:
    counts, zero, reverse = device["counts_per_revolution"], device.get("zero_count", 0), device.get("gain", 1.0) < 0.0
    return Wired(name, device["joint"], device["node"], int(counts), int(zero), reverse, device.get("gear_ratio", 1.0))


def _starts(path: Path, file: dict[str, Any], segments: Path | None) -> dict[str, Any]:
    """``[motion]`` of joints that stand where what their drives will play begins."""
    posture, named = motion_starts(path, file), file.get("mission", {}).get("segments")
    if posture:
        return {"posture": posture, "posture_spread": 0.0}
    asked = segments or (path.parent / named if named else None)
    return {} if asked is None else {"segments": str(asked)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve one vehicle; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m hil_sim.serve_driven", description="Serve a driven vehicle.")
    parser.add_argument("vehicle", type=Path, help="vehicle.toml")
    parser.add_argument("--over", type=Path, help="a scenario file whose tables lie over its rehearsal's")
    parser.add_argument(
        "--segments", type=Path, help="motions that the flight may ask for; joints stand in their posture"
    )
    parser.add_argument("--seed", type=int, default=0, help="of everything random")
    parser.add_argument("--directory", type=Path, required=True, help="where terminals and sockets are to be")
    parser.add_argument("--fault", action="append", default=[], help="KIND:DEVICE:START:END[:VALUE], repeatable")
    parser.add_argument("--seconds", type=float, default=600.0, help="how long it is there (default 600)")
    options = parser.parse_args(arguments)
    try:
        mission = world(options.vehicle, options.over, options.seed, options.seconds, options.fault, options.segments)
    except (OSError, ValueError, KeyError) as error:
        parser.error(f"{options.vehicle}: {error}")
    stops = stops_on_signals()
    do_not_wait()
    with open_sockets(mission.scenario.bus, options.directory, options.seed) as ports:
        start_ns = time.monotonic_ns()
        mission.attach(ports.buses, start_ns)
        say({**ports.urls, "start_ns": start_ns})
        server = MissionServer(ports, time.monotonic_ns)
        server.run(mission, lambda: bool(stops))
        say({"truth": mission.truth(), "joints": travels(mission.drives), "server": server.summary()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
