"""Reads settings: text of a bounded size from a regular file, and the tables of a TOML text of bounded nesting."""

import stat
import tomllib
from pathlib import Path
from typing import Any

from onboard.config.errors import ConfigError

MOST_BYTES = 1 << 20  # the longest packaged vehicle has 9 kB
MOST_BYTES_URDF = 16 << 20
DEEPEST = 32  # tables and arrays within one another


def read(path: Path, what: str = "a vehicle.toml", most_bytes: int = MOST_BYTES) -> str:
    """The text of a file.

    Args:
        path: of the file.
        what: it should be, for messages.
        most_bytes: longest text.

    Raises:
        ConfigError: no such file, a pipe or a device, too long, or not UTF-8.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise ConfigError(f"{path} is no file, but a directory, a pipe or a device; give the path of {what}")
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give the path of {what}") from error
    if len(data) > most_bytes:
        raise ConfigError(f"{path} has more than {most_bytes >> 20} MiB; give the path of {what}")
    try:
        return data.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} is not UTF-8 text (byte {error.start}); save it as UTF-8") from error


def tree_of(text: str, label: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises:
        ConfigError: it is no TOML, or nested too deep; the message begins with ``label``.
    """
    try:
        tree = tomllib.loads(text)
    except RecursionError as error:
        raise ConfigError(f"{label}: tables or arrays are nested too deep; {DEEPEST} is the most") from error
    except ValueError as error:  # not TOML, or an integer of thousands of digits
        raise ConfigError(f"{label}: not TOML: {error}") from error
    if _depth(tree) > DEEPEST:
        raise ConfigError(f"{label}: tables or arrays are nested too deep; {DEEPEST} is the most")
    return tree


def laid_over(tree: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """``tree`` with what ``other`` says in its place, table by table."""
    made = dict(tree)
    for key, value in other.items():
        both = isinstance(value, dict) and isinstance(tree.get(key), dict)
        made[key] = laid_over(tree[key], value) if both else value
    return made


def _depth(tree: dict[str, Any]) -> int:
    level: list[Any] = [tree]
    depth = 0
    while level and depth <= DEEPEST:
        depth += 1
        inside = [part for node in level for part in (node.values() if isinstance(node, dict) else node)]
        level = [part for part in inside if isinstance(part, dict | list)]
    return depth
