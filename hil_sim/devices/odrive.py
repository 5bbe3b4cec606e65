"""An axis of an ODrive on CAN, typed from ODrive's published message table (CANSimple, firmware 0.6.10).

=======  =================  ==================================================================================
command  message            content, little-endian; identifier: 32 times the node, and the command
=======  =================  ==================================================================================
01h      heartbeat          errors u32, state u8, result of the procedure u8, trajectory done u8, 0; 10 a second
09h      encoder estimates  position [rev], velocity [rev/s] of the motor, f32
1Ch      torques            target, estimate [N m] of the motor, f32
=======  =================  ==================================================================================

Both estimates come unasked at ``rate_hz``. It is driven from the start (state 8): an arm that moves is driven; after a
power cycle it is idle (1), makes no torque, and its position is within one revolution: whole turns are lost.

Where the table is silent: it starts in 0.3 s, the kinds of message begin 1 ms apart, the velocity is the mean over the
last 2 ms, and estimates are those of the instant at which the message is offered to the bus. It hears no commands.
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

import math
import struct
from collections.abc import Callable, Mapping
from functools import partial
from typing import Annotated, Any, Final, Literal

from pydantic import Field, PositiveFloat

from hil_sim.devices.can_bus.can_wire import TransmitFrame
from hil_sim.devices.emulator import Bench, Equivalent, JointEmulator, Twin
from hil_sim.devices.powered import PoweredTwin
from hil_sim.faults import CLOCK_KINDS, ENCODER_KINDS, NO_FAULTS, DeviceFaults, FaultKind, FaultyClock, FaultyScalar
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ChipClock, ScalarAnalog
from hil_sim.sensing.controller_sensors import MotorTorqueSensor
from hil_sim.sensing.sensors import EncoderSensor

_HEARTBEAT, _ESTIMATES, _TORQUES = 0x01, 0x09, 0x1C
_IDLE, _CLOSED_LOOP = 1, 8
_DRIVER_FAULT: Final = 0x20
_BOOT_NS: Final = 300_000_000
_BEAT_NS: Final = 100_000_000
_APART_NS: Final = 1_000_000
_WINDOW_S: Final = 2e-3
_COUNTS: Final = 1 << 20  # of a vehicle file, in a revolution of the motor


class OdriveTwin(PoweredTwin):
    """One axis.

    Args:
        node: 0 to 63.
        angle: Of the joint, rad.
        torque: Of the motor on the joint, N m.
        clock: Its oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        turns: Revolutions of the motor in one of the joint; negative where it turns against.
        zero_rev: Its position at angle 0.
        rate_hz: Of either estimate.
        faults: What breaks; ``trip``: error bits ``value``, and it is idle from then on.

    Raises:
        FaultError: a fault that it cannot have.
    """

    _outside = frozenset({"trip"})

    def __init__(
        self,
        node: int,
        angle: ScalarAnalog,
        torque: ScalarAnalog,
        clock: ChipClock,
        start_ns: int,
        *,
        turns: float = 1.0,
        zero_rev: float = 0.0,
        rate_hz: float = 100.0,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        faults.require(
            *(FaultKind.OFF, FaultKind.RESET, FaultKind.SILENT, FaultKind.INTERMITTENT, FaultKind.TRIP),
            *(*ENCODER_KINDS, *CLOCK_KINDS),
        )
        self.hears_process_data = False
        self.samples = {_ESTIMATES: 0, _TORQUES: 0}
        self._node, self._turns, self._zero_rev = node, turns, zero_rev
        self._angle, self._torque = FaultyScalar(angle, faults, start_ns), torque
        self._clock = FaultyClock(clock, faults)
        self._period_ns = 1e9 / rate_hz
        self._state, self._errors = _CLOSED_LOOP, 0
        self._numbers: dict[str, int] = {}
        self._began_chip_ns = 0
        self._transmit: TransmitFrame = lambda identifier, data, ready_ns: None
        super().__init__(start_ns, faults)
        for window in faults.windows:
            if window.kind is FaultKind.TRIP:
                self._at("trip", window.start_ns, partial(self._trip, int(window.value) or _DRIVER_FAULT))

    def connect(self, transmit: TransmitFrame) -> None:
        """See ``CanTalker``."""
        self._transmit = transmit

    def receive(self, identifier: int, data: bytes, now_ns: int) -> None:
        """See ``CanTalker``: nothing is obeyed here."""

    def _trip(self, errors: int, now_ns: int) -> None:
        del now_ns
        self._state, self._errors = _IDLE, errors

    def _gain_power(self, now_ns: int) -> None:
        self._began_chip_ns = self._clock.chip_ns(now_ns) + _BOOT_NS
        if now_ns > self._start_ns:  # whole turns are lost, and nobody closes its loop again
            self._state, self._errors = _IDLE, 0
            self._zero_rev -= math.floor(self._position(self._seconds(now_ns)))
        self._numbers = {"beat": 0, "estimates": 0, "torques": 0}
        for name in self._numbers:
            self._arm(name)

    def _arm(self, name: str) -> None:
        kinds: dict[str, tuple[float, int, Callable[[int], None]]] = {
            "beat": (_BEAT_NS, 0, self._beat),
            "estimates": (self._period_ns, _APART_NS, self._tell_estimates),
            "torques": (self._period_ns, 2 * _APART_NS, self._tell_torques),
        }
        period_ns, phase_ns, action = kinds[name]
        chip_ns = self._began_chip_ns + phase_ns + round(self._numbers[name] * period_ns)
        self._numbers[name] += 1
        self._at(name, self._clock.time_ns(chip_ns), action)

    def _beat(self, now_ns: int) -> None:
        self._send(_HEARTBEAT, struct.pack("<IBBBx", self._errors, self._state, 0, 0), now_ns)
        self._arm("beat")

    def _tell_estimates(self, now_ns: int) -> None:
        time_s = self._seconds(now_ns)
        position, before_s = self._position(time_s), max(time_s - _WINDOW_S, 0.0)
        velocity = (position - self._position(before_s)) / (time_s - before_s) if time_s > before_s else 0.0
        self._send(_ESTIMATES, struct.pack("<ff", position, velocity), now_ns)
        self._arm("estimates")

    def _tell_torques(self, now_ns: int) -> None:
        made = self._torque.value(self._seconds(now_ns)) / self._turns if self._state == _CLOSED_LOOP else 0.0
        self._send(_TORQUES, struct.pack("<ff", made, made), now_ns)
        self._arm("torques")

    def _position(self, time_s: float) -> float:
        return self._turns * self._angle.value(time_s) / math.tau + self._zero_rev

    def _send(self, command: int, data: bytes, now_ns: int) -> None:
        if command in self.samples:
            self.samples[command] += 1
        if not self._is_silent(now_ns):
            self._transmit(self._node << 5 | command, data, now_ns)


class OdriveTable(JointEmulator):
    """An axis."""

    needs = "can"
    where = "node {node}"

    kind: Literal["odrive"]
    node: Annotated[int, Field(ge=0, le=63)]
    turns: float = 1.0
    zero_rev: float = 0.0
    rate_Hz: PositiveFloat = 100.0

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        table = {
            "node": said["node"],
            "measures": name,
            "torque": f"{name}_torque",
            "at": said["joint"],
            "turns": said.get("counts_per_revolution", _COUNTS) / _COUNTS,
            "zero_rev": said.get("zero_count", 0) / _COUNTS,
            "rate_Hz": said.get("rate_hz", 100.0),
            "channels": [channel for channel in ("velocity", "torque") if said.get(channel)],
        }
        torque = sheets.torque(sheets.effort_n_m(said["joint"]), said)
        return Equivalent(table, {name: sheets.encoder(name, said), f"{name}_torque": torque}, {name: "crystal"})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        twin = OdriveTwin(
            self.node,
            bench.sensor(EncoderSensor),
            bench.sensor(MotorTorqueSensor, "torque"),
            bench.clock,
            bench.start_ns,
            turns=self.turns,
            zero_rev=self.zero_rev,
            rate_hz=self.rate_Hz,
            faults=bench.faults,
        )
        commands = {f"{bench.name}_torque": _TORQUES}
        own = {channel: self.node << 5 | commands.get(channel, _ESTIMATES) for channel in self.recorded(bench.name)}
        return Twin(twin, lambda: twin.samples[_ESTIMATES], tuple(own), identifiers=own)
