"""A flight of DYMAFLEX looked at: by all its instruments, and by the report.

Second IMU and wrist cell are fused; one that contradicts the others is named and left out. Each lie is a copy of the
log in which one instrument is off by a scale. In the report and by ``heft predict`` what was identified predicts the
gyro, and something else does not. A second IMU that is not fused has its rates compared with the first one's.
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.records import Rows
from onboard import cli, config
from onboard.flight.estimate.answers import change_event
from onboard.flight.estimate.estimation import SUFFIX
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.readings.at_ticks import ChannelAtTicks
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.witness import RateWitness
from onboard.ground.drawing import theme
from onboard.ground.drawing.gallery import Gallery
from onboard.ground.identify.identify import identify
from onboard.ground.identify.replay.feed import feed
from onboard.ground.report.flight.base_rate import base_rate
from onboard.ground.report.flight.flight_data import FlightData, gather
from onboard.ground.report.flight.sections import base_rate_section
from onboard.identification.online import Change
from onboard.identification.standing import Level
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.flight.missions import Result

MASS_kg = 5.0
EVENTS = "event" + SUFFIX
NOISE_rad_s = 6e-4


def told(log: Path, channel: str, spoil: Callable[[Rows], None]) -> tuple[list[str], np.void]:
    """Instruments left out, and the last answer for the mass, when one channel of the log is spoilt on its way in."""
    reader = LogReader(log)
    estimator = Estimator(config.load(config.packaged("dymaflex")), at_the_end=True)
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
            texts += [row["text"].decode() for row in rows if row["code"] in (b"left_out", b"absent", b"taken_back")]
        elif name == "quantity":
            masses += [row.copy() for row in rows if row["name"] == b"m_payload"]
    return texts, masses[-1]


def test_a_healthy_flight_leaves_nothing_out(catch: Result) -> None:
    log = LogReader(catch.flown.log)
    assert not {b"left_out", b"contradiction"} & set(log.read("event")["code"].tolist())
    rows = log.read("quantity")
    [mass] = rows[rows["name"] == b"m_payload"][-1:]
    assert log.read("row")["measured"].shape[1] == 13
    assert mass["level"] == 0
    assert abs(mass["value"] - MASS_kg) < 3.0 * mass["sigma"]
    assert mass["sigma"] < 0.006 * MASS_kg  # 0.009 without the wrist cell


@pytest.mark.campaign  # later: below; of lines: test_fusion
@pytest.mark.parametrize("factor", [0.7, 0.5])
def test_a_wrist_cell_of_a_wrong_scale_is_left_out_from_the_start_or_after_a_capture(
    catch: Result, factor: float
) -> None:
    """Nothing contradicts half of its scale before a capture: the empty arm hardly loads it.

    The last link takes up its error, and no payload explains the motion with both.
    """

    def spoil(rows: Rows) -> None:
        rows["value_raw"] = np.rint(rows["value_raw"] * factor)

    texts, mass = told(catch.flown.log, "load_cell", spoil)
    assert texts == ["load_cell contradicts the other instruments: estimates without it"]
    assert_weak(mass, "load_cell")


@pytest.mark.parametrize(
    ("name", "field", "factor", "from_s"),
    [
        ("load_cell", "value_raw", 1.1, 10.0),
        pytest.param("imu_2", "gyro_raw", 0.7, -1.0, marks=pytest.mark.campaign),
        pytest.param("imu_base", "gyro_raw", 0.7, 11.0, marks=pytest.mark.campaign),
    ],
)
def test_an_instrument_whose_scale_is_wrong_from_the_start_or_changes_in_flight_is_left_out(
    catch: Result, name: str, field: str, factor: float, from_s: float
) -> None:
    start_ns = int(LogReader(catch.flown.log).read(name)["host_ns"][0])

    def spoil(rows: Rows) -> None:
        late = rows["host_ns"] > start_ns + round(1e9 * from_s)
        rows[field][late] = np.rint(factor * rows[field][late])

    texts, mass = told(catch.flown.log, name, spoil)
    assert texts == [f"{name} contradicts the other instruments: estimates without it"]
    assert_weak(mass, name)


@pytest.mark.campaign  # a wrong scale: above; no readings: below; of lines: test_fusion
def test_a_first_imu_of_swapped_axes_is_left_out(catch: Result) -> None:
    def spoil(rows: Rows) -> None:
        rows["gyro_raw"] = rows["gyro_raw"][:, [1, 0, 2]]

    texts, mass = told(catch.flown.log, "imu_base", spoil)
    assert texts == ["imu_base contradicts the other instruments: estimates without it"]
    assert_weak(mass, "imu_base")


@pytest.mark.campaign  # of lines: test_fusion; that one is left out in flight: above
def test_without_readings_of_the_first_imu_the_second_one_is_enough(catch: Result) -> None:
    def spoil(rows: Rows) -> None:
        rows["gyro_raw"], rows["accel_raw"] = 5, 7

    texts, mass = told(catch.flown.log, "imu_base", spoil)
    assert texts == ["imu_base has no readings that can be used: estimates without it"]
    assert mass["why"] == b"without imu_base, which gives no readings"
    assert abs(mass["value"] - MASS_kg) < 3.0 * mass["sigma"]
    assert mass["sigma"] < 0.006 * MASS_kg


@pytest.mark.parametrize("told_on_board", [False, True])
def test_on_the_ground_a_wrong_scale_is_named_and_one_that_was_left_out_and_is_right_takes_part(
    catch: Result, tmp_path: Path, told_on_board: bool
) -> None:
    """The wrist cell reads 8 % more, unnoticed on board; or nothing is wrong but that it was left out on board."""
    copy, wanted = tmp_path / "copy.mcap", {*config.load(config.packaged("dymaflex")).channels, "estimate", EVENTS}
    with LogWriter.create(copy, durable=False) as writer:
        for name, rows in LogReader(catch.flown.log).batches():
            if name in wanted:
                if name == "load_cell" and not told_on_board:
                    rows["value_raw"] = np.rint(1.08 * rows["value_raw"])
                writer.register(name, rows.dtype)
                writer.write(name, rows)
        if told_on_board:
            name, said = change_event(int(rows["host_ns"][-1]), Change("left_out", np.nan, np.nan, np.nan, "load_cell"))
            writer.write(EVENTS, said)
    (found,) = identify(config.load(config.packaged("dymaflex")), [copy]).logs
    mass, centre_m = found.answers[0], found.answers[1]
    assert "without" not in found.verdict.text
    assert ("not as stated: load_cell" in found.verdict.text) is not told_on_board
    assert (found.verdict.level is Level.GOOD) is told_on_board
    assert abs(mass.value - MASS_kg) < 3.0 * mass.sigma
    assert (mass.sigma < 0.006 * MASS_kg) is told_on_board  # 0.009 without the wrist cell
    assert ("device.load_cell.scale_sigma" in mass.leans) is told_on_board
    assert "load_cell" in found.residuals
    assert abs(centre_m.value - 0.03) < 4.0 * centre_m.sigma


def assert_weak(mass: np.void, without: str) -> None:
    assert mass["level"] == 1
    assert mass["why"] == f"without {without}, which contradicts the others".encode()
    assert mass["supported"]
    assert abs(mass["value"] - MASS_kg) < 3.0 * mass["sigma"]


class Shown:
    """What two IMUs show of one motion, the second one's rates off by a scale."""

    def __init__(self, axes, scale: float) -> None:
        self._axes, self._scale = axes, scale
        self._rng = np.random.default_rng(2)

    def means(self, names, timebase, at_ns, period_ns) -> ChannelAtTicks:
        second = names[0] == "imu_2"
        t = at_ns[:, None] * 1e-9
        rate = (self._scale if second else 1.0) * 0.1 * np.sin(t * [1.0, 1.7, 2.9]) @ self._axes[int(second)]
        rate = rate + NOISE_rad_s * self._rng.standard_normal(rate.shape) + 0.02  # noise and a bias
        return ChannelAtTicks((rate,), (np.full((len(t), 6), NOISE_rad_s),), np.zeros(len(t), np.int64))


@pytest.mark.parametrize(("scale", "contradicts"), [(1.0, False), (1.04, False), (0.92, True), (-1.0, True)])
def test_rates_that_differ_by_a_scale_contradict_each_other(scale: float, contradicts: bool) -> None:
    vehicle = config.load(config.packaged("dymaflex"))
    model, imus = build_model(vehicle), roles_of(vehicle).imus
    axes = [model.pose_in_base(imu.frame)[0] for imu in imus]
    witness, shown = RateWitness(model, (imus[0], imus[1]), 0.003), Shown(axes, scale)
    begun = [witness.check(shown, None, 10_000_000 * np.arange(k, k + 10), 10_000_000) for k in range(0, 400, 10)]
    assert sum(begun) == int(contradicts)
    assert ("imu_base and imu_2 contradict each other" in witness.contradiction) == contradicts


@pytest.fixture(scope="module")
def gathered(catch: Result) -> FlightData:
    return gather(catch.path)


def test_the_identified_payload_predicts_the_gyro_in_the_report(gathered: FlightData) -> None:
    found = base_rate(gathered)
    assert found is not None
    assert found.time_s[-1] - found.time_s[found.fitted] > 4.0
    swing = np.ptp(found.measured, axis=0)
    assert (swing > np.radians(5.0)).all()
    assert (found.rms < 0.03 * swing.max()).all()
    stated = config.load(config.packaged("dymaflex")).file.estimation.imu_prior.gyro_bias_rad_s
    assert (np.abs(found.offset) < 3.0 * stated).all()  # 0.1 rad/s where it may be anything
    with theme.figures():
        assert "gyro less prediction" in base_rate_section(gathered, Gallery())


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
