"""The false-alarm budget of a flight: each of its numbers, and what many looks make of it."""

import numpy as np
import pytest
from scipy.stats import norm

from onboard.estimation import policy


def test_as_many_flights_are_doubted_as_are_wrong_and_a_hundredth_of_them_refused() -> None:
    assert policy.DOUBT == policy.ODDS == 1e-2
    assert policy.REFUSE == 1e-2 * policy.ODDS


def test_intervals_hold_19_of_20() -> None:
    assert policy.INTERVAL == 0.95
    assert norm.cdf(policy.HALF) - norm.cdf(-policy.HALF) == pytest.approx(0.95)


def test_six_tests_of_many_looks_each_spend_the_budget(rng: np.random.Generator) -> None:
    """Of healthy flights with six tests of twenty looks, one in a hundred is beyond a limit that is never beyond it."""
    assert policy.TESTS == 6
    beyond = np.abs(rng.standard_normal((20_000, 6, 20))) > policy.sigmas(policy.of_each(policy.DOUBT, 20))
    assert 0.008 < beyond.any(axis=(1, 2)).mean() < 0.012
    assert 1.0 - (1.0 - policy.of_each(policy.REFUSE, 20)) ** 120 == pytest.approx(policy.REFUSE)
    assert policy.of_each(policy.DOUBT, 0) == policy.of_each(policy.DOUBT)  # nothing to look at


def test_rows_of_an_hour_double_twelve_times_from_those_of_a_second() -> None:
    assert np.log2(3600.0) == pytest.approx(policy.DOUBLINGS, abs=0.5)


def test_a_reading_is_one_of_a_million_of_each_test() -> None:
    assert pytest.approx(0.01 / 6e6, rel=0.01) == policy.READING


def test_more_than_one_reading_in_twenty_is_too_many_to_contradict_the_others() -> None:
    assert not policy.contradicted_text(0.05)
    assert policy.contradicted_text(0.06, "ticks", "it swings") == "6% of the ticks contradict the others; it swings"


def test_evidence_has_words_where_numbers_end() -> None:
    assert [policy.times_text(nats) for nats in (0.0, 2.0, 6.9, 11.6, 5000.0)] == [
        "1",
        "7.39",
        "992",
        "1e+5",
        "1e+2171",
    ]


def test_two_false_changes_in_a_minute_are_by_chance_in_more_flights_than_are_refused_and_three_are_not() -> None:
    assert [policy.too_often(changes, 60.0) for changes in range(4)] == [False, False, False, True]
    assert policy.too_often(2, 5.0)
