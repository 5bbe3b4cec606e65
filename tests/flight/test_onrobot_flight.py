"""A vehicle of ``heft init --load-cell onrobot_hex`` flies in virtual and in real time, and survives what breaks."""

import json

import pytest

from drivers.records import SampleStatus
from onboard.cli import main
from tests.flight.check.test_desk import served
from tests.flight.test_i2c_devices import codes_of, rehearsed
from tests.flight.test_rehearsal import answers, honest

WRIST = ["--base", "fixed", "--joints", "2", "--load-cell", "onrobot_hex"]
SIX = ("fx", "fy", "fz", "mx", "my", "mz")


@pytest.mark.parametrize("rate", [1000, 100])
def test_a_payload_is_weighed_with_it(tmp_path, rate):
    result, log, _ = rehearsed(tmp_path, WRIST, change=("rate_hz = 500 ", f"rate_hz = {rate} "))
    honest(answers(result))
    assert answers(result)["M_payload"]["supported"]
    assert codes_of(log, b"box") == [b"started", b"stopped"]
    for name in SIX:
        assert len(log.read(name)) > 8.8 * rate
        assert result["channels"][name]["missing"] == 0


def test_it_survives_unplugging_and_brown_out_and_is_set_up_anew(tmp_path):
    faults = [
        *("--fault", "unplug:box:2:2.4", "--fault", "unplug:box:3:4.5", "--fault", "off:mz:5.5:5.8"),
        *("--fault", "wrong:fz:8:8.1:1e5", "--fault", "garbage:my:8.6:8.7"),
    ]
    result, log, _ = rehearsed(tmp_path, WRIST, *faults)
    honest(answers(result))
    codes = codes_of(log, b"box")
    assert (codes.count(b"silent"), codes.count(b"bus_recovered"), codes.count(b"restarted")) == (2, 2, 1)
    assert codes.count(b"sensor_error") == codes.count(b"sensor_normal") == 1
    assert codes.count(b"bad_frame") == 1
    rows = log.read("fz")
    assert (rows["status"] & SampleStatus.AFTER_RESET != 0).sum() == 2
    assert (rows["status"] & SampleStatus.NOT_VALID != 0).sum() == pytest.approx(50, abs=2)  # beyond its range
    assert rows["host_ns"][-1] - rows["host_ns"][0] > 8.8e9
    assert len(rows) > 500 * (9.0 - 0.4 - 2.5 - 1.5) - 50


def test_a_rate_that_the_box_has_not_is_refused_with_the_remedy(tmp_path, capsys):
    assert main(["init", str(tmp_path / "mine"), *WRIST]) == 0
    path = tmp_path / "mine" / "vehicle.toml"
    path.write_text(path.read_text().replace("rate_hz = 500 ", "rate_hz = 300 "))
    assert main(["preflight", str(path)]) != 0
    assert "1000 / n" in capsys.readouterr().err


@pytest.mark.realtime
@pytest.mark.timeout(180)
def test_it_flies_in_real_time_and_comes_back(tmp_path):
    _, log, _ = rehearsed(tmp_path, WRIST, "--realtime", "--fault", "unplug:box:2:3.5", swing=4.0)
    assert len(log.read("mz")) > 1200
    assert b"bus_recovered" in codes_of(log, b"box")


@pytest.mark.realtime
def test_it_is_found_and_tried_on_the_desk(tmp_path):
    assert main(["init", str(tmp_path / "mine"), *WRIST]) == 0
    report = tmp_path / "report.json"
    with served(str(tmp_path / "mine" / "vehicle.toml"), tmp_path / "wires") as urls:
        asked = ["devices", "--test", "onrobot_hex", "--url", urls["box"], "--seconds", "2"]
        assert main([*asked, "--json", str(report)]) in (0, 4)  # a busy computer reads too slowly, and that is told
    tests = json.loads(report.read_text())["tests"]
    assert {one["kind"] for one in tests} == {"onrobot_hex"}
    assert all(one["rows"] > 300 for one in tests)
