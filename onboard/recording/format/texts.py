"""Texts in rows, bytes that a device, or whoever made the file, chose; lists of names in a text."""

from collections.abc import Sequence

_ALL = 6  # names that are all in a text


def printable(data: bytes) -> str:
    """Text for people: what is not UTF-8, and what a terminal would obey, is written as an escape."""
    text = bytes(data).decode(errors="backslashreplace")
    return text if text.isprintable() else "".join(mark if mark.isprintable() else repr(mark)[1:-1] for mark in text)


def listed(names: Sequence[str]) -> str:
    """Names with commas between them; of many the first three, and how many more there are."""
    return ", ".join(names if len(names) <= _ALL else [*names[:3], f"{len(names) - 3} more"])
