"""Base of drivers of chips that measure the angle of a magnet: readings, faults of the magnet, what was missed."""

from abc import abstractmethod
from math import tau
from typing import NamedTuple

import numpy as np

from drivers.errors import FrameError
from drivers.i2c.sensor import MS, I2cSensor
from drivers.ports import I2cPort
from drivers.position import Position
from drivers.records import SCALAR, SampleStatus, Severity

FAULTS = {
    "magnet_missing": "no magnet is detected: fit it, or lower it to 0.5 to 3 mm above the chip",
    "magnet_weak": "the magnet is too weak: bring it nearer, or take a stronger magnet",
    "magnet_strong": "the magnet is too strong: raise it, or take a weaker magnet",
    "magnet_unread": "the chip cannot tell an angle of this magnet: place it on the axis, 0.5 to 2.5 mm above the chip",
}


class MagnetReading(NamedTuple):
    """A reading: counts, the chip's status, the code of what is wrong with its magnet, when the answer had come."""

    counts: int
    status: int
    fault: str
    host_ns: int


class MagnetEncoder(I2cSensor):
    """A chip above a magnet, as SCALAR rows in rad on the channel of its name.

    ``tick``: CLOCK_MONOTONIC just before the request, ``host_ns``: when the answer had come. ``device_status``: its
    status. Rows are NOT_VALID where its magnet is at fault.

    Args:
        name: Channel, and source of its events.
        port: The bus.
        address: 7-bit address.
        bits: Of a reading: a turn of the magnet.
        zero_count: Reading at joint angle zero, counts.
        counts_per_revolution: Of the joint; negative: reversed direction.
        sample_period_ms: Time between two readings.
    """

    def __init__(
        self,
        name: str,
        port: I2cPort,
        address: int,
        *,
        bits: int,
        zero_count: int,
        counts_per_revolution: int,
        sample_period_ms: float,
    ) -> None:
        super().__init__(name, port, address, round(sample_period_ms * MS))
        self._position = Position((1 << bits) // 4, zero_count, bits)
        self._scale = tau / counts_per_revolution
        self._next = 0
        self._last_ns: int | None = None
        self._magnet_fault = ""

    @abstractmethod
    def _read(self) -> MagnetReading:
        """Ask for a reading.

        Raises:
            FrameError: What came is none.
            OSError: The bus failed.
        """

    def _take(self, now_ns: int) -> None:
        try:
            reading = self._read()
        except FrameError as error:
            self._report.event(now_ns, Severity.ERROR, "bad_frame", str(error))
            self._interrupt("bad_frame")
            return
        self._name_gap(now_ns)
        self._tell_magnet(now_ns, reading.fault)
        position, accepted = (reading.counts, False) if reading.fault else self._position.place(reading.counts)
        row = np.zeros(1, SCALAR)
        status = SampleStatus.OK if accepted else SampleStatus.NOT_VALID
        asked_ns = min(now_ns, reading.host_ns)
        row[0] = (self._next, reading.host_ns, asked_ns, position, self._scale, b"rad", 0, reading.status, status)
        self._report.rows(self.name, row)
        self._next += 1
        self._last_ns = now_ns

    def _tell_magnet(self, now_ns: int, code: str) -> None:
        """An event where what is wrong with the magnet changes."""
        if code and code != self._magnet_fault:
            self._report.event(now_ns, Severity.ERROR, code, FAULTS[code])
        elif self._magnet_fault and not code:
            self._report.event(now_ns, Severity.INFO, "magnet_over", "the magnet is within its limits again")
        self._magnet_fault = code

    def _name_gap(self, now_ns: int) -> None:
        """Record the readings that were due since the last one as a gap, if it was away."""
        if self._cause and self._last_ns is not None:
            lost = max(round((now_ns - self._last_ns) / self._poll_ns) - 1, 0)
            if lost:
                first = self._next
                self._report.gap(now_ns, self.name, first, first + lost - 1, now_ns - self._last_ns, self._cause)
                self._next += lost
        self._cause = ""

    def _sleep(self, now_ns: int) -> None:
        """It has no state to be put to."""

    def _finish(self, now_ns: int) -> str:
        self._name_gap(now_ns)
        self._last_ns = None
        return f"{self._next} samples"
