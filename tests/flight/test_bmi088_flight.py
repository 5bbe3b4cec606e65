"""A free arm with a BMI088 flies in virtual and in real time and survives what breaks."""

import pytest

from drivers.records import SampleStatus
from onboard.cli import main
from tests.flight.test_devices import timed
from tests.flight.test_i2c_devices import SPARSE, codes_of, rehearsed
from tests.flight.test_rehearsal import answers, honest

FREE = ["--base", "free", "--joints", "2", "--imu"]
INERTIAL = [*FREE, "bmi088"]


@pytest.mark.campaign  # with an IMU of another kind: test_rehearsal; with what it lost: below; its clock: test_devices
def test_a_free_arm_weighs_with_it(tmp_path):
    result, log, _ = rehearsed(tmp_path, [*FREE, "bmi088_spi"], swing=4.0)
    honest(answers(result))
    assert answers(result)["m_payload"]["supported"]
    rows = log.read("imu_base")
    assert len(rows) > 5.0 * 1600
    assert set(rows["status"]) == {0}
    clock = log.read("clock")
    [sigma_ns] = clock["sigma_ns"][clock["channel"] == b"imu_base"][-1:]
    assert sigma_ns < 0.1e6
    assert codes_of(log, b"imu_base") == [b"started", b"stopped"]
    assert result["channels"]["imu_base"]["missing"] == 0


OF_I2C = "off:imu_base:1.5:2.5 nack:imu_base:3.2:3.5 timeout:imu_base:4.2:4.3 reset:imu_base:5 garbage:imu_base:5.6:5.7"
OF_SPI = "off:imu_base:1.5:2.5 unplug:imu_spi:3:3.5 silent:imu_base:4.2:4.5 reset:imu_base:5 garbage:imu_base:5.6:5.7"


@pytest.mark.parametrize(
    ("kind", "faults"), [("bmi088", OF_I2C), pytest.param("bmi088_spi", OF_SPI, marks=pytest.mark.campaign)]
)
def test_it_survives_unplugging_brown_out_and_garbage(tmp_path, kind, faults):
    asked = (word for fault in faults.split() for word in ("--fault", fault))
    result, log, _ = rehearsed(tmp_path, [*FREE, kind], *asked, swing=4.5, change=SPARSE)
    honest(answers(result))
    told = codes_of(log, b"imu_base")
    assert told.count(b"bus_recovered") >= 3
    assert told.count(b"brown_out") + told.count(b"no_samples") >= 2
    rows = log.read("imu_base")
    assert (rows["status"] & SampleStatus.AFTER_RESET != 0).sum() == told.count(b"started") - 1
    assert rows["host_ns"][-1] - rows["host_ns"][0] > 5.4e9


@pytest.mark.parametrize("name", ["imu_hand", "imu_foot"])
def test_its_samples_are_put_between_request_and_answer(mixed_flight, tmp_path, name):
    _, sigma_ns = timed(mixed_flight.vehicle(tmp_path), mixed_flight.rows, name)
    assert sigma_ns < 0.3e6


def test_a_gyroscope_at_an_address_that_is_taken_is_refused(tmp_path, capsys):
    assert main(["init", str(tmp_path / "it"), *INERTIAL]) == 0
    path = tmp_path / "it" / "vehicle.toml"
    other = path.read_text().partition("[device.imu_base]")[2].partition("\n[")[0].replace("0x18", "0x19")
    path.write_text(path.read_text() + f"\n[device.imu_tip]{other}\n")
    assert main(["preflight", str(path)]) != 0
    assert "shares its I2C address" in capsys.readouterr().err
