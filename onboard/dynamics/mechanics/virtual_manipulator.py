"""The virtual manipulator of Vafa and Dubowsky: an arm on a fixed virtual ground whose tip is the real arm's tip.

The virtual ground is the centre of mass of the whole vehicle, which no internal force moves (2.24). With bodies 0..n,
``mu_i`` the share of the mass that bodies 0..i have, ``a_i`` from body i's origin to the next joint (the tip for the
last) and ``c_i`` its centre of mass,

    p_tip - p_cm = sum_i R_i V_i,    V_i = mu_i a_i - (m_i / M) c_i

which is (2.25)-(2.28): the dissertation's ``r_i + l_i`` are mass shares of the body's vectors from its centre of mass
to its joints. A prismatic joint's travel is scaled by the share of what is before it (2.29).
"""

import numpy as np

from onboard.dynamics.mechanics.chain import SerialChain, offsets, rotations
from onboard.estimation.arrays import FloatArray


def mass_shares(chain: SerialChain) -> FloatArray:
    """``mu_i``, (n + 1,): the share of the vehicle's mass in bodies 0..i (2.25-2.28)."""
    return np.asarray(np.cumsum(chain.mass) / chain.mass.sum(), np.float64)


def virtual_links(chain: SerialChain, q: FloatArray) -> FloatArray:
    """``V_i``, (n + 1, 3) m, in each body's axes; constant but for prismatic joints (2.25-2.29)."""
    share = chain.mass / chain.mass.sum()
    return np.asarray(mass_shares(chain)[:, None] * offsets(chain, q) - share[:, None] * chain.centre, np.float64)


def virtual_tip(chain: SerialChain, q: FloatArray) -> FloatArray:
    """From the virtual ground to the tip, (3,) m, base axes (2.28)."""
    return np.asarray(np.einsum("iab,ib->a", rotations(chain, q), virtual_links(chain, q)), np.float64)


def virtual_jacobian(chain: SerialChain, q: FloatArray, axes_rate: FloatArray) -> FloatArray:
    """The tip's velocity per joint rate, (3, n), with bodies turning by ``axes_rate`` (n + 1, 3, n), base axes.

    ``axes_rate[i]`` is the angular velocity of body i in inertial space per joint rate; for a base that floats at zero
    momentum the base's part is in it (see :mod:`onboard.dynamics.mechanics.barycentric`).
    """
    R = rotations(chain, q)
    arms = np.einsum("iab,ib->ia", R, virtual_links(chain, q))  # (n + 1, 3)
    J = np.einsum("iaj->aj", np.cross(axes_rate, arms[:, :, None], axisa=1, axisb=1, axisc=1))
    shares = mass_shares(chain)
    for k, revolute in enumerate(chain.revolute):
        if not revolute:
            J[:, k] += shares[k] * R[k] @ chain.next_axes[k] @ chain.axis[k]
    return np.asarray(J, np.float64)
