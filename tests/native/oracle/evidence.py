"""Evidence of what may not be as stated, in NumPy, one by one."""

from itertools import pairwise

import numpy as np


def by_eigenvalues(M, slope):
    """Nats, sizes and M^-1 of one, of matrices M, (r, r), without eigenvalues below one, and gradients, (r,)."""
    values, V = np.linalg.eigh(M)
    values = np.maximum(values, 1.0)
    inverse = V / values @ V.T
    sizes = inverse @ slope
    return 0.5 * float(slope @ sizes - np.log(values).sum()), sizes, inverse


def alone(suspects, sigma, x, P):
    """M and gradient of each suspect by itself, and of all of them together."""
    every = np.zeros((len(sigma), sum(one.along.shape[1] for one in suspects)))
    ends = np.cumsum([0, *(one.along.shape[1] for one in suspects)])
    own = [slice(*pair) for pair in pairwise(ends)]
    for one, columns in zip(suspects, own, strict=True):
        every[one.at, columns] = one.along
    U = every / sigma[:, None] ** 2
    return np.eye(len(U.T)) + every.T @ U - U.T @ P @ U, U.T @ x, own


def beside(M, slope, first, other):
    """M and gradient of another one, given the first, by their columns."""
    onto = M[other, first] @ np.linalg.inv(M[first, first])
    return M[other, other] - onto @ M[first, other], slope[other] - onto @ slope[first]


def pairs(widths, d, J, odds, farthest):
    """Nats of each two and logarithms of their weights, (n, n), of each alone on the diagonals."""
    n, ends = len(widths), np.cumsum([0, *widths])
    nats = np.full((n, n), -np.inf)
    for a in range(n):
        for b in range(n):
            if a == b or widths[a] == widths[b] == 1:
                at = np.unique([*range(ends[a], ends[a + 1]), *range(ends[b], ends[b + 1])])
                nats[a, b], sizes, _ = by_eigenvalues(np.eye(len(at)) + J[np.ix_(at, at)], d[at])
                if len(at) == widths[a] > 1 and not np.abs(sizes).max() < farthest:
                    nats[a, b] = -np.inf
    return nats, nats + np.where(np.eye(n), odds, odds + odds[:, None])
