"""The plane geometry of what is possible, against points that are tried one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.native.errors import ArrayError
from onboard.timebase import polygon as geometry

coordinates = st.floats(-10.0, 10.0, allow_nan=False).map(lambda x: round(x, 3))
half_planes = st.tuples(coordinates, coordinates, coordinates).filter(lambda p: abs(p[0]) + abs(p[1]) > 0.1)


def inside(polygon: geometry.Polygon, x: float, y: float, slack: float) -> bool:
    corners = np.array(polygon)
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*sides.T)
    to_point = np.array([x, y]) - corners
    left = sides[:, 0] * to_point[:, 1] - sides[:, 1] * to_point[:, 0]
    return bool((left >= -slack * lengths).all())


@given(cuts=st.lists(half_planes, max_size=8), x=coordinates, y=coordinates)
def test_a_point_is_left_exactly_when_it_satisfies_every_cut(
    cuts: list[tuple[float, float, float]], x: float, y: float
) -> None:
    polygon = geometry.box(-10.0, 10.0, -10.0, 10.0)
    for a, b, c in cuts:
        polygon = geometry.moved(polygon, lines=[(a, b, c)]) if len(polygon) else polygon
    margins = [(c - a * x - b * y) / np.hypot(a, b) for a, b, c in cuts]
    if all(margin > 1e-3 for margin in margins) and max(abs(x), abs(y)) < 9.99:
        assert inside(polygon, x, y, 1e-9)
    elif any(margin < -1e-3 for margin in margins):
        assert not len(polygon) or not inside(polygon, x, y, -1e-6)


def test_a_cut_meets_the_sides_where_the_line_does() -> None:
    found = geometry.moved(geometry.box(0.0, 4.0, 0.0, 2.0), lines=[(1.0, 0.0, 1.0)])
    assert set(map(tuple, found.tolist())) == {(0, 0), (1, 0), (1, 2), (0, 2)}


@given(cuts=st.lists(half_planes, max_size=6), segment=st.tuples(coordinates, coordinates), share=st.floats(-1.0, 1.0))
def test_widening_holds_every_point_moved_along_the_segment(
    cuts: list[tuple[float, float, float]], segment: tuple[float, float], share: float
) -> None:
    polygon = geometry.box(-10.0, 10.0, -10.0, 10.0)
    for a, b, c in cuts:
        left = geometry.moved(polygon, lines=[(a, b, c)])
        polygon = left if len(left) else polygon
    wide = geometry.widen(polygon, *segment)
    for x, y in polygon:
        assert inside(wide, x + share * segment[0], y + share * segment[1], 1e-6)


def test_fewer_corners_never_lose_a_point(rng: np.random.Generator) -> None:
    for _ in range(200):
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 40))
        ellipse = np.stack([5.0 * np.cos(angles), np.sin(angles)], axis=1)
        wide = geometry.widen(ellipse, 1e-3, 1e-3)
        assert 3 <= len(wide) <= 16
        assert all(inside(wide, x, y, 1e-9) for x, y in ellipse)
        assert max(x for x, _ in wide) < 15.0


def test_moments_are_those_of_points_spread_evenly(rng: np.random.Generator) -> None:
    polygon = geometry.box(-3.0, 5.0, 2.0, 4.0)
    for a, b, c in ((1.0, 1.0, 7.0), (-1.0, 2.0, 9.0), (0.3, -1.0, -1.9)):
        polygon = geometry.moved(polygon, lines=[(a, b, c)])
    points = rng.uniform([-3.0, 2.0], [5.0, 4.0], (200_000, 2))
    points = points[[inside(polygon, x, y, 0.0) for x, y in points[:20_000]] + [False] * 180_000]
    assert len(points) > 5_000
    found = geometry.moments(polygon)
    assert [found.x, found.y] == pytest.approx(points.mean(axis=0), abs=0.05)
    assert [found.xx, found.xy, found.yy] == pytest.approx(np.cov(points.T)[[0, 0, 1], [0, 1, 1]], rel=0.1, abs=0.02)


def test_a_sliver_that_rounding_ate_still_has_a_place() -> None:
    sliver = np.array([(1e9, 5.0), (1e9 + 1e-7, 5.0), (1e9, 5.0)])
    found = geometry.moments(sliver)
    assert found.x == pytest.approx(1e9)
    assert found.xx >= 0.0


@pytest.mark.parametrize("lines", [[1.0, 0.0], [(1.0, 0.0), (0.0, 1.0)], [(1.0, 0.0, 1.0)] * 3])
def test_lines_that_are_not_two_triples_at_most_are_refused(lines):
    with pytest.raises(ArrayError):
        geometry.moved(geometry.box(0.0, 4.0, 0.0, 2.0), lines=lines)
