"""A recording brought in by the mapping that was proposed for it, and what it then holds."""

import numpy as np
import pytest

from onboard.cli import OK, main
from onboard.recording.reader import LogReader
from tests.ground.log.bring_in.guess.made import COUNT, PERIOD_s


def guessed(path, *options):
    """Proposed by the command and brought in by the next one: the log and the proposal."""
    mapping = path.parent / f"{path.name}.toml"
    assert main(["import", "--guess", str(path), "-o", str(mapping), *options]) == OK
    assert main(["import", str(mapping), str(path), "-o", str(path.parent / "logs")]) == OK
    return LogReader(path.parent / "logs" / f"{path.stem}.mcap"), mapping.read_text(encoding="utf-8")


def values(log, name):
    rows = log.read(name)
    assert len(rows) == COUNT, name
    return rows["value_raw"] * rows["scale"].astype(np.float64)


def held(log, quantities, began_ns=None):
    """Channels against numbers in SI, and that samples are where they were."""
    for name, truth in quantities.items():
        assert values(log, name) == pytest.approx(truth, abs=2e-6 * max(1.0, np.abs(truth).max())), name
        time_ns = log.read(name)["host_ns"]
        assert np.diff(time_ns) == pytest.approx(1e9 * PERIOD_s, abs=2.0)
        if began_ns is not None:
            assert time_ns[0] == began_ns


def held_imu(log, of, name="imu_base", began_ns=None):
    rows = log.read(name)
    assert len(rows) == COUNT
    gyro = rows["gyro_raw"] * rows["gyro_scale_rad_s"][:, None].astype(np.float64)
    accel = rows["accel_raw"] * rows["accel_scale_m_s2"][:, None].astype(np.float64)
    sixteen_bits = 2.0**-12  # a quarter of their range: another recording may go further
    assert np.abs(gyro - of.rate).max() < sixteen_bits * np.abs(of.rate).max()
    assert np.abs(accel - of.force).max() < sixteen_bits * np.abs(of.force).max()
    assert np.diff(rows["host_ns"]) == pytest.approx(1e9 * PERIOD_s, abs=2.0)
    if began_ns is not None:
        assert rows["host_ns"][0] == began_ns


def joints(of, torque, joints_of=None):
    """Channels of an arm by their names."""
    count = of.q.shape[1]
    names = joints_of or [f"joint_{k + 1}" for k in range(count)]
    return {name: of.q[:, k] for k, name in enumerate(names)} | {
        f"{name}_torque": torque[:, k] for k, name in enumerate(names)
    }
