"""Least squares over a sliding window without downdating: a queue of triangular factors made of two stacks.

Rows come in blocks. Each closed block is kept as the triangular factor of its rows, and the window is a queue made of
two stacks. The back stack has its blocks one by one and the triangle of all of them; the front stack has, for each
block, the triangle of that block and all younger ones on the stack. A block leaves by dropping the top of the front
stack. When that is empty, the back stack is transferred to it, which merges every block once. A block thus costs a
constant number of merges, and every triangle is made from rows of the window by orthogonal transformations only;
downdating would lose digits with every step.

Known limits: the step that transfers the stack takes as many merges as the window has blocks (10 us each at ten
parameters); the others take three.
"""

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import RowError
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
        raise RowError("a window cannot be restored from one triangle; add its rows again")
