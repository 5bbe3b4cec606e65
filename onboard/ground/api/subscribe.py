"""Rows of a flight that is running, for scripts of the same user on the same computer; it is not delayed by them."""

import time
from collections.abc import Iterator
from pathlib import Path

from drivers.records import Rows
from onboard.flight.store import directories, manifest
from onboard.ring import RingReader

LOOK_S = 0.02
_LOOKS = 25  # without rows, after which it is asked whether the flight is still there


def subscribe(channel: str = "quantity", log: str | Path | None = None) -> Iterator[Rows]:
    """New rows of one channel of a running flight, until it ends.

    Args:
        channel: ``quantity`` (every answer: name, value, low, high, level, supported), ``event_estimation``, ``row``,
            or a device's.
        log: of the flight; the newest that is running where None.

    Returns:
        Rows (n,) as recorded, each time that there are some. Of a reader that is late the oldest are left out: their
        ``sequence`` has a gap.

    Raises:
        ValueError: no such flight is running, or it has no such channel.
    """
    wanted = None if log is None else Path(log).absolute()
    flights = [flight for flight in manifest.running() if wanted in (None, flight.log)]
    if not flights:
        which = "no flight of yours is running" if log is None else f"no flight is recorded to {log}"
        raise ValueError(f"{which}; start heft fly first")
    directory = flights[-1].directory
    path = directory / f"{channel}.ring"
    if not path.is_file():
        known = ", ".join(sorted(one.stem for one in directory.glob("*.ring")))
        raise ValueError(f"the flight has no channel {channel!r}; its channels are {known}")
    reader = RingReader(path)
    reader.position = reader.published
    return _rows(reader, directory)


def _rows(reader: RingReader, directory: Path) -> Iterator[Rows]:
    looks = 0
    while True:
        rows, _ = reader.read()
        looks = 0 if len(rows) else looks + 1
        if len(rows):
            yield rows
        elif looks % _LOOKS == 0 and (not directory.is_dir() or directories.is_free(directory)):
            return
        else:
            time.sleep(LOOK_S)
