"""How probable rows are under a model of them, to compare two models of the same rows.

With normal equations ``A = N / s + prior``, ``b`` and ``c`` of parameters and considered errors together, and noise of
s times the stated variance, the log of the evidence is, but for what is the same of both models,

    -(c / s - b' A^-1 b) / 2 - log |A| / 2

(Laplace; exact, as the rows are linear). The second term is Occam's: a model that needs two parameters to be the same
number is less probable than the one with one parameter. A row that a model refuses has at least the square of the limit
at which it does.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.recursive.rls import SquareRootRls


class RowsSeen(NamedTuple):
    """What a model of rows has made of them."""

    normal: FloatArray  # (p + k + 1, p + k + 1) of parameters, considered errors and readings, without any prior
    prior: FloatArray  # (p + k + 1, p + k + 1) the same of the prior
    refused: float  # sum of squares, in sigmas, of the rows that it refuses, at least
    drawn: float  # sum of squares, in sigmas, of what is found of parts whose drawing is no prior
    rows: float  # number of rows that it takes

    @classmethod
    def of(cls, rls: SquareRootRls, considered: FloatArray, refused: float, drawn: float) -> "RowsSeen":
        """By a recursion.

        Args:
            rls: of all rows that are not refused.
            considered: (k,) sigmas of the considered errors.
            refused: sum of squares, in sigmas, of the rows that are, at least.
            drawn: of what is found of parts whose drawing is no prior.
        """
        p, state = rls.parameters, rls.state()
        prior = state.prior_rows.T @ state.prior_rows
        normal = state.triangle.T @ state.triangle - prior
        errors = range(p, len(prior) - 1)
        prior[errors, errors] += np.maximum(considered, np.finfo(np.float32).tiny) ** -2
        return cls(normal, prior, refused, drawn, rls.rows)

    def squares(self, scale: float) -> tuple[float, float]:
        """Sum of squares, the prior's included, and log of the determinant of the information, if noise is so large.

        Args:
            scale: s, variance over that stated.
        """
        whole = self.normal / scale + self.prior
        A, b = whole[:-1, :-1], whole[:-1, -1]
        left_over = whole[-1, -1] + self.refused / scale + self.drawn - b @ np.linalg.solve(A, b)
        return float(left_over), float(np.linalg.slogdet(A)[1])


def nats(one: RowsSeen, other: RowsSeen, correlation: float) -> float:
    """Log of the evidence of one model over that of another of the same rows, with noise as large as the better needs.

    Args:
        one: a model.
        other: another, of the same parameters and prior.
        correlation: how many neighbouring rows say the same thing, by which their variances are inflated.
    """
    scale = max(1.0, correlation * min(each.squares(1.0)[0] / max(one.rows, other.rows, 1.0) for each in (one, other)))
    (J, volume), (J_other, volume_other) = one.squares(scale), other.squares(scale)
    return 0.5 * (J_other - J) + 0.5 * (volume_other - volume)
