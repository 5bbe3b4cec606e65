"""An arm that its own DYNAMIXEL servos move, with every other device of its file, in one world: T0 and real time."""

from pathlib import Path

import numpy as np
import pytest

from hil_sim.serve_driven import world
from onboard import cli, config
from onboard.cli.common import NOT_READY
from onboard.flight import hil
from onboard.recording.reader import LogReader
from tests.flight.driven_bench import swings_csv
from tests.flight.test_driven_flight import flown, plugged

SECONDS = 5.0  # of the motion
TIMEOUT_MS = 50  # in real time each round crosses two processes, which a busy computer may hold up
REAL_TIMING = f"sample_period_ms = 10\ntimeout_ms = {TIMEOUT_MS}"
NEW = ("--joints", "2", "--encoder", "dynamixel")


def written(
    directory: Path, seconds: float = SECONDS, timing: str = "timeout_ms = 10", base: str = "free", elbow: float = 0.4
) -> Path:
    """An arm of ``heft init`` whose servos are driven, and a motion for it that begins with this elbow."""
    path = directory / "it" / "vehicle.toml"
    assert cli.main(["init", str(path.parent), "--base", base, *NEW]) == cli.OK
    text = path.read_text().replace('kind = "dynamixel"', f'kind = "dynamixel"\ndriven = true\n{timing}')
    text = text.replace("row_rate_hz = 100 ", "row_rate_hz = 50 ")
    text = text.replace("gain_N_m_A = 1.78 ", "gain_N_m_A = 13.0 ")  # 30 N m, as the URDF says
    drive = 'armed = true\nmotion = "motion.csv"\nsync_limit_ms = 100\nfollowing_error_rad = 0.4\nafter_stop = "hold"'
    path.write_text(f"{text}\n[drive]\n{drive}\n")
    (path.parent / "motion.csv").write_text(swings_csv(seconds, 50, (0.2, elbow)))
    return path


def test_an_arm_that_hangs_in_gravity_tells_what_its_drives_and_payload_are(tmp_path: Path) -> None:
    """Without torque it would fall: the motion begins where it hangs. docs/servos.md says why no Fv is compared."""
    vehicle = written(tmp_path, base="fixed", elbow=np.pi / 2)
    urdf = vehicle.with_suffix(".urdf")
    urdf.write_text(urdf.read_text().replace('upper="1.5"', 'upper="2.5"'))
    mission, log = world(vehicle, None, 8, SECONDS + 2.5), tmp_path / "flight.mcap"
    with plugged(mission) as urls:
        hil.fly_simulated(config.load(vehicle).model_copy(update={"arm": True}), mission, urls, log)
    reader, truth = LogReader(log), mission.truth()
    assert b"drive_done" in reader.read("event")["code"].tolist()
    last = {row["name"].decode(): row for row in reader.read("quantity")}
    payload, drives = truth["quantities"], truth["drives"]
    wanted = {"MZ_payload": payload["m_payload"] * payload["c_z_payload"]}
    for joint, drive in drives.items():
        wanted |= {f"Fc_{joint}": drive["coulomb_n_m"], f"bias_{joint}_torque": truth[f"{joint}_torque"]["offset_Nm"]}
    errors = {name: (last[name]["value"] - true) / last[name]["sigma"] for name, true in wanted.items()}
    assert max(map(abs, errors.values())) < 3.0, errors
    assert last["Fc_joint_1"]["sigma"] < 0.2 * wanted["Fc_joint_1"]


def test_a_line_that_is_unplugged_ends_the_motion_and_is_read_again(tmp_path: Path) -> None:
    vehicle = written(tmp_path, 4.0)
    mission, log = world(vehicle, None, 8, 5.0, ["unplug:tty_servos:2:3.5"]), tmp_path / "flight.mcap"
    with plugged(mission) as urls:
        hil.fly_simulated(config.load(vehicle).model_copy(update={"arm": True}), mission, urls, log)
    reader = LogReader(log)
    events = reader.read("event")
    codes = events["code"].tolist()
    assert b"drive_stopped" in codes
    assert b"drive_done" not in codes
    assert b"bus_recovered" in codes
    rows = reader.read("joint_1")
    assert rows["host_ns"][-1] - rows["host_ns"][0] > 4e9
    after = rows["value_raw"][rows["host_ns"] > rows["host_ns"][0] + int(3.7e9)]
    assert np.ptp(after) < 6  # it stands where its watchdog stopped it


@pytest.mark.campaign  # servos on it: test_rehearsed_devices; unplugged in motion: above
@pytest.mark.realtime
@pytest.mark.timeout(180)
@pytest.mark.usefixtures("own_rings")
def test_on_the_real_clock_servos_are_driven_unplugged_and_read_again(tmp_path: Path) -> None:
    """A computer too busy for the rounds is refused, or stops the arm earlier; either way it stands at the end."""
    vehicle = written(tmp_path, 20.0, REAL_TIMING)
    for seed in range(8, 11):
        status, log, said = flown(vehicle, seed, 60.0, 6.0, "--fault", "unplug:tty_servos:22:24")
        joints = [said["joints"][name] for name in ("joint_1", "joint_2")]
        assert all(abs(joint["rate_rad_s"]) < 0.05 for joint in joints)
        if status != NOT_READY:
            break
    else:
        assert said["server"]["late_max_ms"] > TIMEOUT_MS  # else a refusal is an error
        assert all(joint["highest_rad"] - joint["lowest_rad"] < 1e-3 for joint in joints)
        return
    assert status == cli.OK
    codes = LogReader(log).read("event")["code"].tolist()
    assert b"drive_armed" in codes
    assert b"drive_stopped" in codes
