"""A weight transmitter on Modbus-RTU with the register map of the Laumas TLB (TLB protocols manual, Modbus section).

======  ==============================  ======  =================================
number  holding register                number  holding register
======  ==============================  ======  =================================
40001   firmware version                40014   unit (high byte), division (low)
40002   instrument type                 40015   coefficient, high and low word
40003   year of manufacture             40017   inputs
40004   serial number                   40018   outputs (rw)
40005   program type                    40019   three setpoints (rw, 2 words each)
40006   command (rw)                    40037   sample weight (rw, 2 words)
40007   status                          40039   three hystereses (rw, 2 words each)
40008   gross weight, high and low      40073   preset tare (rw, 2 words)
40010   net weight, high and low
40012   peak weight, high and low
======  ==============================  ======  =================================

On the wire a register has its number less 40001. Functions 3 and 16 only, at most 32 registers each. Exceptions: 1
other functions, 2 a register that is not there or must not be written, 3 a count or byte count that does not fit, or a
command that cannot be obeyed. Weights are magnitudes in units of the last decimal place; their signs are status bits 7
(gross), 8 (net) and 9 (peak). Others: 0 cell error, 2 over capacity by 9 divisions, 3 gross over 110 %, 4 and 5 gross
or net beyond 999999, 10 net mode, 11 stable, 12 within a quarter division of zero. ``signs_in_status=False`` is a
transmitter that writes signed words instead.

Commands: 7 tare, 8 zero (refused beyond 0.3 N), 9 gross, 99 save, 100 permanent zero, 130 preset tare. Tare
and zero are lost with the supply, setpoints and hystereses as well unless they were saved.

Framing is that of "Modbus over serial line" V1.02: a frame ends after 3.5 characters of silence (1.75 ms above 19,200
baud) and is void after a pause of more than 1.5 characters inside (0.75 ms). Left open by the manual: conversions at
300 Hz, stable is eight of them within two divisions; an answer begins ``reply_ns`` after the end of the request. Not
checked against the manual's pages: status bit 9, and the codes of unit and division.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from hil_sim.devices.emulator import FORCES, Bench, Equivalent, MeasuringEmulator, Twin
from hil_sim.devices.serial_line.sampled_scalar import SampledScalar
from hil_sim.devices.serial_line.serial_twin import POLLED_KINDS, SerialTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import NO_FAULTS, DeviceFaults, FaultyScalar
from hil_sim.scenario.sensor_tables import NonNegative
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ChipClock, ScalarAnalog
from hil_sim.sensing.sensors import LoadCellSensor

DIVISIONS: Final = (
    *(100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1),
    *(0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001),
)  # by the low byte of 40014
UNIT_NEWTON: Final = 4  # high byte of 40014

_READ, _WRITE = 0x03, 0x10
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE = 1, 2, 3
_MOST_REGISTERS: Final = 32
_LONGEST_FRAME: Final = 256
_COMMAND, _STATUS, _GROSS, _NET, _PEAK, _DIVISION, _OUTPUTS = 5, 6, 7, 9, 11, 13, 17
_SETPOINTS, _SAMPLE_WEIGHT, _HYSTERESES, _PRESET_TARE = range(18, 24), range(36, 38), range(38, 44), range(72, 74)
_WRITABLE: Final = {_COMMAND, _OUTPUTS, *_SETPOINTS, *_SAMPLE_WEIGHT, *_HYSTERESES, *_PRESET_TARE}
_PRESENT: Final = {*range(18), *_WRITABLE}
_IDENTITY: Final = {0: 103, 1: 13, 2: 2019, 3: 4071, 4: 1}  # firmware, type, year, serial number, program
_TARE, _ZERO, _SHOW_GROSS, _SAVE, _PERMANENT_ZERO, _TAKE_PRESET_TARE = 7, 8, 9, 99, 100, 130
_LARGEST_SHOWN: Final = 999_999
_CONVERTER_RANGE: Final = 1.2  # times the capacity
_CONVERSIONS_HZ: Final = 300.0
_STABLE_CONVERSIONS: Final = 8
_ZERO_RANGE_N: Final = 0.3  # largest gross weight that command 8 takes away
_CHORE_NS: Final = 100_000_000
_FAST_BAUD_RATE: Final = 19_200  # above it the silences are fixed
_CRC_POLYNOMIAL: Final = 0xA001  # x^16 + x^15 + x^2 + 1, reflected


def crc16(data: bytes) -> bytes:
    """The two bytes that end an RTU frame."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _CRC_OF[(crc ^ byte) & 0xFF]
    return crc.to_bytes(2, "little")


def _divided(crc: int) -> int:
    """What eight bits leave, shifted out on the right."""
    for _ in range(8):
        crc = crc >> 1 ^ (_CRC_POLYNOMIAL if crc & 1 else 0)
    return crc


_CRC_OF: Final = tuple(_divided(byte) for byte in range(256))


class _RefusalError(Exception):
    def __init__(self, code: int) -> None:
        super().__init__(f"Modbus exception {code}")
        self.code = code


class ModbusLoadCellTwin(SerialTwin):
    """One transmitter with its cell.

    Args:
        analog: Force on the cell as the converter sees it, N.
        clock: The transmitter's oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        station: Its Modbus address, 1 to 247.
        line: Speed and format.
        capacity_n: Full scale, N.
        division: Index into ``DIVISIONS``; 15 is 1 mN.
        signs_in_status: Whether weights are magnitudes with their signs in 40007.
        boot_ns: From power-up to the first answer.
        reply_ns: From the end of a request to its answer.
        faults: What breaks.

    Raises:
        FaultError: a fault that the transmitter cannot have.
        ValueError: a station out of range.
    """

    def __init__(
        self,
        analog: ScalarAnalog,
        clock: ChipClock,
        start_ns: int,
        *,
        station: int = 1,
        line: LineFormat = LineFormat(115_200),  # noqa: B008  (a constant)
        capacity_n: float = 50.0,
        division: int = 15,
        signs_in_status: bool = True,
        boot_ns: int = 500_000_000,
        reply_ns: int = 500_000,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        super().__init__(line, start_ns, faults, POLLED_KINDS)
        if not 1 <= station <= 247:
            raise ValueError(f"Modbus address {station} is not 1 to 247.")
        self.produced = 0  # weights read
        self.bad_frames = 0
        self._cell = SampledScalar(FaultyScalar(analog, faults, start_ns), clock, start_ns, _CONVERSIONS_HZ)
        self._station = station
        self._capacity_n = capacity_n
        self._division_code = division
        self._division_n = DIVISIONS[division]
        self._decimals = max(0, -math.floor(math.log10(self._division_n)))
        self._signs_in_status = signs_in_status
        self._boot_ns = boot_ns
        self._reply_ns = reply_ns
        self._permanent_zero_n = 0.0
        self._saved: dict[int, int] = {}
        self._clear_state()

    # Start-up and conversions

    def _power_up(self, now_ns: int) -> None:
        self._clear_state()
        self._cell.power_up(now_ns)
        self._at("boot", now_ns + self._boot_ns, self._boot)
        self._at("chores", now_ns + _CHORE_NS, self._chores)

    def _clear_state(self) -> None:
        self._ready = False
        self._stored = dict(self._saved)
        self._zero_n = self._tare_n = 0.0
        self._net_mode = False
        self._peak_n = -math.inf
        self._recent: deque[float] = deque(maxlen=_STABLE_CONVERSIONS)
        self._frame = bytearray()
        self._frame_void = False
        self._last_byte_ns = self._frame_end_ns = 0

    def _boot(self, now_ns: int) -> None:
        del now_ns
        self._ready = True

    def _chores(self, now_ns: int) -> None:
        self._convert(now_ns)
        self._at("chores", now_ns + _CHORE_NS, self._chores)

    def _convert(self, now_ns: int) -> None:
        limit_n = _CONVERTER_RANGE * self._capacity_n
        made = [min(max(sample, -limit_n), limit_n) for sample in self._cell.settle(now_ns)]
        if made:
            self._recent.extend(made)
            self._peak_n = max(self._peak_n, *made)

    # Framing

    def _on_byte(self, byte: int, now_ns: int) -> None:
        if not self._ready:
            return
        character_ns = self.line.character_ns
        fast = self.line.baud_rate > _FAST_BAUD_RATE
        self._frame_end_ns = now_ns + (1_750_000 if fast else round(3.5 * character_ns))
        if not self._frame:
            self._at("silence", self._frame_end_ns, self._end_of_frame)
        elif now_ns - self._last_byte_ns > character_ns + (750_000 if fast else 1.5 * character_ns):
            self._frame_void = True
        self._last_byte_ns = now_ns
        self._frame.append(byte)

    def _end_of_frame(self, now_ns: int) -> None:
        if now_ns < self._frame_end_ns:  # more bytes came after the first
            self._at("silence", self._frame_end_ns, self._end_of_frame)
            return
        frame, void = bytes(self._frame), self._frame_void
        self._frame.clear()
        self._frame_void = False
        if void or not 4 <= len(frame) <= _LONGEST_FRAME or crc16(frame[:-2]) != frame[-2:]:
            self.bad_frames += 1
            return
        if frame[0] not in (0, self._station):
            return
        self._convert(now_ns)
        function = frame[1]
        try:
            answer = self._obey(function, frame[2:-2])
        except _RefusalError as refusal:
            function |= 0x80
            answer = bytes([refusal.code])
        if frame[0]:
            reply = bytes([self._station, function]) + answer
            self._send(reply + crc16(reply), self._late(now_ns + self._reply_ns))

    def _obey(self, function: int, body: bytes) -> bytes:
        if function not in (_READ, _WRITE):
            raise _RefusalError(_ILLEGAL_FUNCTION)
        first, count = int.from_bytes(body[0:2], "big"), int.from_bytes(body[2:4], "big")
        if len(body) < 4 or not 1 <= count <= _MOST_REGISTERS:
            raise _RefusalError(_ILLEGAL_VALUE)
        addresses = range(first, first + count)
        if function == _READ:
            if len(body) != 4:
                raise _RefusalError(_ILLEGAL_VALUE)
            if not _PRESENT.issuperset(addresses):
                raise _RefusalError(_ILLEGAL_ADDRESS)
            registers = self._registers()
            self.produced += _GROSS in addresses or _NET in addresses
            return bytes([2 * count]) + b"".join(registers.get(at, 0).to_bytes(2, "big") for at in addresses)
        if len(body) != 5 + 2 * count or body[4] != 2 * count:
            raise _RefusalError(_ILLEGAL_VALUE)
        if not _WRITABLE.issuperset(addresses):
            raise _RefusalError(_ILLEGAL_ADDRESS)
        for k, address in enumerate(addresses):
            self._write(address, int.from_bytes(body[5 + 2 * k : 7 + 2 * k], "big"))
        return body[:4]

    # Registers

    def _registers(self) -> dict[int, int]:
        gross_n = self._gross_n()
        weights = {_GROSS: gross_n, _NET: gross_n - self._tare_n, _PEAK: self._peak_n - self._offset_n()}
        shown = {address: self._shown(weight_n) for address, weight_n in weights.items()}
        registers = {**_IDENTITY, **self._stored, _STATUS: self._status(weights, shown)}
        for address, word in shown.items():
            word = abs(word) if self._signs_in_status else word & 0xFFFF_FFFF  # noqa: PLW2901
            registers[address], registers[address + 1] = word >> 16, word & 0xFFFF
        registers[_DIVISION] = UNIT_NEWTON << 8 | self._division_code
        return registers

    def _status(self, weights: dict[int, float], shown: dict[int, int]) -> int:
        gross_n = weights[_GROSS]
        signs = self._signs_in_status
        bits = {
            2: gross_n > self._capacity_n + 9 * self._division_n,
            3: gross_n > 1.1 * self._capacity_n,
            4: abs(shown[_GROSS]) >= _LARGEST_SHOWN,
            5: abs(shown[_NET]) >= _LARGEST_SHOWN,
            7: signs and shown[_GROSS] < 0,
            8: signs and shown[_NET] < 0,
            9: signs and shown[_PEAK] < 0,
            10: self._net_mode,
            11: max(self._recent) - min(self._recent) <= 2 * self._division_n,
            12: abs(gross_n) <= self._division_n / 4,
        }
        return sum(1 << bit for bit, is_set in bits.items() if is_set)

    def _offset_n(self) -> float:
        return self._permanent_zero_n + self._zero_n

    def _gross_n(self) -> float:
        return self._recent[-1] - self._offset_n()

    def _shown(self, weight_n: float) -> int:
        """The weight rounded to a division, without its decimal point."""
        divisions = round(weight_n / self._division_n)
        shown = round(divisions * self._division_n * 10.0**self._decimals)
        return min(max(shown, -_LARGEST_SHOWN), _LARGEST_SHOWN)

    def _write(self, address: int, value: int) -> None:
        if address == _COMMAND:
            self._command(value)
        else:
            self._stored[address] = value

    def _command(self, command: int) -> None:
        gross_n = self._gross_n()
        if command == _TARE and self._shown(gross_n):
            self._tare_n, self._net_mode = gross_n, True
        elif command == _ZERO and abs(gross_n) <= _ZERO_RANGE_N:
            self._zero_n += gross_n
        elif command == _PERMANENT_ZERO:
            self._permanent_zero_n += self._zero_n + gross_n
            self._zero_n = 0.0
        elif command == _SHOW_GROSS:
            self._tare_n, self._net_mode = 0.0, False
        elif command == _TAKE_PRESET_TARE:
            high, low = (self._stored.get(at, 0) for at in _PRESET_TARE)
            self._tare_n, self._net_mode = (high << 16 | low) / 10.0**self._decimals, True
        elif command == _SAVE:
            self._saved = {at: v for at, v in self._stored.items() if at in (*_SETPOINTS, *_HYSTERESES)}
        elif command:
            raise _RefusalError(_ILLEGAL_VALUE)


class ModbusLoadCellTable(MeasuringEmulator):
    """A transmitter with the Laumas map; ``signs_in_status``: magnitudes, and their signs in the status word."""

    quantities = FORCES

    kind: Literal["modbus_load_cell"]
    station: Annotated[int, Field(ge=1, le=247)] = 1
    division_code: Annotated[int, Field(ge=0, le=18)] = 15  # 1 mN
    signs_in_status: bool = True
    reply_ms: NonNegative = 0.5

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``: the division nearest to the file's ``scale``, in newtons."""
        division = said.get("scale", 1e-3)
        table = {
            "station": said.get("address", 1),
            "division_code": min(range(len(DIVISIONS)), key=lambda code: abs(DIVISIONS[code] - division)),
            "signs_in_status": said.get("sign", "status") == "status",
            "measures": name,
            "at": said["frame"],
        }
        return Equivalent(table, {name: sheets.load_cell(said)}, {name: "converter"})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        cell = bench.sensor(LoadCellSensor)
        twin = ModbusLoadCellTwin(
            cell,
            bench.clock,
            bench.start_ns,
            station=self.station,
            line=bench.line,
            capacity_n=cell.capacity_N,
            division=self.division_code,
            signs_in_status=self.signs_in_status,
            reply_ns=round(self.reply_ms * 1e6),
            faults=bench.faults,
        )
        return Twin(twin, lambda: twin.produced, (bench.name,))
