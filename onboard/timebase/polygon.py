"""Convex polygons in the (offset, rate) plane: the set of clock parameters consistent with bounded errors.

Quantised marks give bounds, whose intersection is a convex polygon. It is propagated in time (sheared), widened by the
possible drift of the rate, and cut by the next mark; only the widening is approximate, and encloses the exact set
(Schweppe, "Recursive state estimation: unknown but bounded errors", 1968).

Corners are (x, y) in counter-clockwise order, (k, 2); x [ns], y [ns/s]. Computed in ``onboard/native/src/polygon.c``:
cuts by Sutherland and Hodgman (1974), hulls by Andrew (1979), moments by Green's theorem.
"""

from collections.abc import Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.native import library
from onboard.native.errors import ArrayError

Polygon = FloatArray  # (k, 2); without corners: nothing is possible
NOTHING: Polygon = np.zeros((0, 2))
_NONE = (0.0,) * 6  # in place of segments or lines that are not there

_MOST_CORNERS = 16  # of a wider one: above it, those of the shortest sides are left out, from outside


class Moments(NamedTuple):
    """Mean and covariance of the uniform distribution over a polygon."""

    x: float
    y: float
    xx: float
    xy: float
    yy: float


def box(x_low: float, x_high: float, y_low: float, y_high: float) -> Polygon:
    """Rectangle of these limits."""
    return np.array([(x_low, y_low), (x_high, y_low), (x_high, y_high), (x_low, y_high)], np.float64)


def moved(
    polygon: Polygon,
    shear: tuple[float, float] = (0.0, 0.0),
    segments: Sequence[tuple[float, float]] = (),
    lines: Sequence[tuple[float, float, float]] = (),
) -> Polygon:
    """The polygon sheared, then widened, then cut; without corners where nothing is left.

    Args:
        polygon: with a corner at least.
        shear: s and d of ``x + s y + d``.
        segments: (x, y) of two at most: the Minkowski sum with each from (-x, -y) to (x, y).
        lines: (a, b, c) of two at most: the part with ``a x + b y <= c`` is left.

    Raises:
        ArrayError: of another shape, or without a corner.
    """
    count = len(polygon)
    given = library.given(polygon, count, 2)
    try:
        how = np.array([*shear, *chain(*segments, _NONE[2 * len(segments) : 4], *lines, _NONE[3 * len(lines) : 6])])
    except TypeError as wrong:  # numbers in place of pairs or triples
        raise ArrayError(f"segments are pairs and lines are triples: {wrong}") from None
    numbers = len(segments), len(lines), library.address(library.given(how, 12))
    out = np.empty(1 + 20 * (count + 2))
    library.call("heft_polygon", count, _MOST_CORNERS, library.address(given), *numbers, out=out)
    return out[1 : 1 + 2 * int(out[0])].reshape(-1, 2)


def widen(polygon: Polygon, x: float, y: float) -> Polygon:
    """Minkowski sum with the segment from (-x, -y) to (x, y)."""
    return moved(polygon, segments=[(x, y)])


def moments(polygon: Polygon) -> Moments:
    """Centroid and covariance; those of the corners where rounding has left no area."""
    given = library.given(polygon, len(polygon), 2)
    found = library.call("heft_moments", len(polygon), library.address(given), out=np.empty(5))
    return Moments(*found.tolist())
