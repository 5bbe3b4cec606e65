"""Tables of numbers as people write them: text with or without names, arrays, messages; several side by side.

A cell that is no number is NaN and spoils its row only; a row of another length is NaN throughout. Both are counted by
who uses them.
"""

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.ground.calibrate.weigh.errors import PosesError
from onboard.ground.log.bring_in import foreign
from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.guess.sniff import kind_of
from onboard.ground.log.bring_in.mapping import Csv
from onboard.ground.log.bring_in.messages import TIMES
from onboard.ground.log.bring_in.text_rows import list_of, unbroken

LARGEST_BYTES = 64 << 20  # of text; static poses are some hundred rows, a whole recording at 100 Hz some hours
LENGTH = 1e-3  # of a quaternion: four decimals
_ROTATION = 1e-2  # of elements of R R': three decimals
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(,\d{3})+\.\d*")  # 1,234.5
_SEPARATOR = re.compile(r"sep=(.)")  # the line that states the delimiter for a spreadsheet
_TUM = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")  # of a trajectory, whose t is a translation
_NEAR_s = 0.1  # between a wrench and the orientation that it is taken with: poses are held for longer
_DECIMAL_COMMA = re.compile(r"(?<=\d),(?=\d)")


class WeighTable(NamedTuple):
    """Columns side by side.

    Attributes:
        names: of the columns; empty where a file has none.
        values: (n, columns).
        lines: (n,) line of each row in the first file, from 1.
        label: the files, for messages.
    """

    names: tuple[str, ...]
    values: FloatArray
    lines: tuple[int, ...]
    label: str


def read(paths: Sequence[Path]) -> WeighTable:
    """Read files whose rows belong together.

    Raises:
        PosesError: a file without rows, or files of different length.
        OSError: a file cannot be read.
    """
    tables = [_one(path) for path in paths]
    label = " + ".join(path.name for path in paths)
    if len({len(one.values) for one in tables}) > 1:
        counts = ", ".join(f"{len(one.values)} in {one.label}" for one in tables)
        raise PosesError(f"rows of different number ({counts}): give files with a row for each pose, in the same order")
    if len(tables) > 1 and (any(any(one.names) for one in tables) or any(map(_is_timed, tables))):
        tables = [one if any(one.names) else one._replace(names=_by_numbers(one)) for one in tables]
    names = tuple(name for one in tables for name in one.names)
    return WeighTable(names, np.hstack([one.values for one in tables]), tables[0].lines, label)


def _is_timed(one: WeighTable) -> bool:
    return bool((np.diff(one.values[:, 0]) > 0.0).all())


def _by_numbers(one: WeighTable) -> tuple[str, ...]:
    """Names of a file without any, beside others: a time that rises, then a wrench, or a quaternion at its end."""
    timed, width = int(_is_timed(one)), one.values.shape[1]
    if width >= 4 and np.nanmedian(np.abs(np.linalg.norm(one.values[:, -4:], axis=1) - 1.0)) < LENGTH:
        return (*[""] * (width - 4), "quat0", "quat1", "quat2", "quat3")
    return (*[""] * timed, "fx", "fy", "fz", "mx", "my", "mz") if width - timed == 6 else one.names


def named(text: str, width: int) -> tuple[str, ...]:
    """Names of the columns as a person gives them: each in turn, or ``qx=4,qy=5``, by their numbers from 1.

    Raises:
        PosesError: another number of names than columns, or no such column.
    """
    given = [one.strip() for one in text.split(",")]
    if not any("=" in one for one in given):
        if len(given) != width:
            raise PosesError(f"--columns has {len(given)} names, the table {width} columns: name each, or NAME=NUMBER")
        return tuple(given)
    names = ["-"] * width
    for one in given:
        name, _, number = one.partition("=")
        if not number.strip().isdecimal() or not 1 <= int(number) <= width:
            raise PosesError(f"--columns {one}: write NAME=NUMBER, the number from 1 to {width}")
        names[int(number) - 1] = name.strip()
    return tuple(names)


def _one(path: Path) -> WeighTable:
    try:
        kind = kind_of(path)
        if kind != "csv":
            return _of_arrays(path, kind)
    except SourceError as error:
        raise PosesError(str(error)) from error
    return _text_table(path)


def _of_arrays(path: Path, kind: str) -> WeighTable:
    """Arrays by name, or messages: those of other topics nearest to each of the wrench's.

    Raises:
        PosesError: none have as many rows.
        SourceError: the file cannot be read.
    """
    columns: dict[str, FloatArray] = {}
    for name, values in foreign.read(path, Csv(), kind).columns.items():
        if values.dtype.kind in "iufb" and values.ndim:
            whole = values.reshape(len(values), -1).astype(np.float64)
            parts = {f"{name}_{k}": whole[:, k] for k in range(whole.shape[1])} if values.ndim > 1 else {name: values}
            columns |= {re.sub(r"\[(\d+)\]", r"_\1", own): np.asarray(part, np.float64) for own, part in parts.items()}
    if kind in ("bag", "mcap", "ulog"):
        columns = _together(columns)
    length = max(Counter(map(len, columns.values())).items(), key=lambda one: one[::-1], default=(0, 0))[0]
    columns = {name: one for name, one in columns.items() if len(one) == length}
    if length < 2:
        raise PosesError(f"{path} has no arrays of as many rows; give orientation and wrench with a row for each pose")
    names = tuple("" if name.isdecimal() else name for name in columns)
    return WeighTable(names, np.stack([*columns.values()], axis=1), tuple(range(1, length + 1)), path.name)


def _together(columns: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Of messages, those nearest in time to each of the topic with forces; farther than ``_NEAR_s`` NaN."""
    topics: dict[str, dict[str, FloatArray]] = {}
    for name, one in columns.items():
        topic, _, field = name.rpartition(":")
        topics.setdefault(topic, {})[field] = one
    clock = next((time for time in TIMES if all(time in of for of in topics.values() if len(of) > 1)), "log_time")
    own = next((topic for topic, of in topics.items() if any(re.search(r"force\.?x|wrench", each) for each in of)), "")
    at = topics.get(own, {}).get(clock)
    if at is None:
        return columns
    found = {}
    for topic, of in topics.items():
        if (times := of.get(clock)) is None:
            continue
        order = np.argsort(times, kind="stable")
        place = np.clip(np.searchsorted(times[order], at), 1, max(len(times) - 1, 1))
        before, after = order[place - 1], order[np.minimum(place, len(times) - 1)]
        row = np.where(np.abs(times[before] - at) <= np.abs(times[after] - at), before, after)
        far = np.abs(times[row] - at) > _NEAR_s * (1e6 if clock.startswith("timestamp") else 1e9)
        for field, one in of.items():
            name = f"{topic}:{field}".removeprefix(f"{topic}:position.") if topic != own else f"{topic}:{field}"
            found[name] = np.where(far, np.nan, one[row])
    return found


def _text_table(path: Path) -> WeighTable:
    if path.stat().st_size > LARGEST_BYTES:
        raise PosesError(f"{path} has more than {LARGEST_BYTES >> 20} MB: average the readings of each pose first")
    text = _text(path, path.read_bytes())
    lines = [
        (number, line.strip()) for number, line in enumerate(unbroken(text.splitlines()), 1) if line.strip(" \t,;")
    ]
    comments = [(number, line.lstrip("#% ")) for number, line in lines if line[0] in "#%"]
    lines = [one for one in lines if one[1][0] not in "#%"]
    said = _SEPARATOR.fullmatch(lines[0][1]) if lines else None
    lines = lines[1:] if said else lines
    if not lines:
        raise PosesError(f"{path} has no rows")
    between = said[1] if said else _delimiter([line for _, line in lines[:20]])
    rows = [(number, _cells(line, between)) for number, line in lines]
    names: Sequence[str] = ()
    if not any(_is_number(cell) for cell in rows[0][1]):
        names = [cell.strip().strip("\"'") for cell in rows[0][1]]
        rows = rows[1:]
        if rows and len(rows[0][1]) == len(names) and not any(_is_number(cell) for cell in rows[0][1]):
            names = [f"{name} [{unit.strip(' []()')}]" for name, unit in zip(names, rows[0][1], strict=True)]
            rows = rows[1:]
    elif comments and len(_cells(comments[-1][1], between)) == len(rows[0][1]):
        names = [cell.strip() for cell in _cells(comments[-1][1], between)]
    if tuple(name.lower() for name in names[-7:]) == _TUM:
        names = [*names[:-7], "x", "y", "z", *names[-4:]]
    if rows and names:
        names = [part for name, cell in zip_longest(names, rows[0][1], fillvalue="") for part in _parts(name, cell)]
    rows = [(number, [one for cell in row for one in ([*map(str, list_of(cell))] or [cell])]) for number, row in rows]
    if not rows:
        raise PosesError(f"{path} has no rows below the names of its columns")
    width = len(names) or int(np.median([len(row) for _, row in rows]))
    while names and not names[-1]:  # a delimiter at the end of each line
        names, width = names[:-1], width - 1
    values = np.full((len(rows), width), np.nan)
    for k, (_, row) in enumerate(rows):
        cells = row[:-1] if len(row) == width + 1 and not row[-1].strip() else row
        if len(cells) == width:
            values[k] = [_number(cell) for cell in cells]
    at = tuple(number for number, _ in rows)
    if width in (3, 4) and not names and not len(values) % width and _are_matrices(values.reshape(-1, width, width)):
        values, at, width = values.reshape(-1, width**2), at[::width], width**2  # a line a row
    return WeighTable(tuple(names) or ("",) * width, values, at, path.name)


def _are_matrices(T: FloatArray) -> bool:
    """Rotations (n, 3, 3), or homogeneous matrices (n, 4, 4)."""
    R, last = T[:, :3, :3], T[:, 3:]
    return bool(np.nanmedian(off(R)) < _ROTATION and (last == [0.0, 0.0, 0.0, 1.0][: T.shape[2]]).all())


def by_rows(values: FloatArray) -> FloatArray:
    """Rotation matrices by rows, (n, 9), of homogeneous ones (n, 12 or 16) by rows or columns; else (0, 9)."""
    whole = values.reshape(len(values), -1, 4)
    for T in (whole, whole.transpose(0, 2, 1)) if whole.shape[1] == 4 else (whole,):
        R, last = T[:, :3, :3], T[:, 3:] - [0.0, 0.0, 0.0, 1.0]
        if np.nanmax(np.abs(last), initial=0.0) < 1e-9 and np.nanmedian(off(R)) < _ROTATION:
            return R.reshape(-1, 9)
    return np.empty((0, 9))


def off(R: FloatArray) -> FloatArray:
    """How far matrices (n, 3, 3) are from rotations, (n,)."""
    return np.asarray(np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)), np.float64)


def _text(path: Path, raw: bytes) -> str:
    """UTF-8 or, by its mark, UTF-16; else Latin-1, whose letters stand in names alone."""
    try:
        return raw.decode("utf-16" if raw[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig")
    except UnicodeDecodeError as error:
        text = raw.decode("latin-1")
        if any(ord(mark) < 32 and mark not in "\t\n\v\f\r\x1a" for mark in text):
            raise PosesError(
                f"{path} is no text ({error.reason}); give a table of numbers, CSV for instance"
            ) from error
        return text


def _delimiter(lines: Sequence[str]) -> str | None:
    """None: blanks. A comma is a decimal one where there are semicolons, or tabs or blanks and no points."""
    body = lines[-1]
    for mark in (";", "\t"):
        if mark in body:
            return mark
    if "," not in body:
        return None
    words = body.split()
    decimal = len(words) > 3 and all(re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", word) for word in words)
    return None if decimal else ","


def _cells(line: str, between: str | None) -> list[str]:
    if between is None:
        return line.split()
    return next(csv.reader([line], delimiter=between)) if '"' in line else line.split(between)


def _number(cell: str) -> float:
    text = cell.strip().strip("\"'")
    text = text.replace(",", "") if _THOUSANDS.fullmatch(text) else _DECIMAL_COMMA.sub(".", text)
    try:
        value = float(text)
    except ValueError:
        return np.nan
    return value if np.isfinite(value) else np.nan


def _parts(name: str, cell: str) -> list[str]:
    """Names of the numbers of a cell."""
    count = len(list_of(cell))
    return [f"{name}_{k}" for k in range(count)] if count else [name]


def _is_number(cell: str) -> bool:
    return bool(np.isfinite(_number(cell)) or list_of(cell)) or cell.strip().lower() in ("nan", "inf", "-inf")
