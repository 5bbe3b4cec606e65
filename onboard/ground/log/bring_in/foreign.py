"""Reads columns of foreign files: text, NumPy's NPZ, MATLAB's, JSON, messages; a whole file is held in memory."""

import re
import stat
from collections.abc import Collection, Iterable
from collections.abc import Mapping as Columns
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.json_rows import read_json
from onboard.ground.log.bring_in.mapping import Csv
from onboard.ground.log.bring_in.matlab import read_mat
from onboard.ground.log.bring_in.messages import read_messages
from onboard.ground.log.bring_in.text_rows import LARGEST_BYTES, Recording, Values, read_csv
from onboard.npz import NpzError, arrays_of

_MOST_NAMED, _LONGEST_NAME = 20, 80  # columns in a message, characters of one


def read_npz(path: Path) -> Columns[str, Values]:
    """The arrays of an NPZ file, by name.

    Raises:
        SourceError: not an NPZ file, or one with pickled objects.
        OSError: the file cannot be read.
    """
    try:
        return arrays_of(path, LARGEST_BYTES)
    except NpzError as error:
        raise SourceError(str(error)) from error


_WHOLE = {"npz": read_npz, "mat": read_mat, "json": read_json}


def read(path: Path, layout: Csv, kind: str, *, skip: bool = False, names: Collection[str] | None = None) -> Recording:
    """The columns of a file of ``kind``, by ``read_csv``, ``read_npz``, ``read_mat``, ``read_json``, ``read_messages``.

    ``names``: of columns that are wanted; other topics need not be read.

    Raises:
        SourceError: as these; a pipe or a device, which may never end; more than a recording holds.
        OSError: as these.
    """
    about = path.stat()
    if is_bag_directory(path) and kind == "bag":
        sizes = [part.stat().st_size for part in path.iterdir()]
    elif not stat.S_ISREG(about.st_mode):
        raise SourceError(f"{path} is no file, but a pipe, a device or a directory; give the path of a recording")
    else:
        sizes = [about.st_size]
    if sum(sizes) > LARGEST_BYTES:
        limit = f"{LARGEST_BYTES / 1e9:.1f} GB"
        raise SourceError(f"{path} has {sum(sizes) / 1e9:.3g} GB; the limit is {limit}: divide it")
    if kind == "csv":
        return read_csv(path, layout, skip=skip)
    if kind in _WHOLE:
        return Recording(_WHOLE[kind](path))
    topics = None if names is None else {name.partition(":")[0] for name in names}
    return read_messages(path, kind, topics)


def is_bag_directory(path: Path) -> bool:
    """Whether it is a bag of ROS 2, which is a directory."""
    return (path / "metadata.yaml").is_file()


def _found(columns: Columns[str, Values], name: str) -> Values | None:
    """A column by its name, or ``NAME[k]``, column k of an array (n, columns); None where there is none."""
    if name in columns:
        return columns[name]
    indexed = re.fullmatch(r"(.+)\[(\d+)\]", name)
    if indexed is None or indexed[1] not in columns:
        return None
    array, k = columns[indexed[1]], int(indexed[2])
    if array.dtype.kind == "U":
        return array  # why it is none: see numbers
    return array[:, k] if array.ndim == 2 and k < array.shape[1] else None


def usable(columns: Columns[str, Values], names: Iterable[str]) -> NDArray[np.bool_]:
    """Rows (n,) in which all of these columns are finite numbers.

    A column that does not exist, is text or differs in length says nothing: that is reported where its values are read.
    """
    good: NDArray[np.bool_] = np.ones(0, np.bool_)
    for name in names:
        found = _found(columns, name)
        if found is not None and found.dtype.kind in "iuf":
            own = np.atleast_1d(np.isfinite(found.reshape(len(found), -1)).all(axis=1))
            if not len(good):
                good = own
            elif len(good) == len(own):
                good &= own
    return good


def length(columns: Columns[str, Values], name: str) -> int:
    """Rows of a column; 0 where there is none of that name."""
    found = _found(columns, name)
    return 0 if found is None else len(found)


def numbers(path: Path, columns: Columns[str, Values], name: str, width: int | None = None) -> Values:
    """Column ``name`` (n,), or (n, width), of a file that has been read; ``NAME[k]`` is column k of an array.

    Raises:
        SourceError: no such column, or not numbers of that shape.
    """
    values = _found(columns, name)
    if values is None:
        listed = ", ".join(repr(one)[:_LONGEST_NAME] for one in list(columns)[:_MOST_NAMED])
        more = f" and {len(columns) - _MOST_NAMED} more" if len(columns) > _MOST_NAMED else ""
        raise SourceError(f"{path} has no column {name!r}; it has {listed}{more}")
    if values.dtype.kind not in "iuf":
        told = str(values.flat[0]) if values.size and values.strides == (0,) else ""  # of a CSV column: see _numbers
        wrong = f": {told}" if told else " holds cells that are not numbers; correct them or the mapping"
        raise SourceError(f"{path}: column {name!r}{wrong}")
    if values.ndim != (1 if width is None else 2) or (width is not None and values.shape[1] != width):
        wanted = "a value" if width is None else f"{width} values"
        raise SourceError(f"{path}: column {name!r} has shape {values.shape}; the mapping needs {wanted} a row")
    return values
