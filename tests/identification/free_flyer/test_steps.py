"""Steps in flight, against the density of all readings and the fit of all of them with the step as an unknown."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from onboard.estimation.policy import LEAST_WEIGHT, ODDS_OF_PART
from onboard.identification.evidence.bank import Bank, Changed, Suspect
from onboard.identification.evidence.mixture import Known
from onboard.identification.free_flyer import steps as steps_module
from onboard.identification.free_flyer.innovation import Innovation
from onboard.identification.free_flyer.prediction.further import CellPrior, FurtherCell
from onboard.identification.free_flyer.prediction.joint_noise import NoiseAdded
from onboard.identification.free_flyer.steps import ALTERED, Steps
from onboard.identification.free_flyer.suspects import Believed

CELL = FurtherCell("cell", "", (), 1, CellPrior(0.1, 0.0, 0.0025, 0.0))
NAMES = ("rate", "a", "b", "bias_cell", "scale_cell")
SIGMA = np.array([3.0, 1.0, 0.5, 0.1, 0.0025])
SCALE = Suspect("cell", np.array([4]), np.array([[0.1]]), 1e-2)
OF_IMUS: dict[str, Any] = {"instruments": ("cell",), "imu_frames": (), "of_each": ()}  # none
WITH_A_CELL = {"names": NAMES, "sigma": SIGMA, "further": (CELL,), "changing": np.array([0]), **OF_IMUS}
NO_PAYLOAD = slice(0, 0)
BATCHES, LINES, EXACT = 6, 4, NoiseAdded.none(5)
BODY = Suspect("body", np.array([1, 2]), np.array([[2.0], [1.0]]), 1e-2)


Steps_ = Sequence[tuple[int, int]]  # batch from which on, and place in the state


class Flight(NamedTuple):
    """Batches ``y = H x + e``; the rate goes on by a transition, all else stays."""

    H: np.ndarray  # (batches, lines, p)
    F: np.ndarray  # (batches, 1, p)
    y: np.ndarray  # (batches, lines)

    def model(self, steps: Steps_, wrong: Suspect | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Readings by the first state and r steps, (n, p + r); the last state by these, (p, p + r); their prior."""
        T, rows = np.eye(5, 5 + len(steps)), []
        for k in range(BATCHES + 1):
            for column, (at, which) in enumerate(steps, 5):
                T[which, column] += k == at
            if k < BATCHES:
                rows.append(self.H[k] @ T)
                T[0] = (self.F[k] @ T)[0]
        prior = np.diag(np.append(SIGMA, [0.1 if which == 4 else 1.0 for _, which in steps]) ** 2)
        if wrong is not None:
            prior[np.ix_(wrong.at, wrong.at)] += wrong.along @ wrong.along.T
        return np.concatenate(rows), T, prior

    def solved(self, *steps: tuple[int, int], wrong: Suspect | None = None) -> Known:
        """The last state, the steps being unknowns."""
        A, T, prior = self.model(steps, wrong)
        P = np.linalg.inv(np.linalg.inv(prior) + A.T @ A)
        return T @ P @ A.T @ self.y.ravel(), T @ P @ T.T

    def nats(self, *steps: tuple[int, int], wrong: Suspect | None = None) -> float:
        """Evidence of the steps over that of none."""
        A, _, prior = self.model(steps, wrong)
        none = prior.copy()
        none[5:, 5:] = 0.0
        of, no = (multivariate_normal(np.zeros(len(A)), A @ C @ A.T + np.eye(len(A))) for C in (prior, none))
        return float(of.logpdf(self.y.ravel()) - no.logpdf(self.y.ravel()))


@pytest.fixture
def flight(rng: np.random.Generator) -> Flight:
    H, F = rng.standard_normal((BATCHES, LINES, 5)), 0.3 * rng.standard_normal((BATCHES, 1, 5))
    H[:, :, 4] *= 30.0
    F[:, :, 0] = 1.0
    return Flight(H, F, rng.standard_normal((BATCHES, LINES)))


def filtered(flight: Flight, steps: Steps, noise: NoiseAdded = EXACT, shift: np.ndarray | float = 0.0) -> Known:
    """The last state by a filter, with steps beside it; noise that is in each batch, by which its state is off."""
    x, P = np.zeros(5), np.diag(SIGMA**2)
    for H, F, y in zip(*flight, strict=True):
        L = np.linalg.cholesky(H @ P @ H.T + np.eye(LINES))
        W, e, seen = np.split(np.linalg.solve(L, np.column_stack([H @ P, y - H @ x, H @ steps.changed.D])), [5, 6], 1)
        corrected = e[:, 0] - np.linalg.solve(L, H @ np.broadcast_to(shift, 5))
        x, P = x + W.T @ e[:, 0], P - W.T @ W
        T = np.vstack([F, np.eye(5)[1:]])
        x, P = T @ x, T @ P @ T.T
        steps.step((W, corrected, seen), F, x, noise)
    return x, P


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> Steps:
    monkeypatch.setattr(steps_module, "_EVERY", 1)
    predictor: Any = SimpleNamespace(**WITH_A_CELL, period_s=0.01)
    return Steps(predictor, NO_PAYLOAD)


def likely(steps: Steps) -> list[Suspect]:
    """All of them, so likely that none is left out."""
    return [one._replace(odds=1.0) for one in steps.suspects]


def test_steps_without_odds_or_evidence_are_left_out_and_hardly_change_a_weight(flight: Flight, steps: Steps) -> None:
    known, bank = filtered(flight, steps), Bank([BODY], SIGMA)
    rare = [one._replace(odds=1e-5 if k % 2 else 1.0) for k, one in enumerate(steps.suspects)]
    found = steps.changed.hypotheses(rare)
    assert [one.steps for one in found if len(one.steps) == 1] == [(k,) for k in range(0, 2 * (BATCHES + 1), 2)]
    each = [one for one in steps.changed.hypotheses(rare, every=True) if len(one.steps) == 1]
    assert len(each) == 2 * (BATCHES + 1)
    with_all, without = (bank.weigh(known, some) for some in (each, [one for one in found if len(one.steps) == 1]))
    assert without.every[0].weight == pytest.approx(with_all.every[0].weight, rel=LEAST_WEIGHT)


def test_each_is_the_fit_with_the_step_as_an_unknown_and_has_the_evidence_of_its_readings(
    flight: Flight, steps: Steps
) -> None:
    known = filtered(flight, steps)
    weighed = Bank([BODY], SIGMA).weigh(known, steps.changed.hypotheses(likely(steps)))
    found = [one for one in weighed.every if len(one.steps) == 1]
    assert len(found) == 2 * (BATCHES + 1)
    for k, one in enumerate(found):
        at, which = k // 2, (4, 3)[k % 2]
        assert one.suspect is not None
        assert (one.suspect.name, one.suspect.at.item()) == ("a step of cell", which)
        assert one.nats == pytest.approx(flight.nats((at, which)), abs=1e-8)
        for part, wanted in zip(weighed.known(one), flight.solved((at, which)), strict=True):
            np.testing.assert_allclose(part, wanted, rtol=1e-8, atol=1e-10)


def test_a_change_of_the_payload_is_the_fit_with_all_it_changes_as_unknowns(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here of two parameters, a and b, by one each where there is a payload; beside a cell's steps."""
    monkeypatch.setattr(steps_module, "_EVERY", 1)
    monkeypatch.setattr(steps_module, "CHANGES", 2)
    monkeypatch.setattr(steps_module, "changes", lambda chi: np.eye(2) * bool(chi.any()))
    predictor: Any = SimpleNamespace(**WITH_A_CELL, period_s=0.01)
    steps = Steps(predictor, slice(1, 3))
    known = filtered(flight, steps)
    steps.changed.D.setflags(write=False)
    found = [one for one in steps.changed.hypotheses(likely(steps)) if one.suspect.name == ALTERED]
    assert [one.steps for one in found][:2] == [(2, 3), (6, 7)]
    assert found[0].nats == 0.0  # before the first batch there was none to change
    for at, one in enumerate(found):
        assert steps.of_payload((0, *one.steps)) == one.steps
        assert steps.batches_since(one.steps[0]) == BATCHES - at + 1
        if at:
            assert one.nats == pytest.approx(flight.nats((at, 1), (at, 2)), abs=1e-8)
            weighed = Bank([BODY], SIGMA).weigh(known, [one])
            for part, wanted in zip(weighed.known(weighed.every[-1]), flight.solved((at, 1), (at, 2)), strict=True):
                np.testing.assert_allclose(part, wanted, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(("back", "likeliest"), [(0.0, (2,)), (-1.0, (2, 8))])
def test_a_step_that_goes_back_is_two_and_one_that_stays_is_one(
    flight: Flight, steps: Steps, back: float, likeliest: tuple[int, ...]
) -> None:
    """Of 15 % from the second batch on, and back with the fifth; without evidence a step is less likely by 8 nats."""
    odds = np.exp(-8.0)
    for at, by in ((1, 0.15), (4, 0.15 * back)):
        flight.y[at:] += by * flight.H[at:, :, 4]
    known = filtered(flight, steps)
    found = steps.changed.hypotheses([one._replace(odds=odds) for one in steps.suspects])
    weighed = Bank([BODY], SIGMA).weigh(known, found)
    assert weighed.likeliest.steps == likeliest
    assert weighed.names[0] == "a step of cell"
    pairs = [one for one in found if len(one.steps) == 2]
    assert (likeliest in [one.steps for one in pairs]) is (len(likeliest) == 2)
    for one in pairs:
        both = [(k // 2, (4, 3)[k % 2]) for k in one.steps]
        assert one.nats == pytest.approx(flight.nats(*both), rel=1e-6)
        for part, wanted in zip(weighed.known(one), flight.solved(*both), strict=True):
            np.testing.assert_allclose(part, wanted, rtol=1e-6, atol=1e-8)
        assert one.nats - 8.0 + np.log(2.0) > max(flight.nats(alone) for alone in both)
        assert one.suspect is not None
        assert one.suspect.odds == pytest.approx(odds**2)


def test_what_is_judged_given_a_step_is_the_innovation_of_one_who_knows_of_it(rng: np.random.Generator) -> None:
    """Each block given those before it, as without a step: its squares are of the conditional density.

    Noise of the joints has moved the state, and the covariance without it is larger.
    """
    lines, size, root = 8, np.array([0.3, -0.2]), np.array([[0.2, 0.0], [-0.1, 0.3]])
    L, seen = np.tril(rng.standard_normal((lines, lines))), rng.standard_normal((lines, 3))
    e, corrected, doubt = rng.standard_normal(lines), rng.standard_normal(lines), rng.standard_normal((lines, 2))
    plain = Innovation(np.zeros((lines, 5)), e, L, seen, e, np.zeros((lines, 0)), 1)
    assert plain.judged(None) is plain
    noisy, both = plain._replace(corrected_e=corrected, doubt=doubt), seen[:, 1:]
    of_step, of_noise = both @ root @ root.T @ both.T, doubt @ doubt.T
    step = Believed((1, 2), size, root)
    for innovation, given, own, more in (
        (plain, step, e - both @ size, of_step),
        (noisy, None, corrected, of_noise),
        (noisy, step, corrected - both @ size, of_step + of_noise),
    ):
        judged = innovation.judged(given)
        spread, off = L @ (np.eye(lines) + more) @ L.T, L @ own
        np.testing.assert_allclose(judged.L @ judged.e, off, atol=1e-12)
        for first in range(1, lines + 1):
            squares = off[:first] @ np.linalg.solve(spread[:first, :first], off[:first])
            assert judged.e[:first] @ judged.e[:first] == pytest.approx(squares)


@pytest.mark.parametrize("free", [BODY, SCALE], ids=["body", "the scale that steps"])
def test_with_a_thing_free_it_is_the_fit_with_that_prior_and_is_taken_back(
    flight: Flight, steps: Steps, free: Suspect
) -> None:
    known, bank = filtered(flight, steps), Bank([free], SIGMA)
    before = steps.changed
    wide = bank.freed(known, (0,)), bank.steps_freed(known, (0,), before)
    weighed = bank.weigh(wide[0], wide[1].hypotheses(likely(steps)))
    found = [one for one in weighed.every if len(one.steps) == 1]
    assert len(found) == 2 * (BATCHES + 1)
    for k, one in enumerate(found):
        at, which = k // 2, (4, 3)[k % 2]
        assert one.nats == pytest.approx(flight.nats((at, which), wrong=free), abs=1e-8)
        for part, wanted in zip(weighed.known(one), flight.solved((at, which), wrong=free), strict=True):
            np.testing.assert_allclose(part, wanted, rtol=1e-8, atol=1e-10)
    for part, wanted in zip(bank.steps_as_stated(wide[0], (0,), wide[1]), before, strict=True):
        np.testing.assert_allclose(part, wanted, rtol=1e-7, atol=1e-9)


def test_of_more_times_than_are_kept_the_newest_and_the_likeliest_stay(
    flight: Flight, steps: Steps, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(steps_module, "_TIMES", 3)
    all_kept = [[flight.nats((k, which)) for k in range(BATCHES + 1)] for which in (4, 3)]
    filtered(flight, steps)
    assert len(steps.suspects) == 6
    alone = steps.changed.evidence(steps.suspects)[0].diagonal()
    scales, zeros = alone[::2], alone[1::2]
    for nats, every in ((scales, all_kept[0]), (zeros, all_kept[1])):
        assert all(np.isclose(one, every, atol=1e-8).any() for one in nats)
        assert nats[-1] == pytest.approx(every[-1], abs=1e-8)
    steps.forget()
    np.testing.assert_array_equal(steps.changed.D, np.eye(5)[:, [4, 3]] * [0.1, 1.0])
    assert not steps.changed.J.any()


def test_one_may_begin_every_fifth_of_a_second_and_of_a_minute_eight_are_kept_as_likely_as_a_wrong_part() -> None:
    predictor: Any = SimpleNamespace(**WITH_A_CELL, period_s=0.01)
    steps, counts = Steps(predictor, NO_PAYLOAD), list[int]()
    for _ in range(600):  # batches of ten ticks
        m = steps.changed.D.shape[1]
        told = np.zeros((1, 5)), np.zeros(1), np.zeros((1, m))
        steps.step(told, np.eye(5)[:1], np.zeros(5), EXACT)
        counts.append(len(steps.suspects))
    scales_and_zeros = 2
    assert counts[0] == scales_and_zeros
    assert counts[1] == counts[2] == 2 * scales_and_zeros
    assert max(counts) == 8 * scales_and_zeros  # right-hand sides of a batch: 2 % of what an estimate costs
    in_a_minute = sum(one.odds for one in steps.suspects[::2])  # each has the odds of those that are left to it
    assert abs(np.log(in_a_minute / ODDS_OF_PART)) < np.log(1.5)
    steps.begin(
        Changed(np.zeros((5, 80)), np.zeros(80), np.zeros((80, 80)), np.zeros((5, 80))), np.zeros(5)
    )  # of a window of eight seconds
    assert len(steps.suspects) == 8 * scales_and_zeros
    assert sum(one.odds for one in steps.suspects) == pytest.approx(82 * steps.suspects[-1].odds)


def test_what_noise_does_to_the_state_and_to_each_batch_is_no_step(flight: Flight, steps: Steps, monkeypatch) -> None:
    """A flight whose state is off by noise, and whose batches draw it on, has the evidence of one without noise."""
    rng = np.random.default_rng(4)
    shift, rate = 1e-3 * rng.standard_normal((2, 5))
    filtered(flight, steps)
    plain, now = steps.changed, steps.step
    drawn = np.zeros(len(plain.d))

    def noted(told, transition, state, noise):
        n = steps.changed.d.size
        drawn[:n] += steps.changed.D.T @ rate - told[2].T @ off.pop(0)
        now(told, transition, state, noise)

    steps.forget()
    off = []
    P = np.diag(SIGMA**2)
    for H, F, _ in zip(*flight, strict=True):
        L = np.linalg.cholesky(H @ P @ H.T + np.eye(LINES))
        off.append(np.linalg.solve(L, H @ shift))
        W, T = np.linalg.solve(L, H @ P), np.vstack([F, np.eye(5)[1:]])
        P = T @ (P - W.T @ W) @ T.T
    monkeypatch.setattr(steps, "step", noted)
    filtered(flight, steps, NoiseAdded(rate, np.zeros((5, 5))), shift)
    np.testing.assert_allclose(steps.changed.d, plain.d + drawn, atol=1e-12)
    np.testing.assert_array_equal(steps.changed.J, plain.J)
    assert np.abs(drawn).max() > 1e-6


def test_what_the_readings_tell_of_a_step_is_without_the_information_of_noise(flight: Flight, steps: Steps) -> None:
    """Of each the slopes ``K = J - N``, the information ``K V^-1 K`` with ``V = K + c N``, c of products of noise."""
    filtered(flight, steps)
    assert steps.told(steps.changed) is steps.changed  # exact joints
    steps.forget()
    of_noise, D = np.diag([0.0, 0.3, 0.2, 1.0, 600.0]), list[np.ndarray]()
    step = steps.step

    def noted(told, *rest):
        D.append(steps.changed.D)
        step(told, *rest)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(steps, "step", noted)
        filtered(flight, steps, NoiseAdded(np.zeros(5), of_noise, 12.0, 10))
    changed, m = steps.changed, steps.changed.d.size
    told = steps.told(changed)
    N = np.zeros(m)
    for one in D:  # a step that is not there yet has none
        N[: one.shape[1]] += ((of_noise @ one) * one).sum(axis=0)
    J = changed.J.diagonal()
    assert (N[: m - 2] > 0.0).all()
    K = np.maximum(J - N, 0.0)
    share = K / (K + 2.2 * N + LEAST_WEIGHT)
    assert share[: m - 2].min() > 0.01
    assert share[: m - 2].max() < 0.9
    np.testing.assert_allclose(told.d, share * changed.d, rtol=1e-9)
    np.testing.assert_allclose(told.J.diagonal(), share * K, rtol=1e-9, atol=1e-12)
    some = np.ix_(range(m - 2), range(m - 2))  # all but those that begin now
    alike = [part.J[some] / np.sqrt(np.outer(own := part.J.diagonal()[: m - 2], own)) for part in (told, changed)]
    np.testing.assert_allclose(*alike, rtol=1e-9)
    np.testing.assert_array_equal(told.D, changed.D)


def test_gradients_of_ticks_count_for_a_step_from_its_time_on(rng: np.random.Generator) -> None:
    inside = steps_module.Inside(np.array([1, 3]), rng.standard_normal((2, 3)), every=4, times=2)
    gradients = rng.standard_normal((12, 5))
    along = inside.along_with(gradients)
    expected = [gradients[first:, [1, 3]].sum(axis=0) @ inside.along for first in (4, 8)]
    np.testing.assert_allclose(along, np.concatenate(expected))
