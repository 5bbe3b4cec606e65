"""How many base parameters a serial arm has, by Mayeda, Yoshida and Osuka's closed form (section 2.1.4).

For revolute joints whose torques are measured in gravity: ``7 N - 4 B``, B the number of joints from the first on whose
axes are parallel, and two less where the first axis is parallel to gravity (2.64-2.67). The proof is for neighbours
that are parallel or perpendicular; arms with other angles have the same number with B = 1. A geometry that makes
columns vanish besides (an offset that is zero, an axis through the next joint) takes away more: the numerical count
(:mod:`onboard.regressor.base_parameters`) is the one that estimators use.

On a free base whose own wrench is known the base counts as a link that moves in every direction: its ten parameters,
and seven a joint.

On a level bed the base is a link of its own whose joint is vertical, and which slides besides: ``7 (N + 1) - 4 B + 1``,
B counting the base and the vertical joints after it. Of a base whose wrench alone is seen (two forces, the vertical
moment, no joint torques) each horizontal joint that follows directly upon those hides one more: the inertia about its
own axis never turns about the vertical.
"""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.mechanics.chain import SerialChain, rotations
from onboard.estimation.arrays import FloatArray


class Count(NamedTuple):
    """The closed form and what it was made of."""

    parameters: int
    formula: str


def first_cluster(chain: SerialChain, first: int = 0) -> int:
    """B: how many joints, from ``first`` on, have parallel axes (a link cluster of section 2.1.4)."""
    cosines = [chain.axis[k] @ chain.next_axes[k + 1] @ chain.axis[k + 1] for k in range(first, len(chain.axis) - 1)]
    parallel = [abs(abs(cosine) - 1.0) < 1e-9 for cosine in cosines]
    return 1 + (parallel.index(False) if False in parallel else len(parallel))


def fixed_base_count(chain: SerialChain, gravity: FloatArray) -> Count | None:
    """Count for an arm on a fixed base (2.64-2.67), gravity (3,) in base axes; None if a joint is not revolute."""
    if not all(chain.revolute):
        return None
    n, cluster = len(chain.axis), first_cluster(chain)
    axis, size = chain.next_axes[0] @ chain.axis[0], float(np.linalg.norm(gravity))
    along = float(np.linalg.norm(np.cross(axis, gravity))) <= 1e-9 * size
    less = 2 if along else 0
    return Count(7 * n - 4 * cluster - less, f"7 x {n} - 4 x {cluster}{' - 2' if along else ''}")


def free_base_count(chain: SerialChain) -> Count | None:
    """Count for an arm on a free base of known wrench (derived here: 10 + 7 per joint); None if not all revolute."""
    n = len(chain.axis)
    return Count(10 + 7 * n, f"10 + 7 x {n}") if all(chain.revolute) else None


def plane_base_count(chain: SerialChain) -> Count | None:
    """Count for the base wrench on a level bed, z of the base vertical (derived here); None if not all revolute."""
    if not all(chain.revolute):
        return None
    n, rotation = len(chain.axis), rotations(chain, np.zeros(len(chain.axis)))
    upright = [abs((rotation[k + 1] @ chain.axis[k])[2]) for k in range(n)]
    vertical = first_cluster(chain) if abs(upright[0] - 1.0) < 1e-9 else 0
    level = vertical < n and upright[vertical] < 1e-9  # a vertical cluster turns it about z: it stays across
    hidden = first_cluster(chain, vertical) if level else 0
    cluster = 1 + vertical
    less = f" - {hidden}" if hidden else ""
    return Count(7 * (n + 1) - 4 * cluster + 1 - hidden, f"7 x {n + 1} - 4 x {cluster} + 1{less}")
