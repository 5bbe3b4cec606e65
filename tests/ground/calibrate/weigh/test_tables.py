"""Tables of poses and wrenches as people write them, for ``heft weigh``."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onboard.cli import BAD_INPUT, OK, main
from onboard.ground.calibrate.weigh import columns, conventions, table
from onboard.ground.calibrate.weigh.errors import PosesError
from tests.ground.calibrate.weigh.wrist_bench import AS_RECORDED, HEADER, holds, weighed, write

pytestmark = pytest.mark.usefixtures("axes_as_they_are")  # the meaning of a table is chosen by fits
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
    meaning = columns.understood(table.read([write(tmp_path / "poses.csv", one.rows, names, between)]), columns.Units())
    assert meaning.kind.startswith("quaternion")
    np.testing.assert_array_equal(meaning.orientation, one.rows[:, :4])
    np.testing.assert_array_equal(meaning.wrench, one.wrench)


@pytest.mark.parametrize("named", ["actual_TCP_{}_{}", "{}[{}]"])
@pytest.mark.parametrize("first", [0, 1])
def test_numbered_parts_of_a_pose_and_a_wrench(one, named, first):
    def understood(names, values):
        read = table.WeighTable(tuple(names), values, tuple(range(2, len(values) + 2)), "poses.csv")
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
        code, answer = weighed(tmp_path, rows, *AS_RECORDED, *way, header=())
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
    meaning = columns.understood(table.read([path]), columns.Units())
    np.testing.assert_array_equal(meaning.orientation, one.rows[:, :4])
    np.testing.assert_array_equal(meaning.wrench, one.wrench)


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
    assert meaning.unnamed == ()
    write(path, one.rows, [*HEADER[:-3], *(f"{name} [Nm]" for name in HEADER[-3:])])
    assert columns.understood(table.read([path]), columns.Units()).unnamed == ("force",)
    write(path, [*one.rows], [*(f"rot_{axis}" for axis in "wxyz"), *HEADER[4:]])
    assert columns.understood(table.read([path]), columns.Units()).kind == "quaternion"
    write(path, one.rows[:, 1:], [*(f"Rot_{axis} [deg]" for axis in "XYZ"), *HEADER[4:]])
    assert columns.understood(table.read([path]), columns.Units()).kind == "angles?"


def test_counts_and_readings_that_the_controller_has_compensated(one, tmp_path, capsys):
    rows = np.hstack([one.rows[:, :4], np.rint(1e3 * one.wrench)])
    assert weighed(tmp_path, rows)[0] == BAD_INPUT
    assert "are whole numbers without a unit" in " ".join(capsys.readouterr().err.split())
    code, answer = weighed(tmp_path, rows, *AS_RECORDED, "--force-unit", "1e-3", "--moment-unit", "1e-3")
    assert code == OK
    assert all(holds(answer, one.true).values())
    for names, said in (
        ((f"actual_TCP_force_{k}" for k in range(6)), True),
        ((f"wrench_{k}" for k in range(6)), False),
    ):
        read = table.WeighTable((*HEADER[:4], *names), one.rows, tuple(range(len(one.rows))), "poses.csv")
        told = " ".join(columns.understood(read, columns.Units()).said)
        assert ("without the payload set in the controller" in told) == said


def test_a_quaternion_that_is_none_is_said(one, tmp_path, capsys):
    assert weighed(tmp_path, one.rows * ([2.0] * 4 + [1.0] * 6))[0] == BAD_INPUT
    assert "or a quaternion or matrix that is no rotation" in " ".join(capsys.readouterr().err.split())


def test_columns_by_their_numbers(one, tmp_path, capsys):
    rows = np.hstack([np.arange(len(one.rows))[:, None], one.rows[:, ::-1]])
    given = ",".join(f"{name}={11 - k}" for k, name in enumerate(HEADER))
    code, answer = weighed(tmp_path, rows, *AS_RECORDED, "--columns", given, header=())
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
    assert main(["weigh", str(poses), str(wrenches), "--json", str(answer), *AS_RECORDED]) == OK
    assert all(holds(json.loads(answer.read_text(encoding="utf-8")), one.true).values())
    short = write(tmp_path / "short.txt", [row[4:] for row in rows[:-1]], WRENCH, "\t")
    assert main(["weigh", str(poses), str(short)]) == BAD_INPUT


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
