"""Laumas register map (weights, status, unit) and the configuration of the transmitter.

Wire addresses are the register number less 40001. Status bits: LCB manual, "Status register 1". Division and unit codes
of 40014: see the head of the package.
"""

from dataclasses import dataclass
from typing import NamedTuple

from drivers.errors import ConfigurationError, FrameError
from drivers.records import SampleStatus

STATUS = 6  # 40007; the first register that is read
GROSS = 7  # 40008, 40009: high half first
NET = 9
DIVISION_UNIT = 13  # 40014: unit code << 8 | division code
COUNT = DIVISION_UNIT - STATUS + 1  # registers per sample, 16 bytes: count and scale come from one read

GROSS_NEGATIVE = 1 << 7
NET_NEGATIVE = 1 << 8
CELL_ERROR = 1 << 0
CONVERTER_ERROR = 1 << 1
OVER_CAPACITY = 1 << 2 | 1 << 3 | 1 << 4 | 1 << 5  # maximum + 9 divisions, 110 % of full scale, beyond 999999

DECIMALS = (0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4)  # by division code: 100, 50, 20, 10, ... 0.0001
UNITS = {0: ("kg", 1.0), 1: ("kg", 1e-3), 2: ("kg", 1e3), 3: ("kg", 0.45359237)}  # kg, g, t, lb
SIGNS = ("status", "twos_complement", "positive")
VALUES = ("gross", "net")


@dataclass(frozen=True)
class ModbusLoadCellConfig:
    """Configuration of a load cell transmitter.

    Attributes:
        address: Modbus address.
        values: Values to record: ``gross``, ``net`` or both. One value is recorded on channel ``NAME``, both on
            ``NAME_gross`` and ``NAME_net``.
        scale: ``unit`` per count; None: from the division and unit in register 40014 (mass only).
        unit: Unit of a scaled value; goes with ``scale``.
        sign: Where the sign is: ``status`` (magnitude, sign in the status register), ``twos_complement``, ``positive``.
        baud: Bit rate of the link; it decides the silence between frames. The rate itself stands in the bus URL.
        echo: The adapter hears what it sends.
        sample_period_ms: Time between two requests; 0: as fast as the link allows.
        timeout_ms: How long an answer may take.
        poll_period_ms: How often the port is read; 0: the port waits.

    Raises:
        ConfigurationError: A value out of range, or ``scale`` without ``unit``.
    """

    address: int = 1
    values: tuple[str, ...] = ("gross",)
    scale: float | None = None
    unit: str | None = None
    sign: str = "status"
    baud: int = 115_200
    echo: bool = False
    sample_period_ms: float = 0.0
    timeout_ms: float = 100.0
    poll_period_ms: float = 1.0

    def __post_init__(self) -> None:
        if not 1 <= self.address <= 247:
            raise ConfigurationError(f"address = {self.address}: Modbus addresses are 1..247")
        if not self.values or not set(self.values) <= set(VALUES) or len(set(self.values)) != len(self.values):
            raise ConfigurationError(f"values = {self.values}: use gross, net, or both")
        if (self.scale is None) != (self.unit is None):
            raise ConfigurationError("scale and unit go together: give both, or neither to read them from the device")
        if self.unit is not None and len(self.unit.encode()) > 8:
            raise ConfigurationError(f"unit = {self.unit!r}: 8 bytes at most")
        if self.sign not in SIGNS:
            raise ConfigurationError(f"sign = {self.sign!r}: use {', '.join(SIGNS)}")
        if self.baud <= 0:
            raise ConfigurationError(f"baud = {self.baud}: give the bit rate of the link")

    @property
    def pause_ms(self) -> float:
        """Silence between frames: 3.5 characters of 11 bits, 1.75 ms above 19200 baud (Serial Line 1.02, 2.5.1.1)."""
        return 1.75 if self.baud > 19_200 else 3.5 * 11.0 * 1e3 / self.baud


class Weights(NamedTuple):
    """One reading.

    Attributes:
        gross: Counts, signed.
        net: Counts, signed.
        scale: ``unit`` per count; 0 if the transmitter's unit is not a mass and none is configured.
        unit: Unit of a scaled value.
        device_status: Low byte of the status register.
        status: Reasons why it may not be used.
    """

    gross: int
    net: int
    scale: float
    unit: str
    device_status: int
    status: SampleStatus


def decode_weights(registers: tuple[int, ...], config: ModbusLoadCellConfig) -> Weights:
    """Decode registers from 40007 on (``COUNT`` or more) to a reading.

    Raises:
        FrameError: Fewer than ``COUNT`` registers.
    """
    if len(registers) < COUNT:
        raise FrameError(f"{len(registers)} registers, {COUNT} are needed: read 40007 to 40014")
    word = registers[0]
    status = SampleStatus.OK
    if word & (CELL_ERROR | CONVERTER_ERROR):
        status |= SampleStatus.NOT_VALID
    if word & OVER_CAPACITY:
        status |= SampleStatus.SATURATED
    unit_code, division_code = divmod(registers[DIVISION_UNIT - STATUS], 256)
    unit, scale = config.unit, config.scale
    if unit is None or scale is None:
        unit, factor = UNITS.get(unit_code, ("?", 0.0))
        scale = factor * 10.0 ** -DECIMALS[division_code] if division_code < len(DECIMALS) else 0.0
        if scale == 0.0:
            status |= SampleStatus.NOT_VALID
    gross = _signed(registers, GROSS, bool(word & GROSS_NEGATIVE), config.sign)
    net = _signed(registers, NET, bool(word & NET_NEGATIVE), config.sign)
    return Weights(gross, net, scale, unit, word & 0xFF, status)


def _signed(registers: tuple[int, ...], register: int, negative: bool, sign: str) -> int:
    high, low = registers[register - STATUS : register - STATUS + 2]
    value = high << 16 | low
    if sign == "twos_complement":
        return value - (value >> 31 << 32)
    return -value if sign == "status" and negative else value
