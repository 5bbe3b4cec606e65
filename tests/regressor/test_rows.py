"""``Y chi ==`` MuJoCo's inverse dynamics, for random vehicles and motions, base rows included."""

import numpy as np
import pytest

from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError, UnknownFrameError, UrdfError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.regressor.friction import Motor
from onboard.regressor.rows import (
    BaseMotion,
    RowModel,
    base_force_rows,
    base_moment_rows,
    base_motion,
    joint_torque_row,
    load_cell_row,
)
from tests.dynamics.mujoco_twin import inverse_dynamics, random_vehicle, to_mujoco, to_urdf

A_BILLIONTH = 1e-9

VEHICLES = [
    (["revolute"], None),
    (["revolute", "fixed"], None),
    (["prismatic", "revolute"], None),
    (["continuous", "fixed", "fixed"], None),
    (["revolute", "prismatic", "revolute", "fixed"], None),
    (["revolute", "revolute", "fixed", "revolute", "continuous"], [0, 1, 0, 1, 3]),  # branches
    (["fixed"], None),
]


def random_motion(rng, vehicle, n=6):
    nj = len(vehicle.joints)
    q, dq, ddq = rng.uniform(-2, 2, (n, nj)), rng.normal(size=(n, nj)), rng.normal(size=(n, nj)) * 3
    return q, dq, ddq, BaseMotion(rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), rng.normal(size=(n, 3)) * 2)


def by_name(vehicle, links):
    """Our joint order in MuJoCo's (depth first in ours as well, but children in the order of names)."""
    moving = [link for link in links[1:] if link.kind != "fixed"]
    order = depth_first(links)
    mujoco_order = [links[k].name for k in order if links[k] in moving]
    return [mujoco_order.index(joint.name.removeprefix("joint_")) for joint in vehicle.joints]


def depth_first(links, index=0):
    found = [index]
    for k, link in enumerate(links):
        if link.parent == index:
            found += depth_first(links, k)
    return found


@pytest.mark.parametrize(("kinds", "parents"), VEHICLES)
def test_every_row_equals_mujoco(rng, kinds, parents):
    links = random_vehicle(rng, kinds, parents)
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(BaseKind.PRESCRIBED, "base", links[-1].name))
    model = to_mujoco(links)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    cells = [load_cell_row(f"m_{k.name}", f"joint_{k.name}", axis, "moment", 0.04) for k in links[1:]]
    cells += [load_cell_row(f"f_{k.name}", k.name, axis, "force") for k in links[1:]]
    torques = [joint_torque_row(vehicle, joint.name) for joint in vehicle.joints]
    rows = RowModel(vehicle, [*base_force_rows(vehicle), *base_moment_rows(vehicle), *torques, *cells])
    q, dq, ddq, motion = random_motion(rng, vehicle)
    found = rows.regressor(q, dq, ddq, motion) @ rows.chi
    place = by_name(vehicle, links)
    nj = len(vehicle.joints)
    for k in range(q.shape[0]):
        mq, mdq, mddq = (np.empty(nj) for _ in range(3))
        mq[place], mdq[place], mddq[place] = q[k], dq[k], ddq[k]
        # Whatever velocity the base has: nothing may depend on it.
        w, dw, f = motion.rate_rad_s[k], motion.acceleration_rad_s2[k], motion.specific_force_m_s2[k]
        force, moment, tau, sensors = inverse_dynamics(model, mq, mdq, mddq, rng.normal(size=3), w, f, dw)
        scale = max(np.abs(force).max(), np.abs(moment).max())
        np.testing.assert_allclose(found[k, :3], force, atol=A_BILLIONTH * scale)
        np.testing.assert_allclose(found[k, 3:6], moment, atol=A_BILLIONTH * scale)
        np.testing.assert_allclose(found[k, 6 : 6 + nj], tau[place], atol=A_BILLIONTH * scale)
        # MuJoCo's force and torque sensors at each child's frame.
        wrenches = sensors.reshape(-1, 2, 3)
        cut = found[k, 6 + nj :]
        np.testing.assert_allclose(cut[: len(links) - 1], wrenches[:, 1] @ axis / 0.04, atol=25 * A_BILLIONTH * scale)
        np.testing.assert_allclose(cut[len(links) - 1 :], wrenches[:, 0] @ axis, atol=A_BILLIONTH * scale)


def test_columns_are_linear_in_each_links_own_parameters(rng):
    """chi of links on fixed joints stay apart: changing one link's mass changes the rows by its own column only."""
    links = random_vehicle(rng, ["revolute", "fixed"])
    spec = VehicleSpec(BaseKind.FREE, "base", "link_2")
    one = VehicleModel(to_urdf(links), spec)
    links[2].mass *= 1.5
    links[2].com = rng.uniform(-0.2, 0.2, 3)
    other = VehicleModel(to_urdf(links), spec)
    assert one.links == ("base", "link_1", "link_2")
    np.testing.assert_array_equal(one.chi[:20], other.chi[:20])
    rows = RowModel(one, [*base_force_rows(one), *base_moment_rows(one)])
    motion = random_motion(rng, one)
    Y = rows.regressor(*motion)
    change = Y[:, :, 20:] @ (other.chi[20:] - one.chi[20:])
    truth = RowModel(other, rows.rows).regressor(*motion) @ other.chi - Y @ one.chi
    np.testing.assert_allclose(change, truth, atol=1e-10)


def test_without_payload_its_columns_are_zero(rng):
    links = random_vehicle(rng, ["revolute", "fixed"])
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(BaseKind.FREE, "base", "link_2"))
    rows = RowModel(vehicle, base_force_rows(vehicle))
    motion = random_motion(rng, vehicle, 4)
    held = np.array([True, False, True, False])
    Y, always = rows.regressor(*motion, held), rows.regressor(*motion)
    np.testing.assert_array_equal(Y[held], always[held])
    assert not Y[~held][:, :, 20:].any()
    np.testing.assert_array_equal(Y[~held][:, :, :20], always[~held][:, :, :20])


def test_bias_and_friction_columns(rng):
    links = random_vehicle(rng, ["revolute", "revolute"])
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(BaseKind.PRESCRIBED, "base"))
    cell = load_cell_row("cell", "joint_link_1", (0, 0, 2), "moment")
    rows = RowModel(vehicle, [cell, joint_torque_row(vehicle, "joint_link_2")])
    assert rows.names[30:] == ("bias_cell", "Ia_joint_link_2", "Fv_joint_link_2", "Fc_joint_link_2")
    q, dq, ddq, motion = random_motion(rng, vehicle)
    Y = rows.regressor(q, dq, ddq, motion)
    np.testing.assert_array_equal(Y[:, 0, 30:], np.tile([1.0, 0, 0, 0], (6, 1)))
    np.testing.assert_array_equal(Y[:, 1, 30:], np.column_stack([np.zeros(6), ddq[:, 1], dq[:, 1], np.sign(dq[:, 1])]))
    assert rows.chi[30:].tolist() == [0.0] * 4
    given = rows.regressor(q, dq, ddq, motion, friction=np.full((6, 1), 0.25))
    np.testing.assert_array_equal(given[:, 1, 33], np.full(6, 0.25))
    np.testing.assert_array_equal(given[..., :33], Y[..., :33])
    plain = RowModel(vehicle, [load_cell_row("c", "link_1", (0, 0, 1), "force", bias=False)])
    assert len(plain.names) == 30


def test_a_motor_of_two_joints_acts_on_both_by_virtual_work(rng):
    vehicle = VehicleModel(to_urdf(random_vehicle(rng, ["revolute"] * 3)), VehicleSpec(BaseKind.FIXED, "base"))
    torques = [joint_torque_row(vehicle, joint.name) for joint in vehicle.joints]
    wrist = Motor("wrist", (("joint_link_2", 2.0), ("joint_link_3", -1.0)))
    rows = RowModel(vehicle, torques, motors=[wrist])
    assert rows.names[-3:] == ("Ia_wrist", "Fv_wrist", "Fc_wrist")
    q, dq, ddq, motion = random_motion(rng, vehicle)
    ours = rows.regressor(q, dq, ddq, motion)[..., -3:]
    rate, up = 2.0 * dq[:, 1] - dq[:, 2], 2.0 * ddq[:, 1] - ddq[:, 2]
    of_motor = np.column_stack([up, rate, np.sign(rate)])
    for row, ratio in enumerate((0.0, 2.0, -1.0)):
        np.testing.assert_allclose(ours[:, row], ratio * of_motor, rtol=1e-12, atol=1e-12)
    with pytest.raises(UnknownFrameError, match="turns with 'elbow'"):
        RowModel(vehicle, torques, motors=[Motor("wrist", (("elbow", 1.0), ("joint_link_3", 1.0)))])


def test_a_fold_is_the_regressor_times_its_matrix(rng):
    """Columns that are combined before they are made, with and without payload, link columns and extra ones."""
    links = random_vehicle(rng, ["revolute", "prismatic", "fixed"])
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(BaseKind.PRESCRIBED, "base", links[-1].name))
    cells = [
        load_cell_row("a", links[1].name, (1, 2, 3), "moment"),
        load_cell_row("b", links[-1].name, (1, 0, 0), "force"),
    ]
    torques = [joint_torque_row(vehicle, joint.name) for joint in vehicle.joints]
    rows = RowModel(vehicle, [cells[0], *base_force_rows(vehicle), *torques, cells[1]], zero_force=True)
    q, dq, ddq, motion = random_motion(rng, vehicle)
    held = np.array([True, False, True, True, False, False])
    mix = rng.normal(size=(len(rows.names), 4))
    whole = rows.regressor(q, dq, ddq, motion, held)
    np.testing.assert_allclose(rows.regressor(q, dq, ddq, motion, held, fold=rows.fold(mix)), whole @ mix, atol=1e-11)


@pytest.mark.parametrize(("kinds", "parents"), VEHICLES)
def test_readings_on_a_base_that_stands_are_the_regressor_times_any_parameters(rng, kinds, parents):
    links = random_vehicle(rng, kinds, parents)
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(BaseKind.PRESCRIBED, "base", links[-1].name))
    cells = [
        load_cell_row(f"{kind}_{k.name}", k.name, (1, 2, 3), kind) for k in links[1:] for kind in ("force", "moment")
    ]
    torques = [joint_torque_row(vehicle, joint.name) for joint in vehicle.joints]
    rows = RowModel(vehicle, [cells[0], *base_force_rows(vehicle), *torques, *base_moment_rows(vehicle), *cells[1:]])
    q, dq, ddq, motion = random_motion(rng, vehicle)
    still, held = np.zeros((6, 3)), np.array([True, False, True, True, False, False])
    chi, friction = rng.normal(size=len(rows.names)), rng.uniform(-1.0, 1.0, (6, len(rows.motors)))
    chi[[name.startswith("bias") for name in rows.names]] = 0.0
    motion = BaseMotion(still, still, motion.specific_force_m_s2)
    truth = rows.regressor(q, dq, ddq, motion, held, friction=friction) @ chi
    found = rows.readings(chi, q, dq, ddq, motion.specific_force_m_s2, held, friction)
    np.testing.assert_allclose(found, truth, atol=1e-12 * np.abs(truth).max())


def test_zero_force_columns_are_the_response_to_a_wrong_specific_force(rng):
    links = random_vehicle(rng, ["revolute", "fixed"])
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(BaseKind.PRESCRIBED, "base", "link_2"))
    cell = load_cell_row("cell", "joint_link_1", (1, 2, 3), "moment")
    rows = RowModel(vehicle, [cell], zero_force=True)
    assert rows.names[-4:] == ("bias_cell", "zero_force_x", "zero_force_y", "zero_force_z")
    q, dq, ddq, motion = random_motion(rng, vehicle)
    held = np.array([True, False] * 3)
    truth = rows.regressor(q, dq, ddq, motion, held) @ rows.chi
    zero = np.array([0.3, -0.2, 0.1])
    wrong = motion._replace(specific_force_m_s2=motion.specific_force_m_s2 + zero)
    chi = rows.chi.copy()
    chi[-3:] = zero
    np.testing.assert_allclose(rows.regressor(q, dq, ddq, wrong, held) @ chi, truth, atol=1e-10)


def test_zero_force_columns_leave_coasting_rows_alone(rng):
    vehicle = rotor(rng)
    rows = RowModel(vehicle, [*base_force_rows(vehicle), *base_moment_rows(vehicle)], zero_force=True)
    Y = rows.regressor(*random_motion(rng, vehicle))
    assert not Y[:, 3:, -3:].any()
    np.testing.assert_allclose(Y[:, :3, -3:], np.tile(-0.52 * np.eye(3), (6, 1, 1)), atol=1e-12)


def test_imu_anywhere_on_the_base_gives_the_motion_of_its_origin(rng):
    """Against the second difference of the position of a point on a moving body."""
    urdf = (
        '<robot name="r"><link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link><link name="imu"/><joint name="mount" type="fixed"><parent link="base"/>'
        '<child link="imu"/><origin xyz="0.3 -0.2 0.5" rpy="0.4 -0.7 1.1"/></joint></robot>'
    )
    vehicle = VehicleModel(urdf, VehicleSpec(BaseKind.FREE, "base"))
    R, p = vehicle.pose_in_base("imu")
    w, dw, a = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3)
    h = 1e-4

    def place(t):  # of the IMU in the frame the base is in at t = 0; base origin accelerates with a, rate w + dw t
        angle = w * t + 0.5 * dw * t * t
        W = np.cross(np.eye(3), angle)  # matrix of the cross product with the angle
        return 0.5 * a * t * t + (np.eye(3) + W + 0.5 * W @ W) @ p

    at_imu = (place(h) - 2 * place(0.0) + place(-h)) / h**2
    found = base_motion(vehicle, "imu", (R.T @ w)[None], (R.T @ dw)[None], (R.T @ at_imu)[None])
    np.testing.assert_allclose(found.rate_rad_s[0], w, atol=1e-12)
    np.testing.assert_allclose(found.acceleration_rad_s2[0], dw, atol=1e-12)
    np.testing.assert_allclose(found.specific_force_m_s2[0], a, atol=1e-5)


def rotor(rng, off_axis=0.0, kind=BaseKind.FREE, joint="continuous"):
    urdf = (
        '<robot name="r"><link name="base"><inertial><origin xyz="0.01 0.02 0.03"/><mass value="0.5"/>'
        '<inertia ixx="1e-3" iyy="2e-3" izz="2.5e-3" ixy="1e-4" ixz="0" iyz="-2e-4"/></inertial></link>'
        f'<link name="wheel"><inertial><origin xyz="{off_axis} 0 0.004"/><mass value="0.02"/>'
        '<inertia ixx="1e-6" iyy="1e-6" izz="2e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="spin" type="{joint}"><parent link="base"/><child link="wheel"/>'
        '<origin xyz="0.05 0 0" rpy="0 0.3 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
        "</joint></robot>"
    )
    return VehicleModel(urdf, VehicleSpec(kind, "base"))


def test_moment_rows_of_a_free_body_with_a_balanced_rotor_are_about_its_centre_of_mass(rng):
    vehicle = rotor(rng)
    rows = base_moment_rows(vehicle)
    assert all(row.coasting for row in rows)
    model = RowModel(vehicle, [*base_force_rows(vehicle), *rows])
    q, dq, ddq, motion = random_motion(rng, vehicle)
    other = motion._replace(specific_force_m_s2=rng.normal(size=(6, 3)))
    one, two = model.regressor(q, dq, ddq, motion), model.regressor(q, dq, ddq, other)
    np.testing.assert_array_equal(one[:, 3:], two[:, 3:])  # no accelerometer in the moment rows
    assert np.abs(one[:, :3] - two[:, :3]).max() > 0.1
    still = motion._replace(specific_force_m_s2=np.zeros((6, 3)))
    about_origin = RowModel(
        rotor(rng, kind=BaseKind.PRESCRIBED), base_moment_rows(rotor(rng, kind=BaseKind.PRESCRIBED))
    )
    np.testing.assert_allclose(one[:, 3:], about_origin.regressor(q, dq, ddq, still), atol=1e-15)


@pytest.mark.parametrize(
    ("off_axis", "joint", "fixed"), [(0.0, "continuous", True), (1e-4, "continuous", False), (0.0, "prismatic", False)]
)
def test_only_balanced_rotors_keep_the_centre_of_mass(rng, off_axis, joint, fixed):
    vehicle = rotor(rng, off_axis, joint=joint)
    assert vehicle.centre_of_mass_is_fixed() is fixed
    assert all(row.coasting is fixed for row in base_moment_rows(vehicle))


def test_torque_free_spin_of_a_gyrostat_has_zero_moment_rows(rng):
    """Integrate Euler's equations with a spinning rotor by small steps; the rows at the true parameters vanish."""
    vehicle = rotor(rng)
    model = RowModel(vehicle, base_moment_rows(vehicle))
    J, axis = 2e-6, np.array([np.sin(0.3), 0.0, np.cos(0.3)])
    I_c = np.diag([2e-3, 3e-3, 4e-3]) + 1e-4 * (np.ones((3, 3)) - np.eye(3))  # all of it, rotor locked
    spin, dspin = 300.0, 2000.0
    w = np.array([1.0, -2.0, 3.0])
    h = I_c @ w + J * spin * axis
    dw = np.linalg.solve(I_c, -np.cross(w, h) - J * dspin * axis)
    chi = np.zeros(20)
    disc = np.array([[1e-6, 0, 0], [0, 1e-6, 0], [0, 0, 2e-6]])
    R = np.array([[np.cos(0.3), 0, np.sin(0.3)], [0, 1, 0], [-np.sin(0.3), 0, np.cos(0.3)]])
    body = I_c - R @ disc @ R.T
    chi[4:10] = [body[0, 0], body[0, 1], body[1, 1], body[0, 2], body[1, 2], body[2, 2]]
    chi[14], chi[16], chi[19] = 1e-6, 1e-6, 2e-6
    motion = BaseMotion(w[None], dw[None], np.array([[5.0, 6.0, 7.0]]))
    Y = model.regressor([[0.7]], [[spin]], [[dspin]], motion)
    np.testing.assert_allclose(Y[0] @ chi, 0.0, atol=1e-12)


def test_bad_signals_are_named(rng):
    links = random_vehicle(rng, ["revolute"])
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(BaseKind.FREE, "base"))
    rows = RowModel(vehicle, base_force_rows(vehicle))
    q, dq, ddq, motion = random_motion(rng, vehicle)
    with pytest.raises(SignalError, match="same number of ticks"):
        rows.regressor(q[:-1], dq[:-1], ddq[:-1], motion)
    with pytest.raises(SignalError, match="finite"):
        rows.regressor(q * np.nan, dq, ddq, motion)
    with pytest.raises(SignalError, match="flags"):
        rows.regressor(q, dq, ddq, motion, np.ones(5, bool))
    with pytest.raises(SignalError, match=r"\(n, 3\)"):
        base_motion(vehicle, "base", np.zeros((4, 3)), np.zeros((5, 3)), np.zeros((4, 3)))
    with pytest.raises(SignalError, match="axis"):
        load_cell_row("cell", "link_1", (0, 0, 0), "moment")
    with pytest.raises(SignalError, match="lever"):
        load_cell_row("cell", "link_1", (0, 0, 1), "moment", 0.0)
    with pytest.raises(SignalError, match="'moment' or 'force'"):
        load_cell_row("cell", "link_1", (0, 0, 1), "torque")


def test_bad_frames_are_named(rng):
    links = random_vehicle(rng, ["revolute"])
    urdf = to_urdf(links).replace("</robot>", "") + (
        '<link name="bare"/><joint name="bare_mount" type="fixed"><parent link="link_1"/><child link="bare"/></joint>'
        "</robot>"
    )
    vehicle = VehicleModel(urdf, VehicleSpec(BaseKind.FREE, "base"))
    with pytest.raises(UnknownFrameError, match="no link, joint or frame 'nowhere'"):
        RowModel(vehicle, [load_cell_row("cell", "nowhere", (0, 0, 1), "force")])
    with pytest.raises(UrdfError, match="nothing with mass"):
        RowModel(vehicle, [load_cell_row("cell", "bare", (0, 0, 1), "force")])
    with pytest.raises(UnknownFrameError, match="moves with a joint"):
        base_motion(vehicle, "link_1", *np.zeros((3, 4, 3)))
