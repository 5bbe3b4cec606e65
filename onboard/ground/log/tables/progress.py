"""Progress of a command that reads a log: how far the present pass over it has come."""

from collections.abc import Callable

from rich.progress import Progress

from onboard.recording.reader import LogReader


def reporter(progress: Progress | None, title: str, total: int) -> Callable[[int], None]:
    """Add a task; returns what is to be told how much of ``total`` is done."""
    if progress is None:
        return lambda completed: None
    task = progress.add_task(title, total=total)
    return lambda completed: progress.update(task, completed=completed)


def follow(progress: Progress | None, what: str, log: LogReader) -> Callable[[], None]:
    """Add a task for one pass over ``log``; returns what is to be called now and then meanwhile."""
    tell = reporter(progress, f"{what} {log.path.name}", log.size)
    return lambda: tell(log.position)
