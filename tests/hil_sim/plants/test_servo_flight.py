"""Servos, stops, air, ejection and a moving base against hand mechanics: Newton-Euler of one hinge, typed here.

The hand side works in frame 3 (x along the arm, z the joint axis) with the numbers of tables 4.5 and 4.6.
"""

import mujoco
import numpy as np
import pytest

from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.plants.world import NotYetComputedError
from hil_sim.scenario.tables import ScenarioError
from tests.hil_sim.plants import rocket

ARM_kg, TIP_kg = 0.23313, 0.06627
ARM_COM_m = np.array([39.75, 1.41, 5.00]) * 1e-3
TIP_COM_m = np.array([155.7 + 16.4, -13.91, 0.0]) * 1e-3
ARM_I_kg_m2 = 1e-9 * np.array(
    [[52080.30, 7130.97, -38230.98], [7130.97, 6.99e5, 1744.05], [-38230.98, 1744.05, 7.33e5]]
)
TIP_I_kg_m2 = 1e-9 * np.diag([5978.90, 4389.61, 5978.90])
ZZ_ARM_kg_m2 = 1.101823e-3  # 7.33e5 + 233.13 (39.75^2 + 1.41^2) g mm^2
ZZ_BOTH_kg_m2 = 3.083437e-3  # + 5978.9 + 66.27 (172.1^2 + 13.91^2)
JOINT_m = np.array([0.1161 * np.cos(np.deg2rad(-55.4)), 0.1161 * np.sin(np.deg2rad(-55.4)), 0.101])
IMU_m = np.array([0.080, -0.040, 0.020])
R_plate_imu = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # columns: x_0, z_0, -y_0
STEP_S = 5e-4


def flown(seed: int = 7, **overrides) -> rocket.History:
    return rocket.history(rocket.plant(seed, **overrides))


def joint_acceleration(seen: rocket.History) -> np.ndarray:
    """(n - 2,) at rows 1..n-2."""
    return np.diff(seen.angle_rad, 2) / STEP_S**2


def parallel_axis(mass_kg, com_m, inertia_kg_m2):
    return inertia_kg_m2 + mass_kg * (com_m @ com_m * np.eye(3) - np.outer(com_m, com_m))


def hand_moment(seen: rocket.History, with_tip: bool) -> np.ndarray:
    """Moment about the joint axis the flange must exert, rows 1..n-2 (n - 2,): Newton-Euler about the joint."""
    I_O = parallel_axis(ARM_kg, ARM_COM_m, ARM_I_kg_m2)
    mc = ARM_kg * ARM_COM_m
    if with_tip:
        I_O = I_O + parallel_axis(TIP_kg, TIP_COM_m, TIP_I_kg_m2)
        mc = mc + TIP_kg * TIP_COM_m
    rows = slice(1, len(seen.angle_rad) - 1)
    alpha0 = seen.angular_accel_rad_s2[rows]
    w0 = seen.angular_rate_half_rad_s[rows] + 0.5 * STEP_S * alpha0
    aJ = seen.origin_accel_m_s2[rows] + np.cross(alpha0, JOINT_m) + np.cross(w0, np.cross(w0, JOINT_m))
    q, ddq = seen.angle_rad[rows], joint_acceleration(seen)
    dq = (seen.angle_rad[2:] - seen.angle_rad[:-2]) / (2 * STEP_S)
    c, s = np.cos(q + np.deg2rad(-55.4)), np.sin(q + np.deg2rad(-55.4))

    def to_3(v):
        return np.stack([c * v[:, 0] + s * v[:, 1], -s * v[:, 0] + c * v[:, 1], v[:, 2]], axis=1)

    z = np.array([0.0, 0.0, 1.0])
    w3 = to_3(w0) + dq[:, None] * z
    alpha3 = to_3(alpha0) + ddq[:, None] * z + dq[:, None] * np.cross(to_3(w0), z)
    moment = alpha3 @ I_O.T + np.cross(w3, w3 @ I_O.T) + np.cross(mc, to_3(aJ))
    return moment[:, 2]


# ---------------------------------------------------------------- bodies


@pytest.mark.parametrize(("with_tip", "zz"), [(True, ZZ_BOTH_kg_m2), (False, ZZ_ARM_kg_m2)])
def test_mujoco_inertia_about_the_joint_is_the_parallel_axis_number(with_tip, zz) -> None:
    world = rocket.plant(sequence=[rocket.HOLD] if with_tip else [rocket.EJECT, rocket.HOLD])
    world.advance(1e9)
    model, data = world.flight.model, world.flight.data
    column = np.zeros(model.nv)
    mujoco.mj_mulM(model, data, column, np.eye(model.nv)[6])
    assert column[6] - model.dof_armature[6] == pytest.approx(zz, rel=1e-6)
    assert model.dof_armature[6] == 0.010


def test_a_payload_in_the_shape_of_its_link_is_made_within_what_is_stated_of_that() -> None:
    told = rocket.scenario().as_built["tip_mass"]
    assert (told.density_relative, told.centre_mm, told.inertia_relative, told.place_mm) == (0.015, 1.0, 0.1, 0.25)
    plants = [VehiclePlant(rocket.scenario(sequence=[rocket.HOLD]), np.random.default_rng(seed)) for seed in range(10)]
    masses = np.array([one.payload.mass_kg for one in plants])
    assert 0.005 < np.std(masses / TIP_kg) < 0.03
    off = np.array([one.payload.centre_of_mass_m - [0.0, -0.01391, 0.0] for one in plants])
    assert 0.5e-3 < off.std() < 1.5e-3
    moments = np.array([one.payload.inertia_kg_m2[2, 2] / one.payload.mass_kg * TIP_kg for one in plants])
    assert 0.05 < np.std(moments / TIP_I_kg_m2[2, 2]) < 0.3
    again = VehiclePlant(rocket.scenario(sequence=[rocket.HOLD]), np.random.default_rng(3))
    assert again.payload.mass_kg == masses[3]
    with pytest.raises(ScenarioError, match="give it place_mm alone"):
        VehiclePlant(rocket.scenario(payload={"size_mm": [10.0, 10.0, 10.0]}), np.random.default_rng(3))


def test_a_denser_part_keeps_its_radius_of_gyration() -> None:
    exact = rocket.AS_DRAWN["as_built"]
    dense = {"as_built": exact | {name: exact[name] | {"density_relative": 0.015} for name in exact}}
    plants = [
        VehiclePlant(rocket.scenario(**dense, sequence=[rocket.HOLD]), np.random.default_rng(seed))
        for seed in range(10)
    ]
    for parts, mass_kg, moment in (
        ([one.bodies["arm"] for one in plants], ARM_kg, ARM_I_kg_m2[2, 2]),
        ([one.payload for one in plants], TIP_kg, TIP_I_kg_m2[2, 2]),
    ):
        masses = np.array([part.mass_kg for part in parts])
        assert 0.005 < np.std(masses / mass_kg) < 0.03
        moments = np.array([part.inertia_kg_m2[2, 2] for part in parts])
        np.testing.assert_allclose(moments / masses, moment / mass_kg, rtol=1e-4)


# ---------------------------------------------------------------- what the sensors feel


def test_load_cell_reads_inertia_times_acceleration_when_the_base_is_still() -> None:
    seen = flown(**rocket.STILL, sequence=[rocket.HOLD, rocket.SWEEP])
    ddq = joint_acceleration(seen)
    assert np.abs(ddq).max() > 6.0
    np.testing.assert_allclose(seen.moment_n_m[1:-1], ZZ_BOTH_kg_m2 * ddq, atol=2e-8)


@pytest.mark.parametrize("with_tip", [True, False])
def test_arm_feels_the_base_motion(with_tip) -> None:
    """Coning, vibration and a sweep at once; the moment is Newton-Euler's within 2 uN m of some 10 mN m."""
    sequence = [rocket.HOLD, rocket.SWEEP] if with_tip else [rocket.EJECT, rocket.SWEEP]
    seen = flown(**rocket.NO_AIR, ejection={"velocity_m_s": [0.0, 0.0, 0.0]}, sequence=sequence)
    moment, expected = seen.moment_n_m[1:-1], hand_moment(seen, with_tip)
    base_part = expected - (ZZ_BOTH_kg_m2 if with_tip else ZZ_ARM_kg_m2) * joint_acceleration(seen)
    assert base_part.std() > 3e-4  # the base's share is not small
    two_micronewton_metres = 2e-6
    begun = 0 if with_tip else 2  # an ejection at once is in the third row
    np.testing.assert_allclose(moment[begun:], expected[begun:], atol=two_micronewton_metres)


def test_imu_feels_the_prescribed_motion() -> None:
    seen = flown(sequence=[rocket.HOLD, rocket.SWEEP])
    alpha, w_half = seen.angular_accel_rad_s2, seen.angular_rate_half_rad_s
    w = w_half + 0.5 * STEP_S * alpha
    at_imu = seen.origin_accel_m_s2 + np.cross(alpha, IMU_m) + np.cross(w, np.cross(w, IMU_m))
    one_micro_g = 1e-5
    np.testing.assert_allclose(seen.specific_force_imu_m_s2, at_imu @ R_plate_imu, atol=one_micro_g)
    np.testing.assert_allclose(seen.rate_half_imu_rad_s, w_half @ R_plate_imu, atol=1e-7)


def test_imu_on_a_pure_spin_reads_centripetal_and_the_spin_on_its_y_axis() -> None:
    seen = flown(
        **rocket.NO_AIR | rocket.NO_VIBRATION,
        coning=rocket.AT_REST["coning"] | {"spin_rad_s": 0.5, "centre_of_mass_to_base_m": [0.0, 0.0, 1.4]},
        sequence=[rocket.HOLD],
    )
    # -w^2 r of (80, -40) mm: -0.02 along x_0, +0.01 along y_0 = -z_imu; nothing along z_0 = y_imu.
    np.testing.assert_allclose(seen.specific_force_imu_m_s2[-1], [-0.02, 0.0, -0.01], atol=1e-7)
    np.testing.assert_allclose(seen.rate_half_imu_rad_s[-1], [0.0, 0.5, 0.0], atol=1e-9)


def test_friction_and_rotor_stay_on_the_motor_side_of_the_cell() -> None:
    """Servo torque minus what the drive eats is what the cell reads: (tau - friction - Ia ddq) within the ripple."""
    seen = flown(**rocket.STILL, sequence=[rocket.HOLD, rocket.SWEEP])
    rate = seen.joint_rate_half_rad_s[1:-1]
    moving = np.abs(rate) > 0.05
    assert moving.sum() > 1000
    drive = 0.25 * np.sign(rate) + 0.05 * rate + 0.010 * joint_acceleration(seen)
    left = seen.servo_torque_n_m[1:-1] - drive - seen.moment_n_m[1:-1]
    ripple_and_viscosity_half_step = 0.0205
    assert np.abs(left[moving]).max() < ripple_and_viscosity_half_step
    assert np.abs(left[moving]).max() > 0.015  # the ripple is there


def test_strokes_touch_nothing_and_follow_the_command() -> None:
    world = rocket.plant()
    seen = rocket.history(world)
    strokes = [span for span in world.program.spans if span.action == "strokes"]
    assert len(strokes) == 4
    for span in strokes:
        rows = slice(round(span.start_s / STEP_S), round(span.end_s / STEP_S))
        angle = np.rad2deg(seen.angle_rad[rows])
        assert 11.3 < angle.max() < 12.0
        assert -12.0 < angle.min() < -11.3
        command = world.program.at(STEP_S * np.arange(rows.start, rows.stop))[0][:, 0]
        assert np.abs(angle - np.rad2deg(command)).max() < 0.12  # 0.2 where the acceleration is not fed forward


# ---------------------------------------------------------------- stops, ejection, air


@pytest.mark.parametrize(("command_deg", "stop_deg", "stiffness_n_m"), [(17.5, 13.2, 25e3), (-17.5, -15.0, 400e3)])
def test_pushes_press_on_the_stops_by_the_torque_limit(command_deg, stop_deg, stiffness_n_m) -> None:
    seen = flown(**rocket.STILL, sequence=[rocket.HOLD, rocket.push(command_deg), rocket.HOLD])
    side = np.sign(command_deg)
    holding = slice(round(2.9 / STEP_S), round(3.0 / STEP_S))
    moment = side * seen.moment_n_m[holding]
    # Servo limit 1.5 N m; 0.25 N m of friction may help or hinder once the arm has stopped.
    assert 1.25 - 0.02 < moment.mean() < 1.75
    assert moment.std() < 0.01
    depth_m = side * np.tan(seen.angle_rad[holding].mean() - np.deg2rad(stop_deg)) * 0.050
    assert depth_m == pytest.approx(moment.mean() / 0.050 / stiffness_n_m, rel=0.05)
    assert np.abs(seen.moment_n_m).max() / 0.040 < 50.0  # newtons: below the cell's capacity
    assert np.abs(seen.moment_n_m[-200:]).max() < 1e-5  # and let go of
    assert np.abs(np.rad2deg(seen.angle_rad)).max() < 15.5


def test_soft_stop_is_met_before_the_hard_one() -> None:
    seen = flown(**rocket.STILL, sequence=[rocket.HOLD, rocket.push(17.5)])
    assert 13.8 < np.rad2deg(seen.angle_rad.max()) < 15.0


def test_ejection_takes_the_tip_mass_and_kicks_the_arm() -> None:
    seen = flown(**rocket.STILL, sequence=[rocket.SWEEP, rocket.EJECT, rocket.SWEEP])
    ddq, moment = joint_acceleration(seen), seen.moment_n_m[1:-1]
    start = round((0.6 * 2 + 3 * 0.65) / STEP_S)
    before, after = slice(0, start - 1), slice(start + 12, None)
    np.testing.assert_allclose(moment[before], ZZ_BOTH_kg_m2 * ddq[before], atol=2e-8)
    np.testing.assert_allclose(moment[after], ZZ_ARM_kg_m2 * ddq[after], atol=2e-8)
    during = slice(start - 1, start + 12)
    # The spring pushes the mass along -y_5 and the arm along +y at 172.1 mm: impulse m v r about the joint.
    impulse = STEP_S * (ZZ_ARM_kg_m2 * ddq[during] - moment[during]).sum()
    assert impulse == pytest.approx(TIP_kg * 0.4 * 0.1721, rel=1e-4)
    assert 10.0 < np.abs(moment[during]).max() / 0.040 < 50.0  # newtons on the cell
    jump = np.abs(np.diff(seen.joint_rate_half_rad_s[start - 2 : start + 2]))
    assert jump.max() < 0.1  # the joint's speed is carried over


def test_ejection_need_not_fall_on_a_chunk() -> None:
    odd = dict(rocket.HOLD, duration_s=0.5115)
    seen = flown(**rocket.STILL, sequence=[odd, rocket.EJECT, rocket.SWEEP])
    start = round(0.5115 / STEP_S)
    assert start % 40 != 0
    ddq, moment = joint_acceleration(seen), seen.moment_n_m[1:-1]
    np.testing.assert_allclose(moment[start + 12 :], ZZ_ARM_kg_m2 * ddq[start + 12 :], atol=2e-8)
    assert np.abs(moment[: start - 1]).max() < 1e-9
    assert np.abs(moment[start - 1 : start + 12]).max() > 0.3


def test_air_pushes_beyond_the_cell_at_the_centre_of_pressure() -> None:
    """The cell reads Newton-Euler minus the drag's moment, 85 mm out, proportional to dynamic pressure."""
    air = {"reference_s": 2.0, "pressure_Pa": 2.0 / 0.011}
    seen = flown(air=air, sequence=[rocket.HOLD, rocket.SWEEP])
    rows = slice(1, len(seen.angle_rad) - 1)
    q = seen.angle_rad[rows] + np.deg2rad(-55.4)
    force = 0.0024 * seen.pressure_pa[rows, None] * seen.wind[rows]
    drag_moment = 0.085 * (np.cos(q) * force[:, 1] - np.sin(q) * force[:, 0])
    expected = hand_moment(seen, with_tip=True) - drag_moment
    assert np.abs(drag_moment).max() > 0.01
    angle_foreseen_for_one_chunk = 1e-4  # N m: 0.5 N x 85 mm x what the angle departs from a straight line in 20 ms
    np.testing.assert_allclose(seen.moment_n_m[rows], expected, atol=angle_foreseen_for_one_chunk)
    inboard = seen.origin_accel_m_s2[rows]
    assert np.linalg.norm(inboard, axis=1)[-500:].mean() > 2.0  # the IMU sees the rocket decelerate


# ---------------------------------------------------------------- running it


def test_history_does_not_hang_on_how_it_was_advanced() -> None:
    whole, halting = (
        rocket.plant(3, sequence=[rocket.HOLD, rocket.SWEEP, rocket.EJECT]),
        rocket.plant(3, sequence=[rocket.HOLD, rocket.SWEEP, rocket.EJECT]),
    )
    whole.advance(1e9)
    for time_s in np.arange(0.0, 10.0, 0.00713):
        halting.advance(time_s)
    assert halting.count == whole.count == whole.rows
    for a, b in zip(whole.rows_true, halting.rows_true, strict=True):
        assert a.tobytes() == b.tobytes()


def test_plant_knows_what_it_has_not_computed() -> None:
    world = rocket.plant(3, sequence=[rocket.HOLD])
    with pytest.raises(NotYetComputedError, match="advance the mission first"):
        world.require(0.0)
    world.advance(0.5)
    world.require(0.5)
    with pytest.raises(NotYetComputedError):
        world.require(0.6)
    world.advance(1e9)
    world.require(1e9)
