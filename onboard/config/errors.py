"""The error of a vehicle file, and the place of a key in it."""

import re
from typing import NamedTuple


class ConfigError(ValueError):
    """The vehicle file cannot be used; the message names file, line and remedy."""


def line_of(text: str, where: list[str]) -> int:
    """Line of the key at ``where``, else of the nearest table around it."""
    table: list[str] = []
    seen: dict[str, int] = {}
    best, depth = 1, 0
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*\[(\[?)\s*([^\]]+?)\s*\]", line):
            table = [part.strip().strip("\"'") for part in header[2].split(".")]
            if header[1]:
                seen[header[2]] = seen.get(header[2], -1) + 1
                table.append(str(seen[header[2]]))
            here = table
        elif key := re.match(r"\s*([A-Za-z0-9_\-\"'.]+)\s*=", line):
            here = [*table, *(part.strip("\"'") for part in key[1].split("."))]
        else:
            continue
        if here == where[: len(here)] and len(here) > depth:
            best, depth = number, len(here)
    return best


class Origin(NamedTuple):
    """Where a tree of settings comes from: what messages call it, and its text; empty where it has none."""

    label: str
    text: str = ""

    def place(self, where: list[str]) -> str:
        """The label, and the line of the key at ``where`` in a text."""
        return f"{self.label}:{line_of(self.text, where)}" if self.text else self.label
