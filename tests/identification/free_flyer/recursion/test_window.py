"""Windows of ticks: a prediction in pieces is the whole one, and what cannot be explained is given up early."""

import numpy as np
import pytest

from bench.true_flights import free_flyer
from bench.true_flights.free_flyer_sensors import ImuErrors
from onboard.estimation.maximum_likelihood import Descent
from onboard.identification.evidence.bank import Changed
from onboard.identification.evidence.bodies import CHANGES
from onboard.identification.free_flyer.prediction.further import CellPrior, FurtherCell
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE
from onboard.identification.free_flyer.prediction.joint_noise import NoiseAdded
from onboard.identification.free_flyer.recursion import window as windows
from onboard.identification.free_flyer.recursion.pieces import Problem
from onboard.identification.free_flyer.recursion.solved import HeldPayload, Solved
from onboard.identification.free_flyer.recursion.window import WindowSolve
from onboard.identification.free_flyer.steps import Steps
from tests.dynamics.free_flyer_twin import twin
from tests.identification.free_flyer.recorded_flights import PRIOR, WIDE, online, recorded, solved, ticks_of


@pytest.fixture(scope="module")
def held():
    return recorded(twin(1.5).flight, np.random.default_rng(3))


def test_a_hypothesis_that_comes_nowhere_near_is_given_up_after_a_few_iterations(held):
    window = ticks_of(held).part(slice(0, 100))
    uncertain = online(held, imu_prior=PRIOR, links=[*(f"link_{k}" for k in range(1, 6)), "base"]).predictor
    nothing, predicted = solved(uncertain, window, HeldPayload.NOTHING)
    assert nothing.found is None
    assert predicted < 60 * 98  # of 40 iterations with a refused step in each


@pytest.mark.parametrize("at", [[50], [10, 80, 90]])
def test_outliers_do_not_make_a_window_hopeless(held, at):
    window = ticks_of(held).part(slice(0, 100))
    window.measured[at] += 1000.0 * window.sigma[0]
    solve, _ = solved(online(held).predictor, window, HeldPayload.NEW)
    assert solve.found is not None
    assert solve.found.glitches == len(at)
    assert solve.found.state[PAYLOAD][0] == pytest.approx(5.0, abs=4.0 * np.sqrt(solve.found.covariance[3, 3]))


def test_an_iteration_that_stops_short_of_a_minimum_but_explains_the_window_is_a_result(held, monkeypatch):
    """Where a motion tells little, the minimum lies in a flat valley; stopping short of it is no misfit."""
    predictor, window = online(held, imu_prior=PRIOR).predictor, ticks_of(held).part(slice(0, 100))
    best = solved(predictor, window, HeldPayload.NEW)[0].found

    def cut(at_most):
        def descent(start, mean, prior, iterations, tolerance, damping, beyond):
            return Descent(start, mean, prior, min(iterations, at_most), 1e-12, damping, beyond)

        return descent

    for at_most, start in ((3, None), (0, best.start)):
        monkeypatch.setattr(windows, "Descent", cut(at_most))
        short = solved(predictor, window, HeldPayload.NEW, start)[0].found
        assert short is not None
        off = short.state[PAYLOAD] - best.state[PAYLOAD]
        assert (np.abs(off) < 2.0 * np.sqrt(np.diag(short.covariance)[PAYLOAD])).all()
    far = best.start.copy()
    far[PAYLOAD] = 3.0 * far[PAYLOAD] + 1.0
    assert solved(predictor, window, HeldPayload.NEW, far)[0].found is None


def test_what_the_ticks_do_not_tell_goes_back_to_its_prior_mean():
    """A joint's place and the place of what hangs on it, by which the same ticks are explained."""
    stated = np.diag([1.0, 1e-4, 4.0])
    told = 1e6 * np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    problem = Problem(np.array([0.0, 0.0, 7.0, 0.5]), np.diag([1.0, 1e-4, 0.0, 4.0]), np.array([0, 1, 3]))
    near = problem.as_stated(np.array([-1.3, 2.3, 0.9]), told)
    assert near[0] == pytest.approx(0.0, abs=1e-3)
    assert near[0] + near[1] == pytest.approx(1.0, abs=1e-3)
    assert near[2] == pytest.approx(0.9, abs=1e-6)  # told
    before, after = (x @ stated @ x for x in (np.array([-1.3, 2.3, 0.4]), near - [0.0, 0.0, 0.5]))
    assert after < before - 1.6
    assert problem.as_stated(near, told) is None
    assert problem.as_stated(near - np.array([-0.5, 0.5, 0.0]), told) is None  # hardly likelier there
    assert problem.as_stated(near, told + 1e6 * np.eye(3)) is None  # the ticks tell all


@pytest.mark.parametrize("mass_kg", [-0.2, 0.01, 0.2, 0.5, 5.0])
def test_which_ticks_are_kept_does_not_depend_on_the_mass_that_they_tell(mass_kg):
    """Kept where the mass came out large, a light payload became heavier."""
    state, covariance, none = np.zeros(13), np.eye(13), np.zeros((0, 6))
    state[PAYLOAD.start] = mass_kg
    for sigma_kg, kept in ((0.13, True), (0.9, True), (1.5, mass_kg > 3.0), (30.0, False)):
        covariance[PAYLOAD.start, PAYLOAD.start] = sigma_kg**2
        rest = 2000.0, none, covariance, Changed.none(13), NoiseAdded.none(13), (state, covariance), 0.0
        found = Solved(HeldPayload.NEW, np.ones(13), state, covariance, 398, 0, 0.0, *rest)
        for length, grown in ((1.0, 1.5), (8.0, 6.0)):
            assert found.growth(length, 50.0) == ((True, grown) if kept else (False, 1.0))


def test_a_start_that_later_ticks_contradict_is_replaced_by_guesses(held):
    predictor, window = online(held, imu_prior=PRIOR).predictor, ticks_of(held).part(slice(0, 300))
    best = solved(predictor, window, HeldPayload.NEW)[0].found
    far = best.start.copy()
    far[PAYLOAD] = -3.0 * far[PAYLOAD]
    again = solved(predictor, window, HeldPayload.NEW, far)[0].found
    assert again is not None
    assert again.cost == pytest.approx(best.cost, abs=1.0)


def test_steps_inside_are_what_readings_with_them_move_the_solution_and_its_cost_by(held, rng):
    cell = FurtherCell("cell", "link_5", (0.6, 0.5, 0.2, 0.3, -0.7, 0.9), 5, CellPrior(0.1, 0.0, 0.0025, 0.0))
    predictor = online(held, imu_prior=PRIOR, further=(cell,)).predictor
    ticks, p = ticks_of(held).part(slice(0, 122)), len(predictor.names)
    sigma = np.nan_to_num(predictor.sigma)
    sigma[RATE], sigma[PAYLOAD] = 1.0, [0.1, *[0.01] * 3, *[0.01] * 6]
    start = np.zeros(p)
    start[PAYLOAD] = [5.0, 0.1, 0.0, 0.4, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1]
    true = predictor.predict(ticks.q, ticks.dq, ticks.ddq, start)
    lines = predictor.lines[-1].stop
    noise = np.column_stack([ticks.sigma, np.full(len(ticks.sigma), 0.02)])
    measured = np.zeros((122, lines))
    measured[1:-1] = true.values + noise[1:-1] * rng.standard_normal(true.values.shape)
    carried = Steps(predictor).inside(120, carried=True)
    assert (carried.times, carried.taken([0]).first.item(), carried.taken([10]).first.item()) == (6, 0, 20)
    inside = Steps(predictor).inside(120)
    kinds = inside.along.shape[1]
    of_instruments = 5  # scales of gyro, accelerometer and both; the cell's two
    assert (inside.every, inside.times, kinds) == (20, 5, of_instruments + CHANGES)
    first, size = np.repeat(inside.every * np.arange(1, 6), kinds), inside.about(start).changed(p)

    def ended(readings):
        window = ticks._replace(measured=readings, sigma=noise)
        known = start, np.diag(sigma**2)
        solve = WindowSolve(predictor, WIDE, window, known, (HeldPayload.SAME,), start, 0, inside)
        while not solve.over:
            solve.advance()
        return solve.found

    def with_another_payload(tick, by):
        before, after = ticks.part(slice(0, tick + 2)), ticks.part(slice(tick, None))
        until = predictor.predict(before.q, before.dq, before.ddq, start)
        then = predictor.predict(after.q, after.dq, after.ddq, until.state + by)
        return np.vstack([until.values, then.values]), then.state

    plain, costs = ended(measured), dict[tuple[int, ...], float]()
    instruments = ((0,), (1,), (2,), (3,), (4,), (42,), (43,), (44,), (11,), (1, 11), (3, 43), (4, 44))
    for which in (*instruments, (5,), (18,), (46,), (5, 46)):
        by = 0.1 / np.sqrt(1.0 + plain.steps.J.diagonal()[[*which]])
        after, of_step = measured.copy(), np.zeros(p)
        for k, one in zip(which, by, strict=True):
            if (kind := k % kinds) >= of_instruments:
                values, state = with_another_payload(first[k], one * size[:, k])
                after[1:-1] += values - true.values
                of_step += state - true.state
                continue
            of_step += one * size[:, k]
            lines = [slice(0, 3), slice(3, 6), slice(0, 6), slice(-1, None), slice(-1, None)][kind]
            step = np.where(np.arange(120) < first[k], 0.0, one * np.abs(size[:, k]).max())[:, None]
            after[1:-1, lines] += step * (true.values[:, lines] if kind < 4 else 1.0)  # a scale, a zero
        found = ended(after)
        costs[which] = found.cost - plain.cost
        moved = (found.state - plain.state) / np.sqrt(np.diag(plain.covariance))
        wanted = (of_step - plain.steps.D[:, which] @ by) / np.sqrt(np.diag(plain.covariance))
        assert np.abs(wanted).max() > 0.02
        np.testing.assert_allclose(moved, wanted, atol=0.004)
        together = 2.0 * float(np.prod(by)) * plain.steps.J[which[0], which[-1]]  # of two: beyond what each costs
        if len(which) == 1:
            more = 2.0 * float(by[0] * plain.steps.d[which[0]]) + float(by[0] ** 2 * plain.steps.J[which[0], which[0]])
            assert costs[which] == pytest.approx(more, abs=0.003)
        else:
            assert abs(together) > 0.003
            assert costs[which] - costs[which[:1]] - costs[which[1:]] == pytest.approx(together, abs=0.001)


def test_a_step_that_is_taken_is_an_unknown_whose_size_the_window_tells(held):
    """A tenth off from the middle on; where it is not taken no payload explains the window."""
    predictor, ticks = online(held, imu_prior=PRIOR).predictor, ticks_of(held).part(slice(0, 122))
    ticks.measured[61:] *= 0.9
    prior = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma) ** 2)
    inside = Steps(predictor).inside(120)
    both = inside.taken([2 * inside.along.shape[1] + 2])  # scales of gyro and accelerometer, at the third time
    assert both.first.tolist() == [60]
    none, found = (
        WindowSolve(predictor, WIDE, ticks, prior, (HeldPayload.NEW,), None, 0, inside, one)
        for one in (inside.taken([]), both)
    )
    for solve in (none, found):
        while not solve.over:
            solve.advance()
    assert none.found is None
    assert found.found is not None
    sigma = np.sqrt(np.diag(found.found.covariance))
    assert found.found.state[PAYLOAD.start] == pytest.approx(5.0, abs=3.0 * sigma[PAYLOAD.start])
    assert sigma[PAYLOAD.start] < 0.3
    scales = [k for k, name in enumerate(predictor.names) if "_scale_" in name]
    assert len(scales) == 6
    np.testing.assert_allclose(found.found.state[scales], -0.1, atol=0.02)
    np.testing.assert_allclose(found.found.start[scales], 0.0, atol=0.01)


def light(mass_kg, seed):
    """Two seconds of a payload that is so light."""
    rng = np.random.default_rng(seed)
    body = free_flyer.Body.box(mass_kg, (0.06, 0.05, 0.05), (0.01, -0.02, 0.06))
    motion, rate = free_flyer.JointMotion.draw(rng), rng.uniform(-0.05, 0.05, 3)
    return recorded(free_flyer.fly(free_flyer.world(body), motion, rate, 2.0), rng, ImuErrors())


def tried_after_nothing(flight, louder):
    """Of a window whose noise is stated so many times too large: what explains it, and whether nothing held does."""
    predictor, ticks = online(flight, imu_prior=PRIOR).predictor, ticks_of(flight)
    prior = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma) ** 2)
    ticks, solves = ticks._replace(sigma=louder * ticks.sigma), []
    for hypotheses in ((HeldPayload.NOTHING,), (HeldPayload.NOTHING, HeldPayload.NEW)):
        solves.append(WindowSolve(predictor, WIDE, ticks, prior, hypotheses, None))
        while not solves[-1].over:
            solves[-1].advance()
    return solves[1].found, solves[0].found is not None


def test_a_light_payload_counts_though_nothing_held_leaves_no_more_than_noise_over():
    """To the squares of a thousand readings of noise it adds little, but no ten numbers take as much off noise."""
    found, explained = tried_after_nothing(light(0.03, 3), 5.0)
    assert explained
    assert found.hypothesis is HeldPayload.NEW
    assert found.state[PAYLOAD.start] == pytest.approx(0.03, abs=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_where_nothing_is_held_no_payload_is_found(seed):
    found, explained = tried_after_nothing(light(1e-4, seed), 1.0)
    assert explained
    assert found.hypothesis is HeldPayload.NOTHING


def test_noise_before_a_window_is_still_in_what_is_known_of_the_others_after_it(held):
    """Of a payload of which nothing is known, nothing that it had added before a capture."""
    predictor = online(held, imu_prior=PRIOR).predictor
    ticks, p = ticks_of(held).part(slice(0, 102)), len(predictor.names)
    prior = np.zeros(p), np.diag(np.nan_to_num(predictor.sigma) ** 2)
    ones = NoiseAdded(np.ones(p), np.ones((p, p)))
    added = {}
    for hypothesis in (HeldPayload.NEW, HeldPayload.SAME):
        for before in (None, ones):
            known = (prior[0], np.eye(p)) if hypothesis is HeldPayload.SAME else prior
            solve = WindowSolve(predictor, WIDE, ticks, known, (hypothesis,), None, noise=before)
            while not solve.over:
                solve.advance()
            assert solve.found is not None
            added[hypothesis, before is ones] = solve.found.noise_added
    others = np.delete(np.ones(p), np.arange(p)[PAYLOAD], 0)
    for hypothesis, of_payload in ((HeldPayload.NEW, 0.0), (HeldPayload.SAME, 1.0)):
        more = added[hypothesis, True].gradient - added[hypothesis, False].gradient
        np.testing.assert_allclose(np.delete(more, np.arange(p)[PAYLOAD]), others)
        np.testing.assert_allclose(more[PAYLOAD], of_payload)
        both = added[hypothesis, True].information
        assert (both[PAYLOAD.start, -1], both[-1, -1]) == (of_payload, 1.0)


@pytest.mark.parametrize(("more", "expected"), [(-1e6, HeldPayload.SAME), (0.0, HeldPayload.NOTHING)])
def test_whether_a_known_payload_was_held_before_is_decided_by_which_is_likelier(monkeypatch, more, expected):
    """A light one explains the motion of an empty arm, too: a payload that was caught later was taken as held."""
    rng = np.random.default_rng(5)
    motion = free_flyer.JointMotion.draw(rng)
    empty = recorded(free_flyer.fly(free_flyer.world(None), motion, rng.uniform(-0.01, 0.01, 3), 4.2), rng)
    predictor = online(empty, imu_prior=PRIOR).predictor
    p = len(predictor.names)
    mean, known = np.zeros(p), np.diag(np.nan_to_num(predictor.sigma) ** 2)
    mean[PAYLOAD] = 0.2, 0.0, 0.0, 0.02, 4e-3, 0.0, 4e-3, 0.0, 0.0, 1e-3
    mean *= 0.02
    known[PAYLOAD, PAYLOAD] = np.diag((0.05 * mean[PAYLOAD]) ** 2 + 1e-10)
    solution = WindowSolve._solution

    def made(self, *of):
        one = solution(self, *of)
        return one._replace(evidence=one.evidence + more * (one.hypothesis is HeldPayload.NOTHING))

    monkeypatch.setattr(WindowSolve, "_solution", made)
    hypotheses = (HeldPayload.SAME, HeldPayload.NOTHING)
    for some in (*((one,) for one in hypotheses), hypotheses):
        solve = WindowSolve(predictor, WIDE, ticks_of(empty), (mean, known), some, None)
        while not solve.over:
            solve.advance()
        assert solve.found is not None  # each explains it
    assert solve.found.hypothesis is expected
