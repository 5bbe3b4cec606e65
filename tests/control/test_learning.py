"""Learning laws on linear joints: what a trial leaves of the error, by closed form and by the plant's own response."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import cont2discrete

from onboard.control.laws import Gains
from onboard.control.learning import Learning, LearningLaw, contraction

PERIOD_S = 0.004


def scalar(*values):
    return [np.array([value]) for value in values]


@pytest.mark.parametrize("kind", [LearningLaw.PD, LearningLaw.PI])
def test_the_boundary_of_stability_is_the_closed_form(rng, kind):
    frequency = np.geomspace(1e-5, 1e5, 2000)
    seen = set()
    for _ in range(200):
        M, kp, kv, phi, second = np.exp(rng.uniform(-2.0, 2.0, 5))
        if kind is LearningLaw.PD:
            ratios = second / (2.0 * M), 2.0 * kp * second / (phi * (2.0 * kv - phi))
            law = Learning(*scalar(phi, second, 0.0), low_pass_hz=1e9)
        else:
            ratios = second / (2.0 * kp), 2.0 * M * second / (phi * (2.0 * kv - phi))
            law = Learning(*scalar(phi, 0.0, second), low_pass_hz=1e9)
        stable = phi < 2.0 * kv and max(ratios) < 1.0
        if phi < 2.0 * kv and abs(max(ratios) - 1.0) < 0.02:
            continue  # too near to be separated on a grid
        left = contraction(law, Gains(*scalar(kp, kv)), np.array([[M]]), np.zeros(1), frequency)
        assert bool(left.max() <= 1.0 + 1e-9) == stable
        seen.add(bool(stable))
    assert seen == {True, False}


def respond(torques, M, damping, stiffness):
    """Positions of a joint with feedback at the samples; torque i is in force from sample i + 1 on, for one period."""
    A, B, *_ = cont2discrete(
        (np.array([[0, 1], [-stiffness / M, -damping / M]]), np.array([[0], [1 / M]]), np.eye(2), np.zeros((2, 1))),
        PERIOD_S,
    )
    state, positions = np.zeros(2), []
    for before in [0.0, *torques[:-1]]:
        positions.append(state[0])
        state = A @ state + B[:, 0] * before
    return np.array(positions)


@pytest.mark.parametrize("kind", LearningLaw)
@pytest.mark.parametrize("hertz", [0.5, 1.5])
@pytest.mark.parametrize("heavier", [pytest.param(1.0, marks=pytest.mark.campaign), 4.0])  # as the law has it
def test_a_trial_leaves_what_theory_says(kind, hertz, heavier):
    inertia, viscous = np.array([0.3]), np.array([0.4])
    gains, M = Gains.of(np.diag(inertia)), heavier * inertia[0]
    law = Learning.of(kind, gains, inertia)
    time_s = PERIOD_S * np.arange(5000)
    wanted = np.sin(2.0 * np.pi * hertz * time_s) * np.sin(np.pi * time_s / time_s[-1]) ** 2
    torques = first = 0.5 * gains.position[0] * wanted[:, None]
    errors = []
    for _ in range(3):
        q = respond(torques[:, 0], M, gains.rate[0] + viscous[0], gains.position[0])
        # the loop's own feedback acts on the error: the reference enters as its torque
        held = respond(
            (gains.position[0] * wanted + gains.rate[0] * np.gradient(wanted, PERIOD_S)),
            M,
            gains.rate[0] + viscous[0],
            gains.position[0],
        )
        errors.append(wanted - q - held)
        torques = law.next(torques, first, errors[-1][:, None], PERIOD_S)
    [left] = contraction(law, gains, np.array([[M]]), viscous, np.array([hertz]))
    if kind is LearningLaw.FORGETTING:  # e_(k+1) = (1 - alpha - L G) e_k + alpha e_0: differences shrink by it
        steps = [np.linalg.norm(a - b) for a, b in pairwise(errors)]
        measured = steps[1] / steps[0]
        remembering = law._replace(forgetting=0.0)  # what was first is not forgotten in the first step
        [once] = contraction(remembering, gains, np.array([[M]]), viscous, np.array([hertz]))
        assert np.linalg.norm(errors[1]) / np.linalg.norm(errors[0]) == pytest.approx(once, abs=0.02)
    else:
        measured = np.linalg.norm(errors[2]) / np.linalg.norm(errors[1])
    assert measured == pytest.approx(left, abs=0.02)
    assert left < 1.0


def test_independent_joints_learn_as_one_each():
    inertia = np.array([0.2, 0.5])
    gains, frequency = Gains.of(np.diag(inertia)), np.array([0.3, 1.0, 3.0])
    law = Learning.of(LearningLaw.PI, gains, inertia)
    both = contraction(law, gains, np.diag([0.8, 0.5]), np.array([0.1, 0.0]), frequency)
    each = []
    for place, M, viscous in ((0, 0.8, 0.1), (1, 0.5, 0.0)):
        one = slice(place, place + 1)
        alone = Learning(law.rate[one], law.derivative[one], law.integral[one])
        own = Gains(gains.position[one], gains.rate[one])
        each.append(contraction(alone, own, np.array([[M]]), np.array([viscous]), frequency))
    assert both == pytest.approx(np.max(each, axis=0), rel=1e-12)


def test_what_is_above_the_low_pass_is_not_learned():
    law = Learning.of(LearningLaw.PD, Gains.of(np.eye(1)), np.ones(1))
    time_s = PERIOD_S * np.arange(2000)
    none = np.zeros((len(time_s), 1))
    slow, fast = (
        np.abs(law.next(none, none, np.sin(2.0 * np.pi * f * time_s)[:, None] / f**2, PERIOD_S)[500:1500]).max()
        for f in (1.0, 40.0)
    )
    assert fast < 1e-2 * slow
