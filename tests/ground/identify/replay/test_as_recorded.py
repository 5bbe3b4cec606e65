"""What a recording says of itself: how its readings are rounded, whether they are repeated, how far apart they are."""

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from drivers.records import SCALAR
from onboard import config
from onboard.devices.recorded import RecordedAngle, RecordedDevice
from onboard.flight.estimate.readings.jumps import StuckWatch
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.before.init.vehicle import NewVehicle, make
from onboard.ground.identify.replay.as_recorded import as_recorded, best_width, quantum_of
from onboard.ground.identify.replay.feed import check_times
from onboard.recording.format.errors import ChannelError
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter

SCALE_rad = 1e-8


@pytest.fixture
def vehicle(tmp_path: Path) -> config.Vehicle:
    make(NewVehicle("arm", "fixed", ("joint_1",), "none", "recorded"), tmp_path / "v")
    path = tmp_path / "v" / "vehicle.toml"
    path.write_text(path.read_text().replace("# smoothing_ms = 100 ", "smoothing_ms = 100 "))
    return config.load(path)


def recorded(path: Path, angle_rad: np.ndarray, period_ms: float) -> LogReader:
    with LogWriter.create(path, durable=False, overwrite=True) as writer:
        for name, values, scale, unit in (
            ("joint_1", angle_rad, SCALE_rad, b"rad"),
            ("joint_1_torque", np.cos(angle_rad), 1e-6, b"N m"),
        ):
            rows = np.zeros(len(values), SCALAR)
            rows["sequence"], rows["scale"], rows["unit"] = np.arange(len(values)), scale, unit
            rows["host_ns"] = np.rint(1e6 * period_ms * np.arange(1, len(values) + 1))
            rows["value_raw"] = np.rint(values / scale)
            writer.register(name, SCALAR)
            writer.write(name, rows)
    return LogReader(path)


def angle_of(vehicle: config.Vehicle) -> RecordedAngle:
    found = vehicle.file.device["joint_1"]
    assert isinstance(found, RecordedAngle)
    return found


@pytest.mark.parametrize("quantum", [1.0, 7.0, 10_000.0])
def test_the_quantum_of_readings_is_found_and_none_where_there_is_none(rng, quantum):
    readings = quantum * np.rint(np.cumsum(rng.normal(0.0, 3.0, 2000)))
    assert quantum_of(readings) == quantum
    rounded_twice = np.rint(np.rint(readings / 10_000.0) * 17_453.2925)  # degrees to two places, in counts of a radian
    assert (
        quantum_of(rounded_twice) == pytest.approx(17_453.0 if quantum == 10_000.0 else 1.0, rel=1e-3) or quantum < 100
    )
    assert quantum_of(np.rint(1e6 * rng.normal(size=2000))) == 1.0
    assert quantum_of(np.arange(0.0, 1e6, 1000.0) + np.rint(30.0 * rng.normal(size=1000))) == 1.0  # a steady motion


@pytest.mark.parametrize(("steps", "quantum"), [(15, 1.0), (25, 7.0)])
def test_a_quantum_is_told_by_twenty_steps(steps, quantum):
    assert quantum_of(7.0 * np.arange(steps + 1)) == quantum


@pytest.mark.parametrize("step_deg", [0.05, 0.3])
def test_the_quantum_of_an_encoder_whose_angles_were_written_with_few_digits(rng, step_deg):
    """14 bits in degrees to three places, as a mapping of 1e-5 degrees reads them; and digits alone."""
    angle_deg = np.cumsum(rng.normal(0.0, step_deg, 4000))
    encoder = np.rint(angle_deg / 360.0 * 2**14) / 2**14 * 360.0
    assert quantum_of(np.rint(1e5 * np.round(encoder, 3))) == pytest.approx(1e5 * 360.0 / 2**14, rel=0.01)
    assert quantum_of(np.rint(1e5 * np.round(angle_deg, 3))) == 100.0


def test_a_rounded_angle_that_is_slow_is_not_stuck_and_one_that_stands_still_in_motion_is(vehicle, tmp_path):
    """Rounded to 1e-4 rad, 0.02 rad/s at 100 Hz and less: equal readings, then a step of 10,000 counts."""
    t = 0.01 * np.arange(4000)
    angle = 1e-4 * np.rint(1e4 * 0.05 * np.sin(0.4 * t))
    frozen = 1e-4 * np.rint(1e4 * np.sin(2.0 * t))
    frozen[1600:1640] = frozen[1600]
    for values, stuck in ((angle, False), (frozen, True)):
        log = recorded(tmp_path / "log.mcap", values, 10.0)
        found, said = as_recorded(vehicle, log)
        assert angle_of(found).quantum_counts == 10_000.0
        assert angle_of(found).noise_rad == pytest.approx(1e-4 / 12.0**0.5)
        assert angle_of(found).period_ms == pytest.approx(10.0)
        assert any(one.startswith("noise_rad: ") and "device.joint_1" in one for one in said)
        assert not any("smoothing_ms" in one for one in said)  # the file says it
        assert any(one.startswith("period_ms: samples are 10 ms apart, not 5") for one in said)
        rows = log.read("joint_1")
        watch = StuckWatch(roles_of(found).signals["joint_1"])
        assert bool(watch.watch(rows, np.ones(len(rows), np.bool_))[0].any()) is stuck
    as_it_was = StuckWatch(roles_of(vehicle).signals["joint_1"])
    rows = recorded(tmp_path / "log.mcap", angle, 10.0).read("joint_1")
    assert as_it_was.watch(rows, np.ones(len(rows), np.bool_))[0].any()  # by counts alone


def test_a_recorder_that_writes_readings_more_than_once_is_known_by_doing_it_all_the_time(vehicle, tmp_path):
    slow = np.repeat(np.sin(0.2 * np.arange(400.0)), 5)  # 500 Hz of what is read at 100 Hz
    found, said = as_recorded(vehicle, recorded(tmp_path / "log.mcap", slow, 2.0))
    assert angle_of(found).repeats
    assert any(one.startswith("repeats: ") for one in said)
    once = np.sin(0.04 * np.arange(2000.0))
    once[700:760] = once[700]
    assert not angle_of(as_recorded(vehicle, recorded(tmp_path / "log.mcap", once, 2.0)).vehicle).repeats


@pytest.mark.parametrize(("worse", "found_ms"), [(1.0, 100.0), (1.03, 200.0)])
def test_the_width_that_predicts_best_is_taken_and_of_equals_the_narrowest(worse, found_ms):
    assert best_width({100.0: 0.1 * worse, 200.0: 0.1, 400.0: 0.1})[0] == found_ms


@pytest.mark.parametrize(("period_ms", "refused"), [(140.0, False), (170.0, True)])
def test_samples_that_are_nearer_to_another_unit_of_time_are_refused(vehicle, tmp_path, period_ms, refused):
    log = recorded(tmp_path / "log.mcap", np.sin(0.1 * np.arange(400.0)), period_ms)
    with pytest.raises(ChannelError, match="170 ms apart where") if refused else nullcontext():
        check_times(vehicle, log)


def test_a_thrown_body_of_a_slower_recorder_is_identified_at_its_rate(tmp_path):
    """Samples 1.24 ms apart where the vehicle file says 0.248: every row was refused, as if samples were missing."""
    vehicle = config.load(config.packaged("tudelft"))
    with LogWriter.create(tmp_path / "throw_config_a.mcap", durable=False) as writer:
        rows = np.zeros(600, SCALAR)
        rows["sequence"], rows["scale"], rows["unit"] = np.arange(600), 1e-3, b"rad/s"
        rows["host_ns"], rows["value_raw"] = 1_240_000 * np.arange(1, 601), 1000 * np.arange(600)
        writer.register("wheel_rate", SCALAR)
        writer.write("wheel_rate", rows)
    found = as_recorded(vehicle, LogReader(tmp_path / "throw_config_a.mcap"))
    assert found.vehicle.file.device["wheel_rate"].period_ms == pytest.approx(1.24)
    assert found.said == ("period_ms: samples are 1.24 ms apart, not 0.248 (device.wheel_rate)",)
    assert found.vehicle.file.estimation == vehicle.file.estimation


def test_every_recorded_kind_that_an_estimator_reads_may_repeat():
    kinds = [kind for kind in RecordedDevice.__subclasses__() if "role" in kind.about_role or kind.about_role]
    assert len(kinds) >= 6
    for kind in kinds:
        assert "repeats" in kind.model_fields or kind.__name__ in ("RecordedThruster", "RecordedValue"), kind.__name__
