"""Which rings a flight has: their records, their sizes, where they lie."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from drivers import records
from onboard import config
from onboard.ring import RingReader, RingWriter

SECONDS_KEPT = 12.0
OTHERS_HZ = 200.0  # channels that no device makes, and events
FEWEST_ROWS = 256


def device_channels(vehicle: config.Vehicle) -> dict[str, np.dtype[np.void]]:
    """Channels that acquisition writes."""
    return {**vehicle.channels, "event": records.EVENT, "gap": records.GAP}


def capacities(vehicle: config.Vehicle) -> dict[str, int]:
    """Rows for at least :data:`SECONDS_KEPT` of each device channel, by its device's nominal rate."""
    return {
        channel: max(FEWEST_ROWS, int(SECONDS_KEPT * vehicle.rate_hz(name)))
        for name, device in vehicle.file.device.items()
        for channel in device.channels(name)
    }


def create(
    directory: Path,
    vehicle: config.Vehicle,
    channels: Mapping[str, np.dtype[np.void]],
    rates_hz: Mapping[str, float] | None = None,
) -> dict[str, RingWriter]:
    """Open the writing ends of ``channels`` in ``directory``, creating what is missing.

    Args:
        directory: of one flight.
        vehicle: its devices say how often their channels come.
        channels: records by channel.
        rates_hz: how often channels of no device come, where :data:`OTHERS_HZ` is not right.
    """
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    told = {channel: max(FEWEST_ROWS, int(SECONDS_KEPT * rate)) for channel, rate in (rates_hz or {}).items()}
    rows = told | capacities(vehicle)
    others = int(SECONDS_KEPT * OTHERS_HZ)
    return {
        name: RingWriter(directory / f"{name}.ring", dtype, rows.get(name, others)) for name, dtype in channels.items()
    }


def readers(directory: Path, channels: Iterable[str]) -> dict[str, RingReader]:
    """Open reading ends of ``channels`` from their first row."""
    return {name: RingReader(directory / f"{name}.ring") for name in channels}
