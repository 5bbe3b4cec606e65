"""DYMAFLEX's second IMU and wrist cell, which its estimator does not use: silent on a healthy flight, loud on a lie.

One flight; each lie is a copy of its log in which one instrument is off by a scale.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.records import Rows
from onboard import config
from onboard.flight.estimator import Estimator
from onboard.offline.estimate_again.feed import feed
from onboard.recording.reader import LogReader
from tests.flight.missions import Result, fly

DO_NOT_USE = 2  # level of QUANTITY
SEQUENCE = [
    {"phase": 0, "action": "hold", "duration_s": 1.0},
    {
        "phase": 1,
        "action": "swing",
        "duration_s": 24.0,
        "ramp_s": 1.5,
        "swing_deg": 20.0,
        "tones": 3,
        "band_Hz": [0.1, 0.6],
    },
    {"phase": 9, "action": "hold", "duration_s": 0.5},
]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Result:
    path = tmp_path_factory.mktemp("witness") / "flight.mcap"
    return fly(path, 11, vehicle="dymaflex", sequence=SEQUENCE, capture={"earliest_s": 4.0, "latest_s": 5.0})


def told(log: Path, channel: str = "", spoil: Callable[[Rows], None] = lambda rows: None) -> tuple[list[str], set[int]]:
    """Contradictions told, and the levels of the last answers, when one channel of the log is spoilt on its way in."""
    reader = LogReader(log)
    estimator = Estimator(config.load(config.packaged("dymaflex")))
    process, texts, levels = estimator.process, list[str](), dict[bytes, int]()

    def spoilt(now_ns, batches, *rest):
        taken = dict(batches)
        if channel in taken:
            taken[channel] = taken[channel].copy()
            spoil(taken[channel])
        return process(now_ns, taken, *rest)

    estimator.process = spoilt
    for name, rows in feed(estimator, reader):
        if "code" in (rows.dtype.names or ()):
            texts += [row["text"].decode() for row in rows if row["code"] == b"contradiction"]
        elif name == "quantity":
            levels |= {row["name"]: int(row["level"]) for row in rows}
    return texts, set(levels.values())


def test_a_healthy_flight_contradicts_nothing(flown: Result) -> None:
    texts, levels = told(flown.flown.log)
    assert texts == []
    assert DO_NOT_USE not in levels


@pytest.mark.parametrize("factor", [0.5, -1.0, 1.6])
def test_a_wrist_cell_that_is_off_by_a_scale_contradicts_the_payload(flown: Result, factor: float) -> None:
    def spoil(rows: Rows) -> None:
        rows["value_raw"] = np.rint(rows["value_raw"] * factor)

    texts, levels = told(flown.flown.log, "load_cell", spoil)
    assert len(texts) == 1
    assert levels == {DO_NOT_USE}
    assert "load_cell contradicts the payload" in texts[0]


@pytest.mark.parametrize("channel", ["imu_base", "imu_2"])
def test_imus_whose_rates_differ_contradict_each_other(flown: Result, channel: str) -> None:
    def spoil(rows: Rows) -> None:
        rows["gyro_raw"] = np.rint(0.7 * rows["gyro_raw"])

    texts, _ = told(flown.flown.log, channel, spoil)
    assert any("imu_base and imu_2 contradict each other" in text for text in texts)
