"""Arguments of benches that name a directory, a log or a vehicle.

Each is looked at before anything is measured: a wrong one is a sentence and exit code 2, where 1 is a missed bar.
"""

import os
from argparse import ArgumentTypeError
from collections.abc import Callable
from pathlib import Path

from hil_sim.scenario import bed, load
from onboard import config
from onboard.ground.campaign.store import Store
from onboard.recording.format.errors import LogFormatError
from onboard.recording.reader import LogReader

DATASETS = os.environ.get("HEFT_DATASETS", "../shared/datasets")


def directory_with(*patterns: str) -> Callable[[str], Path]:
    """The type of a directory that holds a file of each pattern."""

    def given(text: str) -> Path:
        path = Path(text)
        for pattern in patterns:
            if not any(path.glob(pattern)):
                raise ArgumentTypeError(f"{path} holds no {pattern}; give another directory")
        return path

    return given


def campaign(text: str) -> Path:
    """The type of a campaign's directory."""
    try:
        Store(Path(text)).content()
    except ValueError as error:
        raise ArgumentTypeError(str(error)) from error
    return Path(text)


def log(text: str) -> Path:
    """The type of a flight's log."""
    if not Path(text).is_file():
        raise ArgumentTypeError(f"there is no file {text}")
    try:
        LogReader(Path(text))
    except (OSError, LogFormatError) as error:
        raise ArgumentTypeError(str(error)) from error
    return Path(text)


def flown_log(text: str) -> Path:
    """The type of a virtual flight's log, with its truth beside it."""
    truth = Path(f"{log(text)}.truth.json")
    if not truth.is_file():
        raise ArgumentTypeError(f"there is no {truth}; give a log of heft hil, its truth beside it")
    return Path(text)


def rehearsed() -> tuple[str, ...]:
    """The packaged vehicles that have a scenario of their name."""
    return tuple(sorted({*load.names(), *bed.names()}))


def vehicle(text: str) -> str:
    """The type of a vehicle: its file, or a packaged one's name."""
    try:
        config.named(text)
    except config.ConfigError as error:
        raise ArgumentTypeError(str(error)) from error
    return text
