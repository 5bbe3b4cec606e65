"""``heft preflight`` against a vehicle with a device of every kind, and against what can be wrong with one."""

import json
import subprocess
import sys

import pytest
from rich.console import Console

from onboard import config
from onboard.cli import main
from onboard.flight.check.preflight import preflight, render
from onboard.flight.estimate.estimator import Estimator
from tests.flight.mixed import DEVICES, MixedWorld, only, vehicle
from tests.hil_sim.devices.twin_bench import MS


def look_over(directory, text=DEVICES, seconds=None, urls=None, told=lambda text: None, **world_is):
    with MixedWorld(directory, text, **world_is) as world:

        def wait(waited_s):
            for _ in range(max(1, round(waited_s * 1e3))):
                world.advance(MS)

        flown = vehicle(directory, {**world.urls, **(urls or {})}, text)
        return preflight(flown, world.clock, wait, seconds=seconds, told=told)


def shown(found):
    console = Console(width=160)
    with console.capture() as text:
        console.print(render(found))
    return text.get()


def problems(found):
    return {check.device: " ".join(check.problems) for check in found.checks if check.problems}


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return look_over(tmp_path_factory.mktemp("preflight"), seconds=1.5)


def test_a_vehicle_as_its_file_says_is_ready(found):
    assert problems(found) == {}
    assert found.problems == ()
    assert found.ready


def test_every_device_is_seen_with_its_rate_and_its_pulses(found):
    by_name = {check.device: check for check in found.checks}
    assert list(by_name) == list(vehicle_devices())
    assert by_name["imu_base"].self_test.startswith("passed")
    assert by_name["elbow"].identity == "QSB-D, serial number 81830, firmware 0x0e"
    for name, hz in (("imu_base", 1000), ("imu_tip", 150), ("shoulder", 200), ("cell", 100), ("wrist", 200)):
        assert by_name[name].rate_hz == pytest.approx(hz, rel=0.02)
    assert {name for name, check in by_name.items() if check.marks} == {"imu_base", "imu_elbow", "elbow", "wrist"}
    for name in ("imu_base", "elbow", "wrist"):
        assert 0.0 < by_name[name].time_sigma_us < 200.0
    assert 0.0 < by_name["imu_elbow"].time_sigma_us < 600.0  # a third of its period: its marks are whole samples
    assert by_name["phase"].nominal_hz is None


def vehicle_devices():
    return [line[8:-1] for line in DEVICES.splitlines() if line.startswith("[device.")]


def test_what_is_shown_names_every_device_and_the_verdict(found):
    text = shown(found)
    assert all(name in text for name in vehicle_devices())
    assert "angle [deg]" in text
    assert text.rstrip().endswith("\nready")


WRONG = (  # in the file, what stands there in its place, whose problem that is, and what is said
    ("rate_hz = 200", "rate_hz = 100", "wrist", "200 Hz where the vehicle file has 100 Hz"),
    ("tick_hz = 1000000", "tick_hz = 8000000", "wrist", "its clock makes 1e+06 ticks/s, tick_hz is 8e+06"),
    ("address = 0x68", "address = 0x69", "imu_base", "0x69 has WHO_AM_I 0x00 (unknown), MPU-6050 has 0x68"),
    ("counts_per_revolution = 500000", "counts_per_revolution = 4096", "shoulder", "encoder has 500000 counts/rev"),
    ("index = 0x2000", "index = 0x2001", "phase", "TPDO1 has no 2001h:01"),
    ("sample_period_ms = 10", "sample_period_ms = 1", "cell", "Hz where the vehicle file has 1000 Hz"),
    ('bus = "tty_imu"', 'bus = "tty_imu"\nchecksum_span = "payload"', "imu_tip", "no valid frame for 500 ms"),
)


def test_a_file_that_does_not_fit_its_devices(tmp_path):
    healthy = "can_sync", "pulse", "tip"  # beside those that the file is wrong about
    text = only(*healthy, *(device for _, _, device, _ in WRONG))
    text = text.replace('frame = "body"\n', 'frame = "body"\naddress = 0x68\n', 1)
    for right, wrong, *_ in WRONG:
        assert right in text
        text = text.replace(right, wrong, 1)
    found = look_over(tmp_path, text, 3.0)
    assert not found.ready
    assert problems(found).keys() == {device for _, _, device, _ in WRONG}
    for _, _, device, said in WRONG:
        assert said in problems(found)[device]


def test_buses_that_are_not_there_and_a_sync_line_that_does_not_reach_the_imu(tmp_path):
    on_can = {"can_sync", "shoulder", "upper", "load_cell", "phase"}
    away = {
        "can_0": "can+socketcan://no_such_can?bitrate=500000",
        "tty_cell": "serial:///dev/no-such-tty?baud=115200",
    }
    text = only(*on_can, "cell", "imu_base", "imu_elbow", "imu_tip", "elbow", "tip", "pulse")
    found = look_over(tmp_path, text, 2.0, urls=away, fsync=False)
    assert problems(found).keys() == on_can | {"cell", "imu_base", "imu_elbow"}
    assert {problems(found)[name] for name in on_can} == {"bus can_0 could not be opened"}
    assert "No such file" in problems(found)["cell"]
    for name in ("imu_base", "imu_elbow"):
        assert "check the sync line to it" in problems(found)[name]
    assert found.problems[0].startswith("can_0: can+socketcan://no_such_can")
    assert shown(found).rstrip().endswith("not ready")


def test_an_imu_that_the_sync_line_is_said_not_to_reach(tmp_path):
    text = only("imu_base", "imu_elbow", "can_sync", "pulse", "tip")
    text = text.replace('frame = "body"\n', 'frame = "body"\nsync_input = false\n', 1)
    found = look_over(tmp_path, text, 1.0, fsync=False)
    imu = {check.device: check for check in found.checks}["imu_base"]
    assert (imu.problems, imu.marks) == ((), None)
    assert 100.0 < imu.time_sigma_us < 2000.0  # by arrival stamps: about a sample


def test_room_for_the_flight(tmp_path):
    text = only("imu_base", "tip", "can_sync", "pulse") + '\n[recording]\ndirectory = "/proc/flights"\n'
    said = []
    found = look_over(tmp_path, text, 0.5, told=said.append)
    assert said == ["self tests", "the devices run for 0.5 s"]
    assert "/proc has room for 0 minutes of this vehicle" in " ".join(found.problems)


def test_what_it_costs_that_no_pulse_is_wired(tmp_path):
    found = look_over(tmp_path, only("imu_base", "imu_elbow", "imu_hand", "elbow", "wrist", "can_sync"), 3.0)
    [said] = [text for text in found.warnings if "no sync pulse is wired" in text]
    known = {check.device: check.time_sigma_us for check in found.checks}
    assert known["imu_base"] > 0.0
    assert f"imu_base {known['imu_base']:.0f} us" in said
    assert all(check.marks is None for check in found.checks)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('frame = "imu_base"', 'frame = "imu_bse"', "frame 'imu_bse' is not in the URDF; did you mean 'imu_base'?"),
        ('joint = "joint_1"', 'joint = "elbow"', "joint 'elbow' is not in the URDF; its moving joints are joint_1"),
        ('payload_link = "tip_mass"', 'payload_link = "tip"', "payload_link 'tip' is not in the URDF"),
    ],
)
def test_what_the_urdf_lacks_is_told_before_a_device_is_opened(tmp_path, capsys, old, new, said):
    for name in ("vehicle.toml", "rocksat.urdf"):
        text = config.packaged("rocksat").with_name(name).read_text(encoding="utf-8")
        (tmp_path / name).write_text(text.replace(old, new) if name == "vehicle.toml" else text, encoding="utf-8")
    assert main(["preflight", str(tmp_path / "vehicle.toml")]) == 2
    assert said in capsys.readouterr().err


SECOND_IMU = """
[bus.i2c_2]
url = "i2c:///dev/i2c-2"
[device.imu_tip]
kind = "mpu6050"
bus = "i2c_2"
frame = "tip_mass"
accel_noise_m_s2 = 0.088
gyro_noise_rad_s = 1.95e-3
"""


def test_a_second_imu_that_moves_with_a_joint_is_told():
    rocksat = config.packaged("rocksat")
    vehicle = config.parse(rocksat.read_text(encoding="utf-8") + SECOND_IMU, rocksat)
    with pytest.raises(config.ConfigError, match="moves with a joint"):
        Estimator(vehicle)


@pytest.mark.realtime
def test_the_command_line_against_devices_in_another_process(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    serve = [sys.executable, "-m", "hil_sim.serve", "rocksat", "--directory", str(tmp_path)]
    with subprocess.Popen(serve, stdout=subprocess.PIPE, text=True) as devices:
        try:
            serving = json.loads(devices.stdout.readline())
            buses = config.load(config.packaged("rocksat")).file.bus
            urls = [part for bus in buses for part in ("--url", f"{bus}={serving[bus]}")]
            assert main(["preflight", "rocksat", *urls]) == 0
            said = capsys.readouterr().out
            assert "self test passed" in said
            assert "expected of the default motion of a rehearsal" in said
            assert (
                main(
                    ["preflight", "rocksat", "--seconds", "2", *urls[:4], "--url", "sync_line=gpio:///dev/null?line=1"]
                )
                == 4
            )
        finally:
            devices.terminate()
