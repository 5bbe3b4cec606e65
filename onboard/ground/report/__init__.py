"""``heft report``: a flight as one self-contained HTML page (light, dark, print)."""

from collections.abc import Mapping
from pathlib import Path

from rich.progress import Progress

from drivers.records import Rows
from onboard import config
from onboard.ground.drawing import html, theme
from onboard.ground.report.flight import figures
from onboard.ground.report.flight.flight_data import gather
from onboard.ground.report.flight.sections import document
from onboard.recording.format.scan import Damage


def report(
    log: Path, output: Path, progress: Progress | None = None, vehicle: config.Vehicle | None = None
) -> tuple[Damage, ...]:
    """Write the page of ``log`` to ``output``; returns the damage of the log.

    Args:
        log: its path.
        output: the page.
        progress: gets tasks that count the bytes of the log.
        vehicle: that flew; the one that the log carries where None.

    Raises:
        LogFormatError: not a heft log.
        OSError: a file cannot be read or written.
    """
    flight = gather(log, progress, vehicle)
    if progress is not None:
        progress.add_task(f"draw {output.name}", total=None)
    html.write(output, document(flight))
    return flight.info.damage


def clock_plot(said: Mapping[str, Rows], start_ns: int, duration_s: float, output: Path) -> None:
    """Plot each clock's residuals, rate and state over the flight; the suffix of ``output`` selects the format.

    Args:
        said: CLOCK rows by clock.
        start_ns: host time that the axis counts from.
        duration_s: of the flight.
        output: the file to write.

    Raises:
        ValueError: no clock, or unknown suffix.
        OSError: the file cannot be written.
    """
    with theme.figures():
        figure = figures.clocks(said, start_ns, duration_s)
        if figure is None:
            raise ValueError("the log has no clock: nothing of it runs on sync pulses, so there is nothing to plot")
        figure.savefig(output, dpi=150, facecolor=theme.COLOUR["paper"])
