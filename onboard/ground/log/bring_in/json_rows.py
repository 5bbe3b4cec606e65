"""Reads JSON: a list of objects, an object of lists, or an object on each line; numbers of a row as columns."""

import json
from collections import Counter
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.messages import MessageColumns
from onboard.ground.log.bring_in.text_rows import Values

LARGEST_BYTES = 256 << 20  # of text, of which Python's objects take ten times as much


def read_json(path: Path) -> dict[str, Values]:
    """Columns (n,) by name: ``wrench.force.x``, ``q[0]`` of a list, ``T[0]`` to ``T[15]`` of a matrix by its rows.

    Of an object the lists are read that are as long as most are; columns of lists in a list are numbered from 1.

    Raises:
        SourceError: no JSON, or without two rows of numbers.
        OSError: the file cannot be read.
    """
    if path.stat().st_size > LARGEST_BYTES:
        raise SourceError(f"{path} has more than {LARGEST_BYTES >> 20} MB of JSON: divide it, or save it as CSV or NPZ")
    try:
        text = path.read_text(encoding="utf-8-sig")
        try:
            value = json.loads(text)
        except json.JSONDecodeError:
            value = [json.loads(line) for line in text.splitlines() if line.strip()]
    except (ValueError, RecursionError) as error:
        raise SourceError(f"{path} is no JSON that can be read ({error}); save it again, or as CSV") from error
    table = MessageColumns()
    for row in _rows(value):
        table.add(row)
    columns = table.arrays()
    if not columns or table.count < 2:
        raise SourceError(f"{path} has no two rows of numbers: a list of objects, or an object of lists, is read")
    return columns


def _rows(value: Any) -> Iterator[dict[str, Any]]:
    if isinstance(value, list):
        for one in value:
            fields = one if isinstance(one, dict) else dict(enumerate(one, 1)) if isinstance(one, list) else {}
            yield {str(name): _plain(part) for name, part in fields.items()}
        return
    lists = dict(_lists(value, ""))
    length = max(Counter(map(len, lists.values())).items(), key=lambda one: one[::-1], default=(0, 0))[0]
    of_rows = {name: one for name, one in lists.items() if len(one) == length}
    if len(of_rows) == 1 and all(isinstance(row, (dict, list)) for one in of_rows.values() for row in one):
        yield from _rows(next(iter(of_rows.values())))
        return
    for parts in zip(*of_rows.values(), strict=True):
        yield {name: _plain(part) for name, part in zip(of_rows, parts, strict=True)}


def _lists(value: Any, name: str) -> Iterator[tuple[str, list[Any]]]:
    if isinstance(value, list):
        yield name, value
    elif isinstance(value, dict):
        for key, one in value.items():
            yield from _lists(one, f"{name}.{key}" if name else str(key))


def _plain(value: Any) -> Any:
    """With lists in lists as one, by rows."""
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    while isinstance(value, list) and any(isinstance(one, list) for one in value):
        value = list(chain.from_iterable(one if isinstance(one, list) else [one] for one in value))
    return value
