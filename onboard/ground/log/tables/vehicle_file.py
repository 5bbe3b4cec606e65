"""Reads the vehicle file attached to a log."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from onboard import config
from onboard.flight.store.flight_log import VEHICLE_ATTACHMENT
from onboard.recording.format.errors import ChannelError
from onboard.recording.reader import LogReader

MOST_NAME_BYTES = 255  # of a file, by Linux


def vehicle_of(log: LogReader, directory: Path) -> config.Vehicle:
    """The vehicle a log was flown with; its attached files are written to ``directory``.

    Raises:
        ConfigError: the attachments are missing or cannot be used.
    """
    if VEHICLE_ATTACHMENT not in log.attachments:
        raise config.ConfigError(f"{log.path} carries no vehicle file; give the vehicle that flew with --vehicle")
    for name, attachment in log.attachments.items():
        if _is_file_name(name):
            (directory / name).write_bytes(attachment.data)
    try:
        return config.load(directory / VEHICLE_ATTACHMENT)
    except config.ConfigError as error:  # no vehicle directory of that name
        raise config.ConfigError(str(error).replace(f"{directory}/", f"{log.path}: its ")) from error


def require_kinds(log: LogReader, vehicle: config.Vehicle) -> None:
    """Raises ChannelError where rows of a log's channel are not of the kind that the vehicle's device gives."""
    wanted = vehicle.channels.items()
    if other := [name for name, dtype in wanted if log.channels.get(name, dtype) != dtype]:
        what = f"another kind of rows in {', '.join(other)} than the vehicle gives"
        raise ChannelError(f"{log.path} has {what}; give the vehicle that it was flown with")


def _is_file_name(name: str) -> bool:
    """Whether a file of that name lies in the directory it is written to, and not beside it."""
    return name not in ("", ".", "..") and "/" not in name and len(name.encode()) <= MOST_NAME_BYTES


def attached_vehicle(log: LogReader) -> config.Vehicle:
    """The vehicle of a log, without the files it refers to.

    Raises:
        ConfigError: as :func:`vehicle_of`.
    """
    with tempfile.TemporaryDirectory() as directory:
        return vehicle_of(log, Path(directory))


def urdf_of(log: LogReader, vehicle: config.Vehicle) -> str:
    """The URDF of ``vehicle``: beside its file, or attached to ``log`` where the file was too.

    Raises:
        ConfigError: it is in neither place.
    """
    if vehicle.urdf_path.exists():
        return vehicle.urdf_text
    attached = log.attachments.get(vehicle.file.vehicle.urdf)
    if attached is None:
        raise config.ConfigError(f"{vehicle.file.vehicle.urdf} is neither beside its vehicle file nor in {log.path}")
    try:
        return attached.data.decode()
    except UnicodeDecodeError as error:
        raise config.ConfigError(f"{log.path}: its {attached.name} is not UTF-8 text; give the vehicle") from error


def flown_by(logs: Sequence[LogReader], directory: Path) -> config.Vehicle:
    """The vehicle that all of ``logs`` carry, its attached files laid out in ``directory``.

    Raises:
        ConfigError: none is carried that can be used, or not the same one by all.
    """
    for log in logs:
        if VEHICLE_ATTACHMENT not in log.attachments:
            raise config.ConfigError(f"{log.path} carries no vehicle file; give the vehicle that flew")
        if log.attachments[VEHICLE_ATTACHMENT].data != logs[0].attachments[VEHICLE_ATTACHMENT].data:
            raise config.ConfigError(
                f"{log.path} and {logs[0].path} were flown with different vehicle files; give the file to use"
            )
    return vehicle_of(logs[0], directory)
