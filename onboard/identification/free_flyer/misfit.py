"""Misfit of a filter's innovations per instrument: chi-squared over its degrees of freedom, 1 for a consistent filter.

Two values per instrument since the last window: the mean over all batches, and the worst block of batches as far as it
exceeds chance. A fault that the filter adapts to causes large innovations for a short time only, which a mean over a
flight hides. ``misfit_by_instrument`` of a whole flight, whose blocks are given and of any size, uses the same
:func:`beyond_chance`; here blocks are cut as batches come, and only their sums are kept.
"""

from collections.abc import Mapping

from scipy.special import chdtri

from onboard.estimation.policy import DOUBT, of_each

_BLOCK = 600  # degrees of freedom; a mean over them scatters by 6 %
_BLOCKS = 1e4  # of an hour: one a second of each of three instruments


def beyond_chance(squares: float, freedom: int) -> float:
    """A chi-squared sum over what a block of an hour exceeds by chance: above 1, it counts."""
    return squares / float(chdtri(freedom, of_each(DOUBT, _BLOCKS)))


class InnovationMisfit:
    """Sums of squares of whitened innovations by instrument."""

    def __init__(self) -> None:
        self._sums: dict[str, tuple[float, int]] = {}
        self._blocks: dict[str, tuple[float, int]] = {}
        self._worst: dict[str, float] = {}

    def forget(self) -> None:
        """Clear the sums after a reset of the filter."""
        self._sums, self._blocks, self._worst = {}, {}, {}

    def add(self, instrument: str, squares: float, freedom: int) -> None:
        """Takes in one batch: ``r' S^-1 r`` of an instrument's innovation r, and the number of elements of r."""
        total, seen = self._sums.get(instrument, (0.0, 0))
        self._sums[instrument] = total + squares, seen + freedom
        total, seen = self._blocks.get(instrument, (0.0, 0))
        block = total + squares, seen + freedom
        if block[1] >= _BLOCK:
            self._worst[instrument] = max(self._worst.get(instrument, 0.0), beyond_chance(*block))
            block = 0.0, 0
        self._blocks[instrument] = block

    def by_instrument(self) -> Mapping[str, float]:
        """The larger of mean and worst block, expected 1; empty before the first batch."""
        return {
            instrument: max(total / freedom, self._worst.get(instrument, 0.0))
            for instrument, (total, freedom) in self._sums.items()
        }
