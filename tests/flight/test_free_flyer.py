"""The non-linear estimator in the flight computer: records in, captures and the payload out, again to the bit."""

import pickle
from pathlib import Path

import numpy as np
import pytest

import onboard
from bench.true_flights import free_flyer
from bench.true_flights.free_flyer_sensors import COUNTS_PER_TURN, ImuErrors, sample
from onboard import config
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.estimation.gates import GateReason
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.identification import build_free_flyer
from onboard.ground.identify.replay.feed import feed
from onboard.ground.log.bring_in.importer import import_recordings
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.recording.reader import LogReader
from onboard.regressor.rows import BaseMotion
from onboard.regressor.signals import Signals

VEHICLE = Path(onboard.__file__).parent / "vehicles" / "dymaflex_parabolic"
BOX = free_flyer.Body.box(5.0, (0.20, 0.16, 0.14), (0.03, -0.02, 0.08))
CAPTURE_s, END_s = 3.0, 8.5

ESTIMATION = """
[estimation]
method = "exiddm"
row_rate_hz = 100
smoothing_ms = 100
[estimation.exiddm]
held_at_start = false
[estimation.imu_prior]
gyro_bias_rad_s = 0.01
accelerometer_bias_m_s2 = 0.1
[estimation.prior.link.base]
mass_relative = 0.003
centre_m = 0.001
inertia_relative = 0.01
"""
MAPPING = """
[mapping]
name = "flight"
format = "npz"
[time]
column = "t"
[channel.imu_base]
record = "imu"
gyro = { column = "gyro", values = "physical", scale = 1.332e-4, unit = "rad/s" }
accel = { column = "accel", values = "physical", scale = 1e-3, unit = "m/s^2" }
""" + "".join(
    f"""
[channel.joint_{k}]
record = "scalar"
value = {{ column = "q{k}", values = "physical", scale = {1.0 / COUNTS_PER_TURN!r}, unit = "rev" }}
"""
    for k in range(1, 6)
)


def vehicle_file(directory, estimation=ESTIMATION):
    text = (VEHICLE / "vehicle.toml").read_text().split("[estimation]")[0] + estimation
    (directory / "dymaflex.urdf").write_bytes((VEHICLE / "dymaflex.urdf").read_bytes())
    (directory / "vehicle.toml").write_text(text)
    return directory / "vehicle.toml"


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory):
    return config.load(vehicle_file(tmp_path_factory.mktemp("vehicle")))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A payload is captured after three seconds."""
    directory, rng = tmp_path_factory.mktemp("flown"), np.random.default_rng(12)
    flight = free_flyer.FreeFlight(free_flyer.JointMotion.draw(rng), rng.uniform(-0.05, 0.05, 3))
    capture = free_flyer.Capture(BOX, CAPTURE_s, 0.02 * rng.normal(size=3), 0.02 * rng.normal(size=3))
    flown = free_flyer.fly_with_capture(flight, capture, END_s)
    samples = sample(flown, ImuErrors(gyro_bias_rad_s=0.01, accelerometer_bias_m_s2=0.1), rng)
    turns = {f"q{k + 1}": samples.angle_rad[:, k] / (2.0 * np.pi) for k in range(5)}
    times = {"t": samples.time_s, "gyro": samples.rate_rad_s, "accel": samples.specific_force_m_s2}
    np.savez(directory / "flight.npz", **times, **turns)
    (directory / "flight.toml").write_text(MAPPING)
    return import_recordings(directory / "flight.toml", directory / "flight.npz", directory)[0].path


@pytest.fixture(scope="module")
def answers(vehicle, log):
    return list(feed(Estimator(vehicle), LogReader(log)))


def quantities(answers):
    for channel, rows in answers:
        if channel == "quantity":
            at_s = rows["vehicle_ns"][0] * 1e-9
            yield at_s, {row["name"].decode(): row for row in rows}


def test_a_capture_is_told_within_half_a_second_and_the_payload_follows(answers):
    events = [rows[0] for channel, rows in answers if channel == "event"]
    assert [event["code"] for event in events] == [b"change", b"capture"]
    assert CAPTURE_s < events[0]["host_ns"] * 1e-9 < CAPTURE_s + 0.5
    ago_s = float(events[1]["text"].split()[1])
    assert CAPTURE_s < events[1]["host_ns"] * 1e-9 - ago_s < CAPTURE_s + 0.2
    before = [found for at_s, found in quantities(answers) if at_s < CAPTURE_s + 1.0]
    assert len(before) > 20
    assert not any(row["supported"] for found in before for row in found.values())
    times_s = [at_s for at_s, _ in quantities(answers)]
    assert max(np.diff(times_s)) < 0.3  # also while nothing is known: the last answer does not stand
    _, last = list(quantities(answers))[-1]
    for name, truth in {"m_payload": 5.0, "c_x_payload": 0.03, "c_y_payload": -0.02, "c_z_payload": 0.08}.items():
        assert last[name]["supported"]
        assert last[name]["value"] == pytest.approx(truth, abs=4.0 * last[name]["sigma"])
        assert last[name]["low"] < last[name]["value"] < last[name]["high"]
    assert last["m_payload"]["value"] == pytest.approx(5.0, rel=0.05)


def test_the_state_of_the_estimate_channel_is_the_payload(answers):
    states = [rows[0] for channel, rows in answers if channel == "estimate"]
    _, last = list(quantities(answers))[-1]
    R = np.zeros((11, 11))
    R[np.triu_indices(11)] = states[-1]["triangle"]
    np.testing.assert_allclose(np.linalg.solve(R[:10, :10], R[:10, 10]), states[-1]["mean"], rtol=1e-6)
    half = np.linalg.inv(R[:10, :10])
    assert np.sqrt((half @ half.T)[0, 0]) == pytest.approx(float(last["m_payload"]["sigma"]))
    assert np.isnan(states[20]["mean"]).all()  # nothing was held
    assert not states[20]["triangle"].any()


def test_a_checkpoint_in_mid_flight_gives_the_same_answers_to_the_bit(vehicle, log, answers):
    steps = []

    class Taped(Estimator):
        def process(self, now_ns, batches, *rest):
            steps.append((now_ns, dict(batches), *rest))
            return []

    for _ in feed(Taped(vehicle), LogReader(log)):
        pass
    estimator, again = Estimator(vehicle), []
    for k, step in enumerate(steps):
        again += estimator.process(*step)
        if k % 30 == 29:
            estimator = pickle.loads(pickle.dumps(estimator))
    assert isinstance(estimator.online, MotionIdentifier)
    assert len(again) == len(answers) > 100
    for (channel, rows), (other, theirs) in zip(again, answers, strict=True):
        assert channel == other
        assert rows.tobytes() == theirs.tobytes()


def still(n, first_s=0.0):
    joints, zero = np.zeros((n, 5)), np.zeros((n, 3))
    motion = BaseMotion(zero, zero, zero)
    return Signals(first_s + 0.01 * np.arange(n), joints, joints, joints, motion, np.zeros((n, 6)), np.ones((n, 6)))


def test_refused_ticks_are_marked_and_counted(vehicle):
    online, _ = build_free_flyer(vehicle)
    signals = still(50)
    signals.measured[3, 2] = np.nan
    excluded = np.zeros(50, np.int64)
    excluded[7:9] = GateReason.PHASE
    found = online.update(signals, np.ones(50, np.bool_), excluded)
    assert found[3].tolist() == [0, 0, GateReason.GAP, 0, 0, 0]  # the other readings of the tick are used
    assert (found[7:9] == GateReason.PHASE).all()
    assert np.count_nonzero(found) == 13
    assert online.refused[GateReason.GAP] == 1
    assert online.refused[GateReason.PHASE] == 12
    with pytest.raises(Exception, match=r"need \(50, 6\) readings"):
        online.update(signals._replace(measured=np.zeros((50, 2))), np.ones(50, np.bool_), excluded)


def test_what_the_data_do_not_determine_is_not_supported(vehicle):
    online, _ = build_free_flyer(vehicle)
    ekf = online.ekf
    assert len(online.estimate().quantities) == 10
    assert all("nothing is held" in quantity.note for quantity in online.estimate().quantities)
    ekf.held, ekf.state, ekf.ticks_used = True, np.zeros(len(ekf.predictor.names)), 400
    ekf.state[3:13] = standard_of(RigidBody(BOX.mass_kg, BOX.centre_of_mass_m, BOX.inertia_kg_m2))

    def told(mass_sigma_kg, inertia_sigma):
        sigma = np.array([mass_sigma_kg, *[0.01] * 3, *[inertia_sigma] * 6])
        ekf.covariance = ekf.covariance.copy()
        ekf.covariance[3:13, 3:13] = np.diag(sigma**2)
        found = online.estimate().quantities
        assert all(np.isfinite([q.value, q.sigma, q.low, q.high]).all() == q.supported for q in found)
        assert all((q.note == "") == q.supported for q in found)
        return [q.supported for q in found]

    assert told(0.1, 0.01) == [True] * 10
    assert told(0.1, 5.0) == [True] * 4 + [False] * 6  # half of what a payload could be at all
    assert told(2.0, 0.01) == [True] + [False] * 9  # a mass that one cannot divide by
    ekf.state = np.where(np.arange(ekf.state.size) == 3, -1.0, ekf.state)
    assert not any(quantity.supported for quantity in online.estimate().quantities)
    assert "no centre of mass" in online.estimate().quantities[0].note


def test_a_phase_tells_that_the_payload_was_taken_and_let_go(vehicle):
    online, _ = build_free_flyer(vehicle)
    attached = np.repeat([False, True, False], 40)
    online.update(still(120), attached, np.zeros(120, np.int64))
    online.update(still(120, 1.2), np.zeros(120, np.bool_), np.zeros(120, np.int64))
    told = online.news()
    assert [(change.kind, round(change.time_s, 2)) for change in told] == [("capture", 0.4), ("ejection", 0.8)]
    assert online.news() == ()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("row_rate_hz = 100", "row_rate_hz = 400", "lower row_rate_hz"),
        ("link.base", "link.bass", "prior.link names 'bass'"),
        ("smoothing_ms = 100", 'smoothing_ms = 100\nbase_rows = ["force"]', "base_rows is for"),
        ("smoothing_ms = 100", 'smoothing_ms = 100\nnuisance = ["m"]', "nuisance is for"),
        ("gyro_bias_rad_s = 0.01", "gyro_bias_rad_s = -0.01", "0 or more"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_remedy(tmp_path, old, new, message):
    assert ESTIMATION.count(old) == 1
    with pytest.raises(config.ConfigError, match=message):
        build_free_flyer(config.load(vehicle_file(tmp_path, ESTIMATION.replace(old, new))))


def test_a_base_that_is_not_free_and_a_vehicle_without_a_payload_are_refused(tmp_path):
    path = vehicle_file(tmp_path)
    text = path.read_text()
    path.write_text(text.replace('base = "free"', 'base = "fixed"'))
    with pytest.raises(config.ConfigError, match='is for base = "free"'):
        config.load(path)
    path.write_text(text.replace('payload_link = "payload"\n', ""))
    with pytest.raises(config.ConfigError, match="name its payload_link"):
        config.load(path)


def test_a_vehicle_file_of_before_the_words_changed_is_read_as_it_was():
    new = (VEHICLE / "vehicle.toml").read_text()
    assert new.count("[estimation.imu_prior]") == 1
    assert new.count("_misalignment_rad") == 2
    old = new.replace("[estimation.imu_prior]", "[estimation.doubt]").replace("_misalignment_rad", "_turn_rad")
    read = [config.parse(text, VEHICLE / "vehicle.toml").file.estimation.imu_prior for text in (old, new)]
    assert read[0] == read[1]
    assert read[0].gyro_misalignment_rad == 0.01
    with pytest.raises(config.ConfigError, match="gyro_turn_rad"):
        config.parse(old.replace("gyro_turn_rad = 0.01", "gyro_turn_rad = -1.0"), VEHICLE / "vehicle.toml")
    with pytest.raises(config.ConfigError, match="doubt"):
        config.parse(old + "\n[estimation.imu_prior]\ngyro_scale = 0.1\n", VEHICLE / "vehicle.toml")
