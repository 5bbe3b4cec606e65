"""A body without joints on a table: what its thrusters and its tracked pose tell, and what they do not let pass."""

import json
import re

import numpy as np
import pytest

from bench.floating_bed import THRUSTERS, UnstatedErrors, fly, write
from onboard.cli import OK, main
from onboard.identification.body.fit import BodyModel
from onboard.identification.body.stated import Opening, valve_of_on_times

STATED = {
    "# mass_sigma": "mass_sigma",
    "# common_force_sigma = 0.05 ": "common_force_sigma = 0.03 ",
    "scale_sigma = 0.05 ": "scale_sigma = 0.02 ",
    "position_noise_m = 5e-4": "position_noise_m = 3e-4",
    "yaw_noise_rad = 1e-3": "yaw_noise_rad = 6e-4",
}


def identified(directory, bed, stated=STATED):
    """The answers of ``heft identify`` by the files that ``heft init`` writes, as JSON."""
    write(bed, directory)
    lab, names = directory / "lab", ",".join(THRUSTERS)
    urdf = ["--urdf", str(directory / "body.urdf"), "--marker", "marker"]
    assert main(["init", str(lab), "--base", "planar", *urdf, "--thrusters", names, "--force", "0.6"]) == OK
    text = (lab / "vehicle.toml").read_text()
    for old, new in stated.items():
        assert old in text
        text = text.replace(old, new)
    (lab / "vehicle.toml").write_text(text)
    assert main(["import", str(lab / "import.toml"), str(directory / "run.csv"), "-o", str(directory / "logs")]) == OK
    out = directory / "told.json"
    code = main(
        ["identify", "--vehicle", str(lab / "vehicle.toml"), str(directory / "logs" / "run.mcap"), "--json", str(out)]
    )
    told = json.loads(out.read_text())["logs"][0]
    assert (code == OK) == (told["verdict"]["level"] != "do not use")
    return told


def test_mass_centre_and_inertia_are_told(tmp_path):
    bed = fly(51, 20.0)
    told = identified(tmp_path, bed)
    assert told["verdict"]["level"] == "good", told["verdict"]
    found = {one["name"]: one for one in told["quantities"]}
    assert found["I_zz"]["value"] == pytest.approx(bed.inertia_kg_m2, rel=0.03)
    for name, true in bed.truth.items():
        assert abs(found[name]["value"] - true) < 3.0 * found[name]["sigma"], name
    assert found["I_zz"]["sigma"] < 0.01 * bed.inertia_kg_m2


def test_a_force_error_of_all_thrusters_alike_is_in_the_interval_of_what_was_not_weighed(tmp_path):
    """Half of such masses lay outside before: errors that differ between eight thrusters leave a third of it."""
    bed = fly(52, 20.0, delay_s=0.1, wrong=UnstatedErrors(force=np.full(8, 1.05)))
    told = identified(tmp_path, bed, {})
    assert told["verdict"]["level"] == "weak", told["verdict"]
    assert "nothing checks the thrusters' common force" in told["verdict"]["text"]
    for one in told["quantities"]:
        if one["name"] in ("mass", "I_zz"):
            assert one["low"] < bed.truth[one["name"]] < one["high"], one
            assert 0.05 < one["sigma"] / one["value"] < 0.06
            assert one["leans"].startswith("leans on body.common_force_sigma"), one
            parts = told["budget"][one["name"]]
            assert parts[0]["cause"] == "body.common_force_sigma", parts
            assert sum(part["sigma"] ** 2 for part in parts) == pytest.approx(one["sigma"] ** 2)


def test_commands_of_another_clock_are_late_by_up_to_a_sample(tmp_path):
    """Refused before, and the delay was 5 ms short: each change is written at the first pose after it."""
    bed = fly(97, 30.0, delay_s=0.1, period_s=0.0203)
    told = identified(tmp_path, bed)
    assert told["verdict"]["level"] == "good", told["verdict"]
    found = {one["name"]: one for one in told["quantities"]}
    for name, true in bed.truth.items():
        assert found[name]["low"] < true < found[name]["high"], name
    assert found["delay"]["value"] == pytest.approx(0.1, abs=2e-3)


def test_commands_that_come_with_the_poses_may_all_be_late_by_one_part_of_a_sample(tmp_path):
    delay = next(
        one for one in identified(tmp_path, fly(92, 40.0, delay_s=0.1))["quantities"] if one["name"] == "delay"
    )
    assert delay["value"] == pytest.approx(0.1, abs=1e-3)
    assert delay["low"] < 0.1
    assert delay["high"] > 0.109


@pytest.mark.campaign  # of how late: tests/identification/body/test_sampling.py; of commands: above
def test_a_recorder_that_repeats_poses_writes_them_late(tmp_path):
    """Refused before: 4 ms between rows, 10 ms between poses, each of which is late by 0 or 2 ms."""
    bed = fly(93, 20.0, delay_s=0.1)
    row_s = np.arange(0.0, bed.pose_s[-1], 0.004)
    of = np.floor(row_s / 0.01 + 1e-9).astype(int)
    told = identified(tmp_path, bed._replace(pose_s=row_s, poses=bed.poses[of]))
    assert told["verdict"]["level"] == "good", told["verdict"]
    found = {one["name"]: one for one in told["quantities"]}
    for name, true in bed.truth.items():
        assert found[name]["low"] < true < found[name]["high"], name


def lost(bed, poses, values):
    """Some poses are not of the body."""
    changed = bed.poses.copy()
    changed[poses] = values
    return bed._replace(poses=changed)


def test_poses_that_jump_and_come_back_are_left_out(tmp_path, monkeypatch):
    """Refused before, as slosh or a flexible joint: the marker of another body, zeros while none is seen.

    Other readings leave less of a first guess: they were fitted before the one as stated, in four times its time.
    """
    fits, fit = [], BodyModel.fit
    monkeypatch.setattr(BodyModel, "fit", lambda *arguments: fits.append(arguments[0]) or fit(*arguments))
    bed = fly(94, 30.0, delay_s=0.1)
    other = lost(bed, [500, 1300, 1301], [0.4, -0.3, 2.0])
    other = lost(other, slice(1700, 2000), 0.0)
    told = identified(tmp_path, lost(other, slice(2950, None), 0.0))
    assert told["verdict"]["level"] == "good", told["verdict"]
    assert told["refused"] == {"jumped_and_back": 4}  # each pose once
    assert len(fits) == 1
    for one in told["quantities"]:
        if one["name"] in bed.truth:
            assert one["low"] < bed.truth[one["name"]] < one["high"], one


def test_an_origin_that_moves_is_named_and_nothing_is_predicted_across_it(tmp_path):
    """Refused before: the body goes against its thrusters."""
    bed = fly(95, 20.0, delay_s=0.1)
    told = identified(tmp_path, lost(bed, slice(1000, None), bed.poses[1000:] + np.array([0.5, 0.0, 0.0])))
    assert re.fullmatch(
        r"weak: the tracked pose jumps at 9.99 s by (499|500|501) mm and stays there", told["verdict"]["text"]
    )
    found = {one["name"]: one for one in told["quantities"]}
    assert found["I_zz"]["value"] == pytest.approx(bed.inertia_kg_m2, rel=0.03)


def test_a_tracker_that_loses_the_body_often_is_refused(tmp_path):
    bed = fly(96, 20.0)
    told = identified(tmp_path, lost(bed, slice(100, 1900, 16), [0.4, -0.3, 2.0]))
    assert told["verdict"]["level"] == "do not use"
    assert "6% of the poses contradict the others; the tracker loses the body" in told["verdict"]["text"]


def turned(bed, sign=(1.0, 1.0, 1.0), order=(0, 1, 2)):
    """Axes of the tracker of another sign, in another order."""
    return bed._replace(poses=(bed.poses * sign)[:, order])


def exchanged(bed, first, second):
    """Columns of two thrusters, counted from 0."""
    levels = bed.levels.copy()
    levels[:, [first, second]] = levels[:, [second, first]]
    return bed._replace(levels=levels)


SIGN = np.where(np.arange(8) == 2, -1.0, 1.0)
WRONG = {
    "sign": (lambda: fly(71, 20.0, wrong=UnstatedErrors(force=SIGN)), "if t3 pushes the other way:"),
    "stuck": (lambda: fly(72, 30.0, wrong=UnstatedErrors(stuck=(1, 12.0, 20.0))), r"besides the thrusters|leak_t2"),
    "place": (lambda: fly(73, 15.0, wrong=UnstatedErrors(place=np.outer(np.arange(8) == 3, (0.1, 0.0)))), "lever_t4"),
    "turned": (lambda: turned(fly(74, 20.0), order=(1, 0, 2)), "if the tracker's x and y are exchanged:"),
    "mirrored": (lambda: turned(fly(77, 20.0), (1, -1, 1)), "if the tracker's y counts the other way:"),
    "below": (
        lambda: turned(fly(78, 20.0), (-1, 1, -1)),
        "if the tracker's x counts the other way and its yaw counts the other way:",
    ),
    "exchanged": (lambda: exchanged(fly(79, 20.0), 3, 6), "if t4 and t7 are exchanged:"),
    "both": (
        lambda: turned(exchanged(fly(81, 20.0), 1, 4), (1, -1, 1)),
        "if t2 and t5 are exchanged and the tracker's y counts the other way:",
    ),
    "cycle": (
        lambda: exchanged(exchanged(fly(80, 20.0), 0, 1), 1, 2),
        r"if (t\d and t\d are exchanged( and )?){2}:",
    ),
}


# "both" has an exchange of thrusters and an axis of the tracker that counts the other way; "place" is of no mistake in
# the columns, as "stuck" is
REPEATS = ("exchanged", "mirrored", "below", "cycle", "turned", "stuck")


@pytest.mark.parametrize(
    "what", [pytest.param(one, marks=pytest.mark.campaign if one in REPEATS else ()) for one in WRONG]
)
def test_what_is_wrong_is_named(tmp_path, what):
    flown, named = WRONG[what]
    told = identified(tmp_path, flown())
    assert told["verdict"]["level"] == "do not use"
    assert re.search(named, told["verdict"]["text"]), told["verdict"]["text"]
    assert "nan" not in told["verdict"]["text"]


@pytest.mark.campaign  # of commands: above, by one part of a sample
def test_late_poses_are_a_delay(tmp_path):
    bed = fly(75, 20.0, delay_s=0.1, wrong=UnstatedErrors(late_s=0.25))
    found = {one["name"]: one for one in identified(tmp_path, bed)["quantities"]}
    assert found["delay"]["value"] == pytest.approx(0.35, abs=0.01)
    assert found["I_zz"]["value"] == pytest.approx(bed.inertia_kg_m2, rel=0.03)


def test_on_times_are_pulses():
    commanded, on_s = np.array([0.0, 1.0, 2.0]), np.array([0.2, 0.0, 0.5])
    valve, times = valve_of_on_times(commanded, on_s), np.linspace(0.0, 4.0, 401)
    expected = np.clip(times - 0.1, 0.0, 0.2) + np.clip(times - 2.1, 0.0, 0.5)
    assert np.allclose(valve.integrals(times, Opening(0.1, 0.0, 0.0))[0], expected)
    short = valve.integrals(times, Opening(0.1, 0.05, 0.3))[0]
    assert np.allclose(short, np.clip(times - 2.15, 0.0, 0.45))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('base = "planar"', 'base = "free"', "needs base"),
        ("[device.pose]", "[device.pose]\nrepeats = 3", "pose.repeats"),
        ('frame = "marker"', 'frame = "nowhere"', "nowhere"),
        ("axis = [1.0, 0.0, 0.0]", "axis = [0.0, 0.0, 0.0]", "direction"),
        ("axis = [1.0, 0.0, 0.0]", "axis = [0.0, 0.0, 1.0]", "table"),
        ("delay_ms = [-100, 700]", "delay_ms = [700, -100]", "two numbers that rise"),
    ],
)
def test_a_file_that_cannot_be_is_refused(tmp_path, capsys, old, new, said):
    write(fly(76, 10.0), tmp_path)
    lab = tmp_path / "lab"
    urdf = ["--urdf", str(tmp_path / "body.urdf"), "--marker", "marker"]
    assert main(["init", str(lab), "--base", "planar", *urdf, "--thrusters", ",".join(THRUSTERS)]) == OK
    text = (lab / "vehicle.toml").read_text()
    assert main(["import", str(lab / "import.toml"), str(tmp_path / "run.csv"), "-o", str(tmp_path / "logs")]) == OK
    (lab / "vehicle.toml").write_text(text.replace(old, new, 1))
    log = str(tmp_path / "logs" / "run.mcap")
    assert main(["identify", "--vehicle", str(lab / "vehicle.toml"), log]) == 2
    assert said in capsys.readouterr().err
