"""True values of a simulated flight: the file ``LOG.truth.json`` beside the log.

The simulator writes it after the flight; no flight code reads it, and a real flight has none.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from onboard.recording.space import naming

Truth = dict[str, Any]


def beside(log: Path) -> Path:
    """Path of the truth file of ``log``."""
    return log.with_name(f"{log.name}.truth.json")


def write(log: Path, truth: Truth) -> None:
    """Write ``truth`` (scalars, text, lists, arrays and maps of them) beside ``log``."""
    with naming(path := beside(log)):
        path.write_text(json.dumps(truth, indent=1, default=_plain) + "\n", encoding="utf-8")


def read(log: Path) -> Truth | None:
    """The truth of ``log``; None if there is no file.

    Raises:
        ValueError: the file is not a JSON object.
    """
    path = beside(log)
    if not path.exists():
        return None
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is no JSON ({error}); remove it, and the log is read without a truth") from error
    if not isinstance(found, dict):
        raise ValueError(f"{path} holds no JSON object; remove it, and the log is read without a truth")
    return found


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no JSON; give a number, text, list, array or map")
