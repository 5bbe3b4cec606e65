"""An arm with springs in its joints whose stiffness is known: an answer, where there is none without it."""

import pickle

import numpy as np
import pytest

from bench.true_flights import free_flyer
from onboard import config
from onboard.flight.estimate.problem.identification import build_free_flyer, build_online
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD
from onboard.identification.free_flyer.prediction.parameters import GeometryPrior, JointPrior, SpringPrior
from onboard.identification.standing import Level, standing
from tests.dynamics.free_flyer_twin import BOX
from tests.dynamics.test_compliance import flown
from tests.identification.free_flyer.recorded_flights import online, recorded, same_bits, ticks_of

SECONDS, STEP_s, SHOWN_s = 6.0, 1e-3, 2e-3
OFF = np.array([0.1, -0.1, 0.05, -0.07, 0.08])  # of what is stated


@pytest.fixture(scope="module")
def springy():
    """DYMAFLEX swings a payload on springs of 20 Hz, those of its unladen joints; with the payload of 1.5 Hz and up."""
    (q, dq, _), shown, springs = flown(20.0, STEP_s, SECONDS, tick_s=SHOWN_s)
    still = np.zeros((len(q), 3))
    time_s = SHOWN_s * np.arange(len(q))
    seen = time_s, q, dq, shown[:, :3], shown[:, 3:], still, still, np.zeros_like(q)
    return recorded(free_flyer.FreeFlightSignals(*seen), np.random.default_rng(1)), springs


def flight_of(springy, off, *, stated=True):
    signals, springs = springy
    told = [
        SpringPrior(one.stiffness_N_m_rad * (1.0 + by), 0.1, None, 1.0) for one, by in zip(springs, off, strict=True)
    ]
    joints = {f"joint_{k}": JointPrior(spring=one if stated else None) for k, one in enumerate(told, 1)}
    return MotionIdentifier(online(signals, geometry=GeometryPrior(joints=joints))), ticks_of(signals)


def answer(identifier, ticks):
    ekf = identifier.ekf
    for first in range(0, len(ticks.time_s), 10):
        ekf.update(ticks.part(slice(first, first + 10)))
    ekf.finish()
    return {one.name: one for one in identifier.estimate().quantities}


def test_the_stiffness_is_stated_within_its_sigma(springy):
    identifier, ticks = flight_of(springy, OFF)
    found = answer(identifier, ticks)
    truth = {
        "m_payload": BOX.mass_kg,
        **{f"c_{a}_payload": c for a, c in zip("xyz", BOX.centre_of_mass_m, strict=True)},
    }
    for name, value in truth.items():
        assert standing(found[name], identifier.findings()).level is Level.GOOD
        assert abs(found[name].value - value) < 3.29 * found[name].sigma, name
    assert found["m_payload"].sigma < 0.05
    predictor, state = identifier.ekf.predictor, identifier.ekf.state
    at = [k for k, name in enumerate(predictor.names) if name.startswith("stiffness_")]
    assert np.abs((1.0 + OFF) * (1.0 + state[at]) - 1.0).max() < 0.03  # it was known to 0.1


@pytest.mark.parametrize(
    ("off", "stated", "why"),
    [
        (OFF, False, "swings at"),
        (-5.0 * OFF, True, "stiffness_joint"),
    ],
)
def test_a_stiffness_that_is_missing_or_wrong_is_the_reason(springy, off, stated, why):
    identifier, ticks = flight_of(springy, off, stated=stated)
    found = answer(identifier, ticks)
    for one in found.values():
        said = standing(one, identifier.findings())
        assert said.level is Level.DO_NOT_USE
        assert why in said.text


@pytest.mark.campaign  # of an arm without springs, whose state has the same form: test_recursive
def test_a_checkpoint_goes_on_to_the_same_bits(springy):
    identifier, ticks = flight_of(springy, OFF)
    identifier.ekf.update(ticks.part(slice(0, 430)))
    copy = pickle.loads(pickle.dumps(identifier.ekf))
    assert identifier.ekf.state is not None
    for one in (identifier.ekf, copy):
        one.update(ticks.part(slice(430, 500)))
    assert same_bits(identifier.ekf, copy)


def vehicle_with(name, **joint_1):
    vehicle = config.load(config.packaged(name))
    tree = vehicle.file.model_dump(exclude_unset=True, by_alias=True)
    joints = tree["estimation"].setdefault("prior", {}).setdefault("joint", {})
    joint = next(iter(tree["device"][key]["joint"] for key in tree["device"] if "joint" in tree["device"][key]))
    joints[joint] = joints.get(joint, {}) | joint_1
    return config.parse_tree(tree, vehicle.path, config.Origin("test"))


def test_a_joint_of_a_vehicle_file():
    stiff = build_free_flyer(config.load(config.packaged("dymaflex")))[0].ekf.predictor
    assert not stiff.bends.size
    given = {"stiffness_N_m_rad": 2000.0, "stiffness_relative": 0.2, "damping_N_m_s_rad": 3.0, "damping_relative": 0.3}
    predictor = build_free_flyer(vehicle_with("dymaflex", **given))[0].ekf.predictor
    own = ["stiffness_joint_1", "damping_joint_1", "bend_joint_1", "bend_rate_joint_1"]
    assert sorted(set(predictor.names) - set(stiff.names)) == sorted(own)
    sigma = dict(zip(predictor.names, predictor.sigma, strict=True))
    assert (sigma["stiffness_joint_1"], sigma["damping_joint_1"]) == (0.2, 0.3)


@pytest.mark.parametrize(
    ("name", "keys", "message"),
    [
        ("dymaflex", {"stiffness_relative": 0.1}, "stiffness_relative: of a flexible joint; give stiffness_N_m_rad"),
        ("dymaflex", {"stiffness_N_m_rad": -4700.0}, "stiffness_N_m_rad"),
        ("dymaflex", {"stiffness_N_m_rad": 4700.0, "stiffness_relative": 2.0}, "stiffness_relative"),
        ("dymaflex", {"stiffness_N_m_rad": 300.0}, "swings with nothing held at 7.4 Hz; answers hold from 9 to 25 Hz"),
        ("dymaflex", {"stiffness_N_m_rad": 1e6}, "swings with nothing held at 4.3e.02 Hz.*it is taken for stiff then"),
        ("dymaflex_air_bearing", {"stiffness_N_m_rad": 4700.0}, "not on a table; take it out"),
        ("rocksat", {"stiffness_N_m_rad": 4700.0}, "not to rows; take it out"),
    ],
)
def test_a_stiffness_that_has_no_meaning_is_refused(name, keys, message):
    with pytest.raises(config.ConfigError, match=message):
        build_online(vehicle_with(name, **keys))


def test_the_noise_of_the_joints_drives_the_bends(springy):
    identifier, ticks = flight_of(springy, OFF)
    predictor, some = identifier.ekf.predictor, ticks.part(slice(0, 12))
    state = np.zeros(len(predictor.names))
    state[PAYLOAD] = [5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    found, known = predictor.predict(some.q, some.dq, some.ddq, state), np.eye(len(state))
    noise = np.full((12, 2, 5), [[0.0], [0.3]]) * np.arange(1.0, 6.0)
    _, exact = predictor.carried(found, state, state, known)
    _, noisy = predictor.carried(found, state, state, known, noise)
    wider = np.zeros(len(state))
    wider[predictor.bends[5:]] = 10.0 * 10 * (0.01 * 0.3 * np.arange(1.0, 6.0)) ** 2  # ten ticks of 10 ms
    np.testing.assert_allclose(noisy - exact, np.diag(wider), atol=1e-12)
