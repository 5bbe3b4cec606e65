"""Normal equations of the rows used, per instrument, payload held or not, and block of time.

Constant memory; later estimates and predictions of any half, instrument or time span are made from them. What a
considered error does to a row is linear in the estimate, and stays in the sums as it was at that of its time.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.policy import AGAIN
from onboard.estimation.recursive.consistency import BlockScores
from onboard.regressor.rows import BASE_ROWS

Listener = Callable[[FloatArray, NDArray[np.intp], FloatArray, FloatArray], None]
"""Gets the rows too: times (m,), instruments (m,), whitened ``[Y, y]`` (m, p + 1), and by which sigma (m,)."""


class RowBlocks:
    """Sums of ``[Y, y, 1, C]`` over the rows, whitened.

    Args:
        parameters: p.
        block_s: first length of a block.
        instruments: that made the rows, by name.
        considered: errors that do C to a row, k.

    Attributes:
        listener: hears of the rows, if there is one.
        estimates: at which C was made: since when, and the base parameters, (p,); each of a fifth more time.
    """

    def __init__(self, parameters: int, block_s: float, instruments: tuple[str, ...], considered: int = 0) -> None:
        self.instruments, self.considered = instruments, considered
        self.listener: Listener | None = None
        self.estimates = list[tuple[float, FloatArray]]()
        self._made, every = parameters + 2, parameters + 2 + considered
        self._blocks = {
            (held, k): BlockScores(every, block_s) for held in (True, False) for k in range(len(instruments))
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
        C: FloatArray | None = None,
        mean: FloatArray | None = None,
        errors: FloatArray | None = None,
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
            C: (m, k) what considered errors do to the rows; None where there are none.
            mean: (p,) at which estimate they do; not needed where they are none.
            errors: (m, s, k) noise of C, as that of the motion.
        """
        if self.listener is not None:
            self.listener(times_s, instrument, np.column_stack([Y, y]) / sigma[:, None], sigma)
        if mean is not None and self.considered:
            now_s, since_s = float(times_s.min()), [at_s for at_s, _ in self.estimates]
            if not since_s or now_s - since_s[0] > AGAIN * (since_s[-1] - since_s[0]):
                self.estimates.append((now_s, mean))
        columns = [Y, y, sigma, C] if C is not None and self.considered else [Y, y, sigma]
        rows = np.column_stack(columns)  # whitened, that of sigma is one: it counts
        wider = None
        if noise is not None:
            wider = np.zeros((*noise.shape[:2], rows.shape[1]))
            wider[..., : noise.shape[2]] = noise
            if errors is not None and self.considered:
                wider[..., self._made :] = errors
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
        blocks, made = self._blocks[held, instrument], slice(self._made)
        return blocks.normal[:, made, made], blocks.noise_by_block[:, made, made]

    def with_errors(self, held: bool, instrument: int) -> tuple[FloatArray, FloatArray]:
        """The same with what considered errors do to the rows: of ``[Y, C, y, 1]``, (b, p + k + 2, p + k + 2) each."""
        blocks, p = self._blocks[held, instrument], self._made - 2
        order = np.roll(np.arange(p, blocks.normal.shape[1]), -2)
        at = np.concatenate([np.arange(p), order])[:, None]
        return blocks.normal[:, at, at.T], blocks.noise_by_block[:, at, at.T]

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
