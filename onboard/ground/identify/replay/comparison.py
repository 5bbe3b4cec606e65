"""Compares recorded outputs of an estimator with recomputed ones, a channel at a time."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.records import Rows
from onboard.channels import NUMBERS, is_quantity

_AT_ONCE = 4096  # rows that are compared at once
_SCALED = (*NUMBERS, "drawn")  # fields of QUANTITY in the unit of its sigma


class Comparison:
    """Comparison of recorded and recomputed rows of one channel, of many steps at a time.

    Attributes:
        recorded: number of recorded rows.
        differs_from: first row whose bits are not the same, or that one side lacks; None: there is none.
        farthest_sigmas: largest distance of a supported answer, value or interval, from the recorded one, in recorded
            sigmas; infinite where anything but a number differs, or rows are missing.
        until: rows from here on are of an estimator that has not begun yet; None: no further one begins.
    """

    def __init__(self, dtype: np.dtype[np.void]) -> None:
        self.recorded = 0
        self.differs_from: int | None = None
        self.farthest_sigmas = 0.0
        self.until: int | None = None
        self._dtype = dtype
        self._compared = 0
        self._said: list[Rows] = []  # not compared yet
        self._again: list[Rows] = []
        self._held = 0  # rows that came since the last comparison

    @property
    def replayed(self) -> int:
        """Number of recomputed rows."""
        return self._compared + sum(map(len, self._again))

    def add(self, said: Rows, again: Sequence[Rows] = ()) -> None:
        """Take further recorded and recomputed rows."""
        self.recorded += len(said)
        self._said.append(said)
        self._again += again
        self._held += len(said)
        if self._held >= _AT_ONCE:
            self._compare()

    def forget(self, known: int) -> None:
        """Only the first ``known`` recomputed rows had been published before the estimator died."""
        self._compare()
        self._again = [self._again[0][: max(0, known - self._compared)]]

    def end(self, answered_ns: int) -> None:
        """End of the flight: outputs made after ``answered_ns`` may be missing in the log."""
        self._compare()
        [said], [again] = self._said, self._again
        if len(again) and (again[len(said) :]["host_ns"] > answered_ns).all():
            again = again[: len(said)]
        if len(said) + len(again) > 0:
            self._differ(self._compared, float("inf"))

    def _compare(self) -> None:
        said, again = joined(self._said, self._dtype), joined(self._again, self._dtype)
        count = min(len(said), len(again))
        count = count if self.until is None else max(0, min(count, self.until - self._compared))
        if said.dtype != again.dtype:
            count = 0  # of an earlier version: they stay, and are reported as missing
        equal = (_bytes(again[:count]) == _bytes(said[:count])).all(axis=1)
        if not equal.all():
            apart = _sigmas_apart(said[:count][~equal], again[:count][~equal])
            self._differ(self._compared + int(np.argmin(equal)), apart)
        self._compared += count
        self._said, self._again, self._held = [said[count:]], [again[count:]], 0

    def _differ(self, row: int, sigmas: float) -> None:
        self.differs_from = row if self.differs_from is None else self.differs_from
        self.farthest_sigmas = max(self.farthest_sigmas, sigmas)


def _sigmas_apart(said: Rows, again: Rows) -> float:
    """Largest distance between supported answers in recorded sigmas; infinite where what is no number differs."""
    names = said.dtype.names or ()
    numbers = [name for name in names if said.dtype[name].base.kind == "f"]
    if any((said[name] != again[name]).any() for name in names if name not in numbers):
        return float("inf")
    if any((np.isnan(said[name]) != np.isnan(again[name])).any() for name in numbers):
        return float("inf")
    if not is_quantity(said.dtype):
        return 0.0
    shown = said["supported"] != 0
    sigma, farthest = said["sigma"][shown], 0.0
    for name in (name for name in _SCALED if name in numbers):
        apart = np.abs(again[name][shown] - said[name][shown])
        moved = apart > 0.0  # NaN, of both, is not
        with np.errstate(divide="ignore"):
            farthest = max(farthest, float(np.max(apart[moved] / sigma[moved], initial=0.0)))
    return farthest


def joined(parts: Sequence[Rows], dtype: np.dtype[np.void]) -> Rows:
    """The rows of some batches, (n,); of one dtype as bytes, in a fifth of the time that their fields take."""
    some = [part for part in parts if len(part)]
    if len(some) < 2:
        return some[0] if some else np.empty(0, dtype)
    if any(part.dtype != some[0].dtype for part in some):
        return np.concatenate(some)
    whole = np.dtype((np.void, some[0].dtype.itemsize))
    return np.concatenate([part.view(whole) for part in some]).view(some[0].dtype)


def _bytes(rows: Rows) -> NDArray[np.uint8]:
    """The rows' fields as they lie in memory, (n, itemsize), what fills the gaps between them zeroed."""
    clean = np.zeros(len(rows), rows.dtype)
    for field in rows.dtype.names or ():
        clean[field] = rows[field]
    return clean.view(np.uint8).reshape(len(rows), rows.dtype.itemsize)
