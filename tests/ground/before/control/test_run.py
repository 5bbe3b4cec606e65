"""Trials of controllers on a two-joint arm on a floating base, through drive twins: errors against the true joints."""

import json

import numpy as np
import pytest

from hil_sim.arm_rig import Wired
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.driven_world import DrivenWorld
from hil_sim.faults import Fault
from onboard import cli, config
from onboard.dynamics.model.inertia import RigidBody, symmetric
from onboard.dynamics.model.urdf import with_bodies
from onboard.ground.before.control import run, view
from onboard.ground.before.control.run import TrialRequest, TrialSetup
from onboard.ground.before.control.trials_log import TrialsLog
from onboard.recording.reader import LogReader

SHORT = {"duration_s": 2.0, "rest_s": 0.5}
COUNTS = (500_000, 200_000)
ELEMENTS = ("xx", "xy", "yy", "xz", "yz", "zz")


def body(mass, x, size):
    i = mass * size**2
    return (
        f'<inertial><origin xyz="{x} 0.01 0.02"/><mass value="{mass}"/>'
        f'<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>'
    )


def joint(number, parent, x, low=-2.0):
    return (
        f'<joint name="j{number}" type="revolute"><parent link="{parent}"/><child link="link_{number}"/>'
        f'<origin xyz="{x} 0 0"/><axis xyz="0 0 1"/><limit lower="{low}" upper="2" effort="20" velocity="3"/></joint>'
    )


URDF = (
    f'<robot name="planar"><link name="base">{body(20.0, 0.0, 0.2)}</link>'
    f'<link name="link_1">{body(1.5, 0.15, 0.08)}</link>{joint(1, "base", 0.2)}'
    f'<link name="link_2">{body(1.0, 0.15, 0.08)}</link>{joint(2, "link_1", 0.3)}'
    '<link name="load"/><joint name="grip" type="fixed"><parent link="link_2"/><child link="load"/>'
    '<origin xyz="0.3 0 0"/></joint></robot>'
)
DRIVE = """
[device.drive_{k}]
kind = "cia402"
bus = "can_0"
node = {node}
joint = "j{k}"
counts_per_revolution = {counts}
zero_count = {zero}
gear_ratio = {gear}
noise_rad = 1e-5
driven = true
{gain}
"""
FILE = """
[vehicle]
name = "two joints"
urdf = "arm.urdf"
base = "{base}"
base_link = "base"
payload_link = "load"
[bus.can_0]
url = "can+virtual://x"
[bus.i2c_1]
url = "i2c:///dev/i2c-1"
[device.can_sync]
kind = "canopen_sync"
bus = "can_0"
period_ms = 4
[device.imu_base]
kind = "mpu6050"
bus = "i2c_1"
address = 0x68
frame = "base"
sample_rate_hz = 200
accel_range_g = 4
gyro_range_deg_s = 250
filter_code = 2
poll_period_ms = 50
accel_noise_m_s2 = 0.088
gyro_noise_rad_s = 1.95e-3
"""
OVER = """
payload = { mass_kg = [3.0, 3.0] }
capture = false
[release]
rate_rad_s = 0.02
"""


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    made = tmp_path_factory.mktemp("planar")
    (made / "arm.urdf").write_text(URDF)
    drives = DRIVE.format(k=1, node=4, counts=COUNTS[0], zero=1000, gear=100, gain="")
    drives += DRIVE.format(k=2, node=9, counts=COUNTS[1], zero=-77, gear=-50, gain="gain = -1.0")
    for base in ("free", "fixed", "prescribed"):
        (made / f"{base}.toml").write_text(FILE.format(base=base) + drives)
    (made / "over.toml").write_text(OVER)
    return made


def fly(directory, asked, base="free", seed=5, faults=(), noise_rad=0.0, log="trials.mcap"):
    """The run, the world, and the true positions at the end of each trial; its log lies beside the vehicle."""
    vehicle = config.load(directory / f"{base}.toml")
    scenario = scenario_of(str(directory / f"{base}.toml"), directory / "over.toml")
    wired = [Wired(*wire) for wire in run.wires(vehicle, ("j1", "j2"))]
    ends = []
    (directory / log).unlink(missing_ok=True)
    with (
        DrivenWorld(scenario, seed, wired, faults, noise_rad=noise_rad) as world,
        TrialsLog(vehicle, directory / log, lambda: world.now_ns) as recorded,
    ):

        def told(flown):
            recorded.trial(flown)
            ends.append(world.vehicle.angles_rad)

        made = run.run(vehicle, world, asked, told, recorded.record)
        world.advance(world.now_ns + 200_000_000)
        return made, world, ends


@pytest.fixture(scope="module")
def identified(directory):
    """The URDF with the true payload, 1 % too heavy."""
    scenario = scenario_of(str(directory / "free.toml"), directory / "over.toml")
    with DrivenWorld(scenario, 5, [Wired("a", "j1", 1, 1000), Wired("b", "j2", 2, 1000)]) as world:
        true = world.truth()["quantities"]
    centre, inertia = ([true[f"{what}_{of}_load"] for of in order] for what, order in (("c", "xyz"), ("I", ELEMENTS)))
    return with_bodies(URDF, {"load": RigidBody(1.01 * true["m_load"], np.array(centre), symmetric(np.array(inertia)))})


@pytest.fixture(scope="module")
def learned(directory, identified):
    return fly(directory, TrialRequest("learning_pi", 3, identified, **SHORT), log="learned.mcap")


def test_identification_pays_and_learning_gets_there_trial_by_trial(learned):
    made, _, _ = learned
    assert not made.stopped
    assert [len(made.of(stage)) for stage in TrialSetup] == [2, 1, 1, 3]
    assert made.gain > 5.0
    tips = [trial.tip_rms_m for trial in made.of(TrialSetup.LEARNING)]
    assert tips[2] < 0.5 * tips[0]
    assert made.rate < 0.8
    assert all(trial.flown.missed == 0 for trial in made.trials)


def test_what_is_measured_is_what_the_joints_do(learned):
    made, _, ends = learned
    for trial, end in zip(made.trials, ends, strict=True):
        assert trial.flown.measured[-1] == pytest.approx(end, abs=1e-3)
    assert np.ptp(made.trials[-1].flown.measured, axis=0).min() > 0.2
    assert made.trials[-1].flown.torques.shape == made.trials[-1].flown.error.shape == (625, 2)


def test_drives_are_identified_before_the_capture(learned):
    made, world, _ = learned
    for place, name in enumerate(made.joints):
        true, mean_rad_s = world.truth()["drives"][name], 0.3
        found = made.drives.coulomb_n_m[place] + mean_rad_s * made.drives.viscous_n_m_s[place]
        assert found == pytest.approx(true["coulomb_n_m"] + mean_rad_s * true["viscous_n_m_s"], rel=0.08)


def test_table_and_json_have_every_trial(learned, tmp_path):
    made, _, _ = learned
    told = made.as_json()
    assert len(json.loads(json.dumps(told, allow_nan=False))["trials"]) == 7
    assert told["tip_error_before_over_after"] == made.gain
    assert "times smaller than without" in " ".join(view.findings_of(made))
    view.draw(made, tmp_path / "learned.svg")
    assert (tmp_path / "learned.svg").read_text().count("computed torque") == 2


def test_the_log_has_every_trial_and_what_the_drives_measured(directory, learned, capsys):
    made, _, _ = learned
    log = LogReader(directory / "learned.mcap")
    trials = np.concatenate([rows for _, rows in log.batches(["trial"])])
    assert [row["stage"].decode() for row in trials] == ["empty"] * 2 + ["before", "after"] + ["learning"] * 3
    assert trials["number"].tolist() == [1, 2, 1, 1, 1, 2, 3]
    np.testing.assert_array_equal(trials["sequence"], np.arange(7))
    np.testing.assert_array_equal(trials["joints_rms_rad"], [trial.flown.rms_rad for trial in made.trials])
    np.testing.assert_array_equal(trials["tip_rms_m"], [trial.tip_rms_m for trial in made.trials])
    assert (np.diff(trials["host_ns"]) > 2_000_000_000).all()
    counts = np.concatenate([rows for _, rows in log.batches(["drive_1"])])
    assert (np.diff(counts["sequence"]) == 1).all()
    seen = (counts["value_raw"] - 1000) * 2.0 * np.pi / COUNTS[0]
    np.testing.assert_allclose(made.trials[-1].flown.measured[:, 0].max(), seen[-700:].max(), atol=1e-9)
    assert cli.main(["info", str(directory / "learned.mcap")]) == cli.OK
    assert "trial" in capsys.readouterr().out


def test_gains_that_are_too_large_are_stopped_with_the_reason(directory):
    made, world, _ = fly(directory, TrialRequest("learning_pd", 4, factor=16.0, **SHORT))
    assert any(why in made.stopped for why in ("where it should be", "grows", "faster than its limit"))
    assert made.predicted[:, 1].max() > 1.0
    assert len(made.of(TrialSetup.LEARNING)) < 4
    assert max(abs(rate) for rate in world.vehicle.rates_rad_s) < 1e-3
    assert "error would grow" in " ".join(view.findings_of(made))


def test_a_drive_that_faults_ends_the_trials(directory):
    made, world, _ = fly(directory, TrialRequest("learning_pi", 3, **SHORT), faults=[Fault("trip", "drive_2", 3.0)])
    assert "drive_2 reports 2310h" in made.stopped
    assert len(made.trials) < 5
    assert max(abs(rate) for rate in world.vehicle.rates_rad_s) < 1e-3


def test_a_drive_in_fault_before_the_start_is_named(directory):
    with pytest.raises(RuntimeError, match="cannot be enabled: drive_1 is in fault"):
        fly(directory, TrialRequest("learning_pi", 1, **SHORT), faults=[Fault("trip", "drive_1", 0.02)])


def test_a_vehicle_whose_base_is_moved_is_refused(directory):
    with pytest.raises(ValueError, match="prescribed"):
        fly(directory, TrialRequest("learning_pi", 1), base="prescribed")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--controller", "computed_torque", "--fault", "trip:drive_1:3:"], "add --identified LOG"),
        (["--controller", "learning_pi", "--trials", "0"], "give 1 to 1000"),
        (["--controller", "learning_pi", "--gain", "nan"], "give a positive number"),
        (["--controller", "learning_pi", "--noise", "-1"], "mrad from 0 to 100"),
        (["--controller", "learning_pi", "--model-error", "-100"], "from -90 to 900"),
        (["--controller", "learning_pi", "--realtime"], "virtual time"),
        (["--controller", "learning_pi", "--figure", "x.jpg"], "name a .svg"),
        (["--controller", "learning_pi", "--identified", "nowhere.mcap"], "nowhere.mcap"),
    ],
)
def test_what_cannot_be_is_refused_with_a_sentence(directory, capsys, options, said):
    code = cli.main(["hil", str(directory / "free.toml"), "--scenario", str(directory / "over.toml"), *options])
    assert code == cli.BAD_INPUT
    assert said in capsys.readouterr().err


def test_rocksat_s_base_moves_whatever_its_arm_does(capsys):
    assert cli.main(["hil", "rocksat", "--controller", "learning_pi"]) == cli.BAD_INPUT
    assert "nothing to control" in capsys.readouterr().err
