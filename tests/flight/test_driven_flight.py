"""Servo drives and all sensors in one world: set points move the arm, the arm moves the base, the flight answers."""

import contextlib
import json
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil_sim.buses.in_process import in_process
from hil_sim.driven_flight import DrivenFlight
from hil_sim.scenario.tables import ScenarioError
from hil_sim.serve_driven import world
from onboard import cli, config
from onboard.flight import hil
from onboard.recording.format.errors import ChannelError, LogFormatError
from onboard.recording.reader import LogReader
from tests.flight.driven_bench import swings_csv

SECONDS = 5.0  # of the motion
BODY = ("m", "c_x", "c_y", "c_z", "I_xx", "I_xy", "I_yy", "I_xz", "I_yz", "I_zz")


def written(directory: Path, seconds: float = SECONDS, torque: bool = False) -> Path:
    """A free-flyer of two driven joints, whose torques are read or not, and a motion for them."""
    path = directory / "it" / "vehicle.toml"
    assert cli.main(["init", str(path.parent), "--base", "free", "--joints", "2", "--encoder", "cia402"]) == cli.OK
    text = path.read_text().replace("torque = true ", f"driven = true\ntorque = {str(torque).lower()} ")
    text = text.replace("row_rate_hz = 100 ", "row_rate_hz = 50 ") if torque else text
    if not torque:
        text = re.sub(r"torque_\w+ = .*\n", "", text)
        text = text[: text.index("[estimation.prior.absolute]")]
    path.write_text(f'{text}\n[drive]\narmed = true\nmotion = "motion.csv"\nsync_limit_ms = 100\n')
    (path.parent / "motion.csv").write_text(swings_csv(seconds, 100))
    return path


@contextlib.contextmanager
def plugged(mission: DrivenFlight) -> Iterator[dict[str, str]]:
    """The world on buses in this process."""
    with (
        tempfile.TemporaryDirectory() as directory,
        in_process(mission.scenario.bus, Path(directory), lambda: mission.now_ns, seed=1) as ports,
    ):
        mission.attach(ports.buses)
        yield ports.urls


def last_answers(log: LogReader, mission: DrivenFlight) -> dict[str, Any]:
    """Last answers by name: each within three of its sigmas of the truth."""
    truth, rows = mission.truth()["quantities"], log.read("quantity")
    last = {row["name"].decode(): row for row in rows[-len(BODY) :]}
    assert set(last) == {f"{name}_payload" for name in BODY}
    errors = {name: (row["value"] - truth[name]) / row["sigma"] for name, row in last.items()}
    assert np.isfinite(list(errors.values())).all()
    assert max(map(abs, errors.values())) < 3.0, errors
    return last


@pytest.mark.campaign  # by servos: test_servo_arm; by torques that are read: test_joint_torques
def test_a_flight_by_its_own_drives_tells_what_it_holds(tmp_path: Path) -> None:
    """Torques that are read are what moves the arm and what the drives' friction takes."""
    vehicle = written(tmp_path, torque=True)
    mission, log = world(vehicle, None, 8, SECONDS + 3.0), tmp_path / "flight.mcap"
    with plugged(mission) as urls:
        armed = config.load(vehicle).model_copy(update={"arm": True})
        hil.fly_simulated(armed, mission, urls, log)
    codes = LogReader(log).read("event")["code"].tolist()
    assert b"drive_started" in codes
    assert b"drive_done" in codes
    last = last_answers(LogReader(log), mission)
    assert last["m_payload"]["sigma"] < 0.3 * mission.truth()["quantities"]["m_payload"]
    gyro = LogReader(log).read("imu_base")["gyro_raw"]
    assert (np.ptp(gyro, axis=0)[[1, 2]] > 500).all()  # the arm turned the base


@pytest.mark.campaign  # asked for until enough is known: before/planning/test_segments; played: test_asked_segments
def test_the_flight_asks_its_drives_for_motions_until_it_knows_enough(tmp_path: Path) -> None:
    """Asked for by the estimation, played by the acquisition, felt by the base, seen in the answer."""
    vehicle, segments = written(tmp_path), tmp_path / "plan" / "segments.npz"
    vehicle.write_text(vehicle.read_text().replace('motion = "motion.csv"', ""))
    fast = ["--segments", "--masses", "0.7,3", "--starts", "1", "--iterations", "3"]
    told = tmp_path / "plan.json"
    assert cli.main(["plan", str(vehicle), *fast, "--output", str(segments.parent), "--json", str(told)]) == cli.OK
    planned = json.loads(told.read_text())
    assert planned["masses_kg"] == [0.7, 3.0]
    assert all(one["duration_s"] > 0.0 and len(one["limit"]) == 2 for one in planned["segments"])
    vehicle.write_text(f'{vehicle.read_text()}\n[mission]\nuntil = "mass 30 %"\nsegments = "{segments}"\n')
    mission, log = world(vehicle, None, 7, 60.0), tmp_path / "flight.mcap"
    with plugged(mission) as urls:
        hil.fly_simulated(config.load(vehicle).model_copy(update={"arm": True}), mission, urls, log)
    reader = LogReader(log)
    assert b"goal_met" in reader.read("event_estimation")["code"].tolist()
    played = [text for text in reader.read("event")["text"].tolist() if text.endswith(b" is played")]
    assert any(b"kg is played" in text for text in played)
    last = last_answers(reader, mission)
    assert last["m_payload"]["sigma"] < 0.2 * mission.truth()["quantities"]["m_payload"]


@pytest.mark.campaign  # of a worker: test_driving; what stops a flight, on the real clock: test_servo_arm
def test_a_drive_that_trips_ends_the_motion(tmp_path: Path) -> None:
    vehicle = written(tmp_path)
    mission, log = world(vehicle, None, 8, 3.5, ["trip:joint_1:2.5:"]), tmp_path / "flight.mcap"
    with plugged(mission) as urls:
        armed = config.load(vehicle).model_copy(update={"arm": True})
        hil.fly_simulated(armed, mission, urls, log)
    codes = LogReader(log).read("event")["code"].tolist()
    assert b"drive_stopped" in codes
    assert b"drive_done" not in codes
    assert all(abs(drive.axis.rate_rad_s) < 1e-3 for drive in mission.drives.values())


def test_what_cannot_be_driven_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(path.read_text().replace("driven = true", "driven = false"))
    with pytest.raises(ScenarioError, match="nothing could be driven"):
        world(path, None, 1, 10.0)
    path.write_text(path.read_text().replace("driven = false", "driven = true"))
    over = tmp_path / "over.toml"
    over.write_text("[capture]\nearliest_s = 2.0\nlatest_s = 3.0\n")
    with pytest.raises(ScenarioError, match="take capture"):
        world(path, over, 1, 10.0)


def _await(log: Path, seconds: float, flight: "subprocess.Popen[bytes]") -> None:
    """Wait until the drives have played their motion, or were stopped, or the flight is over."""
    deadline, codes = time.monotonic() + seconds, set[bytes]()
    while not codes & {b"drive_done", b"drive_stopped"} and time.monotonic() < deadline and flight.poll() is None:
        time.sleep(0.5)
        if log.exists():
            with contextlib.suppress(ChannelError, LogFormatError):  # of a log that has just begun
                codes = set(LogReader(log).read("event")["code"].tolist())


def flown(
    vehicle: Path, seed: int, seconds: float, longer_s: float = 0.0, *fault: str
) -> tuple[int, Path, dict[str, Any]]:
    """Exit status and log of a flight on the real clock, ``longer_s`` beyond its drives' stop, and what was true."""
    log, directory = vehicle.parent / f"{seed}.mcap", vehicle.parent / f"served_{seed}"
    serve = [sys.executable, "-m", "hil_sim.serve_driven", str(vehicle), "--directory", str(directory)]
    fly = [sys.executable, "-m", "onboard.cli", "fly", str(vehicle), "--arm", "--log", str(log)]
    with subprocess.Popen([*serve, "--seed", str(seed), *fault], stdout=subprocess.PIPE, text=True) as devices:
        try:
            assert devices.stdout is not None
            urls = json.loads(devices.stdout.readline())
            flight = subprocess.Popen([*fly, *(f"--url={bus}={url}" for bus, url in urls.items() if bus != "start_ns")])
            try:
                _await(log, seconds, flight)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    flight.wait(longer_s)
                flight.send_signal(signal.SIGTERM)
                status = flight.wait(60)
            finally:
                flight.kill()
            time.sleep(0.5)
        finally:
            devices.terminate()
        return status, log, json.loads(devices.stdout.readline())


@pytest.mark.campaign  # drives on the real clock: test_driving_processes; their base: above
@pytest.mark.realtime
@pytest.mark.usefixtures("own_rings")
def test_on_the_real_clock_the_base_moves_as_the_drives_do(tmp_path: Path) -> None:
    """The motion is played; on a computer too busy for that the drives are stopped, with the reason, and hold."""
    vehicle = written(tmp_path, 4.0)
    for seed in range(3):
        status, log, said = flown(vehicle, seed, 50.0)
        assert status == cli.OK
        events = LogReader(log).read("event")
        codes = events["code"].tolist()
        if b"drive_done" in codes:
            break
        assert b"drive_stopped" in codes
        why = b" ".join(events["text"][events["code"] == b"drive_stopped"]).decode()
        assert any(late in why for late in ("SYNC", "8130h")), why  # 8130h: our heartbeat came too late
    else:
        assert {said["joints"][name]["state"] for name in ("joint_1", "joint_2")} <= {"07h", "40h"}
        return
    for name in ("joint_1", "joint_2"):
        joint = said["joints"][name]
        assert joint["highest_rad"] - joint["lowest_rad"] > 0.2
        assert joint["state"] == "40h"
    gyro = LogReader(log).read("imu_base")["gyro_raw"]
    assert (np.ptp(gyro, axis=0)[[1, 2]] > 300).all()
