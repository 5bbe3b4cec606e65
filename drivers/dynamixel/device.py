"""The servos of one line as a polled device: one Sync Read is one sample of each; driven ones are sent goals."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from math import tau
from typing import TYPE_CHECKING

from drivers import transports
from drivers.dynamixel import registers
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
    write_request,
)
from drivers.errors import ConfigurationError
from drivers.ports import SerialPort, Station
from drivers.records import Batch, SampleStatus, Severity
from drivers.serial_line.device import MS, Clock, OpenPort
from drivers.serial_line.poll import PolledDevice, Value

if TYPE_CHECKING:
    from drivers.dynamixel.drive import DynamixelAxis, DynamixelAxisConfig
    from drivers.dynamixel.driven import DrivenLine
    from drivers.play.player import Player, PlayerConfig

SILENT_AFTER = 5  # rounds in a row that a servo does not answer while others do
LOOK_NS = 1_000 * MS  # between two looks at the temperature of a servo, or for one that is silent
HOT_BELOW_LIMIT = 5  # degrees
PING_S = 1.0  # each answers 3 ms after the ID before its own: the last of 253 has answered
ASKED_AGAIN = table.HARDWARE_ERROR, table.TEMPERATURE_LIMIT
REST_S, RESTS = 0.01, 350  # at the end, until the servos stand: half a second more than a stop may take


class DynamixelBus(PolledDevice):
    """Servos on one TTL or RS-485 line, as SCALAR rows; see ``drivers.serial_line.poll`` for their two stamps.

    Without ``play`` nothing is ever written to a control table. When the port is opened each servo is asked who it
    is; those that answer are sampled together, by Fast Sync Read where all of them have it. A servo that does not
    answer ``SILENT_AFTER`` rounds is left out, which its channels lack, and looked for once a second. After an
    unanswered round the next one reads one byte more, so that a late answer has the wrong length and is rejected.
    ``device_status`` is the error byte: 80h (alert) is reported with what Hardware Error Status says, and the current
    is not valid as long as it is set; the position is not if the encoder fails.

    Args:
        name: Of the line: source of its own events. Those of a servo have the servo's.
        servos: At least one, with different IDs.
        open_port: Opens the serial port.
        clock: CLOCK_MONOTONIC, ns.
        timing: How they are asked.
        play: What those that are driven play. They are asked for more in each round, and sent goals after it.
        rest: Waits for some seconds, when the drives are stopped at the end.

    Attributes:
        player: Of ``play``; None without.

    Raises:
        ConfigurationError: No servo, two with one ID, or a time out of range.
    """

    def __init__(
        self,
        name: str,
        servos: Sequence[registers.DynamixelConfig],
        open_port: OpenPort,
        clock: Clock,
        timing: registers.DynamixelTiming | None = None,
        play: "PlayerConfig[DynamixelAxisConfig] | None" = None,
        rest: Callable[[float], object] = transports.rest,
    ) -> None:
        self.timing = registers.DynamixelTiming() if timing is None else timing
        self._servos = {servo.id: registers.KnownServo(servo) for servo in servos}
        if not servos or len(self._servos) < len(servos):
            raise ConfigurationError(f"{name}: ids {[servo.id for servo in servos]}: give each servo a different id")
        super().__init__(
            name,
            open_port,
            clock,
            self.timing.poll_period_ms,
            self.timing.sample_period_ms,
            self.timing.timeout_ms,
            0.0,
        )
        self._asides: deque[registers.BetweenRounds] = deque()
        self._aside_open: registers.BetweenRounds | None = None
        self._next_look_ns = 0
        self._looked_at = 0
        self._extra = 0  # surplus bytes in the request, which mark it against a late answer
        self._was_partial = False
        self._holds = False  # an aside was not answered: a round comes before the next one
        self._reply = Reply([servos[0].id], 1)
        self._stamp_ns = 0  # of its newest bytes
        self._driven: DrivenLine | None = None
        is_driven = any(servo.driven for servo in servos)
        self._block = (table.DRIVEN, table.DRIVEN_BYTES) if is_driven else (table.PRESENT, table.PRESENT_BYTES)
        if play is not None:
            from drivers.dynamixel import driven  # noqa: PLC0415  (few flights drive)

            self._driven = driven.DrivenLine(play, self.timing, self._report)
        self._rest = rest

    @property
    def player(self) -> "Player[DynamixelAxis] | None":
        """What drives the servos; None where they are only read."""
        return None if self._driven is None else self._driven.player

    def _value_channels(self) -> tuple[str, ...]:
        return tuple(channel for servo in self._servos.values() for channel in servo.config.channels)

    def _opened(self, now_ns: int) -> None:
        super()._opened(now_ns)
        self._asides.clear()
        self._aside_open = None
        for identifier, servo in self._servos.items():
            self._lost(servo)
            self._asides.append(registers.BetweenRounds(identifier, table.IDENTITY, table.IDENTITY_BYTES))
        self._next_look_ns = now_ns + LOOK_NS

    # What is driven

    def _exchange(self, now_ns: int) -> None:
        super()._exchange(now_ns)
        self._drive(now_ns)

    def _act(self, now_ns: int) -> bool:
        self._drive(now_ns)
        return super()._act(now_ns)

    def _drive(self, now_ns: int) -> None:
        """What is due by the answers that came; it goes out where no answer is awaited."""
        if self._driven is None:
            return
        self._driven.player.step(max(now_ns, self._stamp_ns))
        if not self._link.is_open:
            self._driven.forget()
        elif self._asked_ns is None:
            for packet in self._driven.packets():
                self._link.write(now_ns, packet)

    def stop(self, now_ns: int) -> list[Batch]:
        """See ``SerialDevice``; the servos are stopped, and looked after until they stand, or for a time."""
        if self._driven is not None and self._running:
            self._driven.player.step(now_ns)
            self._driven.player.stop("the flight ends")
            for _ in range(RESTS):
                self._exchange(now_ns)
                if not self._driven.player.is_moving:
                    break
                self._rest(REST_S)
                before_ns, now_ns = now_ns, max(now_ns, self._now())
                if now_ns == before_ns:  # a clock that stands
                    break
        return super().stop(now_ns)

    # What is asked

    def _aside(self, now_ns: int) -> bytes:
        if not self._asides and now_ns >= self._next_look_ns:
            self._next_look_ns = now_ns + LOOK_NS
            self._look()
        if self._holds and any(servo.is_there for servo in self._servos.values()):
            return b""
        if self._driven is not None and (transfer := self._driven.transfer()) is not None:
            self._aside_open = registers.BetweenRounds(*transfer, is_driving=True)
        elif self._asides:
            self._aside_open = self._asides.popleft()
        else:
            return b""
        identifier, address, count, data, _ = self._aside_open
        self._reply = Reply([identifier], count)
        return write_request(identifier, address, data) if data else read_request(identifier, address, count)

    def _look(self) -> None:
        """Look at the next servo."""
        identifiers = list(self._servos)
        self._looked_at = (self._looked_at + 1) % len(identifiers)
        absent = [identifier for identifier, servo in self._servos.items() if not servo.is_there]
        if absent and len(absent) < len(identifiers):  # where none is there, rounds ask all of them
            looked_for = absent[self._looked_at % len(absent)]
            self._asides.append(registers.BetweenRounds(looked_for, table.IDENTITY, table.IDENTITY_BYTES))
        identifier = identifiers[self._looked_at]
        if self._servos[identifier].is_there:
            self._asides.append(registers.BetweenRounds(identifier, *self._servos[identifier].health))
            if self._servos[identifier].faults:
                self._asides.append(registers.BetweenRounds(identifier, table.HARDWARE_ERROR, 1))

    def _question(self, retry: bool) -> bytes:
        self._extra = 1 - self._extra if retry or self._was_partial else 0
        self._aside_open, self._was_partial, self._holds = None, False, False
        there = {identifier: servo for identifier, servo in self._servos.items() if servo.is_there} or self._servos
        fast = self.timing.fast_sync_read and all(servo.is_fast for servo in there.values())
        address, count = self._block[0], self._block[1] + self._extra
        self._reply = Reply(list(there), count, fast=fast)
        return sync_read_request(list(there), address, count, fast=fast)

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
            if aside.address in ASKED_AGAIN and self._servos[aside.identifier].is_there:
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
        if blocks and self._driven is not None and self._asked_ns is not None:
            self._driven.round(self._asked_ns, host_ns)
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

    def _of_servo(self, host_ns: int, servo: registers.KnownServo, block: Block) -> list[Value]:
        config, present = servo.config, registers.decode_present(block.data[table.PRESENT - self._block[0] :])
        if servo.is_there:
            servo.missed = 0
        else:  # all were asked, as none was there
            servo.is_there = True
            self._asides.append(registers.BetweenRounds(config.id, table.IDENTITY, table.IDENTITY_BYTES))
        self._follow_alert(host_ns, servo, alert=bool(block.error & ALERT))
        encoder_fails = bool((servo.faults or 0) & table.ENCODER_ERROR)
        position, accepted = (present.position, False) if encoder_fails else servo.position.place(present.position)
        per_count = tau / config.counts_per_revolution

        def value(of: str, count: int, scale: float, unit: str, *, good: bool) -> Value:
            status = SampleStatus.OK if good else SampleStatus.NOT_VALID
            return Value(config.name + of, count, scale, unit, block.error, int(status))

        velocity_rad_s = table.VELOCITY_RAD_S * table.COUNTS / config.counts_per_revolution
        readings = [
            value("", position, per_count, "rad", good=accepted),
            value("_velocity", present.velocity, velocity_rad_s, "rad/s", good=not encoder_fails),
            value("_torque", present.current, servo.ampere, "A", good=bool(servo.ampere) and not block.error),
        ]
        if config.driven:
            said = registers.decode_driven(block.data)
            if self._driven is not None:
                self._driven.on_block(config.id, host_ns, block.error, said)
            ok = int(SampleStatus.OK)
            readings.append(Value(f"{config.name}_status", said.moving, 1.0, "", said.watchdog, ok))
        return [one for one in readings if one.channel in config.channels]

    def _missed(self, host_ns: int, servo: registers.KnownServo) -> None:
        servo.missed += 1
        if servo.missed >= SILENT_AFTER:
            self._lost(servo)
            text = f"id {servo.config.id} does not answer: check its cable and supply"
            self._tell(host_ns, servo, Severity.ERROR, "silent", text)

    def _lost(self, servo: registers.KnownServo) -> None:
        servo.is_there = False
        if self._driven is not None:
            self._driven.lost(servo.config.id)

    def _follow_alert(self, host_ns: int, servo: registers.KnownServo, *, alert: bool) -> None:
        if alert and servo.faults == 0:
            servo.faults = None
            self._asides.append(registers.BetweenRounds(servo.config.id, table.HARDWARE_ERROR, 1))
        elif not alert and servo.faults != 0:
            servo.faults = 0
            self._tell(host_ns, servo, Severity.INFO, "hardware_error_over", "its hardware error is over")

    def _answered_aside(self, host_ns: int, block: Block) -> None:
        assert self._aside_open is not None
        servo, address = self._servos[block.identifier], self._aside_open.address
        if self._aside_open.is_driving and self._driven is not None:
            self._driven.answered(block)
            self._holds = self._driven.player.is_active  # a round comes before the next one
        elif block.error & ~ALERT:
            text = f"it refuses address {address} ({ERRORS.get(block.error & ~ALERT, 'unknown error')})"
            self._tell(host_ns, servo, Severity.WARNING, "refused", f"{text}: check that it is an X series servo")
        elif address == table.IDENTITY:
            self._identified(host_ns, servo, block.data)
        elif address == table.TEMPERATURE_LIMIT:
            servo.temperature_limit = block.data[0]
        elif address in (table.HEALTH, table.DRIVEN_HEALTH):
            if self._driven is not None and address == table.DRIVEN_HEALTH:
                self._driven.on_torque(block.identifier, bool(block.data[0]))
            self._judge_health(host_ns, servo, block.data[table.HEALTH - address :])
        elif block.data[0] not in (0, servo.faults) and servo.faults != 0:
            servo.faults = block.data[0]
            said = "; ".join(text for bit, text in table.FAULTS.items() if servo.faults & bit) or "unknown"
            text = f"hardware error {servo.faults:02X}h: {said}. It stays until a reboot"
            self._tell(host_ns, servo, Severity.ERROR, "hardware_error", text)

    def _identified(self, host_ns: int, servo: registers.KnownServo, data: bytes) -> None:
        who = registers.decode_identity(data)
        if servo.missed >= SILENT_AFTER:
            self._tell(host_ns, servo, Severity.INFO, "recovered", f"id {servo.config.id} answers again")
        servo.is_there, servo.missed = True, 0
        if self._driven is not None:
            self._driven.found(servo.config.id)
        if who == servo.identity:
            return
        servo.identity = who
        how = "Fast Sync Read" if servo.is_fast else "Sync Read"
        text = f"model {who.model}, firmware {who.firmware}: {how}, answers after {who.return_delay_us} us"
        hint = ": write 0 to address 9 for shorter rounds" if who.return_delay_us > 20 else ""
        self._tell(host_ns, servo, Severity.INFO, "identified", text + hint)
        self._asides.append(registers.BetweenRounds(servo.config.id, table.TEMPERATURE_LIMIT, 1))
        if servo.config.torque and not servo.ampere:
            text = f"current of model {who.model} is unknown, or it has none: give ampere_per_count, or torque = false"
            self._tell(host_ns, servo, Severity.ERROR, "no_current", text)

    def _judge_health(self, host_ns: int, servo: registers.KnownServo, data: bytes) -> None:
        decivolt, celsius = int.from_bytes(data[:2], "little"), data[2]
        hot = bool(servo.temperature_limit) and celsius > servo.temperature_limit - HOT_BELOW_LIMIT
        if hot and not servo.is_hot:
            text = f"{celsius} C at {0.1 * decivolt:.1f} V, it stops at {servo.temperature_limit} C: load it less"
            self._tell(host_ns, servo, Severity.WARNING, "hot", text)
        servo.is_hot = hot

    def _tell(self, host_ns: int, servo: registers.KnownServo, severity: Severity, code: str, text: str) -> None:
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
            known = "" if model in table.MODELS else ", unknown here"
            yield Station(block.identifier, f"DYNAMIXEL, model {model}{known}, firmware {block.data[2]}")
