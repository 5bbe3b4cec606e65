"""Barycentric vectors and the reduced inertia of Papadopoulos (2.30-2.37).

The centre of mass of body k lies at ``rho_k = sum_i v_ik`` from that of the vehicle, ``v_ik`` fixed in body i: ``r*_i``
for i < k, ``c*_i`` for i = k, ``l*_i`` for i > k (2.32). With the bodies' inertias they give the inertia of the whole
vehicle about its centre of mass D, the coupling D_q and the joints' own D_qq. Angular momentum is then ``D w + D_q
dq``, kinetic energy ``(w' D w + 2 w' D_q dq + dq' D_qq dq) / 2`` beside that of the centre of mass, and no position of
the base occurs. The last line of (2.36) is printed with one sum; the double sum ``sum_ij F_i' D_ij F_j`` is meant.
Revolute joints only.
"""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.mechanics.chain import SerialChain, rotations
from onboard.dynamics.model.errors import SignalError
from onboard.estimation.arrays import FloatArray


class Barycentric(NamedTuple):
    """Constant vectors of each body, (n + 1, 3) m, in its axes."""

    c: FloatArray  # barycentre from the centre of mass (2.33)
    r: FloatArray  # r*: barycentre to the next joint
    l: FloatArray  # l*: barycentre to the joint before  # noqa: E741 - the dissertation's letter


class ReducedInertia(NamedTuple):
    """In base axes, about the vehicle's centre of mass."""

    D: FloatArray  # (3, 3) kg m^2
    D_q: FloatArray  # (3, n)
    D_qq: FloatArray  # (n, n)


def barycentric(chain: SerialChain) -> Barycentric:
    """Barycentric vectors of a serial arm (2.32, 2.33).

    Raises:
        SignalError: a joint that is not revolute; its vectors are not constant.
    """
    if not all(chain.revolute):
        raise SignalError("barycentric vectors are constant for revolute joints only; this arm has another")
    l_own = -chain.centre  # from the centre of mass to the joint before, which is the body's origin
    r_own = chain.next_origin - chain.centre
    total = chain.mass.sum()
    before = (np.cumsum(chain.mass) - chain.mass) / total  # share of bodies 0..i-1
    after = 1.0 - np.cumsum(chain.mass) / total  # share of bodies i+1..n
    c = l_own * before[:, None] + r_own * after[:, None]
    return Barycentric(c, r_own - c, l_own - c)


def augmented_inertias(chain: SerialChain) -> FloatArray:
    """Inertia of each augmented body about its barycentre, (n + 1, 3, 3) kg m^2, its axes: D_ii of (2.37).

    The augmented body has, besides its own mass, that of all bodies before at its first joint and of all after at its
    next one.
    """
    b = barycentric(chain)
    masses = np.cumsum(chain.mass)
    out = np.array(chain.inertia)
    for i, mass in enumerate(chain.mass):
        ahead, behind = masses[-1] - masses[i], masses[i] - mass
        for m, v in ((behind, b.l[i]), (mass, -b.c[i]), (ahead, b.r[i])):
            out[i] += m * (v @ v * np.eye(3) - np.outer(v, v))
    return out


def reduced_inertia(chain: SerialChain, q: FloatArray) -> ReducedInertia:
    """D, D_q and D_qq at joint positions (n,) (2.36, 2.37)."""
    b, R, n = barycentric(chain), rotations(chain, q), len(chain.axis)
    r, l = np.einsum("iab,ib->ia", R, b.r), np.einsum("iab,ib->ia", R, b.l)  # noqa: E741
    own = np.einsum("iab,ibc,idc->iad", R, augmented_inertias(chain), R)
    axes = np.einsum("iab,ib->ia", R[1:], chain.axis)  # (n, 3) of joint i + 1
    total, identity = chain.mass.sum(), np.eye(3)
    F = np.zeros((n + 1, 3, n))  # F_j: angular velocity of body j per joint rate
    for j in range(1, n + 1):
        F[j, :, :j] = axes[:j].T
    D_ij = np.empty((n + 1, n + 1, 3, 3))
    for i in range(n + 1):
        D_ij[i, i] = own[i]
        for j in range(i + 1, n + 1):
            D_ij[i, j] = -total * (l[j] @ r[i] * identity - np.outer(l[j], r[i]))
            D_ij[j, i] = D_ij[i, j].T
    D_j = D_ij.sum(axis=0)  # (n + 1, 3, 3)
    D_q = np.einsum("jab,jbk->ak", D_j, F)
    D_qq = np.einsum("iak,ijab,jbl->kl", F, D_ij, F)
    return ReducedInertia(D_j.sum(axis=0), D_q, D_qq)


def body_rates(chain: SerialChain, q: FloatArray) -> FloatArray:
    """Inertial angular velocity of every body per joint rate at zero momentum, (n + 1, 3, n), base axes (2.35)."""
    inertia, R, n = reduced_inertia(chain, q), rotations(chain, q), len(chain.axis)
    axes = np.einsum("iab,ib->ia", R[1:], chain.axis)
    base = -np.linalg.solve(inertia.D, inertia.D_q)
    out = np.repeat(base[None], n + 1, axis=0)
    for j in range(1, n + 1):
        out[j, :, :j] += axes[:j].T
    return out
