"""Normal equations of the rows used, per instrument, payload held or not, and block of time.

Constant memory; later estimates and predictions of any half, instrument or time span are made from them.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.recursive.consistency import BlockScores
from onboard.regressor.rows import BASE_ROWS

Listener = Callable[[FloatArray, NDArray[np.intp], FloatArray, FloatArray], None]
"""Gets the rows too: times (m,), instruments (m,), whitened ``[Y, y]`` (m, p + 1), and by which sigma (m,)."""


class RowBlocks:
    """Sums of ``[Y, y, 1]`` over the rows, whitened.

    Args:
        parameters: p.
        block_s: first length of a block.
        instruments: that made the rows, by name.

    Attributes:
        listener: hears of the rows, if there is one.
    """

    def __init__(self, parameters: int, block_s: float, instruments: tuple[str, ...]) -> None:
        self.instruments = instruments
        self.listener: Listener | None = None
        self._blocks = {
            (held, k): BlockScores(parameters + 2, block_s) for held in (True, False) for k in range(len(instruments))
        }
        self._own = dict.fromkeys(self._blocks, 0.0)

    def add(
        self,
        times_s: FloatArray,
        held: BoolArray,
        instrument: NDArray[np.intp],
        Y: FloatArray,
        y: FloatArray,
        sigma: FloatArray,
        own: FloatArray,
        noise: FloatArray | None,
    ) -> None:
        """Takes rows in as :meth:`BlockScores.add` does.

        Args:
            times_s: (m,).
            held: (m,) whether the payload was.
            instrument: (m,) its number.
            Y: (m, p).
            y: (m,).
            sigma: (m,) with the noise of the motion.
            own: (m,) of the readings by themselves.
            noise: (m, s, p + 1) of the motion, per sigma of a signal.
        """
        if self.listener is not None:
            self.listener(times_s, instrument, np.column_stack([Y, y]) / sigma[:, None], sigma)
        rows = np.column_stack([Y, y, sigma])  # whitened, the last is one: it counts
        wider = None
        if noise is not None:
            wider = np.zeros((*noise.shape[:2], rows.shape[1]))
            wider[..., : noise.shape[2]] = noise
        for (kind, number), blocks in self._blocks.items():
            mine = (held == kind) & (instrument == number)
            if mine.any():
                unsure = None if wider is None else wider[mine]
                blocks.add(times_s[mine], rows[mine], np.zeros(int(mine.sum())), sigma[mine], unsure)
                share = own[mine] / sigma[mine]
                self._own[kind, number] += float(share @ share)

    def of(self, held: bool, instrument: int) -> tuple[FloatArray, FloatArray]:
        """Normal equations of each block with the noise of their regressor, and that noise, (b, p + 2, p + 2) each."""
        normal, noise = self.apart(held, instrument)
        return normal + noise, noise

    def apart(self, held: bool, instrument: int) -> tuple[FloatArray, FloatArray]:
        """Normal equations of each block without that noise, and the noise: views of what further rows are added to."""
        blocks = self._blocks[held, instrument]
        return blocks.normal, blocks.noise_by_block

    def total(self) -> FloatArray:
        """Normal equations of all rows, with the noise of their regressor, (p + 2, p + 2)."""
        return np.asarray(sum(self.of(*part)[0].sum(axis=0) for part in self.parts), np.float64)

    def own(self, held: bool, instrument: int) -> float:
        """Sum of squares of the readings' own sigmas, whitened: the rows' number less what the motion's noise adds."""
        return self._own[held, instrument]

    def times_s(self, held: bool, instrument: int) -> FloatArray:
        """When each block begins, (b,), on the axis of the rows' times."""
        return self._blocks[held, instrument].starts_s

    @property
    def parts(self) -> tuple[tuple[bool, int], ...]:
        """Kinds of rows that there are: held or not, and the instrument's number."""
        return tuple(part for part, blocks in self._blocks.items() if blocks.count)


def instrument_of(row: str) -> str:
    """Which instrument makes a row: its load cell, its joint, or the base's IMU for all wrenches that are zero."""
    return "base IMU" if row in BASE_ROWS else row
