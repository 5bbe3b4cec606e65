"""Kinds of faults and their effects, applied by the twins and the buses.

In the twins:

==================  =======================  ==========================================================================
kind                devices                  effect between ``start_s`` and ``end_s``
==================  =======================  ==========================================================================
``off``             any twin                 no supply; it starts again, from its reset values, at ``end_s``
``reset``           any twin                 brown-out at ``start_s``: starts again at once (``end_s`` is not used)
``silent``          all but the IMU          open connector: neither hears nor is heard, keeps its state
``intermittent``    any twin, any bus        loose connector: open for the first half of every ``value`` seconds
``stuck``           analogue inputs, phase   the input holds its last value
``saturated``       imu, load cell, node     the input is at full scale; the sign of ``value`` says which end
``wrong``           analogue inputs          plausible and false: the reading is ``1 + value`` times what it should be
``wrong``           phase, SYNC counter      ``value`` is added to the number
``delayed``         analogue inputs, phase   the input shows what was ``value`` seconds ago
``garbage``         any twin                 it sends random bits, in transfers, CAN frames and characters of the
                                             right form
``slow``            CAN nodes, polled cells  it answers (SYNC, SDO, a question) ``value`` seconds late
``slow``            all that have a clock    its oscillator runs slow by the share ``value`` (0.02: 2 %)
``clock_jump``      all that have a clock    its clock stands still for ``-value`` s at ``start_s`` (``end_s`` is not
                                             used); that of all but the MPU-6050 may also be put forward, by a
                                             positive ``value``
``nack``            imu                      every transfer fails with errno ``value`` (0: EREMOTEIO)
``timeout``         imu                      it stretches the clock for ever: a transfer is made, and ends in ETIMEDOUT
``who_am_i``        imu                      WHO_AM_I reads ``value``
``pulse_drop``      recorders of the pulse   the edge never reaches this pin
``pulse_spurious``  recorders of the pulse   one more edge every ``value`` seconds, beginning at ``start_s``
==================  =======================  ==========================================================================

On the wires:

==================  =======================  ==========================================================================
kind                bus                      effect between ``start_s`` and ``end_s``
==================  =======================  ==========================================================================
``nack``            I2C                      no slave acknowledges; errno as above
``timeout``         I2C                      transfers are made, and end in ETIMEDOUT
``stuck_bus``       I2C                      SDA is held low: no transfer begins, EBUSY
``bus_off``         CAN                      the flight computer's controller is off the bus; error frames say when
``error_frames``    CAN                      a bus error every ``value`` seconds; what it hit is sent again
``flood``           CAN                      a babbling node sends ``value`` (a COB-ID) without pause
``frame_drop``      CAN                      the flight computer loses frames with COB-ID ``value`` (0: every frame)
``delayed``         CAN, sync line           frames, or edges, are stamped and delivered ``value`` seconds late
``pulse_drop``      sync line                edges are not seen
``pulse_spurious``  sync line                one more edge every ``value`` seconds, beginning at ``start_s``
``garbage``         sync line                chatter: ``value`` more edges a second, at random times
``byte_loss``       serial                   each character is lost with probability ``value``
``byte_garble``     serial                   each character has one bit inverted with probability ``value``
``unplug``          serial                   the adapter is pulled out of the flight computer
==================  =======================  ==========================================================================

Devices with a clock: MPU-6050, sync box, nIMU, QSB, custom node. Polled cells: Modbus and DSC.

Random numbers are seeded by the device's name, so a fault is reproducible. A fault that its device cannot apply is
refused when the device is built; ignored, it would make a fault test pass for the wrong reason.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Final


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
    GARBAGE = "garbage"
    SLOW = "slow"
    CLOCK_JUMP = "clock_jump"
    NACK = "nack"
    TIMEOUT = "timeout"
    STUCK_BUS = "stuck_bus"
    WHO_AM_I = "who_am_i"
    PULSE_DROP = "pulse_drop"
    PULSE_SPURIOUS = "pulse_spurious"
    BUS_OFF = "bus_off"
    ERROR_FRAMES = "error_frames"
    FLOOD = "flood"
    FRAME_DROP = "frame_drop"
    BYTE_LOSS = "byte_loss"
    BYTE_GARBLE = "byte_garble"
    UNPLUG = "unplug"


INPUT_KINDS: Final = (FaultKind.STUCK, FaultKind.WRONG, FaultKind.DELAYED)
"""What ``FaultyScalar`` and ``FaultyImu`` apply to any analogue input; ``SATURATED`` is for inputs that have an end."""

CLOCK_KINDS: Final = (FaultKind.SLOW, FaultKind.CLOCK_JUMP)
"""What ``FaultyClock`` applies to any oscillator."""

_ABOVE_ZERO: Final = {
    FaultKind.INTERMITTENT: "the seconds from one interruption to the next",
    FaultKind.DELAYED: "the delay in seconds",
    FaultKind.SLOW: "the seconds it answers late, or the share by which its oscillator is slow",
    FaultKind.PULSE_SPURIOUS: "the seconds between two edges",
    FaultKind.ERROR_FRAMES: "the seconds between two error frames",
}
_NOT_ZERO: Final = {
    FaultKind.WRONG: "how wrong it is",
    FaultKind.CLOCK_JUMP: "the jump in seconds",
}
_WITHIN: Final = {
    FaultKind.WHO_AM_I: (0, 0xFF, "the byte to read (0 to 255)"),
    FaultKind.FLOOD: (0, 0x7FF, "the COB-ID to send (0 to 7FFh)"),
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
            raise FaultError(f"No fault is called {self.kind!r}; name one of: {known}.") from None
        if not (math.isfinite(self.start_s) and self.start_s >= 0.0 and self.end_s > self.start_s):
            raise FaultError(
                f"Fault {self.kind} of {self.device} lasts from {self.start_s} s to {self.end_s} s; "
                "give 0 <= start_s < end_s."
            )
        why = self._nonsense()
        if why is not None:
            raise FaultError(f"Fault {self.kind} of {self.device} needs {why}.")

    def _nonsense(self) -> str | None:
        if self.kind in _ABOVE_ZERO and not self.value > 0.0:
            return f"`value`, {_ABOVE_ZERO[self.kind]}, above 0"
        if self.kind in _NOT_ZERO and not (math.isfinite(self.value) and self.value):
            return f"`value`, {_NOT_ZERO[self.kind]}, other than 0"
        low, high, what = _WITHIN.get(self.kind, (-math.inf, math.inf, ""))
        if not low <= self.value <= high:
            return f"`value`, {what}"
        if self.kind is FaultKind.INTERMITTENT and math.isinf(self.end_s):
            return "`end_s`: a connector is not loose for ever"
        return None
