"""A flight of DYMAFLEX looked at: by the instruments that its estimator does not use, and by the report.

Second IMU and wrist cell are silent on the healthy flight and loud on a lie: a copy of its log in which one instrument
is off by a scale. In the report and by ``heft predict`` what was identified predicts the gyro, and something else does
not.
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.records import Rows
from onboard import cli, config
from onboard.flight.estimator import Estimator
from onboard.offline.estimate_again.feed import feed
from onboard.offline.report import theme
from onboard.offline.report.base_rate import base_rate
from onboard.offline.report.flight_data import FlightData, gather
from onboard.offline.report.gallery import Gallery
from onboard.offline.report.sections import _base_rate
from onboard.recording.reader import LogReader
from tests.flight.missions import Result, fly

DO_NOT_USE = 2  # level of QUANTITY
SEQUENCE = [
    {"phase": 0, "action": "hold", "duration_s": 1.0},
    {
        "phase": 1,
        "action": "swing",
        "duration_s": 15.0,
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


def told(log: Path, channel: str, spoil: Callable[[Rows], None]) -> tuple[list[str], set[int]]:
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
    assert flown.events("contradiction") == []
    said = flown.log.read("quantity")
    assert len(said) > 0
    assert DO_NOT_USE not in said["level"][-10:].tolist()


@pytest.mark.parametrize("factor", [0.5, -1.0])
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


@pytest.fixture(scope="module")
def gathered(flown: Result) -> FlightData:
    return gather(flown.path)


def test_the_identified_payload_predicts_the_gyro_in_the_report(gathered: FlightData) -> None:
    found = base_rate(gathered)
    assert found is not None
    assert found.time_s[-1] - found.time_s[found.fitted] > 4.0
    swing = np.ptp(found.measured, axis=0)
    assert (swing > np.radians(5.0)).all()
    assert (found.rms < 0.03 * swing.max()).all()
    with theme.figures():
        assert "gyro less prediction" in _base_rate(gathered, Gallery())


def test_another_vehicle_does_not(gathered: FlightData, monkeypatch: pytest.MonkeyPatch) -> None:
    right = base_rate(gathered)
    assert right is not None
    assert gathered.model is not None
    chi = gathered.model.chi.copy()
    chi[:10] *= 2.0  # of the base
    monkeypatch.setattr(gathered.model, "chi", chi)
    wrong = base_rate(gathered)
    assert wrong is not None
    assert np.linalg.norm(wrong.rms) > 3.0 * np.linalg.norm(right.rms)


def test_predict_shows_three_derivations_of_one_motion(gathered: FlightData, tmp_path: Path) -> None:
    told, drawn, figure = (tmp_path / name for name in ("told.json", "drawn.json", "figure.png"))
    log = str(gathered.info.path)
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


def test_only_a_floating_base_is_predicted(gathered: FlightData, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["predict", str(gathered.info.path), "--vehicle", "rocksat"]) == cli.BAD_INPUT
    assert 'base = "prescribed"; only of a floating base is a motion predicted' in capsys.readouterr().err
