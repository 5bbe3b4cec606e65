"""``heft devices --test``: devices at rest on a desk, against emulators in virtual time, and served on real ones."""

import contextlib
import json
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from onboard.cli import BAD_INPUT, OK, main
from onboard.cli.common import NOT_READY
from onboard.flight.check.desk import DeskTest, alone, desk_tests, render
from tests.flight.mixed import DEVICES, MixedWorld, only, vehicle, without
from tests.hil_sim.devices.twin_bench import MS

ROOT = Path(__file__).resolve().parents[3]
NAMES = ("imu_base", "bridge", "tip", "wrist", "shoulder", "servo_6")
LINES, COLUMNS = 24, 80  # of a terminal


def tried(directory: Path, names: tuple[str, ...], text: str = DEVICES, seconds: float = 11.0) -> dict[str, DeskTest]:
    """Devices of the vehicle with every kind, by name; 11 s are ten windows of a second."""
    with MixedWorld(directory, text) as world:

        def wait(waited_s: float) -> None:
            for _ in range(max(1, round(waited_s * 1e3))):
                world.advance(MS)

        whole = vehicle(directory, world.urls, text)
        return {
            one.seen.device: one for one in desk_tests(alone(whole, names), names, world.clock, wait, None, seconds)
        }


def shown(test: DeskTest) -> list[str]:
    """The lines of its screen."""
    console = Console(width=COLUMNS)
    with console.capture() as text:
        console.print(render(test))
    return text.get().rstrip("\n").split("\n")


def noisy_tip(stated: str) -> str:
    """The vehicle's devices, of which the angle ``tip`` has that noise, rad."""
    text = only(*NAMES, "can_sync", "pulse", "imu_elbow", "bridge", "upper")
    assert "noise_rad = 9e-4" in text
    return text.replace("noise_rad = 9e-4", f"noise_rad = {stated}")


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, DeskTest]:
    return tried(tmp_path_factory.mktemp("desk"), NAMES, noisy_tip("1e-9"))


def test_rate_and_clock_are_those_of_the_emulators(found: dict[str, DeskTest]) -> None:
    assert tuple(found) == tuple(name for name in found if name in NAMES)
    assert set(found) == set(NAMES)
    for name, test in found.items():
        assert test.problems == (), name
        assert test.seen.rate_hz == pytest.approx(test.seen.nominal_hz, rel=0.02), name
        assert (test.lost, test.longest_gap_s) == (0, 0.0), name
    fast = {"imu_base": 4000.0, "bridge": 7000.0, "wrist": -1000.0}  # ppm, as the world is made
    assert {name for name, test in found.items() if test.clock_ppm is not None} == set(fast)
    for name, ppm in fast.items():
        test = found[name]
        assert test.clock_ppm is not None
        assert test.clock_sigma_ppm is not None
        assert abs(test.clock_ppm - ppm) < 4.0 * test.clock_sigma_ppm < 400.0, name
    assert found["tip"].clock == "the computer's, between request and answer"
    assert found["shoulder"].clock == "that of can_sync"


def test_what_a_device_measures_is_there_with_what_is_stated(found: dict[str, DeskTest]) -> None:
    axes = [f"{what} {axis}" for what in ("gyro", "accel") for axis in "xyz"]
    assert [one.name for one in found["imu_base"].signals] == axes
    [force] = found["bridge"].signals
    assert (force.unit, force.stated) == ("N", 0.0025)
    assert force.mean == pytest.approx(12.7, abs=0.2)
    assert force.drift == pytest.approx(0.02 * 11.0, rel=0.1)  # it rises by 20 mN/s, which is no noise
    assert force.noise is not None
    assert force.noise < 0.0025
    assert found["imu_base"].seen.self_test.startswith("passed")
    assert found["bridge"].seen.self_test == ""


def test_a_screen_of_80_columns_says_it(found: dict[str, DeskTest]) -> None:
    for test in found.values():
        lines = shown(test)
        assert len(lines) < LINES
        assert max(map(len, lines)) <= COLUMNS
        assert test.seen.device in lines[0]
    said = "\n".join(shown(found["bridge"]))
    assert "clock      device's, 7000 ± " in said.replace("6999", "7000").replace("7001", "7000")
    assert "self test  it has none" in said
    loud = [
        text for text in found["imu_base"].warnings if "noise" in text
    ]  # it turns by a stair, faster than is stated
    assert [text.split(":")[0] for text in loud] == ["gyro x, gyro y, gyro z"]


def test_more_noise_than_is_stated_is_said_with_the_remedy(tmp_path: Path, found: dict[str, DeskTest]) -> None:
    """An angle that moves has noise beside its line; the same one is quiet where a radian is stated."""
    for test, loud in ((found["tip"], True), (tried(tmp_path, ("tip",), noisy_tip("1.0"), 4.0)["tip"], False)):
        assert [one.too_loud for one in test.signals] == [loud]
        assert any("state it, or look for what shakes it" in said for said in test.warnings) == loud
        assert shown(test)[-1].strip() == ("look" if loud else "good")


def test_another_chip_at_its_address(tmp_path: Path) -> None:
    text = without("imu_elbow").replace('frame = "body"\n', 'frame = "body"\naddress = 0x69\n', 1)
    test = tried(tmp_path, ("imu_base",), text, 1.0)["imu_base"]
    assert any("0x69 has WHO_AM_I 0x00 (unknown), MPU-6050 has 0x68" in said for said in test.problems)
    assert test.signals == ()
    assert shown(test)[-1].strip() == "not ready"


@contextlib.contextmanager
def served(vehicle: str, directory: Path) -> Iterator[dict[str, Any]]:
    """An arm in a process of its own: I2C and TCP on sockets, servos on a pseudo-terminal."""
    command = [sys.executable, "-m", "hil_sim.serve", vehicle, "--directory", str(directory), "--wait"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, cwd=ROOT, text=True, **pipes) as process:  # type: ignore[call-overload]
        ready = json.loads(process.stdout.readline())
        process.stdin.write("start\n")
        process.stdin.flush()
        yield ready | json.loads(process.stdout.readline())
        process.terminate()


@pytest.fixture
def student(tmp_path: Path) -> Iterator[dict[str, Any]]:
    with served("student_arm", tmp_path) as told:
        yield told


@pytest.mark.realtime
def test_from_the_command_by_kind_and_by_the_vehicle_file(student: dict[str, Any], tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    while time.monotonic_ns() < student["start_ns"] + 500 * MS:  # servos boot
        time.sleep(0.05)
    short = ["--seconds", "2", "--json", str(report)]
    ran = OK, NOT_READY  # a busy computer reads too slowly, and that is told
    assert main(["devices", "--test", "nau7802", "--url", student["i2c_1"], *short]) in ran
    [cell] = json.loads(report.read_text())["tests"]
    assert (cell["kind"], cell["signals"][0]["unit"]) == ("nau7802", "N")
    assert cell["rows"] > 20
    assert main(["devices", "--test", "dynamixel", "--url", student["tty_servos"], *short]) in ran
    tests = json.loads(report.read_text())["tests"]
    assert [one["device"] for one in tests] == [f"joint_{k}" for k in range(1, 5)]
    servos = ["--vehicle", "student_arm", "--url", f"tty_servos={student['tty_servos']}"]
    code = main(["devices", "--test", "dynamixel", *servos, *short])
    assert code in ran
    tests = json.loads(report.read_text())["tests"]
    assert [one["device"] for one in tests] == [f"joint_{k}" for k in range(1, 5)]
    answered = [one["rows"] > 20 for one in tests]  # a simulated servo that is late five times is taken for silent
    assert all(answered) or (code == NOT_READY and any(answered))
    assert [one["name"] for one in tests[0]["signals"]] == ["joint_1", "joint_1_torque"]
    assert main(["devices", "--test", "as5600", "--url", student["i2c_1"]]) == BAD_INPUT


@pytest.mark.realtime
def test_a_controller_at_an_address_is_named_and_its_joints_are_tried(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a vehicle file, over a real TCP connection; what is said is what a table of it takes."""
    report = tmp_path / "report.json"
    with served("lab_ur", tmp_path) as told:
        assert main(["devices", "--url", told["robot"], "--json", str(report)]) == OK
        assert "URControl 5.16.1.0: number = 6 -> ur_joint" in capsys.readouterr().out
        tables = tomllib.loads(json.loads(report.read_text())["vehicle_toml"])
        assert [table["number"] for table in tables["device"].values()] == [1, 2, 3, 4, 5, 6]
        assert [bus["url"] for bus in tables["bus"].values()] == [told["robot"]]
        tried = ["--test", "ur_joint", "--url", told["robot"], "--seconds", "2", "--json", str(report)]
        assert main(["devices", *tried]) in (OK, NOT_READY)
        tests = json.loads(report.read_text())["tests"]
        assert [one["device"] for one in tests] == [f"joint_{k}" for k in range(1, 7)]
        assert all(one["rows"] > 60 for one in tests)
        assert {one["signals"][0]["unit"] for one in tests} == {"rad"}
        assert tests[1]["signals"][0]["mean"] == pytest.approx(-1.3, abs=0.25)
        assert main(["devices", "--test", "dynamixel", "--url", told["robot"], "--seconds", "2"]) == BAD_INPUT


def test_a_bus_that_cannot_be_opened_is_not_ready(capsys: pytest.CaptureFixture[str]) -> None:
    there = ["--vehicle", "student_arm", "--url", "tty_servos=serial:///dev/no-such-tty?baud=1000000"]
    assert main(["devices", "--test", "joint_2", *there, "--seconds", "0.3"]) == NOT_READY
    assert "No such file" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--test", "hx712"], "no kind that can be tried without a vehicle file"),
        (["--test", "qsb"], "--url 'serial:///dev/ttyUSB0?baud=230400'"),
        (["--test", "ur_joint"], "--url 'tcp://192.168.56.101:30004'"),
        (["--test", "ur_joint", "--url", "tcp://127.0.0.1:9"], "no ur_joint answers on a bus"),
        (["--test", "ur_joint", "--url", "tcp://192.168.56.101"], "write tcp://192.168.0.10:30004"),
        (["--test", "elbow", "--vehicle", "student_arm"], "no device or kind 'elbow' on a bus; there are: imu_base"),
        (["--test", "nau7802", "--seconds", "0"], "give the length of the test"),
        (["--seconds", "5"], "--vehicle and --seconds are of --test"),
        (["--test", "nau7802", "--url", "serial:///dev/ttyUSB0?baud=9600"], "no nau7802 answers on a bus"),
    ],
)
def test_what_cannot_be_tried_is_a_sentence(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["devices", *arguments]) == BAD_INPUT
    assert said in " ".join(capsys.readouterr().err.split())
