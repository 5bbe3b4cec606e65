"""``heft campaign`` flies a plan of many flights on this computer or a Dask cluster, and reports on them."""

import argparse
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from onboard.cli.common import FAILED, OK, Commands, add_json, complain, console, progress, show, write_json

if TYPE_CHECKING:
    from onboard.ground.campaign.design import Item
    from onboard.ground.campaign.results import Returned
    from onboard.ground.campaign.store import Content, Store

_REPORT = Path("report")


def add(commands: Commands) -> None:
    """Make the command known."""
    campaign = commands.add_parser(
        "campaign",
        help="fly a plan of many flights, here or on a cluster, and report on them",
        description="heft campaign plan.toml flies; heft campaign report DIR writes the page about what was flown.",
    )
    campaign.add_argument("plan", type=Path, metavar="PLAN|report", help="plan.toml (docs/campaigns.md); or: report")
    campaign.add_argument("directory", type=Path, nargs="?", metavar="DIR", help="of a campaign, for report")
    campaign.add_argument(
        "-o", "--output", type=Path, metavar="PATH", help="directory of the campaign (default: campaigns/PLAN), or page"
    )
    campaign.add_argument("--first", type=int, metavar="SEED", help="in place of the plan's first_seed")
    campaign.add_argument("--seeds", type=int, metavar="N", help="in place of the plan's seeds")
    campaign.add_argument(
        "--scheduler", metavar="tcp://HOST:PORT", help="Dask's, in place of processes here (or tls://)"
    )
    campaign.add_argument("--jobs", type=int, metavar="N", help="processes here (default: as many as cores)")
    campaign.add_argument("--memory", default="auto", metavar="2GB", help="of each process (default: an equal share)")
    campaign.add_argument(
        "--dashboard", default="127.0.0.1:0", metavar="HOST:PORT", help="of Dask's page (default: any free port here)"
    )
    campaign.add_argument("--retry", action="store_true", help="fly again what has failed")
    campaign.add_argument("--list", action="store_true", help="say what would be flown, and end")
    campaign.add_argument("--again", metavar="FLIGHT", help="fly this flight in this process, keep its log, and end")
    campaign.add_argument("--by", metavar="FACTOR", help="of report: the answers of each level of a factor too")
    add_json(campaign)
    campaign.set_defaults(command=_campaign)


def _campaign(arguments: argparse.Namespace) -> int:
    try:
        import pyarrow  # noqa: F401
    except ModuleNotFoundError as error:
        raise ValueError(f"heft campaign keeps Parquet files ({error}): pip install 'heft-flight[cluster]'") from error
    if arguments.plan == _REPORT:
        return _report(arguments)
    if arguments.directory is not None:
        raise ValueError(f"heft campaign {arguments.plan} {arguments.directory}: the campaign's directory is -o DIR")
    if arguments.jobs is not None and not 1 <= arguments.jobs <= 1024:
        raise ValueError(f"--jobs {arguments.jobs}: give 1 to 1024")
    from onboard.ground.campaign import design, plan_file
    from onboard.ground.campaign.revision import revision
    from onboard.ground.campaign.store import Content, Store

    plan = plan_file.read(arguments.plan, first_seed=arguments.first, seeds=arguments.seeds)
    if plan.file.flight.call:
        _check_function(plan.file.flight.call)
    code = revision(plan.file.flight.call or "")
    items = {item.address(code): item for item in design.items(plan)}
    store = Store(arguments.output or Path("campaigns") / arguments.plan.stem)
    if arguments.list:
        return _list(items, store)
    if plan.file.flight.mission:
        _check_missions(items)
    if arguments.again is not None:
        return _again(arguments.again, items, code)
    content = Content(plan.file.campaign.name, plan.text, code, items)
    store.begin(content)
    return _fly(arguments, content, store)


def _check_function(call: str) -> None:
    """Of a module that is installed, or lies below the working directory."""
    import importlib
    import sys

    sys.path.append(str(Path.cwd()))  # which the workers are given too
    module, _, function = call.partition(":")
    try:
        getattr(importlib.import_module(module), function)
    except (ModuleNotFoundError, AttributeError) as error:
        remedy = "give package.module:function of a package that is installed or lies in the working directory"
        raise ValueError(f"flight.call = {call!r}: {error}; {remedy}") from error


def _check_missions(items: Mapping[str, "Item"]) -> None:
    from onboard.ground.campaign.flights import check

    try:
        check(items.values(), _world)
    except ModuleNotFoundError as error:
        raise ValueError(f"heft campaign simulates with MuJoCo ({error}): pip install mujoco") from error


def fly(item: "Item", revision: str) -> "Returned":
    """What a worker does with an item."""
    from onboard.ground.campaign.flights import done

    return done(item, revision, _world)


def _world(mission: str, over: Path | None, seed: int, faults: Sequence[str]) -> tuple[Any, Mapping[str, str]]:
    from hil_sim.devices.vehicle_file import scenario_of
    from hil_sim.faults import parse
    from hil_sim.mission import open_in_process

    return open_in_process(scenario_of(mission, over), seed, [parse(text) for text in faults])


def _fly(arguments: argparse.Namespace, content: "Content", store: "Store") -> int:
    try:
        from onboard.ground.campaign import engine
    except ModuleNotFoundError as error:
        raise ValueError(f"heft campaign runs on Dask ({error}): pip install 'heft-flight[cluster]'") from error
    from onboard.ground.campaign.view import failures

    items = content.items
    left = {address: item for address, item in items.items() if not store.is_done(address)}
    if not arguments.retry:
        left = {address: item for address, item in left.items() if not store.has_failed(address)}
    jobs = min(arguments.jobs or os.cpu_count() or 1, max(1, len(left)))
    where = engine.Where(arguments.scheduler, jobs, arguments.memory, arguments.dashboard)
    wrong = 0
    shell = console()
    with progress() as bar:
        task = bar.add_task(content.name, total=len(items), completed=len(items) - len(left))

        def count(item: "Item", done: "Returned") -> None:
            nonlocal wrong
            wrong += done.result is not None and done.result.nonsense
            seen = f"{content.name}: {wrong} beyond 99.9 % at some time" if wrong else content.name
            bar.update(task, advance=1, description=seen)

        links = list[str]()

        def dashboard(link: str) -> None:
            links.append(link)
            said = f"dashboard: {link}" if len(links) == 1 else "the scheduler was away, and is back"
            bar.console.print(said, soft_wrap=True)

        engine.run(left, content.revision, fly, where, store, engine.CampaignWatcher(dashboard, count))
    failed = store.failures(items)
    flown = sum(store.is_done(address) for address in items)
    shell.print(
        f"{flown} of {len(items)} flights are in {store.flights}, {len(left)} of them tried now", soft_wrap=True
    )
    if failed:
        show(failures(failed))
        complain(f"{len(failed)} flights failed; {store.failed} has why. Again with --retry")
    shell.print(f"next: heft campaign report {store.directory}", soft_wrap=True)
    return FAILED if failed else OK


def _list(items: Mapping[str, "Item"], store: "Store") -> int:
    from onboard.ground.campaign.view import listed

    done = [address for address in items if store.is_done(address)]
    show(listed(items, done))
    console().print(f"{len(items)} flights, {len(done)} of them done")
    return OK


def _again(address: str, items: Mapping[str, "Item"], code: str) -> int:
    from dataclasses import replace

    named = [one for one in items if one.startswith(address)]
    if len(named) != 1:
        said = "no flight of this plan and version" if not named else f"{len(named)} flights"
        raise ValueError(f"--again {address}: {said}; heft campaign PLAN --list names them")
    item = items[named[0]]
    print(item.text)
    done = fly(replace(item, keep="all"), code)
    for end, data in done.kept.items():
        path = Path(f"{named[0]}{end}")
        path.write_bytes(data)
        print(path)
    if done.result is None:
        complain(done.error)
        return FAILED
    for one in done.result.answers:
        outcome = one.outcome(unseen=done.result.unseen)
        interval = f"{one.value:.6g} ({one.low:.6g} .. {one.high:.6g}) {one.unit}"
        print(f"{one.quantity}: {interval}, true {one.truth:.6g}: {outcome}")
    return OK


def _report(arguments: argparse.Namespace) -> int:
    from onboard.ground.campaign.statistics import by_level, summary
    from onboard.ground.campaign.store import Store
    from onboard.ground.campaign.view import failures, summed
    from onboard.ground.report import campaign

    if arguments.directory is None:
        raise ValueError("heft campaign report DIR: name the directory of the campaign")
    store = Store(arguments.directory)
    content = store.content()
    rows = store.rows(content.items)
    found, levels = summary(rows), {}
    if arguments.by is not None:
        levels = {f"{arguments.by} = {level}": of for level, of in by_level(rows, arguments.by).items()}
    for level, of in levels.items():
        console().print(level, soft_wrap=True)
        show(summed(of))
    show(summed(found))
    if failed := store.failures(content.items):
        show(failures(failed))
    write_json(arguments.json, found.as_json() | {"by": {level: of.as_json() for level, of in levels.items()}})
    output = arguments.output or arguments.directory / "report.html"
    campaign.write(found, content, store, output, levels)
    print(output)
    return OK if found.flights else FAILED
