"""``heft weigh`` from table to verdict: tables as people write them, conventions, errors, zeros, recorded poses."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onboard.cli import BAD_INPUT, FAILED, OK, main
from onboard.ground.calibrate.weigh import columns, conventions, table
from onboard.ground.calibrate.weigh.errors import PosesError
from tests.ground.calibrate.weigh.wrist_bench import GRAVITY, HEADER, quaternion, record, turn, write

PAGE = (Path(__file__).parents[4] / "docs" / "weigh.md").read_text(encoding="utf-8")
COMMANDS = re.search(r"```sh\n(.*?)```", PAGE, re.S)[1].splitlines()
WRENCH = HEADER[4:]


@pytest.fixture(scope="module")
def one():
    return record(6)


def weighed(directory, rows, *options, header=HEADER, between=","):
    """Exit code and answer of the command."""
    path = write(directory / "poses.csv", rows, header, between)
    answer = directory / "answer.json"
    answer.unlink(missing_ok=True)
    code = main(["weigh", str(path), "--json", str(answer), *options])
    return code, json.loads(answer.read_text(encoding="utf-8")) if answer.exists() else {}


def holds(answer, truth):
    """Whether mass and centre lie in their intervals."""
    found = {quantity["name"]: quantity for quantity in answer["quantities"]}
    true = dict(zip(("m", "c_x", "c_y", "c_z"), (truth.mass_kg, *truth.centre_m), strict=True))
    return {name: found[name]["low"] <= value <= found[name]["high"] for name, value in true.items()}


def test_the_commands_of_the_page(one, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "poses.csv", one.rows)
    assert main(["init", "lab", "--from", "workshop"]) == OK
    assert len(COMMANDS) == 4
    for command in COMMANDS:
        assert main(shlex.split(command)[1:]) == OK, command
    shown = capsys.readouterr().out
    assert "sensor on its flange, about z" in shown
    assert max(len(line.rstrip()) for line in shown.splitlines()[:24]) <= 80
    assert (tmp_path / "weighed.png").stat().st_size > 10_000
    answer = json.loads((tmp_path / "weighed.json").read_text(encoding="utf-8"))
    assert answer["verdict"]["level"] == "good"
    assert all(holds(answer, one.true).values())
    text = (tmp_path / "lab" / "vehicle.toml").read_text(encoding="utf-8")
    written = dict(
        zip(re.findall(r"\[device\.wrist_(\w+)\]", text), re.findall(r"offset_N = (\S+)", text), strict=True)
    )
    lever = 0.05  # of the workshop's moments
    for name, true, sigma in zip(
        ("force_x", "force_y", "force_z", "moment_x", "moment_y", "moment_z"),
        one.true.zero / np.repeat([1.0, lever], 3),
        one.true.noise / np.repeat([1.0, lever], 3),
        strict=True,
    ):
        assert float(written[name]) == pytest.approx(true, abs=4.0 * sigma), name


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
    for names in (("shoulder", "elbow", "wrist"), ("q1", "q2", "q3")):
        code, answer = weighed(tmp_path, rows, "--urdf", str(urdf), header=(*names, *WRENCH))
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


def test_conventions_are_found(one, tmp_path):
    turned = np.einsum("nab,nkb->nka", one.R, one.wrench.reshape(-1, 2, 3)).reshape(-1, 6)
    inverse = np.hstack([one.rows[:, :1], -one.rows[:, 1:4]])
    q = one.rows[:, :4]
    for rows, expected in (
        (np.hstack([q, one.wrench]), ("sensor-in-base", "sensor", "weight")),
        (np.hstack([q, turned]), ("sensor-in-base", "base", "weight")),
        (np.hstack([inverse, one.wrench]), ("base-in-sensor", "sensor", "weight")),
        (np.hstack([q, -one.wrench]), ("sensor-in-base", "sensor", "reaction")),
    ):
        code, answer = weighed(tmp_path, rows)
        assert (code, tuple(answer["convention"][key] for key in ("sense", "axes", "sign"))) == (OK, expected)
        assert all(holds(answer, one.true).values())
        assert 1 < len(answer["others"]) <= 8


def test_a_tilted_base_and_an_arm_on_a_wall(tmp_path):
    tilted = record(12, tilt_deg=8.0)
    code, answer = weighed(tmp_path, tilted.rows)
    assert code == OK
    assert all(holds(answer, tilted.true).values())
    wall = record(13)
    side = turn([0.0, np.pi / 2.0, 0.0])  # the wall's base: downwards is its -x
    rows = np.hstack([np.array([quaternion(side @ R) for R in wall.R]), wall.wrench])
    code, answer = weighed(tmp_path, rows, "--gravity=-1,0,0")
    assert code == OK
    assert all(holds(answer, wall.true).values())


def spoilt(wrench, what):
    out = wrench.copy()
    match what:
        case "fx turned":
            out[:, 0] *= -1.0
        case "mz turned":
            out[:, 5] *= -1.0
        case "fx, fy exchanged":
            out[:, [0, 1]] = out[:, [1, 0]]
        case "fz stuck":
            out[:, 2] = out[0, 2]
        case "fz stuck from half on":
            out[15:, 2] = out[15, 2]
        case "N mm":
            out[:, 3:] *= 1e3
    return out


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("fx turned", "the sign of force x is turned"),
        ("mz turned", "the sign of moment z is turned"),
        ("fx, fy exchanged", "force x and y are exchanged"),
        ("fz stuck", "force z reads the same in poses that differ"),
        ("fz stuck from half on", "force z reads the same in poses that differ"),
        ("N mm", "its moments are in another unit than N m"),
    ],
)
def test_wrong_axes_and_units_are_refused_by_name(one, tmp_path, what, said):
    code, answer = weighed(tmp_path, np.hstack([one.rows[:, :4], spoilt(one.wrench, what)]))
    assert (code, answer["verdict"]["level"]) == (FAILED, "do not use")
    assert said in answer["verdict"]["text"]


def test_the_remedies_that_are_named_help(one, tmp_path):
    rows = np.hstack([one.rows[:, :4], spoilt(one.wrench, "mz turned")])
    code, answer = weighed(tmp_path, rows, "--turned", "mz")
    assert code == OK
    assert all(holds(answer, one.true).values())
    rows = np.hstack([one.rows[:, :4], spoilt(one.wrench, "N mm")])
    code, answer = weighed(tmp_path, rows, "--moment-unit", "Nmm")
    assert code == OK
    assert all(holds(answer, one.true).values())


@pytest.mark.parametrize(("metres", "code"), [(1.5, OK), (3.0, FAILED)])
def test_a_centre_farther_than_two_metres_is_a_wrong_unit(tmp_path, metres, code):
    rng, rows = np.random.default_rng(2), []
    for R in record(14).R:
        weight = 2.0 * R.T @ [0.0, 0.0, -GRAVITY]
        load = np.concatenate([weight, np.cross([0.0, 0.0, metres], weight)])
        rows.append([*quaternion(R), *(load + [0.02, 0.02, 0.02, 0.01, 0.01, 0.01] * rng.normal(size=6))])
    assert weighed(tmp_path, rows)[0] == code


def test_bad_rows_and_outliers_are_left_out_and_counted(one, tmp_path):
    rows = [list(map(float, row)) for row in one.rows]
    rows[3][5], rows[7][2] = "abc", float("nan")
    rows[9] = rows[9][:6]
    rows[20][4:] = [0.0] * 6
    code, answer = weighed(tmp_path, rows)
    assert (code, answer["verdict"]["level"]) == (OK, "weak")
    assert (answer["rows"]["bad"], answer["outliers"]) == (3, [21])
    assert all(holds(answer, one.true).values())


def test_a_recording_at_full_rate_is_averaged_by_pose(one, tmp_path):
    rng, rows = np.random.default_rng(3), []
    for R, wrench in zip(one.R, one.wrench, strict=True):
        rows += [[*quaternion(R), *(wrench + one.true.noise * rng.normal(size=6))] for _ in range(20)]
        moving = turn(0.3 * np.ones(3)) @ R
        rows.append([*quaternion(moving), *(wrench + 5.0)])
    code, answer = weighed(tmp_path, rows)
    assert code == OK
    assert answer["rows"] == {"rows": 630, "bad": 0, "moving": 30, "poses": 30}
    assert all(holds(answer, one.true).values())


def test_what_the_poses_do_not_tell_is_not_known(tmp_path, capsys):
    """Turns about the vertical: the weight is always along the same axis of the sensor, as a zero is."""
    rng = np.random.default_rng(6)
    weight = np.array([0.0, 0.0, -2.0 * GRAVITY])
    load = np.concatenate([weight, np.cross([0.0, 0.01, 0.1], weight)])
    rows = [
        [*quaternion(turn([0.0, 0.0, angle])), *(load + 0.02 * rng.normal(size=6))] for angle in np.linspace(0, 6, 20)
    ]
    code, answer = weighed(tmp_path, rows)
    assert code == FAILED
    assert not answer["quantities"][0]["supported"]
    assert "not known" in capsys.readouterr().out
    assert {"x", "y"} <= set("".join(pose["text"] for pose in answer["further_poses"]))


def test_three_poses_and_five(one, tmp_path, capsys):
    assert weighed(tmp_path, one.rows[:3])[0] == BAD_INPUT
    assert "four or more are needed" in capsys.readouterr().err
    code, answer = weighed(tmp_path, one.rows[:5])
    assert (code, answer["verdict"]["level"]) == (OK, "weak")


def test_the_poses_that_are_advised_tell_what_is_promised(tmp_path):
    """Few poses near each other, then those advised: the sigma falls to about what was said."""
    few = record(21, count=12, spread_deg=2.0, walk=0.0)
    _, answer = weighed(tmp_path, few.rows)
    advised = answer["further_poses"]
    assert advised
    before, promised = answer["quantities"][0]["sigma"], advised[-1]["mass_sigma_kg"]
    assert promised < 0.7 * before


def test_what_cannot_be_understood_is_refused_with_the_remedy(one, tmp_path, capsys):
    for header, said in (
        (("a1", "a2", "a3", "a4", *WRENCH), "no orientation among"),
        ((*HEADER[:4], "u", "v", "w", *WRENCH[3:]), "no columns of forces"),
        ((*HEADER[:4], "fx [furlong]", "fy [furlong]", "fz [furlong]", *WRENCH[3:]), "is not known; give --force-unit"),
    ):
        assert weighed(tmp_path, one.rows, header=header)[0] == BAD_INPUT
        assert said in capsys.readouterr().err
    assert weighed(tmp_path, one.rows, "--columns", "qw,qx")[0] == BAD_INPUT
    assert "name each" in capsys.readouterr().err
    assert weighed(tmp_path, one.rows, "--orientation", "xyx")[0] == BAD_INPUT
    assert weighed(tmp_path, np.delete(one.rows, 9, axis=1), header=())[0] == BAD_INPUT
    assert "--columns" in capsys.readouterr().err


def test_units_of_names():
    assert columns.split_name("Fx [N]") == ("fx", "n")
    assert columns.split_name("torque_z (N mm)") == ("torquez", "nmm")
    assert columns.split_name("roll_deg") == ("roll", "deg")
    assert columns.split_name("tcp_m_x") == ("tcp.mx", "")
    with pytest.raises(PosesError, match="no order of Euler angles"):
        conventions.of_euler("xYz", np.zeros((1, 3)))


def test_a_refused_weighing_writes_no_zeros(one, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "lab", "--from", "workshop"]) == OK
    text = (tmp_path / "lab" / "vehicle.toml").read_text(encoding="utf-8")
    rows = np.hstack([one.rows[:, :4], spoilt(one.wrench, "mz turned")])
    assert weighed(tmp_path, rows, "--vehicle", "lab/vehicle.toml")[0] == FAILED
    assert (tmp_path / "lab" / "vehicle.toml").read_text(encoding="utf-8") == text
    assert "are as they were" in capsys.readouterr().out


def test_a_file_that_is_no_table(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(PosesError):
        table.read([path])
    path.write_text("\n\n", encoding="utf-8")
    with pytest.raises(PosesError, match="no rows"):
        table.read([path])


def test_recorded_poses_of_another_laboratory(datasets, tmp_path):
    """Two files without names. Plain least squares says 1.239 kg, because the zero of z fell by 2 N on the way."""
    files = [str(datasets / "ati_wrist" / name) for name in ("pose_100.txt", "wrench_100.txt")]
    answer = tmp_path / "answer.json"
    assert main(["weigh", *files, "--json", str(answer)]) == OK
    told = json.loads(answer.read_text(encoding="utf-8"))
    mass, axes = told["quantities"][0], told["axes"]
    assert told["plain_least_squares"]["mass_kg"] == pytest.approx(1.239, abs=0.002)
    assert "x, y, z alone give" in told["verdict"]["text"]
    assert told["verdict"]["level"] == "weak"
    assert axes[2]["moved"] == pytest.approx(-2.0, abs=0.3)
    for axis in axes[:3]:
        assert mass["low"] < axis["mass_kg"] < mass["high"]
    assert (mass["high"] - mass["low"]) / 2.0 < 0.02 * mass["value"]
    assert told["convention"]["axes"] == "base"


@pytest.mark.parametrize(("shifted", "level"), [(0, "good"), (1, "do not use"), (4, "do not use")])
def test_rows_of_poses_and_wrenches_that_do_not_belong_together_are_refused(one, tmp_path, shifted, level):
    """The mass of what is left was 0.2 to 0.6 of the true one, weak."""
    rows = np.hstack([np.roll(one.rows[:, :4], shifted, axis=0), one.wrench])
    _, answer = weighed(tmp_path, rows)
    assert answer["verdict"]["level"] == level
    assert ("is left over" in answer["verdict"]["text"]) == (level != "good")


def test_noise_as_large_as_most_of_the_weight_is_wide_and_not_refused(one, tmp_path):
    """A light tool: a quarter of what the readings change by is noise."""
    rng, weight = np.random.default_rng(3), one.true.mass_kg * GRAVITY
    sigma = 0.25 * weight * np.repeat([1.0, 0.1], 3)
    code, answer = weighed(
        tmp_path, np.hstack([one.rows[:, :4], one.wrench + sigma * rng.normal(size=one.wrench.shape)])
    )
    assert (code, answer["verdict"]["level"]) == (OK, "weak")
    assert all(holds(answer, one.true).values())


@pytest.mark.parametrize("order", ["xyz", "XYZ"])
def test_roll_pitch_yaw_may_be_about_fixed_or_moving_axes(one, tmp_path, order):
    angles = Rotation.from_matrix(one.R).as_euler(order, degrees=True)
    code, answer = weighed(tmp_path, np.hstack([angles, one.wrench]), header=("roll", "pitch", "yaw", *HEADER[4:]))
    assert (code, answer["verdict"]["level"]) == (OK, "good")
    assert all(holds(answer, one.true).values())


def test_a_centre_behind_the_sensor_is_said(one, tmp_path, capsys):
    """Moments that are all of the other sign are those of a tool on the other side."""
    turned = np.hstack([one.rows[:, :4], one.wrench * [1.0, 1.0, 1.0, -1.0, -1.0, -1.0]])
    for rows, said in ((one.rows, False), (turned, True)):
        assert weighed(tmp_path, rows)[0] == OK
        assert ("if the tool is not, all moments are turned" in " ".join(capsys.readouterr().out.split())) == said
