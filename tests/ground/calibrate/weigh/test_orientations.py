"""Orientations as people write them, for ``heft weigh``."""

import numpy as np
import pytest

from onboard.cli import BAD_INPUT, OK
from onboard.ground.calibrate.weigh import columns, conventions, table
from onboard.ground.log.bring_in.text_rows import unbroken
from tests.ground.calibrate.weigh.test_tables import WRENCH
from tests.ground.calibrate.weigh.wrist_bench import AS_RECORDED, GRAVITY, holds, record, turn, weighed, write

pytestmark = pytest.mark.usefixtures("axes_as_they_are")  # what angles mean is chosen by fits


@pytest.mark.parametrize(
    ("header", "made", "options"),
    [
        (("roll_deg", "pitch_deg", "yaw_deg"), ("xyz", 1.0), ()),
        (("roll", "pitch", "yaw"), ("XYZ", 1.0), ()),
        (("A", "B", "C"), ("ZYX", 1.0), ()),
        (("rx", "ry", "rz"), ("rotvec", np.pi / 180.0), ()),
        pytest.param(("rx", "ry", "rz"), ("XYZ", 1.0), ("--orientation", "XYZ"), marks=pytest.mark.campaign),
        # angles about fixed axes, as roll, pitch, yaw above
        pytest.param(("euler_x", "euler_y", "euler_z"), ("xyz", 1.0), (), marks=pytest.mark.campaign),
        pytest.param(("phi", "theta", "psi"), ("ZYZ", 1.0), ("--orientation", "ZYZ"), marks=pytest.mark.campaign),
        (("tool_phi [deg]", "tool_theta [deg]", "tool_psi [deg]"), ("ZYZ", 1.0), ()),
        pytest.param(("phi", "theta", "psi"), ("xyz", 1.0), ("--orientation", "ZYX"), marks=pytest.mark.campaign),
        pytest.param(("alpha", "beta", "gamma"), ("ZYX", 1.0), ("--orientation", "ZYX"), marks=pytest.mark.campaign),
    ],
)
def test_angles(tmp_path, header, made, options):
    """Poses made by products of turns about one axis each. Of an order that is given also: test_tables."""
    order, degrees = made
    one, rng = record(9, about_z=False), np.random.default_rng(4)
    angles = np.rad2deg(rng.uniform(-np.pi, np.pi, (30, 3))) * [1.0, 0.49, 1.0]
    axes = dict(zip("xyz", np.eye(3), strict=True))
    rows = []
    for x, y, z in angles:
        turns = {name: turn(np.deg2rad(angle) * axes[name]) for name, angle in zip("xyz", (x, y, z), strict=True)}
        if order == "rotvec":
            R = turn(np.deg2rad([x, y, z]) * 0.5)
            cells = np.array([x, y, z]) * 0.5 * degrees
        elif order == "ZYZ":
            R = turn(np.deg2rad(x) * axes["z"]) @ turns["y"] @ turns["z"]
            cells = np.array([x, y, z])
        else:
            R = (
                turns["z"] @ turns["y"] @ turns["x"]
                if order in ("xyz", "ZYX")
                else turns["x"] @ turns["y"] @ turns["z"]
            )
            cells = np.array([z, y, x] if order == "ZYX" else [x, y, z])
        weight = one.true.mass_kg * one.true.mounting @ R.T @ [0.0, 0.0, -GRAVITY]
        load = np.concatenate([weight, np.cross(one.true.centre_m, weight)])
        rows.append([*cells, *(load + one.true.zero + one.true.noise * rng.normal(size=6))])
    code, answer = weighed(tmp_path, rows, *options, header=(*header, *WRENCH))
    assert code == OK
    assert all(holds(answer, one.true).values())


def test_a_rotation_matrix_by_rows(one, tmp_path):
    names = tuple(f"r{i}{j}" for i in range(1, 4) for j in range(1, 4))
    rows = np.hstack([one.R.reshape(-1, 9), one.wrench])
    for header in ((*names, *WRENCH), ()):
        meaning = columns.understood(table.read([write(tmp_path / "poses.csv", rows, header)]), columns.Units())
        np.testing.assert_array_equal(meaning.orientation.reshape(-1, 3, 3), one.R)
        np.testing.assert_array_equal(meaning.wrench, one.wrench)


def test_homogeneous_matrices(one, tmp_path):
    """By rows or by columns, named and numbered or not, in a line or in four; the unit of the wrench a number."""
    T = np.tile(np.eye(4), (len(one.R), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = one.R, np.random.default_rng(3).normal(size=(len(T), 3))
    by_rows, by_columns = T.reshape(-1, 16), T.transpose(0, 2, 1).reshape(-1, 16)
    corners = [f"T{i}{j}" for i in range(4) for j in range(4)]
    numbered = [*(f"O_T_EE[{k}]" for k in range(16)), *(f"K_F_ext_hat_K[{k}]" for k in range(6))]
    for pose, header in (
        (by_rows, ()),
        (by_columns, ()),
        (by_rows[:, :12], ()),
        (by_rows, (*corners, *WRENCH)),
        (by_columns, tuple(numbered)),
    ):
        read = table.read([write(tmp_path / "poses.csv", np.hstack([pose, one.wrench]), header)])
        meaning = columns.understood(read, columns.Units("1e-3", "2"))
        np.testing.assert_allclose(meaning.orientation.reshape(-1, 3, 3), one.R, atol=1e-12)
        np.testing.assert_allclose(meaning.wrench, one.wrench * np.repeat([1e-3, 2.0], 3), rtol=1e-12)
    stacked = write(tmp_path / "stacked.txt", T.reshape(-1, 4), (), " ,")
    read = table.read([stacked, write(tmp_path / "wrench.txt", one.wrench, (), " ")])
    np.testing.assert_allclose(columns.understood(read, columns.Units()).orientation.reshape(-1, 3, 3), one.R)
    assert read.lines[:2] == (1, 5)


def test_lists_in_cells_and_matrices_as_they_are_printed(one, tmp_path):
    """Of pandas, NumPy and bags: in quotes or not, in a line or in three, with names or without."""

    def shown(values, between=", "):
        return f"[{between.join(repr(float(value)) for value in values)}]"

    def printed(R):
        return "[" + "\n ".join(shown(row, " ") for row in R) + "]"

    q, w = one.rows[:, :4], one.wrench
    poses = [
        ["pose,wrench", *(f'"{shown([1, 2, 3, *a])}","{shown(b)}"' for a, b in zip(q, w, strict=True))],
        ["R,ft_sensor", *(f'"{printed(a)}","{shown(b, "  ")}"' for a, b in zip(one.R, w, strict=True))],
        ["t,ori,force,torque", *(f"0.1,{shown(a)},{shown(b[:3])},{shown(b[3:])}" for a, b in zip(q, w, strict=True))],
        ["t;quat;F;M", *(f"1;{shown(a)};({shown(b[:3])[1:-1]});{shown(b[3:])}" for a, b in zip(q, w, strict=True))],
        [f"{printed(a)}\t{shown(b, ' ')}" for a, b in zip(one.R, w, strict=True)],
    ]
    for lines in poses:
        path = tmp_path / "poses.csv"
        path.write_text("\n".join(lines) + "\n")
        meaning = columns.understood(table.read([path]), columns.Units())
        R = next(R for _, R in conventions.rotations(meaning))
        np.testing.assert_allclose(R, one.R, atol=1e-9)
        np.testing.assert_allclose(meaning.wrench, w, rtol=1e-12)
    for text in (
        "\n".join(map(printed, one.R)),
        "\n".join(" ".join(map(repr, row)) for row in one.R.reshape(-1, 3).tolist()),
    ):
        (tmp_path / "R.txt").write_text(text)
        read = table.read([tmp_path / "R.txt", write(tmp_path / "wrench.txt", w, (), " ")])
        assert read.lines[:2] == (1, 4)
        np.testing.assert_allclose(columns.understood(read, columns.Units()).orientation.reshape(-1, 3, 3), one.R)
    broken = ["a [N m],b[0],c", "1,[2, 3", " 4],5", "(0.1"]
    assert list(unbroken(broken)) == ["a [N m],b[0],c", "1,[2\0\0" + "3\0" + "4],5", "", "(0.1"]
    noted = ["t,note", "0,(1 st try", *(f"{n},[{n}; 5]" for n in range(20)), "1,[2"]  # a bracket that nothing closes
    assert list(unbroken(noted)) == [line.replace("; ", "\0\0") for line in noted]


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        (("imu_ax", "imu_ay", "imu_az"), 1.0),
        (tuple(f"linear_acceleration.{axis}" for axis in "xyz"), 1.0 / GRAVITY),
        (("g_x", "g_y", "g_z"), -1.0),
    ],
)
def test_where_up_is_by_an_accelerometer(tmp_path, names, unit):
    """Beside the sensor, turned against it; or gravity in its axes."""
    rng, rows, one = np.random.default_rng(8), [], record(9)
    for _ in range(30):
        up = turn(rng.uniform(-2.0, 2.0, 3))[2] * GRAVITY
        weight = -one.true.mass_kg * one.true.mounting @ up
        load = np.concatenate([weight, np.cross(one.true.centre_m, weight)])
        rows.append(
            [*(unit * (up + rng.normal(size=3) * 0.02)), *(load + one.true.zero + one.true.noise * rng.normal(size=6))]
        )
    rows[3][:3] = [2.0 * value for value in rows[3][:3]]  # in motion
    code, answer = weighed(tmp_path, rows, header=(*names, *WRENCH))
    assert code == OK
    assert all(holds(answer, one.true).values())
    assert answer["rows"]["bad"] == 1
    rates = [[*rng.normal(size=3), *row[3:]] for row in rows]
    assert weighed(tmp_path, rates, header=("gx", "gy", "gz", *WRENCH))[0] == BAD_INPUT


def test_joint_angles_and_a_urdf(one, tmp_path, capsys):
    """A shoulder about z, an elbow about y, a wrist about x: the product of the three turns."""
    rng = np.random.default_rng(5)
    q = rng.uniform(-3.0, 3.0, (30, 3))
    joints = "".join(
        f'<link name="l{k}"/><joint name="{name}" type="revolute"><parent link="{"base" if not k else f"l{k - 1}"}"/>'
        f'<child link="l{k}"/><axis xyz="{axis}"/><limit lower="-3.1" upper="3.1" effort="1" velocity="1"/></joint>'
        for k, (name, axis) in enumerate((("shoulder", "0 0 1"), ("elbow", "0 1 0"), ("wrist", "1 0 0")))
    )
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(f'<robot name="arm"><link name="base"/>{joints}</robot>', encoding="utf-8")
    rows = []
    for a, b, c in q:
        R = turn([0.0, 0.0, a]) @ turn([0.0, b, 0.0]) @ turn([c, 0.0, 0.0])
        weight = one.true.mass_kg * R.T @ [0.0, 0.0, -GRAVITY]
        load = np.concatenate([weight, np.cross(one.true.centre_m, weight)])
        rows.append([a, b, c, *(load + one.true.zero + one.true.noise * rng.normal(size=6))])
    for names in (("shoulder", "elbow", "wrist"), ("q1", "q2", "q3"), ()):
        code, answer = weighed(
            tmp_path, rows, *AS_RECORDED, "--urdf", str(urdf), header=(*names, *WRENCH) if names else ()
        )
        assert code == OK
        assert all(holds(answer, one.true).values())
    assert weighed(tmp_path, rows, "--urdf", str(urdf), "--link", "hand", header=(*names, *WRENCH))[0] == BAD_INPUT
    capsys.readouterr()
    assert (
        weighed(tmp_path, rows, "--urdf", str(urdf), header=("shoulder", "elbow", "gripper", *WRENCH))[0] == BAD_INPUT
    )
    assert "no columns for the joints wrist among shoulder, elbow, gripper" in capsys.readouterr().err


def test_readings_without_noise_and_three_angles_without_names(tmp_path):
    """Of a simulation, say; with ``--orientation`` the three columns before the wrench are angles."""
    rng, rows = np.random.default_rng(7), []
    for _ in range(20):
        v = rng.uniform(-2.0, 2.0, 3)
        weight = 2.0 * turn(v).T @ [0.0, 0.0, -GRAVITY]
        rows.append([0.4, 0.5, 0.6, *v, *weight, *np.cross([0.01, -0.02, 0.08], weight)])
    assert weighed(tmp_path, rows, header=())[0] == BAD_INPUT
    code, answer = weighed(tmp_path, rows, "--orientation", "rotvec", header=())
    assert code == OK
    assert answer["quantities"][0]["value"] == pytest.approx(2.0, rel=1e-4)
    assert answer["quantities"][3]["value"] == pytest.approx(0.08, rel=1e-3)
