"""Vehicles of ``heft init`` with a device that people own each: in real time, on the desk, and what is refused."""

import json
import time
from typing import NamedTuple

import pytest

from onboard.cli import main
from tests.flight.check.test_desk import served
from tests.flight.test_i2c_devices import codes_of, rehearsed
from tests.hil_sim.devices.twin_bench import MS

FIXED = ["--base", "fixed", "--joints", "2"]
FREE = ["--base", "free", "--joints", "2"]


class Rehearsal(NamedTuple):
    """A vehicle and what happens to it in 7 s of real time.

    Attributes:
        init: Arguments of ``heft init``.
        faults: What breaks; it comes back.
        rows: Fewest of a channel.
    """

    init: list[str]
    faults: tuple[str, ...]
    rows: dict[str, int]


REHEARSALS = {  # each device once: what one does while it is away is not to reach the others
    "bmi088 as5048a bota_ft": Rehearsal(
        [*FREE, "--imu", "bmi088", "--encoder", "as5048a", "--load-cell", "bota_ft"],
        ("silent:imu_base:2:3", "silent:joint_1:3:4", "unplug:tty_wrist:4:5"),
        {"imu_base": 6720, "joint_2": 800, "mz": 1200},
    ),
    "bmi088_spi as5048b robotous_rft": Rehearsal(
        [*FREE, "--imu", "bmi088_spi", "--encoder", "as5048b", "--load-cell", "robotous_rft"],
        ("silent:imu_base:2:3", "silent:joint_1:3:4", "unplug:tty_wrist:4:5"),
        {"imu_base": 6720, "joint_2": 800, "mz": 600},
    ),
    "icm20948 as5600 nau7802": Rehearsal(
        [*FREE, "--imu", "icm20948", "--encoder", "as5600", "--load-cell", "nau7802"],
        ("silent:imu_base:2:3", "silent:joint_1:3:4", "silent:load_cell:4:5"),
        {"imu_base": 2756, "joint_2": 800, "load_cell": 300},
    ),
    "dynamixel": Rehearsal(
        [*FIXED, "--encoder", "dynamixel"],
        ("unplug:tty_servos:2:3",),
        dict.fromkeys(("joint_1", "joint_1_torque", "joint_2", "joint_2_torque"), 600),
    ),
    "odrive": Rehearsal(
        [*FIXED, "--encoder", "odrive"], ("unplug:odrives:2:3",), {"joint_1": 300, "joint_1_torque": 300}
    ),
    "onrobot_hex": Rehearsal([*FIXED, "--load-cell", "onrobot_hex"], ("unplug:box:2:3.5",), {"mz": 1200}),
    "hx711": Rehearsal([*FIXED, "--load-cell", "hx711"], ("silent:load_cell:2:3",), {"load_cell": 300}),
}


def init_of(kind: str) -> list[str]:
    """Arguments of ``heft init`` for a vehicle with it."""
    return next(rehearsal.init for rehearsal in REHEARSALS.values() if kind in rehearsal.init)


IN_CI = ("bmi088 as5048a bota_ft", "dynamixel", "onrobot_hex")  # I2C and SPI, a stream, servos, datagrams


@pytest.mark.parametrize(
    "rehearsal",
    [
        pytest.param(one, id=name, marks=[] if name in IN_CI else [pytest.mark.campaign])
        for name, one in REHEARSALS.items()
    ],
)
@pytest.mark.realtime
@pytest.mark.timeout(180)
def test_it_flies_in_real_time_and_comes_back(tmp_path, rehearsal):
    faults = [word for fault in rehearsal.faults for word in ("--fault", fault)]
    _, log, _ = rehearsed(tmp_path, rehearsal.init, "--realtime", *faults, rest=3.0, swing=4.0)
    for channel, fewest in rehearsal.rows.items():
        assert len(log.read(channel)) > fewest
    for fault in rehearsal.faults:
        assert b"bus_recovered" in codes_of(log, fault.split(":")[1].encode())


@pytest.mark.parametrize(
    ("kind", "bus", "units", "rows"),
    [
        ("bota_ft", "tty_wrist", "N N N Nm Nm Nm", 300),
        ("robotous_rft", "tty_wrist", "N N N Nm Nm Nm", 200),
        ("onrobot_hex", "box", "N N N Nm Nm Nm", 300),
        ("as5048a", "spi_1", "rad", 200),
        ("as5048b", "i2c_1", "rad", 200),
        ("bmi088", "i2c_1", "rad/s rad/s rad/s m/s^2 m/s^2 m/s^2", 150),
        ("bmi088_spi", "imu_spi", "rad/s rad/s rad/s m/s^2 m/s^2 m/s^2", 150),
        ("hx711", "cell_lines", "N", 50),
    ],
)
@pytest.mark.realtime
def test_it_is_tried_on_the_desk(tmp_path, kind, bus, units, rows):
    assert main(["init", str(tmp_path / "mine"), *init_of(kind)]) == 0
    report = tmp_path / "report.json"
    with served(str(tmp_path / "mine" / "vehicle.toml"), tmp_path / "wires") as urls:
        while time.monotonic_ns() < urls["start_ns"] + 500 * MS:  # they start
            time.sleep(0.05)
        asked = ["devices", "--test", kind, "--url", urls[bus], "--seconds", "2"]
        assert main([*asked, "--json", str(report)]) in (0, 4)  # a busy computer reads too slowly, and that is told
    tried = json.loads(report.read_text())["tests"]
    assert {one["kind"] for one in tried} == {kind}
    assert [signal["unit"].replace(" ", "") for one in tried for signal in one["signals"]] == units.split()
    assert all(one["rows"] > rows for one in tried)


def test_one_on_lines_of_its_own_is_tried_by_its_url(capsys):
    assert main(["devices", "--test", "hx711"]) == 2
    assert "--url 'gpio-pair:///dev/gpiochip0?data=5&clock=6'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("kind", "was", "now", "said"),
    [
        ("bota_ft", "baud=460800", "baud=115200", "baud=460800"),
        ("bota_ft", "rate_hz = 400 ", "rate_hz = 300 ", "51,200 over a whole"),
        ("robotous_rft", "baud=115200", "baud=9600", "has 57600, 115200"),
        ("robotous_rft", "rate_hz = 200 ", "rate_hz = 500 ", "sends 333 packets a second at the most"),
        ("robotous_rft", "rate_hz = 200 ", "rate_hz = 300 ", "it is 10, 20, 50"),
        ("onrobot_hex", "rate_hz = 500 ", "rate_hz = 300 ", "1000 / n"),
        ("as5600", "rated_load_N = 50.0", "rated_load_N = 20.0", "its range ends at"),
        ("hx711", "rated_load_N = 50.0", "rated_load_N = 20.0", "its range ends at"),
        ("bmi088_spi", "?second=/dev/spidev1.1", "", "the gyroscope's node is missing"),
    ],
)
def test_what_does_not_fit_it_is_refused_with_the_remedy(tmp_path, capsys, kind, was, now, said):
    assert main(["init", str(tmp_path / "mine"), *init_of(kind)]) == 0
    path = tmp_path / "mine" / "vehicle.toml"
    text = path.read_text()
    assert was in text
    path.write_text(text.replace(was, now))
    assert main(["preflight", str(path)]) != 0
    assert said in capsys.readouterr().err
