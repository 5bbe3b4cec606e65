"""Dynamic singularities and workspaces of a floating arm (Papadopoulos and Dubowsky), over two of its joints.

Where ``J*`` loses rank the tip cannot move in some direction, whatever the joints do, although the fixed arm could. The
distance of the tip from the vehicle's centre of mass depends on the joints alone, so the tip reaches a point at that
distance either by singular configurations or not, depending on the path and the attitude it brings about: distances
that no singular configuration has are the path-independent workspace, the others the path-dependent one.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import FREE_FLYER_NV
from onboard.estimation.arrays import FloatArray, cross

Span = tuple[float, float]


class SingularityMap(NamedTuple):
    """Over a grid of two joints, the others held."""

    first: FloatArray  # (k,) rad, positions of the first joint
    second: FloatArray  # (m,) rad
    measure: FloatArray  # (k, m) m^2, see :func:`pair_measure`
    distance: FloatArray  # (k, m) m of the tip from the vehicle's centre of mass
    reachable: Span  # least and greatest distance, m
    dependent: tuple[Span, ...]  # distances of singular configurations
    independent: tuple[Span, ...]  # reachable distances that no singular configuration has


def tip_distance(arm: FloatingArm, q: FloatArray) -> float:
    """Distance of the tip from the vehicle's centre of mass, m (Papadopoulos and Dubowsky)."""
    return float(np.linalg.norm(arm.tip_pose(q)[1] - arm.centre_of_mass(q)))


def least_singular_value(arm: FloatingArm, q: FloatArray) -> float:
    """Of the linear part of J* (2.93), all joints: zero at a dynamic singularity, m."""
    return float(np.linalg.svd(arm.generalized_jacobian(q)[:3], compute_uv=False)[-1])


def pair_measure(arm: FloatingArm, q: FloatArray, pair: tuple[int, int]) -> float:
    """Measure of a dynamic singularity of two joints, m^2, zero there: determinant or area of J* (2.93).

    For parallel axes the determinant of J* in the plane across them, with its sign; else the area that the two columns
    of J* span, which has none.
    """
    tip, A = arm.tip_jacobian(q), arm.momentum_map(q)
    columns = [FREE_FLYER_NV + joint for joint in pair]
    J = (tip[:, columns] - tip[:, :FREE_FLYER_NV] @ np.linalg.solve(A[:, :FREE_FLYER_NV], A[:, columns]))[:3]
    spins = tip[3:, columns]  # the joints' axes, base axes; zero for a joint that slides
    normal = cross(*J.T)
    first, second = spins[:, 0], spins[:, 1]
    parallel = abs(abs(float(first @ second)) - 1.0) < 1e-9
    return float(first @ normal) if parallel else float(np.sqrt(normal @ normal))


def singularity_map(arm: FloatingArm, q: FloatArray, pair: tuple[int, int], samples: int = 91) -> SingularityMap:
    """Singularities and workspaces over two joints (Limparis 2.1.3; Papadopoulos and Dubowsky).

    Args:
        arm: the vehicle.
        q: joint positions, (n,); those of the pair are varied.
        pair: indices of the joints.
        samples: of each joint, evenly from limit to limit, a whole turn at most.

    Raises:
        SignalError: a pair that is not two joints of the arm, or fewer than three samples.
    """
    if len({*pair}) != 2 or not all(0 <= joint < arm.joints for joint in pair) or samples < 3:
        raise SignalError(f"joints {pair} of {arm.joints}, {samples} samples: name two joints, three samples or more")
    axes = []
    for joint in pair:
        limits = arm.vehicle.joints[joint]
        axes.append(np.linspace(max(limits.low, -np.pi), min(limits.high, np.pi), samples))
    measure, distance = np.empty((samples, samples)), np.empty((samples, samples))
    at = np.array(q, np.float64)
    for i, at[pair[0]] in enumerate(axes[0]):
        for k, at[pair[1]] in enumerate(axes[1]):
            measure[i, k], distance[i, k] = pair_measure(arm, at, pair), tip_distance(arm, at)
    reachable = float(distance.min()), float(distance.max())
    dependent = _singular_spans(measure, distance)
    return SingularityMap(axes[0], axes[1], measure, distance, reachable, dependent, _between(reachable, dependent))


def _singular_spans(measure: FloatArray, distance: FloatArray) -> tuple[Span, ...]:
    """Distances along each connected curve on which the measure is zero."""
    crossings = np.zeros(measure.shape, np.bool_)
    at = np.full(measure.shape, np.nan)
    small = np.abs(measure) < 1e-12 * np.abs(measure).max()
    crossings |= small
    at[small] = distance[small]
    for axis in (0, 1):
        n = measure.shape[axis]
        a, b = (measure.take(range(k, n - 1 + k), axis) for k in (0, 1))
        da, db = (distance.take(range(k, n - 1 + k), axis) for k in (0, 1))
        changes = a * b < 0.0
        share = np.where(changes, a / np.where(changes, a - b, 1.0), 0.0)
        found = da + share * (db - da)
        cells = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        crossings[cells] |= changes
        at[cells] = np.where(changes, found, at[cells])
    labels, count = ndimage.label(crossings, structure=np.ones((3, 3)))
    spans = sorted((float(at[labels == k].min()), float(at[labels == k].max())) for k in range(1, count + 1))
    merged: list[Span] = []
    for low, high in spans:
        if merged and low <= merged[-1][1]:
            merged[-1] = merged[-1][0], max(high, merged[-1][1])
        else:
            merged.append((low, high))
    return tuple(merged)


def _between(reachable: Span, dependent: tuple[Span, ...]) -> tuple[Span, ...]:
    """What the dependent spans leave; slivers below the grid's resolution are left out."""
    ends = [reachable[0], *(end for span in dependent for end in span), reachable[1]]
    pairs = zip(ends[::2], ends[1::2], strict=True)
    return tuple((low, high) for low, high in pairs if high - low > 5e-3 * reachable[1])
