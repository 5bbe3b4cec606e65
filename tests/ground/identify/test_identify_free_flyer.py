"""``heft identify`` on a free-flyer's log: MuJoCo's flight, the payload by maximum likelihood, the verdict with it."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from bench.true_flights import free_flyer
from bench.true_flights.free_flyer_sensors import ImuErrors
from onboard import channels, cli, config
from onboard.dynamics.model.payload import standard_of
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.identify.identify import identify
from onboard.ground.identify.kinds import free_flyer_log
from onboard.ground.identify.kinds.likelihood_log import longest_held
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.free_flyer.recursion.recursive import MotionFilter
from onboard.identification.online import Change
from onboard.identification.standing import Level
from onboard.identification.whole_flight import witnesses
from onboard.identification.whole_flight.segments import in_windows
from onboard.recording.format.errors import ChannelError
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.dynamics.free_flyer_twin import BOX, PAYLOAD, Twin, twin
from tests.recording.logs import make_log, sampled_rows

VEHICLE = config.load(config.packaged("dymaflex_parabolic"))
ERRORS = ImuErrors(0.01, 1e-4, 0.1, 1e-3, 0.003, 0.0035, 1e-4)
WIDE = ("I_xx_payload: its interval is as wide as 22% of it",)  # an uncalibrated IMU, six seconds


@pytest.fixture(scope="module")
def flown() -> Twin:
    return twin(6.0)


def still(seconds: float) -> Twin:
    """No joint moves."""
    flown = twin(0.1)
    motion = dataclasses.replace(flown.motion, amplitude_rad=np.zeros_like(flown.motion.amplitude_rad))
    flight = free_flyer.fly(free_flyer.world(BOX), motion, (0.03, -0.02, 0.04), seconds)
    return flown._replace(motion=motion, flight=flight)


def write(path: Path, flown: Twin, rng: np.random.Generator, axes: tuple[int, int, int] = (0, 1, 2)) -> Path:
    """A log of the flight, the gyro's axes in this order."""
    samples = flown.samples(rng, ERRORS)
    samples = samples._replace(rate_rad_s=samples.rate_rad_s[:, axes])
    return make_log(path, sampled_rows(samples), overwrite=True)


@pytest.mark.campaign  # of the fit: tests/identification/whole_flight/test_fit.py
def test_a_flight_whose_whole_cannot_be_predicted_is_fitted_in_windows(
    flown: Twin, tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Joints move twice as far, the base turns at 1 rad/s: a guess of the payload 10 % off is lost in chaos."""
    motion = dataclasses.replace(flown.motion, amplitude_rad=2.0 * flown.motion.amplitude_rad)
    tumbles = free_flyer.fly(free_flyer.world(BOX), motion, (0.3, 1.0, 0.3), 30.0)
    plain = write(tmp_path / "plain.mcap", flown._replace(motion=motion, flight=tumbles), rng)
    log, divided = answered(plain, tmp_path / "log.mcap", 1.1 * standard_of(PAYLOAD)), list[Any]()
    monkeypatch.setattr(free_flyer_log, "in_windows", lambda *given: divided.append(given) or in_windows(*given))
    (found,) = identify(VEHICLE, [log]).logs
    assert len(divided) == 1
    assert found.answers[0].value == pytest.approx(PAYLOAD.mass_kg, rel=0.03)


def test_the_payload_with_its_verdict_and_urdf(
    flown: Twin, tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    log, report, urdf = write(tmp_path / "parabola.mcap", flown, rng), tmp_path / "r.json", tmp_path / "out.urdf"
    page = tmp_path / "page.html"
    arguments = ["--vehicle", "dymaflex_parabolic", str(log), "--json", str(report), "--urdf", str(urdf)]
    assert cli.main(["identify", *arguments, "--report", str(page)]) == cli.OK
    assert "accelerometer z: autocorrelation" in page.read_text()
    assert "method exiddm" in " ".join(capsys.readouterr().out.split())
    told = json.loads(report.read_text())["logs"][0]
    assert (told["verdict"]["level"], tuple(told["verdict"]["reasons"])) == ("weak", WIDE)
    assert told["misfit"] == pytest.approx(1.0, abs=0.1)
    answers = {answer["name"]: answer for answer in told["quantities"]}
    truth = {"m_payload": PAYLOAD.mass_kg, "I_zz_payload": PAYLOAD.inertia_kg_m2[2, 2]}
    truth |= {f"c_{axis}_payload": value for axis, value in zip("xyz", PAYLOAD.centre_of_mass_m, strict=True)}
    for name, value in truth.items():
        assert answers[name]["low"] - answers[name]["sigma"] < value < answers[name]["high"] + answers[name]["sigma"]
        assert answers[name]["bound"] <= (1.0 + 1e-9) * answers[name]["sigma"]  # the same but for rounding
    assert told["held_out"]["later_from_earlier"]["relative_error"] < 0.1
    assert told["observable"]["determined"] == 10
    spec = mujoco.MjSpec.from_string(urdf.read_text())
    spec.compiler.fusestatic = False
    assert spec.compile().body("payload").mass[0] == pytest.approx(answers["m_payload"]["value"], rel=1e-12)


def answered(plain: Path, log: Path, mean: np.ndarray, again_after_s: float = 0.0, factor: int = 1) -> Path:
    """The same log with an onboard answer; its last second once more after a pause; times multiplied."""
    with LogWriter.create(log, durable=False) as writer:
        for name, rows in LogReader(plain).batches():
            rows["host_ns"] *= factor
            writer.register(name, rows.dtype)
            writer.write(name, rows)
            if again_after_s and rows["host_ns"][-1] > 5_900_000_000:
                later = rows[rows["host_ns"] > 5_000_000_000].copy()
                later["host_ns"] += round(1e9 * again_after_s)
                later["sequence"] += len(later)
                writer.write(name, later)
        answer = np.zeros(1, channels.estimate_dtype(10, 11))
        answer["host_ns"], answer["mean"] = 6_000_000_000, mean
        writer.register("estimate", answer.dtype)
        writer.write("estimate", answer)
    return log


def test_it_starts_from_the_onboard_answer_in_the_log(
    flown: Twin, tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = write(tmp_path / "plain.mcap", flown, rng)
    (wanted,) = identify(VEHICLE, [plain]).logs
    log = answered(plain, tmp_path / "answered.mcap", 1.1 * standard_of(PAYLOAD))
    monkeypatch.setattr(MotionFilter, "update", lambda *_: pytest.fail("the recursive estimator ran"))
    (found,) = identify(VEHICLE, [log]).logs
    assert found.verdict.level is wanted.verdict.level
    for one, other in zip(found.answers, wanted.answers, strict=True):
        assert one.value == pytest.approx(other.value, abs=0.05 * other.sigma)
        assert one.sigma == pytest.approx(other.sigma, rel=0.02)


def test_an_onboard_answer_that_leads_nowhere_is_replaced(
    flown: Twin, tmp_path: Path, rng: np.random.Generator
) -> None:
    """The log's answer is another vehicle's: 40 kg."""
    another = 8.0 * standard_of(PAYLOAD) * np.array([1, -1, 1, 1, 1, 1, 1, 1, 1, 1])
    wrong = answered(write(tmp_path / "plain.mcap", flown, rng), tmp_path / "wrong.mcap", another)
    (found,) = identify(VEHICLE, [wrong]).logs
    assert (found.verdict.level, found.verdict.reasons) == (Level.WEAK, WIDE)
    assert found.answers[0].value == pytest.approx(PAYLOAD.mass_kg, abs=3.0 * found.answers[0].sigma)


def test_a_link_that_the_flight_contradicts_is_a_doubt(
    flown: Twin, tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Short of five sigmas of what the flight tells of it, and not by chance of so many."""
    log, by_the_data = write(tmp_path / "flight.mcap", flown, rng), witnesses._by_the_data
    for off, reasons in (
        (4.5, ("link_2_inertial_8 had to be corrected by 4.5 sigmas of what the flight tells of it",)),
        (3.2, ()),
    ):
        spoilt = {"link_2_inertial_8": off}
        monkeypatch.setattr(witnesses, "_by_the_data", lambda *given, spoilt=spoilt: by_the_data(*given) | spoilt)
        (found,) = identify(VEHICLE, [log]).logs
        assert found.verdict.reasons == (*reasons, *WIDE)


def test_a_correction_that_is_fitted_freely_widens_the_interval_and_not_the_bound(
    flown: Twin, tmp_path: Path, rng: np.random.Generator
) -> None:
    """The accelerometer reads 8 % too much of everything; the bound stays that of the stated sigmas."""
    plain = answered(write(tmp_path / "plain.mcap", flown, rng), tmp_path / "answered.mcap", standard_of(PAYLOAD))
    with LogWriter.create(tmp_path / "scaled.mcap", durable=False) as writer:
        for name, rows in LogReader(plain).batches():
            if name == "imu_base":
                rows["accel_raw"] = np.rint(1.08 * rows["accel_raw"])
            writer.register(name, rows.dtype)
            writer.write(name, rows)
    (healthy,), (found,) = (identify(VEHICLE, [log]).logs for log in (plain, tmp_path / "scaled.mcap"))
    assert "not as stated: imu_base" in found.verdict.text
    assert found.answers[0].bound == pytest.approx(healthy.answers[0].bound, rel=0.05)
    assert found.answers[0].sigma > 1.1 * found.answers[0].bound
    assert healthy.answers[0].sigma < 1.05 * healthy.answers[0].bound
    mass, c_x = healthy.answers[:2]  # of which faults of small probability widen the second alone
    assert mass.outer == pytest.approx((mass.value - 3.29 * mass.sigma, mass.value + 3.29 * mass.sigma), rel=1e-3)
    assert c_x.outer[1] - c_x.outer[0] > 1.01 * 2.0 * 3.29 * c_x.sigma
    assert c_x.as_json()["high_999"] == c_x.outer[1]


def test_an_hour_without_a_recording_is_left_out(
    flown: Twin, tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = write(tmp_path / "plain.mcap", flown, rng)
    (wanted,) = identify(VEHICLE, [answered(plain, tmp_path / "one.mcap", standard_of(PAYLOAD))]).logs
    steps = 0
    process = Estimator.process

    def counted(*arguments: Any) -> Any:
        nonlocal steps
        steps += 1
        return process(*arguments)

    monkeypatch.setattr(Estimator, "process", counted)
    log = answered(plain, tmp_path / "two.mcap", standard_of(PAYLOAD), again_after_s=3600.0)
    (found,) = identify(VEHICLE, [log]).logs
    assert steps < 100
    assert found.verdict.level is wanted.verdict.level
    assert found.answers[0].value == pytest.approx(wanted.answers[0].value, abs=0.1 * wanted.answers[0].sigma)


def test_times_of_another_unit_are_refused(flown: Twin, tmp_path: Path, rng: np.random.Generator) -> None:
    log = answered(
        write(tmp_path / "plain.mcap", flown, rng), tmp_path / "slow.mcap", standard_of(PAYLOAD), factor=1000
    )
    with pytest.raises(ChannelError, match=r"samples of imu_base are 2000 ms apart where .* says 2 ms; check the unit"):
        identify(VEHICLE, [log])


def test_an_arm_that_stands_still_shows_nothing(tmp_path: Path, rng: np.random.Generator) -> None:
    (found,) = identify(VEHICLE, [write(tmp_path / "still.mcap", still(3.0), rng)]).logs
    assert found.verdict.level is Level.DO_NOT_USE
    assert not found.usable
    assert not any(answer.supported for answer in found.answers)


@pytest.mark.campaign  # of throws: test_identify_verdict; they are named: kinds/test_misread
def test_swapped_gyro_axes_are_no_body(tmp_path: Path, rng: np.random.Generator) -> None:
    (found,) = identify(VEHICLE, [write(tmp_path / "swapped.mcap", twin(3.0), rng, (1, 0, 2))]).logs
    assert found.verdict.level is Level.DO_NOT_USE


def test_less_than_twenty_ticks_are_too_few(tmp_path: Path, rng: np.random.Generator) -> None:
    (found,) = identify(VEHICLE, [write(tmp_path / "short.mcap", twin(1.0), rng)]).logs
    assert found.verdict.level is Level.DO_NOT_USE
    assert "no row could be used" in found.verdict.text
    assert re.search(r"as a payload was held for 0\.\d+ s, 0.2 s are needed", found.verdict.text), found.verdict.text


def test_rows_need_rows(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["identify", "--vehicle", "dymaflex_parabolic", "x.mcap", "--method", "rows"]
    assert cli.main(arguments) == cli.BAD_INPUT
    assert "there are no rows; give base_rows" in capsys.readouterr().err
    assert cli.main(["identify", "--vehicle", "rocksat", "x.mcap", "--method", "exiddm"]) == cli.BAD_INPUT
    assert 'method "exiddm" is for base = "free"' in capsys.readouterr().err


@pytest.mark.parametrize(
    ("held", "changes", "wanted"),
    [
        (True, [], (0.0, 9.99)),
        (False, [Change("capture", 3.2, 3.0, 9.0)], (3.61, 9.99)),
        (True, [Change("ejection", 6.2, 6.0, 9.0)], (0.0, 5.99)),
        (True, [Change("contact", 6.2, 6.0, 9.0)], (0.0, 5.99)),
        (False, [Change("capture", 1.0, 0.9, 9.0), Change("capture", 4.0, 3.9, 9.0)], (4.41, 9.99)),
        (True, [Change("capture", 6.005, 6.005, np.nan)], (0.0, 6.0)),
        (False, [], None),
        (False, [Change("capture", 1.0, 1.0, np.nan), Change("capture_contradicted", 5.0, 5.0, np.nan)], None),
        (True, [Change("ejection", 6.0, 6.0, np.nan), Change("release_contradicted", 7.0, 7.0, np.nan)], (0.0, 5.99)),
    ],
)
def test_the_longest_time_with_one_payload(
    held: bool, changes: list[Change], wanted: tuple[float, float] | None
) -> None:
    time_s = 0.01 * np.arange(1000)
    joints = np.zeros((1000, 5))
    ticks = resting(time_s, joints)
    found = longest_held([ticks.part(slice(0, 400)), ticks.part(slice(400, None))], changes, held, 0.01)
    if wanted is None:
        assert len(found.time_s) == 0
    else:
        np.testing.assert_allclose([found.time_s[0], found.time_s[-1]], wanted, atol=1e-9)


def resting(time_s: NDArray[np.float64], joints: NDArray[np.float64]) -> Ticks:
    n = len(time_s)
    six, exact = (np.zeros((n, 6)), np.ones((n, 6))), (*np.zeros((2, n, 2, 5)), np.zeros((n, 3, 0)), np.zeros((n, 0)))
    return Ticks(time_s, joints, joints, joints, *six, *exact, np.ones(n))


def test_ticks_without_joints_cut_the_time() -> None:
    joints = np.zeros((1000, 5))
    joints[300] = np.nan
    ticks = resting(0.01 * np.arange(1000), joints)
    found = longest_held([ticks], [], True, 0.01)
    assert (found.time_s[0], len(found.time_s)) == (pytest.approx(3.01), 699)
    late = ticks._replace(time_s=ticks.time_s + 0.5 * (np.arange(1000) >= 800))
    assert len(longest_held([late], [], True, 0.01).time_s) == 499
