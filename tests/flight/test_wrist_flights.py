"""Vehicles of ``heft init`` with a wrist sensor each fly in virtual time, and survive what breaks."""

import numpy as np
import pytest

from drivers.records import SampleStatus
from onboard import config
from onboard.cli import main
from tests.flight.test_i2c_devices import SPARSE, codes_of, rehearsed
from tests.flight.test_rehearsal import answers, honest

ARM = ["--base", "fixed", "--joints", "2", "--load-cell"]
WARM = ("component = 1\n", "component = 1\ntemperature = true\n")


def flown(directory, kind, *faults, **options):
    """Result, log and codes of the sensor's events; its answers are honest."""
    asked = [word for fault in faults for word in ("--fault", fault)]
    result, log, _ = rehearsed(directory, [*ARM, kind], *asked, **options)
    honest(answers(result))
    return result, log, codes_of(log, b"box" if kind == "onrobot_hex" else b"tty_wrist")


def number_of(log, status):
    """Rows of a component with this bit."""
    return (log.read("fz")["status"] & status != 0).sum()


def seconds_of(log):
    """From the first row of a component to its last."""
    rows = log.read("fz")
    return 1e-9 * (rows["host_ns"][-1] - rows["host_ns"][0])


@pytest.mark.campaign  # by all six components: test_workshop; what each reads and when: test_devices
@pytest.mark.parametrize(
    ("kind", "usual", "rate", "seconds"),
    [
        ("bota_ft", 400, 100, 6.4),  # the first second it starts
        ("bota_ft", 400, 800, 6.4),
        ("robotous_rft", 200, 333, 7.0),
        ("onrobot_hex", 500, 1000, 7.3),
    ],
)
def test_a_payload_is_weighed_with_it(tmp_path, kind, usual, rate, seconds):
    result, log, codes = flown(tmp_path, kind, change=(f"rate_hz = {usual} ", f"rate_hz = {rate} "))
    assert answers(result)["M_payload"]["supported"]
    assert codes == [b"started", b"stopped"]
    for name in ("fx", "fy", "fz", "mx", "my", "mz"):
        assert len(log.read(name)) > seconds * rate
        assert result["channels"][name]["missing"] == 0


@pytest.mark.campaign  # the driver: test_bota_ft, test_serial_laws
def test_a_bota_ft_survives_unplugging_brown_out_and_what_is_lost_on_the_line(tmp_path):
    faults = [
        *("unplug:tty_wrist:2:2.3", "reset:fx:4", "off:mz:5.5:5.8", "silent:fy:7.5:7.7"),
        *("byte_loss:tty_wrist:7.8:8.2:0.002", "saturated:fz:8.3:8.5:1", "garbage:my:8.6:8.7"),
    ]
    _, log, codes = flown(tmp_path, "bota_ft", *faults, rest=3.0, change=WARM)
    assert (codes.count(b"bus_error"), codes.count(b"bus_recovered"), codes.count(b"restarted")) == (1, 1, 2)
    assert codes.count(b"sensor_status") == codes.count(b"sensor_normal") == 1
    assert number_of(log, SampleStatus.AFTER_RESET) == 2
    assert number_of(log, SampleStatus.SATURATED) == pytest.approx(80, abs=2)
    assert seconds_of(log) > 7.9
    warm = log.read("fx_temperature")
    assert (warm["sequence"] == log.read("fz")["sequence"]).all()
    assert np.ptp(warm["value_raw"] * warm["scale"]) < 0.1
    assert set(log.read("gap")["cause"].tolist()) >= {b"port_lost", b"frames_lost"}


@pytest.mark.campaign  # the driver: test_robotous_rft, test_serial_laws; in flight: test_ur_arm
def test_a_robotous_rft_survives_unplugging_brown_out_and_what_is_lost_on_the_line(tmp_path):
    faults = [
        *("unplug:tty_wrist:1:1.3", "reset:fx:2", "silent:fy:4.2:4.4"),
        *("byte_loss:tty_wrist:4.6:5.1:0.002", "saturated:fz:5.4:5.6:1", "garbage:my:5.7:5.8"),
    ]
    _, log, codes = flown(tmp_path, "robotous_rft", *faults, rest=1.5, swing=4.5, change=SPARSE)
    assert (codes.count(b"bus_error"), codes.count(b"silent"), codes.count(b"bus_recovered")) == (1, 1, 2)
    assert codes.count(b"sensor_status") == codes.count(b"sensor_normal") == 1
    assert number_of(log, SampleStatus.AFTER_RESET) >= 3
    assert number_of(log, SampleStatus.SATURATED) == pytest.approx(40, abs=2)
    assert seconds_of(log) > 5.5
    assert set(log.read("gap")["cause"].tolist()) >= {b"port_lost", b"frames_lost"}


@pytest.mark.campaign  # the driver: test_net_ft, test_serial_laws; a box by UDP: test_wrist_box
def test_an_onrobot_hex_survives_unplugging_and_brown_out_and_is_set_up_anew(tmp_path):
    faults = ["unplug:box:2:2.4", "unplug:box:3:4.5", "off:mz:5.5:5.8", "wrong:fz:8:8.1:1e5", "garbage:my:8.6:8.7"]
    _, log, codes = flown(tmp_path, "onrobot_hex", *faults, rest=3.0)
    assert (codes.count(b"silent"), codes.count(b"bus_recovered"), codes.count(b"restarted")) == (2, 2, 1)
    assert codes.count(b"sensor_error") == codes.count(b"sensor_normal") == codes.count(b"bad_frame") == 1
    assert number_of(log, SampleStatus.AFTER_RESET) == 2
    assert number_of(log, SampleStatus.NOT_VALID) == pytest.approx(50, abs=2)  # beyond its range
    assert seconds_of(log) > 8.8
    assert len(log.read("fz")) > 500 * (9.0 - 0.4 - 2.5 - 1.5) - 50


def test_the_clock_of_a_robotous_rft_has_half_a_period_and_the_time_on_the_line(tmp_path):
    assert main(["init", str(tmp_path), *ARM, "robotous_rft"]) == 0
    vehicle = config.load(tmp_path / "vehicle.toml")
    [delay] = [one for one in vehicle.file.device["fx"].delays("fx", vehicle) if "tty_wrist" in one.cause]
    assert delay.delay_s == pytest.approx(2.5e-3 + 1e-3 + 190 / 115_200)
    assert delay.sigma_s == pytest.approx(1.55e-3, abs=0.01e-3)
