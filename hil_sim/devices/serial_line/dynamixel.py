"""A DYNAMIXEL X servo on a TTL or RS-485 line, protocol 2.0 (ROBOTIS e-manual: protocol 2.0, CRC, XM430-W350).

Instructions: Ping, Read, Write, Reboot, Sync Read (82h), Sync Write (83h), Fast Sync Read (8Ah, where the firmware has
it). Others are answered by error 2. EEPROM (below 64) is kept without supply, and written with the torque off only.

======================  ==========================================================================================
address (bytes)         here
======================  ==========================================================================================
0 (2), 6, 7             model, firmware, ID
8, 9                    baud rate (0 to 7), return delay of 2 us each
10, 11, 20 (4)          drive mode, operating mode (3, 4), homing offset, without effect
31, 63                  temperature limit, shutdown
44, 48, 52 (4 each)     limits of velocity, and of position in mode 3
64, 65, 68              torque enable (on from the start: an arm that moves is driven), LED, status return level
70                      hardware error status: 1 voltage, 4 heat, 8 encoder, 10h shock, 20h overload; till a reboot
84 (2), 98              position P gain; bus watchdog
108, 112, 116 (4 each)  profile acceleration, velocity; goal position: without effect where the plant moves the arm
123                     moving status: 1 in position, 2 on the way
120 (2)                 ms since power-up, modulo 32768
126 (2)                 present current, 2.69 mA; 0 with the torque off
128 (4), 132 (4)        present velocity, 0.229 rev/min; present position, 4096 a revolution, in the first at power-up
144 (2), 146            input voltage, 0.1 V; temperature, C
======================  ==========================================================================================

Where the manual is silent: what is read is what is measured as the servo begins to answer; velocity is the mean of the
last 20 ms; the position has a noise of 0.03 degrees rms (AS5045); in Sync Reads each waits for the one named before it,
for as long as that is silent; a broadcast Ping is answered after 3 ms for each ID below; other addresses read 0; a
packet of more than 512 bytes, or with a pause of more than 100 ms inside, is void.
"""

import math
import struct
from typing import Final

import numpy as np

from hil_sim.devices.serial_line.serial_twin import SerialTwin
from hil_sim.devices.serial_wire import Heard, LineFormat
from hil_sim.faults import ENCODER_KINDS, NO_FAULTS, DeviceFaults, FaultKind, FaultyScalar
from hil_sim.sensing.analog import ScalarAnalog

BAUD_RATES: Final = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
_HEADER: Final = b"\xff\xff\xfd\x00"
_EVERYBODY: Final = 0xFE
_PING, _READ, _WRITE, _REBOOT, _STATUS, _SYNC_READ, _FAST_SYNC_READ = 0x01, 0x02, 0x03, 0x08, 0x55, 0x82, 0x8A
_SYNC_WRITE: Final = 0x83
_NO_INSTRUCTION, _BAD_CRC, _OUT_OF_RANGE, _BAD_LENGTH, _NO_ACCESS = 2, 3, 4, 5, 7
_ALERT: Final = 0x80
_TABLE_BYTES: Final = 662
_EEPROM_BYTES: Final = 64
_WRITABLE: Final = {  # bytes, lowest and highest value
    **{7: (1, 0, 252), 8: (1, 0, 7), 9: (1, 0, 254), 31: (1, 0, 100), 63: (1, 0, 255)},
    **{10: (1, 0, 13), 11: (1, 3, 4), 20: (4, -1_044_479, 1_044_479), 44: (4, 0, 1023)},
    **{48: (4, 0, 4095), 52: (4, 0, 4095), 64: (1, 0, 1), 65: (1, 0, 1), 68: (1, 0, 2), 84: (2, 0, 16_383)},
    **{98: (1, 0, 127), 108: (4, 0, 32_767), 112: (4, 0, 32_767), 116: (4, -1_048_575, 1_048_575)},
}
_FAST_FROM: Final = 45
COUNTS: Final = 4096
_NOISE_COUNTS: Final = 0.03 / 360.0 * COUNTS
_WINDOW_S: Final = 0.02
_VELOCITY_RAD_S: Final = 0.229 * math.tau / 60.0
_HEAT, _OVERLOAD = 0x04, 0x20
_BOOT_NS: Final = 400_000_000
_LONGEST_BYTES, _LONGEST_PAUSE_NS = 512, 100_000_000
_HEAD_BYTES: Final = 7  # of a packet: header, ID, length
_TOO_LONG: Final = bytes([_LONGEST_BYTES >> 8])  # higher byte of a length


def crc(data: bytes) -> bytes:
    """The two bytes that end a packet: x^16 + x^15 + x^2 + 1, not reflected, from 0."""
    value = 0
    for byte in data:
        value = (value << 8 & 0xFF00) ^ _CRC_OF[value >> 8 ^ byte]
    return struct.pack("<H", value)


def _divided(value: int) -> int:
    """What eight bits leave, shifted out on the left."""
    for _ in range(8):
        value = value << 1 ^ (0x18005 if value & 0x8000 else 0)
    return value


_CRC_OF: Final = tuple(_divided(byte << 8) for byte in range(256))


def asks(message: bytes) -> int:
    """How often the flight computer asks for a sample of each servo: packets may come together after a pause."""
    packets = message.split(b"\xff\xff\xfd\x00")[1:]  # within a packet these bytes are stuffed
    return sum(packet[3:4] in (bytes([_SYNC_READ]), bytes([_FAST_SYNC_READ])) for packet in packets)


class DynamixelTwin(SerialTwin):
    """One servo, an XM430-W350.

    Args:
        angle: Of the horn, rad.
        torque: Of the servo on its horn, N m.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        identifier: Its ID.
        turns: Of the horn in one of ``angle``.
        zero_count: Present position at angle 0.
        torque_n_m_a: Torque of an ampere.
        firmware: 45 has Fast Sync Read.
        return_delay: Of 2 us each.
        line: Speed; one of ``BAUD_RATES``.
        seed: Of its noise.
        faults: What breaks; ``trip``: hardware error ``value``, 0: overload.

    Raises:
        FaultError: a fault that it cannot have.
        ValueError: an ID or a speed that it cannot have.
    """

    _outside = frozenset({"trip"})

    def __init__(
        self,
        angle: ScalarAnalog,
        torque: ScalarAnalog,
        start_ns: int,
        *,
        identifier: int = 1,
        turns: float = 1.0,
        zero_count: int = 2048,
        torque_n_m_a: float = 1.78,
        firmware: int = 45,
        return_delay: int = 250,
        line: LineFormat = LineFormat(1_000_000),  # noqa: B008  (a constant)
        seed: int = 0,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        if not 0 <= identifier <= 252 or line.baud_rate not in BAUD_RATES:
            raise ValueError(f"ID {identifier} at {line.baud_rate} bit/s: it has 0 to 252, at {BAUD_RATES}.")
        self._angle, self._torque = FaultyScalar(angle, faults, start_ns), FaultyScalar(torque, faults, start_ns)
        self._turns, self._zero, self._torque_n_m_a, self._seed = turns, zero_count, torque_n_m_a, seed
        self.memory = bytearray(_TABLE_BYTES)
        self.memory[:14] = struct.pack("<HIBBBBBBBB", 1020, 0, firmware, identifier, 0, return_delay, 0, 3, 255, 2)
        self.memory[8] = BAUD_RATES.index(line.baud_rate)
        self.memory[31], self.memory[63] = 80, 0x34
        struct.pack_into("<III", self.memory, 44, 200, COUNTS - 1, 0)
        self._frame = bytearray()
        self._turn: int | None = None  # counts taken off, so that it began in the first revolution
        self._before: tuple[int, int, int, int] = 0, 0, 0, 0  # instruction, ID before it in a Sync Read; address, count
        self._heard, self._said = b"", 0  # of a Fast Sync Read's packet: what others said, and how much
        self._ready_ns = self._up_ns = self._byte_ns = start_ns
        self.answered = 0
        super().__init__(line, start_ns, faults, (FaultKind.SLOW, FaultKind.TRIP, *ENCODER_KINDS))
        self._trips = [window for window in faults.windows if window.kind is FaultKind.TRIP][::-1]
        self._next_trip()

    def _power_up(self, now_ns: int) -> None:
        self.memory[_EEPROM_BYTES:] = bytes(_TABLE_BYTES - _EEPROM_BYTES)
        self.memory[64], self.memory[68] = 1, 2
        self._frame.clear()
        self._before = 0, 0, 0, 0
        self._turn = None
        self._ready_ns = now_ns if now_ns == self._start_ns else now_ns + _BOOT_NS
        self._up_ns = now_ns

    def _next_trip(self) -> None:
        if self._trips:
            self._at("trip", self._trips[-1].start_ns, self._trip)

    def _trip(self, now_ns: int) -> None:
        bits = int(self._trips.pop().value) & 0xFF or _OVERLOAD
        if self.powered:
            self.memory[70] |= bits
            if bits & self.memory[63]:
                self.memory[64] = 0
        self._next_trip()

    # Packets

    @property
    def lacks(self) -> int:
        """Characters, at least, to the end of a packet."""
        frame = self._frame
        if len(frame) < _HEAD_BYTES:
            return _HEAD_BYTES - len(frame)
        return _HEAD_BYTES + int.from_bytes(frame[5:7], "little") - len(frame)

    def gather(self, characters: list[Heard]) -> None:
        """As :meth:`receive` of each: none of them ends a packet."""
        frame, last_ns = self._frame + bytes([one.byte for one in characters]), characters[-1].end_ns
        listens = not self._is_faulty and characters[0].end_ns >= self._ready_ns
        on_time = last_ns <= self._byte_ns + _LONGEST_PAUSE_NS
        if listens and on_time and _HEADER.startswith(frame[:4]) and frame[6:7] < _TOO_LONG:
            self._frame, self._byte_ns = frame, last_ns
            return
        for one in characters:
            self.receive(one.byte, one.end_ns)

    def _on_byte(self, byte: int, now_ns: int) -> None:
        if now_ns < self._ready_ns:
            return
        frame = self._frame
        if now_ns > self._byte_ns + _LONGEST_PAUSE_NS:
            frame.clear()
        self._byte_ns = now_ns
        frame.append(byte)
        if len(frame) <= _HEAD_BYTES:  # of a longer one it has been looked at
            while frame and not (_HEADER.startswith(frame[:4]) and frame[6:7] < _TOO_LONG):
                del frame[0]
        if len(frame) < _HEAD_BYTES or len(frame) < _HEAD_BYTES + int.from_bytes(frame[5:7], "little"):
            return
        packet = bytes(frame)
        frame.clear()
        self._stop("answer")
        self._before = 0, 0, 0, 0
        if len(packet) < 10 or crc(packet[:-2]) != packet[-2:]:
            if packet[4] == self.memory[7]:
                self._answer_later(_BAD_CRC, b"", now_ns)
            return
        body = packet[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        self._heard_instruction(now_ns)
        if packet[4] in (self.memory[7], _EVERYBODY):
            self._obey(body[0], body[1:], packet[4] == _EVERYBODY, now_ns)

    def _obey(self, instruction: int, content: bytes, everybody: bool, now_ns: int) -> None:
        level = self.memory[68]
        if instruction == _PING:
            wait_ns = 3_000_000 * self.memory[7] if everybody else 0
            self._answer_later(0, bytes(self.memory[0:2] + self.memory[6:7]), now_ns + wait_ns)
        elif instruction in (_SYNC_READ, _FAST_SYNC_READ):
            if everybody and level and (instruction == _SYNC_READ or self.memory[6] >= _FAST_FROM):
                self._take_turn(instruction, content, now_ns)
        elif instruction == _SYNC_WRITE:
            if everybody and len(content) > 4:
                self._take_block(content, now_ns)
        elif not everybody and instruction == _READ:
            if level and len(content) == 4:
                address, count = struct.unpack("<HH", content)
                self._at("answer", self._due(now_ns), lambda t: self._answer_read(address, count, t))
        elif not everybody:
            error = _NO_INSTRUCTION
            if instruction == _WRITE and len(content) >= 3:
                error = self.write(int.from_bytes(content[:2], "little"), content[2:], now_ns)
            elif instruction == _REBOOT:
                error = 0
            if level == 2:
                self._answer_later(error, b"", now_ns)
            if instruction == _REBOOT:
                self._at("reboot", self._due(now_ns) + 2_000_000, self.restart)

    def _take_block(self, content: bytes, now_ns: int) -> None:
        """Its part of a Sync Write."""
        address, count = struct.unpack("<HH", content[:4])
        for at in range(4, len(content), 1 + count):
            if content[at] == self.memory[7]:
                self.write(address, content[at + 1 : at + 1 + count], now_ns)

    def write(self, address: int, data: bytes, now_ns: int) -> int:
        """As an instruction writes: the error number; nothing is written where a part of it cannot be."""
        values = {}
        while data:
            size, lowest, highest = _WRITABLE.get(address, (0, 0, 0))
            if not size or (address < _EEPROM_BYTES and self.memory[64]):
                return _NO_ACCESS
            if len(data) < size:
                return _BAD_LENGTH
            value = int.from_bytes(data[:size], "little", signed=lowest < 0)
            if not lowest <= value <= highest:
                return _OUT_OF_RANGE
            if error := self.refuses(address, value):
                return error
            values[address] = data[:size]
            address, data = address + size, data[size:]
        for at, one in values.items():
            self.memory[at : at + len(one)] = one
            self.changed(at, now_ns)
        self.line = LineFormat(BAUD_RATES[self.memory[8]])
        return 0

    def _heard_instruction(self, now_ns: int) -> None:
        """An instruction packet, to whomever. Subclasses with a watchdog override."""

    def refuses(self, address: int, value: int) -> int:
        """Error number of a value that is in its range, and not taken now."""
        del address, value
        return 0

    def changed(self, address: int, now_ns: int) -> None:
        """A register was written. Subclasses that move override."""

    # Answers

    def _due(self, now_ns: int) -> int:
        return self._late(now_ns + 2_000 * self.memory[9])

    def _answer_later(self, error: int, data: bytes, now_ns: int) -> None:
        self._at("answer", self._due(now_ns), lambda t: self.answer(error, data, t))

    def answer(self, error: int, data: bytes, now_ns: int) -> None:
        """Send a status packet; ``data``: its parameters."""
        body = (bytes([_STATUS, error | self._alert]) + data).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet = _HEADER + bytes([self.memory[7]]) + struct.pack("<H", len(body) + 2) + body
        self.answered += 1
        self._send(packet + crc(packet), now_ns)

    def _answer_read(self, address: int, count: int, now_ns: int) -> None:
        data = self.read(address, count, now_ns)
        self.answer(0 if data else _NO_ACCESS, data, now_ns)

    def _answer_fast(self, address: int, count: int, now_ns: int) -> None:
        """Its part of the packet that servos make together; without stuffing."""
        block = bytes([self._alert, self.memory[7]]) + self.read(address, count, now_ns).ljust(count, b"\0")
        self.answered += 1
        self._send((self._heard + block + crc(self._heard + block))[self._said :], now_ns)

    def _take_turn(self, instruction: int, content: bytes, now_ns: int) -> None:
        """In Sync Reads each answers after the one before it in the list."""
        address, count = struct.unpack("<HH", content[:4])
        place = content.find(self.memory[7], 4)
        if place < 0 or len(content) < 5:
            return
        fast, servos = instruction == _FAST_SYNC_READ, len(content) - 4
        head = _HEADER + bytes([_EVERYBODY]) + struct.pack("<HB", 1 + servos * (count + 4), _STATUS)
        self._heard, self._said = b"", 0
        if place > 4:
            self._before = instruction, content[place - 1], address, count
        elif fast:
            self._heard = head
            self._at("answer", self._due(now_ns), lambda t: self._answer_fast(address, count, t))
        else:
            self._at("answer", self._due(now_ns), lambda t: self._answer_read(address, count, t))

    def overhear(self, data: bytes, end_ns: int) -> None:
        """Another servo on the line sends; see ``hil_sim.buses.serial_bus.Listens``."""
        instruction, before, address, count = self._before
        if not instruction or not self.powered or self._is_silent(end_ns):
            return
        if instruction == _SYNC_READ:
            if data[4] == before:
                self._at("answer", self._due(end_ns), lambda t: self._answer_read(address, count, t))
            return
        self._heard += data
        self._said = len(self._heard)
        if data[-(count + 3)] == before:
            self._at("answer", self._late(end_ns), lambda t: self._answer_fast(address, count, t))

    # Measurements

    @property
    def _alert(self) -> int:
        return _ALERT if self.memory[70] else 0

    def read(self, address: int, count: int, now_ns: int) -> bytes:
        """Bytes of the control table; none where a part lies beyond it."""
        if not count or address + count > _TABLE_BYTES:
            return b""
        if address <= 146 and address + count > 120:
            self.measure(now_ns)
        return bytes(self.memory[address : address + count])

    def measure(self, now_ns: int) -> None:
        """Put what it measures now into the control table."""
        time_s = self._seconds(now_ns)
        angle = self._angle.value(time_s)
        began_s = max(time_s - _WINDOW_S, self._seconds(self._up_ns))
        rate = 0.0
        if time_s > began_s and self._faults.within(now_ns, *ENCODER_KINDS) is None:
            rate = self._turns * (angle - self._angle.value(began_s)) / (time_s - began_s)
        rng = np.random.default_rng([self._seed, 0x5045, int(time_s * 1e3)])
        counts = round(COUNTS * self._turns * angle / math.tau + _NOISE_COUNTS * rng.standard_normal()) + self._zero
        if self._turn is None:
            self._turn = counts // COUNTS * COUNTS
        amperes = self._torque.value(time_s) / self._turns / self._torque_n_m_a if self.memory[64] else 0.0
        current = min(max(round(amperes / 2.69e-3), -32768), 32767)
        struct.pack_into("<H", self.memory, 120, int((now_ns - self._up_ns) // 1_000_000) % 32768)
        struct.pack_into("<hii", self.memory, 126, current, round(rate / _VELOCITY_RAD_S), counts - self._turn)
        struct.pack_into("<HB", self.memory, 144, 120, 81 if self.memory[70] & _HEAT else 38)
