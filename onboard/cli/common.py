"""Common parts of the commands: exit codes, console, warnings, shared options."""

import glob
import json
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.progress import Progress

    from onboard import config
    from onboard.page.web import Source

Commands = Any  # argparse keeps the type of what add_subparsers returns to itself

OK, FAILED, BAD_INPUT, DAMAGED, NOT_READY = 0, 1, 2, 3, 4
UNAVAILABLE = 69  # sysexits.h, EX_UNAVAILABLE


_MOST_SAID = 10_000  # characters
_WIDER = (100, 120, 160, 240, 400)  # columns, one after the other, until every number is whole


def console() -> "Console":
    """Console of texts and live views."""
    from rich.console import Console

    return Console(markup=False, emoji=False)  # what a file says is shown, not obeyed


def show(shown: "RenderableType") -> None:
    """Print ``shown``. Numbers are never cut or broken: a table that does not fit the terminal, or a pipe, is wider."""
    from rich.console import Group

    if isinstance(shown, Group):  # what stands beside such a table is not
        for part in shown.renderables:
            show(part)
        return
    shell = console()
    _keep_numbers_whole(shown)
    for width in (shell.width, *(wider for wider in _WIDER if wider > shell.width)):
        shell.width = width
        with shell.capture() as caught:
            shell.print(shown)
        if _CUT not in caught.get():
            break
    shell.print(shown, crop=False, soft_wrap=False)


_CUT = "\N{HORIZONTAL ELLIPSIS}"


def _keep_numbers_whole(shown: object) -> None:
    """Right-aligned columns of numbers, not wrapped; rich cuts with ``_CUT`` where they do not fit."""
    from rich.console import Group
    from rich.table import Table

    if isinstance(shown, Table):
        for column in shown.columns:
            column.no_wrap = column.no_wrap or column.justify == "right"
            for cell in column.cells:
                _keep_numbers_whole(cell)
    elif isinstance(shown, Group):
        for part in shown.renderables:
            _keep_numbers_whole(part)


def progress(*, threads: bool = True) -> "Progress":
    """Progress on stderr: a bar that is removed when done; a line after 2 s and then each 5 s without a terminal.

    Args:
        threads: lines come also while nothing is updated; without, the process keeps its one thread.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from onboard.cli.lines import ProgressLines

    where = Console(stderr=True, markup=False, emoji=False)
    if not where.is_terminal:
        return ProgressLines(threads=threads)
    percent = TextColumn("{task.percentage:3.0f} %")
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), percent, TimeRemainingColumn())
    return Progress(*columns, console=where, transient=True)


@contextmanager
def busy(what: str) -> Iterator[Callable[[str], None]]:
    """Shows what is being done and for how long, where nobody can say how much is left; call it with what follows."""
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    shown = progress()
    if shown.console.is_terminal:
        columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
        shown = Progress(*columns, console=shown.console, transient=True)
    with shown as bar:
        task = bar.add_task(what, total=None)
        yield lambda then: bar.update(task, description=then)


def next_log(directory: str, name: str) -> Path:
    """The first ``NAME-NNN.mcap`` without a segment that is there, and that no flight whose rings wait for it has."""
    from onboard.flight.store import manifest

    taken = {flight.log for flight in manifest.waiting()}
    paths = (Path(directory) / f"{name}-{n:03d}.mcap" for n in range(1, 100_000))

    def free(path: Path) -> bool:  # the oldest segments of a flight are the first to be removed
        later = path.parent.glob(f"{glob.escape(path.stem)}_*{path.suffix}")
        return not os.path.lexists(path) and path.absolute() not in taken and not any(later)

    return next(path for path in paths if free(path))


def add_json(command: Any) -> None:
    """The option ``--json`` of a command that answers."""
    told = "also write the result as JSON; -: to stdout, and the words to stderr"
    command.add_argument("--json", type=Path, metavar="FILE", help=told)


def write_json(where: Path | TextIO | None, result: object) -> None:
    """Write what was found as JSON; nothing without ``--json``. A number that is not finite is null."""
    text = json.dumps(_plain(result), indent=1, allow_nan=False) + "\n"
    if isinstance(where, Path):
        from onboard.recording.space import naming

        with naming(where):
            where.write_text(text, encoding="utf-8")
    elif where is not None:
        where.write(text)


def _plain(value: Any) -> Any:
    """Named tuples as objects, arrays as lists, anything else that JSON does not know as its text."""
    if hasattr(value, "_asdict"):
        return _plain(value._asdict())
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):  # of NumPy
        return _plain(value.tolist())
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def load_vehicle(name: str, urdf: Path | None = None) -> "config.Vehicle":
    """Loads a vehicle by file path or packaged name, with another URDF if given."""
    from onboard import config

    return config.named(name, urdf)


def complain(text: object) -> None:
    """Print the reason of a failure; of a file's long text not all."""
    said = str(text)
    more = f" ... and {len(said) - _MOST_SAID} more characters" if len(said) > _MOST_SAID else ""
    sys.stderr.write(f"heft: {said[:_MOST_SAID]}{more}\n")


def warn(damage: Iterable[object]) -> None:
    """Print a warning for each damaged part of the input."""
    for one in damage:
        sys.stderr.write(f"heft: warning: {one}\n")


def worst(codes: Sequence[int]) -> int:
    """Common exit code of several logs: failed before damaged before intact."""
    return FAILED if FAILED in codes else max(codes, default=OK)


def add_page(command: Any, shows: str = "the flight") -> None:
    """The options ``--page``, ``--page-address`` and ``--page-plan``."""
    command.add_argument(
        "--page", action="store_true", help=f"show {shows} on a page for a browser of this computer; prints its address"
    )
    command.add_argument(
        "--page-address",
        metavar="HOST:PORT",
        help="serve the page there (default 127.0.0.1:8787); other computers need the token in the printed address",
    )
    command.add_argument(
        "--page-plan",
        type=Path,
        metavar="FILE",
        help="show beside each interval what this plan expects (plan.json of heft plan)",
    )


def add_flying(command: Any) -> None:
    """The options of a command that flies: what it asks for, who may look on, what it hands over."""
    command.add_argument(
        "--until",
        metavar="GOAL",
        help='ask for motions until half of the 95 %% intervals are so narrow: "mass 1 %%, centre 5 mm"',
    )
    command.add_argument(
        "--segments", type=Path, metavar="FILE", help="the motions to ask for (heft plan --segments), for --until"
    )
    command.add_argument(
        "--live",
        nargs="?",
        const="127.0.0.1:8765",
        metavar="HOST:PORT",
        help="serve the flight to Foxglove or Lichtblick by WebSocket (default ws://127.0.0.1:8765)",
    )
    add_page(command)
    command.add_argument(
        "--telemetry",
        metavar="LINK",
        help="send CCSDS packets to udp://HOST:PORT, serial:///dev/ttyS0?baud=19200 or file://PATH (docs/ground.md)",
    )
    command.add_argument(
        "--hand-over",
        type=Path,
        metavar="FILE",
        help="keep the URDF with the identified payload there while all its numbers are good (docs/hand_over.md)",
    )


def page_address(arguments: Any) -> str | None:
    """Where the page is wanted, checked; empty: anywhere on this computer. None: no page.

    Raises:
        ValueError: not an address.
    """
    if arguments.page_address is None:
        return "" if arguments.page or arguments.page_plan else None
    from onboard.page import address

    address.parse(arguments.page_address)
    return str(arguments.page_address)


def say_page(url: str, *, json_lines: bool = False) -> None:
    """Print the page's address on stderr: what else a flight says there may be switched off."""
    said = json.dumps({"level": "info", "code": "page", "text": url}) if json_lines else f"heft: page at {url}"
    sys.stderr.write(f"{said}\n")
    sys.stderr.flush()


def show_page(arguments: Any, address: str, source: "Source", urdf: Path | None = None) -> None:
    """Serve the page of ``source`` until ^C, or until the flight that it is of has ended.

    Args:
        arguments: of a command with the options of :func:`add_page`.
        address: checked, see :func:`page_address`.
        source: a log, or a flight.
        urdf: beside which meshes lie.

    Raises:
        ValueError: the address is not available.
    """
    import asyncio

    from onboard.page import address as addresses
    from onboard.page.process import serve

    try:
        with suppress(KeyboardInterrupt):
            asyncio.run(serve(source, addresses.parse(address), say_page, arguments.page_plan, urdf=urdf))
    except OSError as error:
        place = address or addresses.DEFAULT_HOST
        raise ValueError(f"--page-address {place}: {error.strerror or error}; give another address") from error


@contextmanager
def _serve_page(arguments: Any, log: Path, vehicle: "config.Vehicle") -> Iterator[None]:
    """The page process of ``--page`` while a flight to ``log`` lasts; none without the option.

    Raises:
        ValueError: the address is not available.
    """
    address = page_address(arguments)
    if address is None:
        yield
        return
    from onboard.page.process import serving

    with serving(log, address, arguments.page_plan, vehicle.file.telemetry.commands, vehicle.urdf_path) as url:
        say_page(url, json_lines=getattr(arguments, "json_lines", False))
        yield


def with_hand_over(vehicle: "config.Vehicle", path: Path | None) -> "config.Vehicle":
    """A vehicle whose flight hands over its payload in a file; the same where there is no path."""
    return vehicle if path is None else vehicle.model_copy(update={"hand_over": path.absolute()})


def _serve_live(address: str | None, log: Path) -> AbstractContextManager[int | None]:
    """The live server of ``--live``; none without the option.

    Raises:
        ValueError: the Foxglove SDK is not installed.
    """
    if address is None:
        return nullcontext()
    try:
        from onboard.live.process import serving
    except ImportError as error:
        raise ValueError(f"--live needs the Foxglove SDK ({error}): pip install 'heft-flight[live]'") from error
    return serving(log, address)


def _send_telemetry(link: str | None, log: Path, vehicle: "config.Vehicle") -> AbstractContextManager[None]:
    """The process of ``--telemetry``; none without the option.

    Raises:
        ValueError: the link is none, or the library of the packets is not installed.
    """
    if link is None:
        return nullcontext()
    try:
        from onboard.telemetry.process import sending
    except ImportError as error:
        raise ValueError(f"--telemetry needs spacepackets ({error}): pip install 'heft-flight[telemetry]'") from error
    return sending(log, link, vehicle.file.telemetry)


@contextmanager
def shown(arguments: Any, log: Path, vehicle: "config.Vehicle") -> Iterator[None]:
    """All that shows a flight to ``log`` while it lasts, by the options of :func:`add_flying`.

    Raises:
        ValueError: an address or a link is none or not available, or a library is not installed.
    """
    with (
        _serve_live(arguments.live, log),
        _serve_page(arguments, log, vehicle),
        _send_telemetry(arguments.telemetry, log, vehicle),
    ):
        yield


def bus_and_url(text: str, option: str = "--url") -> tuple[str, str]:
    """``BUS=URL`` of ``option``, taken apart.

    Raises:
        ValueError: there is no equals sign.
    """
    bus, separator, url = text.partition("=")
    if not separator:
        raise ValueError(f"{option} {text}: write BUS=URL, e.g. can_0=can+socketcan://can0?bitrate=500000")
    return bus, url


def with_urls(vehicle: "config.Vehicle", said: Iterable[str]) -> "config.Vehicle":
    """A vehicle with the bus URLs that ``--url`` says.

    Raises:
        ValueError: not BUS=URL, no such bus, or a URL that its devices cannot be on.
    """
    from onboard import config

    return config.with_urls(vehicle, dict(bus_and_url(text) for text in said))


def show_foreseen(vehicle: "config.Vehicle", planned: Any, motion: str) -> list[dict[str, Any]]:
    """Print what a planned motion determines; the same as JSON values, none where it is not known.

    Args:
        vehicle: what flies.
        planned: the motion, by the simulator.
        motion: whose it is, in words.
    """
    from onboard.ground.before.foresee import foreseen
    from onboard.ground.before.foresee.foresee import foresee
    from onboard.ground.before.foresee.kept import kept
    from onboard.ground.before.foresee.plan import plan_of

    try:
        plan = plan_of(vehicle, planned)
        found = kept(vehicle, plan, lambda: foresee(vehicle, plan))
    except ValueError as error:
        console().print(f"what {motion} determines is not known: {error}")
        return []
    show(foreseen.render(found, motion))
    return [one._asdict() for one in (*found.quantities, *found.parameters)]
