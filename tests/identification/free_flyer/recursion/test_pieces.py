"""A window in pieces: its normal equations are those of the whole, and its evidence that of the linear model."""

from types import SimpleNamespace

import numpy as np
import pytest

from onboard.identification.evidence.bank import Bank
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE
from onboard.identification.free_flyer.prediction.joint_noise import LineNoise, NoiseAdded
from onboard.identification.free_flyer.recursion import pieces
from onboard.identification.free_flyer.recursion import window as windows
from onboard.identification.free_flyer.recursion.pieces import Pieces, evidence_of
from onboard.identification.free_flyer.recursion.solved import HeldPayload
from onboard.identification.free_flyer.recursion.window import WindowSolve
from onboard.identification.free_flyer.steps import NO_STEPS, Steps, StepsTaken
from onboard.identification.free_flyer.suspects import Rivals, suspects_of
from tests.dynamics.free_flyer_twin import twin
from tests.identification.free_flyer.recorded_flights import PRIOR, WIDE, online, recorded, solved, ticks_of


@pytest.fixture(scope="module")
def held():
    return recorded(twin(1.5).flight, np.random.default_rng(3))


def test_normal_equations_in_pieces_are_those_of_the_whole(held, monkeypatch):
    predictor = online(held, imu_prior=PRIOR).predictor
    ticks, p = ticks_of(held).part(slice(0, 122)), len(predictor.names)
    state = np.full(p, 1e-3)
    state[PAYLOAD] = [4.0, 0.1, 0.0, 0.4, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1]
    active = np.flatnonzero(np.arange(p) % 7 != 2)  # not the rate's z, and others
    use = np.ones((120, 6), np.bool_)
    found = []
    for size in (120, 17):
        monkeypatch.setattr(pieces, "PIECE", size)
        whole = Pieces(state, active, *use.shape)
        while not whole.over:
            whole.advance(predictor, ticks, LineNoise.alone(ticks.sigma[1:-1]).whitening(use), use)
        found.append(whole)
    one, several = found
    scale = np.sqrt(np.diag(one.normal.information))
    differences_of_midpoints_at_the_ends = 1e-4
    apart = (several.normal.information - one.normal.information) / np.outer(scale, scale)
    assert np.abs(apart).max() < differences_of_midpoints_at_the_ends
    assert np.abs(several.transition - one.transition).max() < differences_of_midpoints_at_the_ends
    assert several.normal.squares == pytest.approx(one.normal.squares, rel=1e-4)
    assert several.state == pytest.approx(one.state, rel=1e-4, abs=1e-6)


def test_a_piece_predicts_no_more_ticks_than_it_tells(held, monkeypatch):
    """Nor many at once, also when what noise of the joints has added is computed at the end."""
    predictor, ticks = online(held, imu_prior=PRIOR).predictor, ticks_of(held).part(slice(0, 142))
    ticks = ticks._replace(sample_sigma=np.broadcast_to([[0.02], [0.5]], ticks.sample_sigma.shape))
    start = solved(predictor, ticks, HeldPayload.NEW)[0].found.start
    predict, counted = predictor.predict, list[int]()
    monkeypatch.setattr(predictor, "predict", lambda q, *more: counted.append(len(q) - 2) or predict(q, *more))
    prior = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma) ** 2)
    solve = WindowSolve(predictor, WIDE, ticks, prior, (HeldPayload.NEW,), start)
    while not solve.over:
        counted.clear()
        assert solve.advance() == sum(counted) <= 2 * pieces.PIECE
    assert solve.found.noise_added.information.any()


def test_normal_equations_are_by_the_covariance_of_the_lines_of_each_tick(held, rng, monkeypatch):
    """Of those in use, which an error of a joint makes alike."""
    monkeypatch.setattr(pieces, "PIECE", 40)
    predictor, ticks = online(held, imu_prior=PRIOR).predictor, ticks_of(held).part(slice(0, 42))
    state, use = np.full(len(predictor.names), 1e-3), rng.random((40, 6)) < 0.8
    noise = LineNoise.of(ticks.sigma, ticks.sigma[:, None] * rng.standard_normal((42, 10, 6)))
    whole = Pieces(state, np.arange(len(state)), *use.shape)
    whole.advance(predictor, ticks, noise.part(slice(1, -1)).whitening(use), use)
    assert whole.over
    predicted = predictor.predict(ticks.q, ticks.dq, ticks.ddq, state, ticks.cyclic, ticks.thrust)
    information, gradient, squares, logs = np.zeros((len(state), len(state))), np.zeros(len(state)), 0.0, 0.0
    for k, used in enumerate(use):
        own, by_joint = ticks.sigma[k + 1, used], noise.by_joint[k + 1][:, used]
        C = np.diag(own**2) + by_joint.T @ by_joint
        J, off = predicted.jacobian[k, used], (predicted.values[k] - ticks.measured[k + 1])[used]
        information += J.T @ np.linalg.solve(C, J)
        gradient += J.T @ np.linalg.solve(C, off)
        squares += off @ np.linalg.solve(C, off)
        logs += 0.5 * np.linalg.slogdet(C)[1]
    scale = np.sqrt(np.diag(information) + 1e-300)
    np.testing.assert_allclose(whole.normal.information / np.outer(scale, scale), information / np.outer(scale, scale))
    np.testing.assert_allclose(whole.normal.gradient / scale, gradient / scale, atol=1e-9 * np.sqrt(squares))
    assert whole.normal.squares == pytest.approx(squares)
    assert whole.log_sigma == pytest.approx(logs)
    assert not whole.residual[~use].any()


def test_where_the_first_rate_no_longer_shows_the_cost_is_infinite(held):
    """A rate of 1,100 rad/s, say of a gyro in deg/s: the derivative of the later rate may round to a singular one."""
    predictor, ticks = online(held, imu_prior=PRIOR).predictor, ticks_of(held).part(slice(0, 122))
    state, use = np.full(len(predictor.names), 1e-3), np.ones((120, 6), np.bool_)
    costs = []
    for diverged in (False, True):
        whole = Pieces(state, np.arange(len(state)), *use.shape, Steps(predictor).inside(120).about(state))
        while not whole.over:
            whole.advance(predictor, ticks, LineNoise.alone(ticks.sigma[1:-1]).whitening(use), use)
            if diverged:
                whole.transition[RATE, RATE] = 1.0
        costs.append(whole.normal.squares)
    assert np.isfinite(costs[0])
    assert costs[1] == np.inf


@pytest.mark.parametrize("first", [59, 60, 61, 80, 100])
def test_pieces_with_a_step_between_them_are_the_ticks_before_and_after_it(held, first):
    predictor = online(held, imu_prior=PRIOR).predictor
    ticks, p, use = ticks_of(held).part(slice(0, 122)), len(predictor.names), np.ones((120, 6), np.bool_)
    state, active, at = np.full(p, 1e-3), np.arange(p), np.array([predictor.names.index("gyro_scale_z")])
    state[PAYLOAD] = [4.0, 0.1, 0.0, 0.4, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1]
    taken = StepsTaken(at, np.array([[0.1]]), np.array([first]))

    def predicted(size):
        whole = Pieces(state, active, *use.shape, NO_STEPS, taken, np.array([size]))
        while not whole.over:
            whole.advance(predictor, ticks, LineNoise.alone(ticks.sigma[1:-1]).whitening(use), use)
        return whole

    none, some, more = (predicted(size) for size in (0.0, 1.0, 1.001))
    changed = some.residual - none.residual
    np.testing.assert_allclose(changed[:first], 0.0, atol=1e-9)
    np.testing.assert_allclose(changed[first:, [0, 1, 3, 4, 5]], 0.0, atol=1e-9)
    assert np.abs(changed[first:, 2]).min() > 1e-3
    assert some.state[at] - none.state[at] == pytest.approx(0.1)
    np.testing.assert_allclose(some.transition[:, p], np.eye(p)[:, at[0]] * 0.1, atol=1e-12)
    slope = (more.normal.squares - some.normal.squares) / 0.002
    assert some.normal.gradient[p] == pytest.approx(slope, rel=2e-3)


def test_the_evidence_of_two_solutions_is_that_of_the_linear_model_where_that_is_exact(held):
    """A known payload, and a gyro whose scales are 2 % off where 0.3 are stated."""
    predictor, ticks = online(held, imu_prior=PRIOR).predictor, ticks_of(held).part(slice(0, 122))
    ticks.measured[:, :3] *= 1.02
    rivals, sigma = Rivals(predictor), np.nan_to_num(predictor.sigma)
    mean = np.zeros(len(sigma))
    mean[PAYLOAD] = solved(predictor, ticks_of(held).part(slice(0, 600)), HeldPayload.NEW)[0].found.state[PAYLOAD]
    sigma[PAYLOAD] = [1e-3, *[1e-4] * 3, *[1e-5] * 6]
    stated = mean, np.diag(sigma**2)
    gyro = [predictor.names.index(f"gyro_scale_{axis}") for axis in "xyz"]
    (scales,) = (k for k, one in enumerate(suspects_of(predictor)) if one.at.tolist() == gyro and one.along.size == 3)

    def ended(prior):
        solve = WindowSolve(predictor, WIDE, ticks, prior, (HeldPayload.SAME,), None)
        while not solve.over:
            solve.advance()
        return solve.found

    as_stated, free = ended(stated), ended(rivals.with_free(stated, (scales,)))
    known = as_stated.state - mean, as_stated.covariance  # of deviations from the prior's mean, which is not zero
    nats = Bank(suspects_of(predictor), predictor.sigma).nats(known, (scales,))
    assert nats > 3.0
    assert free.evidence - as_stated.evidence == pytest.approx(nats, rel=0.01)  # but for the noise, which is scaled


def test_evidence_does_not_depend_on_how_large_noise_was_expected(rng):
    squares, used, informations = rng.random((50, 3)), np.array([50, 50, 40]), (np.eye(5), 4.0 * np.eye(5))

    def evidence(squares, sigma):
        whole = SimpleNamespace(squares=squares / sigma**2, log_sigma=140 * np.log(sigma))
        return evidence_of(whole, used, np.full(10, sigma), 2.0, informations)

    found = [evidence(squares, sigma) for sigma in (0.1, 0.3)]
    assert found[0] - found[1] == pytest.approx(10 * np.log(3.0))  # of the ten readings that were left out
    more = evidence(2.0 * squares, 0.1)
    assert found[0] - more == pytest.approx(70 * np.log(2.0))


def test_what_noise_adds_from_tick_to_tick_is_no_step_inside_a_window(held, monkeypatch):
    """A payload seemed to become lighter: a flight with encoders of 12 bits and a wrist sensor was refused."""
    predictor, ticks = online(held, imu_prior=PRIOR).predictor, ticks_of(held).part(slice(0, 102))
    p, inside = len(predictor.names), Steps(predictor).inside(100)
    gradients = np.random.default_rng(3).standard_normal((100, p))
    found = []
    for of_all in (np.zeros(p), np.full(p, 1e-15)):
        added = NoiseAdded(of_all, np.zeros((p, p)))
        of_ticks = SimpleNamespace(added=added, by_tick=gradients, over=True)
        monkeypatch.setattr(windows, "NoiseInPieces", lambda *_, of_ticks=of_ticks, **__: of_ticks)
        prior = np.zeros(p), np.diag(np.nan_to_num(predictor.sigma) ** 2)
        solve = WindowSolve(predictor, WIDE, ticks, prior, (HeldPayload.NEW,), None, steps=inside)
        while not solve.over:
            solve.advance()
        assert solve.found is not None
        found.append(solve.found)
    about = inside.about(found[0].start)
    np.testing.assert_allclose(found[1].steps.d - found[0].steps.d, about.along_with(gradients), rtol=1e-3, atol=1e-3)
