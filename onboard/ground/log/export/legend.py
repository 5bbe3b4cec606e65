"""``README.txt`` beside a dump: explains files, columns, status bits and codes."""

from collections.abc import Iterable, Mapping
from enum import IntEnum, IntFlag

from drivers.records import SampleStatus, Severity
from onboard.estimation.gates import GateReason
from onboard.flight.health.status import MEANINGS
from onboard.ground.log.tables.columns import Times
from onboard.ground.log.tables.flight_tables import FlightTables
from onboard.ground.log.tables.meaning import ChannelMeaning
from onboard.timebase.clock import ClockState

FILE = "README.txt"
_STATUS = {
    SampleStatus.SATURATED: "at an end of the range",
    SampleStatus.NOT_VALID: "reported by the device, or impossible; an event gives the reason",
    SampleStatus.AFTER_RESET: "first sample after the device restarted: its tick began again",
}
_GATES = {
    GateReason.SATURATED: "a sample under the smoothing kernel is at the end of its range",
    GateReason.GAP: "samples are missing under the kernel",
    GateReason.CONTACT: "a joint is near its mechanical stop",
    GateReason.DRAG: "an external force acts on the base",
    GateReason.PHASE: "not an identification phase, or not settled in it",
    GateReason.RESIDUAL: "the row contradicts the estimate",
    GateReason.NOT_SYNCHRONISED: "a clock that the row depends on is not valid",
    GateReason.STILL: "the joint is too slow: its Coulomb friction is undetermined",
    GateReason.STUCK: "a reading under the kernel repeats where it must change",
    GateReason.LEFT_OUT: "its instrument contradicts the others",
    GateReason.JUMPED: "the angle of a joint has jumped since rows were used: its encoder is another",
}
_CLOCKS = {
    ClockState.ACQUIRING: "not enough marks yet",
    ClockState.LOCKED: "on its marks",
    ClockState.FLYWHEEL: "marks have stopped or contradict: extrapolated at the last rate, sigma growing",
    ClockState.INVALID: "not valid",
}
_SEVERITY = {Severity.INFO: "", Severity.WARNING: "", Severity.ERROR: ""}


def legend(tables: FlightTables, files: Mapping[str, str]) -> str:
    """The text for ``files``, names by channel."""
    vehicle, log = tables.vehicle, tables.log
    if vehicle is not None:
        flown = f"vehicle {vehicle.file.vehicle.name}"
    else:
        flown = f"no vehicle is known, so no frames, zero counts or clocks ({tables.why_none})"
    lines = [f"{log.path.name}: {flown}", "", *_time_lines(tables.times), "", "Files"]
    for channel, file in files.items():
        meaning = tables.meanings.get(channel, ChannelMeaning(time=""))
        about = {"": meaning.measures, "time_s: ": meaning.time, "filter delay, not taken off time_s: ": meaning.delay}
        lines += [f"  {file}", *(f"      {head}{text}" for head, text in about.items() if text)]
    lines += [
        *codes(),
        "",
        "level of a quantity: 0 good, 1 weak, 2 do not use; supported 0: its value is not to be used",
        "",
        "device_status is the device's status byte, filter_code the code of its low-pass filter: see its data sheet.",
        "Text that would begin a formula in a spreadsheet has an apostrophe before it.",
    ]
    return "\n".join(lines) + "\n"


def codes() -> list[str]:
    """What the bits and codes of the records stand for."""
    lines = []
    for title, said in (
        ("status, bits (0: a good sample)", _codes(_STATUS.items())),
        ("gate, bits (0: the row was used)", _codes(_GATES.items())),
        ("state of a clock", _codes(_CLOCKS.items())),
        ("severity of an event", _codes(_SEVERITY.items())),
        ("status_word and status_latched of health, bits", _codes(MEANINGS.items())),
    ):
        lines += ["", title, *said]
    return lines


def _time_lines(times: Times) -> list[str]:
    utc = (
        "utc is that instant by the flight computer's wall clock, which was read once, when the flight began."
        if times.utc_offset_ns is not None
        else "The log has no wall clock (simulated, imported, or never set), so there is no utc."
    )
    return [
        f"time_s is vehicle time (CLOCK_MONOTONIC of the flight computer) less {times.start_ns} ns, the log's first",
        "record, where --from and --until count from too; nan where the sample's clock never was known. host_ns is the",
        "arrival at the flight computer.",
        utc,
    ]


def _codes(said: Iterable[tuple[IntFlag | IntEnum, str]]) -> list[str]:
    return [f"  {int(code):3d}  {str(code.name).lower()}{': ' if text else ''}{text}" for code, text in said]
