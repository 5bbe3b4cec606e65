"""CiA 402 drive: actual position 6064h, velocity 606Ch, torque 6077h and statusword 6041h on every SYNC.

The configured values are mapped in that order into as few TPDOs as hold them. Known limits: position and velocity are
in the drive's user units (CiA 402-2: scaled by 608Fh, 6091h, 6092h and 6096h), which drives do not report in one common
way; the scale comes from the configuration and is not checked. Unused TPDOs keep the manufacturer's setting: switch off
an event-driven one that floods the bus with the drive's tool.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.canopen_pdo import frame
from drivers.canopen_pdo.profiles.channel import ProcessData, Sample, Samples, position_sample, position_samples
from drivers.canopen_pdo.sdo import Setup, ensure_tpdo, read_unsigned
from drivers.errors import ConfigurationError, FrameError
from drivers.position import Position

POSITION, VELOCITY, TORQUE = 0x6064_0020, 0x606C_0020, 0x6077_0010  # as mapping entries
STATUS, MODE = 0x6041_0010, 0x6061_0008  # the statusword; the mode of operation that is in force
RATED_TORQUE = 0x6076  # mN m
PDO_BITS = 64
TWO_PI = 2.0 * math.pi


@dataclass(frozen=True)
class Cia402Config:
    """A drive. Values without a channel name are not mapped.

    Attributes:
        node: Node number.
        counts_per_revolution: Position units in a revolution of the joint, gear included.
        zero_count: What it reads at joint angle zero, counts.
        position: Channel of 6064h, rad.
        velocity: Channel of 606Ch, rad/s.
        torque: Channel of 6077h, N m.
        status: Channel of 6041h, with 6061h as the device's status: of a drive that is driven.
        velocity_scale_rad_s: Velocity unit of the drive, rad/s of the joint; None: counts a second.
        rated_torque_N_m: Rated torque of the motor; None: read from 6076h.
        gear_ratio: Motor revolutions per joint revolution, for the torque; negative where the directions are opposite.
        tpdos: Numbers of the TPDOs to use, in this order, as many as needed.
    """

    node: int
    counts_per_revolution: int
    zero_count: int = 0
    position: str | None = None
    velocity: str | None = None
    torque: str | None = None
    status: str | None = None
    velocity_scale_rad_s: float | None = None
    rated_torque_N_m: float | None = None  # noqa: N815 - a unit, as in vehicle.toml
    gear_ratio: float = 1.0
    tpdos: tuple[int, ...] = (1, 2)

    def __post_init__(self) -> None:
        if not self.names:
            raise ConfigurationError(f"drive at node {self.node} has no channel: name position, velocity or torque")
        if self.counts_per_revolution < 1:
            raise ConfigurationError(f"{self.name}: counts_per_revolution = {self.counts_per_revolution}: 1 or more")
        if self.velocity_scale_rad_s is not None and not abs(self.velocity_scale_rad_s) > 0.0:
            raise ConfigurationError(f"{self.name}: velocity_scale_rad_s = {self.velocity_scale_rad_s}: give the unit")
        if self.rated_torque_N_m is not None and not self.rated_torque_N_m > 0.0:
            raise ConfigurationError(f"{self.name}: rated_torque_N_m = {self.rated_torque_N_m}: above 0, or leave it")
        if not abs(self.gear_ratio) > 0.0:
            raise ConfigurationError(f"{self.name}: gear_ratio = {self.gear_ratio}: motor revolutions per joint's")
        if len(set(self.tpdos)) < len(self.tpdos) or not set(self.tpdos) <= {1, 2, 3, 4}:
            raise ConfigurationError(f"{self.name}: tpdos = {self.tpdos}: use different ones of 1..4")
        if len(self.layout) > len(self.tpdos):
            raise ConfigurationError(f"{self.name}: its values fill {len(self.layout)} TPDOs: name more tpdos")

    @property
    def names(self) -> tuple[str, ...]:
        """Its channels."""
        return tuple(name for name in (self.position, self.velocity, self.torque, self.status) if name is not None)

    @property
    def name(self) -> str:
        """Its first channel."""
        return self.names[0]

    @property
    def layout(self) -> list[tuple[int, ...]]:
        """Mapping entries of each TPDO."""
        wanted = {entry: name for name, entry in self._wanted()} | {MODE: self.status}
        layout: list[tuple[int, ...]] = [()]
        for entry in (entry for entry, name in wanted.items() if name is not None):
            together = (entry, MODE) if entry == STATUS else (entry,)  # one answer has both
            if sum(each & 0xFF for each in (*layout[-1], *together)) > PDO_BITS:
                layout.append(())
            layout[-1] += (entry,)
        return layout

    def place(self, entry: int) -> "Place":
        """Where an object that is mapped is found."""
        at = next(at for at, mapping in enumerate(self.layout) if entry in mapping)
        mapping = self.layout[at]
        start = sum(each & 0xFF for each in mapping[: mapping.index(entry)]) // 8
        length = sum(each & 0xFF for each in mapping) // 8
        return Place(self.tpdos[at], mapping, start, (entry & 0xFF) // 8, length)

    def process_data(self) -> "list[DriveValue]":
        """The channels of the drive."""
        return [DriveValue(self, name, entry) for name, entry in self._wanted() if name is not None]

    def _wanted(self) -> tuple[tuple[str | None, int], ...]:
        return (self.position, POSITION), (self.velocity, VELOCITY), (self.torque, TORQUE), (self.status, STATUS)


class Place(NamedTuple):
    """Where an object stands: in which TPDO, with what mapping; its first byte, its bytes, and those of the TPDO."""

    tpdo: int
    mapping: tuple[int, ...]
    start: int
    size: int
    length: int


class DriveValue(ProcessData):
    """One of the values of a drive: signed counts as sent; a position is unwrapped by ``Position``.

    A statusword is unsigned, and the mode of operation that is in force stands beside it.

    Args:
        config: The drive.
        name: Channel.
        entry: ``POSITION``, ``VELOCITY``, ``TORQUE`` or ``STATUS``.
    """

    profile = 0x0192

    def __init__(self, config: Cia402Config, name: str, entry: int) -> None:
        place = config.place(entry)
        self._tpdo, self._mapping, self._start, self._size, self._length = place
        super().__init__(name, config.node, frame.TPDO[self._tpdo] + config.node)
        self._config = config
        self._entry = entry
        self._mode_at = config.place(MODE).start if entry == STATUS else 0
        self._position = Position(config.counts_per_revolution, config.zero_count)
        per_count = TWO_PI / config.counts_per_revolution
        if entry == POSITION:
            self.unit, self.scale = "rad", per_count
        elif entry == VELOCITY:
            self.unit = "rad/s"
            self.scale = per_count if config.velocity_scale_rad_s is None else config.velocity_scale_rad_s
        elif entry == TORQUE:
            self.unit = "N m"
            self.scale = self._per_mille(config.rated_torque_N_m or 0.0)

    def setup(self) -> Setup:
        """Read the rated torque if needed, map the values to their TPDO.

        Raises:
            ConfigurationError: The rated torque 6076h is 0.
        """
        if self._entry == TORQUE and self._config.rated_torque_N_m is None:
            rated = yield from read_unsigned(RATED_TORQUE)
            if rated == 0:
                raise ConfigurationError("drive has rated torque 0 (6076h): write it, or give rated_torque_N_m")
            self.scale = self._per_mille(rated * 1e-3)
        yield from ensure_tpdo(self._tpdo, self.cob_id, 1, self._mapping)

    def decode(self, data: bytes) -> Sample:
        """The value's bytes out of the TPDO. Raises FrameError."""
        if len(data) != self._length:
            raise FrameError(
                f"{self.name}: TPDO of {len(data)} bytes, its objects have {self._length}: "
                f"check the mapping {0x1A00 + self._tpdo - 1:04X}h"
            )
        word = data[self._start : self._start + self._size]
        if self._entry == STATUS:
            return Sample(int.from_bytes(word, "little"), data[self._mode_at])
        raw = int.from_bytes(word, "little", signed=True)
        return position_sample(self._position, raw) if self._entry == POSITION else Sample(raw)

    def decode_many(self, words: NDArray[np.uint8]) -> Samples | None:
        """See ``ProcessData``."""
        if words.shape[1] != self._length:
            return None
        word = np.ascontiguousarray(words[:, self._start : self._start + self._size])
        if self._entry == STATUS:
            return Samples(word.view("<u2")[:, 0].astype(np.int64), words[:, self._mode_at])
        raw = word.view(f"<i{self._size}")[:, 0].astype(np.int64)
        return position_samples(self._position, raw) if self._entry == POSITION else Samples(raw)

    def _per_mille(self, rated_N_m: float) -> float:
        """Joint torque per thousandth of the rated motor torque (unit of 6077h, CiA 402-2), N m."""
        return rated_N_m * 1e-3 * self._config.gear_ratio
