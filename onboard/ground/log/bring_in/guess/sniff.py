"""What kind of file it is, by its first bytes; of text, how it is laid out."""

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from onboard.ground.log.bring_in import foreign
from onboard.ground.log.bring_in.errors import SourceError
from onboard.ground.log.bring_in.mapping import Csv
from onboard.ground.log.bring_in.text_rows import list_of, number, times_of, unbroken

Kind = Literal["csv", "npz", "mat", "json", "bag", "mcap", "ulog"]
_HEAD, _LOOKED_AT = 1 << 18, 200  # bytes, lines
_NOTHING = ("", "nan", "na", "n/a", "null", "none", "-", "--", "inf", "-inf", "#n/a", "?")
_WAYS = ((",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", "."), (" ", "."), (" ", ","))
_COMMENTS = ("#", "%", "//")
_JSON = re.compile(r'\s*(\{\s*"|\[\s*(\{\s*"|\[[^\[\]]*\]\s*,\s*\[))')  # objects, a list of them, a list of lists


class Layout(NamedTuple):
    """How text is laid out, and what of that is shown to a person."""

    csv: Csv
    units: tuple[str, ...] = ()  # of a line below the names
    notes: tuple[str, ...] = ()


def kind_of(path: Path) -> Kind:
    """By the first bytes.

    Raises:
        SourceError: a kind that is not read, with what to do.
        OSError: it cannot be opened.
    """
    if foreign.is_bag_directory(path):
        return "bag"
    if path.is_dir():
        raise SourceError(f"{path} is a directory; give a recording in it")
    if path.suffix.lower() in (".yaml", ".yml"):
        save = "json.dump([*yaml.safe_load_all(open('FILE.yaml'))], open('FILE.json', 'w'))"
        raise SourceError(f"{path} is YAML, which is not read here: save it as JSON, in Python by {save}")
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if not head:
        raise SourceError(f"{path} is empty")
    for magic, kind in (
        *((b"\x89MCAP0\r\n", "mcap"), (b"#ROSBAG V", "bag"), (b"ULog\x01\x12\x35", "ulog"), (b"MATLAB ", "mat")),
        *((b"\x89HDF\r\n\x1a\n", "mat"), (b"SQLite format 3", "bag")),
    ):
        if head.startswith(magic):
            return kind  # type: ignore[return-value]
    if head.startswith(b"PK\x03\x04"):
        if b".npy" in head[:4096]:
            return "npz"
        raise SourceError(f"{path} is a ZIP archive, or a spreadsheet: unpack it, or save the sheet as CSV")
    if head.startswith((b"\x93NUMPY", b"\x1f\x8b", b"PAR1", b"\xd0\xcf\x11\xe0")):
        remedy = "save it as NPZ, with a name for each array, or as CSV; unpack it first if it is packed"
        raise SourceError(f"{path} is of a kind that is not read here: {remedy}")
    if b"\0" in head and not head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise SourceError(f"{path} is no text, and of no kind that is known: save it as CSV, NPZ, MAT or MCAP")
    return "json" if _JSON.match(head.decode("utf-8-sig", errors="replace")) else "csv"


def layout_of(path: Path) -> Layout:
    """How a text file is laid out.

    Raises:
        SourceError: no line of numbers among the first.
    """
    encoding = _encoding(path)
    with path.open("rb") as file:
        head = file.read(_HEAD)
    text = head.decode("utf-8-sig" if encoding == "utf-8" else encoding, errors="replace")
    lines = text.splitlines()[:_LOOKED_AT]
    if len(head) == _HEAD and len(lines) < _LOOKED_AT:
        lines = lines[:-1] or lines
    lines = list(unbroken(lines))
    body = [line for line in lines if line.strip() and not line.lstrip().startswith(_COMMENTS)]
    if not body:
        raise SourceError(f"{path} has no line but comments")
    delimiter, decimal = _between(body)
    cells = [_cells(line, delimiter) for line in lines]
    width = Counter(len(row) for row in cells if _are_numbers(row, decimal)).most_common(1)
    if not width:
        raise SourceError(f"{path} has no line of numbers among its first {len(lines)}")
    count = width[0][0]
    comment = next((mark for mark in _COMMENTS if any(line.lstrip().startswith(mark) for line in lines)), None)
    first = next(k for k, row in enumerate(cells) if len(row) == count and _are_numbers(row, decimal))
    named = [k for k in range(first) if _could_name(lines[k], cells[k], count, delimiter, comment)]
    own: dict[str, object] = {"delimiter": delimiter, "decimal": decimal, "encoding": encoding}
    if comment is not None and any(
        line.lstrip().startswith(comment) for k, line in enumerate(lines) if k > first or k not in named[:1]
    ):
        own["comment"] = comment
    units: tuple[str, ...] = ()
    if not named:
        own["header"] = False
        if first and not all(_passed_over(line, comment) for line in lines[:first]):
            own["rows_from"] = first + 1
        return Layout(Csv.model_validate(own), (), ("no line names the columns: they are numbered from 1",))
    header = named[-1]
    if len(named) > 1 and _are_units(cells[named[-1]]):
        header, units = named[-2], tuple(cells[named[-1]])
    own["header_line"] = header + 1
    if first != header + 1 and not all(_passed_over(line, comment) for line in lines[header + 1 : first]):
        own["rows_from"] = first + 1
    return Layout(Csv.model_validate(own), units)


def _encoding(path: Path) -> str:
    with path.open("rb") as file:
        if file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
            return "utf-16"
        file.seek(0)
        decoder = codecs.getincrementaldecoder("utf-8")()
        try:
            while some := file.read(1 << 20):
                decoder.decode(some)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            return "latin-1"
    return "utf-8"


def _between(body: Sequence[str]) -> tuple[str, str]:
    """What stands between cells, and in numbers: the way by which most of the text is rows of as many numbers."""
    last = body[len(body) // 3 :]

    def regularity(way: tuple[str, str]) -> tuple[float, int]:
        rows = [_cells(line, way[0]) for line in last]
        width, alike = Counter(map(len, rows)).most_common(1)[0]
        good = sum(_is_number(cell, way[1]) for row in rows for cell in row) / max(1, sum(map(len, rows)))
        return round(good * alike / len(rows), 2) * (1.0 if width > 1 else 0.5), width

    best = max(_WAYS, key=lambda way: (regularity(way), -_WAYS.index(way)))
    return best if regularity(best)[1] > 1 else (",", ".")


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:
        return []


def _is_number(cell: str, decimal: str) -> bool:
    text = cell.strip().strip('"').replace(decimal, ".")
    known = number(text) == number(text) or text.lower() in _NOTHING or times_of([text]) is not None
    return known or bool(list_of(text))


def _are_numbers(row: Sequence[str], decimal: str) -> bool:
    """Whether half of the cells are numbers, and at least one is more than nothing."""
    good = [cell for cell in row if _is_number(cell, decimal)]
    return 2 * len(good) >= len(row) and any(cell.strip().lower() not in _NOTHING for cell in good)


def _could_name(line: str, row: Sequence[str], count: int, delimiter: str, comment: str | None) -> bool:
    if comment is not None and line.lstrip().startswith(comment):
        row = _cells(line.lstrip()[len(comment) :].strip(), delimiter)
    return len(row) == count and any(re.search(r"[A-Za-z]", cell) for cell in row)


def _passed_over(line: str, comment: str | None) -> bool:
    return not line.strip() or (comment is not None and line.lstrip().startswith(comment))


def _are_units(row: Sequence[str]) -> bool:
    """A line such as ``[s],[N],[Nm]`` or ``s,deg,,N``: short, and no word of it is a name."""
    known = (
        r"[\[(]?\s*(|-|n?u?m?s|sec|seconds?|k?m?N|N\s*[.*·]?\s*m?m|deg(/s)?|°(/s)?|rad(/s)?|m?m(/s(\^?2|²)?)?|g|m?A|V|°?C|"
        r"rpm|1|counts?|bool|x|str|int)\s*[\])]?"
    )
    return all(re.fullmatch(known, cell.strip()) for cell in row) and any(cell.strip() for cell in row)
