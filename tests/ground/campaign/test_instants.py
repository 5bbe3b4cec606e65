"""Estimates in the course of a flight, held against a truth that changes when a payload is caught and let go."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard import channels, config
from onboard.ground.campaign.instants import CHANGING_S, of_flight
from onboard.recording.reader import LogReader
from tests.recording.logs import make_log

START_NS = 7_000_000_000
CAPTURE_S, EJECTION_S = 10.0, 20.0
VEHICLE = config.load(config.packaged("dymaflex"))


def truth(**more: float | None) -> dict[str, Any]:
    own = {"m_payload": 5.0, "c_x_payload": 0.03}
    none = {"gripped_s": None, "ejection_s": None}
    world = {"start_ns": START_NS, "payload_link": "payload", "pucks": {}, "capture_s": CAPTURE_S, "quantities": own}
    return {**world, **none, **more}


def told(path: Path, *estimates: tuple[str, float, float, float], level: int = 0, supported: int = 1) -> LogReader:
    """A log of estimates: name, mission time s, value, half width of 95 %; 99.9 % is 2 of them below, 3 above."""
    rows = np.zeros(len(estimates), channels.QUANTITY)
    for row, (name, at_s, value, half) in zip(rows, estimates, strict=True):
        row["name"], row["vehicle_ns"] = name.encode(), START_NS + round(1e9 * at_s)
        row["value"], row["low"], row["high"] = value, value - half, value + half
        row["low_999"], row["high_999"] = value - 2.0 * half, value + 3.0 * half
        row["level"], row["supported"] = level, supported
    rows["sequence"] = np.arange(len(rows))
    return LogReader(make_log(path, {"quantity": rows}))


def test_an_estimate_that_was_wrong_for_a_while_counts(tmp_path: Path) -> None:
    log = told(tmp_path / "a.mcap", ("m_payload", 12.0, 5.6, 0.1), ("m_payload", 13.0, 5.05, 0.1))
    found = of_flight(log, VEHICLE, truth())["m_payload"]
    assert (found.told, found.beyond, found.good_beyond) == (2, 1, 1)
    assert found.farthest == pytest.approx(0.6 / 0.2)  # its lower side is twice that of 95 %


def test_an_interval_is_longer_on_one_side(tmp_path: Path) -> None:
    log = told(tmp_path / "a.mcap", ("m_payload", 12.0, 4.75, 0.1), ("m_payload", 13.0, 5.25, 0.1))
    assert of_flight(log, VEHICLE, truth())["m_payload"].beyond == 1


def test_what_is_weak_and_wrong_is_wrong_but_not_good(tmp_path: Path) -> None:
    log = told(tmp_path / "a.mcap", ("m_payload", 12.0, 5.6, 0.1), level=1)
    found = of_flight(log, VEHICLE, truth())["m_payload"]
    assert (found.told, found.beyond, found.good_beyond) == (1, 1, 0)


def test_what_is_not_supported_is_not_told(tmp_path: Path) -> None:
    log = told(tmp_path / "a.mcap", ("m_payload", 12.0, 5.6, 0.1), supported=0)
    assert of_flight(log, VEHICLE, truth()) == {}


@pytest.mark.parametrize(
    ("at_s", "value", "beyond"),
    [
        (CAPTURE_S - 1.0, 5.0, 1),  # nothing is held yet
        (CAPTURE_S - 1.0, 0.0, 0),
        (CAPTURE_S + CHANGING_S, 0.0, 1),
        (EJECTION_S - 0.1, 5.0, 0),
        (EJECTION_S + CHANGING_S, 5.0, 1),
        (EJECTION_S + CHANGING_S, 0.0, 0),
    ],
)
def test_before_the_capture_and_after_the_ejection_the_mass_is_zero(
    tmp_path: Path, at_s: float, value: float, beyond: int
) -> None:
    log = told(tmp_path / "a.mcap", ("m_payload", at_s, value, 0.1))
    found = of_flight(log, VEHICLE, truth(ejection_s=EJECTION_S))["m_payload"]
    assert (found.told, found.beyond) == (1, beyond)


@pytest.mark.parametrize("at_s", [CAPTURE_S, CAPTURE_S + 0.99 * CHANGING_S, EJECTION_S + 0.99 * CHANGING_S])
@pytest.mark.parametrize("value", [0.0, 5.0])
def test_just_after_a_change_nothing_counts(tmp_path: Path, at_s: float, value: float) -> None:
    log = told(tmp_path / "a.mcap", ("m_payload", at_s, value, 0.1))
    assert of_flight(log, VEHICLE, truth(ejection_s=EJECTION_S))["m_payload"].told == 0


def test_a_centre_of_mass_of_nothing_has_no_truth(tmp_path: Path) -> None:
    log = told(tmp_path / "a.mcap", ("c_x_payload", 5.0, 1.0, 0.1), ("c_x_payload", 15.0, 0.03, 0.1))
    found = of_flight(log, VEHICLE, truth())["c_x_payload"]
    assert (found.told, found.beyond) == (1, 0)


def test_an_interval_without_width_that_misses_is_beyond(tmp_path: Path) -> None:
    log = told(tmp_path / "a.mcap", ("m_payload", 15.0, 5.1, 0.0))
    assert of_flight(log, VEHICLE, truth())["m_payload"].beyond == 1
