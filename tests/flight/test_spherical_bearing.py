"""The platform on a spherical air bearing: its answers on board, on the ground, of a recording; what refuses them."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.scenario.load import Scenario
from onboard import config
from onboard.cli import main
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate import state
from onboard.flight.estimate.answers import useful_of
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.identification import build_online
from onboard.ground.identify.identify import identify
from onboard.ground.identify.kinds import table_log
from onboard.ground.identify.kinds.identified import Identified
from onboard.ground.identify.replay.feed import fed, feed
from onboard.ground.identify.replay.replay import replay
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.pivot.online import UNCHECKED, PivotRun
from onboard.identification.quantities import sizes
from onboard.identification.rows.free_body import FREE_BODY
from onboard.identification.standing import Level, standing
from onboard.recording.reader import LogReader
from tests.flight.estimate.state_bytes import to_bytes
from tests.flight.missions import Result, fly

NAMES = (*FREE_BODY, "move_trim_x", "move_trim_y", "move_trim_z")
DOCS = Path(__file__).parents[2] / "docs" / "spherical_bearing.md"


def scenario() -> Scenario:
    """The packaged one, with four strokes a sweep in place of seven and eight."""
    steps = [step.model_dump(exclude_unset=True) for step in scenario_of("spherical_bearing").sequence]
    for step in (step for step in steps if "strokes" in step):
        step["duration_s"] *= 4 / step["strokes"]
        step["strokes"] = 4
    return scenario_of("spherical_bearing", {"sequence": steps})


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Result:
    path = tmp_path_factory.mktemp("pivot") / "flight.mcap"
    return fly(path, 2, scenario(), "spherical_bearing")


class Kept(NamedTuple):
    """The ticks of a flight, and what ``heft identify`` says of them."""

    ticks: Ticks
    held: FloatArray
    truth: dict[str, float]
    found: Identified


@pytest.fixture(scope="module")
def kept(flown: Result) -> Kept:
    runs: list[PivotRun] = []

    def watched(estimator: Estimator, log: LogReader) -> None:
        assert isinstance(estimator.online, PivotRun)
        runs.append(estimator.online)
        fed(estimator, log)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table_log, "fed", watched)
        [found] = identify(config.load(config.packaged("spherical_bearing")), [flown.path]).logs
    [run] = runs
    rows = [*flown.table["centres"], *flown.table["inertias"]]
    return Kept(*run.taken, {row["quantity"]: row["truth"] for row in rows}, found)


def test_the_body_is_told_on_board_as_it_was_built(flown: Result) -> None:
    assert flown.table["accounted"], flown.table["channels"]
    rows = {row["quantity"]: row for row in (*flown.table["centres"], *flown.table["inertias"])}
    assert sorted(rows) == sorted(NAMES)
    assert all(row["standing"].startswith("good") for row in rows.values())
    assert sum(row["covered"] for row in rows.values()) >= 10
    for name in ("com_x", "com_y", "com_z"):
        assert abs(rows[name]["value"] - rows[name]["truth"]) < 20e-6
    for name in ("I_xx", "I_yy", "I_zz"):
        assert rows[name]["value"] == pytest.approx(rows[name]["truth"], rel=0.01)


def test_the_balance_masses_bring_the_offset_to_zero(flown: Result) -> None:
    told = {row["quantity"]: row["value"] for row in flown.table["centres"]}
    for axis, mass_kg in zip("xyz", (0.2, 0.2, 0.5), strict=True):
        assert 24.0 * told[f"com_{axis}"] + mass_kg * told[f"move_trim_{axis}"] == pytest.approx(0.0, abs=1e-9)


def test_the_ground_tells_the_same(flown: Result, kept: Kept) -> None:
    found = kept.found
    assert found.verdict.level is Level.GOOD
    rows = {row["quantity"]: row for row in (*flown.table["centres"], *flown.table["inertias"])}
    assert [one.name for one in found.answers] == [*FREE_BODY, *NAMES[9:]]
    for one in found.answers:  # the fit begins elsewhere, and ends a hundredth of a sigma from the minimum at most
        assert one.value == pytest.approx(rows[one.name]["value"], abs=0.01 * one.sigma)
    assert found.residuals.keys() == {f"{one} {axis}" for one in ("gyro", "accelerometer") for axis in "xyz"}
    assert all(0.9 < np.nanstd(of) < 1.2 for of in found.residuals.values())


@pytest.mark.campaign  # its state: below; of a body that tumbles: test_tumble
def test_the_flight_replays(flown: Result) -> None:
    found = replay(flown.path)
    assert found.identical, found.summary


def again(ticks: Ticks, held: FloatArray, change: Callable[[PivotRun], None] = lambda run: None) -> PivotRun:
    """A fresh estimator of these ticks."""
    run, _ = build_online(config.load(config.packaged("spherical_bearing")))
    assert isinstance(run, PivotRun)
    change(run)
    run.take(ticks, np.asarray(held, np.bool_))
    run.finish()
    return run


def measured(ticks: Ticks, matrix: FloatArray) -> Ticks:
    return ticks._replace(measured=ticks.measured @ matrix.T)


def scaled(*factors: float) -> FloatArray:
    return np.diag(np.asarray(factors, np.float64))


def late(ticks: Ticks, by_s: float) -> Ticks:
    return ticks._replace(dq=ticks.dq - by_s * ticks.ddq)


def heavier_wheels(factor: float) -> Callable[[PivotRun], None]:
    def change(run: PivotRun) -> None:
        run.model.stored = run.model.stored * factor

    return change


SWAP = np.eye(6)[[0, 1, 2, 4, 3, 5]]
WRONG: dict[str, tuple[Callable[[Ticks], Ticks], Callable[[PivotRun], None], str]] = {
    "gyro 3 %": (lambda t: measured(t, scaled(1.03, 1.03, 1.03, 1, 1, 1)), lambda r: None, "gyro_scale"),
    "wheels 3 %": (lambda t: t, heavier_wheels(1.03), "proof|wheels' inertia|scale_wheel"),
    "wheels 1.5 %": (lambda t: t, heavier_wheels(1.015), "proof|wheels' inertia|scale_wheel"),
    "accelerometer swapped": (lambda t: measured(t, SWAP), lambda r: None, "accelerometer"),
    "accelerometer 3 %": (lambda t: measured(t, scaled(1, 1, 1, 1.03, 1.03, 1.03)), lambda r: None, "accelerometer"),
    "wheels late": (lambda t: late(t, 0.01), lambda r: None, "delay"),
    "noise": (lambda t: t._replace(sigma=t.sigma / 1.2), lambda r: None, "residuals of the"),
}


@pytest.mark.parametrize(
    "what", [pytest.param(one, marks=pytest.mark.campaign if one == "wheels 1.5 %" else ()) for one in WRONG]
)
def test_what_is_wrong_is_named_and_nothing_is_good(kept: Kept, what: str) -> None:
    spoil, change, named = WRONG[what]
    run = again(spoil(kept.ticks), kept.held, change)
    findings = run.findings()
    assert any(re.search(named, said) for said in findings.against + findings.doubts), findings
    quantities = run.estimate().quantities
    size = sizes(quantities, useful_of(config.load(config.packaged("spherical_bearing"))))
    levels = {standing(one, findings, size.get(one.name)).level for one in quantities}
    assert Level.GOOD not in levels


def test_an_imu_off_its_place_within_its_sigma_harms_nothing(kept: Kept) -> None:
    def change(run: PivotRun) -> None:
        run.model.p_BoSo_B = run.model.p_BoSo_B + np.array([0.005, 0.0, 0.0])

    run = again(kept.ticks, kept.held, change)
    assert run.findings() == again(kept.ticks, kept.held).findings()
    inside = [one.low <= kept.truth[one.name] <= one.high for one in run.estimate().quantities]
    assert sum(inside) >= 10


def test_without_the_proof_mass_the_scale_is_not_checked(kept: Kept) -> None:
    before = np.flatnonzero(kept.held)[0]
    run = again(kept.ticks.part(slice(0, before)), kept.held[:before])
    assert run.findings().doubts == (UNCHECKED.format("wheel_x, wheel_y, wheel_z"),)
    told = {one.name: one for one in run.estimate().quantities}
    assert all(one.supported for one in told.values())
    assert "scale_sigma" in told["I_xx"].leans


@pytest.mark.parametrize(("mass_g", "checked"), [(30.0, True), (12.0, False)])
def test_a_proof_mass_checks_the_scale_to_half_a_per_cent(kept: Kept, mass_g: float, *, checked: bool) -> None:
    """By foresight: a lighter one tells less than :data:`CHECKED`."""

    def change(run: PivotRun) -> None:
        run.model.proof = run.model.proof * mass_g / 30.0

    run, _ = build_online(config.load(config.packaged("spherical_bearing")))
    assert isinstance(run, PivotRun)
    change(run)
    known = slice(int(np.flatnonzero(np.isfinite(kept.ticks.dq).all(axis=1))[0]), None)
    run.foresee(kept.ticks.part(known), np.asarray(kept.held[known], np.bool_), np.zeros(3))
    assert any("nothing checks" in said for said in run.findings().doubts) != checked


def test_its_state_is_written_as_values(flown: Result) -> None:
    """A checkpoint in mid-flight has its answer."""
    vehicle = config.load(config.packaged("spherical_bearing"))
    estimator = Estimator(vehicle, at_the_end=True)
    places = state.UnwrittenParts(estimator)
    for count, _ in enumerate(feed(estimator, flown.log)):
        if count == 400:
            break
    other = state.from_bytes(to_bytes(estimator, places), state.UnwrittenParts(Estimator(vehicle, at_the_end=True)))
    assert isinstance(other, Estimator)
    assert isinstance(other.online, PivotRun)
    assert other.online.found is not None
    assert other.online.estimate().quantities[0].supported


def blocks(page: str) -> list[str]:
    return re.findall(r"```toml\n(.*?)```", page, re.DOTALL)


def files_of_the_page(directory: Path) -> None:
    """Its mapping and its vehicle file, with the packaged drawing."""
    mapping, vehicle = blocks(DOCS.read_text(encoding="utf-8"))
    (directory / "bench.toml").write_text(mapping, encoding="utf-8")
    (directory / "vehicle.toml").write_text(vehicle, encoding="utf-8")
    drawing = config.packaged("spherical_bearing").with_name("spherical_bearing.urdf")
    (directory / drawing.name).write_text(drawing.read_text(encoding="utf-8"), encoding="utf-8")


COLUMNS = "time_s,gx,gy,gz,ax,ay,az,wheel_x,wheel_y,wheel_z,phase"


def test_the_files_of_the_page_are_read_and_name_the_same_channels(tmp_path: Path) -> None:
    files_of_the_page(tmp_path)
    still = np.zeros((400, 11))
    still[:, 0] = 5e-3 * np.arange(400)
    np.savetxt(tmp_path / "run.csv", still, "%.4f", ",", header=COLUMNS, comments="")
    assert main(["import", str(tmp_path / "bench.toml"), str(tmp_path / "run.csv"), "-o", str(tmp_path)]) == 0
    read, vehicle = LogReader(tmp_path / "run.mcap"), config.load(tmp_path / "vehicle.toml")
    assert set(vehicle.channels) <= set(read.channels)
    assert len(read.read("wheel_x")) == 400
    run, _ = build_online(vehicle)
    assert isinstance(run, PivotRun)


@pytest.mark.campaign  # its files: above; what is told of a flight: test_the_ground_tells_the_same
def test_a_recording_is_identified_by_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """CSV of gyro, accelerometer, wheel speeds and phase, by the mapping and the vehicle file of the page."""
    rng = np.random.default_rng(5)
    plant = VehiclePlant(scenario(), rng)
    plant.advance(1e9)
    every = round(5e-3 / plant.step_s)
    imu, n = plant.inertial("imu_base"), plant.count
    rate = imu.rate_rad_s[:n:every] + 1.2e-3 * rng.standard_normal((len(imu.rate_rad_s[:n:every]), 3)) + 0.01
    force = imu.specific_force_m_s2[:n:every] + 0.054 * rng.standard_normal(rate.shape)
    speeds = np.stack([plant.wheel_rate_rad_s(f"wheel_{axis}")[:n:every] for axis in "xyz"], axis=1)
    speeds = speeds + 0.02 * rng.standard_normal(speeds.shape)
    t = 5e-3 * np.arange(len(rate))
    phase = np.where(t < 4.0, 0, np.where(t < plant.events_s["capture"], 1, 2))
    formats = ["%.4f"] + ["%.6f"] * 9 + ["%d"]
    table = np.column_stack([t, rate, force, speeds, phase])
    np.savetxt(tmp_path / "run.csv", table, formats, ",", header=COLUMNS, comments="")
    files_of_the_page(tmp_path)
    assert main(["import", str(tmp_path / "bench.toml"), str(tmp_path / "run.csv"), "-o", str(tmp_path)]) == 0
    [found] = identify(config.load(tmp_path / "vehicle.toml"), [tmp_path / "run.mcap"]).logs
    assert found.verdict.level is Level.GOOD, found.verdict.text
    body = plant.bodies["platform"]
    told = {one.name: one for one in found.answers}
    assert told["com_z"].value == pytest.approx(22.2 / 24.0 * body.centre_of_mass_m[2], abs=60e-6)  # wheels' places
    rotors = sum(
        plant.bodies[f"rotor_{axis}"].inertia_kg_m2[2, 2] + 0.6 * r
        for axis, r in zip("xyz", (0.045, 0.045, 0.09), strict=True)
    )
    assert told["I_zz"].value == pytest.approx(body.inertia_kg_m2[2, 2] + rotors, rel=0.01)
    capsys.readouterr()


def test_a_rehearsal_of_a_copied_file_sets_on_the_mass_that_it_knows(tmp_path: Path) -> None:
    """It was drawn within a quarter of the drawing: all answers were 8 to 21 % off, as far outside their intervals."""
    lab = tmp_path / "lab"
    assert main(["init", str(lab), "--from", "spherical_bearing"]) == 0
    for name in ("spherical_bearing", lab / "vehicle.toml"):
        payload = scenario_of(name).payload
        assert payload is not None
        assert payload.mass_kg == (0.03, 0.03), name
