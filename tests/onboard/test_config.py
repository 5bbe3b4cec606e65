"""Bad vehicle files: the line, the reason, the remedy."""

from pathlib import Path

import pytest

from onboard import config
from onboard.flight.estimator import Estimator

TEXT = config.packaged("rocksat").read_text()


def refuse(old: str, new: str) -> str:
    assert TEXT.count(old) >= 1
    with pytest.raises(config.ConfigError) as caught:
        config.parse(TEXT.replace(old, new, 1), config.packaged("rocksat"))
    return str(caught.value)


def line_of(text: str, start: str) -> int:
    return next(n for n, line in enumerate(text.splitlines(), 1) if line.startswith(start))


def test_the_packaged_vehicle_reads() -> None:
    vehicle = config.load(config.packaged("rocksat"))
    assert list(vehicle.devices_on("can_0")) == ["can_sync", "joint_1", "load_cell", "arm_phase"]
    assert vehicle.urdf_path.is_file()


def test_an_unknown_key_names_line_and_the_key_meant() -> None:
    message = refuse("poll_period_ms = 10", "poll_period_s = 0.01")
    assert f"vehicle.toml:{line_of(TEXT, 'poll_period_ms')}:" in message
    assert "'device.imu_base.poll_period_s'" in message
    assert "did you mean 'poll_period_ms'" in message


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('bus = "i2c_1"', 'bus = "i2c_9"', "no bus 'i2c_9'; there are: i2c_1, can_0, sync_line"),
        ("address = 0x68", "address = 0x10", "greater than or equal to 104"),
        ('kind = "mpu6050"', 'kind = "mpu9999"', "'cia404'"),
        ("node = 2\n", "", "'device.load_cell.node' is missing"),
        ("[estimation.gates]", "[estimation.gate]", "did you mean 'gates'"),
        ('channel = "arm_phase"', 'channel = "phase"', "no device 'phase'"),
        ('urdf = "rocksat.urdf"', 'urdf = "lost.urdf"', "put the URDF beside the vehicle file"),
        ("[vehicle]", "[vehicle", "not TOML"),
        ('base = "prescribed"', 'base = "floating"', "'free', 'prescribed' or 'fixed'"),
        ("lever_m = 0.040", "lever_mm = 40", "did you mean 'lever_m'"),
    ],
)
def test_other_mistakes(old: str, new: str, expected: str) -> None:
    assert expected in refuse(old, new)


def without(device: str) -> str:
    start = TEXT.index(f"[device.{device}]")
    return TEXT[start : TEXT.index("[device.", start + 1)]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (without("imu_base"), "", "no device is an IMU"),
        (without("can_sync"), "", "bus 'can_0' has 0 canopen_sync devices; it needs one"),
        ('bus = "i2c_1"', 'bus = "can_0"', "bus 'can_0' has devices of CAN and I2C"),
    ],
)
def test_devices_that_cannot_fly_together(old: str, new: str, expected: str) -> None:
    assert expected in refuse(old, new)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('frame = "imu_base"', 'frame = "nose"', "no link, joint or frame 'nose'"),
        (
            'joint = "joint_1"\ncounts',
            'joint = "elbow"\ncounts',
            "moving joints are joint_1, the devices measure elbow",
        ),
        ("arm = 1.0, ", "", "give a relative sigma for each of plate, arm, tip_mass"),
    ],
)
def test_names_that_the_urdf_does_not_have_are_refused_before_the_flight(old: str, new: str, expected: str) -> None:
    assert old in TEXT
    vehicle = config.parse(TEXT.replace(old, new, 1), config.packaged("rocksat"))
    with pytest.raises(config.ConfigError, match=expected):
        Estimator(vehicle)


def test_a_missing_file_says_so(tmp_path: Path) -> None:
    with pytest.raises(config.ConfigError, match=r"No such file.*give the path of a vehicle\.toml"):
        config.load(tmp_path / "nowhere.toml")


def test_urls_can_be_replaced_and_nothing_else_changes() -> None:
    vehicle = config.load(config.packaged("rocksat"))
    other = vehicle.with_urls({"can_0": "can+virtual://x"})
    assert other.file.bus["can_0"].url == "can+virtual://x"
    assert other.file.bus["i2c_1"] == vehicle.file.bus["i2c_1"]
    assert other.file.device == vehicle.file.device
