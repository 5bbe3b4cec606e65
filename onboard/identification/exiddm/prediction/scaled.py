"""Errors of bodies in the drawing, such that all masses together grow along the same direction wherever the state is.

With all masses and moments of inertia a times as large, what an arm does to its base is the same: no motion shows a.
Where the parameters of a body are those of the drawing and a linear function of its errors z, that direction depends on
them, and what was learned about one estimate is information about all masses about another one: after an error of 10 %
was allowed for, all masses of a free-flyer without a cell were told to 3 % in ten seconds, and of two explanations that
no motion tells apart, the arm 10 % lighter or the base 10 % heavier, the wrong one was believed.

So the part of z along the body itself is the logarithm of a factor: with ``z = d t + r``, ``d = L^-1 chi``, r at right
angles to d (chi: drawn parameters, L: root of their covariance, so that z is of unit variance),

    exp(t) (chi + L r) = chi + L s,   s = exp(t) (d + r) - d,   ds/dz = exp(t) (1 + r d' / d'd)

which for small z is z.
"""

import numpy as np

from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.identification.exiddm.prediction.parameters import together


class Scaled:
    """Errors of some bodies.

    Args:
        at: where their errors stand in the state, (10 k,).
        drawn: d of each, (k, 10); zero: a body without mass.
    """

    def __init__(self, at: IndexArray, drawn: FloatArray) -> None:
        self._at, self._drawn = together(at), drawn
        self._of_body = np.repeat(np.eye(len(drawn)), drawn.shape[1], axis=0)  # (10 k, k)
        squares = np.sum(drawn**2, axis=1)[:, None]
        self._factor = np.divide(drawn, squares, out=np.zeros_like(drawn), where=squares > 0.0)  # t of z

    def linear(self, state: FloatArray) -> FloatArray:
        """The state, (p,), with s in place of z."""
        linear = state.copy()
        t, r = self._parts(state)
        linear[self._at] = (np.exp(t) * (self._drawn + r) - self._drawn).ravel()
        return linear

    def derive(self, by: FloatArray, state: FloatArray) -> None:
        """Make derivatives by s, (..., p), those by z, in place."""
        t, r = self._parts(state)
        own = by[..., self._at]
        more = (own @ (r.ravel()[:, None] * self._of_body)) @ (self._factor.ravel()[:, None] * self._of_body).T
        by[..., self._at] = (own + more) * np.repeat(np.exp(t), r.shape[1])

    def _parts(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        z = state[self._at].reshape(self._drawn.shape)
        t = np.sum(self._factor * z, axis=1, keepdims=True)
        return t, z - t * self._drawn
