"""Which instruments are used, left out and taken back."""

import numpy as np
import pytest

from onboard.identification.free_flyer.fusion import Accusation, Fusion

TICKS = 10


@pytest.fixture
def fusion() -> Fusion:
    return Fusion(("imu", "imu_2", "cell"), (slice(0, 6), slice(6, 12), slice(12, 13)))


def test_lines_are_ordered_by_instrument_and_those_left_out_come_last(fusion: Fusion) -> None:
    fusion.leave_out(1)
    assert fusion.order == [0, 2, 1]
    assert fusion.contradicting == ("imu_2",)
    rows = fusion.rows(fusion.order, 2)
    np.testing.assert_array_equal(rows[:14], [0, 1, 2, 3, 4, 5, 13, 14, 15, 16, 17, 18, 12, 25])
    assert sorted(rows.tolist()) == list(range(26))
    assert [(change.kind, change.what) for change in fusion.news()] == [("left_out", "imu_2")]
    assert fusion.news() == []


def test_without_the_first_imu_the_second_one_is_the_reference(fusion: Fusion) -> None:
    assert fusion.rivals(0) == [0, 1]
    assert fusion.rivals(1) == [1, 0]
    assert fusion.rivals(2) == [2]
    assert fusion.doubted(longer=False) == [0, 1]
    assert fusion.doubted(longer=True) == [0, 1, 2]
    assert fusion.reference == 0
    fusion.leave_out(0)
    assert fusion.reference == 1
    assert fusion.order == [1, 2, 0]
    assert fusion.rivals(2) == fusion.doubted(longer=True) == [2]
    e = np.full(13 * TICKS, 5.0)
    assert fusion.improbable([1, 2, 0], e, np.ones((TICKS, 13), np.bool_)) == 2


def test_an_imu_without_readings_is_left_out_if_there_is_another_and_used_again(fusion: Fusion) -> None:
    for _ in range(9):
        fusion.judged([], np.array([False, True, True]))
    assert fusion.reference == 0
    fusion.judged([], np.array([False, True, True]))
    assert fusion.reference == 1
    assert fusion.absent == {0}
    assert fusion.contradicting == ()
    for _ in range(20):
        fusion.judged([], np.array([False, False, True]))
    assert fusion.reference == 1
    for _ in range(100):
        fusion.judged([], np.array([True, True, True]))
    assert fusion.reference == 0
    assert not fusion.absent
    assert [(change.kind, change.what) for change in fusion.news()] == [("absent", "imu"), ("taken_back", "imu")]


@pytest.mark.parametrize(("silent", "reference"), [((0,), 1), ((1,), 0), ((0, 1), 0), ((), 0)])
def test_in_a_window_an_imu_without_readings_is_not_expected(
    fusion: Fusion, silent: tuple[int, ...], reference: int
) -> None:
    measured = np.zeros((100, 13))
    for k in silent:
        measured[40:, 6 * k : 6 * k + 6] = np.nan
    fusion.expect(measured)
    assert fusion.reference == reference
    assert fusion.absent == (set(silent) if len(silent) == 1 else set())


def test_an_imu_that_reads_in_most_ticks_of_a_window_is_expected(fusion: Fusion) -> None:
    measured = np.zeros((100, 13))
    measured[60:, :6] = np.nan
    fusion.expect(measured)
    assert not fusion.absent


def test_half_an_imu_is_none(fusion: Fusion) -> None:
    measured = np.zeros((2, 13))
    measured[0, 7] = measured[1, 12] = np.nan
    there = fusion.whole(measured)
    assert there[0].tolist() == [True] * 6 + [False] * 6 + [True]
    assert there[1].tolist() == [True] * 12 + [False]
    assert np.isnan(fusion.without([2], measured)[:, 12]).all()
    assert not np.isnan(measured[0, 12])


def test_an_improbable_instrument_is_named_and_the_first_never(fusion: Fusion, rng: np.random.Generator) -> None:
    there, e = np.ones((TICKS, 13), np.bool_), rng.standard_normal(13 * TICKS)
    assert fusion.improbable([0, 1, 2], e, there) is None
    e[: 6 * TICKS] *= 5.0
    assert fusion.improbable([0, 1, 2], e, there) is None
    e[12 * TICKS :] *= 5.0
    assert fusion.improbable([0, 1, 2], e, there) == 2
    assert fusion.improbable([0, 1, 2], e, there, known=[2]) is None


def test_one_refused_for_half_a_second_is_accused_and_one_left_out_is_used_again_once(fusion: Fusion) -> None:
    seen = np.array([True, True, True])
    for again in (False, True):
        for _ in range(5):
            assert fusion.refused is None
            fusion.judged([2], seen)
        assert fusion.refused == Accusation(2, 5, for_good=False)
        assert fusion.contradicting == ()
        fusion.forget()
        assert fusion.refused is None
        fusion.leave_out(2, for_good=False)
        fusion.judged([2], np.array([True, True, False]))
        for _ in range(100):
            assert fusion.contradicting == ("cell",)
            fusion.judged([], seen)
        assert fusion.contradicting == (("cell",) if again else ())
    assert [change.kind for change in fusion.news()] == ["left_out", "taken_back", "left_out"]


def test_a_tracker_that_was_left_out_is_not_used_again() -> None:
    """While it is left out nothing tells which pose it should show, so that any agrees."""
    fusion = Fusion(("imu", "cell", "tracker"), (slice(0, 6), slice(6, 7), slice(7, 14)))
    for instrument in (1, 2):
        fusion.leave_out(instrument, for_good=False)
    for _ in range(300):
        fusion.judged([], np.ones(3, np.bool_))
    assert fusion.left_out == [2]
    assert [(change.kind, change.what) for change in fusion.news()][-1] == ("taken_back", "cell")
