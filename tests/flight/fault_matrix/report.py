"""The document of the matrix."""

from collections.abc import Iterable
from typing import NamedTuple

from hil_sim.faults import FaultKind
from tests.flight.fault_matrix.cells import CELLS, KINDS, Cell
from tests.flight.fault_matrix.flights import Outcome, broken_promises, others_lost, outcomes

INPUTS = (FaultKind.STUCK, FaultKind.WRONG, FaultKind.DELAYED)
HEADING = """# Faults: detection, side effects, recovery

Written by `python -m tests.flight.fault_matrix docs/evidence/faults.md`, which flies all of them (with `--check` it
compares and writes nothing); `tests/flight/test_fault_matrix.py` flies a part of them and compares their lines. Each
fault of `hil_sim/faults` begins and ends in the middle of an 11 s RockSat-X mission in virtual time.

- **driver reports**: event codes and causes of `gap` records. *cannot know*: the data are well-formed and plausible,
  and nothing that the device sends contradicts them.
- **vehicle reports**: states of its clocks, and the estimator's gates of refused rows: consistency with the other
  devices. Where both columns are empty nothing detects the fault at this size; *estimate* gives its effect.
- **others lose**: missing samples in channels that do not depend on the device.
- **recovery**: time from the end of the fault to the first good row of the device; 5 ms is one step of the flight.
- **samples**: *all*: every sample the device made is recorded or in a gap record. *n more named*: gap records contain
  samples that were never made: the device was off or received no SYNC. *n in no gap record*: made and lost without a
  gap record; only events report the fault.
- **estimate**: five masses and inertias at the end of the flight. *right*: the truth is in the 95 % interval; *absent*:
  not reported. A wrong one fails the test, at any time of the flight.
- **flown with**: two faults that only remove samples may share a flight, one in each sweep; the estimate is then
  that of both.
"""
COLUMNS = (
    "| device | fault | lasts | driver reports | vehicle reports | others lose "
    "| recovery | samples | estimate | flown with |"
)


class Flown(NamedTuple):
    """A flight, for another process to hand back.

    Attributes:
        lines: Of the table, by cell.
        broken: Promises that were not kept.
    """

    lines: list[tuple[Cell, str]]
    broken: list[str]


def flown(flight: tuple[Cell, ...]) -> Flown:
    """Fly one flight."""
    return Flown(lines_of(flight), broken_promises(flight))


def document(flights_flown: Iterable[Flown]) -> str:
    """The document, of all flights."""
    lines = dict(line for flight in flights_flown for line in flight.lines)
    parts = [HEADING]
    for vehicle, kinds in KINDS.items():
        rows = [lines[cell] for cell in CELLS if cell.vehicle == vehicle]
        parts.append(
            f"\n## {vehicle}: {kinds}\n\n{COLUMNS}\n|{'---|' * COLUMNS.count(' |')}\n" + "\n".join(rows) + "\n"
        )
    return "".join(parts)


def lines_of(flight: tuple[Cell, ...]) -> list[tuple[Cell, str]]:
    """The lines of the cells that fly together. They are flown."""
    told = []
    for place, outcome in enumerate(outcomes(flight)):
        partner = " ".join(f"{cell.device} {cell.name}" for at, cell in enumerate(flight) if at != place)
        told.append((outcome.cell.on_its_own(), f"{_line(outcome)} {partner or '—'} |"))
    return told


def _line(outcome: Outcome) -> str:
    cell = outcome.cell
    others = ", ".join(f"{name} {count}" for name, count in others_lost(outcome).items()) or "nothing"
    unaccounted = {name: n for name, n in outcome.unaccounted.items() if n and name in cell.channels}
    samples = ", ".join(
        f"{name}: {-n} more named" if n < 0 else f"{name}: {n} in no gap record" for name, n in unaccounted.items()
    )
    verdicts = list(outcome.estimate.values())
    kinds = [verdict for verdict in ("right", "absent", "wrong") if verdict in verdicts]
    estimate = kinds[0] if len(kinds) == 1 else ", ".join(f"{verdicts.count(kind)} {kind}" for kind in kinds)
    vehicle = [text for text in outcome.reported if text.startswith(("clock ", "rows refused", "estimation "))]
    driver = [text for text in outcome.reported if text not in vehicle]
    unknown = "cannot know" if cell.kind in INPUTS else "—"
    flows = "at once" if outcome.recovery_s <= 0.005 else f"{10 * round(outcome.recovery_s * 100 + 0.5)} ms"
    if cell.device == "arm_phase" and outcome.recovery_s > 1.0:
        flows = "next change"
    lasts = "—" if cell.kind in (FaultKind.RESET, FaultKind.CLOCK_JUMP) else f"{cell.last_s:g} s"
    columns = (
        *(cell.device, cell.name, lasts, ", ".join(driver) or unknown, ", ".join(vehicle) or "—"),
        *(others, flows, samples or "all", estimate),
    )
    return f"| {' | '.join(columns)} |"
