"""A part of the fault matrix, flown again: what is promised holds, and the committed table says what comes of it.

The whole of it is flown by ``python -m tests.flight.fault_matrix docs/evidence/faults.md --check``.
"""

from pathlib import Path

import pytest

from hil_sim.faults import FaultKind
from tests.flight.fault_matrix.cells import CELLS, CHANNELS, Cell
from tests.flight.fault_matrix.flights import broken_promises, flights
from tests.flight.fault_matrix.report import lines_of

pytestmark = pytest.mark.timeout(300)
COMMITTED = Path(__file__).resolve().parents[2] / "docs" / "evidence" / "faults.md"
FLOWN = {  # and whatever shares their flights
    ("rocksat_mixed", "joint_1", "silent"),
}
MORE = {
    ("rocksat", "imu_base", "stuck"),  # one that is stuck: test_honesty
    ("rocksat", "arm_phase", "silent"),  # its samples: test_fault_campaign
    ("rocksat", "imu_base", "garbage"),
    ("rocksat", "joint_1", "slow"),
    ("rocksat_serial", "cell_port", "unplug"),
    ("rocksat_serial", "load_cell", "delayed"),
    ("rocksat_serial", "joint_1", "reset"),
}


def with_any(flight: tuple[Cell, ...], wanted: set[tuple[str, str, str]]) -> bool:
    return any((cell.vehicle, cell.device, cell.kind) in wanted for cell in flight)


@pytest.fixture(
    params=[
        pytest.param(flight, marks=() if with_any(flight, FLOWN) else pytest.mark.campaign)
        for flight in flights()
        if with_any(flight, FLOWN | MORE)
    ],
    ids=lambda flight: " and ".join(f"{cell.vehicle} {cell.device} {cell.name}" for cell in flight),
)
def flight(request: pytest.FixtureRequest) -> tuple[Cell, ...]:
    flown: tuple[Cell, ...] = request.param
    return flown


def test_faults_are_named_contained_and_over_when_they_are_over(flight: tuple[Cell, ...]) -> None:
    assert broken_promises(flight) == []
    committed = COMMITTED.read_text(encoding="utf-8").splitlines()
    made = [line for _, line in lines_of(flight)]
    assert made
    assert set(made) <= set(committed)


def test_every_kind_that_a_vehicle_can_have_is_flown() -> None:
    at_start = {FaultKind.WHO_AM_I}
    of_driven_arms = {FaultKind.TRIP, FaultKind.EMERGENCY_STOP}  # bench.drive_faults, tests/flight/test_driving.py
    of_magnets = {FaultKind.FIELD}  # tests/flight/test_i2c_devices.py
    assert {FaultKind(cell.kind) for cell in CELLS} | at_start | of_driven_arms | of_magnets == set(FaultKind)
    assert len(set(CELLS)) == len(CELLS)
    assert {(cell.vehicle, cell.device) for cell in CELLS} == {(v, d) for v in CHANNELS for d in CHANNELS[v]}
    assert sorted(cell.on_its_own() for flight in flights() for cell in flight) == sorted(CELLS)
    assert {(cell.vehicle, cell.device, cell.kind) for cell in CELLS} >= FLOWN | MORE
