"""Each calibration on readings of a bench whose truth is known, and on benches that went wrong."""

import numpy as np
import pytest

from bench.true_flights.free_flyer import BASE
from hil_sim.plants import bench
from onboard import config
from onboard.estimation.calibration.bifilar import Suspension
from onboard.estimation.errors import CalibrationError
from onboard.ground.calibrate.balance import Rig, calibrate_balance
from onboard.ground.calibrate.bifilar import calibrate_bifilar
from onboard.ground.calibrate.encoder import Stops, calibrate_encoder
from onboard.ground.calibrate.imu import ImuOptions, calibrate_imu
from onboard.ground.calibrate.load_cell import HungMasses, calibrate_load_cell
from onboard.ground.calibrate.place import Gravity, place
from onboard.ground.calibrate.readings import LogSpan, Readings, steps

PLACE = place(bench.LATITUDE_deg)
EVERY = 10  # rows of a bench in a sample: 200 Hz
E_ACCEL = np.array([[1.02, 0.01, -0.015], [0.004, 0.985, 0.01], [-0.01, 0.006, 1.012]])
E_GYRO = np.array([[0.98, -0.01, 0.012], [0.006, 1.018, -0.008], [0.01, -0.004, 0.99]])
BIAS_ACCEL, BIAS_GYRO = np.array([0.3, -0.2, 0.4]), np.array([0.05, -0.03, 0.02])
RIG = Rig.model_validate(
    {
        "orientation": [
            {"up": u, "pivot_m": p, "hinge": h, "support_m": s, "push": u}
            for u, p, h, s in (
                ((0, 0, 1), (-0.025, 0, -0.205), (0, 1, 0), (0.22, 0, -0.205)),
                ((0, 0, 1), (0, -0.025, -0.205), (1, 0, 0), (0, 0.22, -0.205)),
                ((0, 0, -1), (-0.025, 0, 0.205), (0, 1, 0), (0.22, 0, 0.205)),
                ((0, 0, -1), (0, 0.025, 0.205), (1, 0, 0), (0, -0.22, 0.205)),
                ((1, 0, 0), (-0.225, 0, -0.025), (0, 1, 0), (-0.225, 0, 0.2)),
                ((0, 1, 0), (0, -0.225, -0.025), (1, 0, 0), (0, -0.225, 0.2)),
            )
        ]
    }
)


@pytest.fixture(scope="module")
def vehicle():
    return config.named("dymaflex")


def read_of(name, values, resolution, usable=None):
    n = len(values)
    good = np.ones(n, bool) if usable is None else usable
    return Readings(name, 100.0, 5e-3 * np.arange(n), values, good, np.full(values.shape[1], resolution), [])


def imu_readings(rng, signals, calibrated=False):
    w, f = signals.rate_rad_s[::EVERY], signals.specific_force_m_s2[::EVERY]
    if not calibrated:
        w, f = w @ E_GYRO.T + BIAS_GYRO, f @ E_ACCEL.T + BIAS_ACCEL
    noise = rng.standard_normal((len(w), 6)) * np.repeat([1e-3, 0.03], 3)
    return read_of("imu_base", np.hstack([w, f]) + noise, 1e-4)


@pytest.fixture(scope="module")
def table():
    rng = np.random.default_rng(4)
    return imu_readings(rng, bench.turntable(rng, rest_s=4.0, turn_s=4.0))


def test_an_imu_by_six_positions_and_turns(vehicle, table):
    found, _ = calibrate_imu(table, vehicle, "imu_base", ImuOptions(PLACE))
    truth = [*E_ACCEL.ravel(), *BIAS_ACCEL, *E_GYRO.ravel(), *BIAS_GYRO]
    z = np.array([(one.value - true) / one.sigma for one, true in zip(found.found, truth, strict=True)])
    assert np.abs(z).max() < 4.0
    assert np.sqrt(np.mean(z**2)) < 1.4
    scales = [one for one in found.found if one.name.endswith(("matrix xx", "matrix yy", "matrix zz"))]
    assert max(one.sigma for one in scales) < 5e-4  # of a part that was 2 % off
    keys = {(*one.table, one.key) for one in found.changes}
    assert ("estimation", "imu_prior", "gyro_scale") in keys
    other, _ = calibrate_imu(table, vehicle, "imu_2", ImuOptions(PLACE))
    assert all(one.table == ("device", "imu_2") for one in other.changes)  # the prior is of the base's IMU


def test_the_cross_axis_is_that_of_the_calibration_from_then_on(vehicle, table):
    found, _ = calibrate_imu(table, vehicle, "imu_base", ImuOptions(PLACE))
    changes = {one.key: float(one.value) for one in found.changes if one.table == ("estimation", "imu_prior")}
    for sensor in ("gyro", "accelerometer"):
        assert changes[f"{sensor}_cross_axis"] == changes[f"{sensor}_misalignment_rad"] < 1e-3


def without(read, start_s, end_s):
    keep = (read.time_s < start_s) | (read.time_s > end_s)
    return read._replace(time_s=read.time_s[keep], values=read.values[keep], usable=read.usable[keep])


def swapped(read, order):
    return read._replace(values=read.values[:, order])


def tilted(read, rad):
    """Somebody bumps the table while it lies on its second face."""
    late = (read.time_s > 25.0) & (read.time_s < 39.5)
    values = read.values.copy()
    f = values[late, 3:6]
    values[late, 3:6] = f + rad * np.cross([0.0, 1.0, 0.0], f)
    return read._replace(values=values)


@pytest.mark.parametrize(
    ("spoil", "options", "why"),
    [
        (lambda r: without(r, 80.0, 200.0), {}, r"no position with \+z, -z up"),
        (lambda r: swapped(r, [1, 0, 2, 3, 4, 5]), {}, "right-handed"),
        (lambda r: swapped(r, [0, 1, 2, 4, 3, 5]), {}, "right-handed"),
        (lambda r: r._replace(values=r.values * [1, 1, -1, 1, 1, 1]), {}, "right-handed"),
        (lambda r: r._replace(values=r.values * [1, 1, 1, 0.1, 0.1, 0.1]), {}, r"a scale of 0\.0"),
        (lambda r: tilted(r, 0.02), {}, "position .* sigmas off the others"),
        (lambda r: r, {"turn_rad": np.deg2rad(250.0)}, "no multiple of 250 deg"),
        (lambda r: without(r, 5.0, 6.5), {}, "samples are missing in the turn"),
        (lambda r: r._replace(usable=(r.time_s < 5.0) | (r.time_s > 5.1)), {}, "saturated in the turn"),
        (lambda r: r._replace(values=r.values + np.sin(9.0 * r.time_s)[:, None]), {}, "still nowhere"),
        (
            lambda r: swapped(r, [0, 1, 2, 3, 4, 5])._replace(values=r.values[:, [0, 1, 2, 3, 3, 5]]),
            {},
            "lies on no face",
        ),
    ],
)
def test_a_bad_run_of_the_table_is_refused(vehicle, table, spoil, options, why):
    with pytest.raises(CalibrationError, match=why):
        calibrate_imu(spoil(table), vehicle, "imu_base", ImuOptions(PLACE)._replace(**options))


def test_gravity_that_is_not_known_widens_the_scales(vehicle, table):
    known, _ = calibrate_imu(table, vehicle, "imu_base", ImuOptions(PLACE))
    unknown, _ = calibrate_imu(table, vehicle, "imu_base", ImuOptions(place(None)))
    assert unknown.found[0].sigma > 3.0 * known.found[0].sigma
    assert abs(unknown.found[0].value - E_ACCEL[0, 0]) < 3.0 * unknown.found[0].sigma
    with pytest.raises(ValueError, match="no place on Earth"):
        place(91.0)


def test_the_allan_deviation_gives_the_noise(vehicle):
    rng = np.random.default_rng(6)
    read = imu_readings(rng, bench.turntable(rng, rest_s=4.0, turn_s=4.0, long_rest_s=90.0))
    found, allan = calibrate_imu(read, vehicle, "imu_base", ImuOptions(PLACE, allan=True))
    noise = {one.name: one for one in found.found[-2:]}
    assert noise["gyro_noise_rad_s"].value == pytest.approx(1e-3, rel=0.1)
    assert noise["accel_noise_m_s2"].value == pytest.approx(0.03, rel=0.1)
    assert allan.deviation.shape == (len(allan.tau_s), 6)
    with pytest.raises(CalibrationError, match="leave it alone for 60 s"):
        calibrate_imu(without(read, 135.0, 400.0), vehicle, "imu_base", ImuOptions(PLACE, allan=True))


def cell_readings(rng, masses, gain=1.03, offset=0.2, sigma_kg=1e-4):
    signals = bench.masses(rng, masses, sigma_kg, None)
    force = np.clip(
        gain * signals.force_n[::EVERY] + offset + 2.5e-3 * rng.standard_normal(-(-len(signals.force_n) // EVERY)),
        -50,
        50,
    )
    return read_of("load_cell", force[:, None], 1e-3)


def test_a_load_cell_by_masses(vehicle):
    z = []
    for seed in range(12):
        read = cell_readings(np.random.default_rng(seed), (0.0, 1.0, 2.0, 0.5))
        found = calibrate_load_cell(read, vehicle, "load_cell", HungMasses((0.0, 1.0, 2.0, 0.5), 1e-4, PLACE)).found
        z.append([(found[0].value - 1.03) / found[0].sigma, (found[1].value - 0.2) / found[1].sigma])
    assert np.abs(z).max() < 3.0
    assert found[0].sigma < 1e-3


@pytest.mark.parametrize(
    ("hung", "typed", "why"),
    [
        ((0.0, 1.0, 2.0), (0.0, 1.0, 2.5), "sigmas off the line"),  # a wrong mass
        ((0.0, 2.0), (0.0, 1.0), "for a newton; check the masses"),
        ((0.0, 1.0, 5.05), (0.0, 1.0, 5.05), "overloaded"),
        ((0.0, 1.0, 2.0), (0.0, 1.0), "3 steady readings in the log, 2 masses"),
        ((0.0, 1.0, 1.0), (0.0, 1.0, 2.0), "sigmas off the line|2 steady readings"),  # the same twice
        ((0.0, 1.0, 2.0), (0.0, -1.0, 2.0), "negative"),
    ],
)
def test_masses_that_do_not_fit_are_refused(vehicle, hung, typed, why):
    read = cell_readings(np.random.default_rng(3), hung)
    with pytest.raises(CalibrationError, match=why):
        calibrate_load_cell(read, vehicle, "load_cell", HungMasses(typed, 1e-4, PLACE))


def test_a_moment_cell_gets_its_lever():
    rocksat = config.named("rocksat")
    rng = np.random.default_rng(5)
    masses = (0.0, 0.1, 0.2, 0.3)
    moment = bench.masses(rng, masses, 1e-5, 0.30).moment_n_m[::EVERY]
    force = moment / 0.0415 + 2.5e-3 * rng.standard_normal(len(moment))
    read = read_of("load_cell", force[:, None], 1e-3)
    found = calibrate_load_cell(read, rocksat, "load_cell", HungMasses(masses, 1e-5, PLACE, 0.30))
    assert abs(found.found[0].value - 0.0415) < 3.0 * found.found[0].sigma
    assert found.found[0].sigma < 1e-4
    assert {one.key for one in found.changes} == {"lever_m", "lever_sigma_m", "scale_sigma", "gain", "offset_N"}
    with pytest.raises(CalibrationError, match="a lever of"):
        calibrate_load_cell(read, rocksat, "load_cell", HungMasses(masses, 1e-5, PLACE, 0.6))
    with pytest.raises(CalibrationError, match="has no lever"):
        calibrate_load_cell(read, config.named("dymaflex"), "load_cell", HungMasses(masses, 1e-5, PLACE, 0.3))


STOPS = tuple(np.deg2rad([-150.0, 150.0, -150.0, 150.0]))


def encoder_readings(rng, gain, zero_rad):
    angle = bench.stops(rng, STOPS, 4.0).angle_rad[::EVERY]
    step = 2.0 * np.pi / 500_000
    return read_of("joint_2", (np.floor((gain * angle + zero_rad) / step) * step)[:, None], step)


@pytest.mark.parametrize(("gain", "writes"), [(1.0, False), (-1.0, True), (1.02, True)])
def test_an_encoder_by_its_stops(vehicle, gain, writes):
    read = encoder_readings(np.random.default_rng(2), gain, 0.05)
    found = calibrate_encoder(read, vehicle, "joint_2", Stops(STOPS, 3e-4))
    zero = 1_000_000 + 0.05 / (2.0 * np.pi) * 500_000
    assert abs(found.found[1].value - zero) < 3.0 * found.found[1].sigma
    written = {one.key: one.value for one in found.changes}
    assert ("gain" in written) == writes
    if writes:
        assert written["gain"] == pytest.approx(gain, rel=5e-4)


def test_stops_in_the_wrong_number_are_refused(vehicle):
    read = encoder_readings(np.random.default_rng(2), 1.0, 0.0)
    with pytest.raises(CalibrationError, match="4 steady readings in the log, 2 stops"):
        calibrate_encoder(read, vehicle, "joint_2", Stops(STOPS[:2], 3e-4))
    with pytest.raises(CalibrationError, match="counts a turn where the file has"):
        calibrate_encoder(read, vehicle, "joint_2", Stops(tuple(2 * a for a in STOPS), 3e-4))
    assert len(steps(read, [LogSpan(1.0, 3.0), LogSpan(7.0, 9.0)], 2, "stops")) == 2
    with pytest.raises(CalibrationError, match="is not in the log"):
        steps(read, [LogSpan(1.0, 3000.0)], 1, "stops")


HUNG = Suspension(23.1, 0.40, 1.80, 0.005, 1e-4, 3e-4, PLACE.gravity_m_s2)


def swing_readings(rng, **settings):
    strings = bench.Strings(0.40 + 1e-4 * rng.standard_normal(), 1.80 + 3e-4 * rng.standard_normal())
    signals = bench.bifilar(rng, BASE, strings, **settings)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # R_BS of imu_base
    signals.rate_rad_s, signals.specific_force_m_s2 = signals.rate_rad_s @ turn, signals.specific_force_m_s2 @ turn
    return imu_readings(rng, signals, calibrated=True)


def test_the_base_by_its_swings(vehicle):
    found, hangs = calibrate_bifilar(swing_readings(np.random.default_rng(1)), vehicle, "imu_base", HUNG)
    assert len(hangs) == 6
    true = BASE.inertia_kg_m2[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    six = np.array([one.value for one in found.found[:6]])
    z = (six - true) / [one.sigma for one in found.found[:6]]
    assert np.abs((six - true)[[0, 2, 5]] / true[[0, 2, 5]]).max() < 5e-3
    assert np.sqrt(np.mean(np.square(z))) < 1.5
    assert {one.table for one in found.changes} == {("link", "base"), ("estimation", "prior", "link", "base")}


# Turned about x in CI; about the others it is the same computation
@pytest.mark.parametrize(
    ("axes", "sign"),
    [((0,), 1.0), *(pytest.param((0, 1, 2), sign, marks=pytest.mark.campaign) for sign in (1.0, -1.0))],
)
def test_axes_of_the_gyro_that_are_off_are_in_the_interval(vehicle, axes, sign):
    """As the vehicle file states: products take up differences of the moments, the same in every run."""
    read = swing_readings(np.random.default_rng(1))
    true = BASE.inertia_kg_m2[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    z = []
    for turn in sign * np.eye(3)[list(axes)] * vehicle.file.estimation.imu_prior.mounting_rad:
        turned = read.values.copy()
        turned[:, :3] -= np.cross(turn, read.values[:, :3])
        found, _ = calibrate_bifilar(read._replace(values=turned), vehicle, "imu_base", HUNG)
        z.append([(one.value - t) / one.sigma for one, t in zip(found.found[:6], true, strict=True)])
    assert np.abs(z).max() < 2.0  # a 95 % interval; YY is at 1.983 by the strings drawn, +- 0.001 by the processor
    assert np.abs(np.array(z)[:, [3, 4]]).max() > 0.7  # XZ, YZ: it is what their sigma is made of
    assert any("0.0092 rad (estimation.imu_prior.mounting_rad)" in note for note in found.notes)  # with its own 3 mrad


@pytest.mark.parametrize(
    ("settings", "spoil", "why"),
    [
        ({"amplitude_rad": np.deg2rad(88.0)}, lambda r: r, "begin with less than 75 deg|no pendulum"),
        ({"drag": (400.0, 400.0)}, lambda r: r, "no pendulum|swings|does not determine"),
        ({"axes": np.eye(3)}, lambda r: r, "do not determine six elements"),
        ({}, lambda r: r._replace(values=r.values * 0.0), "no swing|still nowhere|swings"),
        ({}, lambda r: r._replace(usable=np.abs(r.values[:, 0]) < 0.5), "saturated"),
        (
            {},
            lambda r: r._replace(values=r.values + 0.3 * np.sin(2.3 * r.time_s)[:, None]),
            "several axes|nowhere",
        ),
    ],
)
def test_swings_that_are_none_are_refused(vehicle, settings, spoil, why):
    read = spoil(swing_readings(np.random.default_rng(1), **settings))
    with pytest.raises(CalibrationError, match=why):
        calibrate_bifilar(read, vehicle, "imu_base", HUNG)


def balance_readings(rng, rig):
    signals = bench.balance(rng, BASE, [one.model_dump() for one in rig.orientation])
    force = np.clip(signals.force_n[::EVERY], -50, 50)
    force = force + 2.5e-3 * rng.standard_normal(len(force))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    f = signals.specific_force_m_s2[::EVERY] @ turn
    return read_of("load_cell", force[:, None], 1e-3), read_of("imu_base", np.hstack([0 * f, f]), 1e-4)


def test_the_base_on_a_balance(vehicle):
    cell, imu = balance_readings(np.random.default_rng(8), RIG)
    found = calibrate_balance(cell, imu, vehicle, "load_cell", RIG, PLACE)
    truth = [BASE.mass_kg, *BASE.centre_of_mass_m]
    z = [(one.value - true) / one.sigma for one, true in zip(found.found, truth, strict=True)]
    assert np.abs(z).max() < 3.0
    assert max(one.sigma for one in found.found[1:]) < 3e-4
    assert "mass_kg" not in {one.key for one in found.changes}  # the file knows it better


def rig_of(*orientations):
    return RIG.model_copy(update={"orientation": list(orientations)})


def test_a_balance_that_cannot_be_is_refused(vehicle):
    cell, imu = balance_readings(np.random.default_rng(8), RIG)
    a, b, c, d, e, f = RIG.orientation
    with pytest.raises(CalibrationError, match=r"orientation 5 .* from the rig file's"):
        calibrate_balance(cell, imu, vehicle, "load_cell", rig_of(a, b, c, d, f, e), PLACE)
    with pytest.raises(CalibrationError, match="6 steady loads in the log, 5 orientations"):
        calibrate_balance(cell, imu, vehicle, "load_cell", rig_of(a, b, c, d, e), PLACE)
    flat = rig_of(a, b, a, b, a, b)
    with pytest.raises(CalibrationError, match="not determined"):
        calibrate_balance(*balance_readings(np.random.default_rng(1), flat), vehicle, "load_cell", flat, PLACE)
    heavy = rig_of(a.model_copy(update={"pivot_m": (-0.06, 0.0, -0.205)}), b, c, d, e, f)
    with pytest.raises(CalibrationError, match="overloaded"):
        calibrate_balance(*balance_readings(np.random.default_rng(1), heavy), vehicle, "load_cell", heavy, PLACE)


def test_a_device_of_another_kind_is_refused(vehicle, table):
    for call in (
        lambda: calibrate_imu(table, vehicle, "load_cell", ImuOptions(PLACE)),
        lambda: calibrate_load_cell(table, vehicle, "joint_1", HungMasses((0.0, 1.0), 1e-4, PLACE)),
        lambda: calibrate_encoder(table, vehicle, "imu_2", Stops(STOPS, 1e-3)),
        lambda: calibrate_bifilar(table, vehicle, "joint_1", HUNG),
        lambda: calibrate_balance(table, None, vehicle, "joint_1", RIG, Gravity(9.8, 1e-3)),
    ):
        with pytest.raises(CalibrationError, match=r"is a |is no IMU"):
            call()
