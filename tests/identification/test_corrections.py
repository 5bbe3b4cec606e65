"""Corrections of instruments and links, all together, against what the motion tells of them."""

import numpy as np
import pytest

from onboard.channels import QUANTITY
from onboard.identification.corrections import DOUBTFUL, Together, contradicted, together, too_large


def posterior_of(told: float, rng: np.random.Generator, k: int = 80) -> np.ndarray:
    """Covariance of k corrections of unit prior that motion tells of, some well and most hardly."""
    rows = told * rng.standard_normal((k, 2 * k)) * np.geomspace(1e-3, 1.0, k)[:, None]
    return np.asarray(np.linalg.inv(np.eye(k) + rows @ rows.T))


@pytest.mark.parametrize("told", [1.0, 0.03, 1e-4])
def test_of_sound_flights_as_many_are_improbable_as_chance_makes(told: float, rng: np.random.Generator) -> None:
    posterior = posterior_of(told, rng)
    values, vectors = np.linalg.eigh(np.eye(len(posterior)) - posterior)
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    found = [together(spread @ rng.standard_normal(len(posterior)), posterior) for _ in range(2000)]
    chances = np.array([one.chance for one in found])
    assert 0.4 < np.median(chances) < 0.6
    assert (chances < 0.01).mean() < 0.02
    assert not any(one.refused() for one in found)
    assert sum(bool(one.doubted()) for one in found) == sum(one.widening > 1.0 for one in found) < 12  # 3.3 expected


@pytest.mark.parametrize("judged", [contradicted, too_large])
@pytest.mark.parametrize(("count", "limit"), [(1, 4.305), (20, 4.927), (100, 5.233)])  # of 1e-4 / 6, both sides
def test_one_correction_is_refused_where_the_largest_of_so_many_is_one_in_60_000_times(judged, count, limit) -> None:
    others = {f"bias_{k}": 0.1 for k in range(count - 1)}
    assert judged({"scale": limit - 0.01, **others}) == ()
    [said] = judged({"scale": -limit - 0.01, **others})
    assert "scale" in said
    assert f"by {limit:.0f} " in said


def test_many_that_are_each_within_two_sigmas_are_refused_together(rng: np.random.Generator) -> None:
    """What slosh does: 60 corrections of which the motion tells all take a part of it."""
    k = 60
    posterior = 0.1 * np.eye(k)
    moved = rng.choice([-1.0, 1.0], k) * 1.6 * np.sqrt(0.9)
    one = together(moved, posterior)
    assert one.refused()
    assert not one.doubted()
    assert "1.6 times what is stated" in one.refused()[0]
    assert len(one.refused()[0]) <= QUANTITY["why"].itemsize
    assert one.widening == pytest.approx(60 * 1.6**2 / 97.24, rel=0.01)  # chi-squared of 60, exceeded by 0.17 %


def test_between_improbable_and_refused_there_is_a_doubt() -> None:
    k = 60
    one = together(np.full(k, 1.3 * np.sqrt(0.9)), 0.1 * np.eye(k))
    assert 1e-4 / 6 < one.chance < 1e-2 / 6
    assert one.doubted()
    assert not one.refused()


def test_one_alone_widens_as_its_own_test_does() -> None:
    assert together(np.array([2.0 * DOUBTFUL * np.sqrt(0.5)]), np.array([[0.5]])).widening == pytest.approx(
        4.0, rel=1e-6
    )


def test_nothing_is_said_of_none_of_those_whose_prior_is_wider_for_now_and_of_those_no_motion_tells_of() -> None:
    none, wider, untold = np.zeros((0, 0)), np.array([[2.0]]), np.eye(2)
    for found in (
        together(np.zeros(0), none),
        together(np.array([9.0]), wider),
        together(np.array([0.0, 1e-9]), untold),
    ):
        assert found.chance == found.widening == 1.0
        assert not found.refused()
        assert not found.doubted()


@pytest.mark.parametrize("told", [1.0, 0.3])
def test_no_more_squares_than_expected_are_as_probable_as_with_all_degrees_of_freedom(told, rng, monkeypatch) -> None:
    posterior, quick = posterior_of(told, rng), 0
    values, vectors = np.linalg.eigh(np.eye(len(posterior)) - posterior)
    weights = values / (values + 0.05)
    mean, square = weights.sum(), (weights**2).sum()
    for size in np.linspace(0.3, 1.6, 40):
        moved = vectors @ (size * np.sqrt(np.maximum(values, 0.0)) * rng.choice([-1.0, 1.0], len(posterior)))
        squares = float((vectors.T @ moved) ** 2 @ (1.0 / (values + 0.05)))
        one, whole = together(moved, posterior), Together(squares * mean / square, mean**2 / square)
        assert bool(one.refused()) == bool(whole.refused())
        assert bool(one.doubted()) == bool(whole.doubted())
        assert one.widening == pytest.approx(whole.widening)
        if one.freedom < 0.999 * whole.freedom:
            assert whole.chance > 0.3
            quick += 1
    assert 0 < quick < 40
