"""Reads settings: text of a bounded size from a regular file, and the tables of a TOML text of bounded nesting."""

import contextlib
import re
import stat
import tomllib
from pathlib import Path
from typing import Any
from xml.parsers import expat

from onboard.config.errors import ConfigError

MOST_BYTES = 1 << 20  # the longest packaged vehicle has 9 kB
MOST_BYTES_URDF = 16 << 20
DEEPEST = 32  # tables and arrays within one another
MOST_KEYS = 1000  # of a table: a process has 1024 files open at the most (RLIMIT_NOFILE), and a device one at least
MOST_ATTRIBUTES = 64  # of an element; a URDF's has 6 at the most
_PART = r"""(?:[A-Za-z0-9_-]++|"[^"\n]*+"|'[^'\n]*+')"""
# before it is parsed, as the parser takes time by the square of a key's parts, and memory with it
_TOO_DEEP = re.compile(rf"(?<![A-Za-z0-9_-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST},}}")


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


def read_urdf(path: Path) -> str:
    """The text of a URDF.

    Raises:
        ConfigError: as :func:`read`; an element has so many attributes that its parser takes minutes.
    """
    text = read(path, "the vehicle's URDF", MOST_BYTES_URDF)
    parser = expat.ParserCreate()
    parser.ordered_attributes = True

    def start(name: str, attributes: list[str]) -> None:
        if len(attributes) > 2 * MOST_ATTRIBUTES:
            what = f"<{name[:64]}> has {len(attributes) // 2} attributes; {MOST_ATTRIBUTES} is the most"
            raise ConfigError(f"{path}:{parser.CurrentLineNumber}: {what}")

    parser.StartElementHandler = start
    with contextlib.suppress(expat.ExpatError):  # reported by the full reader
        parser.Parse(text, True)
    return text


def tree_of(text: str, label: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises:
        ConfigError: it is no TOML, nested too deep, or a table has too many keys; the message begins with ``label``.
    """
    if deep := _TOO_DEEP.search(text):
        line = text.count("\n", 0, deep.start()) + 1
        raise ConfigError(f"{label}:{line}: tables or arrays are nested too deep; {DEEPEST} is the most")
    try:
        tree = tomllib.loads(text)
    except RecursionError as error:
        raise ConfigError(f"{label}: tables or arrays are nested too deep; {DEEPEST} is the most") from error
    except ValueError as error:  # not TOML, or an integer of thousands of digits
        raise ConfigError(f"{label}: not TOML: {error}") from error
    _require_bounded(tree, label)
    return tree


def laid_over(tree: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """``tree`` with its values replaced by those of ``other``, table by table."""
    made = dict(tree)
    for key, value in other.items():
        both = isinstance(value, dict) and isinstance(tree.get(key), dict)
        made[key] = laid_over(tree[key], value) if both else value
    return made


def _require_bounded(tree: dict[str, Any], label: str) -> None:
    level: list[Any] = [tree]
    for _ in range(DEEPEST):
        if large := next((node for node in level if isinstance(node, dict) and len(node) > MOST_KEYS), None):
            raise ConfigError(
                f"{label}: a table has {len(large)} keys, of {next(iter(large))!r}; {MOST_KEYS} is the most"
            )
        inside = [part for node in level for part in (node.values() if isinstance(node, dict) else node)]
        level = [part for part in inside if isinstance(part, dict | list)]
        if not level:
            return
    raise ConfigError(f"{label}: tables or arrays are nested too deep; {DEEPEST} is the most")
