"""Reads the vehicle file attached to a log."""

import tempfile
from pathlib import Path

from onboard import config
from onboard.flight.flight_log import VEHICLE_ATTACHMENT
from onboard.recording.reader import LogReader


def vehicle_of(log: LogReader, directory: Path) -> config.Vehicle:
    """The vehicle a log was flown with; its attached files are written to ``directory``.

    Raises:
        ConfigError: the attachments are missing or cannot be used.
    """
    for name, attachment in log.attachments.items():
        (directory / Path(name).name).write_bytes(attachment.data)
    return config.load(directory / VEHICLE_ATTACHMENT)


def attached_vehicle(log: LogReader) -> config.Vehicle:
    """The vehicle of a log, without the files it refers to.

    Raises:
        ConfigError: as :func:`vehicle_of`.
    """
    with tempfile.TemporaryDirectory() as directory:
        return vehicle_of(log, Path(directory))
