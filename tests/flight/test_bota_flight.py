"""A vehicle of ``heft init --load-cell bota_ft`` flies in virtual time and in real time, and survives what breaks."""

import json

import numpy as np
import pytest

from drivers.records import SampleStatus
from onboard.cli import main
from onboard.recording.reader import LogReader
from tests.flight.check.test_desk import served
from tests.flight.test_i2c_devices import rehearsed
from tests.flight.test_rehearsal import answers, honest

WRIST = ["--base", "fixed", "--joints", "2", "--load-cell", "bota_ft"]
SIX = ("fx", "fy", "fz", "mx", "my", "mz")
WARM = ("component = 1\n", "component = 1\ntemperature = true\n")


def told(log: LogReader) -> list[bytes]:
    """Codes of the sensor's events."""
    events = log.read("event")
    return events["code"][events["source"] == b"tty_wrist"].tolist()


@pytest.mark.parametrize("rate", [800, 100])
def test_a_payload_is_weighed_with_it(tmp_path, rate):
    result, log, _ = rehearsed(tmp_path, WRIST, change=("rate_hz = 400 ", f"rate_hz = {rate} "))
    assert result["accounted"]
    honest(answers(result))
    assert answers(result)["M_payload"]["supported"]
    assert told(log) == [b"started", b"stopped"]
    for name in SIX:
        assert len(log.read(name)) > 7.9 * rate  # the first second it starts
        assert result["channels"][name]["missing"] == 0


def test_it_survives_unplugging_brown_out_and_what_is_lost_on_the_line(tmp_path):
    faults = [
        *("--fault", "unplug:tty_wrist:2:2.3", "--fault", "reset:fx:4", "--fault", "off:mz:5.5:5.8"),
        *("--fault", "silent:fy:7.5:7.7", "--fault", "byte_loss:tty_wrist:7.8:8.2:0.002"),
        *("--fault", "saturated:fz:8.3:8.5:1", "--fault", "garbage:my:8.6:8.7"),
    ]
    result, log, _ = rehearsed(tmp_path, WRIST, *faults, change=WARM)
    assert result["accounted"]
    honest(answers(result))
    codes = told(log)
    assert (codes.count(b"bus_error"), codes.count(b"bus_recovered"), codes.count(b"restarted")) == (1, 1, 2)
    assert codes.count(b"sensor_status") == codes.count(b"sensor_normal") == 1
    rows = log.read("fz")
    assert (rows["status"] & SampleStatus.AFTER_RESET != 0).sum() == 2
    assert (rows["status"] & SampleStatus.SATURATED != 0).sum() == pytest.approx(80, abs=2)
    assert rows["host_ns"][-1] - rows["host_ns"][0] > 7.9e9
    warm = log.read("fx_temperature")
    assert (warm["sequence"] == rows["sequence"]).all()
    assert np.ptp(warm["value_raw"] * warm["scale"]) < 0.1
    causes = set(log.read("gap")["cause"].tolist())
    assert causes >= {b"port_lost", b"frames_lost"}


def test_another_speed_of_the_line_and_another_rate_are_refused_with_the_remedy(tmp_path, capsys):
    for number, (was, now, said) in enumerate(
        [("baud=460800", "baud=115200", "baud=460800"), ("rate_hz = 400 ", "rate_hz = 300 ", "51,200 over a whole")]
    ):
        directory = tmp_path / str(number)
        assert main(["init", str(directory), *WRIST]) == 0
        path = directory / "vehicle.toml"
        path.write_text(path.read_text().replace(was, now))
        assert main(["preflight", str(path)]) != 0
        assert said in capsys.readouterr().err


@pytest.mark.realtime
@pytest.mark.timeout(180)
def test_it_flies_in_real_time_and_comes_back(tmp_path):
    result, log, _ = rehearsed(tmp_path, WRIST, "--realtime", "--fault", "unplug:tty_wrist:2:3", swing=4.0)
    assert result["accounted"]
    assert len(log.read("mz")) > 1200
    assert b"bus_recovered" in told(log)


@pytest.mark.realtime
def test_it_is_found_and_tried_on_the_desk(tmp_path):
    assert main(["init", str(tmp_path / "mine"), *WRIST]) == 0
    report = tmp_path / "report.json"
    with served(str(tmp_path / "mine" / "vehicle.toml"), tmp_path / "wires") as urls:
        asked = ["devices", "--test", "bota_ft", "--url", urls["tty_wrist"], "--seconds", "2"]
        assert main([*asked, "--json", str(report)]) in (0, 4)  # a busy computer reads too slowly, and that is told
    tests = json.loads(report.read_text())["tests"]
    assert {one["kind"] for one in tests} == {"bota_ft"}
    assert all(one["rows"] > 300 for one in tests)
