"""Centre of mass of a whole vehicle in base axes about the base's origin, and its derivatives.

It stands in the composite inertia, whose linear momentum of a turn is ``-m hat(r)``.
"""

import numpy as np

from onboard.dynamics.kinematics import Frames
from onboard.dynamics.spatial import Columns
from onboard.estimation.arrays import FloatArray


def centre_of(composite: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mass, (n, 1), and centre of mass, (n, 3), of spatial inertias about the base's origin, (n, 6, 6)."""
    mass_kg = composite[:, 0, 0, None]
    moment = -np.stack([composite[:, 2, 4], composite[:, 0, 5], composite[:, 1, 3]], axis=1)  # -m hat(r) in it
    with np.errstate(divide="ignore", invalid="ignore"):  # nothing has no centre: not finite
        return mass_kg, np.asarray(moment / mass_kg, np.float64)


def centre_by_chi(free: Columns, frames: Frames, mass_kg: FloatArray, centre_m: FloatArray) -> FloatArray:
    """Derivative of the centre of mass by standard parameters, (n, 3, c): ``dr = (d(m r) - r dm) / m``.

    Args:
        free: the links.
        frames: of all links.
        mass_kg: (n, 1).
        centre_m: (n, 3).
    """
    which, n = list(free.links), len(frames.p)
    arm = frames.p[:, which] - centre_m[:, None]  # (n, k, 3)
    moved = frames.R[:, which] @ free.bases[:, 1:4] + arm[..., None] * free.bases[:, :1]  # (n, k, 3, 10)
    return np.asarray(moved.swapaxes(1, 2).reshape(n, 3, -1) / mass_kg[..., None], np.float64)
