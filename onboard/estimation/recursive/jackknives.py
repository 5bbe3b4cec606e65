"""The last jackknife of each identifier: of the same rows it is asked for many times in one judgement.

Beside the identifiers and not in them, since what they have is written to each checkpoint.
"""

from collections.abc import Callable
from typing import Protocol
from weakref import WeakKeyDictionary

from onboard.estimation.recursive.consistency import JackknifeEstimate


class _Counts(Protocol):
    """What has rows."""

    rows_used: int


_LAST: WeakKeyDictionary[_Counts, dict[bool, tuple[int, JackknifeEstimate]]] = WeakKeyDictionary()


def last(of: _Counts, exact: bool, make: Callable[[bool], JackknifeEstimate]) -> JackknifeEstimate:
    """What ``make(exact)`` returned for the rows so far."""
    kept = _LAST.setdefault(of, {})
    if exact not in kept or kept[exact][0] != of.rows_used:
        kept[exact] = of.rows_used, make(exact)
    return kept[exact][1]


def forget(of: _Counts) -> None:
    """Make it anew the next time, of the same rows too."""
    _LAST.pop(of, None)
