"""Writes a calibration into vehicle.toml: comments and order stay, each value has its sigma behind it."""

import difflib
import os
import re
import stat
import tempfile
from collections.abc import Iterable, MutableMapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import Comment, Item

from onboard import config
from onboard.flight.estimate.problem.identification import build_online
from onboard.ground.calibrate.result import KeyChange

_OURS = re.compile(r"(; )?\+- [^;]* \(1 sigma\)$")  # of an earlier calibration


def changed(vehicle: config.Vehicle, changes: Iterable[KeyChange]) -> str:
    """The text of the vehicle file with some keys changed or added.

    Raises:
        ConfigError: the file would not be a vehicle's any more.
    """
    text = edited(vehicle, changes)
    build_online(config.parse(text, vehicle.path, vehicle.urdf))
    return text


def edited(vehicle: config.Vehicle, changes: Iterable[KeyChange]) -> str:
    """The same, without looking whether it is a vehicle's.

    Raises:
        ConfigError: the text cannot be edited.
    """
    try:
        document = tomlkit.parse(vehicle.text)
        for one in changes:
            _put(document, one)
        return tomlkit.dumps(document)
    except TOMLKitError as error:
        raise config.ConfigError(f"{vehicle.label} cannot be edited: {error}; write the values by hand") from error


def difference(vehicle: config.Vehicle, text: str) -> str:
    """What changes, as a unified diff."""
    before, after = vehicle.text.splitlines(keepends=True), text.splitlines(keepends=True)
    return "".join(difflib.unified_diff(before, after, vehicle.label, "calibrated", n=1))


def require_writable(vehicle: config.Vehicle) -> None:
    """Refuse a file that cannot be written, before anybody has worked for it.

    Raises:
        ConfigError: it is one of heft's own.
        PermissionError: it is read-only.
    """
    path = vehicle.path.resolve()
    if config.packaged(path.parent.name).resolve() == path:
        name = path.parent.name
        raise config.ConfigError(
            f"{name} comes with heft and is not written to: heft init DIR --from {name}, then calibrate DIR/{path.name}"
        )
    if not path.stat().st_mode & stat.S_IWUSR or not os.access(path, os.W_OK):
        raise PermissionError(13, "read-only", str(vehicle.path))


def replace(vehicle: config.Vehicle, text: str) -> None:
    """Put the new text in the file's place, whole or not at all.

    Raises:
        OSError: it cannot be written; the file is as it was.
    """
    require_writable(vehicle)
    path = vehicle.path.resolve()
    if path.read_text(encoding="utf-8") != vehicle.text:
        raise config.ConfigError(f"{vehicle.label} was changed meanwhile and is left as it is; calibrate again")
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    new = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        new.chmod(stat.S_IMODE(path.stat().st_mode))
        new.replace(path)
    except BaseException:
        new.unlink(missing_ok=True)
        raise


def _put(document: MutableMapping[str, Any], change: KeyChange) -> None:
    table = document
    for part in change.table:
        if part not in table and change.value is None:
            return
        if part not in table:
            table[part] = tomlkit.table()
        table = table[part]
    if change.value is None:
        table.pop(change.key, None)
        return
    before = table.get(change.key)
    kept = _comment(before)
    if kept and "(was " not in kept and before != change.value:
        kept += f" (was {before})"
    table[change.key] = change.value
    item = table[change.key]
    told = "; ".join(filter(None, (kept, change.sigma and f"+- {change.sigma} (1 sigma)")))
    if isinstance(item, Item) and (told or item.trivia.comment):
        item.comment(told) if told else _uncomment(item)


def _comment(item: Any) -> str:
    """The comment that a person wrote behind a value."""
    text = item.trivia.comment if isinstance(item, Item) and not isinstance(item, Comment) else ""
    return _OURS.sub("", text.lstrip("# ")).strip()


def _uncomment(item: Item) -> None:
    item.trivia.comment = item.trivia.comment_ws = ""
