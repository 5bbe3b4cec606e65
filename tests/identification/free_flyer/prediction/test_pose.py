"""What a tracker of the base shows, against a motion integrated here and against the law of its centre of mass."""

import numpy as np
import pytest

from onboard import config
from onboard.dynamics.kinematics import chain_motion
from onboard.dynamics.tracked_pose import left, product, quaternion_of, right, rotation
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.problem.priors import free_flyer_prior, geometry_prior
from onboard.identification.free_flyer.fusion import Fusion
from onboard.identification.free_flyer.guesses import first_pose, first_state
from onboard.identification.free_flyer.prediction.further import FurtherPose, PosePrior
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE, ImuPredictor
from onboard.identification.free_flyer.prediction.ticks import Ticks

PERIOD_s = 0.01
PRIOR = PosePrior(1e-3, 0.02, 3e-3, 1e-3, 1e-3)
START = [0.6, -0.3, 0.7, 0.245, 1.0, 2.0, 3.0, 0.1, 0.2, -0.1]  # attitude of length one, place, velocity
PAYLOAD_CHI = [5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]


def predictor_of(*further):
    vehicle = config.load(config.packaged("dymaflex"))
    model = build_model(vehicle)
    covariance, prior, _ = free_flyer_prior(vehicle, model)
    return ImuPredictor(model, "imu_base", PERIOD_s, 10, covariance, prior, geometry_prior(vehicle, model), further)


@pytest.fixture(scope="module")
def predictor():
    return predictor_of(FurtherPose("tracker", "imu_base", PRIOR))


def motion(ticks, seed=1):
    rng = np.random.default_rng(seed)
    t, size, pace, phase = PERIOD_s * np.arange(ticks)[:, None], *rng.uniform(0.5, 2.0, (3, 5))
    q, dq = 0.3 * size * np.sin(pace * t + phase), 0.3 * size * pace * np.cos(pace * t + phase)
    return q, dq, -(pace**2) * q


def state_of(predictor):
    x = np.zeros(len(predictor.names))
    x[PAYLOAD], x[RATE], x[predictor.moving] = PAYLOAD_CHI, [0.2, -0.3, 0.1], START
    x[predictor.moving[:4]] /= np.linalg.norm(x[predictor.moving[:4]])
    return x


def test_quaternions_are_those_of_hamilton(rng):
    p, q, r = rng.normal(size=(3, 4))
    assert left(p) @ q == pytest.approx(right(q) @ p)
    assert product(product(p, q), r) == pytest.approx(product(p, product(q, r)))
    p /= np.linalg.norm(p)
    a = rng.normal(size=3)
    turned = product(product(p, np.concatenate([[0.0], a])), p * [1, -1, -1, -1])
    assert rotation(p[None])[0] @ a == pytest.approx(turned[1:])
    assert abs(quaternion_of(rotation(p[None])[0]) @ p) == pytest.approx(1.0)


def test_each_of_two_trackers_has_a_pose_of_its_own_that_is_carried_on():
    both = predictor_of(FurtherPose("tracker", "imu_base", PRIOR), FurtherPose("other", "imu_base", PRIOR))
    x, half = np.zeros(len(both.names)), len(both.moving) // 2
    one, other = both.moving[:half], both.moving[half:]
    x[PAYLOAD], x[RATE] = PAYLOAD_CHI, [0.2, -0.3, 0.1]
    x[one] = x[other] = state_of(predictor_of(FurtherPose("tracker", "imu_base", PRIOR)))[one]
    transition = both.predict(*motion(40), x).transition
    rows = [[both.changing.tolist().index(at) for at in its.tolist()] for its in (one, other)]
    for columns in ((one, other), (slice(0, 3), slice(0, 3))):
        first, second = (transition[its][:, own] for its, own in zip(rows, columns, strict=True))
        assert first.any()
        np.testing.assert_array_equal(first, second)


def test_the_centre_of_mass_moves_straight_and_the_base_turns_with_its_rate(predictor):
    x, (q, dq, ddq) = state_of(predictor), motion(400)
    found = predictor.predict(q, dq, ddq, x)
    shown, rate = found.values[:, predictor.lines[-1]], found.values[:, :3]
    R_BM, p_BoMo_B = predictor.vehicle.pose_in_base("imu_base")
    attitude = [rotation(one[None])[0] for one in shown[:, :4]]  # of M: the base's axes turned by its mounting
    for a, b, w in zip(attitude[:-1], attitude[1:], 0.5 * (rate[1:] + rate[:-1]), strict=True):
        turn = a.T @ b
        two_thousandths = 2e-3 * np.linalg.norm(w)
        seen = np.array([turn[2, 1], turn[0, 2], turn[1, 0]]) / PERIOD_s
        assert np.linalg.norm(seen - w) < two_thousandths
    vehicle = predictor.vehicle
    links = chain_motion(vehicle, q, dq, ddq).links
    chi = predictor.chi(x).reshape(-1, 10)
    first = np.einsum("nlij,lj->nli", links.R, chi[:, 1:4]) + links.p * chi[:, 0, None]
    centre_B = (first.sum(axis=1) / chi[:, 0].sum())[1:-1]
    seen_m = [p + R @ R_BM.T @ (c - p_BoMo_B) for p, R, c in zip(shown[:, 4:], attitude, centre_B, strict=True)]
    t = PERIOD_s * np.arange(1, 399)[:, None]
    a_micrometre = 1e-6
    assert np.abs(np.array(seen_m) - (START[4:7] + t * START[7:])).max() < a_micrometre


def test_the_first_pose_is_found_from_nothing(predictor):
    x, joints = state_of(predictor), motion(120)
    own = predictor.lines[-1]
    measured = np.full((120, own.stop), np.nan)
    measured[3:-1:4, own] = predictor.predict(*joints, x).values[2::4, own]
    none = predictor.no_ticks
    blank = np.zeros((120, 3, 20))  # functions of the cyclic errors of five joints
    zeros = np.zeros((120, 2, 5))
    exact = zeros, zeros, blank, none.thrust, np.ones(120)
    ticks = Ticks(PERIOD_s * np.arange(120), *joints, measured, np.full_like(measured, 5e-4), *exact)
    nothing = x.copy()
    nothing[predictor.moving] = 0.0
    assert first_pose(predictor, ticks, nothing) == pytest.approx(x[predictor.moving], abs=1e-4)
    assert first_pose(predictor, ticks._replace(measured=np.full_like(measured, np.nan)), nothing).any() == 0


def test_of_a_joint_that_says_nonsense_no_state_is_made_and_nothing_is_printed(predictor, capfd):
    """LAPACK wrote "On entry to DLASCL parameter number 4 had an illegal value" to the terminal of the flight."""
    x, (q, dq, ddq) = state_of(predictor), motion(120)
    read = np.zeros((120, predictor.lines[-1].stop))
    wild, zeros = np.full_like(dq, 1e300), np.zeros((120, 2, 5))
    rest = np.full_like(read, 5e-4), zeros, zeros, np.zeros((120, 3, 20)), predictor.no_ticks.thrust, np.ones(120)
    assert first_state(predictor, Ticks(PERIOD_s * np.arange(120), q, wild, ddq, read, *rest), x) is None
    assert capfd.readouterr() == ("", "")


def test_a_pose_that_is_not_known_any_more(predictor, rng):
    A = rng.normal(size=(len(predictor.names), len(predictor.names)))
    mean, P = predictor.anew(np.ones(len(A)), A @ A.T)
    at = predictor.moving
    assert (mean[at] == 0.0).all()
    assert P[np.ix_(at, at)] == pytest.approx(np.diag(predictor.sigma[at] ** 2))
    others = np.setdiff1d(np.arange(len(A)), at)
    assert (P[np.ix_(others, others)] == (A @ A.T)[np.ix_(others, others)]).all()
    assert not P[np.ix_(at, others)].any()


def test_a_vehicle_without_a_tracker_has_nothing_of_it(rng):
    bare = predictor_of()
    assert bare.moving.size == 0
    mean, P = rng.normal(size=3), np.eye(3)
    assert bare.anew(mean, P) == (mean, P)  # the same objects: not one bit changes
    assert not any("tracker" in name for name in bare.names)


def test_a_tracker_is_doubted_in_the_first_window_already():
    fusion = Fusion(("imu", "cell", "tracker"), (slice(0, 6), slice(6, 7), slice(7, 14)))
    assert fusion.doubted(longer=False) == [2]
    assert fusion.doubted(longer=True) == [1, 2]


def test_the_place_in_the_room_does_not_take_part_in_the_trackers_scale(predictor):
    x, joints = state_of(predictor), motion(20)
    x[predictor.names.index("scale_tracker")] = 0.05
    near = predictor.predict(*joints, x).values[:, predictor.lines[-1]]
    x[predictor.moving[4:7]] += [100.0, -50.0, 20.0]
    far = predictor.predict(*joints, x).values[:, predictor.lines[-1]]
    assert far[:, :4] == pytest.approx(near[:, :4])
    assert far[:, 4:] - near[:, 4:] == pytest.approx(np.tile([100.0, -50.0, 20.0], (len(near), 1)))
