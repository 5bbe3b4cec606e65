"""A wrist sensor's network box that streams RDT records over UDP, typed from ATI's Net F/T manual, section 10.

========  ==============================================================================================================
request   uint16 1234h, uint16 command, uint32 records; commands: 0 stop, 2 start; others are heard only
record    uint32 number in this stream, uint32 internal sample, uint32 status, 6 x int32 counts of Fx Fy Fz Tx Ty Tz
========  ==============================================================================================================

Big-endian. A stream's numbers begin at 1; a request takes the place of the one before, and so does its sender. Internal
samples are 7000 a second since power-up. Bit 31 of the status is an error: here, a component beyond its range.

OnRobot's Compute Box, by what its example ``highspeed_udp.c`` sends and reads: further commands 0082h, milliseconds
between two records; 0081h, its low-pass filter, 0 to 6, whose delay is the sensor's; 0042h, FFh: what it reads now is
taken off from now on, 0: not any more. 10,000 counts a newton, 100,000 a newton metre. What its status says of a
component beyond its range is not published: here bit 0.
"""

import struct
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final, Literal

from pydantic import PositiveFloat

from hil_sim.devices.emulator import Bench, Twin
from hil_sim.devices.network.networked import NetworkedTwin
from hil_sim.devices.wrist.components import ComponentEmulator
from hil_sim.faults import FaultKind, FaultyScalar
from hil_sim.scenario.sensor_tables import NonNegative
from hil_sim.sensing.analog import ChipClock
from hil_sim.sensing.sensors import LoadCellSensor

_START, _STOP = 2, 0
_SPEED, _FILTER, _BIAS = 0x82, 0x81, 0x42
_FILTERS = 7
_MOST: Final = 2**31 - 1
Input = Callable[[float], tuple[float, bool]]
"""Counts at a mission time, and whether that is beyond the range."""


class NetBox(NetworkedTwin[int]):
    """One sensor; see ``NetworkedTwin``.

    Args:
        inputs: What it measures, by component from 0; others are 0.
        rate_hz: Records a second.
    """

    draws = 0x4654
    boot_ns = 500_000_000  # a real one takes some seconds
    internal_hz: ClassVar[int] = 7000
    error: ClassVar[int] = 0x8000_0000  # its status beyond its range

    def __init__(
        self, inputs: Mapping[int, Input], clock: ChipClock, start_ns: int, *, rate_hz: float = 1000.0, **options: Any
    ) -> None:
        self._period_ns = 1e9 / rate_hz
        self._next = 0  # number of the next record since power-up, at its rate
        self._number = self._left = 0  # in this stream; records to send
        super().__init__(inputs, clock, start_ns, **options)

    def receive(self, data: bytes, now_ns: int) -> None:
        """See ``NetworkDevice``: a datagram."""
        if len(data) != 8 or data[:2] != b"\x12\x34":
            return
        command, records = struct.unpack(">HI", data[2:])
        if command == _START:
            self._number, self._left = 0, records or -1
            since_ns = self._clock.chip_ns(now_ns + self._latency_ns) - self._powered_chip_ns
            self._next = int(since_ns / self._period_ns) + 1
            self._arm()
        elif command == _STOP:
            self._stop("sample")
        else:
            self._further(command, records)

    def _further(self, command: int, number: int) -> None:
        """A command that this box is not known to have, but other boxes."""

    def _unbiased(self, values: list[float]) -> list[float]:
        """What it makes of what it measures."""
        return values

    def _arm(self) -> None:
        at_ns = self._clock.time_ns(self._powered_chip_ns + round(self._next * self._period_ns))
        self._at("sample", at_ns, self._sample)

    def _sample(self, now_ns: int) -> None:
        time_s = self._seconds(now_ns)
        measured = [self._inputs[k](time_s) if k in self._inputs else (0.0, False) for k in range(6)]
        values = self._unbiased([value for value, _ in measured])
        counts = [max(-_MOST, min(_MOST, round(value))) for value in values]
        status = self.error if any(beyond for _, beyond in measured) else 0
        internal = int(self._next * self._period_ns * 1e-9 * self.internal_hz)
        self._number += 1
        data = struct.pack(">III6i", self._number & 0xFFFF_FFFF, internal & 0xFFFF_FFFF, status, *counts)
        if self._active(FaultKind.GARBAGE, now_ns):
            data = self._latency.rng.bytes(len(data))
        self._send(data, self._next, now_ns + self._latency.draw_ns())
        self._next += 1
        self._left -= 1
        if self._left:
            self._arm()


class HexBox(NetBox):
    """OnRobot's Compute Box with a HEX; 100 records a second until it is told another rate.

    What it is told it forgets without power.

    Attributes:
        filter: As it was told.
    """

    internal_hz = 1000
    error = 1

    def _gain_power(self, now_ns: int) -> None:
        super()._gain_power(now_ns)
        self._period_ns, self.filter = 1e7, 0
        self._read, self._bias = [0.0] * 6, [0.0] * 6

    def _further(self, command: int, number: int) -> None:
        """See ``NetBox``."""
        if command == _SPEED and number and self._period_ns != 1e6 * number:
            self._period_ns, self._counted = 1e6 * number, None
        elif command == _FILTER and number < _FILTERS:
            self.filter = number
        elif command == _BIAS:
            self._bias = list(self._read) if number == 0xFF else [0.0] * 6

    def _unbiased(self, values: list[float]) -> list[float]:
        """See ``NetBox``."""
        self._read = values
        return [value - bias for value, bias in zip(values, self._bias, strict=True)]


class NetFtTable(ComponentEmulator):
    """A component of the sensor."""

    box: ClassVar[type[NetBox]] = NetBox

    needs = "udp"

    kind: Literal["net_ft"]
    rate_hz: PositiveFloat = 1000.0
    counts: PositiveFloat = 1e6  # of a newton or newton metre
    range: PositiveFloat = 1e6  # N or N m
    latency_ms: NonNegative = 0.4

    @classmethod
    def counts_of(cls, said: Mapping[str, Any]) -> float:
        """Of a newton or newton metre, by a table of a vehicle file."""
        return float(said.get("counts_per_N" if said["component"] < 4 else "counts_per_N_m", 1e6))

    @classmethod
    def further(cls, said: Mapping[str, Any]) -> dict[str, Any]:
        """See ``ComponentEmulator``."""
        rate = {"rate_hz": said["rate_hz"]} if "rate_hz" in said else {}
        return {**super().further(said), **rate, "counts": cls.counts_of(said)}

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        cell = FaultyScalar(bench.sensor(LoadCellSensor), bench.faults, bench.start_ns)

        def measured(time_s: float) -> tuple[float, bool]:
            value = cell.value(time_s)
            return self.counts * value, abs(value) > self.range

        box = self.box(
            {self.component - 1: measured},
            bench.clock,
            bench.start_ns,
            rate_hz=self.rate_hz,
            latency_ns=round(1e6 * self.latency_ms),
            seed=bench.seed,
            faults=bench.faults,
        )
        return Twin(box, lambda: box.produced, (bench.name,))


class OnrobotHexTable(NetFtTable):
    """A component of a HEX."""

    box = HexBox

    kind: Literal["onrobot_hex"]  # type: ignore[assignment]

    @classmethod
    def counts_of(cls, said: Mapping[str, Any]) -> float:
        """See ``NetFtTable``."""
        return 1e4 if said["component"] < 4 else 1e5
