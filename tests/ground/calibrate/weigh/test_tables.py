"""Tables of poses and wrenches as people write them, for ``heft weigh``."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onboard.cli import BAD_INPUT, OK, main
from onboard.ground.calibrate.weigh import columns, conventions, table
from onboard.ground.calibrate.weigh.errors import PosesError
from onboard.ground.log.bring_in.text_rows import unbroken
from tests.ground.calibrate.weigh.wrist_bench import GRAVITY, HEADER, holds, record, turn, weighed, write

pytestmark = pytest.mark.usefixtures("axes_as_they_are")  # what a table means is told by the fits of its meanings
WRENCH = HEADER[4:]


@pytest.mark.parametrize(
    ("names", "between"),
    [
        (("qw", "qx", "qy", "qz", "Fx [N]", "Fy [N]", "Fz [N]", "Tx [Nm]", "Ty [Nm]", "Tz [Nm]"), ","),
        (
            (
                "quat_w",
                "quat_x",
                "quat_y",
                "quat_z",
                "force_x",
                "force_y",
                "force_z",
                "torque_x",
                "torque_y",
                "torque_z",
            ),
            ";",
        ),
        (
            tuple(f"pose.orientation.{c}" for c in "wxyz")
            + tuple(f"wrench.{kind}.{c}" for kind in ("force", "torque") for c in "xyz"),
            "\t",
        ),
        (
            (
                "w",
                "x",
                "y",
                "z",
                *(f"{name}_mean [{'Nm' if name[0] == 'T' else 'N'}]" for name in ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")),
            ),
            ",",
        ),
        (("q0", "q1", "q2", "q3", "FX", "FY", "FZ", "MX", "MY", "MZ"), " "),
        (("q1", "q2", "q3", "q4", "Force_X", "Force_Y", "Force_Z", "Torque_X", "Torque_Y", "Torque_Z"), ","),
        ((), ","),
    ],
)
def test_names_of_columns(one, tmp_path, names, between):
    code, answer = weighed(tmp_path, one.rows, header=names, between=between)
    assert code == OK
    assert all(holds(answer, one.true).values())


@pytest.mark.parametrize("named", ["actual_TCP_{}_{}", "{}[{}]"])
@pytest.mark.parametrize("first", [0, 1])
def test_numbered_parts_of_a_pose_and_a_wrench(one, named, first):
    def understood(names, values):
        read = table.Table(tuple(names), values, tuple(range(2, len(values) + 2)), "poses.csv")
        return columns.understood(read, columns.Units())

    rows = np.hstack([np.full((len(one.rows), 3), 7.0), one.rows])
    pose, wrench = ([named.format(what, first + k) for k in range(n)] for what, n in (("pose", 7), ("force", 6)))
    meaning = understood(pose + wrench, rows)
    assert meaning.kind == "quaternion?"
    np.testing.assert_array_equal(meaning.orientation, rows[:, 3:7])
    np.testing.assert_array_equal(meaning.wrench, rows[:, 7:])
    assert understood(pose[:-1] + wrench, np.delete(rows, 6, axis=1)).kind == "angles?"
    with pytest.raises(PosesError, match="no columns of forces"):
        understood(pose + wrench[:-1], rows[:, :-1])


def test_angles_without_names_are_named_by_the_message(one, tmp_path, capsys):
    """It counts the table's own columns; what it shows can be given as it is."""
    angles = Rotation.from_matrix(one.R).as_euler("xyz", degrees=True)
    rows = np.hstack([np.full((len(angles), 2), 7.0), angles, one.rows[:, 4:]])
    assert weighed(tmp_path, rows, header=())[0] == BAD_INPUT
    said = " ".join(capsys.readouterr().err.split())
    given = said.partition("e.g. ")[2].partition(";")[0]
    assert given == "--columns=-,-,roll,pitch,yaw,fx,fy,fz,mx,my,mz"
    assert "--orientation xyz" in said
    for way in ((given,), ("--orientation", "xyz")):
        code, answer = weighed(tmp_path, rows, *way, header=())
        assert code == OK
        assert all(holds(answer, one.true).values())
    assert weighed(tmp_path, rows[:, 3:], header=())[0] == BAD_INPUT
    assert "have nine or more" in " ".join(capsys.readouterr().err.split())


def test_joints_are_no_quaternion(one, tmp_path, capsys):
    names = [*(f"q{k}" for k in range(1, 5)), *HEADER[4:]]
    assert weighed(tmp_path, one.rows * ([1.5] * 4 + [1.0] * 6), header=names)[0] == BAD_INPUT
    assert "joints with --urdf" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16", "utf-8-sig"])
def test_tables_of_other_encodings(one, tmp_path, encoding):
    path = write(tmp_path / "poses.csv", np.hstack([one.rows, one.rows[:, :1]]), (*HEADER, "gr\u00f6\u00dfe"))
    path.write_bytes(path.read_text(encoding="utf-8").encode(encoding))
    answer = tmp_path / "a.json"
    assert main(["weigh", str(path), "--json", str(answer)]) == OK
    assert all(holds(json.loads(answer.read_text(encoding="utf-8")), one.true).values())


def test_quoted_cells_thousands_and_a_spreadsheets_line(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text('sep=,\nname,qw,fx_mN\n"home, left",0.5,"-1,234.5"\n"a ""b""",1,"1,5"\nplain,0.25,12345.5\n')
    found = table.read([path])
    assert found.names == ("name", "qw", "fx_mN")
    np.testing.assert_array_equal(found.values[:, 1:], [[0.5, -1234.5], [1.0, 1.5], [0.25, 12345.5]])
    assert found.lines == (3, 4, 5)
    path.write_text("sep=;\nqw;fx\n0,5;1,25\n")
    np.testing.assert_array_equal(table.read([path]).values, [[0.5, 1.25]])
    path.write_text("sep=;\n")
    with pytest.raises(PosesError, match="no rows"):
        table.read([path])


def test_a_line_of_units_below_the_names(one, tmp_path):
    """Units that are passed over are a mass or a centre that is wrong by a factor."""
    path = write(tmp_path / "poses.csv", [("-",) * 4 + ("kgf",) * 3 + ("[N mm]",) * 3, *one.rows], HEADER)
    meaning = columns.understood(table.read([path]), columns.Units())
    np.testing.assert_allclose(meaning.wrench, one.wrench * np.repeat([9.80665, 1e-3], 3), rtol=1e-12)
    assert meaning.moments_named
    write(path, [*one.rows], [*(f"rot_{axis}" for axis in "wxyz"), *HEADER[4:]])
    assert columns.understood(table.read([path]), columns.Units()).kind == "quaternion"
    write(path, one.rows[:, 1:], [*(f"Rot_{axis} [deg]" for axis in "XYZ"), *HEADER[4:]])
    assert columns.understood(table.read([path]), columns.Units()).kind == "angles?"


def test_counts_and_readings_that_the_controller_has_compensated(one, tmp_path, capsys):
    rows = np.hstack([one.rows[:, :4], np.rint(1e3 * one.wrench)])
    assert weighed(tmp_path, rows)[0] == BAD_INPUT
    assert "are whole numbers without a unit" in " ".join(capsys.readouterr().err.split())
    code, answer = weighed(tmp_path, rows, "--force-unit", "1e-3", "--moment-unit", "1e-3")
    assert code == OK
    assert all(holds(answer, one.true).values())
    for names, said in (
        ((f"actual_TCP_force_{k}" for k in range(6)), True),
        ((f"wrench_{k}" for k in range(6)), False),
    ):
        read = table.Table((*HEADER[:4], *names), one.rows, tuple(range(len(one.rows))), "poses.csv")
        told = " ".join(columns.understood(read, columns.Units()).said)
        assert ("without the payload that the controller was told" in told) == said


def test_a_quaternion_that_is_none_is_said(one, tmp_path, capsys):
    assert weighed(tmp_path, one.rows * ([2.0] * 4 + [1.0] * 6))[0] == BAD_INPUT
    assert "or a quaternion or matrix that is no rotation" in " ".join(capsys.readouterr().err.split())


def test_columns_by_their_numbers(one, tmp_path, capsys):
    rows = np.hstack([np.arange(len(one.rows))[:, None], one.rows[:, ::-1]])
    given = ",".join(f"{name}={11 - k}" for k, name in enumerate(HEADER))
    code, answer = weighed(tmp_path, rows, "--columns", given, header=())
    assert code == OK
    assert all(holds(answer, one.true).values())
    for wrong in ("qw=12", "qw=0", "qw=x", "qw=1,qx"):
        assert weighed(tmp_path, rows, "--columns", wrong, header=())[0] == BAD_INPUT
        assert "write NAME=NUMBER" in capsys.readouterr().err


def test_two_files_decimal_commas_and_other_columns(one, tmp_path):
    rows = [[str(float(value)).replace(".", ",") for value in row] for row in one.rows]
    poses = write(tmp_path / "p.csv", [["0", *row[:4], "1,5"] for row in rows], ("t", *HEADER[:4], "speed"), ";")
    wrenches = write(tmp_path / "w.txt", [row[4:] for row in rows], WRENCH, "\t")
    answer = tmp_path / "answer.json"
    assert main(["weigh", str(poses), str(wrenches), "--json", str(answer)]) == OK
    assert all(holds(json.loads(answer.read_text(encoding="utf-8")), one.true).values())
    short = write(tmp_path / "short.txt", [row[4:] for row in rows[:-1]], WRENCH, "\t")
    assert main(["weigh", str(poses), str(short)]) == BAD_INPUT


@pytest.mark.parametrize(
    ("header", "made", "options"),
    [
        (("roll_deg", "pitch_deg", "yaw_deg"), ("xyz", 1.0), ()),
        (("roll", "pitch", "yaw"), ("XYZ", 1.0), ()),
        (("A", "B", "C"), ("ZYX", 1.0), ()),
        (("rx", "ry", "rz"), ("rotvec", np.pi / 180.0), ()),
        (("rx", "ry", "rz"), ("XYZ", 1.0), ("--orientation", "XYZ")),
        (("euler_x", "euler_y", "euler_z"), ("xyz", 1.0), ()),
        (("phi", "theta", "psi"), ("ZYZ", 1.0), ("--orientation", "ZYZ")),
        (("tool_phi [deg]", "tool_theta [deg]", "tool_psi [deg]"), ("ZYZ", 1.0), ()),
        (("phi", "theta", "psi"), ("xyz", 1.0), ("--orientation", "ZYX")),
        (("alpha", "beta", "gamma"), ("ZYX", 1.0), ("--orientation", "ZYX")),
    ],
)
def test_angles(tmp_path, header, made, options):
    """Poses made by products of turns about one axis each."""
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
        code, answer = weighed(tmp_path, rows, header=header)
        assert code == OK
        assert all(holds(answer, one.true).values())


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


def test_joint_angles_and_a_urdf(one, tmp_path):
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
        code, answer = weighed(tmp_path, rows, "--urdf", str(urdf), header=(*names, *WRENCH) if names else ())
        assert code == OK
        assert all(holds(answer, one.true).values())
    assert weighed(tmp_path, rows, "--urdf", str(urdf), "--link", "hand", header=(*names, *WRENCH))[0] == BAD_INPUT


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


def test_units_of_names():
    assert columns.split_name("Fx [N]") == ("fx", "n")
    assert columns.split_name("torque_z (N mm)") == ("torquez", "nmm")
    assert columns.split_name("roll_deg") == ("roll", "deg")
    assert columns.split_name("tcp_m_x") == ("tcp.mx", "")
    assert columns.split_name("Fx [\u00b5N]") == columns.split_name("Fx [\u03bcN]") == ("fx", "un")
    with pytest.raises(PosesError, match="no order of Euler angles"):
        conventions.of_euler("xYz", np.zeros((1, 3)))


def test_a_file_that_is_no_table(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(PosesError):
        table.read([path])
    path.write_text("\n\n", encoding="utf-8")
    with pytest.raises(PosesError, match="no rows"):
        table.read([path])
