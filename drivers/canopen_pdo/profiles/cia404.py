"""CiA 404 measuring device: a load cell's process value 9130h and status 6150h on every SYNC."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.canopen_pdo import frame
from drivers.canopen_pdo.profiles.channel import ProcessData, Sample, Samples
from drivers.canopen_pdo.sdo import SdoWrite, Setup, ensure_tpdo, read_unsigned
from drivers.errors import ConfigurationError, FrameError
from drivers.records import SampleStatus

MAPPING = (0x9130_0120, 0x6150_0108)
VALUE_TPDO = 1
AUTO_ZERO = 0x6125
NEWTON = 0x21  # CiA 303-2
NOT_VALID = 1 << 0  # 6150h
MOST_DIGITS = 9


@dataclass(frozen=True)
class Cia404Config:
    """A load cell.

    Attributes:
        name: Channel.
        node: Node number.
        capacity_N: Rated force, N: at or beyond it a sample is marked SATURATED.
        tare: Tare the cell (6125h) at the first set-up, when it must be unloaded. A node that reboots loses its tare
            while it may be loaded: it is not tared again, and its samples are NOT_VALID from there on.
    """

    name: str
    node: int
    capacity_N: float  # noqa: N815 - a unit, as in vehicle.toml
    tare: bool = False

    def __post_init__(self) -> None:
        if not self.capacity_N > 0.0:
            raise ConfigurationError(f"{self.name}: capacity_N = {self.capacity_N}: give the rated force, above 0")

    def process_data(self) -> "list[LoadCell]":
        """Its one channel."""
        return [LoadCell(self)]


class LoadCell(ProcessData):
    """Force in counts of 10^-digits of the node's unit; the scale to N is read from the node during set-up."""

    profile = 0x0194
    unit = "N"

    def __init__(self, config: Cia404Config) -> None:
        super().__init__(config.name, config.node, frame.TPDO[VALUE_TPDO] + config.node)
        self._capacity_N = config.capacity_N
        self._tare_due = config.tare
        self._tared = self._tare_lost = False

    def rebooted(self) -> None:
        """See ``ProcessData``."""
        self._tare_lost |= self._tared

    def setup(self) -> Setup:
        """Read unit and decimal digits, tare if configured, map value and status to the SYNC TPDO.

        Raises:
            ConfigurationError: The process value is not a force in powers of ten of a newton.
        """
        unit = yield from read_unsigned(0x6131, 1)
        digits = yield from read_unsigned(0x6132, 1)
        prefix, numerator, denominator = unit >> 24, unit >> 16 & 0xFF, unit >> 8 & 0xFF
        if numerator != NEWTON or denominator != 0:
            raise ConfigurationError(f"load cell measures in unit {unit:08X}h, not newton (xx210000h): write 6131h")
        if digits > MOST_DIGITS:
            raise ConfigurationError(f"load cell has {digits} decimal digits: write 0..{MOST_DIGITS} to 6132h")
        power = (prefix - 0x100 if prefix > 0x7F else prefix) - digits
        self.scale = float(f"1e{power}")
        if self._tare_due:
            yield SdoWrite(AUTO_ZERO, 1, b"zero")
            self._tare_due, self._tared = False, True
        yield from ensure_tpdo(VALUE_TPDO, self.cob_id, 1, MAPPING)

    def decode(self, data: bytes) -> Sample:
        """Process value and status byte. Raises FrameError."""
        if len(data) != 5:
            raise FrameError(f"{self.name}: TPDO of {len(data)} bytes, 9130h and 6150h have 5: check the mapping 1A00h")
        value = int.from_bytes(data[:4], "little", signed=True)
        status = SampleStatus.NOT_VALID if data[4] & NOT_VALID or self._tare_lost else SampleStatus.OK
        if abs(value) * self.scale >= self._capacity_N:
            status |= SampleStatus.SATURATED
        return Sample(value, data[4], status)

    def decode_many(self, words: NDArray[np.uint8]) -> Samples | None:
        """See ``ProcessData``."""
        if words.shape[1] != 5:
            return None
        values = np.ascontiguousarray(words[:, :4]).view("<i4")[:, 0].astype(np.int64)
        saturated = np.abs(values) * self.scale >= self._capacity_N
        if not (self._tare_lost or words[:, 4].any() or saturated.any()):
            return Samples(values)
        not_valid = (words[:, 4] & NOT_VALID != 0) | self._tare_lost
        status = not_valid * np.uint8(SampleStatus.NOT_VALID) | saturated * np.uint8(SampleStatus.SATURATED)
        return Samples(values, words[:, 4], status)
