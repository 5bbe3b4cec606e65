"""The flight computer before a flight: the disk and the clock."""

import time

import pytest

from onboard import config
from onboard.flight.check import host
from onboard.flight.estimate.estimator import Estimator

CLOCKS = (time.monotonic_ns, 1.8e9)  # CLOCK_MONOTONIC; a Unix time of 2027


@pytest.fixture(scope="module")
def estimator():
    return Estimator(config.named("rocksat"))


def in_directory(directory):
    rocksat = config.packaged("rocksat")
    text = rocksat.read_text(encoding="utf-8")
    return config.parse(text.replace("[recording]", f'[recording]\ndirectory = "{directory}"'), rocksat)


def test_a_disk_that_is_large_and_fast_enough(tmp_path, estimator):
    found = host.look_over(in_directory(tmp_path / "flights"), estimator, 60.0, *CLOCKS, unsynchronised=False)
    assert (found.problems, found.warnings) == ((), ())
    assert found.write_bytes_s > host.FASTER * found.bytes_per_s
    assert list(tmp_path.iterdir()) == []  # nothing is left


def test_a_mission_that_does_not_fit(tmp_path, estimator):
    vehicle = in_directory(tmp_path)
    endless_s = host.look_over(vehicle, estimator, 60.0, *CLOCKS, unsynchronised=False).free_bytes / 2e5
    [said] = host.look_over(vehicle, estimator, endless_s, *CLOCKS, unsynchronised=False).problems
    assert f"are needed for {endless_s / 60:.0f}" in said


def test_a_slow_disk(tmp_path, estimator, monkeypatch):
    monkeypatch.setattr(host, "write_speed", lambda directory, clock: (1e5, 3.0))
    found = host.look_over(in_directory(tmp_path), estimator, 60.0, *CLOCKS, unsynchronised=False)
    assert "takes 0.10 MB/s where 0.34" in found.problems[0]
    assert "took 3.0 s to bring data to the medium" in found.warnings[0]


def test_write_speed_is_by_the_clock_that_is_given(tmp_path):
    times = iter(range(0, 1000 * 10**9, 10**9))
    speed, slowest_s = host.write_speed(tmp_path, lambda: next(times))
    assert slowest_s == 1.0
    assert speed == pytest.approx(host.TRIES * host.TRY_BYTES / (2 * host.TRIES + 1))


@pytest.mark.parametrize("directory", ["/proc/flights", "/dev/null/flights"])
def test_where_nothing_can_be_written(directory, estimator):
    assert host.look_over(in_directory(directory), estimator, 60.0, *CLOCKS, unsynchronised=False).problems


def test_a_clock_that_nothing_disciplines(tmp_path, estimator):
    [said] = host.look_over(in_directory(tmp_path), estimator, 60.0, *CLOCKS, unsynchronised=True).warnings
    assert "not synchronised" in said
    [said] = host.look_over(
        in_directory(tmp_path), estimator, 60.0, time.monotonic_ns, 86_400.0, unsynchronised=False
    ).warnings
    assert "says 1970-01-02" in said


def test_the_kernel_says_whether_its_clock_is_synchronised():
    assert host.unsynchronised() in (True, False)
