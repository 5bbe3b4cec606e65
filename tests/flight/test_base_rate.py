"""The report's base rate: what was identified predicts the gyro, and something else does not."""

from pathlib import Path

import numpy as np
import pytest

from onboard.offline.report import report
from onboard.offline.report.base_rate import base_rate
from onboard.offline.report.flight_data import FlightData, gather
from tests.flight.missions import fly

SWING = {"phase": 1, "action": "swing", "ramp_s": 1.5, "swing_deg": 20.0, "tones": 3, "band_Hz": [0.1, 0.6]}
SEQUENCE = [
    {"phase": 0, "action": "hold", "duration_s": 1.0},
    {**SWING, "duration_s": 15.0},
    {"phase": 9, "action": "hold", "duration_s": 0.5},
]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> FlightData:
    path = tmp_path_factory.mktemp("base_rate") / "flight.mcap"
    fly(path, 3, vehicle="dymaflex", sequence=SEQUENCE, capture={"earliest_s": 4.0, "latest_s": 4.5})
    return gather(path)


def test_the_identified_payload_predicts_the_gyro(flight: FlightData) -> None:
    found = base_rate(flight)
    assert found is not None
    assert found.time_s[-1] - found.time_s[found.fitted] > 4.0
    swing = np.ptp(found.measured, axis=0)
    assert (swing > np.radians(5.0)).all()
    assert (found.rms < 0.03 * swing.max()).all()


def test_another_vehicle_does_not(flight: FlightData, monkeypatch: pytest.MonkeyPatch) -> None:
    right = base_rate(flight)
    assert right is not None
    assert flight.model is not None
    chi = flight.model.chi.copy()
    chi[:10] *= 2.0  # of the base
    monkeypatch.setattr(flight.model, "chi", chi)
    wrong = base_rate(flight)
    assert wrong is not None
    assert np.linalg.norm(wrong.rms) > 3.0 * np.linalg.norm(right.rms)


def test_the_page_shows_it(flight: FlightData, tmp_path: Path) -> None:
    report(flight.info.path, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "<h2" in text
    assert "gyro less prediction" in text
