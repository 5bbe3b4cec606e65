"""``heft plan`` finds the joint motion that tells most about a payload, inside limits."""

import argparse
from pathlib import Path

from onboard.cli.common import OK, Commands, add_json, load_vehicle, progress, show, write_json

SEGMENT_S = 6.0
STARTS, SEGMENT_STARTS = 64, 8


def add(commands: Commands) -> None:
    """Make the command known."""
    plan = commands.add_parser("plan", help="the joint motion that tells most about the payload")
    plan.add_argument("vehicle", help="vehicle.toml, or the name of a packaged vehicle")
    plan.add_argument(
        "--for",
        dest="asked",
        action="append",
        default=[],
        metavar="WHAT",
        help="mass, centre, inertia or a quantity by name; repeatable (default: all)",
    )
    plan.add_argument("--seconds", type=float, metavar="S", help="length of the motion (default: the swing's)")
    plan.add_argument("--limits", type=Path, metavar="FILE", help="limits beside the URDF's (docs/planning.md)")
    plan.add_argument("--scenario", dest="over", type=Path, metavar="FILE", help="rehearsal that it is planned into")
    plan.add_argument(
        "--criterion",
        default="D",
        choices=("D", "A", "worst"),
        help="least volume (D), sum of variances (A), or longest axis of the error ellipsoid (default D)",
    )
    plan.add_argument(
        "--starts",
        type=int,
        metavar="N",
        help=f"random motions; the two best are improved (default {STARTS}; of each segment {SEGMENT_STARTS})",
    )
    plan.add_argument("--iterations", type=int, default=15, metavar="N", help="of each descent (default 15)")
    plan.add_argument("--seed", type=int, default=1, metavar="N", help="of the random motions (default 1)")
    plan.add_argument(
        "--segments",
        action="store_true",
        help="many short motions that a flight may ask for (--until), in segments.npz",
    )
    plan.add_argument("--masses", metavar="KG,...", help="with --segments: payloads that they are planned for")
    plan.add_argument("-o", "--output", type=Path, default=Path("plan"), metavar="DIR", help="(default: plan)")
    add_json(plan)
    plan.set_defaults(command=_plan)


def _plan(arguments: argparse.Namespace) -> int:
    try:
        from hil_sim.devices.vehicle_file import rehearsal
        from hil_sim.plants.planned import default_plan, room_for_motion
    except ModuleNotFoundError as error:
        raise ValueError(f"the rehearsal is the simulator's, which is not installed ({error}); install it") from error
    from onboard.ground.before.planning import files, limits, view
    from onboard.ground.before.planning.criteria import Criterion
    from onboard.ground.before.planning.planning import Wanted, plan_motion
    from onboard.ground.before.planning.segments import plan_segments

    _check(arguments)
    vehicle = load_vehicle(arguments.vehicle)
    seconds = arguments.seconds or (SEGMENT_S if arguments.segments else None)
    starts = arguments.starts or (SEGMENT_STARTS if arguments.segments else STARTS)
    room = room_for_motion(rehearsal(vehicle.path, arguments.over), seconds)
    wanted = Wanted(
        *(room.start_s, room.end_s, tuple(arguments.asked), Criterion(arguments.criterion)),
        limits.LimitsFile() if arguments.limits is None else limits.read(arguments.limits),
        *(starts, arguments.iterations, arguments.seed, _masses(arguments.masses)),
    )
    with progress() as bar:
        task = bar.add_task("planning segments" if arguments.segments else "planning", total=1.0)
        given = vehicle, lambda period_s: default_plan(room.scenario, period_s), wanted
        made = (plan_segments if arguments.segments else plan_motion)(
            *given, lambda done: bar.update(task, completed=done)
        )
    show(view.render(made))
    tables: dict[str, object] = {"sequence": [step.model_dump(mode="json") for step in room.scenario.sequence]}
    if room.scenario.capture is not None:
        tables["capture"] = room.scenario.capture.model_dump(mode="json", exclude_none=True)
    paths = files.write(made, tables, arguments.over, arguments.output)
    write_json(arguments.json, files.numbers(made) | {"files": paths})
    for path in paths:
        print(path)
    own = arguments.vehicle if str(arguments.vehicle).endswith(".toml") else vehicle.path  # no packaged mission
    scenario = f"--scenario {arguments.output / files.SCENARIO}"
    print(f"next: heft hil {own} " + (f'--until "mass 1 %" --segments {paths[0]}' if arguments.segments else scenario))
    return OK


def _check(arguments: argparse.Namespace) -> None:
    """Refuse options that make no sense.

    Raises:
        ValueError: with the remedy.
    """
    if arguments.seconds is not None and not 4.0 <= arguments.seconds <= 600.0:
        raise ValueError(f"--seconds {arguments.seconds:g}: give 4 to 600")
    for option, value in (("--starts", arguments.starts), ("--iterations", arguments.iterations)):
        if value is not None and not 1 <= value <= 10_000:
            raise ValueError(f"{option} {value}: give 1 to 10000")
    if arguments.masses is not None and not arguments.segments:
        raise ValueError("--masses needs --segments")
    if arguments.segments and arguments.asked:
        raise ValueError("--segments are planned for mass, centre, inertia and all of them: leave --for out")


def _masses(text: str | None) -> tuple[float, ...]:
    if text is None:
        return ()
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = (0.0,)
    if not all(1e-3 <= mass <= 1e6 for mass in found) or len(set(found)) != len(found):
        raise ValueError(f"--masses {text}: different numbers of kg between commas, e.g. 0.5,2,8,32")
    return found
