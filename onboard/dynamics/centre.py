"""Centre of mass of a whole vehicle in base axes about the base's origin, and its derivatives.

It stands in the composite inertia, whose linear momentum of a turn is ``-m hat(r)``.
"""

import numpy as np

from onboard.dynamics.spatial import Columns
from onboard.estimation.arrays import FloatArray


def centre_of(composite: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mass, (n, 1), and centre of mass, (n, 3), of spatial inertias about the base's origin, (n, 6, 6)."""
    mass_kg = composite[:, 0, 0, None]
    moment = -np.stack([composite[:, 2, 4], composite[:, 0, 5], composite[:, 1, 3]], axis=1)  # -m hat(r) in it
    with np.errstate(divide="ignore", invalid="ignore"):  # nothing has no centre: not finite
        return mass_kg, np.asarray(moment / mass_kg, np.float64)


def centre_by_chi(free: Columns, X: FloatArray, mass_kg: FloatArray, centre_m: FloatArray) -> FloatArray:
    """Derivative of the centre of mass by standard parameters, (n, 3, c): ``dr = (d(m r) - r dm) / m``.

    Args:
        free: the links.
        X: :func:`onboard.dynamics.spatial.force_transforms` of all links, (n, links, 6, 6).
        mass_kg: (n, 1).
        centre_m: (n, 3).
    """
    n, c = len(X), 10 * len(free.links)
    along_x, along_y = np.empty((n, 6, c)), np.empty((n, 6, c))
    for out, unit in ((along_x, 0), (along_y, 1)):  # momentum of unit translations: m, and m r across
        free.into(out, X, np.broadcast_to(np.eye(6)[unit], X.shape[:-1]))
    d_mass = along_x[:, :1]
    d_moment = np.stack([along_y[:, 5], -along_x[:, 5], along_x[:, 4]], axis=1)
    return np.asarray((d_moment - centre_m[..., None] * d_mass) / mass_kg[..., None], np.float64)
