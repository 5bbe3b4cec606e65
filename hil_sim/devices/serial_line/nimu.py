"""A Memsense nIMU on RS-422: 38-byte packets, unasked, at its sample rate (DOC00290 rev. J; PSD-0822 rev. C).

=======  ==========================================================================================
byte     content
=======  ==========================================================================================
0..3     FFh four times
4        message size, 38
5        reserved
6        message identifier, 14h
7..8     sample timer: 2.1701 us a count at the start of the X gyro's conversion; wraps every 0.142 s
9..10    reserved
11..12   serial number
13..36   gyro x, y, z; accelerometer x, y, z; magnetometer x, y, z; temperature of the gyros x, y, z
37       sum modulo 256 of what ``checksum`` says
=======  ==========================================================================================

Words are signed, the high byte first. The document can be read in three ways about the checksum, so it is a choice
here; public code that talks to real units sums all 37 bytes before it, synchronisation bytes included, at 115,200
baud 8N1, and those are the defaults. Samples stand on the device's clock; every word of a packet belongs to the
instant of its timer. A packet leaves ``latency_ns`` after that instant. The device takes no commands.
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

import math
from collections.abc import Mapping
from enum import StrEnum
from typing import Any, Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import PositiveFloat

from hil_sim.devices.emulator import Bench, Equivalent, MeasuringEmulator, Twin
from hil_sim.devices.serial_line.serial_twin import SerialTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import CLOCK_KINDS, INPUT_KINDS, NO_FAULTS, DeviceFaults, FaultKind, FaultyClock, FaultyImu
from hil_sim.plants.motions.motion import STANDARD_GRAVITY
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ChipClock, ImuAnalog
from hil_sim.sensing.sensors import ImuSensor

_SIZE: Final = 38
_GYRO_DPS: Final = 1.3733e-2  # a count, +-300 deg/s model
_ACCEL_G: Final = 9.1553e-5  # a count, +-2 g model
_MAG_GAUSS: Final = 8.6975e-5  # a count, +-1.9 gauss model
_TEMPERATURE_C: Final = 1.8165e-2  # a count
_TEMPERATURE_ZERO_C: Final = 25.0
_TIMER_PS: Final = 2_170_100  # a count
_BANDWIDTH_CODE: Final = 3  # of ImuAnalog: the code nearest to the unit's 50 Hz
_ANALOG_TEMPERATURE_PER_C: Final = 340.0  # ImuAnalog's temperature word
_ANALOG_TEMPERATURE_ZERO_C: Final = 36.53
_PACKET: Final = np.dtype(
    [
        ("synchronisation", "u1", (4,)),
        ("size", "u1"),
        ("reserved", "u1"),
        ("identifier", "u1"),
        ("timer", ">u2"),
        ("reserved_2", ">u2"),
        ("serial_number", ">u2"),
        ("gyro", ">i2", (3,)),
        ("accel", ">i2", (3,)),
        ("mag", ">i2", (3,)),
        ("temperature", ">i2", (3,)),
        ("checksum", "u1"),
    ]
)


class Checksum(StrEnum):
    """What the checksum sums."""

    PACKET = "packet"  # all bytes before it
    AFTER_SYNC = "after_sync"  # without the four FFh
    PAYLOAD = "payload"  # the words only


_MOST_AHEAD: Final = 256
_BOOT_NS: Final = 250_000_000  # from power-up to the first sample
_LATENCY_NS: Final = 1_000_000  # from a sample to the first bit of its packet
_FIRST_SUMMED: Final = {Checksum.PACKET: 0, Checksum.AFTER_SYNC: 4, Checksum.PAYLOAD: 13}


class FieldAnalog(Protocol):
    """The magnetometer's sensing elements."""

    def gauss(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Field in sensor axes at mission times, shape (n, 3)."""


class _QuietField:
    def gauss(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.tile((0.21, 0.02, -0.44), (len(times_s), 1))


class NimuTwin(SerialTwin):
    """One unit.

    Args:
        analog: Gyroscopes, accelerometers and temperature. It is asked with this unit's sensitivities; its
            temperature word is 340 counts a degree from 36.53 deg C.
        clock: The unit's oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        rate_hz: Sample rate on its own clock.
        line: Speed and format.
        checksum: What the checksum sums.
        magnetometer: Its field; None: a constant one.
        serial_number: Bytes 11 and 12.
        faults: What breaks.

    Raises:
        FaultError: a fault that the unit cannot have.
        ValueError: the line is too slow for the rate.
    """

    def __init__(
        self,
        analog: ImuAnalog,
        clock: ChipClock,
        start_ns: int,
        *,
        rate_hz: float = 150.0,
        line: LineFormat = LineFormat(115_200),  # noqa: B008  (a constant)
        checksum: Checksum | str = Checksum.PACKET,
        magnetometer: FieldAnalog | None = None,
        serial_number: int = 0x0457,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        super().__init__(line, start_ns, faults, (FaultKind.SATURATED, *INPUT_KINDS, *CLOCK_KINDS))
        if _SIZE * line.character_ns * rate_hz > 1e9:
            raise ValueError(
                f"{rate_hz:g} packets of {_SIZE} bytes a second do not fit into {line.baud_rate} baud; "
                "lower rate_hz or raise the baud rate."
            )
        self.produced = 0
        self._analog = FaultyImu(analog, faults, start_ns)
        self._clock: ChipClock = FaultyClock(clock, faults)
        self._period_ns = 1e9 / rate_hz
        self._first_summed = _FIRST_SUMMED[Checksum(checksum)]
        self._field: FieldAnalog = magnetometer or _QuietField()
        self._serial_number = serial_number
        self._powered_chip_ns = 0
        self._next = 0
        self._is_known = not faults and magnetometer is None  # its packets, as far ahead as its input is
        self._ahead: list[tuple[bytes, float]] = []  # the next packets, and their mission times

    def _power_up(self, now_ns: int) -> None:
        self._powered_chip_ns = self._clock.chip_ns(now_ns)
        self._next = 0
        self._ahead.clear()
        self._arm(now_ns)

    def _chip_ns(self, sample: NDArray[np.float64]) -> NDArray[np.float64]:
        """The unit's time of its samples since it was powered up, whole ns."""
        return np.floor(_BOOT_NS + sample * self._period_ns)

    def _arm(self, not_before_ns: int) -> None:
        own_ns = int(self._chip_ns(np.array([self._next], np.float64))[0])
        self._at("sample", max(self._clock.time_ns(self._powered_chip_ns + own_ns), not_before_ns), self._sample)

    def _sample(self, now_ns: int) -> None:
        """Make this sample and all that follow until the next event of another device."""
        until_ns = max(now_ns, min(self._until_ns, self.due_ns - 1))
        own_until_ns = self._clock.chip_ns(until_ns) - self._powered_chip_ns
        n = max(1, math.ceil((own_until_ns + 1 - _BOOT_NS) / self._period_ns) - self._next)
        latest_s = self._seconds(until_ns)
        if n <= len(self._ahead) and self._ahead[n - 1][1] <= latest_s:
            made = self._ahead[:n]
            del self._ahead[:n]
            self._next += n
        else:
            made = self._made(n, latest_s)
            self._next += n
            self._ahead = self._made(_MOST_AHEAD, math.inf) if self._is_known else []
        self.produced += len(made)
        for packet, time_s in made:
            self._send(packet, self._start_ns + round(time_s * 1e9) + _LATENCY_NS)
        self._arm(until_ns)

    def _made(self, n: int, latest_s: float) -> list[tuple[bytes, float]]:
        """Packets of the next ``n`` samples with their mission times, none after ``latest_s``; if inf, those known."""
        own_ns = self._chip_ns(self._next + np.arange(n, dtype=np.float64))  # (n,)
        times_s = np.minimum(self._clock.times_s(self._powered_chip_ns + own_ns), latest_s)  # (n,)
        shown = np.append(np.diff(times_s) > 0.0, True)  # the unit has no samples of times that it never showed
        if math.isinf(latest_s):
            shown &= times_s < self._analog.known_s
        own_ns, times_s = own_ns[shown], times_s[shown]
        return list(zip(self._packets(own_ns, times_s), times_s.tolist(), strict=True)) if len(own_ns) else []

    def _packets(self, own_ns: NDArray[np.float64], times_s: NDArray[np.float64]) -> list[bytes]:
        words = self._analog.counts(times_s, 1.0 / _ACCEL_G, 1.0 / _GYRO_DPS, _BANDWIDTH_CODE)  # (n, 7)
        celsius = words[:, 3] / _ANALOG_TEMPERATURE_PER_C + _ANALOG_TEMPERATURE_ZERO_C
        rows = np.zeros(len(times_s), _PACKET)
        rows["synchronisation"] = 0xFF
        rows["size"] = _SIZE
        rows["identifier"] = 0x14
        rows["timer"] = own_ns.astype(np.int64) * 1000 // _TIMER_PS % 0x10000
        rows["serial_number"] = self._serial_number
        rows["gyro"] = words[:, 4:7]
        rows["accel"] = words[:, 0:3]
        rows["mag"] = _to_words(self._field.gauss(times_s) / _MAG_GAUSS)
        rows["temperature"] = _to_words((celsius - _TEMPERATURE_ZERO_C) / _TEMPERATURE_C)[:, np.newaxis]
        octets = rows.view(np.uint8).reshape(len(rows), _SIZE)
        rows["checksum"] = octets[:, self._first_summed : -1].sum(axis=1, dtype=np.uint64) % 256
        return [row.tobytes() for row in rows]


def _to_words(counts: NDArray[np.float64]) -> NDArray[np.int16]:
    return np.clip(np.rint(counts), -32768, 32767).astype(np.int16)


class NimuTable(MeasuringEmulator):
    """A Memsense nIMU."""

    quantities = ("inertial",)

    kind: Literal["nimu"]
    rate_Hz: PositiveFloat = 150.0
    checksum: Literal["packet", "after_sync", "payload"] = "packet"
    magnetometer: bool = True  # whether its words are recorded, as NAME_mag_x, _y, _z; they are sent always

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``: noise and delays are those of the file, from its certificate."""
        table = {
            "rate_Hz": said["sample_rate_hz"],
            "checksum": said.get("checksum_span", "packet"),
            "magnetometer": said.get("magnetometer", True),
            "measures": name,
            "at": said["frame"],
        }
        imu = sheets.imu("nimu", said)
        for triad, noise, delay, unit in (
            ("accel_g", "accel_noise_m_s2", "accel_delay_ms", STANDARD_GRAVITY),
            ("gyro_deg_s", "gyro_noise_rad_s", "gyro_delay_ms", math.pi / 180.0),
        ):
            (bandwidth_hz,) = imu[triad]["bandwidth_Hz"]
            imu[triad]["noise_density"] = said[noise] / unit / math.sqrt(0.5 * said["sample_rate_hz"])  # white samples
            own_ms = 1e3 * math.sqrt(0.5) / (math.pi * bandwidth_hz)  # of these poles
            imu[triad]["delay_ms"] = [max(said.get(delay, 0.0), own_ms if delay in said else 0.0)]
        return Equivalent(table, {name: imu}, {name: "crystal"})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        nimu = NimuTwin(
            bench.sensor(ImuSensor),
            bench.clock,
            bench.start_ns,
            rate_hz=self.rate_Hz,
            line=bench.line,
            checksum=self.checksum,
            faults=bench.faults,
        )
        magnetometer = [f"{bench.name}_mag_{axis}" for axis in "xyz"] if self.magnetometer else []
        return Twin(nimu, lambda: nimu.produced, (bench.name, *magnetometer), len)
