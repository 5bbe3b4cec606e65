"""The compiled core against plain NumPy of the same equations, of random vehicles and shapes."""

import numpy as np
import pytest

from onboard.dynamics import free_flight
from onboard.dynamics.air_bearing import predict_run
from onboard.dynamics.cut_wrench import CutWrench
from onboard.dynamics.free_flight import predict_base, predict_base_from_rate, rate_of_momentum, sensor_in_base
from onboard.dynamics.joint_errors import JointErrors
from onboard.dynamics.kinematics import Bodies, chain_motion
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.spatial import Columns
from onboard.estimation import kinematics, smoothing
from onboard.identification.evidence.bank import Bank, Changed, Suspect
from onboard.identification.free_flyer.prediction.further import PlacedImu, cuts_of
from onboard.identification.free_flyer.prediction.imu_errors import SIZE, gain_of, imu_reading, whitened
from onboard.identification.free_flyer.prediction.joint_noise import JointNoise, sigma_of
from onboard.identification.free_flyer.prediction.scaled import Scaled
from onboard.native import build, library
from onboard.native.errors import ArrayError
from tests.native.oracle import base as oracle
from tests.native.oracle import errors as of_errors
from tests.native.oracle import evidence as of_evidence
from tests.native.oracle import imu as of_imu
from tests.native.oracle import noise as of_noise
from tests.native.oracle import prediction as of_prediction
from tests.native.oracle import smoothing as of_smoothing
from tests.native.oracle import table as of_table
from tests.native.oracle.bodies import Bodies as OracleBodies
from tests.native.oracle.chain import chain_motion as oracle_chain
from tests.native.vehicles import (
    PERIOD_s,
    lines_of_imu,
    on_table,
    predicted_from,
    random_case,
    random_predictor,
    random_suspects,
)

CASES = [pytest.param(one, marks=pytest.mark.campaign if one > 11 else ()) for one in range(24)]  # further vehicles
TOLERANCE = 1e-13  # of the largest of an array
SOLVED = 1e-11  # where a system of six equations was solved: the condition of a composite inertia is a few hundred


def same(found, true, tolerance=TOLERANCE):
    assert found.shape == true.shape
    if true.size:
        assert np.isfinite(true).all()
        np.testing.assert_allclose(found, true, rtol=0.0, atol=tolerance * max(np.abs(true).max(), 1e-300))


@pytest.fixture(params=CASES)
def case(request):
    return random_case(request.param)


def test_readings_and_the_chain(case):
    for found, true in zip(
        case.corrected,
        of_errors.corrected(case.readings, case.of_joints, case.multiples, case.errors.of_cyclic),
        strict=True,
    ):
        same(found, true)
    motion = case.corrected[:3]
    for offsets in (None, case.of_joints[:, :3]):
        found, true = (one(case.vehicle, *motion, offsets) for one in (chain_motion, oracle_chain))
        for ours, theirs in zip((*found[0], *found[1], *found[2:]), (*true[0], *true[1], *true[2:]), strict=True):
            same(ours, theirs)


def test_bodies_and_their_sums(case):
    rng = np.random.default_rng(1)
    frames, n = case.chain.links, len(case.rate)
    n = len(frames.p)
    twist, thrust = rng.normal(size=(2, n, 6))
    groups = rng.integers(0, 2, size=(3, len(case.vehicle.links))).astype(np.float64)
    rest, still = Bodies.of(frames, case.vehicle.chi), OracleBodies(frames, case.vehicle.chi)
    same(rest.composite, still.composite)
    same(rest.relative_momentum, still.relative_momentum)
    same(rest.sums(groups).inertia, still.sums(groups).inertia)
    moved = Bodies.of(frames, case.vehicle.chi, twist, thrust)
    _, slope = still.moved(twist)
    still.pushed(thrust)
    same(moved.slope, slope)
    for name in ("twist", "rate", "V", "A"):
        same(getattr(moved, name), getattr(still, name))
    for found, true in zip(moved.sums(groups), still.sums(groups), strict=True):
        same(found, true)


def local_of(case):
    """Functions at each tick by itself: none, or some of the last."""
    return len(case.errors.of_cyclic) // 2


@pytest.mark.parametrize("by_rate", [True, False])
def test_the_base_and_all_derivatives(case, by_rate):
    chain, frames = case.chain, case.chain.links
    along = case.errors.along(chain, case.corrected.functions, local_of(case))
    free, given = Columns(case.free, case.bases), (PERIOD_s, case.vehicle.chi, case.rate)
    if by_rate:
        found = predict_base_from_rate(frames, *given, free, along, case.push)
        true = oracle.predict(frames, *given, case.free, case.bases, along, case.push)
    else:
        found = predict_base(frames, *given, case.free)
        true = oracle.predict(frames, *given, case.free, by_rate=False)
    names = "rate acceleration specific_force along by_rate by_wrench momentum d_momentum"
    for name in names.split():
        same(getattr(found, name), getattr(true, name), SOLVED)
    assert (found.local, found.at_first) == (true.local, true.at_first)
    if by_rate:
        same(found.displaced.screws, true.displaced.screws, SOLVED)
        bodies = free_flight.bodies_from_rate(frames, *given, case.push)
        assert (bodies.parts == found.bodies.parts).all()  # the same arithmetic without derivatives


def test_instruments_along_a_motion(case):
    rng = np.random.default_rng(2)
    chain, (n, _) = case.chain, case.readings.q.shape
    along = case.errors.along(chain, case.corrected.functions)
    free, given = Columns(case.free, case.bases), (PERIOD_s, case.vehicle.chi, case.rate)
    base = predict_base_from_rate(chain.links, *given, free, along, case.push)
    true = oracle.predict(chain.links, *given, case.free, case.bases, along, case.push)
    R, p = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3)
    found, sensor = sensor_in_base(base, R, p), oracle.sensor_in_base(base, R, p)
    for ours, theirs in zip(found, sensor, strict=True):
        same(ours, theirs)
    for size in (1e-3, 0.3):  # with series for the rotation, and without
        errors = size * rng.normal(size=SIZE)
        same(gain_of(errors), of_imu.gain_of(errors))
        read = rng.normal(size=(2, n, 6))
        for one, other in zip(
            imu_reading(*read, np.arange(float(n)), errors),
            of_imu.imu_reading(*read, np.arange(float(n)), errors),
            strict=True,
        ):
            same(one, other)
    frame = case.vehicle.joints[-1].name
    cyclic = case.errors.of_cyclic.tolist()
    cut = CutWrench(case.vehicle, frame, rng.normal(size=6), case.free, cyclic)
    ours, theirs = cut.predict(base), oracle.cut_wrench(cut, true, true.bodies)
    same(ours.values, theirs[0], SOLVED)
    same(ours.d_values, theirs[1], SOLVED)


@pytest.mark.parametrize("seed", range(12))
def test_what_instruments_show_from_a_state(seed):
    predictor = random_predictor(seed)
    for more in range(3):
        given = predicted_from(predictor, seed + 12 * more)
        found, true = predictor.predict(*given), of_prediction.predict(predictor, *given)
        for ours, theirs in zip(found, true, strict=True):
            same(ours, theirs, SOLVED)
        by_line = np.moveaxis(found.jacobian, 1, 0), np.moveaxis(true[1], 1, 0)
        for ours, theirs in zip(*by_line, strict=True):
            same(ours, theirs, 1e-9)  # of the largest of each instrument's


@pytest.mark.parametrize("free", [range(6), (0, 1, 5)])
@pytest.mark.parametrize("seed", range(6))
def test_noise_of_the_joints(seed, free):
    predictor, rng = random_predictor(seed), np.random.default_rng(seed)
    vehicle, n, joints = predictor.vehicle, 23, len(predictor.vehicle.joints)
    q, sigma = rng.normal(size=(n, joints)), rng.uniform(0.0, 1.0, (2, n, 2, joints))
    imus = [PlacedImu(*vehicle.pose_in_base(frame), 10, *[slice(0)] * 2) for frame in predictor.imu_frames]
    cuts = [cut for _, cut in cuts_of(vehicle, predictor.further, (), ())]
    parts = JointErrors(vehicle), imus, cuts, predictor.lines, list(free)
    noise = JointNoise(vehicle, *parts)
    each = noise.by_joint(q, vehicle.chi, *sigma)
    for found, one in zip(each, sigma, strict=True):
        same(found, expected := of_noise.of(vehicle, *parts, q, vehicle.chi, one), SOLVED)
        same(sigma_of(found) ** 2, (expected**2).sum(axis=1), SOLVED)
    assert not noise.by_joint(q, vehicle.chi, 0.0 * sigma[0])[0].any()


@pytest.mark.parametrize("seed", range(6))
def test_a_covariance_some_ticks_later(seed):
    predictor, rng = random_predictor(seed), np.random.default_rng(seed)
    *given, cyclic, thrust = predicted_from(predictor, seed)
    predicted, p, c = predictor.predict(*given, cyclic, thrust), len(predictor.names), predictor.changing
    root, state = rng.normal(size=(p, p)), rng.normal(size=p)
    whole, after_s = np.eye(p), len(predicted.values) * PERIOD_s
    whole[c] = predicted.transition
    left = np.ones(p)
    for at, memory_s in predictor.fading:
        left[at] = np.exp(-after_s / memory_s)
    covariance, start = root @ root.T, given[-1]
    found, later = predictor.carried(predicted, start, state, covariance)
    aged = predictor.aged(np.diag(left) @ whole @ covariance @ whole.T @ np.diag(left), len(predicted.values))
    same(later, aged, 1e-12)
    assert (later == later.T).all()
    expected = predicted.state + state - start
    expected[c] = predicted.state[c] + predicted.transition @ (state - start)
    same(found, expected * left, 1e-12)


@pytest.mark.parametrize("seed", CASES)
def test_whitened_lines_of_an_imu(seed):
    for use in (slice(None), slice(1, None, 3), slice(-1, None), slice(0, 0)):  # with gaps, the last one alone
        given = lines_of_imu(seed, use)
        found, true = whitened(*given), of_imu.whitened(*given)
        same(found[0], true[0])
        same(found[1], true[1])
        assert found[1].any() == (use != slice(0, 0))


@pytest.mark.parametrize("wrong", [{"places": [-1]}, {"places": [1000]}, {"ticks": 4}, {"columns": 3}])
def test_whitened_lines_of_other_shapes_are_refused(wrong):
    shown, errors, (gain, along), samples, told, (places, use) = lines_of_imu(1)
    places = np.array(wrong.get("places", places))
    gain, along = gain[: wrong.get("ticks")], along[..., : wrong.get("columns")]
    with pytest.raises(ArrayError):
        whitened(shown, errors, (gain, along), samples, told, (places, use))


def test_a_motion_of_too_few_ticks_is_refused():
    predictor = random_predictor(1)
    q, dq, ddq, state, *_ = predicted_from(predictor, 1)
    with pytest.raises(SignalError, match="3 ticks"):
        predictor.predict(q[:3], dq[:3], ddq[:3], state)


def test_a_momentum_alone(case):
    rng, n = np.random.default_rng(3), len(case.readings.q)
    J = np.eye(3) + 0.1 * rng.normal(size=(n, 3, 3))
    still, start = rng.normal(size=(n, 3)), rng.normal(size=3)
    rate, slope = rate_of_momentum(J, still, start, PERIOD_s)
    eta = oracle.integrate_momentum(J, still, start, PERIOD_s)
    same(rate, np.einsum("nij,nj->ni", J, eta) - still)
    nothing = np.zeros((n, 3, 0))
    same(slope, J @ oracle.integrate_sensitivity(rate, eta, J, nothing, np.eye(3), PERIOD_s))


@pytest.mark.parametrize("seed", CASES)
def test_a_base_on_an_air_bearing(seed):
    given = on_table(random_case(seed), seed)
    found, (states, a, along) = predict_run(*given), of_table.predict(*given)
    same(found.velocity, states, SOLVED)
    same(np.column_stack([found.base.specific_force[:, :2], found.base.acceleration[:, 2]]), a, SOLVED)
    same(found.base.along, along, SOLVED)


def test_a_base_on_an_air_bearing_that_runs_away_is_no_number_from_there():
    run, _, *given = on_table(random_case(3), 3)
    found = predict_run(run, np.array([0.0, 0.0, 1e3 - 1e-9]), *given).velocity
    assert np.isfinite(found[0]).all()
    assert np.isnan(found[-1]).all()


@pytest.mark.parametrize("bodies", [0, 1, 3])
def test_errors_of_bodies_in_the_drawing(bodies):
    rng = np.random.default_rng(4)
    drawn, at = rng.normal(size=(bodies, 10)), rng.permutation(45)[: 10 * bodies]
    drawn[1:2] = 0.0  # a body without mass
    state = 0.3 * rng.normal(size=45)
    same(Scaled(at, drawn).linear(state), of_errors.linear(at, drawn, state))


@pytest.mark.parametrize("seed", CASES)
def test_evidence_of_each_suspect_alone_and_beside_another(seed):
    suspects, sigma, (x, P) = random_suspects(seed)
    bank, (M, slope, own) = Bank(suspects, sigma), of_evidence.alone(suspects, sigma, x, P)
    for first in range(-1, len(suspects)):
        found = bank.alone((x, P))
        if first >= 0:
            found = bank.alone((x, P), first, found.of(first))
        for k, columns in enumerate(own):
            given = M[columns, columns], slope[columns]
            if first >= 0 and k != first:
                given = of_evidence.beside(M, slope, own[first], columns)
            if k != first:
                nats, sizes, inverse = of_evidence.by_eigenvalues(*given)
                root, g = found.of(k)
                same(root @ root.T, inverse, SOLVED)
                same(root @ g, sizes, 1e-9)
                assert found.nats[k] == pytest.approx(nats, rel=1e-9, abs=1e-9)
                assert found.sizes[k] == pytest.approx(np.sqrt((sizes**2).mean()))


def test_what_is_no_covariance_has_no_evidence_without_bounds():
    rng, size = np.random.default_rng(5), 30
    suspect, P = Suspect("all", np.arange(size), np.eye(size), 0.1), rng.normal(size=(size, size))
    M = 2.0 * np.eye(size) - (P + P.T)
    assert np.linalg.eigvalsh(M).min() < -5.0
    found = Bank([suspect], np.ones(size)).alone((np.ones(size), P + P.T))
    assert 0.0 < np.abs(found.out).max() < np.linalg.norm(M)


@pytest.mark.parametrize("seed", range(6))
def test_evidence_of_steps_and_of_each_two(seed):
    rng, suspects = np.random.default_rng(seed), random_suspects(seed)[0]
    widths = [one.along.shape[1] for one in suspects]
    seen, d = rng.normal(size=(30, sum(widths))), 5.0 * rng.normal(size=sum(widths))
    steps = Changed(np.zeros((1, len(d))), d, seen.T @ seen, np.zeros((1, 0)))
    odds = np.log([one.odds for one in suspects])
    for farthest in (np.inf, 0.4):
        for ours, theirs in zip(
            steps.evidence(suspects, farthest), of_evidence.pairs(widths, d, steps.J, odds, farthest), strict=True
        ):
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
        assert (np.array(widths) == 1).sum() >= 3


@pytest.mark.parametrize("kernel", [smoothing.SPLINE, kinematics.smoother_kernel()])
@pytest.mark.parametrize("seed", range(6))
def test_samples_under_a_kernel(seed, kernel):
    rng, width_s, gap_s = np.random.default_rng(seed), 0.1, 0.0015
    times = np.cumsum(rng.uniform(0.0002, 0.0005, 1500) * rng.choice([1.0, 8.0], 1500, p=[0.997, 0.003]))
    at = rng.uniform(times[0] - 0.02, times[-1] + 0.02, 40)
    window = smoothing.SmoothingWindow(times, at, width_s, gap_s, kernel)
    low, high = times.searchsorted(at - 0.5 * width_s, "right"), times.searchsorted(at + 0.5 * width_s, "left")
    u, cell, whole = of_smoothing.under(times, at, low, high, width_s, gap_s * (1.0 + 1e-9))
    assert (window.valid == (whole & (high - low >= 5))).all()
    assert 0 < window.valid.sum() < len(at)
    u, cell = u[window.valid], cell[window.valid]
    if kernel is smoothing.SPLINE:
        shapes = of_smoothing.pieces(smoothing.SPLINE_TOGETHER.coefficients, u)
        np.testing.assert_array_equal(smoothing.SPLINE_TOGETHER(u), shapes)
        assert not smoothing.SPLINE_TOGETHER(np.array([-0.51, 0.6, np.inf, np.nan])).any()
    else:
        shapes = np.stack([part(u) for part in (smoothing.BASE, *kernel.parts)])
    true = of_smoothing.weights(u, cell, shapes, kernel.of_powers, width_s)
    found, _ = window.weights
    near = 1e-11
    for ours, theirs in zip(found[window.valid].swapaxes(0, 1), true.swapaxes(0, 1), strict=True):
        same(ours, theirs, near)
    assert not found[~window.valid].any()
    columns = rng.normal(size=(len(times), 3))
    for orders in ((0, 1, 2), (0, 1), (2, 0)):
        values, gains = window.stacked(columns, orders)
        for order, value, gain in zip(orders, values, gains, strict=True):
            rows = true[:, order]
            seen = [columns[first : first + rows.shape[1]] for first in low[window.valid]]
            sums = np.array([row[: len(own)] @ own for row, own in zip(rows, seen, strict=True)])
            same(value[window.valid], sums, near)
            same(gain[window.valid], np.linalg.norm(rows, axis=1), near)
            assert np.isnan(value[~window.valid]).all()
            assert np.isnan(gain[~window.valid]).all()


def test_sine_cosine_and_exponential_are_those_of_the_processor_to_rounding():
    angles = np.concatenate([np.linspace(-30.0, 30.0, 4001), 10.0 ** np.linspace(-12, 6, 4001), [0.0, -0.0]])
    vehicle = random_case(0).vehicle
    q = np.zeros((len(angles), len(vehicle.joints)))
    q[:, 0] = angles
    R = chain_motion(vehicle, q, 0.0 * q, 0.0 * q).axes[:, 1]
    same(R, oracle_chain(vehicle, q, 0.0 * q, 0.0 * q).axes[:, 1], 1e-15)
    assert np.isnan(chain_motion(vehicle, q[:1] + 2e6, q[:1], q[:1]).axes[0, 1]).all()


def test_the_library_says_what_it_is():
    key, compiler = library.identity()
    assert (key, bool(compiler)) == (build.key(), True)
