"""Which rings a flight has: their records, their sizes, where they lie."""

import os
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from drivers import records
from onboard import config
from onboard.ring import RingReader, RingWriter

SECONDS_KEPT = 12.0
DEVICE_RECORDS: dict[str, np.dtype[np.void]] = {
    "mpu6050": records.IMU,
    "canopen_sync": records.CAN_SYNC,
    "cia406": records.SCALAR,
    "cia404": records.SCALAR,
    "canopen_object": records.SCALAR,
    "sync_pulse": records.PULSE,
    "recorded_imu": records.IMU,
    "recorded_rate": records.SCALAR,
}


def device_channels(vehicle: config.Vehicle) -> dict[str, np.dtype[np.void]]:
    """Channels that acquisition writes."""
    channels = {name: DEVICE_RECORDS[device.kind] for name, device in vehicle.file.device.items()}
    return {**channels, "event": records.EVENT, "gap": records.GAP}


def capacity(vehicle: config.Vehicle, channel: str) -> int:
    """Rows for at least :data:`SECONDS_KEPT` of a channel."""
    device = vehicle.file.device.get(channel)
    rate_hz = device.sample_rate_hz if isinstance(device, config.Mpu6050Device) else 200.0
    return int(SECONDS_KEPT * rate_hz)


def create(
    directory: Path, vehicle: config.Vehicle, channels: Mapping[str, np.dtype[np.void]]
) -> dict[str, RingWriter]:
    """Open the writing ends of ``channels`` in ``directory``, creating what is missing."""
    directory.mkdir(parents=True, exist_ok=True)
    return {
        name: RingWriter(directory / f"{name}.ring", dtype, capacity(vehicle, name)) for name, dtype in channels.items()
    }


def readers(directory: Path, channels: Iterable[str]) -> dict[str, RingReader]:
    """Open reading ends of ``channels`` from their first row."""
    return {name: RingReader(directory / f"{name}.ring") for name in channels}


def new_directory() -> Path:
    """A fresh directory for the rings of one flight, in shared memory where there is any."""
    memory = Path("/dev/shm")
    return Path(tempfile.mkdtemp(prefix="heft-", dir=memory if os.access(memory, os.W_OK) else None))
