"""A US Digital QSB, the serial adapter of a quadrature encoder ("QSB Command List" v1.28, 2021-05-05).

A command is a letter (R, W, S), two hexadecimal digits of a register, up to eight of data, and CR, LF or both;
backspace deletes. It is answered by the letter in lower case, or ``e`` (refused; data echoed) or ``x`` (not supported),
by register and eight digits of data, by the time stamp if EOR asks for it, and by ``!``. A write of EOR is answered in
the new format already. A read of a register ends its stream.

What the document leaves open, and what is done here:

- A line that is no command is answered ``e`` with register 00. An answer leaves 100 us (one measurement) after the end
  of its command. MODE 1 is stored and nothing more.
- A stream says its value once when it is asked for. ``S0E`` then measures every INTERVAL ticks (FFFFh: never again) and
  speaks when the count is THRESHOLD or more away from what was said last; if the line is busy it measures 100 us before
  the line is free. ``S05`` and ``S01`` speak at the edge that changed them, ``S06`` is looked at every 100 us, and what
  they say waits its turn.
- DIG I/O CFG holds for each input the polarity in bits 3..0 (1: falling) and the interrupt in bits 7..4.
- ``W16x0A`` chooses 9600, 19200, 38400, 56000, 115200, 128000, 230400 or 256000 baud for x = 0..7; its answer goes at
  the old rate. ``W163`` keeps registers and rate over a reset, not the count and not the streams.
- ``QSB-D  0E!`` at start-up is not in the document; others saw it.
"""

import heapq
import math
from typing import Final

from hil_sim.devices.serial_line import qsb_map as reg
from hil_sim.devices.serial_line.quadrature import QuadratureCounter
from hil_sim.devices.serial_line.serial_twin import SerialTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import CLOCK_KINDS, ENCODER_KINDS, NO_FAULTS, DeviceFaults, FaultKind, FaultyClock, FaultyScalar
from hil_sim.sensing.analog import ChipClock, ScalarAnalog

TICK_512_HZ: Final = 1e9 / 512  # ns; the document's "1/512 Hz" and "1.95 ms"
TICK_1900_US: Final = 1.9e6  # ns; its "5 ticks: 9.5 ms" and "rollover in 94.5 days"

_FACTORY_LINE: Final = LineFormat(230_400)
_MEASUREMENT_NS: Final = 100_000
_BOOT_NS: Final = 100_000_000
_LONGEST_COMMAND: Final = 32
_LOOK_AHEAD_NS: Final = 1_000_000_000
_VERSION: Final = 0x13FA600E  # serial number 13FA6, model D, firmware 0E
_BANNER: Final = b"QSB-D  0E!\r\n"
_SPURIOUS_HIGH_NS: Final = 300_000
_FREE_RUNNING: Final = {1: 0x01, 2: 0x02, 4: 0x03}  # MDR0, by counts in a cycle
_CAPTURE_NOW: Final = 2  # beside the levels 0 and 1 in the queue of input events


class QsbTwin(SerialTwin):
    """One adapter with its encoder.

    Args:
        analog: Angle of the encoder's shaft, or of the joint behind it, rad.
        clock: The adapter's oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        counts_per_revolution: x4 counts in one turn of what ``analog`` gives.
        tick_ns: Unit of TIMESTAMP and INTERVAL on its own clock: ``TICK_512_HZ`` or ``TICK_1900_US``.
        sync_input: Whether a line that is low at rest drives DIG I/O 0; the pull-up holds it high otherwise.
        capture_latency_ns: From the edge on DIG I/O 0 to the count that CAPTURE holds.
        zero_count: Count at angle zero when the mission begins, for it was set up and the joint moved before; None: it
            begins with 0. A restart begins with 0.
        counting: Counts in a cycle of the encoder, of that earlier set-up: 1, 2 or 4.
        faults: What breaks.

    Raises:
        FaultError: a fault that the adapter cannot have.
    """

    _outside = frozenset({"input", "spurious"})

    def __init__(
        self,
        analog: ScalarAnalog,
        clock: ChipClock,
        start_ns: int,
        *,
        counts_per_revolution: int = 500_000,
        tick_ns: float = TICK_512_HZ,
        sync_input: bool = True,
        capture_latency_ns: int = 0,
        zero_count: int | None = None,
        counting: int = 4,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        kinds = (FaultKind.PULSE_DROP, FaultKind.PULSE_SPURIOUS, *ENCODER_KINDS, *CLOCK_KINDS)
        super().__init__(_FACTORY_LINE, start_ns, faults, kinds)
        self.produced = 0  # lines streamed by S0E
        self.captures = 0
        self.commands = 0
        self._analog = FaultyScalar(analog, faults, start_ns)
        self._clock: ChipClock = FaultyClock(clock, faults)
        self._steps_per_rad = counts_per_revolution / math.tau
        self._tick_ns = tick_ns
        self._inputs = 0xE if sync_input else 0xF
        self._capture_latency_ns = capture_latency_ns
        self._input_events: list[tuple[int, int]] = []  # heap of (time, level or _CAPTURE_NOW)
        self._saved: dict[int, int] = {}
        self._saved_line = _FACTORY_LINE
        self._dtr_line = True
        self._counter = QuadratureCounter(0)
        self._zero_count, self._counting = zero_count, counting
        self._clear_state()
        if any(w.kind is FaultKind.PULSE_SPURIOUS for w in faults.windows):
            self._spurious(start_ns)

    def dig_io(self, edge_ns: int, high_ns: int) -> None:
        """DIG I/O 0 goes high at ``edge_ns`` for ``high_ns``.

        Raises:
            ValueError: the adapter is past that instant; advance the source of the pulses first.
        """
        if edge_ns < self._until_ns:
            raise ValueError(
                f"DIG I/O 0 rose at {self._seconds(edge_ns):.6f} s and the adapter is at "
                f"{self._seconds(self._until_ns):.6f} s; advance the pulse source before the adapter."
            )
        if self._faults.active(FaultKind.PULSE_DROP, edge_ns) is None:
            self._add_pulse(edge_ns, high_ns)

    def drive_dtr(self, level: bool, now_ns: int) -> None:
        """The host's DTR line: high, low and high again restarts the adapter."""
        if level and not self._dtr_line and self.powered:
            self.restart(now_ns)
        self._dtr_line = level

    # Start-up

    def _power_up(self, now_ns: int) -> None:
        self._clear_state()
        position = self._position(now_ns)
        self._counter = QuadratureCounter(position)
        if self._zero_count is not None and now_ns == self._start_ns:
            self._counter.mdr0 = _FREE_RUNNING[self._counting]
            self._counter.count = (position * self._counting // 4 + self._zero_count) & 0xFFFF_FFFF
        for register, value in self._saved.items():
            self._store(register, value)
        self.line = self._saved_line
        self._stamp_zero_ns = self._clock.chip_ns(now_ns)
        self._arm_input_events()
        self._at("boot", now_ns + _BOOT_NS, self._boot)

    def _clear_state(self) -> None:
        self._ready = False
        self._register = dict(reg.FACTORY)
        self._capture = 0
        self._stamp_zero_ns = 0
        self._streams: dict[int, int] = {}  # register: value said last
        self._command = bytearray()
        self._line_free_ns = 0
        self._stream_from_chip_ns = 0

    def _boot(self, now_ns: int) -> None:
        self._ready = True
        self._say(_BANNER, now_ns)

    # Commands

    def _on_byte(self, byte: int, now_ns: int) -> None:
        if not self._ready:
            return
        if byte in b"\r\n":
            command, self._command = bytes(self._command), bytearray()
            if command:
                self._obey(command, now_ns)
        elif byte == 0x08:
            del self._command[-1:]
        elif len(self._command) < _LONGEST_COMMAND:
            self._command.append(byte)

    def _obey(self, command: bytes, now_ns: int) -> None:
        self.commands += 1
        try:
            text = command.decode("ascii")
            letter, register = text[0], int(_digits(text[1:3], 2, 2), 16)
            data = int(_digits(text[3:], 1, 8), 16) if text[3:] else None
            handler = {"R": self._read, "W": self._write, "S": self._stream}[letter]
        except (ValueError, KeyError):
            self._answer("e", 0, 0, now_ns)
            return
        if register not in reg.LARGEST and register not in reg.READ_ONLY:
            self._answer("x", register, data or 0, now_ns)
        else:
            handler(register, data, now_ns)

    def _read(self, register: int, data: int | None, now_ns: int) -> None:
        del data
        self._end_stream(register)
        self._answer("r", register, self._value(register, now_ns), now_ns)

    def _write(self, register: int, data: int | None, now_ns: int) -> None:
        if register in reg.READ_ONLY or data is None or data > reg.LARGEST[register]:
            self._answer("e", register, data or 0, now_ns)
            return
        line = self.line
        self._counter.follow(self._position(now_ns))
        accepted = self._command_register(data) if register == reg.COMMAND else self._act_on(register, data, now_ns)
        new_line, self.line = self.line, line
        self._answer("w" if accepted else "e", register, data, now_ns)
        self.line = new_line

    def _stream(self, register: int, data: int | None, now_ns: int) -> None:
        if register not in (reg.ENCODER, reg.CAPTURE, reg.STR, reg.DIGIO):
            self._answer("x", register, data or 0, now_ns)
            return
        value = self._value(register, now_ns)
        self._streams[register] = value
        self._answer("s", register, value, now_ns)
        if register == reg.ENCODER:
            self.produced += 1
            self._stream_from_chip_ns = self._clock.chip_ns(now_ns)
            self._arm_interval(now_ns)
        elif register == reg.STR:
            self._at("status", now_ns + _MEASUREMENT_NS, self._look_at_status)

    # Registers

    def _value(self, register: int, now_ns: int) -> int:
        self._counter.follow(self._position(now_ns))
        if register == reg.TIMESTAMP:
            return self._stamp(now_ns)
        return {
            reg.DIGIO: self._inputs,
            reg.MDR0: self._counter.mdr0,
            reg.MDR1: self._counter.mdr1,
            reg.CAPTURE: self._capture,
            reg.STR: self._counter.status,
            reg.OTR: self._counter.otr,
            reg.DTR: self._counter.dtr,
            reg.ENCODER: self._counter.count,
            reg.VERSION: _VERSION,
        }.get(register, self._register.get(register, 0))

    def _act_on(self, register: int, data: int, now_ns: int) -> bool:
        counter = self._counter
        if register == reg.TIMESTAMP:
            if data:
                self._stamp_zero_ns = self._clock.chip_ns(now_ns)
        elif register == reg.LOAD:
            if data:
                counter.otr = counter.count
            else:
                counter.load()
        elif register == reg.CLEAR:
            if data == 0:
                counter.mdr0 = 0
            elif data == 1:
                counter.mdr1 = 0
            elif data == 2:
                counter.clear()
            else:
                counter.clear_status()
        else:
            self._store(register, data)
            if register == reg.INTERVAL and reg.ENCODER in self._streams:
                self._stream_from_chip_ns = self._clock.chip_ns(now_ns)
                self._arm_interval(now_ns)
        return True

    def _store(self, register: int, data: int) -> None:
        if register == reg.MDR0:
            self._counter.mdr0 = data
        elif register == reg.MDR1:
            self._counter.mdr1 = data
        elif register == reg.DTR:
            self._counter.dtr = data
        else:
            self._register[register] = data

    def _command_register(self, data: int) -> bool:
        if data == reg.STOP_STREAMS:
            for register in tuple(self._streams):
                self._end_stream(register)
        elif data == reg.SAVE:
            counter = {reg.MDR0: self._counter.mdr0, reg.MDR1: self._counter.mdr1, reg.DTR: self._counter.dtr}
            self._saved = {register: (self._register | counter)[register] for register in reg.SAVED}
            self._saved_line = self.line
        elif data & 0xFF == reg.SET_BAUD_RATE and data >> 8 < len(reg.BAUD_RATES):
            self.line = LineFormat(reg.BAUD_RATES[data >> 8])
        else:
            return False
        return True

    def _stamp(self, now_ns: int) -> int:
        return int((self._clock.chip_ns(now_ns) - self._stamp_zero_ns) / self._tick_ns) & 0xFFFF_FFFF

    def _position(self, now_ns: int) -> int:
        """Quarter cycles that the encoder has turned."""
        return round(self._analog.value(self._seconds(now_ns)) * self._steps_per_rad)

    # Streams

    def _end_stream(self, register: int) -> None:
        self._streams.pop(register, None)
        if register == reg.ENCODER:
            self._stop("interval")
        elif register == reg.STR:
            self._stop("status")

    def _arm_interval(self, now_ns: int) -> None:
        interval = self._register[reg.INTERVAL]
        if interval == reg.NEVER_AGAIN:
            self._stop("interval")
        elif interval == 0:
            self._at("interval", max(now_ns + _MEASUREMENT_NS, self._line_free_ns - _MEASUREMENT_NS), self._measure)
        else:
            period_ns = interval * self._tick_ns
            elapsed = self._clock.chip_ns(now_ns) - self._stream_from_chip_ns
            due_chip_ns = self._stream_from_chip_ns + (int(elapsed / period_ns) + 1) * period_ns
            self._at("interval", max(self._clock.time_ns(round(due_chip_ns)), now_ns + 1), self._measure)

    def _measure(self, now_ns: int) -> None:
        if now_ns < self._line_free_ns - _MEASUREMENT_NS:
            self._at("interval", self._line_free_ns - _MEASUREMENT_NS, self._measure)
            return
        count = self._value(reg.ENCODER, now_ns)
        if _distance(count, self._streams[reg.ENCODER]) >= self._register[reg.THRESHOLD]:
            self._streams[reg.ENCODER] = count
            self.produced += 1
            self._answer("s", reg.ENCODER, count, now_ns)
        self._arm_interval(now_ns)

    def _look_at_status(self, now_ns: int) -> None:
        self._say_if_changed(reg.STR, now_ns)
        self._at("status", now_ns + _MEASUREMENT_NS, self._look_at_status)

    def _say_if_changed(self, register: int, now_ns: int) -> None:
        if self.powered and register in self._streams:
            value = self._value(register, now_ns)
            if value != self._streams[register]:
                self._streams[register] = value
                self._answer("s", register, value, now_ns)

    # Inputs

    def _add_pulse(self, edge_ns: int, high_ns: int) -> None:
        for event in ((edge_ns, 1), (edge_ns + high_ns, 0)):
            heapq.heappush(self._input_events, event)
        self._arm_input_events()

    def _arm_input_events(self) -> None:
        if self._input_events:
            self._at("input", self._input_events[0][0], self._input_event)

    def _input_event(self, now_ns: int) -> None:
        what = heapq.heappop(self._input_events)[1]
        if what == _CAPTURE_NOW:
            if self.powered:
                self._capture = self._value(reg.ENCODER, now_ns)
                self.captures += 1
                self._say_if_changed(reg.CAPTURE, now_ns)
        else:
            configuration = self._register[reg.DIGIO_CFG]
            falling = configuration & 0x01
            if self.powered and what != self._inputs & 1 and configuration & 0x10 and what != falling:
                heapq.heappush(self._input_events, (now_ns + self._capture_latency_ns, _CAPTURE_NOW))
            self._inputs = self._inputs & 0xE | what
            self._say_if_changed(reg.DIGIO, now_ns)
        self._arm_input_events()

    def _spurious(self, now_ns: int) -> None:
        for edge_ns in self._faults.spurious_edges(now_ns, now_ns + _LOOK_AHEAD_NS):
            self._add_pulse(edge_ns, _SPURIOUS_HIGH_NS)
        self._at("spurious", now_ns + _LOOK_AHEAD_NS, self._spurious)

    # Answers

    def _answer(self, letter: str, register: int, data: int, now_ns: int) -> None:
        eor = self._register[reg.EOR]
        fields = [letter, f"{register:02X}", f"{data:08X}"]
        if eor & reg.STAMP:
            fields.append(f"{self._stamp(now_ns):08X}")
        text = (" " if eor & reg.SPACES else "").join([*fields, "!"])
        text += ("\r" if eor & reg.CARRIAGE_RETURN else "") + ("\n" if eor & reg.LINE_FEED else "")
        self._say(text.encode("ascii"), now_ns + _MEASUREMENT_NS)

    def _say(self, text: bytes, ready_ns: int) -> None:
        self._line_free_ns = self._send(text, ready_ns)


def _digits(text: str, fewest: int, most: int) -> str:
    """``text`` if it is that many hexadecimal digits; ValueError if not."""
    if not fewest <= len(text) <= most or set(text) - set("0123456789abcdefABCDEF"):
        raise ValueError(text)
    return text


def _distance(count: int, other: int) -> int:
    """Between two 32-bit counts, the short way round."""
    apart = (count - other) & 0xFFFF_FFFF
    return min(apart, (1 << 32) - apart)
