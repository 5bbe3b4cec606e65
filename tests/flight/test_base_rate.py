"""Base rate in the report and by ``heft predict``: what was identified predicts the gyro, something else does not."""

import json
from pathlib import Path

import numpy as np
import pytest

from onboard import cli
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


def test_predict_shows_three_derivations_of_one_motion(flight: FlightData, tmp_path: Path) -> None:
    told, drawn, figure = (tmp_path / name for name in ("told.json", "drawn.json", "figure.png"))
    log = str(flight.info.path)
    assert cli.main(["predict", log, "--seconds", "12", "--json", str(told), "--figure", str(figure)]) == cli.OK
    assert figure.stat().st_size > 20_000
    found = json.loads(told.read_text())
    assert found["payload_held"]
    assert "onboard estimate" in found["parameters"]
    methods = found["methods"]
    assert set(methods) == {"exiddm", "virtual_manipulator", "generalized_jacobian"}
    assert max(methods["exiddm"]["rms_deg_s"]) < 0.03 * max(found["swing_deg_s"])
    assert methods["exiddm"]["turned_deg"] > 5.0
    assert methods["exiddm"]["angle_error_worst_deg"] < 0.1 * methods["exiddm"]["turned_deg"]
    for other in ("virtual_manipulator", "generalized_jacobian"):
        np.testing.assert_allclose(methods[other]["predicted_deg_s"], methods["exiddm"]["predicted_deg_s"], atol=1e-6)
    one = ["--method", "generalized_jacobian", "--seconds", "12", "--drawn"]
    assert cli.main(["predict", log, *one, "--json", str(drawn)]) == cli.OK
    worse = json.loads(drawn.read_text())["methods"]["generalized_jacobian"]
    assert np.linalg.norm(worse["rms_deg_s"]) > 3.0 * np.linalg.norm(methods["exiddm"]["rms_deg_s"])


def test_only_a_floating_base_is_predicted(flight: FlightData, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["predict", str(flight.info.path), "--vehicle", "rocksat"]) == cli.BAD_INPUT
    assert 'base = "prescribed"; only of a floating base is a motion predicted' in capsys.readouterr().err
