"""Errors of bodies in the drawing, such that all masses together grow along the same direction wherever the state is.

With all masses and moments of inertia a times as large, what an arm does to its base is the same: no motion shows a.
Where the parameters of a body are those of the drawing and a linear function of its errors z, that direction depends on
them, and what was learned about one estimate is information about all masses about another one: after an error of 10 %
was allowed for, all masses of a free-flyer without a cell seemed known to 3 % after ten seconds, and of two
explanations that no motion tells apart, the arm 10 % lighter or the base 10 % heavier, the wrong one was believed.

So the part of z along the body itself is the logarithm of a factor: with ``z = d t + r``, ``d = L^-1 chi``, r at right
angles to d (chi: drawn parameters, L: root of their covariance, so that z is of unit variance),

    exp(t) (chi + L r) = chi + L s,   s = exp(t) (d + r) - d,   ds/dz = exp(t) (1 + r d' / d'd)

which for small z is z. Computed in ``onboard/native/src/scaled.c``.
"""

import numpy as np

from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.native import library


class Scaled:
    """Errors of some bodies.

    Args:
        at: where their errors stand in the state, (10 k,).
        drawn: d of each, (k, 10); zero: a body without mass.

    Attributes:
        at: as given.
        drawn: as given, and by what t is made of z, (k, 10).
    """

    def __init__(self, at: IndexArray, drawn: FloatArray) -> None:
        self.at = np.ascontiguousarray(at, np.int64)
        own, squares = library.given(drawn, len(drawn), 10), np.sum(drawn**2, axis=1)[:, None]
        factor: FloatArray = np.divide(own, squares, out=np.zeros_like(own), where=squares > 0.0)
        self.drawn = own, factor

    def linear(self, state: FloatArray) -> FloatArray:
        """The state, (p,), with s in place of z."""
        linear, z = state.copy(), state[self.at]
        own = len(self.drawn[0]), *(library.address(part) for part in (*self.drawn, z))
        linear[self.at] = library.call("heft_scaled", *own, out=np.empty(z.size))
        return linear
