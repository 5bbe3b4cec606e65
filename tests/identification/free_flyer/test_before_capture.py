"""How a payload moved before it was captured, against MuJoCo's capture of it."""

import numpy as np
import pytest

from bench.true_flights import free_flyer
from onboard.dynamics.model.errors import SignalError
from onboard.ground.identify.identify_view import within_interval
from tests.identification.free_flyer.captures import LARGE, Case


@pytest.mark.parametrize("seed", range(6))
def test_a_large_body_that_tumbles(seed):
    rng = np.random.default_rng(100 + seed)
    case = Case(seed, LARGE, 0.02 * rng.normal(size=3), 0.1 * rng.normal(size=3))
    found = case.told()
    assert case.squares(found) < 22.5  # 99.9 % of chi-squared with 6
    assert (found.sigma[3:] < 0.07).all()
    assert (found.sigma[:3] < 0.06).all()


def test_of_a_small_one_the_interval_says_that_nothing_is_known():
    body = free_flyer.Body.box(1.5, (0.12, 0.11, 0.10), (0.01, -0.01, 0.05))
    case = Case(1, body, np.array([0.02, -0.01, 0.0]), np.array([0.1, 0.0, -0.1]))
    found = case.told()
    assert case.squares(found) < 22.5
    assert (found.sigma[3:] > 0.3).all()


def test_readings_must_be_there():
    case = Case(1, LARGE, np.zeros(3), np.zeros(3))
    with pytest.raises(SignalError, match=r"ticks are missing within 0\.12 s of the capture"):
        case.told(touched_s=(0.1, 0.2))
    with pytest.raises(SignalError, match="no mass"):
        case.told(chi=np.zeros(10))
    holed = case.ticks.part(np.r_[0:110, 112 : len(case.ticks.time_s)])
    with pytest.raises(SignalError, match="readings are missing"):
        case.told(ticks=holed)
    absurd = case.ticks._replace(ddq=1e200 * case.ticks.ddq, dq=1e200 * case.ticks.dq)
    with pytest.raises(SignalError, match="cannot be predicted"):
        case.told(ticks=absurd)
    case.ticks.measured[120, 0] = np.nan
    with pytest.raises(SignalError, match="readings are missing"):
        case.told()


def test_it_is_shown_to_two_digits_of_its_interval():
    assert within_interval(np.array([-2.37, 8.451, 0.0123]), np.array([140.3, 0.59, 0.001])) == (
        "-2 ± 140, 8.45 ± 0.59, 0.0123 ± 0.0010"
    )
