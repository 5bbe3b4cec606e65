"""What the commands share: exit codes, the console, warnings."""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

    from onboard import config

OK, FAILED, BAD_INPUT, DAMAGED, NOT_READY = 0, 1, 2, 3, 4


def console() -> "Console":
    """Where tables go."""
    from rich.console import Console

    return Console()


def progress(*, to_stderr: bool = False) -> "Progress":
    """A progress bar that is gone when done, and nothing at all where no terminal shows it."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    where = Console(stderr=to_stderr)
    percent = TextColumn("{task.percentage:3.0f} %")
    columns = (TextColumn("{task.description}"), BarColumn(), percent, TimeRemainingColumn())
    return Progress(*columns, console=where, transient=True, disable=not where.is_terminal)


def next_log(directory: str, name: str) -> Path:
    """The first free ``NAME-NNN.mcap``."""
    return next(path for n in range(1, 100_000) if not (path := Path(directory) / f"{name}-{n:03d}.mcap").exists())


def load_vehicle(name: str) -> "config.Vehicle":
    """A vehicle by the path of its file, or by the name of a packaged one."""
    from onboard import config

    return config.load(Path(name) if name.endswith(".toml") else config.packaged(name))


def complain(text: object) -> None:
    """Say why a command failed."""
    sys.stderr.write(f"heft: {text}\n")


def warn(damage: Iterable[object]) -> None:
    """Say what of the input could not be read."""
    for one in damage:
        sys.stderr.write(f"heft: warning: {one}\n")


def worst(codes: Sequence[int]) -> int:
    """The exit code of several logs together: failed before damaged before whole."""
    return FAILED if FAILED in codes else max(codes, default=OK)
