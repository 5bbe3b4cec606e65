"""``heft.identify``: the onboard estimator on logs."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from threadpoolctl import threadpool_limits

from onboard import config
from onboard.ground.api.flight_log import FlightLog, vehicle_named
from onboard.ground.identify import identify as again
from onboard.ground.log.tables.vehicle_file import flown_by
from onboard.recording.reader import LogReader

Source = str | Path | FlightLog


def identify(
    logs: Source | Sequence[Source],
    vehicle: str | Path | config.Vehicle | None = None,
    method: Literal["rows", "exiddm"] | None = None,
) -> again.Identification:
    """Identify from logs, as ``heft identify`` does.

    Args:
        logs: one log or several, by path or opened.
        vehicle: that flew: a vehicle file, the name of a packaged vehicle, or one that is loaded; the one that the
            logs carry where None.
        method: by rows, or by maximum likelihood; the vehicle file's where None.

    Raises:
        LogFormatError: a file that is no log.
        ChannelError: a log of another vehicle.
        ConfigError: no vehicle is known, or it does not fit.
    """
    several = [logs] if isinstance(logs, str | Path | FlightLog) else logs
    paths = [log.path if isinstance(log, FlightLog) else Path(log) for log in several]
    with tempfile.TemporaryDirectory() as directory, threadpool_limits(1, user_api="blas"):  # as onboard.cli.main
        flown = vehicle_named(vehicle) or flown_by([LogReader(path) for path in paths], Path(directory))
        return again.identify(again.by_method(flown, method) if method else flown, paths)
