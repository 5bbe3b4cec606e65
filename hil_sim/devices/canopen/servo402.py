"""A CiA 402 servo drive that moves its axis by set points, and stops it by itself (IEC 61800-7-201, CiA 301).

Modes: profile position (1), cyclic synchronous position (8) and torque (10). Set points come by SDO or RPDO.

=====  ============================  =============================================================================
index  object                        here
=====  ============================  =============================================================================
1016h  consumer heartbeat time       one producer; a beat that stays out is EMCY 8130h, 6007h, and pre-operational
6007h  abort connection option       0 nothing, 1 fault, 2 no current, 3 quick stop; also on NMT stop and reset
605Ah  quick stop option             0 no current, 2 ramp of 6085h and off, 6 ramp of 6085h and hold
605Eh  fault reaction option         0 no current, 2 ramp of 6085h
6062h  position demand value         increments
6065h  following error window        increments, FFFFFFFFh for none; 6066h: ms; beyond it EMCY 8611h
6071h  target torque                 0.1 % of 6076h
607Ah  target position               increments; what is outside 607Dh is cut to it
607Dh  software position limit       least, most; no limit where both are 0 or the least is not below the most
6081h  profile velocity              increments/s; 6083h, 6084h: acceleration and deceleration, increments/s2
6085h  quick stop deceleration       increments/s2
60C2h  interpolation period          :1 times 10 to the power of :2 seconds
60F4h  following error actual value  increments
=====  ============================  =============================================================================

In mode 8 the demand goes to a new target in one interpolation period and stands there until the next one comes. In
mode 1 bit 4 of the controlword takes a target over, bit 12 of the statusword answers, bit 8 halts. In mode 10 an axis
that leaves 607Dh is a fault (8612h). A change of mode while enabled begins from where the axis is. The brake holds
whenever there is no current.
"""

import math
from typing import Final

from hil_sim.devices.canopen.canopen_node import OFF, OPERATIONAL, PRE_OPERATIONAL
from hil_sim.devices.canopen.drive402 import (
    FAULT,
    FAULT_REACTION_ACTIVE,
    OPERATION_ENABLED,
    QUICK_STOP_ACTIVE,
    SWITCH_ON_DISABLED,
    Drive402,
)
from hil_sim.devices.canopen.servo_loop import ServoLoop
from hil_sim.devices.canopen.servo_objects import CSP, CST, NO_WINDOW, PP, ServoObjects
from hil_sim.faults import NO_FAULTS, DeviceFaults, FaultKind
from hil_sim.plants.drives.servo_axis import STEP_S, AxisAngle, AxisTorque, DriveJoint

_CYCLE_NS: Final = 2_000_000  # of the watch
_NEW_SET_POINT, _AT_ONCE, _HALT = 0x10, 0x20, 0x100  # controlword
_REACHED, _INTERNAL_LIMIT, _ACKNOWLEDGE, _FOLLOWING_ERROR = 0x0400, 0x0800, 0x1000, 0x2000  # statusword
_HEARTBEAT_ERROR, _FOLLOWING, _LIMIT, _EMERGENCY_STOP, _OVER_CURRENT = 0x8130, 0x8611, 0x8612, 0x5441, 0x2310
_COMMUNICATION: Final = 0x10  # error register
_STANDSTILL: Final = 2e-2  # rad/s, by the encoder
_LONGEST_RAMP_NS: Final = 2_000_000_000


class ServoDrive402(Drive402):
    """One drive and the axis behind it.

    Args:
        node_id: CANopen node number.
        axis: What it moves.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        increments_per_revolution: 608Fh; of the axis.
        zero_increments: Position actual value at angle zero.
        reversed_count: It counts against the joint.
        rated_torque_nm: 6076h, N m, of the motor itself.
        gear_ratio: Revolutions of the motor in one of the axis.
        faults: What breaks.

    Raises:
        FaultError: a fault that a drive cannot have.
    """

    def __init__(
        self,
        node_id: int,
        axis: DriveJoint,
        start_ns: int,
        *,
        increments_per_revolution: int = 500_000,
        zero_increments: int = 0,
        reversed_count: bool = False,
        rated_torque_nm: float = 10.0,
        gear_ratio: float = 1.0,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        told = [
            ((window.start_ns - start_ns) * 1e-9, int(window.value) or _OVER_CURRENT)
            for window in faults.windows
            if window.kind is FaultKind.TRIP
        ]
        super().__init__(
            node_id,
            AxisAngle(axis),
            AxisTorque(axis),
            start_ns,
            increments_per_revolution=increments_per_revolution,
            zero_increments=zero_increments,
            rated_torque_nm=rated_torque_nm,
            gear_ratio=gear_ratio,
            commands=(),
            trips=tuple(told),
            faults=faults,
            extra_faults=(FaultKind.TRIP, FaultKind.EMERGENCY_STOP),
        )
        self.axis = axis
        self._sense = -1.0 if reversed_count else 1.0
        self._increments_per_rad *= self._sense
        self._loop = ServoLoop(axis, self._angle.value)
        self._acknowledged = self._ramping = self._heard = self._cut = False
        self._error_since_ns: int | None = None
        self._ramp_since_ns = 0
        self._objects = ServoObjects(self.dictionary, node_id, abs(self._increments_per_rad))
        self._mode = self._objects.mode
        self._objects.mode.changed, self._objects.target.changed = self._on_mode, self._on_target
        self._objects.demand.read, self._objects.error.read = self.demand, self.following_error
        self._rpdos += self._objects.rpdos
        for window in faults.windows:
            if window.kind is FaultKind.EMERGENCY_STOP:
                self._at(f"emergency stop {window.start_ns}", window.start_ns, self._emergency_stop)
        axis.controller = self._control

    # What the bus sees

    def receive(self, identifier: int, data: bytes, now_ns: int) -> None:
        """A frame has ended on the wire."""
        self.axis.advance(self._seconds(now_ns))
        beat = self._objects.consumer.value
        if identifier == 0x700 + (beat >> 16 & 0x7F) and beat & 0xFFFF and beat >> 16 & 0x7F:
            if self.state not in (OFF, 0) and not self._is_silent(now_ns):
                self._heard = True
                self._at("consumer", now_ns + self._timer_ns(beat & 0xFFFF), self._abandoned_by_master)
            return
        super().receive(identifier, data, now_ns)

    def answers(self, now_ns: int) -> None:
        """See ``CanopenNode``: where its axis goes depends on what the bus carries."""

    def statusword(self, now_ns: int) -> int:
        """Object 6041h."""
        word = super().statusword(now_ns) & ~_REACHED
        if self._drive_state == OPERATION_ENABLED:
            if self._mode.value == PP:
                word |= _ACKNOWLEDGE if self._acknowledged else 0
                word |= _REACHED if self._loop.target is None else 0
            else:
                word |= _ACKNOWLEDGE  # the drive follows the command value
            cut = self._within(self._objects.target.value) != self._zeroed(self._objects.target.value)
            word |= _INTERNAL_LIMIT if cut else 0
        if self._error_since_ns is not None:
            word |= _FOLLOWING_ERROR
        return word

    def demand(self, now_ns: int) -> int:
        """Object 6062h at ``now_ns``."""
        self.axis.advance(self._seconds(now_ns))
        return round(self._loop.demand * self._increments_per_rad) + self._zero_increments

    def following_error(self, now_ns: int) -> int:
        """Object 60F4h at ``now_ns``: demand less actual position."""
        return self.demand(now_ns) - self._increments(now_ns) - self._zero_increments

    def trip(self, code: int, now_ns: int) -> None:
        """See ``Drive402``; the axis is stopped as 605Eh says before the current goes."""
        if self._drive_state in (FAULT, FAULT_REACTION_ACTIVE):
            return
        ramps = self._drive_state in (OPERATION_ENABLED, QUICK_STOP_ACTIVE) and self._objects.fault_option.value == 2
        super().trip(code, now_ns)
        self._ramping = ramps
        self._ramp_since_ns = now_ns
        if ramps:
            self._stop("drive")  # it is over when the axis stands

    # State machine

    def _command(self, word: int, now_ns: int) -> None:
        self.axis.advance(self._seconds(now_ns))
        super()._command(word, now_ns)

    def _on_controlword(self, word: int, now_ns: int) -> None:
        before = self._drive_state
        rising = word & _NEW_SET_POINT and not self._last_controlword & _NEW_SET_POINT
        if self._cut:  # the button is in yet: no reset
            self._last_controlword = word
            return
        super()._on_controlword(word, now_ns)
        if self._drive_state == OPERATION_ENABLED and before not in (OPERATION_ENABLED, QUICK_STOP_ACTIVE):
            self._loop.stand()
        elif self._drive_state == OPERATION_ENABLED and before == QUICK_STOP_ACTIVE:
            self._ramping = False
            self._loop.stand()
        if self._drive_state == OPERATION_ENABLED and self._mode.value == PP:
            if rising and not self._acknowledged and (self._loop.target is None or word & _AT_ONCE):
                self._loop.target = self._within(self._objects.target.value)
                self._acknowledged = True
            elif not word & _NEW_SET_POINT:
                self._acknowledged = False

    def _quick_stop(self, now_ns: int) -> None:
        if self._drive_state == OPERATION_ENABLED and self._objects.stop_option.value:
            self._enter(QUICK_STOP_ACTIVE, now_ns)
            self._ramping, self._ramp_since_ns = True, now_ns
        elif self._drive_state != QUICK_STOP_ACTIVE:
            self._enter(SWITCH_ON_DISABLED, now_ns)

    def _enter(self, state: int, now_ns: int) -> None:
        super()._enter(state, now_ns)
        if state not in (OPERATION_ENABLED, QUICK_STOP_ACTIVE, FAULT_REACTION_ACTIVE):
            self._ramping, self._loop.target, self._acknowledged = False, None, False
            self._error_since_ns = None
            self._stop("watch")
        elif "watch" not in self._timers:
            self._at("watch", now_ns + _CYCLE_NS, self._watch)

    def _before_start(self) -> None:
        super()._before_start()
        self._ramping = self._heard = False
        self._loop.target, self._acknowledged, self._error_since_ns = None, False, None
        self._stop("consumer")
        self._stop("watch")
        for rpdo in self._rpdos:
            rpdo.restart()

    def _lose_power(self, now_ns: int) -> None:
        self.axis.advance(self._seconds(now_ns))
        super()._lose_power(now_ns)
        self._before_start()

    def _on_nmt(self, command: int, now_ns: int) -> None:
        before = self.state
        if command in (129, 130) or command == 2:
            self._lose_connection(now_ns)
        if command == 130 and before == OPERATIONAL:
            self._stop("consumer")
        super()._on_nmt(command, now_ns)

    def _start_node(self, now_ns: int) -> None:
        if self.state != OPERATIONAL:
            for rpdo in self._rpdos:
                rpdo.restart()
        super()._start_node(now_ns)

    def _on_sync(self, counter: int | None, now_ns: int) -> None:
        super()._on_sync(counter, now_ns)
        for rpdo in self._rpdos:
            rpdo.on_sync(now_ns)

    # What stops it without a master

    def _abandoned_by_master(self, now_ns: int) -> None:
        self._heard = False
        self.emergency(_HEARTBEAT_ERROR, _COMMUNICATION, b"", now_ns)
        self._lose_connection(now_ns)
        if self.state == OPERATIONAL:
            self._leave_operational(PRE_OPERATIONAL)

    def _lose_connection(self, now_ns: int) -> None:
        """6007h."""
        self.axis.advance(self._seconds(now_ns))
        option = self._objects.abort_option.value
        if option == 1:
            self.trip(_HEARTBEAT_ERROR, now_ns)
        elif option == 2 and self._drive_state not in (FAULT, FAULT_REACTION_ACTIVE):
            self._enter(SWITCH_ON_DISABLED, now_ns)
        elif option == 3 and self._drive_state == OPERATION_ENABLED:
            self._quick_stop(now_ns)

    def _emergency_stop(self, now_ns: int) -> None:
        self.axis.advance(self._seconds(now_ns))
        window = self._faults.active(FaultKind.EMERGENCY_STOP, now_ns)
        self._cut = True
        if window is not None:
            self._at(f"released {window.start_ns}", window.end_ns, self._release)
        if self.state != OFF:
            self._error_code.value = _EMERGENCY_STOP
            self.emergency(_EMERGENCY_STOP, 0x01, b"", now_ns)
            self._enter(FAULT, now_ns)

    def _release(self, now_ns: int) -> None:
        del now_ns
        self._cut = False

    def _watch(self, now_ns: int) -> None:
        """Every 2 ms while there is current: following error, limits in mode 10, the end of a ramp."""
        self.axis.advance(self._seconds(now_ns))
        self._at("watch", now_ns + _CYCLE_NS, self._watch)
        if self._ramping:
            stands = self._loop.stands and abs(self._rate(now_ns)) < _STANDSTILL
            if stands or now_ns - self._ramp_since_ns > _LONGEST_RAMP_NS:
                self._end_ramp(now_ns)
                return
        if self._drive_state == FAULT_REACTION_ACTIVE:
            return
        if self._drive_state == OPERATION_ENABLED and self._mode.value == CST:
            low, high = self._limits()
            if not low <= self._angle.value(self._seconds(now_ns)) <= high:
                self.trip(_LIMIT, now_ns)
        elif self._objects.window.value != NO_WINDOW and abs(self.following_error(now_ns)) > self._objects.window.value:
            if self._error_since_ns is None:
                self._error_since_ns = now_ns
            if now_ns - self._error_since_ns >= self._objects.window_ms.value * 1_000_000:
                self.trip(_FOLLOWING, now_ns)
        else:
            self._error_since_ns = None

    def _end_ramp(self, now_ns: int) -> None:
        self._ramping = False
        if self._drive_state == FAULT_REACTION_ACTIVE:
            self._enter(FAULT, now_ns)
        elif self._drive_state == QUICK_STOP_ACTIVE and self._objects.stop_option.value == 2:
            self._enter(SWITCH_ON_DISABLED, now_ns)

    # The servo, in radians of the joint

    def _control(self, time_s: float, rate_rad_s: float) -> float | None:
        """Torque on the joint; None without current. See ``Controller``."""
        state, loop = self._drive_state, self._loop
        reacts = state == FAULT_REACTION_ACTIVE and self._ramping
        if self._cut or self.state == OFF or not (reacts or state in (OPERATION_ENABLED, QUICK_STOP_ACTIVE)):
            return None
        per_rad, mode = abs(self._increments_per_rad), self._mode.value
        if self._ramping:
            loop.slow_down(self._objects.quick_deceleration.value / per_rad)
        elif state == QUICK_STOP_ACTIVE:
            loop.rate = 0.0
        elif mode == CST:
            loop.stand()
            return self._sense * self._objects.target_torque.value * 1e-3 * self._rated_torque_nm
        elif mode == CSP:
            loop.follow_line(time_s, self._interpolation_s())
        else:
            fastest = 0.0 if self._last_controlword & _HALT else self._objects.velocity.value / per_rad
            ramps = (
                max(entry.value / per_rad, 1e-6) for entry in (self._objects.acceleration, self._objects.deceleration)
            )
            loop.follow_profile(fastest, *ramps)
        blind = self._faults.active(FaultKind.STUCK, self._start_ns + round(time_s * 1e9)) if self._faults else None
        return loop.torque(time_s, 0.0 if blind is not None else rate_rad_s)

    def _on_target(self, value: int, now_ns: int) -> None:
        if self._mode.value == CSP:
            self._loop.go_to(self._seconds(now_ns), self._within(value))

    def _on_mode(self, value: int, now_ns: int) -> None:
        del value, now_ns
        self._objects.target_torque.value = 0
        self._loop.stand()

    def _rate(self, now_ns: int) -> float:
        return self.velocity(now_ns) / self._increments_per_rad

    def _raw_torque(self, now_ns: int) -> float:
        return self._sense * super()._raw_torque(now_ns)

    def _zeroed(self, increments: int) -> float:
        return (increments - self._zero_increments) / self._increments_per_rad

    def _limits(self) -> tuple[float, float]:
        """607Dh in rad."""
        low, high = self._objects.least.value, self._objects.most.value
        if low >= high:
            return -math.inf, math.inf
        ends = self._zeroed(low), self._zeroed(high)
        return min(ends), max(ends)

    def _within(self, increments: int) -> float:
        """A target in rad, cut to 607Dh."""
        low, high = self._limits()
        return min(max(self._zeroed(increments), low), high)

    def _interpolation_s(self) -> float:
        period = self._objects.interpolation.value * 10.0**self._objects.interpolation_power.value
        return float(max(period, STEP_S))
