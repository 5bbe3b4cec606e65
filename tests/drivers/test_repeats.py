"""A chip that hangs and says the same sample again and again, and one that only rests."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given
from scipy.signal import lfilter

from drivers.mpu6050 import Mpu6050, Mpu6050Config
from drivers.mpu6050.noise import most_repeats
from drivers.records import IMU, SampleStatus
from drivers.repeats import Repeats
from drivers.reporter import Reporter
from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.mpu6050_model import MS, Mpu6050Model, sample_words

FILTERS = {  # DLPF_CFG: bandwidth of accel and gyro, Hz (RM register 26)
    0: (260.0, 256.0),
    1: (184.0, 188.0),
    2: (94.0, 98.0),
    3: (44.0, 42.0),
    4: (21.0, 20.0),
    5: (10.0, 10.0),
    6: (5.0, 5.0),
}


def runs(same):
    """Length of the run of equal samples that each sample is the last of, shape (n,)."""
    lengths = np.ones(len(same) + 1, int)
    for place in np.flatnonzero(same):
        lengths[place + 1] = lengths[place] + 1
    return lengths


@pytest.mark.parametrize("code", FILTERS)
@pytest.mark.parametrize(("accel_g", "gyro_deg_s"), [(2, 250), (4, 250), (16, 2000)])
def test_the_noise_of_a_chip_at_rest_makes_no_run_of_that_length(rng, code, accel_g, gyro_deg_s):
    """Typical noise (PS 6.1, 6.2) through a first-order filter, 200 s of it, each axis at the middle of a count."""
    config = Mpu6050Config(filter_code=code, accel_range_g=accel_g, gyro_range_deg_s=gyro_deg_s)
    count, rate_hz = 200_000, 1000.0
    same = np.ones(count - 1, bool)
    for density, bandwidth_hz, lsb in zip(
        (400e-6, 0.005), FILTERS[code], (32768 / accel_g, 131.0 * 250 / gyro_deg_s), strict=True
    ):
        keeps = np.exp(-2.0 * np.pi * bandwidth_hz / rate_hz)
        sigma = density * np.sqrt(np.pi / 2.0 * bandwidth_hz) * lsb
        for _ in range(3):
            white = rng.normal(0.0, sigma * np.sqrt(1.0 - keeps**2), count)
            counts = np.rint(lfilter([1.0], [1.0, -keeps], white))
            same &= counts[1:] == counts[:-1]
    assert runs(same).max() < 0.7 * most_repeats(config)


@given(
    words=st.lists(st.integers(0, 2), min_size=1, max_size=60),
    cuts=st.lists(st.integers(1, 9), min_size=60, max_size=60),
    longest=st.integers(1, 6),
    saturated=st.integers(0, 2),
)
def test_runs_are_found_however_the_samples_come(words, cuts, longest, saturated):
    """Against a plain list: status of each batch as if the run were looked at to the end of that batch."""
    repeats = Repeats(longest, Reporter("imu"))
    start = 0
    while start < len(words):
        end = min(start + cuts.pop(), len(words))
        rows = np.zeros(end - start, IMU)
        rows["gyro_raw"][:, 1] = words[start:end]
        rows["status"] = (np.array(words[start:end]) == saturated) * int(SampleStatus.SATURATED)
        began = repeats.mark(rows)
        length = 0
        lengths = []
        for place in range(end):
            is_same = place > 0 and words[place] == words[place - 1] and words[place] != saturated
            length = length + 1 if is_same else 1
            lengths.append(length)
        for place in range(start, end):
            last = place
            while last + 1 < end and lengths[last + 1] > 1:
                last += 1
            bad = bool(rows["status"][place - start] & SampleStatus.NOT_VALID)
            assert bad == (lengths[last] > longest), (start, place)
        bad_runs = [place - length + 1 for place, length in enumerate(lengths) if place >= start and length > longest]
        assert began == (bad_runs[0] - start if bad_runs else None)
        assert repeats.stuck == (lengths[-1] > longest)
        start = end


@pytest.mark.parametrize("mode", ["fifo", "burst"])
def test_a_chip_that_hangs_is_named_and_its_samples_are_not_valid(clock, mode):
    config = Mpu6050Config(mode=mode)
    chip = Mpu6050Model(clock)
    held = range(500, 700)
    chip.words = lambda number: sample_words(number if number not in held else 500)
    chip.sync_samples = {510, 600}  # the sync bit is the chip's own doing: it does not hide that
    imu = Mpu6050("imu", chip, config)
    batches = imu.start(clock())
    while clock.now_ns < 2_000 * MS:
        clock.advance(imu.period_ns)
        batches += imu.pump(clock())
    batches += imu.stop(clock())
    rows = whole(batches, "imu")
    bad = rows["sequence"][(rows["status"] & SampleStatus.NOT_VALID) != 0]
    assert set(range(500 + most_repeats(config), 700)) <= set(bad.tolist()) <= set(held)
    assert texts(batches, "stuck")[0].startswith("samples from 500 on are bit-identical")
    assert [code for code in codes(batches) if code.startswith("stuck")] == ["stuck", "stuck_over"]
    assert not len(of(batches, "gap"))


def test_a_chip_that_hangs_between_two_drains_is_named_too(clock):
    config = Mpu6050Config(poll_period_ms=18.0, filter_code=1)
    chip = Mpu6050Model(clock, period_ns=1_000_000.0)
    chip.words = lambda number: sample_words(109 if number in range(109, 118) else number)
    imu = Mpu6050("imu", chip, config)
    batches = imu.start(clock())
    while clock.now_ns < 2_000 * MS:
        clock.advance(imu.period_ns)
        batches += imu.pump(clock())
    rows = whole(batches, "imu")
    assert rows["sequence"][rows["status"] != 0].tolist() == list(range(109, 118))
    assert texts(batches, "stuck")[0].startswith("samples from 109 on")
    assert codes(batches).count("stuck_over") == 1
