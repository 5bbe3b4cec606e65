"""RockSat-X in virtual time: from bus bytes to the identified tip mass, and what must hold of its log."""

import io
import json
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from drivers import records
from onboard import cli, config
from onboard.estimation.gates import GateReason
from onboard.flight.check import host
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.store.flight_log import blas_kernels
from onboard.ground.identify.mission import mission_table as table
from onboard.ground.identify.replay import replay as replay_module
from onboard.ground.identify.replay.replay import replay
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.flight.missions import SHORT, SHORTER, Result, fly
from tests.hil_sim.built import AS_DRAWN

HEAVY = {"sequence": SHORT, "as_built": AS_DRAWN | {"tip_mass": AS_DRAWN["tip_mass"] | {"mass_factor": 1.2}}}


def test_the_masses_are_found_within_what_was_promised(mission: Result) -> None:
    inertia = {row["quantity"]: row["truth"] for row in mission.table["inertias"]}
    held, free = inertia["ZZ_joint_1_R_held"], inertia["ZZ_joint_1_R_released"]
    arm = 0.23313 * free / 1.101823e-3  # what the drawing's radii of gyration make of inertias without an error
    tip = 0.06627 * (held - free) / (3.083437e-3 - 1.101823e-3)
    promised = ("m_arm", arm, 3.0), ("m_arm+m_tip_mass", arm + tip, 1.5), ("m_tip_mass", tip, 5.0)
    for quantity, told_kg, percent in promised:
        mass = mission.mass(quantity)
        assert mass["supported"]
        assert abs(mass["value"] / told_kg - 1.0) < 0.01 * percent
        assert mass["low"] < mass["value"] < mass["high"]
        rows = np.sqrt(mass["sigma"] ** 2 - mass["drawn"] ** 2)
        assert 0.2 < 100 * rows / mass["value"] < percent  # the calibration alone is worth 0.35 %
        assert 0.5 < 100 * mass["drawn"] / mass["value"] < 3.0  # a millimetre of the centres of mass
        assert mass["standing"].startswith("good; ")


def test_every_sample_the_devices_made_is_in_the_log(mission: Result) -> None:
    assert mission.table["accounted"]
    counts = mission.table["channels"]
    assert set(counts) == {"imu_base", "joint_1", "load_cell", "arm_phase", "can_sync", "pulse"}
    assert counts["imu_base"]["recorded"] > 60_000
    assert counts["joint_1"]["recorded"] > 12_000
    for name in counts:
        sequence = mission.log.read(name)["sequence"]
        assert np.array_equal(sequence, np.arange(sequence[0], sequence[0] + len(sequence)))


def test_nothing_is_said_before_the_data_support_it(mission: Result) -> None:
    answers = mission.log.read("quantity")
    for name, supported_after_ejection_only in ((b"m_arm", True), (b"m_tip_mass", True), (b"ZZ_joint_1_R_held", False)):
        rows = answers[answers["name"] == name]
        start_ns = mission.flown.truth["start_ns"]
        ejected = rows["vehicle_ns"] > start_ns + mission.flown.truth["ejection_s"] * 1e9
        assert 0 < np.count_nonzero(ejected) < len(rows)
        if supported_after_ejection_only:
            assert not rows["supported"][~ejected].any()
            assert np.isnan(rows["value"][~ejected]).all()
        else:
            assert rows["supported"][~ejected].any()
        assert rows["supported"][-1]


def test_contamination_is_gated_by_name(mission: Result) -> None:
    rows = mission.log.read("row")
    start_ns = mission.flown.truth["start_ns"]
    seconds = (rows["vehicle_ns"] - start_ns) * 1e-9
    gate = rows["gate"][:, 0]
    pushes = [p for p in mission.flown.truth["phases"] if p["action"] == "push"]
    assert len(pushes) == 4
    for push in pushes:
        during = (seconds > push["start_s"]) & (seconds < push["end_s"])
        assert during.any()
        assert (gate[during] & GateReason.PHASE).all()
        assert (gate[during] & GateReason.CONTACT).any()
    cell = mission.log.read("load_cell")
    full_scale = cell[(cell["status"] & records.SampleStatus.SATURATED) != 0]
    assert len(full_scale) == 2
    for glitch_s in (full_scale["host_ns"] - start_ns) * 1e-9:
        near = abs(seconds - glitch_s) < 0.08
        assert near.any()
        assert (gate[near] & GateReason.SATURATED).all()
    reentry = seconds > seconds[-1] - 5.0
    assert (gate[reentry] & GateReason.DRAG).any()
    used, innovation = gate == 0, rows["innovation"][:, 0]
    assert (np.isfinite(innovation) == (gate & ~GateReason.RESIDUAL == 0)).all()
    assert 0.2 < np.sqrt((innovation[used] ** 2).mean()) < 2.0
    assert 1500 < np.count_nonzero(used) < 5000


def test_clocks_are_locked_and_right(mission: Result) -> None:
    clocks = mission.log.read("clock")
    truth = mission.flown.truth["clock"]["imu_base"]
    last = clocks[clocks["channel"] == b"imu_base"][-1]
    true_period = 1e6 / (1 + truth["rate_error"])
    assert abs(last["period_ns"] / true_period - 1) < 100e-6  # the drift of a minute is in there
    assert last["sigma_ns"] < 150e3
    sync = clocks[clocks["channel"] == b"can_sync"][-1]
    assert abs(sync["period_ns"] / 5e6 - 1) < 100e-6
    assert sync["rejected"] == 0


OF_X86 = pytest.mark.skipif(platform.machine() != "x86_64", reason="there is one set of kernels for this processor")
BY_COMMAND = "import sys; from onboard import cli; sys.exit(cli.main(['replay', sys.argv[1]]))"
BY_CALL = "import heft, sys; found = heft.replay(sys.argv[1]); print(found.summary); sys.exit(not found.agrees)"


def replayed_with(kernels: str, log: Path, code: str) -> str:
    environment = os.environ | {"OPENBLAS_CORETYPE": kernels}
    command = [sys.executable, "-c", code, str(log)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == cli.OK, done.stdout + done.stderr
    return done.stdout


@OF_X86
def test_replay_computes_with_the_kernels_of_the_flight(short_mission: Result) -> None:
    other = "Haswell" if blas_kernels() == "Nehalem" else "Nehalem"
    assert replayed_with(other, short_mission.path, BY_COMMAND).startswith("identical to the last bit: ")


@OF_X86
def test_replay_on_another_processor_gives_the_same_answers_to_rounding(short_mission: Result) -> None:
    other = "Haswell" if blas_kernels() == "Nehalem" else "Nehalem"
    said = replayed_with(other, short_mission.path, BY_CALL)
    assert "the same to rounding" in said
    assert f"blas_kernels: {blas_kernels()} in the log, {other} here" in said


@pytest.fixture(scope="module")
def heavy(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """A shorter one, with a tip mass a fifth heavier than drawn, as the flight's may have been."""
    return fly(tmp_path_factory.mktemp("heavy") / "heavy.mcap", **HEAVY)


def test_replay_notices_another_vehicle(short_mission: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    laid_out = replay_module.vehicle_of

    def other(log: object, directory: Path) -> object:
        vehicle = laid_out(log, directory)
        text = vehicle.text.replace("lever_m = 0.040", "lever_m = 0.0400001")
        assert text != vehicle.text
        return replay_module.config.parse(text, vehicle.path)

    monkeypatch.setattr(replay_module, "vehicle_of", other)
    found = replay(short_mission.path)
    assert not found.identical
    assert "differs from row" in found.summary


@pytest.mark.parametrize(("missing", "identical"), [(2, True), (3, False)])
def test_answers_to_the_last_two_steps_of_a_flight_that_was_interrupted_may_be_missing(
    short_mission: Result, tmp_path: Path, missing: int, identical: bool
) -> None:
    log, vehicle = LogReader(short_mission.path), config.load(config.packaged("rocksat"))
    outputs, ends_ns = Estimator(vehicle).outputs, log.read("tick")["host_ns"][: len(log.read("tick")) // 2]
    with LogWriter.create(tmp_path / "log.mcap", durable=False) as writer:
        for one in log.attachments.values():
            writer.attach(one.name, one.media_type, one.data)
        for name, rows in log.batches():
            writer.register(name, rows.dtype)
            writer.write(name, rows[rows["host_ns"] <= ends_ns[-1 - missing if name in outputs else -1]])
    assert replay(tmp_path / "log.mcap").identical is identical


def test_one_seed_one_log(short_mission: Result, tmp_path: Path) -> None:
    again = fly(tmp_path / "again.mcap", sequence=SHORTER)
    assert again.path.read_bytes() == short_mission.path.read_bytes()


@pytest.mark.campaign  # masses as they were built: the first test
def test_the_answer_follows_the_truth_and_not_the_drawing(heavy: Result) -> None:
    tip = heavy.mass("m_tip_mass")
    assert tip["truth"] == pytest.approx(1.2 * 0.06627)
    assert abs(tip["our_error_percent"]) < 5.0
    assert abs(heavy.mass("m_arm")["our_error_percent"]) < 3.0


def test_the_table_fits_a_terminal_and_says_what_it_cannot(mission: Result) -> None:
    screen = io.StringIO()
    Console(file=screen, width=80).print(table.render(mission.table))
    text = screen.getvalue()
    assert "…" not in text
    assert "22.30" in text
    assert "every sample accounted for" in text
    unsupported = {**mission.table, "masses": [{**m, "supported": False} for m in mission.table["masses"]]}
    screen = io.StringIO()
    Console(file=screen, width=80).print(table.render(unsupported))
    assert screen.getvalue().count("not determined") == 3


def test_info_and_dump_read_it_back(short_mission: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", str(short_mission.path)]) == cli.OK
    assert "imu_base" in capsys.readouterr().out
    assert cli.main(["dump", str(short_mission.path), "--to", "csv", str(tmp_path / "csv")]) == cli.OK
    header, first = (tmp_path / "csv" / "load_cell.csv").read_text().splitlines()[:2]
    assert "[N]" in header or "_N" in header or "(N)" in header
    assert len(first.split(",")) == len(header.split(","))


def test_a_truncated_log_is_read_to_its_last_whole_chunk(
    mission: Result, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    shutil.copy(mission.path, cut)
    with cut.open("r+b") as file:
        file.truncate(cut.stat().st_size // 2)
    assert cli.main(["info", str(cut)]) == cli.DAMAGED
    capsys.readouterr()
    assert cli.main(["dump", str(cut), "--to", "csv", str(tmp_path / "csv"), "--channel", "imu_base"]) == cli.DAMAGED
    assert "warning" in capsys.readouterr().err
    lines = (tmp_path / "csv" / "imu_base.csv").read_text().splitlines()
    assert 20_000 < len(lines) < 45_000


def test_json_says_what_the_table_says(mission: Result) -> None:
    again = json.loads(json.dumps(mission.table))
    assert again["masses"][2]["identified_g"] == 51.5
    assert again["masses"][0]["covered"] in (True, False)


def test_preflight_says_what_a_flight_records_at_most(mission):
    log = mission.log
    stamps = [rows["host_ns"] for _, rows in log.batches(["imu_base"])]
    recorded = log.size / (1e-9 * float(stamps[-1][-1] - stamps[0][0]))
    estimator = Estimator(config.named("rocksat"))
    said = host.recorded_bytes_s(estimator.vehicle, estimator)
    assert recorded <= said <= 1.4 * recorded
