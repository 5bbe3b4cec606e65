"""``heft hil`` flies a scenario against simulated devices."""

import argparse
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from onboard.cli import common, controller

if TYPE_CHECKING:
    from onboard import config
    from onboard.flight.hil import Flown


def add(commands: common.Commands) -> None:
    """Make the command known."""
    hil = commands.add_parser("hil", help="fly a scenario against simulated devices")
    hil.add_argument("scenario", help="a packaged mission or test bed: rocksat, capture, ...; or your vehicle.toml")
    hil.add_argument(
        "--scenario", dest="over", type=Path, metavar="TOML", help="a file that says otherwise: docs/rehearsal.md"
    )
    hil.add_argument(
        "--campaign", metavar="NAME", help="runs of a test bed: parabolic has day1, day2; air_bearing pitch, yaw, both"
    )
    hil.add_argument("--seed", type=int, default=1, help="seed of all random numbers of the scenario (default 1)")
    hil.add_argument("--realtime", action="store_true", help="devices and flight app as processes, on the real clock")
    common.add_json(hil)
    hil.add_argument("--log", type=Path, help="log to write (default: flights/NAME-NNN.mcap)")
    hil.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="KIND:DEVICE:START:END[:VALUE]",
        help="something breaks between two mission times [s], e.g. off:imu_base:10:12 (no END: to its end); repeatable",
    )
    hil.add_argument("--faults", action="store_true", help="say which faults the scenario's devices can have, and end")
    hil.add_argument("--most", type=float, default=300.0, metavar="S", help="with --until: longest time (default 300)")
    common.add_flying(hil)
    controller.add(hil)
    hil.set_defaults(command=_hil)


def _hil(arguments: argparse.Namespace) -> int:
    from onboard import config

    vehicle = config.with_mission(config.named(arguments.scenario), arguments.until, arguments.segments)
    try:
        from hil_sim.devices.vehicle_file import scenario_of
        from hil_sim.faults import EFFECTS, parse
        from hil_sim.mission import open_in_process
        from hil_sim.plants.planned import with_segments
    except ModuleNotFoundError as error:
        raise ValueError(f"heft hil simulates with MuJoCo ({error}): pip install mujoco") from error
    from onboard.flight import hil
    from onboard.flight.supervise.runner_processes import FlightError

    if arguments.live is not None and not arguments.realtime:
        raise ValueError("--live shows a flight on the real clock: add --realtime")
    if common.page_address(arguments) is not None and not arguments.realtime:
        raise ValueError("--page shows a flight on the real clock: add --realtime, or heft watch LOG --page afterwards")
    if arguments.telemetry is not None and not arguments.realtime:
        raise ValueError("--telemetry sends a flight on the real clock: add --realtime")
    seed = arguments.seed
    faults = [parse(text) for text in arguments.fault]
    asks = vehicle.segments_path
    name = vehicle.file.vehicle.name if arguments.scenario.endswith(".toml") else arguments.scenario
    if arguments.campaign and (arguments.realtime or asks is not None or arguments.controller):
        raise ValueError("--campaign flies its schedule in virtual time: without --realtime, --until, --controller")
    flown_as = arguments.scenario if asks is None else _rehearsed(vehicle.path, arguments)
    scenario = scenario_of(flown_as, arguments.over, arguments.campaign)
    scenario = scenario if asks is None else with_segments(scenario, asks, arguments.most)
    common.warn(held_otherwise(vehicle, scenario))
    vehicle = common.with_hand_over(vehicle, arguments.hand_over)
    if arguments.controller:
        return controller.fly(arguments, vehicle, scenario, faults)
    world, urls = open_in_process(scenario, seed, faults)  # what cannot be is refused here, with the reason
    if arguments.faults or arguments.realtime:
        world.close()
    if arguments.faults:
        _list_faults(world.possible_faults(), EFFECTS)
        return common.OK
    log = arguments.log or common.next_log(vehicle.file.recording.directory, name)
    # the fork server is forked from a process without threads
    with common.progress(threads=not arguments.realtime) as bar:
        task = bar.add_task(f"{name}, seed {seed}", total=1.0)
        expected = _foresee(vehicle, world) if asks is None else []
        if arguments.realtime:
            serve = _serving(flown_as, asks, arguments)
            try:
                with common.shown(arguments, log, vehicle):
                    flown = hil.fly_realtime(vehicle, serve, log, lambda done: bar.update(task, completed=done))
            except FlightError as error:
                common.complain(error)
                return common.FAILED
        else:
            with world:
                flown = hil.fly_simulated(vehicle, world, urls, log, lambda done: bar.update(task, completed=done))
    return _shown(arguments, vehicle, flown, expected)


def held_otherwise(vehicle: "config.Vehicle", scenario: Any) -> Iterator[str]:
    """Where the scenario's payload is held from another time on than the vehicle file states, with the remedy."""
    estimation, caught = vehicle.file.estimation, scenario.capture
    if scenario.payload is None or vehicle.file.parabola is not None:
        return
    taken = estimation.phases.payload_taken if estimation.phases is not None else None
    from_start = not estimation.predicts or estimation.exiddm.held_at_start
    if taken is not None:
        if caught is None or caught.phase != taken or all(step.phase != taken for step in scenario.sequence):
            yield (
                f"the scenario does not catch the payload at phase {taken}, from which on the vehicle file takes it "
                f"for held: give a [[sequence]] with phase = {taken}, and [capture] phase = {taken}"
            )
    elif from_start and caught is not None:
        key = "exiddm] held_at_start = false" if estimation.predicts else "phases] payload_taken"
        yield (
            "the scenario catches the payload in flight, and the vehicle file takes it for held from the start: expect "
            f"a wrong answer; state [estimation.{key}, or capture = false in the scenario"
        )
    elif not from_start and caught is None:
        yield (
            "the scenario holds the payload from the start, and the vehicle file waits for a capture: expect no "
            "answer; state [estimation.exiddm] held_at_start = true, or a [capture]"
        )


def _rehearsed(path: Path, arguments: argparse.Namespace) -> str:
    """What is rehearsed where the flight asks for its motions: of a packaged mission its vehicle."""
    from hil_sim.scenario.load import names

    if not 10.0 <= arguments.most <= 3600.0:
        raise ValueError(f"--most {arguments.most:g}: give 10 to 3600")
    return str(path) if arguments.scenario in names() else str(arguments.scenario)


def _serving(flown_as: str, segments: Path | None, arguments: argparse.Namespace) -> list[str]:
    """What the process of the simulated devices is started with."""
    serve = ["-m", "hil_sim.serve", flown_as, "--seed", str(arguments.seed)]
    serve += ["--segments", str(segments), "--most", str(arguments.most)] if segments is not None else []
    serve += ["--over", str(arguments.over)] if arguments.over else []
    return serve + [f"--fault={text}" for text in arguments.fault]


def _shown(
    arguments: argparse.Namespace, vehicle: "config.Vehicle", flown: "Flown", expected: list[dict[str, Any]]
) -> int:
    """Print the result, then write it, which a full disk may refuse, and give the exit code."""
    from onboard.ground.identify.mission import mission_table, own_mission
    from onboard.ground.log.tables import truth
    from onboard.recording.space import refusal

    result, log, screen = mission_table.result(flown, vehicle) | {"expected": expected}, flown.log, common.console()
    common.show(mission_table.render(result))
    screen.print(f"log: {log}", soft_wrap=True)
    screen.print(f"next: heft report {log}, heft info {log}, heft replay {log}", soft_wrap=True)
    try:
        truth.write(log, own_mission.with_quantities(vehicle, flown.truth))
        common.write_json(arguments.json, result)
    except OSError as error:
        common.complain(refusal(error))
        return common.FAILED
    for lost in flown.lost:
        common.complain(f"of the log: {lost}")
    return common.OK if result["identified"] and result["accounted"] and not flown.lost else common.FAILED


def _foresee(vehicle: "config.Vehicle", world: Any) -> list[dict[str, Any]]:
    """Say what the motion of a vehicle determines, before it is flown; as JSON values too."""
    planned = world.planned(1.0 / vehicle.file.estimation.row_rate_hz)
    return [] if planned is None else common.show_foreseen(vehicle, planned, "this motion")


def _list_faults(possible: Mapping[str, Iterable[str]], effects: Mapping[Any, str]) -> None:
    """The devices and buses with the faults they can have; then what each of these does."""
    from rich.table import Table

    devices = Table(
        box=None,
        pad_edge=False,
        title="--fault KIND:DEVICE:START:END[:VALUE], no END: to its end",
        title_justify="left",
    )
    devices.add_column("device or bus", no_wrap=True)
    devices.add_column("can have")
    kinds = Table(box=None, pad_edge=False)
    kinds.add_column("kind", no_wrap=True)
    kinds.add_column("between START and END")
    for name, its in possible.items():
        devices.add_row(name, ", ".join(its))
    for kind in sorted({kind for its in possible.values() for kind in its}):
        kinds.add_row(kind, effects[kind])
    common.show(devices)
    common.console().print()
    common.show(kinds)
