"""A six-axis force-torque sensor with a serial interface (Robotous RFT), typed from its manual, revision 1.8.

========  ==============================================================================================================
command   55h, 8 bytes (number, parameters), low byte of their sum, AAh; 115,200 baud 8N1 as it comes
response  55h, 16 bytes (number of the command, contents), low byte of their sum, AAh
========  ==============================================================================================================

Numbers: 1 model, 2 serial number, 3 firmware, 15 characters each; 6 sets, 7 reads the speed; 8 sets, 9 reads the
filter (type 0 or 1, cut-off 0 to 14); 10 a sample; 11 starts, 12 stops samples, 12 unanswered; 15 sets, 16 reads the
output rate (0 to 8: 200, 10, 20, 50, 100, 200, 333, 500, 1000 Hz); 17 bias, unanswered; 18 counts of overloads. What
sets is answered 1, 0 where it is done, else 0 and 1 (not supported), 2 (out of range). While it sends samples it takes
12 and 17 alone. A sample: Fx Fy Fz Tx Ty Tz, int16, high byte first, 50 a newton, 2000 or 1000 a newton metre; then the
overload byte, bit 5 for Fx to bit 0 for Tz, beyond 120 % of the rating. Rate and filter survive without power.

Where the sources are silent: it listens as soon as it has power and answers after 1 ms; another speed is not here and
refused; its filter is stored and reported, and does nothing; serial number and firmware are inventions.
"""

import struct
from collections import Counter
from collections.abc import Mapping
from typing import Any, Final, Literal

from pydantic import PositiveFloat

from hil_sim.devices.emulator import Bench, Twin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.devices.wrist.components import ComponentEmulator, ComponentsTwin
from hil_sim.faults import FaultKind, FaultyScalar
from hil_sim.scenario.sensor_tables import NonNegative
from hil_sim.sensing.analog import ChipClock, ScalarAnalog
from hil_sim.sensing.sensors import LoadCellSensor

_BAUDS: Final = (57_600, 115_200, 230_400, 460_800, 921_600)
_PERIODS_NS: Final = tuple(1e9 / hz for hz in (200, 10, 20, 50, 100, 200, 1000 / 3, 500, 1000))
_ANSWER_NS: Final = 1_000_000
_COMMAND_BYTES, _RESPONSE_BYTES = 11, 19
_OVERLOAD: Final = 1.2
_START, _STOP, _BIAS = 11, 12, 17


class RftTwin(ComponentsTwin):
    """One sensor; see ``ComponentsTwin``.

    Args:
        torque_counts: Of a newton metre: of its model.
    """

    comes_with = LineFormat(_BAUDS[1])
    draws = 0x5254
    clock_kinds = (FaultKind.SLOW,)  # it tells no time

    def __init__(
        self,
        inputs: Mapping[int, tuple[ScalarAnalog, float]],
        clock: ChipClock,
        start_ns: int,
        *,
        torque_counts: float = 2000.0,
        **options: Any,
    ) -> None:
        super().__init__(inputs, clock, start_ns, **options)
        self._torque_counts = torque_counts
        self.rate, self.filter = 0, (0, 0)  # stored
        self._next_chip_ns = 0.0
        self._bias = [0.0] * 6
        self._overloads: Counter[int] = Counter()

    def _power_up(self, now_ns: int) -> None:
        self._heard, self._runs, self._bias = b"", False, [0.0] * 6

    def _measured(self, now_ns: int) -> tuple[list[float], int]:
        """Six components, and the overload byte."""
        values, overload = [0.0] * 6, 0
        for component, (analog, rating) in self._inputs.items():
            values[component] = value = analog.value(self._seconds(now_ns))
            if abs(value) > _OVERLOAD * rating:
                overload |= 0x20 >> component
                self._overloads[component] += 1
        return values, overload

    def _contents(self, now_ns: int) -> bytes:
        values, overload = self._measured(now_ns)
        counts = []
        for component, value in enumerate(values):
            scaled = (value - self._bias[component]) * (50.0 if component < 3 else self._torque_counts)
            counts.append(round(min(max(scaled, -32768.0), 32767.0)))
        return struct.pack(">6hB", *counts, overload)

    def _respond(self, number: int, contents: bytes, ready_ns: int) -> None:
        field = (bytes([number]) + contents).ljust(16, b"\0")
        self._send(b"\x55" + field + bytes([sum(field) % 256, 0xAA]), ready_ns)

    def _arm(self) -> None:
        self._next_chip_ns += _PERIODS_NS[self.rate]
        self._at("sample", self._clock.time_ns(round(self._next_chip_ns)), self._sample)

    def _sample(self, now_ns: int) -> None:
        self._respond(_START, self._contents(now_ns), now_ns + self._latency.draw_ns())
        self.samples += 1
        self._arm()

    # Commands

    def _on_byte(self, byte: int, now_ns: int) -> None:
        self._heard += bytes([byte])
        if self._heard[0] != 0x55:
            self._heard = b""
        elif len(self._heard) == _COMMAND_BYTES:
            told, self._heard = self._heard, b""
            field = told[1:9]
            if told[10] == 0xAA and told[9] == sum(field) % 256 and (not self._runs or field[0] in (_STOP, _BIAS)):
                self._obey(field[0], field[1:], now_ns)

    def _obey(self, number: int, said: bytes, now_ns: int) -> None:
        if number == _START:
            self._runs, self._next_chip_ns = True, float(self._clock.chip_ns(now_ns + _ANSWER_NS))
            self._arm()
        elif number == _STOP:
            self._runs = False
            self._stop("sample")
        elif number == _BIAS:
            self._bias = self._measured(now_ns)[0] if said[0] else [0.0] * 6
        else:
            self._respond(number, self._answer_to(number, said, now_ns), now_ns + _ANSWER_NS)

    def _answer_to(self, number: int, said: bytes, now_ns: int) -> bytes:
        """Contents of the answer to a command that has one."""
        speed = (1, 921_600), (2, 460_800), (3, 230_400), (4, 115_200), (5, 57_600)
        now = [code for code, baud in speed if baud == self.line.baud_rate]
        known = {
            1: b"RFT80-6A01" if self._torque_counts == 1000.0 else b"RFT40-SA01",
            2: b"000000000000001",
            3: b"1.8",
            7: bytes(now * 2),
            9: bytes(self.filter),
            10: self._contents(now_ns) if number == 10 else b"",
            16: bytes([self.rate]),
            18: bytes(min(self._overloads[component], 255) for component in range(6)),
        }
        if number in known:
            return known[number]
        if number == 8 and said[0] <= 1 and said[1] <= 14:
            self.filter = said[0], said[1]
            return bytes([1, 0])
        if number == 15 and said[0] < len(_PERIODS_NS):
            self.rate = said[0]
            return bytes([1, 0])
        return bytes([0, 2 if number in (8, 15) else 1])


def sample_length(message: bytes) -> int:
    """Bytes of a message that is a sample, else 0."""
    return _RESPONSE_BYTES if len(message) == _RESPONSE_BYTES and message[1] == _START else 0


class RobotousRftTable(ComponentEmulator):
    """A component of the sensor."""

    baud_rates = _BAUDS

    kind: Literal["robotous_rft"]
    range: PositiveFloat = 1e6  # N or N m
    torque_counts: PositiveFloat = 2000.0  # a newton metre
    latency_ms: NonNegative = 0.4

    @classmethod
    def further(cls, said: Mapping[str, Any]) -> dict[str, Any]:
        """See ``ComponentEmulator``."""
        return {**super().further(said), "torque_counts": said.get("counts_per_N_m", 2000.0)}

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        felt = FaultyScalar(bench.sensor(LoadCellSensor), bench.faults, bench.start_ns)
        twin = RftTwin(
            {self.component - 1: (felt, self.range)},
            bench.clock,
            bench.start_ns,
            line=bench.line,
            torque_counts=self.torque_counts,
            latency_ns=round(1e6 * self.latency_ms),
            seed=bench.seed,
            faults=bench.faults,
        )
        return Twin(twin, lambda: twin.produced, (bench.name,), sample_length)
