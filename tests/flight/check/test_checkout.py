"""``heft checkout``: the list walked against a vehicle with joints, cells and IMUs on six buses; automatic checks."""

import json
import os
import re
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from rich.console import Console

from onboard.cli import main
from onboard.devices.roles import LoadCellKeys
from onboard.dynamics.model.vehicle import Joint
from onboard.flight.check.checkout import CheckHost, Lengths, Record, checkout, pulse, render, write
from onboard.flight.check.checkout_checks import CheckResult, judge_motion, judge_tare
from onboard.flight.check.preflight import run_in_turn
from tests.flight.mixed import DEVICES, MixedWorld, only, vehicle
from tests.hil_sim.devices.twin_bench import MS

ROOT = Path(__file__).resolve().parents[3]
HINGE = Joint("joint_1", (0.0, 0.0, 1.0), True, 7, 1, 6, -1.5, 1.5)
CELL = LoadCellKeys(frame="link_4", axis=(1.0, 0.0, 0.0), measures="force", capacity_N=50.0, noise_N=0.01)
T = np.linspace(0.0, 1.0, 500)
MARKED = "imu_base", "imu_elbow", "elbow", "wrist"  # by the pulse
JOINTS = 6
WALKED = only(*MARKED, "pulse", "can_sync", "shoulder", "upper", "tip", "servo_6", "load_cell", "cell", "phase")


class Script:
    """An operator who answers by the step, and signs."""

    def __init__(self, answers, signs="Ada"):
        self.answers, self.signs, self.told, self.asked = answers, signs, [], []

    def ask(self, text):
        self.asked.append(text)
        if text.startswith("Signed off"):
            return self.signs
        return next((answer for step, answer in self.answers.items() if text.startswith(step)), "")

    def tell(self, text):
        self.told.append(text)


def walk(directory, operator, text=WALKED, dry_run=lambda: CheckResult((), "as in flight")):
    with MixedWorld(directory, text) as world:
        flying = vehicle(directory, world.urls, text)

        def wait(waited_s):
            for _ in range(max(1, round(waited_s * 1e3))):
                world.advance(MS)

        def run(opened, seconds):
            return run_in_turn(opened.devices, world.clock, wait, seconds)

        bench = CheckHost(world.clock, wait, lambda: datetime(2026, 11, 21, tzinfo=UTC), run, dry_run)
        return checkout(flying, None, bench, operator, Lengths(2.0, 1.2, 60.0))


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    unpowered = [f"range and sense of joint_{k}:" for k in range(4, JOINTS + 1)]
    left = {"tare of ": "skip the payload is on", **dict.fromkeys(unpowered, "skip no power")}
    operator = Script({**left, "range and sense of joint_2": "no it is blocked", "[Enter": "keep"})
    return walk(tmp_path_factory.mktemp("checkout"), operator), operator


def test_every_line_of_the_list_is_there_and_judged(walked):
    record, _ = walked
    by_name = {step.name: step for step in record.steps}
    assert list(by_name)[:4] == ["power", "devices", "pulse", "disk"]
    assert list(by_name)[-1] == "dry run"
    for name in ("power", "devices", "pulse", "disk", "dry run"):
        assert by_name[name].outcome == "passed", by_name[name]
    assert "imu_base" in by_name["devices"].found
    assert {part.split()[0] for part in by_name["pulse"].found.removeprefix("marked: ").split(", ")} == set(MARKED)
    # The arm swings by 0.3 rad, joint_1 about 0.2 rad; the incremental encoder of joint_3 counts from its power-up.
    swings = [re.search(r"read (\S+) to (\S+) deg", by_name[f"range and sense of joint_{k}"].found) for k in (1, 3)]
    (low, high), (first, last) = (map(float, swing.groups()) for swing in swings)
    assert -5.8 < low < high - 5.0 < high < 28.7
    assert 5.0 < last - first < 34.5
    assert {by_name[f"range and sense of joint_{k}"].outcome for k in range(4, JOINTS + 1)} == {"left out"}


def test_what_failed_or_was_left_out_is_recorded_with_the_operators_words(walked):
    record, operator = walked
    by_name = {step.name: step for step in record.steps}
    assert by_name["range and sense of joint_2"][2:5] == ("failed", "", "it is blocked")
    tares = [step for step in record.steps if step.name.startswith("tare")]
    assert len(tares) >= 2
    assert all((step.outcome, step.said) == ("left out", "the payload is on") for step in tares)
    assert record.signed_by == "Ada"
    assert not record.ready
    assert any(text.startswith("failed: range and sense of joint_2") for text in operator.told)


def test_the_record_is_written_beside_the_flights_and_never_over_another(walked, tmp_path):
    record, _ = walked
    one, other = write(record, tmp_path / "flights"), write(record, tmp_path / "flights")
    assert [path.name for path in (one, other)] == ["mixed-checkout-001.json", "mixed-checkout-002.json"]
    read = json.loads(one.read_text())
    assert read["ready"] is False
    assert len(read["steps"]) == len(record.steps)
    assert len(read["vehicle_sha256"]) == 64
    console = Console(width=300)
    with console.capture() as text:
        console.print(render(record))
    said = text.get().rstrip()
    assert said.endswith("not ready")
    assert "heft checkout mixed --without joint_" in said
    assert "--without joint_2" in said
    assert "--without load_cell" in said


def test_nobody_who_answers_leaves_everything_open(tmp_path):
    class Gone(Script):
        def ask(self, text):
            self.asked.append(text)

    record = walk(tmp_path, Gone({}))
    assert {step.outcome for step in record.steps} == {"left out"}
    assert [step.name for step in record.steps] == ["power", "devices"]  # of a vehicle not looked at no more is asked
    assert not record.ready


def test_a_pulse_that_nobody_marks_fails_and_one_that_is_not_wired_is_left_out(tmp_path):
    class Looked(NamedTuple):
        checks: tuple

    bench = CheckHost(None, None, lambda: datetime(2026, 11, 21, tzinfo=UTC), None, None)
    wired = vehicle(tmp_path, {})
    assert pulse(wired, bench, Looked(())).outcome == "failed"
    text = re.sub(r"\[device\.(pulse|second|loop)\]\n(?:[^\[\n].*\n|\n)*", "", DEVICES)
    bare = vehicle(tmp_path, {}, text)
    assert pulse(bare, bench, Looked(()))[2:5:2] == ("left out", "none is wired")


def test_recorded_data_have_nothing_to_check(capsys):
    for command in ("checkout", "preflight"):
        assert main([command, "dymaflex_air_bearing"]) == 2
        assert "no device is on a bus, its data are imported" in capsys.readouterr().err


def test_ready_needs_a_signature_and_a_reason_for_what_is_left_out(walked):
    steps = tuple(step for step in walked[0].steps if step.outcome != "failed")
    record = Record("mixed", "", steps, "Ada", "")
    assert record.ready
    assert not record._replace(signed_by="").ready
    assert not record._replace(steps=(*steps, steps[0]._replace(outcome="left out", said=""))).ready
    assert not record._replace(steps=()).ready


SWEEP = 1.5 * np.sin(2.0 * np.pi * T)  # positive first, from stop to stop


@pytest.mark.parametrize(
    ("values", "swings", "problem"),
    [
        (SWEEP, {"joint_2": 0.1}, ""),
        (-SWEEP, {}, "it read backwards"),
        (0.5 * SWEEP, {}, "it covered 50 % of its range"),
        (1.1 * SWEEP, {}, "8.6 deg beyond the URDF's limits"),
        (0.01 * SWEEP, {}, "moved by 1.72 deg only"),
        (np.zeros(500), {}, "moved by 0.00 deg only"),
        (SWEEP[:10], {}, "10 samples only"),
        (SWEEP, {"joint_2": 3.5}, "joint_2 moved further: its encoder is wired or named as another joint's"),
    ],
)
def test_a_moved_joint(values, swings, problem):
    found = judge_motion(HINGE, values, swings)
    assert (problem in found.problems[0]) if problem else not found.problems, found


def test_a_joint_that_slides_is_judged_in_millimetres():
    slide = HINGE._replace(revolute=False, low=0.0, high=0.2)
    assert judge_motion(slide, 0.2 * np.sin(np.pi * T), {}).problems == ()
    assert "read 0.0 to 200.0 mm" in judge_motion(slide, 0.2 * np.sin(np.pi * T), {}).found


def test_of_a_rate_only_the_sense_is_judged():
    assert judge_motion(HINGE, np.cos(2.0 * np.pi * T), {}, is_rate=True).problems == ()
    assert "backwards" in judge_motion(HINGE, -np.cos(2.0 * np.pi * T), {}, is_rate=True).problems[0]


@pytest.mark.parametrize(
    ("mean", "spread", "problem"),
    [(0.3, 0.01, ""), (3.0, 0.01, "more than 5 % of 50 N"), (0.3, 0.1, "10 times noise_N"), (0.3, 0.0, "not change")],
)
def test_a_cell_without_load(mean, spread, problem):
    values = mean + spread * np.where(np.arange(200) % 2, 1.0, -1.0)
    found = judge_tare(values, CELL)
    assert (problem in found.problems[0]) if problem else not found.problems, found


@pytest.mark.realtime
def test_the_command_walks_with_real_processes(tmp_path):
    """RockSat's devices as a process; the arm does not sweep yet, so the operator leaves range and tare out."""
    serve = [sys.executable, "-m", "hil_sim.serve", "rocksat", "--seed", "3", "--wait", "--directory", str(tmp_path)]
    with subprocess.Popen(serve, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as devices:
        try:
            said = json.loads(devices.stdout.readline())
            devices.stdin.write("\n")
            devices.stdin.flush()
            assert "start_ns" in devices.stdout.readline()
            urls = [f"--url={bus}={said[bus]}" for bus in ("i2c_1", "can_0", "sync_line")]
            asked = ["checkout", "rocksat", *urls, "--seconds", "3", "--move", "1", "--dry-run", "4"]
            answers = "\n\nskip it is bolted down\nskip it is loaded\n\nGrace\n"
            walked = subprocess.run(
                [sys.executable, "-m", "onboard.cli", *asked, "--json", "record.json"],
                input=answers,
                capture_output=True,
                text=True,
                cwd=tmp_path,
                env=os.environ | {"PYTHONPATH": str(ROOT)},
                timeout=120,
                check=False,
            )
        finally:
            devices.terminate()
    read = json.loads((tmp_path / "record.json").read_text())
    outcomes = {step["name"]: step["outcome"] for step in read["steps"]}
    assert outcomes == {
        **dict.fromkeys(("power", "devices", "pulse", "disk", "dry run"), "passed"),
        **dict.fromkeys(("range and sense of joint_1", "tare of load_cell"), "left out"),
    }, walked.stdout
    assert walked.returncode == 0  # everything that was left out has its reason, and Grace signed
    assert read["ready"]
    assert read["steps"][-1]["found"].startswith("rocksat-checkout-001.mcap: ")
    assert {path.name for path in (tmp_path / "flights").iterdir()} == {
        *("rocksat-checkout-001.mcap", "rocksat-checkout-001.json")
    }
