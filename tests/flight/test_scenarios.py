"""The RockSat flight with other devices, in virtual time and short: serial lines alone, and the rest of CANopen."""

from pathlib import Path

import numpy as np
import pytest

from drivers.records import EVENT, GAP, Severity
from hil_sim.scenario.load import names
from onboard import config
from onboard.flight import hil, simulated
from onboard.ground.identify.mission import mission_table as table
from onboard.ground.identify.replay.replay import replay
from onboard.recording.reader import LogReader
from tests.flight.missions import Result, fly, inline, sweep

SEED = 6  # the MPU-6050's clock is 1 % fast: one that is not polled at its own period loses samples
SHORT = {
    "sequence": [
        {"phase": 0, "action": "hold", "duration_s": 2.0},
        sweep(3, 0.5),
        {"phase": 5, "action": "hold", "duration_s": 0.5},
        sweep(3, 0.5),
        {"phase": 9, "action": "hold", "duration_s": 0.5},
    ],
}


MIXED = pytest.param("rocksat_mixed", marks=pytest.mark.campaign)  # flown with faults: test_fault_matrix


@pytest.fixture(scope="module", params=["rocksat_serial", MIXED])
def flown(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Result:
    return fly(tmp_path_factory.mktemp(request.param) / "flight.mcap", SEED, vehicle=request.param, **SHORT)


def test_every_packaged_scenario_is_flown_by_a_test() -> None:
    assert set(names()) == {"rocksat", "rocksat_serial", "rocksat_mixed"}


def test_every_sample_of_every_channel_is_accounted_for(flown: Result) -> None:
    assert flown.table["accounted"], flown.table["channels"]
    vehicle = config.load(config.packaged(flown.table["vehicle"]))
    marks = {name for name in vehicle.channels if name.endswith("_mark")}  # what was seen twice, not samples
    assert set(flown.table["channels"]) == set(vehicle.channels) - marks
    assert all(counted["recorded"] > 5 for counted in flown.table["channels"].values())


def test_replay_gives_the_onboard_estimates_to_the_bit(flown: Result) -> None:
    found = replay(flown.path)
    assert found.identical, found.summary


def test_rows_are_made_of_all_devices_and_the_answer_holds_the_truth(flown: Result) -> None:
    gate = flown.log.read("row")["gate"]  # (n, cells)
    used = np.count_nonzero(gate == 0, axis=0)
    cells = sum(name.startswith("load_cell") for name in flown.table["channels"])
    assert len(used) >= cells
    assert (used[:cells] > 250).all()  # of 430 in the sweeps, less their ends
    answered = [row for row in (*flown.table["masses"], *flown.table["inertias"]) if row["supported"]]
    assert len(answered) >= 3
    assert all(row["covered"] for row in answered)


def test_nothing_is_told_but_that_transmitters_take_their_time_to_start(flown: Result) -> None:
    events = [row for _, rows in flown.log.batches() if rows.dtype == EVENT for row in rows]
    assert {row["code"] for row in events if row["severity"] >= Severity.WARNING} <= {b"no_answer"}
    gaps = [row for _, rows in flown.log.batches() if rows.dtype == GAP for row in rows]
    causes = {row["cause"] for row in gaps}
    assert causes <= {b"no_answer", b"stopped", b"no_pdo"}  # to start; and what was under way when the flight ended
    assert sum(row["last_missing"] - row["first_missing"] + 1 for row in gaps if row["cause"] != b"no_answer") < 10


@pytest.mark.parametrize(
    ("periods_ms", "step_ms"),
    [((), 5.0), ((1, 2), 5.0), ((10,), 5.0), ((20, 10, 1), 5.0), ((9, 1), 4.5), ((9, 12), 3.0)],
)
def test_every_device_is_polled_at_its_own_period(periods_ms: tuple[int, ...], step_ms: float) -> None:
    assert simulated.step_ns(ms * 1_000_000 for ms in periods_ms) == step_ms * 1e6


@pytest.mark.realtime
@pytest.mark.timeout(180)
def test_serial_devices_fly_in_real_time_on_terminals(tmp_path: Path) -> None:
    """The devices in a process of their own, the flight app in its own processes, a port for each device."""
    scenario = tmp_path / "short.toml"
    header = {"name": "short", "description": "", "based_on": "rocksat_serial"}
    scenario.write_text(f"scenario = {inline(header)}\nsequence = [{', '.join(map(inline, SHORT['sequence']))}]\n")
    vehicle = config.load(config.packaged("rocksat_serial"))
    flown = hil.fly_realtime(vehicle, ["-m", "hil_sim.serve", str(scenario), "--seed", "3"], tmp_path / "rt.mcap")
    result = table.result(flown)
    for name, counted in result["channels"].items():
        # a terminal does not tell whether a sample that left as the port was opened or closed has been read
        assert abs(counted["produced"] - counted["recorded"] - counted["missing"]) <= 2, name
    assert result["channels"]["imu_base"]["recorded"] > 1000
    assert np.count_nonzero(LogReader(flown.log).read("row")["gate"][:, 0] == 0) > 200
    assert replay(flown.log).identical
