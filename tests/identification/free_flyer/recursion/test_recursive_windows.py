"""The windows the recursion starts from: solved in bounded pieces, and what comes in while one is solved."""

import pickle

import numpy as np
import pytest

from bench.true_flights import free_flyer
from bench.true_flights.free_flyer_sensors import ImuErrors
from onboard.flight.estimate.state import UnwrittenParts, from_bytes
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, ImuPredictor
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS
from onboard.identification.free_flyer.recursion.bounded_work import WORK
from tests.dynamics.free_flyer_twin import BOX
from tests.flight.estimate.state_bytes import to_bytes
from tests.identification.free_flyer.recorded_flights import PRIOR, online, recorded, same_bits, ticks_of


@pytest.fixture
def predicted(monkeypatch):
    """Ticks of each prediction that is made."""
    made, predict = [], ImuPredictor.predict

    def counted(self, q, *rest):
        made.append(len(q))
        return predict(self, q, *rest)

    monkeypatch.setattr(ImuPredictor, "predict", counted)
    return made


def test_nothing_is_said_before_the_first_window_and_of_axes_that_are_swapped(held):
    ticks = ticks_of(held)
    recursive = online(held)
    recursive.update(ticks.part(slice(0, 99)))
    assert recursive.estimate() is None
    recursive.update(ticks.part(slice(99, 100)))
    assert recursive.estimate() is None  # one tick pays for one prediction of the window
    recursive.finish()
    assert recursive.estimate() is not None
    wrong = online(held)
    wrong.update(ticks._replace(measured=ticks.measured[:, [1, 0, 2, 3, 4, 5]]))
    assert wrong.estimate() is None


@pytest.mark.parametrize("swapped", [False, True])
def test_a_call_does_a_bounded_piece_of_a_window_and_can_be_checkpointed_in_between(held, swapped, predicted):
    ticks = ticks_of(held).part(slice(0, 210))
    if swapped:  # no hypothesis explains it, so every guess is tried to its end
        ticks = ticks._replace(measured=ticks.measured[:, [1, 0, 2, 3, 4, 5]])
    whole, pieces = online(held), online(held)
    whole.update(ticks)
    places, most, solving = UnwrittenParts(pieces), 0, 0
    for first in range(0, 210, 10):
        predicted.clear()
        pieces.update(ticks.part(slice(first, first + 10)))
        most, solving = max(most, sum(predicted)), solving + pieces.solving
        if pieces.solving:
            pieces = from_bytes(to_bytes(pieces, places), places)
    assert solving >= (8 if swapped else 1)
    assert most <= 10 * WORK + 200  # a piece, and what begins the next guess
    whole.finish()
    pieces.finish()
    assert not pieces.solving
    assert pieces.unexplained.count == whole.unexplained.count
    assert (pieces.state is None) == swapped
    assert swapped or same_bits(whole, pieces)


def test_what_ticks_give_without_a_window_is_there_before_the_window_is_solved(held, predicted):
    ticks, whole, late = ticks_of(held), online(held), online(held)
    for first in range(0, 900, 10):
        some = ticks.part(slice(first, first + 10))
        whole.update(some)
        late.work()  # of the ticks before
        predicted.clear()
        late.take(some)
        assert max(predicted, default=0) <= BATCH_TICKS + 2  # steps of the filter only
        if first == 90:
            assert late.solving
    assert late.state is not None
    assert late.ticks_used > 400
    whole.finish()
    late.finish()
    assert same_bits(whole, late)


def test_a_window_of_nonsense_is_not_explained(held):
    ticks = ticks_of(held).part(slice(0, 110))
    recursive = online(held)
    recursive.update(ticks._replace(dq=1e160 * ticks.dq))
    recursive.finish()
    assert recursive.state is None
    assert not recursive.solving


def test_a_flight_that_ends_leaves_to_be_solved_what_takes_too_long_and_says_so(held, monkeypatch):
    ticks, recursive = ticks_of(held), online(held)
    for first in range(0, 90, BATCH_TICKS):
        recursive.update(ticks.part(slice(first, first + BATCH_TICKS)))
    recursive.take(ticks.part(slice(90, 100)))
    assert recursive.solving
    copies = [MotionIdentifier(pickle.loads(pickle.dumps(recursive))) for _ in range(2)]
    copies[0].finish()
    assert not copies[0].findings().against
    monkeypatch.setattr("onboard.identification.free_flyer.online.last_work", lambda joints: 0)  # more than is due
    copies[1].finish()
    assert copies[1].ekf.solving
    assert "take too long" in copies[1].findings().against[0]
    copies[1].ekf.state, copies[1].ekf.held = copies[0].ekf.state, True  # of an earlier window
    assert any("take too long" in one for one in copies[1].findings().doubts)


def test_a_release_that_is_announced_while_a_window_is_solved_comes_after_it(held):
    ticks = ticks_of(held)
    recursive = online(held)
    recursive.update(ticks.part(slice(0, 99)))
    recursive.update(ticks.part(slice(99, 100)))
    recursive.announce(False, 1.0)
    assert recursive.changes == []
    recursive.finish()
    assert [change.kind for change in recursive.changes] == ["ejection"]
    assert recursive.held is None


def test_a_payload_whose_release_is_announced_is_no_answer_while_the_release_waits_for_a_window(held):
    ticks, recursive = ticks_of(held), online(held)
    recursive.update(ticks.part(slice(0, 250)))
    recursive.finish()
    assert recursive.estimate() is not None
    recursive.take(ticks.part(slice(250, 402)))  # the last window is due
    assert recursive.solving
    assert recursive.holds
    recursive.announce(False, float(ticks.time_s[402]))
    assert recursive.solving
    assert recursive.changes == []
    assert not recursive.holds
    assert recursive.estimate() is None


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.campaign) for seed in (2, 5))]
)  # other bodies
def test_the_first_second_is_enough_for_a_start_whatever_is_held(seed):
    rng = np.random.default_rng(seed)
    body = BOX.grown(rng.uniform(8.0, 18.0))
    motion = free_flyer.JointMotion.draw(rng)
    flight = free_flyer.fly(free_flyer.world(body), motion, rng.uniform(-0.05, 0.05, 3), 1.3)
    signals = recorded(flight, rng, ImuErrors(0.01, 1e-4, 0.1, 1e-3, 0.003, 0.0035, 1e-4))
    recursive = online(signals, imu_prior=PRIOR, links=[*(f"link_{k}" for k in range(1, 6)), "base"])
    recursive.update(ticks_of(signals))
    recursive.finish()
    found = recursive.estimate()
    assert found is not None
    assert abs(found.body.mass_kg - body.mass_kg) < 4.0 * np.sqrt(found.covariance[0, 0])


def test_what_a_window_told_of_a_base_far_from_its_drawing_is_solved_again_once_it_is_freed():
    """A fifth lighter: taken over linearly, what was known as stated ends in a change of a payload that stays."""
    rng, drawn = np.random.default_rng(1), free_flyer.BASE
    base = free_flyer.Body(0.8 * drawn.mass_kg, drawn.centre_of_mass_m, 0.8 * drawn.inertia_kg_m2)
    motion = free_flyer.JointMotion.draw(rng)
    flight = free_flyer.fly(free_flyer.world(BOX, base), motion, rng.uniform(-0.05, 0.05, 3), 9.0)
    signals = recorded(flight, rng, ImuErrors(0.01, 1e-4, 0.1, 1e-3, 0.003, 0.0035, 1e-4))
    recursive, ticks = online(signals, imu_prior=PRIOR, links=["base"]), ticks_of(signals)
    for first in range(0, len(ticks.time_s), 10):
        recursive.update(ticks.part(slice(first, first + 10)))
    recursive.finish()
    assert recursive.changes == []
    weighed = recursive.rivals.weighed(recursive.state, recursive.covariance)
    assert weighed.names == ("base",)
    mean, covariance = weighed.known(weighed.likeliest, PAYLOAD)
    assert abs(mean[0] - BOX.mass_kg) < 3.0 * np.sqrt(covariance[0, 0]) < 1.0


@pytest.mark.parametrize(
    ("seed", "tick"), [(3, 300), *(pytest.param(*one, marks=pytest.mark.campaign) for one in ((3, 60), (4, 300)))]
)  # sooner, another motion
def test_an_imu_whose_scales_step_while_the_payload_is_not_known_is_named_and_the_payload_inside(flown, seed, tick):
    """A tenth, while readings are so noisy that the window is explained as stated: by 2.5 to 3 kg of 5."""
    rng = np.random.default_rng(seed)
    signals = recorded(flown.flight, rng)
    ticks = ticks_of(signals)
    ticks = ticks._replace(sigma=60.0 * ticks.sigma)
    ticks.measured[tick:] *= 0.9
    ticks.measured[:] += ticks.sigma * rng.standard_normal(ticks.sigma.shape)
    recursive = online(signals, imu_prior=PRIOR)
    recursive.update(ticks)
    recursive.finish()
    weighed = recursive.rivals.weighed(recursive.state, recursive.covariance)
    assert weighed.names
    assert {"imu", "a step of imu"}.issuperset(weighed.names)
    mass, variance = (part.item(0) for part in weighed.mixed(lambda one: weighed.known(one, PAYLOAD)).known)
    assert mass == pytest.approx(5.0, abs=3.0 * variance**0.5)
