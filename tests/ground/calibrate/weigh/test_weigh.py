"""``heft weigh`` from table to verdict: conventions, errors, zeros, recorded poses."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from onboard.cli import BAD_INPUT, FAILED, OK, main
from onboard.ground.calibrate.weigh import units
from tests.ground.calibrate.weigh import wrist_bench

PAGE = (Path(__file__).parents[4] / "docs" / "weigh.md").read_text(encoding="utf-8")
COMMANDS = re.search(r"```sh\n(.*?)```", PAGE, re.S)[1].splitlines()
WRENCH = wrist_bench.HEADER[4:]
FRAMES = wrist_bench.AS_RECORDED[:3]  # all but how the base stands


def test_the_commands_of_the_page(one, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    wrist_bench.write(tmp_path / "poses.csv", one.rows, wrist_bench.NAMED)
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
    assert "is left over" not in answer["verdict"]["text"]
    assert all(wrist_bench.holds(answer, one.true).values())
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


@pytest.mark.usefixtures("axes_as_they_are")
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
        code, answer = wrist_bench.weighed(tmp_path, rows)
        assert (code, tuple(answer["convention"][key] for key in ("sense", "axes", "sign"))) == (OK, expected)
        assert all(wrist_bench.holds(answer, one.true).values())
        assert 1 < len(answer["others"]) <= 24
        (second,) = (note for note in answer["notes"] if note.startswith("the next likeliest of"))
        assert re.search(r"[\d.e+]+ times less likely: (Euler|.*orientation is)", second)


@pytest.mark.usefixtures("axes_as_they_are")
def test_a_tilted_base_and_an_arm_on_a_wall(tmp_path):
    tilted = wrist_bench.record(12, tilt_deg=8.0)
    code, answer = wrist_bench.weighed(tmp_path, tilted.rows, *FRAMES)
    assert code == OK
    assert all(wrist_bench.holds(answer, tilted.true).values())
    wall = wrist_bench.record(13)
    side = wrist_bench.turn([0.0, np.pi / 2.0, 0.0])  # the wall's base: downwards is its -x
    rows = np.hstack([np.array([wrist_bench.quaternion(side @ R) for R in wall.R]), wall.wrench])
    for said in (("--gravity=-1,0,0",), ()):
        code, answer = wrist_bench.weighed(tmp_path, rows, *FRAMES, *said)
        assert code == OK
        assert all(wrist_bench.holds(answer, wall.true).values())
        assert any("downwards in the base's axes is -1,0,0" in note for note in answer["notes"])


@pytest.mark.usefixtures("axes_as_they_are")
def test_a_base_that_leans_further_than_is_stated(tmp_path):
    """25 deg are five stated sigmas: a note where nobody said how it stands, a doubt of what was said."""
    leaning = wrist_bench.record(15)
    about = wrist_bench.turn([0.0, np.deg2rad(25.0), 0.0])
    rows = np.hstack([np.array([wrist_bench.quaternion(about @ R) for R in leaning.R]), leaning.wrench])
    for said, level, where in (
        ((), "good", lambda answer: " ".join(answer["notes"])),
        (("--gravity=0,0,-1",), "weak", lambda answer: answer["verdict"]["text"]),
        (("--gravity=0,0,-1", "--tilt-deg=25"), "good", lambda _: "the base leans by 25 deg against"),
    ):
        code, answer = wrist_bench.weighed(tmp_path, rows, *FRAMES, *said, header=wrist_bench.NAMED)
        assert (code, answer["verdict"]["level"]) == (OK, level)
        assert re.search("the base leans by 2[3-7] deg against", where(answer))
        assert all(wrist_bench.holds(answer, leaning.true).values())


@pytest.mark.usefixtures("axes_as_they_are")
@pytest.mark.parametrize(("factor", "level"), [(2000.0, "good"), (3000.0, "do not use")])
def test_forces_in_another_unit_are_a_mass_that_no_arm_holds(one, tmp_path, factor, level):
    rows = np.hstack([one.rows[:, :4], one.wrench * factor / one.true.mass_kg])
    answer = wrist_bench.weighed(tmp_path, rows, *wrist_bench.AS_RECORDED, header=wrist_bench.NAMED)[1]
    assert answer["verdict"]["level"] == level
    assert ("--force-unit" in answer["verdict"]["text"]) == (level == "do not use")


@pytest.mark.usefixtures("axes_as_they_are")
def test_a_payload_that_is_gripped_between_poses(tmp_path):
    """A tenth more from some pose on is named with its row; zeros taken off again, or contacts, are no body."""
    one = wrist_bench.record(8)
    weight = one.true.mass_kg * (one.true.mounting @ one.R.transpose(0, 2, 1) @ [0.0, 0.0, -wrist_bench.GRAVITY])
    more = 0.1 * np.hstack([weight, np.cross(one.true.centre_m, weight)])
    knocked = np.zeros_like(more)
    knocked[[3, 11, 19], :3] = np.random.default_rng(1).normal(size=(3, 3)) * 5.0
    held = np.arange(len(more))[:, None] >= 11
    for added, body in ((more * held, True), (-one.wrench[11] * held, False), (knocked, False), (0.0, False)):
        rows = np.hstack([one.rows[:, :4], one.wrench + added])
        answer = wrist_bench.weighed(tmp_path, rows, *wrist_bench.AS_RECORDED)[1]
        said = re.search(
            r"from row 12 on another body is held, of ([\d.]+) kg after ([\d.]+) kg", answer["verdict"]["text"]
        )
        assert (said is not None) == body
        assert (answer["verdict"]["level"] == "do not use") == body
        if said:
            assert float(said[1]) / float(said[2]) == pytest.approx(1.1, abs=0.02)


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
        case "fx at the end of its range":  # a third of its poses
            out[:, 0] = np.minimum(out[:, 0], np.quantile(out[:, 0], 0.67))
        case "N mm":
            out[:, 3:] *= 1e3
    return out


@pytest.mark.parametrize(
    ("what", "said"),
    [
        *(
            pytest.param(f"{axis} turned", f"the sign of {name} is turned", marks=pytest.mark.campaign)  # below
            for axis, name in (("fx", "force x"), ("mz", "moment z"))
        ),
        ("fx, fy exchanged", "force x and y are exchanged"),
        ("fz stuck", "force z reads the same in poses that differ"),
        pytest.param(
            "fz stuck from half on", "force z reads the same in poses that differ", marks=pytest.mark.campaign
        ),
        ("fx at the end of its range", "force x reads the same in poses that differ: it is stuck or at the end of its"),
        ("N mm", "its moments are in another unit than N m; it would be in N and Nmm"),
    ],
)
def test_wrong_axes_and_units_are_refused_by_name(one, tmp_path, what, said):
    code, answer = wrist_bench.weighed(tmp_path, np.hstack([one.rows[:, :4], spoilt(one.wrench, what)]))
    assert (code, answer["verdict"]["level"]) == (FAILED, "do not use")
    assert answer["verdict"]["text"].count(said) == 1
    assert answer["verdict"]["text"].count("it would be in") == (what == "N mm")


@pytest.mark.usefixtures("axes_as_they_are")
def test_what_nobody_named_a_unit_of_is_weak(one, tmp_path):
    """Poses tell no unit of force: a mass in kgf taken for N is a tenth of it. Names of ROS are defined in N."""
    q, wrench = one.rows[:, :4], one.wrench
    ros = [*wrist_bench.HEADER[:4], *(f"wrench.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz")]
    for header, factor, weak in (
        (wrist_bench.HEADER, 1.0, {"m", "c_x", "c_y", "c_z"}),
        (wrist_bench.HEADER, [1.0 / 9.80665] * 3 + [1.0] * 3, {"m", "c_x", "c_y", "c_z"}),
        ((*wrist_bench.NAMED[:7], *wrist_bench.HEADER[7:]), 1.0, {"c_x", "c_y", "c_z"}),
        ((*wrist_bench.HEADER[:7], *wrist_bench.NAMED[7:]), 1.0, {"m", "c_x", "c_y", "c_z"}),
        (ros, 1.0, set()),
    ):
        code, answer = wrist_bench.weighed(
            tmp_path, np.hstack([q, wrench * factor]), *wrist_bench.AS_RECORDED, header=header
        )
        found = {each["name"] for each in answer["quantities"] if "no unit is named" in each.get("why", "")}
        assert (code, found, answer["verdict"]["level"]) == (OK, weak, "weak" if weak else "good")
        assert ("in kgf and Nm" in answer["verdict"]["text"]) == (np.ndim(factor) == 1)


def test_units_that_would_make_a_held_tool():
    """Within ten radii of a sphere of its mass, 94 mm at 1.756 kg, and beyond a tenth of one."""
    both = ("force", "moment")
    assert units.likelier(1.756, 0.08, both) == ""
    assert [bool(units.likelier(1.756, far, both)) for far in (0.85, 1.05)] == [False, True]
    assert ["in N and Nmm" in units.likelier(1.756, far, both) for far in (8.5, 10.5)] == [False, True]
    assert units.likelier(1.756, 80.0, both).startswith("in N and Nmm 1.76 kg at 80 mm")
    assert units.likelier(1.756, 8.0, both).startswith("in N and Ncm 1.76 kg at 80 mm")
    assert "in kgf and Nm 1.76 kg at 80 mm" in units.likelier(0.17906, 0.7845, both)
    assert "in gf and Nm 1.76 kg at 80 mm" in units.likelier(179.06, 0.7845e-3, both)
    assert units.likelier(0.17906, 0.7845, ("moment",)) == "in N and Ncm 0.179 kg at 7.84 mm"


@pytest.mark.usefixtures("axes_as_they_are")
def test_the_remedies_that_are_named_help(one, tmp_path):
    rows = np.hstack([one.rows[:, :4], spoilt(one.wrench, "mz turned")])
    code, answer = wrist_bench.weighed(tmp_path, rows, *wrist_bench.AS_RECORDED, "--turned", "mz")
    assert code == OK
    assert all(wrist_bench.holds(answer, one.true).values())
    rows = np.hstack([one.rows[:, :4], spoilt(one.wrench, "N mm")])
    code, answer = wrist_bench.weighed(tmp_path, rows, *wrist_bench.AS_RECORDED, "--moment-unit", "Nmm")
    assert code == OK
    assert all(wrist_bench.holds(answer, one.true).values())


@pytest.mark.usefixtures("axes_as_they_are")
@pytest.mark.parametrize(("metres", "code"), [(1.5, OK), (3.0, FAILED)])
def test_a_centre_farther_than_two_metres_is_a_wrong_unit(tmp_path, metres, code):
    rng, rows = np.random.default_rng(2), []
    for R in wrist_bench.record(14).R:
        weight = 2.0 * R.T @ [0.0, 0.0, -wrist_bench.GRAVITY]
        load = np.concatenate([weight, np.cross([0.0, 0.0, metres], weight)])
        rows.append([*wrist_bench.quaternion(R), *(load + [0.02, 0.02, 0.02, 0.01, 0.01, 0.01] * rng.normal(size=6))])
    assert wrist_bench.weighed(tmp_path, rows, *wrist_bench.AS_RECORDED)[0] == code


@pytest.mark.usefixtures("axes_as_they_are")
def test_bad_rows_and_outliers_are_left_out_and_counted(one, tmp_path):
    rows = [list(map(float, row)) for row in one.rows]
    rows[3][5], rows[7][2] = "abc", float("nan")
    rows[9] = rows[9][:6]
    rows[20][4:] = [0.0] * 6
    code, answer = wrist_bench.weighed(tmp_path, rows, *wrist_bench.AS_RECORDED)
    assert (code, answer["verdict"]["level"]) == (OK, "weak")
    assert (answer["rows"]["bad"], answer["outliers"]) == (3, [21])
    assert all(wrist_bench.holds(answer, one.true).values())


@pytest.mark.usefixtures("axes_as_they_are")
def test_a_recording_at_full_rate_is_averaged_by_pose(one, tmp_path):
    rng, rows = np.random.default_rng(3), []
    for R, wrench in zip(one.R, one.wrench, strict=True):
        rows += [[*wrist_bench.quaternion(R), *(wrench + one.true.noise * rng.normal(size=6))] for _ in range(20)]
        moving = wrist_bench.turn(0.3 * np.ones(3)) @ R
        rows.append([*wrist_bench.quaternion(moving), *(wrench + 5.0)])
    code, answer = wrist_bench.weighed(tmp_path, rows, *wrist_bench.AS_RECORDED)
    assert code == OK
    assert answer["rows"] == {"rows": 630, "bad": 0, "moving": 30, "poses": 30}
    assert all(wrist_bench.holds(answer, one.true).values())


@pytest.mark.usefixtures("axes_as_they_are")
def test_what_the_poses_do_not_tell_is_not_known(tmp_path, capsys):
    """Turns about the vertical: the weight is always along the same axis of the sensor, as a zero is."""
    rng = np.random.default_rng(6)
    weight = np.array([0.0, 0.0, -2.0 * wrist_bench.GRAVITY])
    load = np.concatenate([weight, np.cross([0.0, 0.01, 0.1], weight)])
    rows = [
        [*wrist_bench.quaternion(wrist_bench.turn([0.0, 0.0, angle])), *(load + 0.02 * rng.normal(size=6))]
        for angle in np.linspace(0, 6, 20)
    ]
    code, answer = wrist_bench.weighed(tmp_path, rows, *wrist_bench.AS_RECORDED)
    assert code == FAILED
    assert not answer["quantities"][0]["supported"]
    assert "not known" in capsys.readouterr().out
    assert {"x", "y"} <= set("".join(pose["text"] for pose in answer["further_poses"]))


def test_three_poses_and_five(one, tmp_path, capsys):
    assert wrist_bench.weighed(tmp_path, one.rows[:3])[0] == BAD_INPUT
    assert "four or more are needed" in capsys.readouterr().err
    code, answer = wrist_bench.weighed(tmp_path, one.rows[:5])
    assert (code, answer["verdict"]["level"]) == (OK, "weak")


@pytest.mark.usefixtures("axes_as_they_are")
def test_the_poses_that_are_advised_tell_what_is_promised(tmp_path):
    """Few poses near each other, then those advised: the sigma falls to about what was said."""
    few = wrist_bench.record(21, count=12, spread_deg=2.0, walk=0.0)
    _, answer = wrist_bench.weighed(tmp_path, few.rows)
    advised = answer["further_poses"]
    assert advised
    before, promised = answer["quantities"][0]["sigma"], advised[-1]["mass_sigma_kg"]
    assert promised < 0.7 * before


def test_what_cannot_be_understood_is_refused_with_the_remedy(one, tmp_path, capsys):
    for header, said in (
        (("a1", "a2", "a3", "a4", *WRENCH), "no orientation among"),
        ((*wrist_bench.HEADER[:4], "u", "v", "w", *WRENCH[3:]), "no columns of forces"),
        (
            (*wrist_bench.HEADER[:4], "fx [furlong]", "fy [furlong]", "fz [furlong]", *WRENCH[3:]),
            "is not known; give --force-unit",
        ),
    ):
        assert wrist_bench.weighed(tmp_path, one.rows, header=header)[0] == BAD_INPUT
        assert said in capsys.readouterr().err
    assert wrist_bench.weighed(tmp_path, one.rows, "--columns", "qw,qx")[0] == BAD_INPUT
    assert "name each" in capsys.readouterr().err
    assert wrist_bench.weighed(tmp_path, one.rows, "--orientation", "xyx")[0] == BAD_INPUT
    assert wrist_bench.weighed(tmp_path, np.delete(one.rows, 9, axis=1), header=())[0] == BAD_INPUT
    assert "--columns" in capsys.readouterr().err


def test_a_refused_weighing_writes_no_zeros(one, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["init", "lab", "--from", "workshop"]) == OK
    text = (tmp_path / "lab" / "vehicle.toml").read_text(encoding="utf-8")
    rows = np.hstack([one.rows[:, :4], spoilt(one.wrench, "mz turned")])
    asked = [*wrist_bench.AS_RECORDED, "--vehicle", "lab/vehicle.toml"]
    assert wrist_bench.weighed(tmp_path, rows, *asked)[0] == FAILED
    assert (tmp_path / "lab" / "vehicle.toml").read_text(encoding="utf-8") == text
    shown = " ".join(capsys.readouterr().out.split())
    assert "the sign of moment z is turned" in shown
    assert "are as they were" in shown


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


@pytest.mark.parametrize("shifted", [pytest.param(1, marks=pytest.mark.campaign), 4])
def test_rows_of_poses_and_wrenches_that_do_not_belong_together_are_refused(one, tmp_path, shifted):
    """The mass of what is left was 0.2 to 0.6 of the true one, weak."""
    rows = np.hstack([np.roll(one.rows[:, :4], shifted, axis=0), one.wrench])
    _, answer = wrist_bench.weighed(tmp_path, rows)
    assert answer["verdict"]["level"] == "do not use"
    assert "is left over" in answer["verdict"]["text"]


@pytest.mark.usefixtures("axes_as_they_are")
def test_noise_as_large_as_most_of_the_weight_is_wide_and_not_refused(one, tmp_path):
    """A light tool: a quarter of what the readings change by is noise."""
    rng, weight = np.random.default_rng(3), one.true.mass_kg * wrist_bench.GRAVITY
    sigma = 0.25 * weight * np.repeat([1.0, 0.1], 3)
    rows = np.hstack([one.rows[:, :4], one.wrench + sigma * rng.normal(size=one.wrench.shape)])
    code, answer = wrist_bench.weighed(tmp_path, rows, *wrist_bench.AS_RECORDED)
    assert (code, answer["verdict"]["level"]) == (OK, "weak")
    assert all(wrist_bench.holds(answer, one.true).values())


def test_a_centre_behind_the_sensor_is_said(one, tmp_path, capsys):
    """Moments that are all of the other sign are those of a tool on the other side."""
    turned = np.hstack([one.rows[:, :4], one.wrench * [1.0, 1.0, 1.0, -1.0, -1.0, -1.0]])
    for rows, said in ((one.rows, False), (turned, True)):
        assert wrist_bench.weighed(tmp_path, rows, *wrist_bench.AS_RECORDED)[0] == OK
        assert ("if the tool is not, all moments are turned" in " ".join(capsys.readouterr().out.split())) == said
