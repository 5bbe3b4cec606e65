"""A six-axis force-torque sensor with a serial interface (Bota Systems), typed from the maker's example for Python.

=====  =========================================================================================
byte   of a frame, unasked, 460,800 baud 8N1
=====  =========================================================================================
0      AAh
1      status, u16: 1 leaves out measurements, 2 beyond the range, 4 invalid, 8 raw gauges
3      force x, y, z [N], moment x, y, z [N m], f32 each
27     us since power-up, u32
31     temperature [deg C], f32
35     CRC-16/X-25 of bytes 1 to 34, u16
=====  =========================================================================================

Little-endian. After power-up it says ``App Init`` and then runs with what is saved. Commands, with or without an end of
line: ``C`` configuration mode, which stops the frames; there ``c,TEMPERATURE,CALIBRATION,FORMAT,BAUD``,
``f,SINC,CHOP,FAST,NO_FIR`` (a period of 19.53125 us times SINC, 64 to 2048), ``s`` saves, ``R`` runs. Each is answered
``r,0,COMMAND,0``.

Where the sources are silent: it starts in half a second; a command that it cannot do is answered 1 in place of 0;
numbers as text, another speed, chopping and fast settling are not here and refused; the stamp is that of the sample.
"""

import re
import struct
from collections.abc import Mapping
from typing import Any, Final, Literal

from pydantic import PositiveFloat

from hil_sim.devices.emulator import Bench, Twin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.devices.wrist.components import ComponentEmulator, ComponentsTwin
from hil_sim.faults import FaultyScalar
from hil_sim.scenario.sensor_tables import NonNegative
from hil_sim.sensing.sensors import LoadCellSensor

_FRAME_BYTES: Final = 37
_CYCLE_NS: Final = 19_531.25
_BOOT_NS: Final = 500_000_000
_ANSWER_NS: Final = 1_000_000
_BEYOND, _RAW = 2, 8
_WHOLE: Final = re.compile(rb"[CRs]|c(,\d){4}|f,\d+(,\d){3}")
_SAVED: Final = (1, 512)  # calibration, sinc length


def _crc(data: bytes) -> int:
    """Bit by bit: x^16 + x^12 + x^5 + 1, lowest first, from all ones, inverted."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc ^ 0xFFFF


class BotaTwin(ComponentsTwin):
    """One sensor; see ``ComponentsTwin``."""

    comes_with = LineFormat(460_800)
    draws = 0x424F

    _was_asked = False  # by a client, to run
    _calibration, _sinc = _saved = _SAVED
    _powered_chip_ns = _next_chip_ns = 0

    def _power_up(self, now_ns: int) -> None:
        self._powered_chip_ns = self._clock.chip_ns(now_ns)
        self._calibration, self._sinc = self._saved
        self._heard, self._runs = b"", False
        self._at("boot", now_ns + _BOOT_NS, self._booted)

    def _booted(self, now_ns: int) -> None:
        self._run(self._send(b"App Init\r\n", now_ns))

    def _run(self, now_ns: int) -> None:
        self._runs, self._next_chip_ns = True, self._clock.chip_ns(now_ns)
        self._arm()

    def _arm(self) -> None:
        self._next_chip_ns += round(_CYCLE_NS * self._sinc)
        self._at("sample", self._clock.time_ns(self._next_chip_ns), self._sample)

    def _sample(self, now_ns: int) -> None:
        time_s, status, wrench = self._seconds(now_ns), 0 if self._calibration else _RAW, [0.0] * 6
        for component, (analog, most) in self._inputs.items():
            value = analog.value(time_s)
            status |= _BEYOND if abs(value) > most else 0
            wrench[component] = min(max(value, -most), most)
        own_us = (self._next_chip_ns - self._powered_chip_ns) // 1000 & 0xFFFF_FFFF
        content = struct.pack("<H6fIf", status, *wrench, own_us, 31.0 + 1e-3 * time_s)
        self._send(b"\xaa" + content + struct.pack("<H", _crc(content)), now_ns + self._latency.draw_ns())
        self.samples += self._was_asked
        self._arm()

    # Commands

    def _on_byte(self, byte: int, now_ns: int) -> None:
        letter = bytes([byte])
        if letter.isalpha():
            self._heard = b""
        self._heard += letter if not letter.isspace() else b""
        command = _WHOLE.fullmatch(self._heard)
        if command is None and not letter.isspace():
            return
        told, self._heard = self._heard, b""
        if told and (not self._runs or told == b"C"):
            code = 1 if command is None else self._obey(told, now_ns)
            self._send(b"r,0,%c,%d\r\n" % (told[0], code), now_ns + _ANSWER_NS)

    def _obey(self, told: bytes, now_ns: int) -> int:
        """Do it; returns the code of the answer."""
        numbers = [int(number) for number in told.split(b",")[1:]]
        if told == b"C":
            self._runs = False
            self._stop("sample")
        elif told == b"R":
            self._was_asked = True
            self._run(now_ns + _ANSWER_NS)
        elif told == b"s":
            self._saved = self._calibration, self._sinc
        elif told[:1] == b"c":
            if numbers[0] > 1 or numbers[1] > 1 or numbers[2:] != [0, 4]:
                return 1
            self._calibration = numbers[1]
        else:
            if not 64 <= numbers[0] <= 2048 or numbers[1:3] != [0, 0] or numbers[3] > 1:
                return 1
            self._sinc = numbers[0]
        return 0


class BotaFtTable(ComponentEmulator):
    """A component of the sensor."""

    baud_rates = (BotaTwin.comes_with.baud_rate,)

    kind: Literal["bota_ft"]
    range: PositiveFloat = 1e6  # N or N m
    latency_ms: NonNegative = 0.4
    temperature: bool = False  # whether it is recorded, as NAME_temperature; it is sent always

    @classmethod
    def further(cls, said: Mapping[str, Any]) -> dict[str, Any]:
        """See ``ComponentEmulator``."""
        return {**super().further(said), "temperature": said.get("temperature", False)}

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        felt = FaultyScalar(bench.sensor(LoadCellSensor), bench.faults, bench.start_ns)
        twin = BotaTwin(
            {self.component - 1: (felt, self.range)},
            bench.clock,
            bench.start_ns,
            line=bench.line,
            latency_ns=round(1e6 * self.latency_ms),
            seed=bench.seed,
            faults=bench.faults,
        )
        warm = [f"{bench.name}_temperature"] if self.temperature else []
        return Twin(
            twin, lambda: twin.produced, (bench.name, *warm), lambda data: len(data) // _FRAME_BYTES * _FRAME_BYTES
        )
