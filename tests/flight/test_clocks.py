"""Clocks and known delays of a vehicle, from its file."""

from pathlib import Path

import pytest

from onboard import config
from onboard.flight.clocks import known_delays, sync_line, timebase_of
from onboard.timebase.timebase import SyncLine, Timebase
from tests.flight.mixed import DEVICES, vehicle


def mixed(directory: Path, text: str = DEVICES) -> config.Vehicle:
    return vehicle(directory, {}, text)


def test_every_channel_that_is_estimated_with_has_a_clock(tmp_path: Path) -> None:
    timebase = timebase_of(mixed(tmp_path))
    silent = {"pulse", "can_sync", "second", "loop", "phase", "elbow_mark", "wrist_mark"}
    spoken = mixed(tmp_path).channels.keys() - silent
    assert len(spoken) > 15
    for channel in spoken:
        assert not timebase.trusted(channel), channel  # known, and nothing heard yet


def test_the_coded_line_is_the_one_and_a_pps_where_there_is_none(tmp_path: Path) -> None:
    assert sync_line(mixed(tmp_path)) == SyncLine("pulse", 5e6)
    uncoded = DEVICES.replace(
        'kind = "sync_pulse"\nbus = "sync_line"\nsync_period_ms = 5', 'kind = "pps"\nbus = "sync_line"'
    )
    uncoded = uncoded.replace('[device.second]\nkind = "pps"\nbus = "loop_in"\nperiod_ms = 227', "")
    uncoded = uncoded.replace('[bus.loop_in]\nurl = "pps:///dev/pps0"\n', "")
    assert sync_line(mixed(tmp_path, uncoded)) == SyncLine("pulse", 1e9, coded=False)
    assert isinstance(timebase_of(mixed(tmp_path, uncoded)), Timebase)


def test_every_known_delay_is_listed(tmp_path: Path) -> None:
    listed = {(d.channel, d.part, d.cause.split(",")[0].split(" of ")[0]): d for d in known_delays(mixed(tmp_path))}
    gyro = listed["imu_base", "gyro", "low-pass filter"]
    accel = listed["imu_base", "accel", "low-pass filter"]
    assert (gyro.delay_s, accel.delay_s) == (2.8e-3, 3.0e-3)  # DLPF_CFG 2
    assert listed["shoulder", "", "SYNC frame"].delay_s == pytest.approx(-110e-6)
    packet = listed["imu_tip", "", "packet: wait for the line"]
    assert packet.delay_s == pytest.approx(38 * 10 / 115_200 + 0.5 / 150)
    assert packet.sigma_s == pytest.approx(1 / 150 / 12**0.5)
    assert listed["cell", "", "answer on the wire; the sample lies between it and the question's end"].delay_s > 1.8e-3


def test_a_latency_that_was_measured_is_taken_for_it(tmp_path: Path) -> None:
    text = DEVICES.replace("sample_rate_hz = 150", "sample_rate_hz = 150\nlatency_ms = 1.5\nlatency_sigma_ms = 0.1")
    packet = next(d for d in known_delays(mixed(tmp_path, text)) if d.channel == "imu_tip")
    assert packet.delay_s == pytest.approx(38 * 10 / 115_200 + 1.5e-3)
    assert packet.sigma_s == pytest.approx(1e-4)


def test_what_is_taken_off_does_not_depend_on_where_the_bus_was_in_the_flight(tmp_path: Path) -> None:
    plain = mixed(tmp_path)
    elsewhere = plain.with_urls(dict.fromkeys(plain.file.bus, "serial:///dev/pts/1?baud=9600"))
    assert known_delays(elsewhere) == known_delays(plain)
