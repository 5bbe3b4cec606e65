"""Hypotheses against brute force: linear problems solved with each prior, and evidences from the readings' density."""

from string import ascii_lowercase

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from onboard.estimation import policy
from onboard.estimation.policy import INTERVAL, LEAST_WEIGHT, tails
from onboard.identification.evidence import bank as bank_module
from onboard.identification.evidence.bank import Bank, Changed, Hypothesis, Root, Suspect, Weighed
from onboard.identification.evidence.mixture import Mixture

SIGMA = np.array([np.nan, 0.2, 0.5, 1.0, 0.1])  # of the first nothing is known
BODY = Suspect("body", np.array([1, 2, 3]), np.array([[0.9, 0.3], [-0.4, 0.0], [2.0, 1.5]]), 1e-2)
CELL = Suspect("cell", np.array([4]), np.array([[1.3]]), 1e-3)


class Linear:
    """``y = A x + e`` with unit noise, prior of mean zero, variance 1e4 where nothing is known."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.A = rng.standard_normal((30, 5))
        self.y = self.A @ np.array([3.0, 0.3, 0.1, -1.0, 2.0]) + rng.standard_normal(30)
        self.prior = np.diag(np.where(np.isnan(SIGMA), 100.0, SIGMA) ** 2)

    def solved(self, *wrong: Suspect) -> tuple[np.ndarray, np.ndarray]:
        prior = self.with_wrong(*wrong)
        P = np.linalg.inv(np.linalg.inv(prior) + self.A.T @ self.A)
        return P @ self.A.T @ self.y, P

    def with_wrong(self, *wrong: Suspect) -> np.ndarray:
        prior = self.prior.copy()
        for one in wrong:
            prior[np.ix_(one.at, one.at)] += one.along @ one.along.T
        return prior

    def nats(self, *wrong: Suspect) -> float:
        spread = self.A @ self.with_wrong(*wrong) @ self.A.T + np.eye(30)
        return float(multivariate_normal(np.zeros(30), spread).logpdf(self.y))


@pytest.fixture
def linear(rng: np.random.Generator) -> Linear:
    return Linear(rng)


def names(first: Suspect, second: Suspect) -> tuple[str, str]:
    return f"{first.name} and {second.name}", f"{second.name} and {first.name}"


def test_each_hypothesis_is_the_fit_with_its_prior_and_has_the_evidence_of_its_readings(linear: Linear) -> None:
    body, cell = (one._replace(odds=100.0) for one in (BODY, CELL))
    weighed = Bank([body, cell], SIGMA).weigh(linear.solved())
    assert weighed.every[-1].suspect.name in names(body, cell)
    for one, wrong in zip(weighed.every, ((), (body,), (cell,), (body, cell)), strict=True):
        for found, wanted in zip(weighed.known(one), linear.solved(*wrong), strict=True):
            np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-10)
        assert one.nats == pytest.approx(linear.nats(*wrong) - linear.nats(), abs=1e-6)
    odds = np.array([1.0, 1e2, 1e2, 1e4]) * np.exp([one.nats for one in weighed.every])
    np.testing.assert_allclose([one.weight for one in weighed.every], odds / odds.sum(), rtol=1e-5)


def test_a_hypothesis_is_the_same_whether_weighed_alone_or_among_many(linear: Linear, rng: np.random.Generator) -> None:
    """Also of suspects that share places and columns."""
    several = [BODY, CELL, BODY._replace(name="alone", along=BODY.along[:, :1])]
    several += [Suspect(f"at_{k}", np.array([k, k + 1]), rng.standard_normal((2, 1)), 0.01) for k in (1, 2, 3)]
    several = [one._replace(odds=10.0) for one in several]
    stated = linear.solved()
    together = Bank(several, SIGMA).weigh(stated)
    _, *every = together.every
    every, pairs = every[: len(several)], every[len(several) :]
    for one, suspect in zip(every, several, strict=True):
        by_itself = Bank([suspect], SIGMA).weigh(stated)
        _, alone = by_itself.every
        assert one.suspect is suspect
        assert one.nats == pytest.approx(alone.nats, rel=1e-10)
        assert one.size == pytest.approx(alone.size, rel=1e-10)
        (shift, root), (shift_alone, root_alone) = together.effect(one), by_itself.effect(alone)
        np.testing.assert_allclose(shift, shift_alone, rtol=1e-9, atol=1e-13)
        np.testing.assert_allclose(root @ root.T, root_alone @ root_alone.T, rtol=1e-9, atol=1e-13)
        np.testing.assert_allclose(shift, linear.solved(suspect)[0] - stated[0], rtol=1e-6, atol=1e-9)
        part = slice(1, 3)
        np.testing.assert_allclose(together.across(one, part), together.known(one)[1][part], rtol=1e-12, atol=1e-15)
    assert pairs
    for one in pairs:
        first, second = (several[k] for k in one.numbers)
        assert one.suspect is not None
        assert one.suspect.name in names(first, second)
        assert one.nats == pytest.approx(linear.nats(first, second) - linear.nats(), abs=1e-6)
        for found, wanted in zip(together.known(one), linear.solved(first, second), strict=True):
            np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-9)


def test_a_freed_filter_has_all_errors_in_its_prior_and_is_taken_back(linear: Linear) -> None:
    bank = Bank([BODY, CELL], SIGMA)
    freed = bank.freed(linear.solved(), (0, 1))
    for found, wanted in zip(freed, linear.solved(BODY, CELL), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-10)
    for found, wanted in zip(bank.as_stated(freed, (0, 1)), linear.solved(), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-9)


def test_what_no_data_tell_apart_shares_its_evidence(linear: Linear) -> None:
    alike = [one._replace(alike=True, odds=odds) for one, odds in ((BODY, 0.01), (CELL, 0.03))]
    _, body, cell, *_ = Bank(alike, SIGMA).weigh(linear.solved()).every
    assert cell.weight == pytest.approx(3.0 * body.weight)


def test_two_are_wrong_only_where_the_data_show_the_second(linear: Linear) -> None:
    """The second, of odds so small that both are less than half as likely as the first alone, is left out."""
    gain = linear.nats(BODY, CELL) - max(linear.nats(BODY), linear.nats(CELL))
    first = max((BODY, CELL), key=lambda one: linear.nats(one) + np.log(one.odds))
    second = CELL if first is BODY else BODY
    assert gain == pytest.approx(linear.nats(BODY, CELL) - linear.nats(first))
    for factor, found in ((0.9, 3), (1.1, 4)):
        other = second._replace(odds=0.5 * factor * float(np.exp(-gain)))
        assert len(Bank([first, other], SIGMA).weigh(linear.solved()).every) == found


def weighed(*weights: float, size: float = 1.0) -> Weighed:
    """As stated, then suspects a, b, ... whose means lie 1, 2, ... apart."""
    names = [None, *(Suspect(name, np.zeros(1, np.intp), np.eye(1), 0.01) for name in ascii_lowercase)]
    each, small = zip(names[: len(weights)], weights, strict=True), 1e-9 * np.eye(1)  # of what is added to a covariance
    every = (
        Hypothesis(one, (), w, 0.0, size, Root(small, np.eye(1), np.array([1e9 * k])))
        for k, (one, w) in enumerate(each)
    )
    return Weighed((np.zeros(1), np.eye(1)), tuple(every))


def test_an_answer_is_the_mixture_over_what_counts() -> None:
    every = weighed(0.5, 0.4995, 0.0005)
    mean, covariance = every.mixed(every.known).known  # the last one does not count
    assert mean == pytest.approx(0.5, abs=1e-3)
    assert covariance == pytest.approx(1.25, abs=1e-3)


TWO = np.array([[0.0], [10.0]]), np.ones((2, 1, 1))  # Gaussians of one sigma ten sigmas apart
OUTER = tails(LEAST_WEIGHT)
TAILS = *tails(1.0 - INTERVAL), *OUTER


def test_ends_leave_out_as_much_of_the_mixture_on_each_side_as_they_say() -> None:
    mixture = Mixture(
        np.array([0.7, 0.2, 0.1]), np.array([[0.0], [1.0], [-6.0]]), np.array([[[1.0]], [[4.0]], [[0.3]]])
    )
    mean, sigma = 3.0 * (mixture.means[:, 0] - mixture.known[0]), 3.0 * np.sqrt(mixture.covariances[:, 0, 0])
    for share, (at,) in zip(TAILS, mixture.ends(3.0 * np.eye(1), TAILS), strict=True):
        assert mixture.weights @ norm.cdf(at, mean, sigma) == pytest.approx(share, rel=0.05 if share < 0.5 else 1e-4)
    np.testing.assert_allclose(
        Mixture(np.ones(1), *(x[:1] for x in TWO)).ends(2.0 * np.eye(1), TAILS), 2.0 * norm.ppf(TAILS)[:, None]
    )


def test_an_unlikely_error_that_is_large_is_in_a_99_9_percent_interval_and_not_in_that_of_95() -> None:
    """The second of two has a weight of 0.01: about the mean, 0.1."""
    mixture = Mixture(np.array([0.99, 0.01]), *TWO)
    low, high, lowest, highest = mixture.ends(np.eye(1), TAILS)[:, 0]
    np.testing.assert_allclose([low, high], -0.1 + norm.ppf([0.025 / 0.99, 0.975 / 0.99]), atol=0.03)
    np.testing.assert_allclose([lowest, highest], [-0.1 - 3.29, 9.9 + norm.ppf(0.95)], atol=0.03)
    np.testing.assert_allclose(np.ravel(mixture.half_widths(np.eye(1))), [max(-low, high), highest])
    assert 3.2905 * mixture.known[1][0, 0] ** 0.5 == pytest.approx(4.64, abs=0.01)


def test_what_lies_beyond_an_interval_is_due_to_the_unlikely_one() -> None:
    means, covariances = np.array([[0.0], [10.0], [0.0]]), np.ones((3, 1, 1))
    mixture, along = Mixture(np.array([0.6, 0.01, 0.39]), means, covariances), np.eye(1)
    alone = Mixture(np.array([0.6, 0.4]), means[[0, 2]], covariances[:2])
    shares = mixture.shares(along, mixture.ends(along, OUTER))[:, 0]
    np.testing.assert_allclose(shares, [0.3, 0.5, 0.2], atol=0.02)  # below the interval it has none
    np.testing.assert_allclose(alone.shares(along, alone.ends(along, OUTER))[:, 0], [0.6, 0.4])


def test_of_two_that_are_as_likely_both_are_covered() -> None:
    mixture = Mixture(np.array([0.5, 0.5]), np.array([[-5.0], [5.0]]), np.ones((2, 1, 1)))
    np.testing.assert_allclose(np.ravel(mixture.half_widths(np.eye(1))), 5.0 + norm.ppf([0.95, 0.999]), atol=0.01)


def test_what_may_be_wrong_is_named_once_all_as_stated_is_no_longer_believed() -> None:
    assert weighed(0.6, 0.4).names == ()
    assert weighed(0.2, 0.3, 0.5).names == ("b", "a")
    assert not weighed(0.6, 0.4).contradicts
    assert weighed(0.4, 0.6).contradicts
    assert not weighed(0.4, 0.6, size=3.5).contradicts  # of another kind


def test_what_is_left_out_of_an_answer_weighs_no_more_than_it_may_all_together() -> None:
    """Twenty hypotheses of 0.06 % each are 1.2 %; each by itself is not likely enough to be named."""
    many = weighed(0.988, *[0.0006] * 20)
    assert sum(one.weight for one in many.every) - sum(one.weight for one in many.counting) <= policy.LEAST_WEIGHT
    assert len(many.counting) == 20
    assert len(many.likely) == 1


LIMITS = {
    "LEAST_WEIGHT": lambda: len(weighed(0.9985, 0.0015).counting),
    "LIKELIER": lambda: weighed(0.6, 0.4).names,
    "FARTHEST_SIZE": lambda: weighed(0.1, 0.9, size=4.0).contradicts,
}


def test_evidence_of_some_is_that_of_the_readings_and_what_a_linear_model_does_not_have_is_added(
    linear: Linear,
) -> None:
    bank, stated = Bank([BODY, CELL], SIGMA), linear.solved()
    for which, wrong in (((0,), (BODY,)), ((1,), (CELL,)), ((0, 1), (BODY, CELL))):
        assert bank.nats(stated, which) == pytest.approx(linear.nats(*wrong) - linear.nats(), abs=1e-6)
    plain, more = (bank.weigh(stated, (), beyond).every for beyond in (0.0, np.array([0.0, 3.0])))
    ratio = [np.log(one[k].weight / one[0].weight) for one in (plain, more) for k in (1, 2)]
    assert ratio[2:] == pytest.approx([ratio[0], ratio[1] + 3.0])


@pytest.mark.parametrize("name", LIMITS)
def test_a_limit_that_is_doubled_is_noticed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = LIMITS[name]()
    monkeypatch.setattr(bank_module, name, 2.0 * getattr(policy, name))
    assert LIMITS[name]() != before


def test_two_steps_whose_information_rounding_made_negative_are_weighed_all_the_same(rng):
    """Two that do the same to what is read, of which large numbers were subtracted: their covariance is one still."""
    suspects = [Suspect(f"step {k}", np.arange(1), np.ones((1, 1)), 0.1) for k in range(2)]
    J = np.array([[1e4, 1.001e4], [1.001e4, 1e4]])
    changed = Changed(rng.normal(size=(3, 2)), np.array([150.0, -150.0]), J, np.zeros((3, 2)))
    assert np.linalg.eigvalsh(np.eye(2) + J)[0] < 0.0
    mean, root = changed.sizes((0, 1))
    assert np.linalg.eigvalsh(root @ root.T)[0] > 0.0
    np.testing.assert_allclose(mean, [150.0, -150.0])  # their difference is known by what is stated alone
    assert any(one.steps == (0, 1) for one in changed.hypotheses(suspects))


def test_sizes_of_steps_are_those_of_their_normal_equations(rng):
    A, d = rng.normal(size=(4, 9)), rng.normal(size=4)
    J = A @ A.T
    mean, root = Changed(np.zeros((3, 4)), d, J, np.zeros((3, 4))).sizes((0, 2, 3))
    at = np.ix_([0, 2, 3], [0, 2, 3])
    np.testing.assert_allclose(root @ root.T, np.linalg.inv(np.eye(3) + J[at]))
    np.testing.assert_allclose(mean, np.linalg.solve(np.eye(3) + J[at], d[[0, 2, 3]]))
