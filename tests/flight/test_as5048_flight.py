"""A vehicle of ``heft init`` with AS5048s on SPI or I2C flies in virtual and in real time and survives what breaks."""

import tomllib

import numpy as np
import pytest

from drivers.records import SampleStatus
from onboard.cli import main
from tests.flight.test_i2c_devices import SPARSE, codes_of, rehearsed
from tests.flight.test_rehearsal import answers, honest

ARM = ["--base", "fixed", "--joints", "2", "--load-cell", "nau7802", "--encoder"]
JOINTS = "joint_1", "joint_2"


def test_an_arm_of_magnets_is_weighed_with(tmp_path):
    result, log, _ = rehearsed(tmp_path, [*ARM, "as5048a"], swing=7.0, seed=6)
    honest(answers(result))
    moment = answers(result)["MY_payload"]
    assert moment["supported"]
    assert abs(moment["value"] - moment["truth"]) < 2e-3  # kg m; through 100 ms it was 12 to 18e-3 off
    for joint in JOINTS:
        rows = log.read(joint)
        assert len(rows) > 8.0 * 200
        assert set(rows["status"]) == {0}
        assert set(rows["device_status"]) == {0x01}
        assert result["channels"][joint]["missing"] == 0
    noise = [np.diff(np.unwrap(log.read(joint)["value_raw"].astype(float), period=2**14)[:1600], 3) for joint in JOINTS]
    assert abs(np.corrcoef(noise)[0, 1]) < 0.1  # two chips have noise of their own


@pytest.mark.campaign  # the driver: test_magnets, test_as5048
@pytest.mark.parametrize("kind", ["as5048a", "as5048b"])
def test_a_magnet_that_comes_loose_is_named_and_what_breaks_is_survived(tmp_path, kind):
    faults = [
        *("--fault", "field:joint_1:2:3:-0.7", "--fault", "field:joint_2:3:3.5:0.8", "--fault", "off:joint_2:4:4.5"),
        *("--fault", "silent:joint_1:4.8:5.1", "--fault", "garbage:joint_2:5.4:5.6"),
    ]
    result, log, _ = rehearsed(tmp_path, [*ARM, kind], *faults, swing=4.5, change=SPARSE)
    honest({name: row for name, row in answers(result).items() if row["supported"]})
    events = log.read("event")
    told = {(event["source"], event["code"]) for event in events}
    assert told >= {(b"joint_1", b"magnet_weak"), (b"joint_1", b"magnet_over"), (b"joint_2", b"magnet_strong")}
    assert told >= {(b"joint_1", b"bus_recovered"), (b"joint_2", b"bus_recovered")}
    assert (log.read("joint_1")["status"] & SampleStatus.NOT_VALID != 0).sum() == pytest.approx(200, abs=2)
    rows = log.read("joint_2")
    assert rows["host_ns"][-1] - rows["host_ns"][0] > 5.8e9


@pytest.mark.campaign  # an adapter of I2C: test_bmi088_flight; SPI: test_as5048
def test_an_adapter_that_is_unplugged_comes_back(tmp_path):
    result, log, _ = rehearsed(tmp_path, [*ARM, "as5048a"], "--fault", "unplug:spi_1:2:3", swing=4.5, change=SPARSE)
    honest({name: row for name, row in answers(result).items() if row["supported"]})
    assert codes_of(log, b"joint_1").count(b"bus_recovered") == 1
    assert 190 < result["channels"]["joint_1"]["missing"] < 420


def test_heft_init_gives_each_joint_a_select_line(tmp_path):
    assert main(["init", str(tmp_path / "it"), *ARM, "as5048a"]) == 0
    buses = tomllib.loads((tmp_path / "it" / "vehicle.toml").read_text())["bus"]
    assert [buses[name]["url"] for name in ("spi_1", "spi_2")] == ["spi:///dev/spidev0.0", "spi:///dev/spidev0.1"]
