"""A vehicle of ``heft init --load-cell hx711`` flies in virtual time and in real time, and survives what breaks."""

import json

import pytest

from drivers.records import SampleStatus
from hil_sim.devices.hx711 import Hx711Twin
from onboard.cli import main
from onboard.recording.reader import LogReader
from tests.flight.check.test_desk import served
from tests.flight.mixed import MixedWorld, vehicle
from tests.flight.test_devices import timed
from tests.flight.test_i2c_devices import rehearsed
from tests.flight.test_rehearsal import answers, honest

CELL = ["--base", "fixed", "--joints", "2", "--load-cell", "hx711"]


def told(log: LogReader) -> list[bytes]:
    """Codes of its events."""
    events = log.read("event")
    return events["code"][events["source"] == b"load_cell"].tolist()


@pytest.mark.parametrize("rate", [80, 10])
def test_a_cell_on_an_hx711_is_weighed_with(tmp_path, rate):
    change = ("sample_rate_hz = 80 ", f"sample_rate_hz = {rate} ")
    result, log, _ = rehearsed(tmp_path, CELL, change=change)
    assert result["accounted"]
    honest(answers(result))
    assert ("XZ_payload_R" in answers(result)) == (rate == 80)  # ten samples a second say little of a moving arm
    rows = log.read("load_cell")
    assert len(rows) > 8.0 * rate
    assert result["channels"]["load_cell"]["missing"] == 0
    assert not rows["status"][-8 * rate :].any()


def test_it_survives_unplugging_brown_out_and_its_chip_of_gpio_lines_going(tmp_path):
    faults = [
        *("--fault", "silent:load_cell:3:4", "--fault", "reset:load_cell:5", "--fault", "off:load_cell:6:6.5"),
        *("--fault", "unplug:cell_lines:7.5:8", "--fault", "saturated:load_cell:8.5:8.7:-1"),
    ]
    result, log, _ = rehearsed(tmp_path, CELL, *faults)
    assert result["accounted"]
    honest(answers(result))
    assert told(log).count(b"bus_recovered") == 3
    assert told(log).count(b"brown_out") == 1
    assert [code for code in told(log) if code in (b"no_samples", b"bus_error")] == [
        *(b"no_samples", b"no_samples", b"bus_error")
    ]
    rows = log.read("load_cell")
    assert (rows["status"] & SampleStatus.AFTER_RESET != 0).sum() == 4  # with the brown-out
    saturated = rows["status"] & SampleStatus.SATURATED != 0
    assert set(rows["value_raw"][saturated]) == {-(1 << 23)}
    assert rows["host_ns"][-1] - rows["host_ns"][0] > 8.4e9


def test_what_the_file_says_of_the_bridge_must_fit_the_converter(tmp_path, capsys):
    assert main(["init", str(tmp_path / "mine"), *CELL]) == 0
    path = tmp_path / "mine" / "vehicle.toml"
    path.write_text(path.read_text().replace("rated_load_N = 50.0", "rated_load_N = 20.0"))
    assert main(["preflight", str(path)]) != 0
    assert "its range ends at" in capsys.readouterr().err


def test_conversions_are_put_on_the_time_when_they_ended(tmp_path, monkeypatch):
    """The clock of its own oscillator, 1.2 % fast, fitted to what was seen, against the truth."""
    ended_s = []
    convert = Hx711Twin._convert

    def watched(self, until_ns):
        word = convert(self, until_ns)
        ended_s.append(self.conversions.last_s)
        return word

    monkeypatch.setattr(Hx711Twin, "_convert", watched)
    with MixedWorld(tmp_path) as world:
        flying = vehicle(tmp_path, world.urls)
        heard = world.fly(world.open(flying), 6.0)
    times_ns, sigma_ns, start_ns = timed(flying, heard, "wing")
    late_s = [float(t - min(ended_s, key=lambda s: abs(s - t))) for t in (times_ns[-100:] - start_ns) * 1e-9]
    assert sigma_ns < 0.5e6
    assert max(map(abs, late_s)) < 3e-9 * sigma_ns


@pytest.mark.realtime
@pytest.mark.timeout(180)
def test_a_cell_on_an_hx711_flies_in_real_time(tmp_path):
    result, log, _ = rehearsed(tmp_path, CELL, "--realtime", "--fault", "silent:load_cell:2:3", swing=4.0)
    assert result["accounted"]
    assert len(log.read("load_cell")) > 300
    assert b"bus_recovered" in told(log)


@pytest.mark.realtime
def test_it_is_tried_on_the_desk_by_its_url(tmp_path, capsys):
    assert main(["devices", "--test", "hx711"]) == 2
    assert "--url 'gpio-pair:///dev/gpiochip0?data=5&clock=6'" in capsys.readouterr().err
    assert main(["init", str(tmp_path / "mine"), *CELL]) == 0
    report = tmp_path / "report.json"
    with served(str(tmp_path / "mine" / "vehicle.toml"), tmp_path / "wires") as urls:
        asked = ["devices", "--test", "hx711", "--url", urls["cell_lines"], "--seconds", "2"]
        assert main([*asked, "--json", str(report)]) in (0, 4)  # a busy computer reads too slowly, and that is told
    [cell] = json.loads(report.read_text())["tests"]
    assert (cell["kind"], cell["signals"][0]["unit"]) == ("hx711", "N")
    assert cell["rows"] > 50
