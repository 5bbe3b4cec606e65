"""A vehicle of ``heft init --load-cell robotous_rft`` flies in virtual and in real time, and survives what breaks."""

import json

import pytest

from drivers.records import SampleStatus
from onboard import config
from onboard.cli import main
from tests.flight.check.test_desk import served
from tests.flight.test_i2c_devices import codes_of, rehearsed
from tests.flight.test_rehearsal import answers, honest

WRIST = ["--base", "fixed", "--joints", "2", "--load-cell", "robotous_rft"]
SIX = ("fx", "fy", "fz", "mx", "my", "mz")


@pytest.mark.parametrize("rate", [333, 100])
def test_a_payload_is_weighed_with_it(tmp_path, rate):
    result, log, _ = rehearsed(tmp_path, WRIST, change=("rate_hz = 200 ", f"rate_hz = {rate} "))
    assert result["accounted"]
    honest(answers(result))
    assert answers(result)["M_payload"]["supported"]
    assert codes_of(log, b"tty_wrist") == [b"started", b"stopped"]
    for name in SIX:
        assert len(log.read(name)) > 8.5 * rate
        assert result["channels"][name]["missing"] == 0


def test_it_survives_unplugging_brown_out_and_what_is_lost_on_the_line(tmp_path):
    faults = [
        *("--fault", "unplug:tty_wrist:2:2.3", "--fault", "reset:fx:4", "--fault", "silent:fy:7:7.2"),
        *("--fault", "byte_loss:tty_wrist:7.4:7.9:0.002", "--fault", "saturated:fz:8.3:8.5:1"),
        *("--fault", "garbage:my:8.6:8.7"),
    ]
    result, log, _ = rehearsed(tmp_path, WRIST, *faults)
    assert result["accounted"]
    honest(answers(result))
    codes = codes_of(log, b"tty_wrist")
    assert (codes.count(b"bus_error"), codes.count(b"silent"), codes.count(b"bus_recovered")) == (1, 1, 2)
    assert codes.count(b"sensor_status") == codes.count(b"sensor_normal") == 1
    rows = log.read("fz")
    assert (rows["status"] & SampleStatus.AFTER_RESET != 0).sum() >= 3
    assert (rows["status"] & SampleStatus.SATURATED != 0).sum() == pytest.approx(40, abs=2)
    assert rows["host_ns"][-1] - rows["host_ns"][0] > 8.5e9
    assert set(log.read("gap")["cause"].tolist()) >= {b"port_lost", b"frames_lost"}


def test_its_clock_has_half_a_period_and_the_time_on_the_line(tmp_path):
    assert main(["init", str(tmp_path), *WRIST]) == 0
    vehicle = config.load(tmp_path / "vehicle.toml")
    [delay] = [one for one in vehicle.file.device["fx"].delays("fx", vehicle) if "tty_wrist" in one.cause]
    assert delay.delay_s == pytest.approx(2.5e-3 + 1e-3 + 190 / 115_200)
    assert delay.sigma_s == pytest.approx(1.55e-3, abs=0.01e-3)


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ("baud=115200", "baud=9600", "has 57600, 115200"),
        ("rate_hz = 200 ", "rate_hz = 500 ", "sends 333 packets a second at the most"),
        ("rate_hz = 200 ", "rate_hz = 300 ", "it is 10, 20, 50"),
    ],
)
def test_what_its_line_cannot_is_refused_with_the_remedy(tmp_path, capsys, was, now, said):
    assert main(["init", str(tmp_path / "mine"), *WRIST]) == 0
    path = tmp_path / "mine" / "vehicle.toml"
    path.write_text(path.read_text().replace(was, now))
    assert main(["preflight", str(path)]) != 0
    assert said in capsys.readouterr().err


@pytest.mark.realtime
@pytest.mark.timeout(180)
def test_it_flies_in_real_time_and_comes_back(tmp_path):
    result, log, _ = rehearsed(tmp_path, WRIST, "--realtime", "--fault", "unplug:tty_wrist:2:3", swing=4.0)
    assert result["accounted"]
    assert len(log.read("mz")) > 600
    assert b"bus_recovered" in codes_of(log, b"tty_wrist")


@pytest.mark.realtime
def test_it_is_found_and_tried_on_the_desk(tmp_path):
    assert main(["init", str(tmp_path / "mine"), *WRIST]) == 0
    report = tmp_path / "report.json"
    with served(str(tmp_path / "mine" / "vehicle.toml"), tmp_path / "wires") as urls:
        asked = ["devices", "--test", "robotous_rft", "--url", urls["tty_wrist"], "--seconds", "2"]
        assert main([*asked, "--json", str(report)]) in (0, 4)  # a busy computer reads too slowly, and that is told
    tests = json.loads(report.read_text())["tests"]
    assert {one["kind"] for one in tests} == {"robotous_rft"}
    assert all(one["rows"] > 200 for one in tests)
