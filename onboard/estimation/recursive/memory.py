"""Least squares with growing, fading or sliding-window memory: square-root recursion plus blocks for intervals.

The three differ only in the weight of earlier rows. Time comes with the rows; where it goes back (start of another
log), no time is taken to have passed.

Least squares over a sliding window without downdating: a queue of triangular factors made of two stacks.

Rows come in blocks. Each closed block is kept as the triangular factor of its rows, and the window is a queue made of
two stacks. The back stack has its blocks one by one and the triangle of all of them; the front stack has, for each
block, the triangle of that block and all younger ones on the stack. A block leaves by dropping the top of the front
stack. When that is empty, the back stack is transferred to it, which merges every block once. A block thus costs a
constant number of merges, and every triangle is made from rows of the window by orthogonal transformations only;
downdating would lose digits with every step.

Known limits: the step that transfers the stack takes as many merges as the window has blocks (10 us each at ten
parameters); the others take three.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import RowError
from onboard.estimation.recursive.consistency import BlockScores, JackknifeEstimate, corrected_mean, innovation
from onboard.estimation.recursive.rls import RlsState, SquareRootRls, merged


class WindowRls(SquareRootRls):
    """Square-root least squares of the newest block of rows and ``blocks`` closed ones before it, plus the prior.

    Args:
        parameters: p.
        considered: k, as for :class:`SquareRootRls`.
        blocks: closed blocks kept beside the one that is being filled.

    Raises:
        RowError: dimension out of range.
    """

    def __init__(self, parameters: int, considered: int = 0, blocks: int = 1) -> None:
        super().__init__(parameters, considered)
        if blocks < 0:
            raise RowError(f"{blocks} closed blocks in the window; give none or more")
        self.blocks = blocks
        self._newest = self._nothing()
        self._back: list[FloatArray] = []
        self._back_sum = self._nothing()
        self._front: list[FloatArray] = []  # the oldest block's, with all after it, comes last
        self._counts = [0.0]  # rows by block, the oldest first

    def _nothing(self) -> NDArray[np.float64]:
        return np.zeros((self._size, self._size), order="F")

    def update(
        self,
        Y: FloatArray,
        y: FloatArray,
        sigma: FloatArray,
        C: FloatArray | None = None,
        forgetting: float | None = None,
    ) -> None:
        """Adds rows to the newest block; see :meth:`SquareRootRls.update`.

        Raises:
            RowError: as there, or a forgetting factor given: a window forgets by :meth:`close_block`.
        """
        if forgetting is not None and forgetting != 1.0:
            raise RowError("a window has no forgetting factor; close its blocks")
        rows = self._weighted(Y, y, sigma, C)
        if rows is None:
            return
        self._newest = merged(self._newest, rows.copy(order="F"))
        self._absorb(rows)
        self._counts[-1] += y.shape[0]
        self.rows += y.shape[0]

    def close_block(self) -> None:
        """Begins a new block; drops the oldest if there are more than ``blocks`` closed ones."""
        self._back.append(self._newest)
        self._back_sum = merged(self._back_sum, self._newest.copy(order="F"), True)
        self._newest = self._nothing()
        self._counts.append(0.0)
        if len(self._counts) - 1 > self.blocks:
            self._drop_oldest()
        self._triangle, self._sound = self._back_sum.copy(order="F"), None
        if self._front:
            self._triangle = merged(self._triangle, self._front[-1].copy(order="F"), True)
        if self._prior_rows.shape[0]:
            self._absorb(self._prior_rows.copy(order="F"))
        self.rows = sum(self._counts)

    def _drop_oldest(self) -> None:
        if not self._front:
            suffix = self._nothing()
            for block in reversed(self._back):
                suffix = merged(suffix.copy(order="F"), block, True)
                self._front.append(suffix)
            self._back, self._back_sum = [], self._nothing()
        self._front.pop()
        del self._counts[0]

    def restore(self, state: RlsState) -> None:
        """Refused: a single triangle does not contain the blocks of a window.

        Raises:
            RowError: always.
        """
        raise RowError("a window cannot be restored from a triangle; add its rows again")


@dataclass(frozen=True, slots=True)
class Memory:
    """Memory of the estimator: all rows, unless one of the two is given.

    Attributes:
        forgetting_s: a row's weight falls by 1/e in this time. The covariance is that of drifting parameters: for
            constant ones the interval is up to sqrt(2) too wide.
        window_s: rows have full weight for this long, and none one block later.

    Raises:
        RowError: both given, or a time that is not positive.
    """

    forgetting_s: float | None = None
    window_s: float | None = None

    def __post_init__(self) -> None:
        if self.forgetting_s is not None and self.window_s is not None:
            raise RowError("forgetting_s and window_s are both given; rows fade or leave a window: remove either")
        for name, value in (("forgetting_s", self.forgetting_s), ("window_s", self.window_s)):
            if value is not None and not 0.0 < value < np.inf:
                raise RowError(f"{name} is {value}; give a positive time")


FOR_EVER = Memory()


class RecursiveLeastSquares:
    """Least squares with block-jackknife intervals under any :class:`Memory`.

    Args:
        parameters: p.
        considered: k, as for :class:`SquareRootRls`.
        block_s: first length of the jackknife blocks, and length of the blocks that leave a window.
        memory: weighting of earlier rows.

    Attributes:
        rls: the recursion.
        blocks: the same rows per block of time, with the same weights.

    Raises:
        RowError: see :class:`SquareRootRls` and :class:`BlockScores`.
    """

    def __init__(self, parameters: int, considered: int, block_s: float, memory: Memory = FOR_EVER) -> None:
        self.memory = memory
        if memory.window_s is None:
            self.rls = SquareRootRls(parameters, considered)
            self.blocks = BlockScores(parameters, block_s)
        else:
            closed = int(np.ceil(memory.window_s / block_s))
            self.rls = WindowRls(parameters, considered, closed)
            self.blocks = BlockScores(parameters, block_s, max(closed + 2, 4))
        self._last_s: float | None = None

    def add(
        self,
        times_s: FloatArray,
        Y: FloatArray,
        y: FloatArray,
        sigma: FloatArray,
        C: FloatArray | None = None,
        noise: FloatArray | None = None,
    ) -> None:
        """Adds rows.

        Args:
            times_s: (m,) time of each row, not decreasing.
            Y: (m, p).
            y: (m,).
            sigma: (m,).
            C: (m, k) columns of the considered parameters, if any.
            noise: (m, s, p), see :meth:`BlockScores.add`.

        Raises:
            RowError: see :meth:`SquareRootRls.update` and :meth:`BlockScores.add`.
        """
        if y.shape[0] == 0:
            return
        if self.memory.window_s is not None:
            self._add_to_window(times_s, Y, y, sigma, C, noise)
            return
        factor = 1.0
        if self.memory.forgetting_s is not None and self._last_s is not None:
            factor = float(np.exp(-max(times_s[-1] - self._last_s, 0.0) / self.memory.forgetting_s))
        self.rls.update(Y, y, sigma, C, factor)
        if factor < 1.0:
            self.blocks.fade(factor)
        self.blocks.add(times_s, Y, y, sigma, noise)
        self._last_s = float(times_s[-1])

    def _add_to_window(
        self,
        times_s: FloatArray,
        Y: FloatArray,
        y: FloatArray,
        sigma: FloatArray,
        C: FloatArray | None,
        noise: FloatArray | None,
    ) -> None:
        assert isinstance(self.rls, WindowRls)
        index = np.floor(times_s / self.blocks.block_s)
        for number in np.unique(index):
            mine = index == number
            steps = 0 if self._last_s is None else int(number - np.floor(self._last_s / self.blocks.block_s))
            for _ in range(min(max(steps, 0), self.rls.blocks + 1)):
                self.rls.close_block()
            columns, doubt = (None if part is None else part[mine] for part in (C, noise))
            self.rls.update(Y[mine], y[mine], sigma[mine], columns)
            # A log that begins again continues in the newest block.
            newest_s = float(times_s[mine][-1]) if self._last_s is None or steps > 0 else self._last_s
            at_s = np.full(int(mine.sum()), newest_s)
            self.blocks.add(at_s, Y[mine], y[mine], sigma[mine], doubt)
            self._last_s = newest_s
            self.blocks.keep_from(newest_s, self.rls.blocks)

    def expect_noise(self) -> None:
        """Of rows that were made without noise: takes in what that of the regressor adds on average.

        No residual scatters then: intervals are formal ones.
        """
        values, vectors = np.linalg.eigh(self.blocks.noise)
        told = values > values[-1] * np.finfo(np.float64).eps
        rows = (vectors * np.sqrt(np.maximum(values, 0.0))).T[told]  # rows' rows: the noise
        shared = (vectors.T @ self.blocks.noise_moment)[told] / np.sqrt(values[told])
        none = np.zeros((len(rows), self.rls.considered)) if self.rls.considered else None
        self.rls.update(rows, shared, np.ones(len(rows)), none)
        self.blocks.expect_noise()

    def innovation(self, Y: FloatArray, y: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
        """As :meth:`SquareRootRls.innovation`, against :meth:`least_squares`."""
        return innovation(self.rls, self.blocks, Y, y, sigma)

    def least_squares(self) -> FloatArray:
        """Least squares estimate corrected for known regressor noise, (p,): the mean that intervals are about."""
        return corrected_mean(self.rls, self.blocks)

    def block_jackknife(self, considered_sigma: ArrayLike = ()) -> JackknifeEstimate:
        """The estimate with its block-jackknife covariance; see :class:`JackknifeEstimate`."""
        return JackknifeEstimate(self.rls, self.blocks, considered_sigma)
