"""Lines in innovations: found where there is one, not where there is noise, gaps or a reset."""

import numpy as np
import pytest

from onboard.estimation.policy import DOUBT
from onboard.identification.free_flyer.recursion.lines import InnovationLines

PERIOD_s, BATCH = 0.01, 10


def run(lines, signal, missing=()):
    for batch, part in enumerate(signal.reshape(-1, BATCH, 6)):
        use = np.ones(BATCH, bool)
        use[[k for k in missing if batch % 3 == 0]] = False
        lines.add(part[use].ravel(), use)
    return lines.strongest


@pytest.mark.parametrize(("channel", "instrument"), [(1, "gyro"), (5, "accelerometer")])
@pytest.mark.parametrize("missing", [(), (2, 7)])
def test_a_line_far_below_the_noise_is_found_with_its_frequency(rng, channel, instrument, missing):
    signal = rng.normal(size=(8000, 6))
    signal[:, channel] += 0.45 * np.sin(2.0 * np.pi * 0.45 * PERIOD_s * np.arange(8000))
    found = run(InnovationLines(PERIOD_s), signal, missing)
    a_bin = 1.0 / 8.0
    assert found.frequency_Hz == pytest.approx(0.45, abs=a_bin)
    assert found.instrument == instrument
    assert found.beyond > 2.0


def test_an_hour_of_noise_has_no_line(rng):
    assert run(InnovationLines(PERIOD_s), rng.normal(size=(360_000, 6))) is None


def test_what_was_found_stays_over_a_reset_and_half_a_block_does_not(rng):
    lines, swing = InnovationLines(PERIOD_s), np.sin(2.0 * np.pi * 3.0 * PERIOD_s * np.arange(1600))
    signal = rng.normal(size=(1600, 6)) + swing[:, None]
    assert run(lines, signal[:600]) is None
    lines.forget()
    assert run(lines, rng.normal(size=(1600, 6))) is None
    found = run(lines, signal)
    assert found is not None
    lines.forget()
    assert lines.strongest == found


@pytest.mark.parametrize(("channel", "sensor"), [(1, "gyro"), (5, "accelerometer")])
def test_a_window_with_a_swing_as_slow_as_the_motion_is_widened_and_one_of_noise_is_not(rng, channel, sensor):
    """1.8 periods of 0.8 sigma: 5 % of the residuals' power, most of what they have below 1.5 Hz."""
    lines, white = InnovationLines(PERIOD_s), rng.normal(size=(400, 6))
    lines.begin(white)
    assert lines.slow.by_sensor(DOUBT) == {}
    swinging = white.copy()
    swinging[:, channel] += 0.8 * np.sin(2.0 * np.pi * 0.45 * PERIOD_s * np.arange(400))
    lines.begin(swinging)
    [(found, ratio)] = lines.slow.by_sensor(DOUBT).items()
    assert found == sensor
    assert 2.0 < ratio < 6.0
    assert (swinging**2).mean() < 1.15
    lines.begin(white)
    assert lines.slow.by_sensor(DOUBT) == {}


@pytest.mark.parametrize(("frequency_Hz", "slow"), [(1.25, True), (2.5, False)])
def test_slow_is_what_is_as_slow_as_the_motion_of_an_arm(rng, frequency_Hz, slow):
    lines, swinging = InnovationLines(PERIOD_s), rng.normal(size=(400, 6))
    swinging[:, 1] += 0.8 * np.sin(2.0 * np.pi * frequency_Hz * PERIOD_s * np.arange(400))
    lines.begin(swinging)
    assert ("gyro" in lines.slow.by_sensor(DOUBT)) is slow


def test_innovations_after_a_window_count_with_it(rng):
    lines, white = InnovationLines(PERIOD_s), rng.normal(size=(8000, 6))
    lines.begin(white[:400])
    run(lines, white)
    assert lines.slow.by_sensor(DOUBT) == {}
    run(lines, white + 0.3 * np.sin(2.0 * np.pi * 0.45 * PERIOD_s * np.arange(8000))[:, None])
    assert lines.slow.by_sensor(DOUBT).keys() == {"gyro", "accelerometer"}
    lines.slow.forget()
    assert lines.slow.by_sensor(DOUBT) == {}
