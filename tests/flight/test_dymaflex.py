"""The free-flyer catches something in mid-flight, short and in virtual time: from bus bytes to what it is."""

import re
from pathlib import Path

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from onboard import config
from onboard.flight import hil
from onboard.ground.identify.kinds.free_flyer_log import identify_free_flyer
from onboard.ground.identify.mission import mission_table as table
from onboard.ground.identify.replay.replay import replay
from onboard.identification.free_flyer.captured_body import NAMES
from onboard.recording.reader import LogReader
from tests.flight.missions import CATCH, CATCH_SEED, Result, fly, inline
from tests.flight.supervise.test_overload import slowed
from tests.flight.supervise.test_takeover import Stretch

SEED = 2  # of flights of its own


def test_every_sample_of_every_channel_is_accounted_for(catch: Result) -> None:
    assert catch.table["accounted"], catch.table["channels"]
    assert set(catch.table["channels"]) == set(config.load(config.packaged("dymaflex")).channels)
    recorded = {name: counted["recorded"] for name, counted in catch.table["channels"].items()}
    seconds = catch.flown.truth["duration_s"]
    for name in ("joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "load_cell", "can_sync"):
        assert recorded[name] == pytest.approx(500 * seconds, rel=0.02)
    for name in ("imu_base", "imu_2"):
        assert recorded[name] == pytest.approx(1000 * seconds, rel=0.03)


def test_the_capture_is_found_and_told(catch: Result) -> None:
    capture = catch.table["capture"]
    assert len(capture["said_s"]) == 1
    lag_s, step_s = 0.2, 0.1
    assert 0.0 < capture["said_s"][0] - capture["true_s"] < 0.2 + lag_s + step_s


def test_the_intervals_hold_what_was_caught(catch: Result) -> None:
    assert catch.table["identified"]
    mass = catch.mass("m_payload")
    assert mass["covered"]
    assert abs(mass["our_error_percent"]) < 5.0
    told = [row for group in ("masses", "centres", "inertias") for row in catch.table[group]]
    assert len(told) == 10
    assert all(row["supported"] for row in told)
    assert sum(row["covered"] for row in told) >= 8


def test_how_the_payload_came_is_told_or_how_badly_it_is_known(catch: Result) -> None:
    rows = catch.table["motions"]
    assert tuple(row["quantity"] for row in rows) == NAMES
    for row in rows:
        assert row["covered"] if row["supported"] else "determine no more" in row["standing"]
    assert not all(row["supported"] for row in rows)  # 5 kg bring little
    before = next(batch for _, batch in catch.log.batches(["quantity"]))
    assert not {name.encode() for name in NAMES} & set(before["name"].tolist())


@pytest.mark.campaign  # in flight: test_free_flyer
def test_the_kalman_smoother_finds_and_weighs_the_same_in_flight(catch: Result, tmp_path: Path) -> None:
    """The kernel of dymaflex_parabolic, half down at 9 Hz: its poles are those of filterpy's steady-state filter."""
    packaged, path = config.packaged("dymaflex"), tmp_path / "flight.mcap"
    kernel = 'smoothing = "smoother"\nsmoothing_ms = 1000'
    text, count = re.subn(r"(?m)^smoothing_ms = 250\b", kernel, packaged.read_text(encoding="utf-8"))
    text, lags = re.subn(r"(?m)^lag_ms = 200\b", "lag_ms = 600", text)
    assert count == lags == 1
    world, urls = open_in_process(scenario_of("dymaflex", CATCH), CATCH_SEED)
    with world:
        smoothed = hil.fly_simulated(config.parse(text, packaged), world, urls, path)
    again = Result(path, smoothed, table.result(smoothed))
    (said_s,), (by_spline_s,) = (one.table["capture"]["said_s"] for one in (again, catch))
    longer_lag_s = 0.4
    assert said_s - longer_lag_s == pytest.approx(by_spline_s, abs=0.2)
    mass, by_spline = again.mass("m_payload"), catch.mass("m_payload")
    assert mass["covered"]
    half_a_sigma_without_the_wrist_cell_kg = 0.035
    assert mass["value"] == pytest.approx(by_spline["value"], abs=half_a_sigma_without_the_wrist_cell_kg)
    assert mass["value"] != by_spline["value"]
    told = [row for group in ("masses", "centres", "inertias") for row in again.table[group]]
    assert len(told) == 10
    assert sum(row["covered"] for row in told) >= 8


@pytest.mark.campaign  # of a free-flyer with torques: test_joint_torques
def test_replay_gives_the_onboard_estimates_to_the_bit(catch: Result) -> None:
    found = replay(catch.path)
    assert found.identical, found.summary


def test_the_second_imu_is_recorded_and_the_first_one_has_the_marks(catch: Result) -> None:
    base, other = catch.log.read("imu_base"), catch.log.read("imu_2")
    R = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # base axes to the first one's
    flipped = np.diag([1.0, -1.0, -1.0])  # base axes to the second one's
    rate, again = (
        (rows["gyro_raw"] * rows["gyro_scale_rad_s"][:, None])[: 50 * (len(rows) // 50)].reshape(-1, 50, 3).mean(axis=1)
        for rows in (base, other)
    )
    n = min(len(rate), len(again))
    two_biases_of_a_degree_and_a_percent_of_time = 0.05
    difference = rate[:n] @ R - again[:n] @ flipped
    assert np.abs(rate).max() > 0.2
    assert np.abs(difference).max() < two_biases_of_a_degree_and_a_percent_of_time
    assert np.count_nonzero(base["sync"]) > 100
    assert not other["sync"].any()


@pytest.mark.realtime
@pytest.mark.timeout(120)
def test_it_flies_in_real_time_too(tmp_path: Path) -> None:
    """The devices in a process of their own at the full rate, the flight app in its own processes."""
    tables = {"scenario": {"based_on": "dymaflex"}, "capture": CATCH["capture"]}
    sequence = ", ".join(map(inline, CATCH["sequence"]))
    scenario = tmp_path / "short.toml"
    scenario.write_text("".join(f"{k} = {inline(v)}\n" for k, v in tables.items()) + f"sequence = [{sequence}]\n")
    vehicle = config.load(config.packaged("dymaflex"))
    flown = hil.fly_realtime(vehicle, ["-m", "hil_sim.serve", str(scenario), "--seed", "2"], tmp_path / "rt.mcap")
    result = table.result(flown)
    assert result["accounted"], result["channels"]
    assert result["channels"]["imu_base"]["recorded"] > 10_000
    log = LogReader(flown.log)
    codes = {code for by in ("estimation", "supervisor") for code in log.read(f"event_{by}")["code"].tolist()}
    if not codes & {b"estimator_skips", b"estimator_unfinished", b"worker_killed"}:  # there was time for all rows
        assert len(result["capture"]["said_s"]) == 1
        assert result["identified"]
    assert replay(flown.log).identical


@pytest.mark.campaign  # of rocksat: test_overload
def test_a_computer_of_less_than_half_the_speed_that_it_needs_tells_the_capture_late(
    catch: Result, tmp_path: Path
) -> None:
    vehicle = config.load(config.packaged("dymaflex"))
    stretch = Stretch(catch.log, vehicle, tmp_path / "rings", after_s=0.0)
    log = slowed(stretch, vehicle, tmp_path / "rings", 0.4, stretch.end_ns, stretch.end_ns)
    ticks, codes = log.read("tick"), log.read("event_estimation")["code"].tolist()
    assert not ticks["skipped_ns"].any()
    assert codes.count(b"estimator_late") == codes.count(b"capture") == 1
    answers = log.read("quantity")
    [mass] = answers[(answers["host_ns"] == answers["host_ns"][-1]) & (answers["name"] == b"m_payload")]
    assert mass["supported"]
    assert mass["low"] < catch.mass("m_payload")["truth"] < mass["high"]


@pytest.mark.campaign  # of ticks: test_encoder_jumps, test_jump_watch; in flight, of rocksat: test_honesty
@pytest.mark.parametrize("fault", ["slipped:joint_2:8::3", "wrong:joint_2:8::0.05"])
def test_the_flight_goes_on_after_an_encoder_has_become_another_one(tmp_path: Path, fault: str) -> None:
    """While the payload is held, on board and afterwards: it is told, and another scale is named."""
    kind, device, start_s, _, value = fault.split(":")
    broken = {"kind": kind, "device": device, "start_s": float(start_s), "value": float(value)}
    flown = fly(tmp_path / "log.mcap", SEED, vehicle="dymaflex", **CATCH, fault=[broken])
    [said] = flown.events("angle_jumped")
    assert said.startswith("joint_2: its angle jumps by +")
    mass = flown.mass("m_payload")
    assert mass["covered"]
    assert 0.0 < mass["high"] - mass["low"] < 0.2 * mass["truth"]
    assert "joint_2: its angle jumps" in mass["standing"]
    assert ("scale_joint_2" in mass["standing"]) == (kind == "wrong")
    found = identify_free_flyer(config.load(config.packaged("dymaflex")), flown.log)
    [again] = (one for one in found.answers if one.name == "m_payload")
    assert again.low < mass["truth"] < again.high
    assert again.high - again.low < 0.2 * mass["truth"]
    assert any("joint_2: its angle jumps" in reason for reason in found.verdict.reasons)


@pytest.mark.campaign  # of ticks: test_recursive_changes
def test_a_payload_that_loses_a_part_is_followed_and_told(tmp_path: Path) -> None:
    lost = {"at_s": 9.5, "mass_kg": 0.6, "centre_m": [0.05, 0.0, 0.1]}
    flown = fly(tmp_path / "log.mcap", SEED, vehicle="dymaflex", **CATCH, lost_part=lost)
    mass = flown.mass("m_payload")
    assert mass["truth"] == pytest.approx(4.4)
    assert mass["covered"]
    assert 0.0 < mass["high"] - mass["low"] < 0.2 * mass["truth"]
    assert mass["standing"].startswith("weak: the payload changed without a release")
    assert len(flown.events("altered")) == 1
