"""DYMAFLEX's second IMU and wrist cell are fused; one that contradicts the others is named and left out.

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

MASS_kg = 5.0
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
    path = tmp_path_factory.mktemp("fused") / "flight.mcap"
    return fly(path, 11, vehicle="dymaflex", sequence=SEQUENCE, capture={"earliest_s": 4.0, "latest_s": 5.0})


def told(log: Path, channel: str, spoil: Callable[[Rows], None]) -> tuple[list[str], np.void]:
    """Instruments left out, and the last answer for the mass, when one channel of the log is spoilt on its way in."""
    reader = LogReader(log)
    estimator = Estimator(config.load(config.packaged("dymaflex")))
    process, texts, masses = estimator.process, list[str](), list[np.void]()

    def spoilt(now_ns, batches, *rest):
        taken = dict(batches)
        if channel in taken:
            taken[channel] = taken[channel].copy()
            spoil(taken[channel])
        return process(now_ns, taken, *rest)

    estimator.process = spoilt
    for name, rows in feed(estimator, reader):
        if "code" in (rows.dtype.names or ()):
            texts += [row["text"].decode() for row in rows if row["code"] in (b"left_out", b"taken_back")]
        elif name == "quantity":
            masses += [row.copy() for row in rows if row["name"] == b"m_payload"]
    return texts, masses[-1]


def test_a_healthy_flight_leaves_nothing_out(flown: Result) -> None:
    log = LogReader(flown.flown.log)
    assert not {b"left_out", b"contradiction"} & set(log.read("event")["code"].tolist())
    rows = log.read("quantity")
    [mass] = rows[rows["name"] == b"m_payload"][-1:]
    assert log.read("row")["measured"].shape[1] == 13
    assert mass["level"] == 0
    assert abs(mass["value"] - MASS_kg) < 3.0 * mass["sigma"]
    assert mass["sigma"] < 0.006 * MASS_kg  # 0.009 without the wrist cell


def test_a_wrist_cell_of_a_wrong_scale_is_left_out_from_the_start(flown: Result) -> None:
    def spoil(rows: Rows) -> None:
        rows["value_raw"] = np.rint(rows["value_raw"] * 0.5)

    texts, mass = told(flown.flown.log, "load_cell", spoil)
    assert texts == ["load_cell contradicts the other instruments: estimates without it"]
    assert_weak(mass, "load_cell")


def test_a_wrist_cell_whose_scale_changes_in_flight_is_left_out(flown: Result) -> None:
    start_ns = int(LogReader(flown.flown.log).read("load_cell")["host_ns"][0])

    def spoil(rows: Rows) -> None:
        late = rows["host_ns"] > start_ns + 12_000_000_000
        rows["value_raw"][late] = np.rint(1.1 * rows["value_raw"][late])

    texts, mass = told(flown.flown.log, "load_cell", spoil)
    assert texts == ["load_cell contradicts the other instruments: estimates without it"]
    assert_weak(mass, "load_cell")


def test_a_second_imu_of_a_wrong_scale_is_left_out(flown: Result) -> None:
    def spoil(rows: Rows) -> None:
        rows["gyro_raw"] = np.rint(0.7 * rows["gyro_raw"])

    texts, mass = told(flown.flown.log, "imu_2", spoil)
    assert texts == ["imu_2 contradicts the other instruments: estimates without it"]
    assert_weak(mass, "imu_2")


def assert_weak(mass: np.void, without: str) -> None:
    assert mass["level"] == 1
    assert mass["why"] == f"without {without}, which contradicts the others".encode()
    assert mass["supported"]
    assert abs(mass["value"] - MASS_kg) < 3.0 * mass["sigma"]
