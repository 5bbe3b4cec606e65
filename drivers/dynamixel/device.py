"""The servos of one line as a polled device: one Sync Read is one sample of each."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from math import tau

from drivers.dynamixel import registers as table
from drivers.dynamixel.packet import (
    ALERT,
    ERRORS,
    PING_BYTES,
    Block,
    Reply,
    ping_request,
    read_request,
    statuses,
    sync_read_request,
)
from drivers.dynamixel.registers import DynamixelConfig, DynamixelTiming, Identity, decode_identity, decode_present
from drivers.errors import ConfigurationError
from drivers.ports import SerialPort, Station
from drivers.position import Position
from drivers.records import SampleStatus, Severity
from drivers.serial_poll import PolledDevice, Value
from drivers.serial_stream import MS, Clock, OpenPort

SILENT_AFTER = 5  # rounds in a row that a servo does not answer while others do
LOOK_NS = 1_000 * MS  # between two looks at the temperature of a servo, or for one that is silent
HOT_BELOW_LIMIT = 5  # degrees
PING_S = 1.0  # each answers 3 ms after the ID before its own: the last of 253 has answered
LARGEST_STEP = table.COUNTS // 4  # between two samples, counts of the horn


class _Servo:
    """What is known of one."""

    def __init__(self, config: DynamixelConfig) -> None:
        self.config = config
        many_turns = abs(config.counts_per_revolution) > table.COUNTS
        self.position = Position(LARGEST_STEP, config.zero_count, 32 if many_turns else 12)
        self.is_there = False
        self.missed = 0
        self.identity = Identity(0, 0, 0)
        self.faults: int | None = 0  # None: the alert bit is set, and what it means is not read yet
        self.temperature_limit = 0
        self.is_hot = False

    @property
    def is_fast(self) -> bool:
        """Whether its firmware has Fast Sync Read."""
        return self.identity.firmware >= self._model.fast_from

    @property
    def _model(self) -> table.Model:
        return table.MODELS.get(self.identity.model, table.UNKNOWN)

    @property
    def ampere(self) -> float:
        """Of a count of Present Current, in the joint's direction; 0: unknown."""
        sign = 1.0 if self.config.counts_per_revolution > 0 else -1.0
        return sign * (self.config.ampere_per_count or self._model.ampere)


class DynamixelBus(PolledDevice):
    """Servos on one TTL or RS-485 line, as SCALAR rows; see ``drivers.serial_poll`` for their two stamps.

    Only read: nothing is ever written to a control table. When the port is opened each servo is asked who it is; those
    that answer are sampled together, by Fast Sync Read where all of them have it. A servo that does not answer
    ``SILENT_AFTER`` rounds is left out, which its channels lack, and looked for once a second. After an
    unanswered round the next one reads one byte more, so that a late answer has the wrong length and is rejected.
    ``device_status`` is the error byte: 80h (alert) is told with what Hardware Error Status says, and the current is
    not valid as long as it is set; the position is not if the encoder fails.

    Args:
        name: Of the line: source of its own events. Those of a servo have the servo's.
        servos: At least one, with different IDs.
        open_port: Opens the serial port.
        clock: CLOCK_MONOTONIC, ns.
        timing: How they are asked.

    Raises:
        ConfigurationError: No servo, two with one ID, or a time out of range.
    """

    def __init__(
        self,
        name: str,
        servos: Sequence[DynamixelConfig],
        open_port: OpenPort,
        clock: Clock,
        timing: DynamixelTiming | None = None,
    ) -> None:
        self.timing = DynamixelTiming() if timing is None else timing
        self._servos = {servo.id: _Servo(servo) for servo in servos}
        if not servos or len(self._servos) < len(servos):
            raise ConfigurationError(f"{name}: ids {[servo.id for servo in servos]}: give each servo one of its own")
        super().__init__(
            name,
            open_port,
            clock,
            self.timing.poll_period_ms,
            self.timing.sample_period_ms,
            self.timing.timeout_ms,
            0.0,
        )
        self._asides: deque[tuple[int, int, int]] = deque()  # id, address, count
        self._aside_open: tuple[int, int, int] | None = None
        self._next_look_ns = 0
        self._looked_at = 0
        self._extra = 0  # surplus bytes in the request, which mark it against a late answer
        self._was_partial = False
        self._holds = False  # an aside was not answered: a round comes before the next one
        self._reply = Reply([servos[0].id], 1)
        self._stamp_ns = 0  # of its newest bytes

    def _value_channels(self) -> tuple[str, ...]:
        return tuple(channel for servo in self._servos.values() for channel in servo.config.channels)

    def _opened(self, now_ns: int) -> None:
        super()._opened(now_ns)
        self._asides.clear()
        self._aside_open = None
        for identifier, servo in self._servos.items():
            servo.is_there = False
            self._asides.append((identifier, table.IDENTITY, table.IDENTITY_BYTES))
        self._next_look_ns = now_ns + LOOK_NS

    # What is asked

    def _aside(self, now_ns: int) -> bytes:
        if not self._asides and now_ns >= self._next_look_ns:
            self._next_look_ns = now_ns + LOOK_NS
            self._look()
        if not self._asides or (self._holds and any(servo.is_there for servo in self._servos.values())):
            return b""
        self._aside_open = self._asides.popleft()
        identifier, address, count = self._aside_open
        self._reply = Reply([identifier], count)
        return read_request(identifier, address, count)

    def _look(self) -> None:
        """Look at the next servo."""
        identifiers = list(self._servos)
        self._looked_at = (self._looked_at + 1) % len(identifiers)
        absent = [identifier for identifier, servo in self._servos.items() if not servo.is_there]
        if absent and len(absent) < len(identifiers):  # where none is there, rounds ask all of them
            self._asides.append((absent[self._looked_at % len(absent)], table.IDENTITY, table.IDENTITY_BYTES))
        identifier = identifiers[self._looked_at]
        if self._servos[identifier].is_there:
            self._asides.append((identifier, table.HEALTH, table.HEALTH_BYTES))
            if self._servos[identifier].faults:
                self._asides.append((identifier, table.HARDWARE_ERROR, 1))

    def _question(self, retry: bool) -> bytes:
        self._extra = 1 - self._extra if retry or self._was_partial else 0
        self._aside_open, self._was_partial, self._holds = None, False, False
        there = {identifier: servo for identifier, servo in self._servos.items() if servo.is_there} or self._servos
        fast = self.timing.fast_sync_read and all(servo.is_fast for servo in there.values())
        count = table.PRESENT_BYTES + self._extra
        self._reply = Reply(list(there), count, fast=fast)
        return sync_read_request(list(there), table.PRESENT, count, fast=fast)

    def _missing(self) -> int:
        return self._reply.missing

    # What is answered

    def _answer(self, host_ns: int, data: bytes) -> list[Value] | None:
        self._stamp_ns = host_ns
        if not self._reply.receive(data):
            return None
        if self._aside_open is not None:
            (block,) = self._reply.blocks
            self._answered_aside(host_ns, block)
            return []
        return self._values(host_ns)

    def _given_up(self, now_ns: int, cause: str) -> tuple[int, list[Value]]:
        aside = self._aside_open
        if aside is not None:
            self._holds = True
            if aside[1] in (table.HARDWARE_ERROR, table.TEMPERATURE_LIMIT) and self._servos[aside[0]].is_there:
                self._asides.append(aside)
            return now_ns, []
        came = {block.identifier for block in self._reply.blocks}
        self._was_partial = bool(came)
        silent = next((servo for one, servo in self._servos.items() if servo.is_there and one not in came), None)
        if cause == "no_answer" and silent is not None:  # they answer in turn: those after it may have waited for it
            self._missed(now_ns, silent)
        return self._stamp_ns, self._values(self._stamp_ns)

    def _values(self, host_ns: int) -> list[Value]:
        """Of the blocks of a round."""
        blocks = {block.identifier: block for block in self._reply.blocks}
        values: list[Value] = []
        for identifier, servo in self._servos.items():
            block = blocks.get(identifier)
            if block is None:
                continue
            if block.error & ~ALERT:
                error = block.error & ~ALERT
                text = f"error {error}: {ERRORS.get(error, 'unknown')}: check that it is an X series servo"
                self._tell(host_ns, servo, Severity.ERROR, f"error_{error}", text)
            else:
                values += self._of_servo(host_ns, servo, block)
        return values

    def _of_servo(self, host_ns: int, servo: _Servo, block: Block) -> list[Value]:
        config, present = servo.config, decode_present(block.data)
        if servo.is_there:
            servo.missed = 0
        else:  # all were asked, as none was there
            servo.is_there = True
            self._asides.append((config.id, table.IDENTITY, table.IDENTITY_BYTES))
        self._follow_alert(host_ns, servo, alert=bool(block.error & ALERT))
        encoder_fails = bool((servo.faults or 0) & table.ENCODER_ERROR)
        position, accepted = (present.position, False) if encoder_fails else servo.position.place(present.position)
        per_count = tau / config.counts_per_revolution

        def told(of: str, count: int, scale: float, unit: str, *, good: bool) -> Value:
            status = SampleStatus.OK if good else SampleStatus.NOT_VALID
            return Value(config.name + of, count, scale, unit, block.error, int(status))

        velocity_rad_s = table.VELOCITY_RAD_S * table.COUNTS / config.counts_per_revolution
        readings = (
            told("", position, per_count, "rad", good=accepted),
            told("_velocity", present.velocity, velocity_rad_s, "rad/s", good=not encoder_fails),
            told("_torque", present.current, servo.ampere, "A", good=bool(servo.ampere) and not block.error),
        )
        return [one for one in readings if one.channel in config.channels]

    def _missed(self, host_ns: int, servo: _Servo) -> None:
        servo.missed += 1
        if servo.missed >= SILENT_AFTER:
            servo.is_there = False
            text = f"id {servo.config.id} does not answer: check its cable and supply"
            self._tell(host_ns, servo, Severity.ERROR, "silent", text)

    def _follow_alert(self, host_ns: int, servo: _Servo, *, alert: bool) -> None:
        if alert and servo.faults == 0:
            servo.faults = None
            self._asides.append((servo.config.id, table.HARDWARE_ERROR, 1))
        elif not alert and servo.faults != 0:
            servo.faults = 0
            self._tell(host_ns, servo, Severity.INFO, "hardware_error_over", "its hardware error is over")

    def _answered_aside(self, host_ns: int, block: Block) -> None:
        servo, address = self._servos[block.identifier], (self._aside_open or (0, 0, 0))[1]
        if block.error & ~ALERT:
            text = f"it refuses address {address} ({ERRORS.get(block.error & ~ALERT, 'unknown error')})"
            self._tell(host_ns, servo, Severity.WARNING, "refused", f"{text}: check that it is an X series servo")
        elif address == table.IDENTITY:
            self._identified(host_ns, servo, block.data)
        elif address == table.TEMPERATURE_LIMIT:
            servo.temperature_limit = block.data[0]
        elif address == table.HEALTH:
            self._judge_health(host_ns, servo, block.data)
        elif block.data[0] not in (0, servo.faults) and servo.faults != 0:
            servo.faults = block.data[0]
            said = "; ".join(text for bit, text in table.FAULTS.items() if servo.faults & bit) or "unknown"
            text = f"hardware error {servo.faults:02X}h: {said}. It stays until a reboot"
            self._tell(host_ns, servo, Severity.ERROR, "hardware_error", text)

    def _identified(self, host_ns: int, servo: _Servo, data: bytes) -> None:
        who = decode_identity(data)
        if servo.missed >= SILENT_AFTER:
            self._tell(host_ns, servo, Severity.INFO, "recovered", f"id {servo.config.id} answers again")
        servo.is_there, servo.missed = True, 0
        if who == servo.identity:
            return
        servo.identity = who
        how = "Fast Sync Read" if servo.is_fast else "Sync Read"
        text = f"model {who.model}, firmware {who.firmware}: {how}, answers after {who.return_delay_us} us"
        hint = ": write 0 to address 9 for shorter rounds" if who.return_delay_us > 20 else ""
        self._tell(host_ns, servo, Severity.INFO, "identified", text + hint)
        self._asides.append((servo.config.id, table.TEMPERATURE_LIMIT, 1))
        if servo.config.torque and not servo.ampere:
            text = (
                f"current of model {who.model} is not known, or it has none: give ampere_per_count, or torque = false"
            )
            self._tell(host_ns, servo, Severity.ERROR, "no_current", text)

    def _judge_health(self, host_ns: int, servo: _Servo, data: bytes) -> None:
        decivolt, celsius = int.from_bytes(data[:2], "little"), data[2]
        hot = bool(servo.temperature_limit) and celsius > servo.temperature_limit - HOT_BELOW_LIMIT
        if hot and not servo.is_hot:
            text = f"{celsius} C at {0.1 * decivolt:.1f} V, it stops at {servo.temperature_limit} C: load it less"
            self._tell(host_ns, servo, Severity.WARNING, "hot", text)
        servo.is_hot = hot

    def _tell(self, host_ns: int, servo: _Servo, severity: Severity, code: str, text: str) -> None:
        self._report.event(host_ns, severity, code, text, servo.config.name)


def answering(port: SerialPort, wait: Callable[[float], object]) -> Iterator[Station]:
    """Servos that answer a ping to all of them at the line's speed; nothing is written to a control table.

    Raises:
        OSError: The line fails.
    """
    port.write(ping_request())
    wait(PING_S)
    for block in statuses(port.read(port.in_waiting)):
        if len(block.data) == PING_BYTES:
            model = int.from_bytes(block.data[:2], "little")
            known = "" if model in table.MODELS else ", not one that is known"
            yield Station(block.identifier, f"DYNAMIXEL, model {model}{known}, firmware {block.data[2]}")
