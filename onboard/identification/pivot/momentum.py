"""A body on a pivot by the balance of its momentum, as a start for the fit.

Over a second ``J w + h`` changes by the integral of ``g u x c - w x (J w + h)``, with rate w and vertical u as they are
read: linear in first moment c and inertia J. No drawing has to be near. That matters where a drawing leaves out what
balances a wheel: within a window such a body swings to where no step leads back from.
"""

import numpy as np

from onboard.dynamics.model.inertia import symmetric
from onboard.estimation.arrays import BoolArray, FloatArray

_BASIS = np.stack([symmetric(one) for one in np.eye(6)], axis=2)  # (3, 3, 6)


def by_momentum(
    motion: tuple[FloatArray, FloatArray, FloatArray],
    whole: BoolArray,
    proof: FloatArray,
    beforehand: tuple[FloatArray, FloatArray],
    noise: float,
    g: float,
    period_s: float,
) -> FloatArray:
    """First moment and inertia about the pivot, (9,): XX XY YY XZ YZ ZZ.

    Args:
        motion: rate rad/s, specific force m/s^2, what the wheels store N m s, each (k, n, 3), body axes, over k spans.
        whole: (k,) which spans were measured without a gap.
        proof: (k, 9) the same numbers of what is known to be set on.
        beforehand: mean and sigma, (9,) each.
        noise: of a momentum, N m s.
        g: m/s^2.
        period_s: between ticks.
    """
    w, f, h = (one[whole] for one in motion)
    u = f / np.linalg.norm(f, axis=2, keepdims=True)
    spin = np.einsum("ijm,knj->knim", _BASIS, w)
    lever = -np.cross(np.eye(3), u[:, :, None])  # (k, n, 3, 3): row i is u x e_i
    torque = np.concatenate([g * lever.swapaxes(2, 3), -np.cross(w[..., None], spin, 2, 2, 2)], axis=3)
    gained = np.concatenate([np.zeros((*w.shape, 3)), spin], axis=3)
    A = gained[:, -1] - gained[:, 0] - np.trapezoid(torque, dx=period_s, axis=1)
    b = h[:, 0] - h[:, -1] - np.trapezoid(np.cross(w, h), dx=period_s, axis=1)
    b -= np.einsum("kim,km->ki", A, proof[whole])
    mean, sigma = beforehand
    A, b = A.reshape(-1, 9) * sigma / noise, (b - A @ mean).ravel() / noise
    return np.asarray(mean + sigma * np.linalg.solve(A.T @ A + np.eye(9), A.T @ b), np.float64)
