"""The payload tick by tick, with MuJoCo's truth: as good as the whole flight at once, and it notices what happens."""

import pickle

import numpy as np
import pytest

from hil_sim.plants import free_flyer
from hil_sim.sensing.free_flyer_sensors import ImuErrors, sample
from onboard.dynamics.errors import UnknownFrameError
from onboard.dynamics.free_flight import predict_base
from onboard.dynamics.kinematics import link_motions
from onboard.dynamics.payload import standard_covariance
from onboard.dynamics.ticks import tick_signals
from onboard.dynamics.vehicle import BaseKind, VehicleModel, VehicleSpec
from onboard.flight.estimate.state import Places, from_bytes, to_bytes
from onboard.identification.exiddm.bounded_work import BATCH_TICKS, WORK
from onboard.identification.exiddm.free_base import free_exiddm
from onboard.identification.exiddm.imu_errors import CERTAIN, ImuPrior
from onboard.identification.exiddm.imu_prediction import PAYLOAD, RATE, ImuPredictor
from onboard.identification.exiddm.online import ExiddmIdentifier
from onboard.identification.exiddm.parameters import EXACT_GEOMETRY, GeometryPrior, JointPrior
from onboard.identification.exiddm.recursive import RecursiveExiddm
from onboard.identification.exiddm.ticks import Ticks
from onboard.identification.quantities import Findings
from tests.dynamics.free_flyer_twin import BOX, URDF, twin

WIDE = np.array([50.0, *[20.0] * 3, *[10.0] * 6])
BIASED = ImuErrors(gyro_bias_rad_s=0.01, accelerometer_bias_m_s2=0.1)
BIASES = CERTAIN._replace(gyro_bias_rad_s=0.01, accelerometer_bias_m_s2=0.1)
PRIOR = ImuPrior(0.01, 1e-4, 0.003, 0.0035, 0.1, 1e-3, 0.003, 0.0035, 1e-4)
CAPTURE_s, RELEASE_s, END_s = 3.0, 7.5, 10.0


def ticks_of(signals):
    n = len(signals.q)
    sigma = np.tile(np.r_[signals.rate_sigma, signals.specific_force_sigma], (n, 1))
    measured = np.c_[signals.rate, signals.specific_force]
    joints = (x.copy() for x in (signals.q, signals.dq, signals.ddq))
    exact = np.zeros((n, 2, 5)), np.zeros((n, 3, 0))
    return Ticks(0.054 + signals.period_s * np.arange(n), *joints, measured, sigma, *exact)


def recorded(flight, rng, errors=BIASED):
    samples = sample(flight, errors, rng)
    return tick_signals(*samples[:4], samples[4:], 5, 0.1)


def online(signals, held=True, imu_prior=BIASES, links=(), geometry=EXACT_GEOMETRY):
    vehicle = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", "payload"))
    covariance = {
        name: standard_covariance(vehicle.chi[10 * k : 10 * k + 10], 0.01, 1e-3, 0.01)
        for k, name in enumerate(vehicle.links[:-1])
        if name in links
    }
    predictor = ImuPredictor(vehicle, "imu_base", signals.period_s, signals.samples, covariance, imu_prior, geometry)
    return RecursiveExiddm(predictor, WIDE, held)


def same_bits(a, b):
    return a.state.tobytes() == b.state.tobytes() and a.covariance.tobytes() == b.covariance.tobytes()


@pytest.fixture(scope="module")
def flown():
    return twin(8.0)


@pytest.fixture(scope="module")
def held(flown):
    return recorded(flown.flight, np.random.default_rng(3))


@pytest.fixture(scope="module")
def mission():
    """Nothing held, a capture, a release."""
    rng = np.random.default_rng(11)
    flight = free_flyer.FreeFlight(free_flyer.JointMotion.draw(rng), rng.uniform(-0.05, 0.05, 3))
    capture = free_flyer.Capture(BOX, CAPTURE_s, 0.02 * rng.normal(size=3), 0.02 * rng.normal(size=3))
    free_flyer.fly_with_capture(flight, capture, RELEASE_s)
    flight.release()
    flight.advance(round((END_s - RELEASE_s) / flight.step_s))
    return recorded(flight.history, rng)


def test_it_ends_where_the_maximum_likelihood_of_the_whole_flight_does(held):
    recursive = online(held)
    recursive.update(ticks_of(held))
    whole = free_exiddm(recursive.predictor.vehicle, "imu_base", held, WIDE, {}, BIASES).fit()
    found, sigma = recursive.estimate(), np.sqrt(np.diag(whole.chi_covariance))
    a_fifth_of_a_sigma = 0.2
    assert np.abs(recursive.state[PAYLOAD] - whole.chi).max() < a_fifth_of_a_sigma * sigma.max()
    assert (np.abs(recursive.state[PAYLOAD] - whole.chi) < a_fifth_of_a_sigma * sigma).all()
    ratio = np.sqrt(np.diag(recursive.covariance))[PAYLOAD] / sigma
    assert ratio.min() > 0.9
    assert ratio.max() < 1.1
    assert abs(found.body.mass_kg - 5.0) < 4.0 * np.sqrt(found.covariance[0, 0])
    assert recursive.changes == []


def test_with_everything_uncertain_the_covariance_stays_positive_and_covers(flown):
    signals = recorded(flown.flight, np.random.default_rng(5), ImuErrors(0.01, 1e-4, 0.1, 1e-3, 0.003, 0.0035, 1e-4))
    recursive = online(signals, imu_prior=PRIOR, links=[f"link_{k}" for k in range(1, 6)] + ["base"])
    ticks = ticks_of(signals)
    for first in range(0, len(ticks.time_s), 100):
        recursive.update(ticks.part(slice(first, first + 100)))
        if recursive.state is not None:
            sigma = np.sqrt(np.diag(recursive.covariance))
            assert np.linalg.eigvalsh(recursive.covariance / np.outer(sigma, sigma))[0] > 0.0
            assert np.abs(recursive.covariance - recursive.covariance.T).max() < 1e-12 * sigma.max() ** 2
    found = recursive.estimate()
    error = found.body.mass_kg - 5.0
    assert abs(error) < 3.0 * np.sqrt(found.covariance[0, 0]) < 0.3 * 5.0
    assert recursive.changes == []


def test_how_the_ticks_arrive_does_not_matter_to_a_bit(held):
    ticks = ticks_of(held)
    whole = online(held)
    whole.update(ticks)
    whole.finish()
    crumbs = online(held)
    first = 0
    for size in [1, 7, 13, 1, 250] * 10:
        crumbs.update(ticks.part(slice(first, first + size)))
        first += size
    assert first > len(ticks.time_s)
    crumbs.finish()
    assert same_bits(whole, crumbs)


@pytest.mark.parametrize("at", [60, 157, 555])
def test_what_was_pickled_goes_on_to_the_bit(held, at):
    ticks = ticks_of(held).part(slice(0, 600))
    whole, cut = online(held), online(held)
    whole.update(ticks)
    cut.update(ticks.part(slice(0, at)))
    again = pickle.loads(pickle.dumps(cut))
    again.update(ticks.part(slice(at, None)))
    assert same_bits(whole, again)


def test_capture_and_ejection_are_found_and_only_the_payload_forgotten(mission):
    recursive, ticks = online(mission, held=False), ticks_of(mission)
    biases = [recursive.predictor.names.index(f"gyro_bias_rad_s_{axis}") for axis in "xyz"]
    before = int(np.searchsorted(ticks.time_s, CAPTURE_s))
    recursive.update(ticks.part(slice(0, before)))
    assert recursive.held is False
    assert recursive.estimate() is None
    known = np.sqrt(np.diag(recursive.covariance))[biases]
    recursive.update(ticks.part(slice(before, before + 50)))
    assert [change.kind for change in recursive.changes] == ["change"]
    assert CAPTURE_s < recursive.changes[0].time_s < CAPTURE_s + 0.5
    assert recursive.held is None
    assert recursive.estimate() is None  # it does not go on with what it held before
    gone = int(np.searchsorted(ticks.time_s, RELEASE_s))
    recursive.update(ticks.part(slice(before + 50, gone)))
    assert (np.sqrt(np.diag(recursive.covariance))[biases] < known).all()
    found = recursive.estimate()
    assert found.body.mass_kg == pytest.approx(BOX.mass_kg, rel=0.05)
    assert abs(found.body.mass_kg - BOX.mass_kg) < 4.0 * np.sqrt(found.covariance[0, 0])
    recursive.update(ticks.part(slice(gone, None)))
    assert [change.kind for change in recursive.changes] == ["change", "capture", "change", "ejection"]
    assert recursive.changes[1][1:] == recursive.changes[0][1:]
    assert RELEASE_s < recursive.changes[2].time_s < RELEASE_s + 0.5
    assert recursive.held is False
    assert recursive.estimate() is None


def test_a_light_payload_is_not_taken_for_a_push(rng):
    light = BOX.grown(0.2)
    flight = free_flyer.FreeFlight(free_flyer.JointMotion.draw(rng), rng.uniform(-0.05, 0.05, 3))
    capture = free_flyer.Capture(light, 2.0, 0.02 * rng.normal(size=3), 0.02 * rng.normal(size=3))
    signals = recorded(free_flyer.fly_with_capture(flight, capture, 6.0), rng)
    recursive = online(signals, held=False)
    recursive.update(ticks_of(signals))
    assert [change.kind for change in recursive.changes] == ["change", "capture"]
    found = recursive.estimate()
    assert abs(found.body.mass_kg - 0.2) < 4.0 * np.sqrt(found.covariance[0, 0]) < 0.2


def test_a_push_is_a_contact_and_the_payload_is_kept(rng):
    flight = free_flyer.FreeFlight(free_flyer.JointMotion.draw(rng), rng.uniform(-0.05, 0.05, 3), BOX)
    flight.advance(2500)
    flight.data.qvel[3:6] += [0.02, -0.03, 0.01]
    flight.advance(1500)
    signals = recorded(flight.history, rng)
    recursive, ticks = online(signals), ticks_of(signals)
    push = int(np.searchsorted(ticks.time_s, 5.0))
    recursive.update(ticks.part(slice(0, push)))
    sigma = recursive.estimate().covariance[0, 0] ** 0.5
    recursive.update(ticks.part(slice(push, None)))
    assert [change.kind for change in recursive.changes] == ["change", "contact"]
    assert recursive.held is True
    found = recursive.estimate()
    assert found.covariance[0, 0] ** 0.5 < sigma
    assert abs(found.body.mass_kg - 5.0) < 4.0 * sigma


def test_a_payload_that_turns_into_another_contradicts_itself(held, mission):
    joint = np.array([1.0, 1.03, 1.0, 1.0, 1.0])
    ticks = ticks_of(held)
    wrong = np.arange(len(ticks.time_s))[:, None] >= 500
    recursive = online(held)
    recursive.update(
        ticks._replace(
            **{name: np.where(wrong, joint * getattr(ticks, name), getattr(ticks, name)) for name in ("dq", "ddq")}
        )
    )
    kinds = [change.kind for change in recursive.changes]
    assert kinds[0] == "change"
    assert not {"capture", "ejection"} & set(kinds)
    assert recursive.exchanged or recursive.estimate() is None
    wary = online(held)
    wary.update(ticks)
    identifier = ExiddmIdentifier(wary)
    assert identifier.findings() == Findings()
    wary.exchanged = True
    assert "without a release" in identifier.findings().against[0]
    wary.exchanged = False
    wary.misfit.add("gyro", 1e6, 60)
    assert "gyro" in identifier.findings().doubts[0]
    assert identifier.estimate().sigma[0] > 2.0 * wary.covariance[PAYLOAD, PAYLOAD][0, 0] ** 0.5
    fine = online(mission, held=False)
    fine.update(ticks_of(mission))
    assert [change.kind for change in fine.changes] == ["change", "capture", "change", "ejection"]
    assert not fine.exchanged


def test_told_is_as_good_as_found(mission):
    recursive, ticks = online(mission, held=False), ticks_of(mission)
    at = int(np.searchsorted(ticks.time_s, CAPTURE_s + 0.02))
    recursive.update(ticks.part(slice(0, at)))
    recursive.told(True, float(ticks.time_s[at]))
    recursive.told(False, float(ticks.time_s[at]))
    recursive.told(True, float(ticks.time_s[at]))
    recursive.update(ticks.part(slice(at, at + 400)))
    assert [change.kind for change in recursive.changes] == ["capture", "ejection", "capture"]
    assert all(np.isnan(change.score) for change in recursive.changes)
    assert recursive.estimate().body.mass_kg == pytest.approx(BOX.mass_kg, rel=0.05)
    recursive.told(True, 0.0)
    assert len(recursive.changes) == 3


def test_a_release_that_is_told_and_was_none_is_rejected(mission):
    ticks, recursive = ticks_of(mission), online(mission, held=False)
    held = [int(np.searchsorted(ticks.time_s, time_s)) for time_s in (CAPTURE_s + 0.02, 5.5, RELEASE_s - 0.1)]
    recursive.update(ticks.part(slice(0, held[0])))
    recursive.told(True, float(ticks.time_s[held[0]]))
    recursive.update(ticks.part(slice(held[0], held[1])))
    before = recursive.estimate()
    recursive.told(False, float(ticks.time_s[held[1]]))
    recursive.update(ticks.part(slice(held[1], held[2])))
    recursive.finish()
    assert [change.kind for change in recursive.changes] == ["capture", "ejection", "release_contradicted"]
    assert recursive.estimate().body.mass_kg == pytest.approx(before.body.mass_kg, rel=0.02)
    released = online(mission, held=False)
    released.update(ticks.part(slice(0, held[0])))
    released.told(True, float(ticks.time_s[held[0]]))
    end = int(np.searchsorted(ticks.time_s, RELEASE_s + 0.02))
    released.update(ticks.part(slice(held[0], end)))
    released.told(False, float(ticks.time_s[end]))
    released.update(ticks.part(slice(end, len(ticks.time_s))))
    assert [change.kind for change in released.changes] == ["capture", "ejection"]
    assert released.held is False


def test_a_capture_that_is_told_and_was_none_is_rejected_when_the_payload_comes():
    """Told six seconds before anything is held; at the capture it is no exchange of payloads."""
    rng = np.random.default_rng(5)
    flight = free_flyer.FreeFlight(free_flyer.JointMotion.draw(rng), rng.uniform(-0.05, 0.05, 3))
    capture = free_flyer.Capture(BOX, 6.0, 0.02 * rng.normal(size=3), 0.02 * rng.normal(size=3))
    free_flyer.fly_with_capture(flight, capture, 12.0)
    signals = recorded(flight.history, rng)
    ticks, recursive = ticks_of(signals), online(signals, held=False)
    recursive.told(True, float(ticks.time_s[0]))
    recursive.update(ticks)
    assert [change.kind for change in recursive.changes] == ["capture", "capture_contradicted", "change", "capture"]
    assert recursive.changes[1].time_s < 5.0
    assert not recursive.exchanged
    assert recursive.estimate().body.mass_kg == pytest.approx(BOX.mass_kg, rel=0.05)


def test_ticks_without_an_imu_carry_the_momentum_on(held):
    ticks = ticks_of(held)
    ticks.measured[450:520] = np.nan
    recursive = online(held)
    recursive.update(ticks)
    assert recursive.changes == []
    assert recursive.ticks_used == 398 + (len(ticks.time_s) - 400) // BATCH_TICKS * BATCH_TICKS - 70
    found = recursive.estimate()
    assert abs(found.body.mass_kg - 5.0) < 4.0 * np.sqrt(found.covariance[0, 0])


def test_over_a_gap_of_the_joints_the_rate_follows_from_the_momentum(held):
    predictor = online(held).predictor
    ticks = ticks_of(held)
    x = np.zeros(len(predictor.names))
    x[PAYLOAD] = [5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    x[RATE] = [0.05, -0.02, 0.03]
    near = ticks.part(slice(300, 312))
    predicted = predictor.predict(near.q, near.dq, near.ddq, x)
    ends = [part[[0, 10]] for part in (near.q, near.dq, near.ddq)]
    carried, transition, of_a_turn = predictor.bridge(*ends, x)
    by_a_tenth_of_a_second = 0.1 * 0.06 * np.sqrt(np.linalg.eigvalsh(of_a_turn)[-1])  # the momentum turned meanwhile
    assert np.abs(carried[RATE] - predicted.state[RATE]).max() < by_a_tenth_of_a_second
    assert np.abs(carried[RATE] - x[RATE]).max() > 3.0 * by_a_tenth_of_a_second
    for k in (0, 1, 2, 3, 6, 12):
        step = 1e-5 * np.eye(x.size)[k]
        slope = (predictor.bridge(*ends, x + step)[0] - predictor.bridge(*ends, x - step)[0]) / 2e-5
        np.testing.assert_allclose(transition[:, k], slope, atol=1e-6 * max(1.0, np.abs(slope).max()))


def test_when_joints_and_imu_are_missing_nothing_is_said_until_the_momentum_is_found_again(held):
    ticks, recursive = ticks_of(held), online(held)
    ticks.q[504:510] = np.nan
    ticks.measured[490:510] = np.nan
    recursive.update(ticks.part(slice(0, 502)))
    assert recursive.estimate() is not None
    recursive.update(ticks.part(slice(502, 511)))
    assert recursive.estimate() is None
    recursive.update(ticks.part(slice(511, None)))
    assert recursive.changes == []
    assert abs(recursive.estimate().body.mass_kg - 5.0) < 4.0 * np.sqrt(recursive.estimate().covariance[0, 0])


@pytest.mark.parametrize("lost", [3, 150])
def test_missing_joints_widen_the_momentum_and_nothing_else(held, lost):
    ticks = ticks_of(held)
    recursive = online(held)
    recursive.update(ticks.part(slice(0, 502)))
    before = np.diag(recursive.covariance).copy()
    ticks.dq[502 : 502 + lost, 2] = np.nan
    recursive.update(ticks.part(slice(502, 502 + lost + 1)))
    if recursive.state is not None:
        after = np.diag(recursive.covariance)
        assert (after[RATE] > 1.5 * before[RATE]).all()
        np.testing.assert_array_equal(after[PAYLOAD], before[PAYLOAD])
    else:
        assert recursive.estimate() is None
    recursive.update(ticks.part(slice(502 + lost + 1, None)))
    assert recursive.changes == []
    found = recursive.estimate()
    assert abs(found.body.mass_kg - 5.0) < 4.0 * np.sqrt(found.covariance[0, 0])
    assert found.covariance[0, 0] < before[3]


def test_a_glitch_is_left_out_and_no_alarm(held):
    ticks, clean = ticks_of(held), online(held)
    clean.update(ticks)
    ticks.measured[50, 1] += 0.05  # in the first window
    ticks.measured[555, 4] -= 30.0
    recursive = online(held)
    recursive.update(ticks)
    assert recursive.glitches == 2
    assert recursive.changes == []
    sigma = np.sqrt(np.diag(clean.covariance))
    assert (np.abs(recursive.state - clean.state) < 0.5 * sigma).all()


def test_no_information_comes_from_where_no_motion_tells_any():
    """The motion of a vehicle that holds nothing is the same if every link is heavier by the same share."""
    rng = np.random.default_rng(21)
    errors = ImuErrors(0.01, 1e-4, 0.1, 1e-3, 0.003, 0.0035, 1e-4)
    world = free_flyer.world(None)
    flight = free_flyer.fly(world, free_flyer.JointMotion.draw(rng), rng.uniform(-0.05, 0.05, 3), 12.0)
    signals = recorded(flight, rng, errors)
    recursive = online(signals, held=False, imu_prior=PRIOR, links=[*(f"link_{k}" for k in range(1, 6)), "base"])
    recursive.update(ticks_of(signals))
    assert recursive.held is False
    assert recursive.changes == []
    at = [k for k, name in enumerate(recursive.predictor.names) if "_inertial_" in name]
    assert len(at) == 60
    chi = recursive.predictor.vehicle.chi[:60].reshape(6, 10)
    heavier = np.concatenate(
        [np.linalg.solve(np.linalg.cholesky(standard_covariance(x, 0.01, 1e-3, 0.01)), x) for x in chi]
    )
    information = np.linalg.inv(recursive.covariance[np.ix_(at, at)])
    of_the_prior = heavier @ information @ heavier / (heavier @ heavier)
    assert of_the_prior < 1.01


def test_an_innovation_that_is_too_large_shows_by_instrument(held):
    ticks, clean = ticks_of(held), online(held)
    clean.update(ticks)
    assert set(clean.misfit.by_instrument()) == {"imu", "gyro", "accelerometer"}
    assert all(0.9 < ratio < 1.1 for ratio in clean.misfit.by_instrument().values())
    noisier = ticks.measured.copy()
    noisier[450:, :3] += 0.35 * ticks.sigma[450:, :3] * np.random.default_rng(1).normal(size=(len(noisier) - 450, 3))
    spoilt = online(held)
    spoilt.update(ticks._replace(measured=noisier))
    assert spoilt.changes == []
    assert spoilt.misfit.by_instrument()["gyro"] > 1.08
    assert spoilt.misfit.by_instrument()["accelerometer"] < 1.05


def test_a_batch_that_is_suspect_is_not_taken_in(held):
    ticks, recursive = ticks_of(held), online(held)
    recursive.update(ticks.part(slice(0, 500)))
    batch = ticks.part(slice(500, 510))
    outcomes = []
    for scale in np.linspace(0.0, 3.0, 31):
        again = pickle.loads(pickle.dumps(recursive))
        again.update(batch._replace(measured=batch.measured + scale * batch.sigma * [1, -1, 1, -1, 1, -1]))
        outcomes.append("alarm" if again.changes else again.ticks_used - recursive.ticks_used)
    assert outcomes[0] == 10
    assert outcomes[-1] == "alarm"
    assert 0 in outcomes  # large, and not large enough for an alarm: it may be the beginning of something


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
def test_a_call_does_a_bounded_piece_of_a_window_and_can_be_checkpointed_in_between(held, swapped, monkeypatch):
    predicted, predict = [], ImuPredictor.predict

    def counted(self, q, *rest):
        predicted.append(len(q))
        return predict(self, q, *rest)

    monkeypatch.setattr(ImuPredictor, "predict", counted)
    ticks = ticks_of(held).part(slice(0, 210))
    if swapped:  # no hypothesis explains it, so every guess is tried to its end
        ticks = ticks._replace(measured=ticks.measured[:, [1, 0, 2, 3, 4, 5]])
    whole, pieces = online(held), online(held)
    whole.update(ticks)
    places, most, solving = Places(pieces), 0, 0
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


def test_what_ticks_give_without_a_window_is_there_before_the_window_is_solved(held, monkeypatch):
    predicted, predict = [], ImuPredictor.predict

    def counted(self, q, *rest):
        predicted.append(len(q))
        return predict(self, q, *rest)

    monkeypatch.setattr(ImuPredictor, "predict", counted)
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


def test_a_release_that_is_announced_while_a_window_is_solved_comes_after_it(held):
    ticks = ticks_of(held)
    recursive = online(held)
    recursive.update(ticks.part(slice(0, 99)))
    recursive.update(ticks.part(slice(99, 100)))
    recursive.told(False, 1.0)
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
    recursive.told(False, float(ticks.time_s[402]))
    assert recursive.solving
    assert recursive.changes == []
    assert not recursive.holds
    assert recursive.estimate() is None


@pytest.mark.parametrize("seed", [1, 2, 5])
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


class Late:
    """A motion that begins softly, after a while of none."""

    def __init__(self, motion, begins_s):
        self.motion, self.begins_s = motion, begins_s

    def at(self, time_s):
        u = np.maximum(time_s - self.begins_s, 0.0)
        q, dq, ddq = self.motion.at(u - np.arctan(u))
        rate = (u**2 / (1.0 + u**2))[:, None]
        return q, dq * rate, ddq * rate**2 + dq * (2.0 * u / (1.0 + u**2) ** 2)[:, None]


def test_while_the_arm_is_still_the_payload_is_not_known_and_no_alarm_comes_when_it_moves():
    rng = np.random.default_rng(1)
    late = Late(free_flyer.JointMotion.draw(rng), 7.3)
    flight = free_flyer.fly(free_flyer.world(BOX), late, rng.uniform(-0.05, 0.05, 3), 13.0)
    signals = recorded(flight, rng)
    recursive, ticks = online(signals), ticks_of(signals)
    recursive.update(ticks.part(slice(0, 720)))
    unknown = recursive.estimate()
    assert unknown is None or unknown.covariance[0, 0] ** 0.5 > 0.2 * 5.0
    recursive.update(ticks.part(slice(720, None)))
    assert recursive.changes == []
    found = recursive.estimate()
    assert found.body.mass_kg == pytest.approx(5.0, rel=0.03)
    assert abs(found.body.mass_kg - 5.0) < 4.0 * np.sqrt(found.covariance[0, 0])


class Slow:
    """A motion at a share of its rate."""

    def __init__(self, motion, share):
        self.motion, self.share = motion, share

    def at(self, time_s):
        q, dq, ddq = self.motion.at(self.share * np.asarray(time_s))
        return q, self.share * dq, self.share**2 * ddq


def test_what_a_slow_motion_has_told_is_added_up_until_it_determines_the_mass():
    """Windows of 4 s, each solved by itself, know it to a fifth at best, and to a half at the end."""
    rng = np.random.default_rng(2)
    motion = Slow(free_flyer.JointMotion.draw(rng), 0.25)
    flight = free_flyer.fly(free_flyer.world(BOX.grown(0.25)), motion, rng.uniform(-0.01, 0.01, 3), 11.0)
    signals = recorded(flight, rng)
    recursive = online(signals)
    recursive.update(ticks_of(signals))
    found = recursive.estimate()
    sigma_kg = np.sqrt(found.covariance[0, 0])
    assert abs(found.body.mass_kg - 0.25) < 4.0 * sigma_kg < 4.0 * 0.05 * 0.25
    assert recursive.settled()


def test_what_was_caught_at_rest_has_been_in_all_of_the_motion_since(monkeypatch):
    """What was learned of other unknowns since the arm began to move is not kept."""
    rng = np.random.default_rng(4)
    late = Late(Slow(free_flyer.JointMotion.draw(rng), 0.5), 3.0)
    flight = free_flyer.FreeFlight(late, rng.uniform(-0.01, 0.01, 3))
    capture = free_flyer.Capture(BOX.grown(0.3), 2.0, np.zeros(3), np.zeros(3))
    signals = recorded(free_flyer.fly_with_capture(flight, capture, 7.5), rng)
    recursive, since_s = online(signals, held=False), []
    back = recursive._snapshots.back

    def noted(batches):
        since_s.append(recursive._pending.time_s[-1] - BATCH_TICKS * signals.period_s * batches)
        return back(batches)

    monkeypatch.setattr(recursive._snapshots, "back", noted)
    recursive.update(ticks_of(signals))
    assert [change.kind for change in recursive.changes] == ["change", "capture"]
    assert 2.0 < since_s[0] < 3.15 < recursive.changes[0].since_s


def test_derivatives_of_the_prediction_are_finite_differences(held):
    links = ["link_4", "base"]
    one, other = JointPrior(1e-3, 1e-3, 1e-3, 1e-3), JointPrior(zero=1e-3, cyclic=(1e-4, 1e-4))
    some = GeometryPrior(3e-3, {"joint_2": one, "joint_5": other})
    recursive = online(held, imu_prior=PRIOR, links=links, geometry=some)
    predictor, ticks = recursive.predictor, ticks_of(held).part(slice(300, 324))
    motion, waves = (ticks.q, ticks.dq, ticks.ddq), np.random.default_rng(2).normal(size=(24, 3, 4))
    p = len(predictor.names)
    assert p == 3 + 10 + 25 + 20 + 3 + 6 + 1 + 4
    x = np.nan_to_num(predictor.sigma) * np.random.default_rng(1).normal(size=p) * 0.1
    x[:13] = [0.1, -0.2, 0.3, 5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    found = predictor.predict(*motion, x, waves)
    for k in range(p):
        size = 1e-4 if k < 13 else 1e-2 * predictor.sigma[k]
        step = size * np.eye(p)[k]
        up, down = predictor.predict(*motion, x + step, waves), predictor.predict(*motion, x - step, waves)
        slope = (up.values - down.values) / (2.0 * size)
        assert np.abs(found.jacobian[:, :, k] - slope).max() <= 2e-3 * np.abs(slope).max() + 1e-9, predictor.names[k]
        carried = (up.state - down.state) / (2.0 * size)
        assert np.abs(found.transition[:, k] - carried).max() <= 2e-3 * np.abs(carried).max(), predictor.names[k]


def test_the_noise_of_the_joints_is_what_their_errors_make_of_the_prediction(held):
    predictor = online(held).predictor
    q, still = np.repeat(held.q[300:301], 4, axis=0), np.zeros((4, 5))
    x, chi = np.zeros(len(predictor.names)), predictor.vehicle.chi.copy()
    x[PAYLOAD] = chi[predictor.vehicle.payload_columns()] = [5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    rest = predictor.predict(q, still, still, x).values
    small, variance = 1e-6, np.zeros((4, 6))
    for kind, rows in enumerate([slice(0, 3), slice(3, 6)]):  # of a rate the gyro, of an acceleration the force
        for joint in range(5):
            sigma = np.zeros((4, 2, 5))
            sigma[:, kind, joint] = small
            links = link_motions(predictor.vehicle, q, sigma[:, 0], sigma[:, 1])
            turned = x.copy()  # the base takes up what momentum the joints seem to have: there is none in all
            turned[RATE] = predict_base(links, predictor.period_s, chi, np.zeros(3), ()).rate[0]
            moved = predictor.predict(q, sigma[:, 0], sigma[:, 1], turned).values - rest
            alone = predictor.joint_noise(q, sigma, x)
            np.testing.assert_allclose(alone[1:3, rows], np.abs(moved[:, rows]), rtol=1e-3, atol=1e-3 * small)
            variance += alone**2
    together = predictor.joint_noise(q, np.full((4, 2, 5), small), x)
    np.testing.assert_allclose(together**2, variance, rtol=1e-9)
    assert (together > 0.01 * small).all()


def test_noise_of_the_joints_that_is_told_is_no_change(held):
    rng = np.random.default_rng(4)
    ticks, sigma = ticks_of(held), np.full((len(held.q), 2, 5), [[[2e-3], [0.05]]])
    dq, ddq = np.moveaxis(sigma * rng.normal(size=sigma.shape), 1, 0)
    noisy = ticks._replace(dq=ticks.dq + dq, ddq=ticks.ddq + ddq)
    trusting, knowing = online(held), online(held)
    trusting.update(noisy.part(slice(0, 100)))
    knowing.update(noisy._replace(joint_sigma=sigma))
    assert trusting.estimate() is None  # nothing explains its window
    assert knowing.changes == []
    found = knowing.estimate()
    assert abs(found.body.mass_kg - 5.0) < 3.0 * np.sqrt(found.covariance[0, 0]) < 0.5


@pytest.mark.parametrize(
    ("payload", "imu", "links", "message"),
    [
        (None, "imu_base", {}, "no payload link"),
        ("payload", "imu_tip", {}, "imu_tip"),
        ("payload", "imu_base", {"payload": np.eye(10)}, "other than the payload"),
        ("payload", "imu_base", {"wheel": np.eye(10)}, "wheel"),
    ],
)
def test_names_that_do_not_fit_are_refused(payload, imu, links, message):
    vehicle = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", payload))
    with pytest.raises(UnknownFrameError, match=message):
        ImuPredictor(vehicle, imu, 0.01, 5, links, CERTAIN)
