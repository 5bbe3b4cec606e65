"""Momentum of a link, linear in its parameters: NumPy beside the compiled core's, for worlds and tests."""

import numpy as np

from onboard.dynamics.kinematics import LinkMotion, inertia_columns, turned
from onboard.estimation.arrays import FloatArray, cross, hat


def momentum_columns(link: LinkMotion, v: FloatArray, w: FloatArray) -> FloatArray:
    """Momentum (linear, angular about the base's origin) of one link as columns of its ten parameters, (n, 6, 10).

    ``l = m v_Lo + w_L x h``, ``k_Lo = I w_L + h x v_Lo``, moved to the base's origin; h: first moment.

    Args:
        link: its motion relative to the base.
        v: velocity of the base's origin, (n, 3).
        w: rate of the base, (n, 3).
    """
    wi = link.w + w
    vi = v + link.v + cross(w, link.p)
    Rt = link.R.swapaxes(-1, -2)
    own, along = turned(Rt, wi), turned(Rt, vi)
    H = np.zeros((*wi.shape[:-1], 6, 10))
    H[..., :3, 0] = vi
    H[..., :3, 1:4] = link.R @ hat(own)
    H[..., 3:, 0] = cross(link.p, vi)
    H[..., 3:, 1:4] = hat(link.p) @ H[..., :3, 1:4] - link.R @ hat(along)
    H[..., 3:, 4:] = link.R @ inertia_columns(own)
    return H
