"""Errors of instruments in the identifier: scales, delays, drifts and biases widen the interval by their effect."""

import numpy as np
import pytest

from onboard.dynamics.model.errors import SignalError
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.stated_errors.considered import Considered, columns, misread_noise
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.prior import prior_root
from onboard.regressor.rows import base_motion
from onboard.regressor.signals import SignalNoise
from tests.identification.rows import rocksat_flight


def test_regressor_noise_is_what_biases_first_moments(rng):
    _, _, base, _ = rocksat_flight.setup()
    signals, held, _ = rocksat_flight.flight(rng)
    with_noise, without = rocksat_flight.identifier(), rocksat_flight.identifier()
    rocksat_flight.feed(with_noise, signals, held)
    rocksat_flight.feed(without, signals._replace(noise=None), held)
    index = base.names.index("MX_arm")
    truth = 0.23313 * 0.03975
    assert without.estimate().mean[index] < 0.9 * truth
    assert with_noise.estimate().mean[index] == pytest.approx(truth, rel=0.08)


def test_an_accelerometer_zero_passes_for_inertia_unless_it_has_its_columns(rng):
    """0.15 m/s^2 (15 mg) of zero: a false gravity, which turns with the joint as the sweep's own torque does."""
    signals, held, scale = rocksat_flight.flight(rng)
    zero = np.array([0.15, 0.0, 0.0])
    wrong = signals.motion._replace(specific_force_m_s2=signals.motion.specific_force_m_s2 + zero)
    signals = signals._replace(motion=wrong)
    with_columns, without = rocksat_flight.identifier(zero_force=True), rocksat_flight.identifier()
    for who in (with_columns, without):
        rocksat_flight.feed(who, signals, held)
    truth = scale * rocksat_flight.TRUTH_KG["m_arm"]
    each = (rocksat_flight.by_name(who.estimate())["m_arm"].value for who in (with_columns, without))
    right, false = (value / truth - 1 for value in each)
    assert abs(right) < 0.006
    assert abs(false) > 2 * abs(right)
    estimate = with_columns.estimate()
    found = dict(zip(estimate.names, zip(estimate.mean, estimate.sigma, strict=True), strict=True))
    mean, sigma = found["zero_force_x"]
    assert mean == pytest.approx(0.15, abs=3 * sigma)
    assert sigma < 0.03


def test_what_is_taken_for_exact_is_the_limit_of_a_small_sigma(rng):
    """A zero sigma moves the arm's columns to the other side; the noise of its motion goes with them."""
    _, model, _, _ = rocksat_flight.setup()
    signals, held, _ = rocksat_flight.flight(rng)
    found = []
    for relative in (0.0, 1e-5):
        links = {"plate": 1.0, "arm": relative, "tip_mass": 1.0}
        sigma = prior_root(model, links, {"bias_load_cell": 1.0})
        base = base_parameters(model, np.random.default_rng(0), known=~sigma.any(axis=1))
        one = Identifier(model, base, sigma, 5 * rocksat_flight.WIDTH_S, (), rocksat_flight.SCALE, imu_frame="imu_base")
        rocksat_flight.feed(one, signals, held)
        found.append(one.estimate())
    assert set(found[0].names) < set(found[1].names)
    assert not any("_arm" in name for name in found[0].names)
    for name in ("ZZ_tip_mass_R", "bias_load_cell"):
        exact, close = (one.mean[one.names.index(name)] for one in found)
        assert exact == pytest.approx(close, rel=2e-3), name
        exact, close = (one.sigma[one.names.index(name)] for one in found)
        assert exact == pytest.approx(close, rel=0.1), name


def test_the_scale_does_not_average_out(rng):
    signals, held, _ = rocksat_flight.flight(rng)
    with_scale, without = rocksat_flight.identifier(), rocksat_flight.identifier(considered=())
    for who in (with_scale, without):
        rocksat_flight.feed(who, signals, held)
    wide, narrow = (
        rocksat_flight.by_name(with_scale.estimate())["m_arm"],
        rocksat_flight.by_name(without.estimate())["m_arm"],
    )
    assert wide.value == pytest.approx(narrow.value)
    assert wide.sigma**2 - narrow.sigma**2 == pytest.approx((rocksat_flight.SCALE_SIGMA * wide.value) ** 2, rel=0.1)


def test_a_delay_is_considered_by_the_rate_of_the_reading(rng):
    signals, held, _ = rocksat_flight.flight(rng)
    signals = signals._replace(noise=None)
    delay = (Considered("delay", "load_cell", "delay", 1e-3),)
    who = rocksat_flight.identifier(considered=delay)
    rocksat_flight.feed(who, signals, held, step=5)
    late = rocksat_flight.identifier(considered=())
    rocksat_flight.feed(late, signals._replace(measured=signals.measured - 1e-3 * signals.measured_rate), held, step=5)
    on_time = rocksat_flight.identifier(considered=())
    rocksat_flight.feed(on_time, signals, held, step=5)
    moved = late.rls.solve().mean - on_time.rls.solve().mean
    sensitivity = who.rls.solve().sensitivity[:, 0] * 1e-3
    assert np.abs(moved).max() > 1e-6
    np.testing.assert_allclose(moved, sensitivity, rtol=1e-6, atol=1e-12)
    with pytest.raises(SignalError, match="rate"):
        rocksat_flight.feed(
            rocksat_flight.identifier(considered=delay), signals._replace(measured_rate=None), held, step=5
        )


@pytest.mark.parametrize("since_boot_s", [0.0, 1e5])
def test_a_drift_of_a_cells_zero_is_considered_whenever_the_computer_was_started(rng, since_boot_s):
    signals, held, _ = rocksat_flight.flight(rng)
    signals = signals._replace(noise=None, time_s=signals.time_s + since_boot_s)
    who = rocksat_flight.identifier(
        considered=(Considered("drift", "load_cell", "drift", 1e-3, "load_cell zero_drift_N_s"),)
    )
    rocksat_flight.feed(who, signals, held, step=5)
    since_start_s = signals.time_s - signals.time_s[0]
    drifting, steady = rocksat_flight.identifier(considered=()), rocksat_flight.identifier(considered=())
    rocksat_flight.feed(
        drifting, signals._replace(measured=signals.measured + 1e-3 * since_start_s[:, None]), held, step=5
    )
    rocksat_flight.feed(steady, signals, held, step=5)
    zz = rocksat_flight.setup()[3][0].weights
    moved = zz @ (drifting.rls.solve().mean - steady.rls.solve().mean)
    assert abs(moved) > 1e-9
    assert zz @ who.rls.solve().sensitivity[:, 0] * 1e-3 == pytest.approx(moved, rel=1e-3)
    assert who.considered[0].stated == "load_cell zero_drift_N_s 0.001 N/s"


def as_read(motion, gyro, accelerometer):
    """The base's motion by an IMU at its place in the URDF, its readings scaled."""
    vehicle = rocksat_flight.setup()[0]
    R, p = vehicle.pose_in_base("imu_base")
    w, dw, f = motion
    at_imu = f + np.cross(dw, p) + np.cross(w, np.cross(w, p))
    return base_motion(vehicle, "imu_base", gyro * w @ R, gyro * dw @ R, accelerometer * at_imu @ R)


@pytest.mark.parametrize(
    ("effect", "row"), [("joint_scale", "joint_1"), ("gyro_scale", "imu_base"), ("accelerometer_scale", "imu_base")]
)
def test_a_scale_of_the_motion_moves_the_estimate_by_what_the_interval_allows(rng, effect, row):
    """Signals of a sensor that reads 1 % more: the estimate moves by one of the sigmas of a scale known to 1 %."""
    signals, held, _ = rocksat_flight.flight(rng)
    who, other = rocksat_flight.identifier((Considered("scale", row, effect, 0.01),)), rocksat_flight.identifier(())
    rocksat_flight.feed(who, signals, held)
    scaled = {
        "joint_scale": lambda s: s._replace(q=1.01 * s.q, dq=1.01 * s.dq, ddq=1.01 * s.ddq),
        "gyro_scale": lambda s: s._replace(motion=as_read(s.motion, 1.01, 1.0)),
        "accelerometer_scale": lambda s: s._replace(motion=as_read(s.motion, 1.0, 1.01)),
    }[effect](signals)
    rocksat_flight.feed(other, scaled, held)
    moved = other.block_jackknife().mean - who.block_jackknife().mean
    sensitivity = 0.01 * who.rls.solve().sensitivity[:, 0]
    zz = rocksat_flight.setup()[3][0].weights
    assert abs(zz @ moved) == pytest.approx(abs(zz @ sensitivity), rel=0.05, abs=1e-7)


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize(("effect", "sensor"), [("gyro_bias", 0), ("accelerometer_bias", 1)])
def test_a_bias_of_the_imu_is_considered_as_it_changes_the_rows(rng, effect, sensor, axis):
    """Along the arm, axis 1, neither changes the moment about the joint that the cell reads."""
    signals, held, _ = rocksat_flight.flight(rng)
    who, at = rocksat_flight.identifier(()), np.arange(20, held.size, 40)
    mean, bias = who.base.value(who.model.chi), 1e-3 * np.eye(3)[axis]
    R, p = rocksat_flight.setup()[0].pose_in_base("imu_base")
    w, dw, f = signals.motion
    at_imu = f + np.cross(dw, p) + np.cross(w, np.cross(w, p))
    read = [w @ R, dw @ R, at_imu @ R]
    read[2 * sensor] = read[2 * sensor] + bias
    biased = signals._replace(motion=base_motion(rocksat_flight.setup()[0], "imu_base", *read))
    before, after = (who.errors.regressors([one], at, held)[0] @ [*mean, 1.0] for one in (signals, biased))
    cause = Considered("bias", "imu_base", effect, 0.01, axis=axis)
    use = np.ones(before.shape, np.bool_)
    p = len(who.base.names)
    D = columns([cause], who.model, signals, at, use, held, p, lambda of: who.errors.regressors(of, at, held))
    assert D is not None
    C = D @ [*mean, 1.0]
    np.testing.assert_allclose(C[:, 0], ((before - after) / 1e-3)[use], rtol=1e-6, atol=1e-9)
    assert np.abs(C).max() > 1e-3


@pytest.mark.parametrize(
    ("effect", "axis"),
    [
        ("joint_scale", None),
        ("gyro_scale", None),
        ("gyro_scale", 1),
        ("gyro_misalignment", 1),
        ("accelerometer_scale", 0),
        ("accelerometer_misalignment", 2),
    ],
)
def test_noise_of_a_signal_is_noise_in_what_an_error_of_its_reading_does(rng, effect, axis):
    """By differences, in signals of which rows are linear: acceleration of the joint and the base, specific force."""
    signals, held, _ = rocksat_flight.flight(rng)
    who, at = rocksat_flight.identifier(()), np.array([held.size // 2])
    joint, mean, p = who.model.vehicle.joints[0].name, who.base.value(who.model.chi), len(who.base.names)
    cause = Considered("error", joint if effect == "joint_scale" else "imu_base", effect, 0.01, axis=axis)
    use = np.ones((1, len(who.model.rows)), np.bool_)

    def done(of):
        D = columns([cause], who.model, of, at, use, held, p, lambda each: who.errors.regressors(each, at, held))
        assert D is not None
        return D[:, 0] @ [*mean, 1.0]

    R, place = rocksat_flight.setup()[0].pose_in_base("imu_base")
    w, dw, f = signals.motion
    read = [w @ R, dw @ R, (f + np.cross(dw, place) + np.cross(w, np.cross(w, place))) @ R]
    noisy = [signals._replace(ddq=signals.ddq + 1e-3)]
    for kind in (1, 2):
        for each in np.eye(3):
            parts = [value + 1e-3 * each * (kind == n) for n, value in enumerate(read)]
            noisy.append(signals._replace(motion=base_motion(rocksat_flight.setup()[0], "imu_base", *parts)))
    n = len(signals.time_s)
    spread = SignalNoise(*[np.full((n, 1), 1e-3)] * 3, *[np.full((n, 3), 1e-3)] * 3)
    changes, _ = who._noise.changes(signals, spread, at, held)
    expected = misread_noise([cause], [joint])[0] @ (changes[0] @ [*mean, -1.0]).T  # (s, rows)
    found = np.array([done(one) - done(signals) for one in noisy])
    of_joint = effect == "joint_scale"  # an angle multiplies the others' noise, too
    found, expected = (found[:1], expected[2:3]) if of_joint else (found, expected[[2, *range(6, 12)]])
    assert np.abs(found).max() > 1e-6
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-9)


def test_a_gain_of_the_recording_with_the_payload_moves_its_rows_alone(rng):
    signals, held, _ = rocksat_flight.flight(rng)
    who, at = rocksat_flight.identifier(()), np.arange(20, held.size, 40)
    name = who.model.rows[0].name
    use, p = np.ones((at.size, len(who.model.rows)), np.bool_), len(who.base.names)
    D = columns([Considered("gain", name, "held_scale", 0.03)], who.model, signals, at, use, held, p, lambda of: of)
    assert D is not None
    own = np.zeros(use.shape)
    own[:, 0] = signals.measured[at, 0] * held[at]
    assert 0 < np.count_nonzero(own) < at.size
    np.testing.assert_array_equal(D[:, 0, -1], own[use])
    assert not D[:, 0, :-1].any()


def test_friction_that_differs_with_the_payload_is_a_share_of_its_column_there(rng):
    signals, held, _ = rocksat_flight.flight(rng)
    who, at = rocksat_flight.identifier(()), np.arange(20, held.size, 40)
    use, p, number = np.ones((at.size, len(who.model.rows)), np.bool_), len(who.base.names), 1
    warmed, made = Considered("Fv", "", "held_friction", 0.2, axis=number), who.errors.regressors([signals], at, held)
    D = columns([warmed], who.model, signals, at, use, held, p, lambda of: who.errors.regressors(of, at, held))
    assert D is not None
    own = np.where(held[at, None], made[0, ..., number], 0.0)
    assert 0 < np.count_nonzero(own) < np.count_nonzero(made[0, ..., number])
    np.testing.assert_array_equal(D[:, 0, number], own[use])
    assert not np.delete(D[:, 0], number, axis=1).any()


def test_a_bias_acts_on_the_body_that_was_found_not_on_the_drawn(rng):
    """A constant error of the specific force times a first moment: both are unknown."""
    signals, held, _ = rocksat_flight.flight(rng)
    who, at = rocksat_flight.identifier(()), np.arange(20, held.size, 40)
    heavier = 1.5 * who.base.value(who.model.chi)
    use = np.ones((at.size, len(who.model.rows)), np.bool_)
    f = signals.motion.specific_force_m_s2
    biased = signals._replace(motion=signals.motion._replace(specific_force_m_s2=f + np.array([1e-3, 0.0, 0.0])))
    before, after = (who.errors.regressors([one], at, held)[0] @ [*heavier, 1.0] for one in (signals, biased))
    names, rows = [*who.base.names[1:], "zero_force_x"], np.zeros((np.count_nonzero(use), len(who.base.names)))
    found = who.errors.biased(rows.copy(), names, (signals, at, use, held), heavier, who.rls)
    assert not found[:, :-1].any()
    assert not who.errors.biased(rows, names, (signals, at, use, held), None, who.rls).any()
    np.testing.assert_allclose(found[:, -1], ((before - after) / 1e-3)[use], rtol=1e-6, atol=1e-9)


def test_noise_of_rows_is_that_of_the_body_that_was_found(rng):
    """Noise of the motion times ten times the body: ten times the sigma, of rows with little else."""
    signals, held, _ = rocksat_flight.flight(rng)
    weight = []
    for size in (10.0, 100.0):
        who = rocksat_flight.identifier(zero_force=True)
        who.about = size * who.base.value(who.model.chi)
        rocksat_flight.feed(who, signals._replace(sigma=0.0 * signals.sigma + 1e-9), held)
        weight.append(np.sqrt(np.trace(who.seen.total()[:5, :5])))
    assert weight[0] == pytest.approx(10.0 * weight[1], rel=0.2)
