"""Kinds of faults: what each does in a device or on a bus between ``start_s`` and ``end_s``, and what ``value`` means.

``EFFECTS`` has them for people; ``heft hil SCENARIO --faults`` prints it with the devices of a scenario. A fault is
applied by the twin or the bus it is of. Random numbers are seeded by the device's name, so a fault is reproducible. A
fault that its device cannot apply is refused when the device is built; ignored, it would make a fault test pass for the
wrong reason.
"""

import difflib
import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, cast


class FaultError(ValueError):
    """A fault that cannot be applied as written."""


class FaultKind(StrEnum):
    """The vocabulary. The module's table says what each does."""

    OFF = "off"
    RESET = "reset"
    SILENT = "silent"
    INTERMITTENT = "intermittent"
    STUCK = "stuck"
    SATURATED = "saturated"
    WRONG = "wrong"
    DELAYED = "delayed"
    SLIPPED = "slipped"
    GARBAGE = "garbage"
    SLOW = "slow"
    CLOCK_JUMP = "clock_jump"
    NACK = "nack"
    TIMEOUT = "timeout"
    STUCK_BUS = "stuck_bus"
    WHO_AM_I = "who_am_i"
    FIELD = "field"
    TRIP = "trip"
    EMERGENCY_STOP = "emergency_stop"
    PULSE_DROP = "pulse_drop"
    PULSE_SPURIOUS = "pulse_spurious"
    BUS_OFF = "bus_off"
    ERROR_FRAMES = "error_frames"
    FLOOD = "flood"
    FRAME_DROP = "frame_drop"
    BYTE_LOSS = "byte_loss"
    BYTE_GARBLE = "byte_garble"
    UNPLUG = "unplug"


EFFECTS: Final = {
    FaultKind.OFF: "no supply; it starts again from its reset values at the end",
    FaultKind.RESET: "brown-out at the start: it starts again at once (the end is not used)",
    FaultKind.SILENT: "open connector: it neither hears nor is heard, and keeps its state",
    FaultKind.INTERMITTENT: "loose connector: open for the first half of every VALUE seconds",
    FaultKind.STUCK: "the input holds its last value",
    FaultKind.SATURATED: "the input is at full scale, at the end that the sign of VALUE says",
    FaultKind.WRONG: "the reading is 1 + VALUE times the truth; a phase code or SYNC counter is VALUE too high",
    FaultKind.SLIPPED: "the coupling of the encoder has slipped: it reads VALUE degrees too much",
    FaultKind.DELAYED: "the input shows what was VALUE seconds ago; CAN frames and edges arrive VALUE seconds late",
    FaultKind.GARBAGE: "it sends random bits in frames of the right form; the sync line has VALUE more edges a second",
    FaultKind.SLOW: "CAN nodes and polled cells answer VALUE seconds late; a clock runs slow by the share VALUE",
    FaultKind.CLOCK_JUMP: "its clock stands still for -VALUE seconds, or is put forward by VALUE (not the MPU-6050's)",
    FaultKind.NACK: "every transfer fails with errno VALUE (0: EREMOTEIO)",
    FaultKind.TIMEOUT: "transfers are made, and end in ETIMEDOUT",
    FaultKind.STUCK_BUS: "SDA is held low: no transfer begins (EBUSY)",
    FaultKind.WHO_AM_I: "WHO_AM_I reads VALUE",
    FaultKind.FIELD: "the magnet's field is 1 + VALUE times the nominal: weak below 0.5, strong above 1.5",
    FaultKind.TRIP: "a drive faults at the start with error code VALUE (0: 2310h), by EMCY; a DYNAMIXEL with hardware "
    "error VALUE (0: 20h, overload), until it has no supply (the end is not used); a UR arm says protective stop",
    FaultKind.EMERGENCY_STOP: "a drive's emergency stop is in until the end: no current, brake on, EMCY 5441h; or "
    "that of a UR arm: no power",
    FaultKind.PULSE_DROP: "edges of the sync pulse do not reach it",
    FaultKind.PULSE_SPURIOUS: "a further edge every VALUE seconds",
    FaultKind.BUS_OFF: "the flight computer's controller is off the bus; error frames say when",
    FaultKind.ERROR_FRAMES: "a bus error every VALUE seconds; the frame it hit is sent again",
    FaultKind.FLOOD: "a babbling node sends COB-ID VALUE without pause",
    FaultKind.FRAME_DROP: "the flight computer loses frames of COB-ID VALUE (0: every frame)",
    FaultKind.BYTE_LOSS: "each character is lost with probability VALUE",
    FaultKind.BYTE_GARBLE: "each character has a bit inverted with probability VALUE",
    FaultKind.UNPLUG: "the adapter is pulled out of the flight computer, or its network cable",
}
"""Of each kind, between its start and its end."""

INPUT_KINDS: Final = (FaultKind.STUCK, FaultKind.WRONG, FaultKind.DELAYED)
"""What ``FaultyScalar`` and ``FaultyImu`` apply to any analogue input; ``SATURATED`` is for inputs that have an end."""

ENCODER_KINDS: Final = (*INPUT_KINDS, FaultKind.SLIPPED)
"""What ``FaultyScalar`` applies to the angle of a joint."""

MEMORYLESS: Final = (FaultKind.WRONG, FaultKind.DELAYED, FaultKind.SLIPPED, FaultKind.SATURATED)
"""Those of inputs that do not ask what was read before."""

CLOCK_KINDS: Final = (FaultKind.SLOW, FaultKind.CLOCK_JUMP)
"""What ``FaultyClock`` applies to any oscillator."""

_SHORTEST_S, _LONGEST_S = 1e-4, 1e6
_SECONDS: Final = {
    FaultKind.INTERMITTENT: "the seconds from interruption to interruption",
    FaultKind.DELAYED: "the delay in seconds",
    FaultKind.SLOW: "the seconds it answers late, or the share by which its oscillator is slow",
    FaultKind.PULSE_SPURIOUS: "the seconds between two edges",
    FaultKind.ERROR_FRAMES: "the seconds between two error frames",
}
_NOT_ZERO: Final = {
    FaultKind.WRONG: "how wrong it is",
    FaultKind.SLIPPED: "the degrees it slips by",
    FaultKind.CLOCK_JUMP: "the jump in seconds",
    FaultKind.FIELD: "by what share the field is off",
}
_WITHIN: Final = {
    FaultKind.WHO_AM_I: (0, 0xFF, "the byte to read (0 to 255)"),
    FaultKind.FLOOD: (0, 0x7FF, "the COB-ID to send (0 to 7FFh)"),
    FaultKind.FRAME_DROP: (0, 0x7FF, "the COB-ID to lose (0: all)"),
    FaultKind.TRIP: (
        0,
        0xFFFF,
        "an error code of CiA 402 (0: 2310h, over current), or a hardware error of a DYNAMIXEL",
    ),
    FaultKind.NACK: (0, 133, "an errno (0: EREMOTEIO)"),
    FaultKind.BYTE_LOSS: (1e-9, 1.0, "a probability above 0 and up to 1"),
    FaultKind.BYTE_GARBLE: (1e-9, 1.0, "a probability above 0 and up to 1"),
}


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Args:
        kind: What happens.
        device: Name of the twin or bus it happens to.
        start_s: Mission time of its beginning, s.
        end_s: Mission time of its end, s.
        value: Meaning by ``kind``, see the module's table.

    Raises:
        FaultError: an unknown kind, or times or a value that make no sense for it.
    """

    kind: FaultKind
    device: str
    start_s: float
    end_s: float = math.inf
    value: float = 0.0

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "kind", FaultKind(self.kind))
        except ValueError:
            known = ", ".join(FaultKind)
            said = f"No fault is called {self.kind!r}{meant(str(self.kind), FaultKind)}"
            raise FaultError(f"{said}; there are: {known}.") from None
        if not (math.isfinite(self.start_s) and self.start_s >= 0.0 and self.end_s > self.start_s):
            raise FaultError(
                f"Fault {self.kind} of {self.device} lasts from {self.start_s} s to {self.end_s} s; "
                "give 0 <= start_s < end_s."
            )
        why = self._nonsense()
        if why is not None:
            raise FaultError(f"Fault {self.kind} of {self.device} needs {why}.")

    def _nonsense(self) -> str | None:
        if not abs(self.value) <= _LONGEST_S:
            return f"a `value` between -{_LONGEST_S:g} and {_LONGEST_S:g}"
        if self.kind in _SECONDS and not self.value >= _SHORTEST_S:
            return f"`value`, {_SECONDS[self.kind]}, of {_SHORTEST_S:g} or more"
        if self.kind in _NOT_ZERO and not self.value:
            return f"`value`, {_NOT_ZERO[self.kind]}, other than 0"
        low, high, what = _WITHIN.get(self.kind, (-math.inf, math.inf, ""))
        if not low <= self.value <= high:
            return f"`value`, {what}"
        if self.kind is FaultKind.INTERMITTENT and math.isinf(self.end_s):
            return "`end_s`: a connector is not loose for ever"
        return None


def meant(word: str, known: Iterable[str]) -> str:
    """``: did you mean X?`` where one of ``known`` is like ``word``; else nothing."""
    like = difflib.get_close_matches(word, list(known), 1)
    return f" (did you mean {like[0]}?)" if like else ""


def parse(text: str) -> Fault:
    """A fault as ``--fault`` has it: ``KIND:DEVICE:START:END[:VALUE]``, times in s, no END for the rest of the mission.

    Raises:
        FaultError: it is not of this form, or no such fault.
    """
    kind, _, rest = text.partition(":")
    device, *numbers = rest.split(":")
    try:
        start_s, end_s, value = (
            float(number) if number else default
            for number, default in zip([*numbers, "", ""][:3], (math.nan, math.inf, 0.0), strict=True)
        )
    except ValueError:
        start_s = math.nan
    if not device or not 1 <= len(numbers) <= 3 or math.isnan(start_s):
        raise FaultError(f"{text} is no fault: write KIND:DEVICE:START:END[:VALUE], e.g. off:imu_base:10:12.")
    return Fault(cast("FaultKind", kind), device, start_s, end_s, value)  # which checks and converts it
