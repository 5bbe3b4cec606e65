"""A vehicle of ``heft init --load-cell hx711`` flies in virtual time and in real time, and survives what breaks."""

import pytest

from drivers.records import SampleStatus
from tests.flight.test_i2c_devices import codes_of, rehearsed
from tests.flight.test_rehearsal import answers, honest

CELL = ["--base", "fixed", "--joints", "2", "--load-cell", "hx711"]


@pytest.mark.parametrize("rate", [pytest.param(80, marks=pytest.mark.campaign), 10])
def test_a_cell_on_an_hx711_is_weighed_with(tmp_path, rate):
    change = ("sample_rate_hz = 80 ", f"sample_rate_hz = {rate} ")
    result, log, _ = rehearsed(tmp_path, CELL, change=change)
    honest(answers(result))
    assert ("XZ_payload_R" in answers(result)) == (rate == 80)  # ten samples a second say little of a moving arm
    rows = log.read("load_cell")
    assert len(rows) > 6.5 * rate
    assert result["channels"]["load_cell"]["missing"] == 0
    assert not rows["status"][-6 * rate :].any()


@pytest.mark.campaign  # the driver: test_hx711; in flight, on I2C: test_bmi088_flight
def test_it_survives_unplugging_brown_out_and_its_chip_of_gpio_lines_going(tmp_path):
    faults = [
        *("--fault", "silent:load_cell:1.5:2.5", "--fault", "reset:load_cell:3", "--fault", "off:load_cell:3.8:4.3"),
        *("--fault", "unplug:cell_lines:4.8:5.2", "--fault", "saturated:load_cell:5.6:5.8:-1"),
    ]
    result, log, _ = rehearsed(tmp_path, CELL, *faults, swing=4.5)
    honest(answers(result))
    assert codes_of(log, b"load_cell").count(b"bus_recovered") == 3
    assert codes_of(log, b"load_cell").count(b"brown_out") == 1
    assert [code for code in codes_of(log, b"load_cell") if code in (b"no_samples", b"bus_error")] == [
        *(b"no_samples", b"no_samples", b"bus_error")
    ]
    rows = log.read("load_cell")
    assert (rows["status"] & SampleStatus.AFTER_RESET != 0).sum() == 4  # with the brown-out
    saturated = rows["status"] & SampleStatus.SATURATED != 0
    assert set(rows["value_raw"][saturated]) == {-(1 << 23)}
    assert rows["host_ns"][-1] - rows["host_ns"][0] > 5.4e9
