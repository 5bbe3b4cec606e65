"""The identifier on a RockSat-like flight: masses, intervals that cover, nothing said that the data do not hold."""

import re
from functools import cache

import numpy as np
import pytest

from onboard.config import packaged
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError, UnknownFrameError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.estimation.errors import RowError
from onboard.estimation.gates import GateReason
from onboard.estimation.recursive.memory import Memory
from onboard.estimation.smoothing import SmoothingWindow, correlation_inflation
from onboard.identification.quantities import inertia_about_joint, mass_quantities
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.stated_errors.considered import Considered, columns
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.prior import prior_root
from onboard.regressor.rows import BaseMotion, RowModel, base_motion, load_cell_row
from onboard.regressor.signals import SignalNoise, Signals

WIDTH_S, ROW_S, CELL_S, IMU_S = 0.1, 0.01, 0.005, 0.001
CELL_NOISE_N, GYRO_NOISE, ACCEL_NOISE, ENCODER_NOISE = 0.0025, 9e-4, 0.05, 4e-6
SCALE_SIGMA = 0.0035
EJECTION_S, END_S = 9.0, 18.0
TRUTH_KG = {"m_arm": 0.23313, "m_arm+m_tip_mass": 0.2994, "m_tip_mass": 0.06627}  # table 4.6


@cache
def setup(zero_force=False):
    text = packaged("rocksat").with_name("rocksat.urdf").read_text()
    vehicle = VehicleModel(text, VehicleSpec(BaseKind.PRESCRIBED, "plate", "tip_mass"))
    model = RowModel(vehicle, [load_cell_row("load_cell", "joint_1", (0, 0, 1), "moment", 0.04)], zero_force)
    base = base_parameters(model, np.random.default_rng(0))
    return vehicle, model, base, mass_quantities(model, base, "joint_1", "arm")


SCALE = (Considered("scale", "load_cell", "scale", SCALE_SIGMA),)


def identifier(considered=SCALE, zero_force=False, **options):
    _, model, base, quantities = setup(zero_force)
    links = {"plate": 1.0, "arm": 1.0, "tip_mass": 1.0}
    zeros = {f"zero_force_{axis}": 0.1 for axis in "xyz"} if zero_force else {}
    sigma = prior_root(model, links, {"bias_load_cell": 1.0} | zeros)
    return Identifier(model, base, sigma, 5 * WIDTH_S, quantities, considered, imu_frame="imu_base", **options)


def joint(t):
    """A slow and a fast sweep, twice."""
    rate = np.where(t % 9.0 < 4.5, 2 * np.pi * 0.4, 2 * np.pi * 0.9)
    return 0.21 * np.sin(rate * t), 0.21 * rate * np.cos(rate * t), -0.21 * rate**2 * np.sin(rate * t)


def rocket(t):
    """Spin with wobble and vibration, in plate axes."""
    six, seven = 2 * np.pi * 6, 2 * np.pi * 7
    w = np.column_stack([0.02 * np.sin(0.7 * t), 0.015 * np.sin(1.1 * t), 0.3 + 2e-3 * np.sin(six * t)])
    dw = np.column_stack([0.014 * np.cos(0.7 * t), 0.0165 * np.cos(1.1 * t), 2e-3 * six * np.cos(six * t)])
    f = 0.03 * np.column_stack([np.sin(seven * t), np.cos(0.8 * seven * t), np.sin(1.3 * seven * t)])
    return BaseMotion(w, dw, f + np.array([0.01, 0.02, 0.0]))


def flight(rng):
    """Noisy, smoothed signals of one flight, whether the tip mass is held, and the true scale of the cell."""
    vehicle, model, _, _ = setup()
    ts, ti = np.arange(0, END_S, CELL_S), np.arange(0, END_S, IMU_S)
    q, dq, ddq = (v[:, None] for v in joint(ts))
    chi = model.chi.copy()
    chi[-1] = 0.03  # the cell's zero, N
    scale = 1 + SCALE_SIGMA * rng.normal()
    cell = scale * (model.regressor(q, dq, ddq, rocket(ts), ts < EJECTION_S)[:, 0] @ chi)
    cell = np.round((cell + CELL_NOISE_N * rng.normal(size=ts.size)) * 1e4) / 1e4
    encoder = np.round(q * 500_000 / (2 * np.pi)) / 500_000 * 2 * np.pi
    R, p = vehicle.pose_in_base("imu_base")
    w, dw, f = rocket(ti)
    at_imu = f + np.cross(dw, p) + np.cross(w, np.cross(w, p))
    gyro = w @ R + GYRO_NOISE * rng.normal(size=w.shape)
    accel = at_imu @ R + ACCEL_NOISE * rng.normal(size=w.shape)
    at = np.arange(0.2, END_S - 0.2, ROW_S)
    at = at[(at % 4.5 > 0.2) & (at % 4.5 < 4.3)]
    slow, fast = SmoothingWindow(ts, at, WIDTH_S), SmoothingWindow(ti, at, WIDTH_S)
    inflation = correlation_inflation(WIDTH_S, ROW_S)
    load, rate = slow.apply(cell), slow.apply(cell, 1).values
    joints = [slow.apply(encoder, d) for d in range(3)]
    imu = [fast.apply(gyro), fast.apply(gyro, 1), fast.apply(accel)]
    noise = SignalNoise(
        *(np.outer(s.noise_gain, [ENCODER_NOISE]) for s in joints),
        *(np.outer(s.noise_gain, [n] * 3) for s, n in zip(imu, (GYRO_NOISE, GYRO_NOISE, ACCEL_NOISE), strict=True)),
        inflation,
    )
    motion = base_motion(vehicle, "imu_base", *(s.values for s in imu))
    sigma = (CELL_NOISE_N * inflation * load.noise_gain)[:, None]
    signals = Signals(at, *(s.values for s in joints), motion, load.values, sigma, rate, noise)
    return signals, at < EJECTION_S, scale


def part(signals, which):
    def cut(value):
        if value is None or isinstance(value, float):
            return value
        if isinstance(value, tuple):
            return type(value)(*map(cut, value))
        return value[which]

    return Signals(*map(cut, signals))


def feed(who, signals, held, excluded=None, step=5):
    flags = np.zeros(held.size, np.int64) if excluded is None else excluded
    found = [
        who.update(part(signals, slice(k, k + step)), held[k : k + step], flags[k : k + step])
        for k in range(0, held.size, step)
    ]
    return np.concatenate(found)


def by_name(estimate):
    return {quantity.name: quantity for quantity in estimate.quantities}


def test_masses_over_many_flights(rng):
    """Bars, with room: p95 errors, coverage of masses and of every base parameter."""
    _, model, base, _ = setup()
    chi = model.chi.copy()
    chi[-1] = 0.03
    truth = base.value(chi)
    errors, covered, parameters = [], [], []
    for _ in range(40):
        signals, held, _ = flight(rng)
        who = identifier()
        feed(who, signals, held, step=64)
        estimate = who.estimate()
        masses = by_name(estimate)
        errors.append([masses[name].mean / kg - 1 for name, kg in TRUTH_KG.items()])
        covered.append([masses[name].low <= kg <= masses[name].high for name, kg in TRUTH_KG.items()])
        parameters.append((estimate.low <= truth) & (truth <= estimate.high))
    p95 = np.percentile(np.abs(errors), 95, axis=0)
    assert (p95 < [0.015, 0.010, 0.015]).all(), p95
    assert np.abs(np.mean(errors, axis=0)).max() < 0.002
    assert (np.mean(covered, axis=0) >= 0.9).all()
    assert (np.mean(parameters, axis=0) >= 0.85).all()


def test_before_the_ejection_only_the_inertia_of_both_is_told(rng):
    signals, held, _ = flight(rng)
    who = identifier()
    feed(who, part(signals, held), held[held])
    masses = by_name(who.estimate())
    for name in TRUTH_KG:
        assert not masses[name].supported
        assert np.isnan([masses[name].mean, masses[name].sigma, masses[name].low, masses[name].high]).all()
        assert "not determined" in masses[name].note
    assert masses["ZZ_joint_1_R_held"].mean == pytest.approx(3.0794e-3, rel=0.015)
    assert not masses["ZZ_joint_1_R_released"].supported


def test_before_any_row_nothing_is_told():
    estimate = identifier().estimate()
    assert not estimate.supported.any()
    assert estimate.supported.size > 0
    assert len(estimate.quantities) > 0
    assert not any(quantity.supported for quantity in estimate.quantities)
    assert estimate.rows_used == 0


def test_regressor_noise_is_what_biases_first_moments(rng):
    _, _, base, _ = setup()
    signals, held, _ = flight(rng)
    with_noise, without = identifier(), identifier()
    feed(with_noise, signals, held)
    feed(without, signals._replace(noise=None), held)
    index = base.names.index("MX_arm")
    truth = 0.23313 * 0.03975
    assert without.estimate().mean[index] < 0.9 * truth
    assert with_noise.estimate().mean[index] == pytest.approx(truth, rel=0.08)


def test_an_accelerometer_zero_passes_for_inertia_unless_it_has_its_columns(rng):
    """0.15 m/s^2 (15 mg) of zero: a false gravity, which turns with the joint as the sweep's own torque does."""
    signals, held, scale = flight(rng)
    zero = np.array([0.15, 0.0, 0.0])
    wrong = signals.motion._replace(specific_force_m_s2=signals.motion.specific_force_m_s2 + zero)
    signals = signals._replace(motion=wrong)
    with_columns, without = identifier(zero_force=True), identifier()
    for who in (with_columns, without):
        feed(who, signals, held)
    truth = scale * TRUTH_KG["m_arm"]
    right, false = (by_name(who.estimate())["m_arm"].mean / truth - 1 for who in (with_columns, without))
    assert abs(right) < 0.006
    assert abs(false) > 2 * abs(right)
    estimate = with_columns.estimate()
    found = dict(zip(estimate.names, zip(estimate.mean, estimate.sigma, strict=True), strict=True))
    mean, sigma = found["zero_force_x"]
    assert mean == pytest.approx(0.15, abs=3 * sigma)
    assert sigma < 0.03


def test_a_row_weighs_what_its_motion_is_known_to(rng):
    """A reading without any error of its own: the row's sigma is what the motion's noise makes of the masses."""
    signals, held, _ = flight(rng)
    exact = signals._replace(sigma=np.zeros_like(signals.sigma))
    who = identifier(considered=())
    found = feed(who, exact, held)
    assert np.count_nonzero(found == 0) > 0.9 * held.size
    assert by_name(who.estimate())["ZZ_joint_1_R_held"].mean == pytest.approx(3.0794e-3, rel=0.015)
    # with a perfect accelerometer, what is left is angular acceleration: 3.08e-3 kg m^2 over 40 mm, held
    noise = signals.noise._replace(specific_force=np.zeros_like(signals.noise.specific_force))
    exact = exact._replace(noise=noise)
    expected = 3.08e-3 / 0.04 * np.hypot(noise.ddq[100, 0], noise.acceleration[100, 0]) * noise.inflation
    one = identifier(considered=())
    one.rls.prior(one.base.value(one.model.chi), np.full(len(one.base.names), 1e-9))  # sure of the drawing
    one.update(part(exact, slice(100, 101)), held[100:101], np.zeros(1, np.int64))
    row = one.recursion.blocks.normal[0]
    index = one.base.names.index("ZZ_arm")
    regressor = (signals.ddq[100, 0] + signals.motion.acceleration_rad_s2[100, 2]) / 0.04
    doubt = np.hypot(noise.ddq[100, 0], noise.acceleration[100, 0]) / 0.04
    assert row[index, index] == pytest.approx((regressor**2 - doubt**2) / expected**2, rel=0.3)  # and lever arms
    with pytest.raises(RowError, match="sigma"):
        feed(identifier(considered=()), exact._replace(noise=None), held)


def test_batches_of_any_size_agree(rng):
    signals, held, _ = flight(rng)
    one, two = identifier(), identifier()
    feed(one, signals, held, step=5)
    feed(two, signals, held, step=17)
    assert len(one.estimate().quantities) > 0
    for a, b in zip(one.estimate().quantities, two.estimate().quantities, strict=True):
        assert a.mean == pytest.approx(b.mean, rel=1e-3)


def test_an_answer_takes_two_jackknifes_one_for_its_findings(rng, monkeypatch):
    signals, held, _ = flight(rng)
    who, taken, real = identifier(), [], Identifier.block_jackknife
    feed(who, signals, held)
    monkeypatch.setattr(Identifier, "block_jackknife", lambda self, *how: taken.append(how) or real(self, *how))
    who.findings()
    who.estimate()
    assert len(taken) == 2


def test_a_window_forgets_what_was_held_and_an_identifier_for_ever_does_not(rng):
    """4 s after the ejection a window of 3 s holds rows without the payload only: it cannot tell the payload."""
    signals, held, _ = flight(rng)
    short, whole = identifier(memory=Memory(window_s=3.0)), identifier()
    for one in (short, whole):
        feed(one, part(signals, signals.time_s < EJECTION_S + 4.0), held[signals.time_s < EJECTION_S + 4.0])
    assert 0.8 * 300 < short.rls.rows <= 350  # rows at 100 Hz, some of them between sweeps
    assert by_name(whole.estimate())["m_tip_mass"].supported
    told = by_name(short.estimate())
    assert told["m_arm"].supported
    assert not told["m_tip_mass"].supported


def test_what_is_taken_for_exact_is_the_limit_of_a_small_sigma(rng):
    """A zero sigma moves the arm's columns to the other side; the noise of its motion goes with them."""
    _, model, _, _ = setup()
    signals, held, _ = flight(rng)
    found = []
    for relative in (0.0, 1e-5):
        links = {"plate": 1.0, "arm": relative, "tip_mass": 1.0}
        sigma = prior_root(model, links, {"bias_load_cell": 1.0})
        base = base_parameters(model, np.random.default_rng(0), known=~sigma.any(axis=1))
        one = Identifier(model, base, sigma, 5 * WIDTH_S, (), SCALE, imu_frame="imu_base")
        feed(one, signals, held)
        found.append(one.estimate())
    assert set(found[0].names) < set(found[1].names)
    assert not any("_arm" in name for name in found[0].names)
    for name in ("ZZ_tip_mass_R", "bias_load_cell"):
        exact, close = (one.mean[one.names.index(name)] for one in found)
        assert exact == pytest.approx(close, rel=2e-3), name
        exact, close = (one.sigma[one.names.index(name)] for one in found)
        assert exact == pytest.approx(close, rel=0.1), name


def test_outliers_that_the_gate_lets_pass_weigh_less_with_huber(rng):
    signals, held, _ = flight(rng)
    hit = rng.random(held.size) < 0.05
    spoilt = signals._replace(measured=signals.measured + 15.0 * np.where(hit, 1.0, 0.0)[:, None] * signals.sigma)
    errors = []
    for huber in (None, 1.5):
        one, clean = identifier(huber_sigma=huber), identifier()
        feed(one, spoilt, held)
        feed(clean, signals, held)
        bias = one.base.names.index("bias_load_cell")
        errors.append(abs(one.estimate().mean[bias] - clean.estimate().mean[bias]))
    assert errors[1] < 0.6 * errors[0]


def test_the_scale_does_not_average_out(rng):
    signals, held, _ = flight(rng)
    with_scale, without = identifier(), identifier(considered=())
    for who in (with_scale, without):
        feed(who, signals, held)
    wide, narrow = by_name(with_scale.estimate())["m_arm"], by_name(without.estimate())["m_arm"]
    assert wide.mean == pytest.approx(narrow.mean)
    assert wide.sigma**2 - narrow.sigma**2 == pytest.approx((SCALE_SIGMA * wide.mean) ** 2, rel=0.1)


def test_a_delay_is_considered_by_the_rate_of_the_reading(rng):
    signals, held, _ = flight(rng)
    signals = signals._replace(noise=None)
    delay = (Considered("delay", "load_cell", "delay", 1e-3),)
    who = identifier(considered=delay)
    feed(who, signals, held)
    late = identifier(considered=())
    feed(late, signals._replace(measured=signals.measured - 1e-3 * signals.measured_rate), held)
    on_time = identifier(considered=())
    feed(on_time, signals, held)
    moved = late.rls.solve().mean - on_time.rls.solve().mean
    sensitivity = who.rls.solve().sensitivity[:, 0] * 1e-3
    assert np.abs(moved).max() > 1e-6
    np.testing.assert_allclose(moved, sensitivity, rtol=1e-6, atol=1e-12)
    with pytest.raises(SignalError, match="rate"):
        feed(identifier(considered=delay), signals._replace(measured_rate=None), held)


@pytest.mark.parametrize("since_boot_s", [0.0, 1e5])
def test_a_drift_of_a_cells_zero_is_considered_whenever_the_computer_was_started(rng, since_boot_s):
    signals, held, _ = flight(rng)
    signals = signals._replace(noise=None, time_s=signals.time_s + since_boot_s)
    who = identifier(considered=(Considered("drift", "load_cell", "drift", 1e-3, "load_cell zero_drift_N_s"),))
    feed(who, signals, held)
    since_start_s = signals.time_s - signals.time_s[0]
    drifting, steady = identifier(considered=()), identifier(considered=())
    feed(drifting, signals._replace(measured=signals.measured + 1e-3 * since_start_s[:, None]), held)
    feed(steady, signals, held)
    zz = setup()[3][0].weights
    moved = zz @ (drifting.rls.solve().mean - steady.rls.solve().mean)
    assert abs(moved) > 1e-9
    assert zz @ who.rls.solve().sensitivity[:, 0] * 1e-3 == pytest.approx(moved, rel=1e-3)
    assert who.considered[0].stated == "load_cell zero_drift_N_s 0.001 N/s"


def test_reasons_and_counts(rng):
    signals, held, _ = flight(rng)
    excluded = np.zeros(held.size, np.int64)
    excluded[:100] = GateReason.PHASE
    excluded[50:60] |= GateReason.DRAG
    measured, q, noise = signals.measured.copy(), signals.q.copy(), signals.noise.rate.copy()
    measured[300], measured[400] = np.nan, measured[400] + 20.0
    q[310], noise[320] = np.nan, np.nan
    spoiled = signals._replace(measured=measured, q=q, noise=signals.noise._replace(rate=noise))
    who = identifier()
    found = feed(who, spoiled, held, excluded)
    assert found.shape == (held.size, 1)
    assert found[0, 0] == GateReason.PHASE
    assert found[55, 0] == GateReason.PHASE | GateReason.DRAG
    assert (found[[300, 310, 320], 0] == GateReason.GAP).all()
    assert found[400, 0] == GateReason.RESIDUAL
    estimate = who.estimate()
    assert estimate.refused[GateReason.PHASE] == 100
    assert estimate.refused[GateReason.DRAG] == 10
    assert estimate.refused[GateReason.GAP] == 3
    assert estimate.refused[GateReason.RESIDUAL] >= 1
    assert estimate.rows_used == np.count_nonzero(found == 0)
    assert by_name(estimate)["m_arm"].mean == pytest.approx(0.23313, rel=0.03)


def test_functionals_are_the_inertia_about_the_joint():
    vehicle, _, _, _ = setup()
    plate, arm, tip = inertia_about_joint(vehicle, "joint_1") @ vehicle.chi
    assert plate == 0.0
    # table 4.6, g mm^2: ZZ about the centre of mass and Steiner
    assert arm == pytest.approx(1e-9 * (7.33e5 + 233.13 * (39.75**2 + 1.41**2)), rel=1e-9)
    assert tip == pytest.approx(1e-9 * (5978.90 + 66.27 * (172.1**2 + 13.91**2)), rel=1e-9)


def test_impossible_set_ups_are_named():
    vehicle, model, base, _ = setup()
    with pytest.raises(UnknownFrameError, match="names row 'cell'"):
        identifier(considered=(Considered("scale", "cell", "scale", 0.1),))
    with pytest.raises(UnknownFrameError, match="forearm"):
        mass_quantities(model, base, "joint_1", "forearm")
    drawn = packaged("rocksat").with_name("rocksat.urdf").read_text()
    nothing = '<mass value="0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'
    bare = re.sub(r'<mass value="0.06627"/>\s*<inertia [^>]*/>', nothing, drawn)
    assert nothing in bare
    light = VehicleModel(bare, vehicle.spec)
    with pytest.raises(SignalError, match="no mass"):
        mass_quantities(RowModel(light, model.rows), base, "joint_1", "arm")


def test_signals_of_a_wrong_shape_are_named(rng):
    signals, held, _ = flight(rng)
    who = identifier()
    none = np.zeros(held.size, np.int64)
    with pytest.raises(SignalError, match="one each"):
        who.update(signals._replace(measured=np.repeat(signals.measured, 2, axis=1)), held, none)
    with pytest.raises(SignalError, match="one each"):
        who.update(signals, held, none[:-1])


def as_read(motion, gyro, accelerometer):
    """The base's motion by an IMU at its place in the URDF, its readings scaled."""
    vehicle = setup()[0]
    R, p = vehicle.pose_in_base("imu_base")
    w, dw, f = motion
    at_imu = f + np.cross(dw, p) + np.cross(w, np.cross(w, p))
    return base_motion(vehicle, "imu_base", gyro * w @ R, gyro * dw @ R, accelerometer * at_imu @ R)


@pytest.mark.parametrize(
    ("effect", "row"), [("joint_scale", "joint_1"), ("gyro_scale", "imu_base"), ("accelerometer_scale", "imu_base")]
)
def test_a_scale_of_the_motion_moves_the_estimate_by_what_the_interval_allows(rng, effect, row):
    """Signals of a sensor that reads 1 % more: the estimate moves by one of the sigmas of a scale known to 1 %."""
    signals, held, _ = flight(rng)
    who, other = identifier((Considered("scale", row, effect, 0.01),)), identifier(())
    feed(who, signals, held)
    scaled = {
        "joint_scale": lambda s: s._replace(q=1.01 * s.q, dq=1.01 * s.dq, ddq=1.01 * s.ddq),
        "gyro_scale": lambda s: s._replace(motion=as_read(s.motion, 1.01, 1.0)),
        "accelerometer_scale": lambda s: s._replace(motion=as_read(s.motion, 1.0, 1.01)),
    }[effect](signals)
    feed(other, scaled, held)
    moved = other.block_jackknife().mean - who.block_jackknife().mean
    sensitivity = 0.01 * who.rls.solve().sensitivity[:, 0]
    zz = setup()[3][0].weights
    assert abs(zz @ moved) == pytest.approx(abs(zz @ sensitivity), rel=0.05, abs=1e-7)


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize(("effect", "sensor"), [("gyro_bias", 0), ("accelerometer_bias", 1)])
def test_a_bias_of_the_imu_is_considered_as_it_changes_the_rows(rng, effect, sensor, axis):
    """Along the arm, axis 1, neither changes the moment about the joint that the cell reads."""
    signals, held, _ = flight(rng)
    who, at = identifier(()), np.arange(20, held.size, 40)
    mean, bias = who.base.value(who.model.chi), 1e-3 * np.eye(3)[axis]
    R, p = setup()[0].pose_in_base("imu_base")
    w, dw, f = signals.motion
    at_imu = f + np.cross(dw, p) + np.cross(w, np.cross(w, p))
    read = [w @ R, dw @ R, at_imu @ R]
    read[2 * sensor] = read[2 * sensor] + bias
    biased = signals._replace(motion=base_motion(setup()[0], "imu_base", *read))
    before, after = (who._errors.regressors([one], at, held)[0] @ [*mean, 1.0] for one in (signals, biased))
    cause = Considered("bias", "imu_base", effect, 0.01, axis=axis)
    use = np.ones(before.shape, np.bool_)
    p = len(who.base.names)
    D = columns([cause], who.model, signals, at, use, held, p, lambda of: who._errors.regressors(of, at, held))
    assert D is not None
    C = D @ [*mean, 1.0]
    np.testing.assert_allclose(C[:, 0], ((before - after) / 1e-3)[use], rtol=1e-6, atol=1e-9)
    assert np.abs(C).max() > 1e-3


def test_a_gain_of_the_recording_with_the_payload_moves_its_rows_alone(rng):
    signals, held, _ = flight(rng)
    who, at = identifier(()), np.arange(20, held.size, 40)
    name = who.model.rows[0].name
    use, p = np.ones((at.size, len(who.model.rows)), np.bool_), len(who.base.names)
    D = columns([Considered("gain", name, "held_scale", 0.03)], who.model, signals, at, use, held, p, lambda of: of)
    assert D is not None
    own = np.zeros(use.shape)
    own[:, 0] = signals.measured[at, 0] * held[at]
    assert 0 < np.count_nonzero(own) < at.size
    np.testing.assert_array_equal(D[:, 0, -1], own[use])
    assert not D[:, 0, :-1].any()


@pytest.mark.parametrize(("every", "against"), [(15, True), (25, False)])
def test_more_than_one_row_in_twenty_that_contradicts_the_others_refuses_all(rng, every, against):
    signals, held, _ = flight(rng)
    measured = signals.measured.copy()
    measured[100::every] += 20.0
    who = identifier()
    feed(who, signals._replace(measured=measured), held)
    assert any("of the rows contradict the others" in said for said in who.findings().against) == against
