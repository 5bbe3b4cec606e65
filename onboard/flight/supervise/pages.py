"""Gives back pages of program files that a process needed while it was imported, and no more.

Importing Pinocchio runs through 60 MB of libraries once. Such pages are as they are in the file, and stay in the page
cache: a process that needs one again has it mapped again by a minor fault. Until then they count for nobody.
"""

import contextlib
import ctypes
import os
import re
from collections.abc import Iterator
from pathlib import Path

_MADV_DONTNEED = 4  # mman.h
_HEAD = re.compile(r"^([0-9a-f]+)-([0-9a-f]+) (\S{4}) \S+ \S+ (\d+)")


def give_back() -> int:
    """Unmap what is unchanged of the libraries of this process; bytes that were resident there. Linux only."""
    given = 0
    with contextlib.suppress(OSError, AttributeError):
        madvise = ctypes.CDLL(None, use_errno=True).madvise
        madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
        for first, last, resident in unchanged(Path("/proc/self/smaps").read_text(encoding="ascii", errors="replace")):
            if madvise(first, last - first, _MADV_DONTNEED):
                raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
            given += resident
    return given


def unchanged(smaps: str) -> Iterator[tuple[int, int, int]]:
    """First and last address, and resident bytes, of private mappings of files that cannot be and were not written to.

    A library's table of relocations is read-only after it was written to: it has anonymous pages.
    """
    place: tuple[int, int] | None = None
    resident = 0
    for line in smaps.splitlines():
        if head := _HEAD.match(line):
            first, last, rights, inode = head.groups()
            of_a_file = inode != "0" and rights[1] == "-" and rights[3] == "p"
            place = (int(first, 16), int(last, 16)) if of_a_file else None
        elif line.startswith("Rss:"):
            resident = 1024 * int(line.split()[1])
        elif line.startswith("Anonymous:") and place is not None and resident and line.split()[1] == "0":
            yield (*place, resident)
