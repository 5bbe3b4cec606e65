"""Sums over rows per block of time, in constant memory."""

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import RowError


class TimeBlocks:
    """Arrays of sums, one slot per block; when all slots are used, neighbours are merged and the block length doubles.

    Args:
        block_s: first length of a block; five kernel widths or more.
        capacity: blocks kept before neighbours are merged.
        shapes: of the sums of one block.

    Attributes:
        block_s: current length of a block.
        sums: the arrays, (capacity, *shape) each.

    Raises:
        RowError: block length not positive, or capacity below four.
    """

    def __init__(self, block_s: float, capacity: int, *shapes: tuple[int, ...]) -> None:
        if not 0.0 < block_s < np.inf:
            raise RowError(f"the block length is {block_s} s; it must be positive")
        if capacity < 4:
            raise RowError(f"a capacity of {capacity} blocks; give at least four")
        self.block_s = block_s
        self.sums = [np.zeros((capacity, *shape)) for shape in shapes]
        self._slots: dict[int, int] = {}

    @property
    def count(self) -> int:
        """Number of blocks that hold rows."""
        return len(self._slots)

    @property
    def starts_s(self) -> FloatArray:
        """When each block that holds rows begins, (count,), in the order of the sums."""
        return np.array(list(self._slots), np.float64) * self.block_s

    def split(self, times_s: FloatArray) -> list[tuple[int, slice | NDArray[np.intp]]]:
        """Slots and the rows that belong to each; slot numbers are valid until the next call.

        Args:
            times_s: (m,) on any continuous time axis.
        """
        first, last = float(times_s.min()), float(times_s.max())
        while True:
            if first // self.block_s == last // self.block_s:
                wanted, index = [int(first // self.block_s)], None
            else:
                index = (times_s // self.block_s).astype(np.int64)
                wanted = np.unique(index).tolist()
            missing = [number for number in wanted if number not in self._slots]
            if self.count + len(missing) <= self.sums[0].shape[0]:
                break
            self._double()
        for number in missing:
            self._slots[number] = self.count
        if index is None:
            return [(self._slots[wanted[0]], slice(None))]
        return [(self._slots[number], np.flatnonzero(index == number)) for number in wanted]

    def _double(self) -> None:
        self.block_s *= 2.0
        slots: dict[int, int] = {}
        sums = [np.zeros_like(part) for part in self.sums]
        for index, old in self._slots.items():
            new = slots.setdefault(index // 2, len(slots))
            for made, part in zip(sums, self.sums, strict=True):
                made[new] += part[old]
        self._slots, self.sums = slots, sums
