"""Convex polygons in the (offset, rate) plane: the set of clock parameters consistent with bounded errors.

Quantised marks give bounds, whose intersection is a convex polygon. It is propagated in time (sheared), widened by the
possible drift of the rate, and cut by the next mark; only the widening is approximate, and encloses the exact set
(Schweppe, "Recursive state estimation: unknown but bounded errors", 1968).

Vertices are (x, y) floats in counter-clockwise order; x [ns], y [ns/s].
"""

import math
from itertools import pairwise
from typing import NamedTuple

Point = tuple[float, float]
Polygon = list[Point]

_MOST_VERTICES = 16


class Moments(NamedTuple):
    """Mean and covariance of the uniform distribution over a polygon."""

    x: float
    y: float
    xx: float
    xy: float
    yy: float


def box(x_low: float, x_high: float, y_low: float, y_high: float) -> Polygon:
    """Rectangle of these limits."""
    return [(x_low, y_low), (x_high, y_low), (x_high, y_high), (x_low, y_high)]


def clip(polygon: Polygon, a: float, b: float, c: float) -> Polygon:
    """The part of ``polygon`` with ``a x + b y <= c``, possibly empty (Sutherland and Hodgman, 1974)."""
    excess = [a * x + b * y - c for x, y in polygon]
    if max(excess) <= 0.0:
        return polygon if len(polygon) > 2 else []
    kept: Polygon = []
    following = zip(polygon[1:] + polygon[:1], excess[1:] + excess[:1], strict=True)
    for p, here, (q, there) in zip(polygon, excess, following, strict=True):
        if here <= 0.0:
            kept.append(p)
        if (here < 0.0 < there) or (there < 0.0 < here):
            share = here / (here - there)
            kept.append((p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1])))
    return kept if len(kept) > 2 else []


def widen(polygon: Polygon, x: float, y: float) -> Polygon:
    """Minkowski sum with the segment from (-x, -y) to (x, y)."""
    facing: list[float] = []  # outward normals projected on the segment
    ax, ay = polygon[-1]
    for bx, by in polygon:
        facing.append((by - ay) * x - (bx - ax) * y)
        ax, ay = bx, by
    out = next((side > 0.0 for side in reversed(facing) if side != 0.0), True)
    wider: Polygon = []
    for (px, py), side, following in zip(polygon, facing, facing[1:] + facing[:1], strict=True):
        if side != 0.0:
            out = side > 0.0
        wider.append((px + x, py + y) if out else (px - x, py - y))
        if following != 0.0 and (following > 0.0) is not out:
            wider.append((px - x, py - y) if out else (px + x, py + y))
    return wider if len(wider) <= _MOST_VERTICES else _hull(wider)


def moments(polygon: Polygon) -> Moments:
    """Centroid and covariance, by Green's theorem about the first vertex."""
    x0, y0 = polygon[0]
    points = [(x - x0, y - y0) for x, y in polygon]
    area = sx = sy = sxx = sxy = syy = 0.0
    for (ax, ay), (bx, by) in pairwise([*points, points[0]]):
        cross = ax * by - bx * ay
        area += cross
        sx += (ax + bx) * cross
        sy += (ay + by) * cross
        sxx += (ax * ax + ax * bx + bx * bx) * cross
        syy += (ay * ay + ay * by + by * by) * cross
        sxy += (ax * by + 2.0 * ax * ay + 2.0 * bx * by + bx * ay) * cross
    if area <= 0.0:  # area lost to rounding: use the corners
        n = len(points)
        mx, my = sum(x for x, _ in points) / n, sum(y for _, y in points) / n
        return Moments(
            x0 + mx,
            y0 + my,
            sum((x - mx) ** 2 for x, _ in points) / n,
            sum((x - mx) * (y - my) for x, y in points) / n,
            sum((y - my) ** 2 for _, y in points) / n,
        )
    mx, my = sx / (3.0 * area), sy / (3.0 * area)
    xx, yy = sxx / (6.0 * area) - mx * mx, syy / (6.0 * area) - my * my
    return Moments(x0 + mx, y0 + my, max(xx, 0.0), sxy / (12.0 * area) - mx * my, max(yy, 0.0))


def _hull(points: list[Point]) -> Polygon:
    """Convex hull (Andrew, 1979), simplified from outside if it has too many corners."""
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return ordered
    lower, upper = _chain(ordered), _chain(ordered[::-1])
    hull = lower[:-1] + upper[:-1]
    return hull if len(hull) <= _MOST_VERTICES else _simplified(hull)


def _chain(ordered: list[Point]) -> Polygon:
    chain: Polygon = []
    for x, y in ordered:
        while len(chain) > 1:
            (ax, ay), (bx, by) = chain[-2:]
            if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:  # it turns to the left there
                break
            chain.pop()
        chain.append((x, y))
    return chain


def _simplified(polygon: Polygon) -> Polygon:
    """Enclosing polygon with fewer corners: the shortest sides are removed and their neighbours extended."""
    scale_x = max(x for x, _ in polygon) - min(x for x, _ in polygon)
    scale_y = max(y for _, y in polygon) - min(y for _, y in polygon)
    while len(polygon) > _MOST_VERTICES // 2:
        n = len(polygon)
        lengths = [
            math.hypot((polygon[i][0] - polygon[i - 1][0]) / scale_x, (polygon[i][1] - polygon[i - 1][1]) / scale_y)
            for i in range(n)
        ]
        for i in sorted(range(n), key=lengths.__getitem__):
            apex = _meeting(polygon[i - 2], polygon[i - 1], polygon[i], polygon[(i + 1) % n])
            if apex is not None:
                polygon = [p for k, p in enumerate(polygon) if k != (i - 1) % n]
                polygon[max(i - 1, 0)] = apex
                break
        else:
            break
    return polygon


def _meeting(a: Point, b: Point, c: Point, d: Point) -> Point | None:
    """Intersection of line a b extended beyond b with line d c extended beyond c; None if there is none."""
    ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], c[0] - d[0], c[1] - d[1]
    cross = ux * vy - uy * vx
    if cross >= 0.0:
        return None
    along = ((c[0] - b[0]) * vy - (c[1] - b[1]) * vx) / cross
    return (b[0] + along * ux, b[1] + along * uy) if along >= 0.0 else None
