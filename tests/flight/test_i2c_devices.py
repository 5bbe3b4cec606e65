"""Devices on I2C that people own: a vehicle of ``heft init`` with each flies in virtual time and in real time."""

import json

import numpy as np
import pytest

from drivers.records import SampleStatus
from onboard.cli import main
from onboard.flight.clocks import timebase_of
from onboard.recording.reader import LogReader
from tests.flight.test_devices import timed
from tests.flight.test_rehearsal import answers, honest
from tests.hil_sim.devices.twin_bench import MS, START_NS

SEQUENCE = """
[[sequence]]
phase = 1
action = "hold"
duration_s = {rest}
[[sequence]]
phase = 1
action = "swing"
duration_s = {swing}
"""
JOINTS = ["--base", "fixed", "--joints", "2", "--encoder", "as5600", "--load-cell", "nau7802"]
INERTIAL = ["--base", "free", "--joints", "2", "--imu", "icm20948"]
SPARSE = ("row_rate_hz = 100 ", "row_rate_hz = 50 ")  # where rows are not what is looked at
CELL = ["--base", "fixed", "--joints", "2", "--load-cell", "nau7802"]


def rehearsed(directory, init, *further, rest=1.5, swing=6.0, seed=3, change=("", "")):
    """The result of ``heft hil`` of a vehicle of ``heft init``, accounted for; its log and its exit code."""
    assert main(["init", str(directory / "mine"), *init]) == 0
    path = directory / "mine" / "vehicle.toml"
    path.write_text(path.read_text().replace(*change))
    (directory / "over.toml").write_text(SEQUENCE.format(rest=rest, swing=swing))
    log, result = directory / "flight.mcap", directory / "result.json"
    asked = ["hil", str(path), "--seed", str(seed), "--scenario", str(directory / "over.toml"), *further]
    code = main([*asked, "--json", str(result), "--log", str(log)])
    told = json.loads(result.read_text())
    assert told["accounted"]
    return told, LogReader(log), code


def codes_of(log, source):
    """Codes of the events of a device."""
    events = log.read("event")
    return events["code"][events["source"] == source].tolist()


@pytest.mark.campaign  # with an NAU7802: test_as5048_flight; what is saturated: drivers/test_nau7802
@pytest.mark.parametrize(("rate", "faults"), [(80, []), (320, ["--fault", "saturated:load_cell:4:5:1"])])
def test_a_cell_on_an_nau7802_is_weighed_with_but_for_what_is_beyond_its_range(tmp_path, rate, faults):
    change = ("sample_rate_hz = 320 ", f"sample_rate_hz = {rate} ")
    result, log, _ = rehearsed(tmp_path, CELL, *faults, change=change)
    honest(answers(result))
    assert answers(result)["XZ_payload_R"]["supported"]
    rows = log.read("load_cell")
    assert len(rows) > 6.5 * rate
    assert result["channels"]["load_cell"]["missing"] == 0
    saturated = rows["status"] & SampleStatus.SATURATED != 0
    assert (rows["status"].astype(bool) & ~saturated).nonzero()[0].tolist() == [0, 1, 2, 3]  # its filter settles
    if faults:
        assert 280 < saturated.sum() < 340
        (end,) = set(rows["value_raw"][saturated])  # less what its calibration takes off
        assert 0.99 < end / (1 << 23) < 1.0


@pytest.mark.campaign  # on I2C: test_bmi088_flight; the driver: test_nau7802, test_chip_laws
def test_it_survives_unplugging_brown_out_and_garbage(tmp_path):
    faults = [
        *("--fault", "silent:load_cell:1.5:2.3", "--fault", "reset:load_cell:3", "--fault", "nack:load_cell:3.8:4"),
        *("--fault", "off:load_cell:4.5:5", "--fault", "timeout:load_cell:5.6:5.7"),
    ]
    result, log, _ = rehearsed(tmp_path, CELL, *faults, swing=4.5, change=SPARSE)
    honest(answers(result))
    told = codes_of(log, b"load_cell")
    assert told.count(b"bus_recovered") == 4
    assert told.count(b"brown_out") == 2
    rows = log.read("load_cell")
    assert (rows["status"] & SampleStatus.AFTER_RESET != 0).sum() == 2
    assert rows["host_ns"][-1] - rows["host_ns"][0] > 5.4e9


@pytest.mark.parametrize("channel", ["bridge", "wing"])
def test_conversions_are_put_on_the_time_when_they_ended(mixed_flight, tmp_path, channel):
    """Of an NAU7802 and an HX711: the clock of its own oscillator, 0.7 and 1.2 % fast, fitted, against the truth."""
    times_ns, sigma_ns = timed(mixed_flight.vehicle(tmp_path), mixed_flight.rows, channel)
    assert len(times_ns) > 260  # of four seconds
    assert sigma_ns < 0.5e6
    assert np.abs(mixed_flight.late_ns(channel, times_ns[-200:])).max() < 3.0 * sigma_ns


@pytest.mark.campaign  # with AS5048s: test_as5048_flight; the driver: test_as5600, test_magnets
def test_an_arm_of_magnets_and_a_bridge_is_weighed_with(tmp_path):
    """Two joints with an AS5600 each, on two buses, and their eccentric magnets."""
    result, log, _ = rehearsed(tmp_path, JOINTS, swing=8.0, seed=6)
    honest(answers(result))
    moment = answers(result)["MY_payload"]
    assert moment["supported"]
    assert abs(moment["value"] - moment["truth"]) < 2e-3  # kg m; through 100 ms it was 12 to 18e-3 off
    for joint in ("joint_1", "joint_2"):
        rows = log.read(joint)
        assert len(rows) > 9.0 * 200
        assert set(rows["status"]) == {0}
        assert set(rows["device_status"]) == {0x20}


@pytest.mark.campaign  # of AS5048s: test_as5048_flight; the driver: test_as5600, test_magnets
def test_a_magnet_that_comes_loose_is_named_and_its_samples_are_not_used(tmp_path):
    faults = [
        *("--fault", "field:joint_1:2:3:-0.7", "--fault", "field:joint_2:3:3.5:-1", "--fault", "off:joint_2:4:4.5"),
        *("--fault", "silent:joint_1:5:5.3"),
    ]
    result, log, _ = rehearsed(tmp_path, JOINTS, *faults, swing=4.5)
    honest({name: row for name, row in answers(result).items() if row["supported"]})
    events = log.read("event")
    told = {(event["source"], event["code"]) for event in events}
    assert told >= {(b"joint_1", b"magnet_weak"), (b"joint_2", b"magnet_missing"), (b"joint_2", b"brown_out")}
    assert told >= {(b"joint_1", b"magnet_over"), (b"joint_1", b"bus_recovered"), (b"joint_2", b"bus_recovered")}
    assert (log.read("joint_1")["status"] & SampleStatus.NOT_VALID != 0).sum() == pytest.approx(200, abs=2)


def test_the_samples_of_an_icm20948_are_put_on_the_time_when_they_were_made(mixed_flight, tmp_path):
    """The clock of its own oscillator, 0.6 % slow, fitted to the marks of FSYNC, against the truth."""
    rows = {channel: mixed_flight.rows[channel] for channel in ("imu_elbow", "pulse")}
    assert set(rows["imu_elbow"]["status"]) == {0}
    timebase = timebase_of(mixed_flight.vehicle(tmp_path))
    for until_ns in range(START_NS, START_NS + 8_000 * MS, 50 * MS):
        now = {c: r[(r["host_ns"] < until_ns) & (r["host_ns"] >= until_ns - 50 * MS)] for c, r in rows.items()}
        timebase.update(until_ns, now)
    times_ns = timebase.time_ns("imu_elbow", rows["imu_elbow"])[-200:]
    late_ns = mixed_flight.late_ns("imu_elbow", times_ns - START_NS)
    sigma_ns = timebase.sigma_ns("imu_elbow", int(times_ns[-1]))
    assert sigma_ns < 1e9 / 562.5 / 8.0
    assert np.abs(late_ns).max() < 3.0 * sigma_ns


@pytest.mark.campaign  # with a BMI088: test_bmi088_flight; the driver: test_icm20948
def test_a_free_arm_with_an_icm20948_weighs_and_survives_its_unplugging(tmp_path):
    faults = [
        *("--fault", "off:imu_base:1.5:2.5", "--fault", "nack:imu_base:3.5:3.8", "--fault", "timeout:imu_base:4.5:4.6"),
        *("--fault", "reset:imu_base:5.5", "--fault", "garbage:imu_base:6.5:6.6"),
    ]
    result, log, _ = rehearsed(tmp_path, INERTIAL, *faults)
    honest(answers(result))
    assert answers(result)["m_payload"]["supported"]
    told = codes_of(log, b"imu_base")
    assert told.count(b"brown_out") == 2
    assert told.count(b"bus_recovered") >= 3
    rows = log.read("imu_base")
    assert (rows["status"] & SampleStatus.AFTER_RESET != 0).sum() == told.count(b"started") - 1
    assert rows["host_ns"][-1] - rows["host_ns"][0] > 6.9e9
