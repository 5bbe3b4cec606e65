"""A channel that freezes again and again is reported once, and once when it has been over for a second."""

import numpy as np
import pytest

from drivers import records
from onboard import config
from onboard.flight.estimate.readings.jumps import StuckWatch
from onboard.flight.estimate.readings.roles import roles_of


@pytest.mark.parametrize(("for_s", "codes"), [(0.7, ["stuck"]), (1.5, ["stuck", "stuck_over"])])
def test_a_freeze_is_over_after_a_second_without_one(rng, for_s, codes):
    signal = roles_of(config.load(config.packaged("rocksat"))).signals["imu_base"]
    sound, frozen = round(for_s / signal.period_s), 500
    rows = np.zeros(2 * frozen + sound, records.IMU)
    rows["sequence"] = np.arange(len(rows))
    rows["gyro_scale_rad_s"], rows["accel_scale_m_s2"] = 1e-4, 6e-4
    for name in ("gyro_raw", "accel_raw"):
        rows[name] = rng.integers(-500, 500, (len(rows), 3))
        rows[name][frozen : 2 * frozen] = 7
    watch, told = StuckWatch(signal), []
    for part in np.split(rows, range(50, len(rows), 50)):
        _, _, event = watch.watch(part, np.ones(len(part), np.bool_))
        told += [event.code] if event else []
    assert told == codes
