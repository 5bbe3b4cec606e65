"""Progress of a command that reads a log: how far the present pass over it has come."""

from collections.abc import Callable

from rich.progress import Progress

from onboard.recording.reader import LogReader


def follow(progress: Progress | None, what: str, log: LogReader) -> Callable[[], None]:
    """Add a task for one pass over ``log``; returns what is to be called now and then meanwhile."""
    if progress is None:
        return lambda: None
    task = progress.add_task(f"{what} {log.path.name}", total=log.size)
    return lambda: progress.update(task, completed=log.position)
