"""Any object of any node that comes in an event-driven TPDO: a phase, a mode, a counter."""

import struct
from dataclasses import dataclass

from drivers.canopen_pdo import frame
from drivers.canopen_pdo.channel import ProcessData, Sample
from drivers.canopen_pdo.sdo import Read, Setup, read_unsigned
from drivers.errors import ConfigurationError, FrameError

FORMATS = {"u8": "<B", "i8": "<b", "u16": "<H", "i16": "<h", "u32": "<I", "i32": "<i", "u64": "<Q", "i64": "<q"}


@dataclass(frozen=True)
class CanopenObjectConfig:
    """A mapped object.

    Attributes:
        name: Channel.
        node: Node number.
        tpdo: Number of the TPDO that carries it, 1..4.
        byte_offset: Where it begins in the TPDO.
        format: u8, i8, u16, i16, u32, i32, i64, or u64 up to 2^63 - 1.
        index: Its place in the object dictionary, checked against the mapping and read once at the start.
        subindex: The same.
        unit: Unit of the scaled value.
        scale: ``unit`` per count.
    """

    name: str
    node: int
    tpdo: int
    byte_offset: int
    format: str
    index: int
    subindex: int = 0
    unit: str = "1"
    scale: float = 1.0

    def __post_init__(self) -> None:
        if self.format not in FORMATS:
            raise ConfigurationError(f"{self.name}: format {self.format!r} is unknown: use one of {', '.join(FORMATS)}")
        if not 1 <= self.tpdo <= 4:
            raise ConfigurationError(f"{self.name}: tpdo = {self.tpdo}: use 1..4")
        if not 0 <= self.byte_offset <= 8 - struct.calcsize(FORMATS[self.format]):
            raise ConfigurationError(f"{self.name}: byte_offset = {self.byte_offset}: the object must end in 8 bytes")


class MappedObject(ProcessData):
    """The object's value, unscaled, as often as the node sends it."""

    synchronous = False

    def __init__(self, config: CanopenObjectConfig) -> None:
        super().__init__(config.name, config.node, frame.TPDO[config.tpdo] + config.node)
        self.unit = config.unit
        self.scale = config.scale
        self._config = config
        self._struct = struct.Struct(FORMATS[config.format])
        self._initial: tuple[int, Sample] | None = None

    def setup(self) -> Setup:
        """Check that the TPDO carries the object where the configuration says, and read its present value.

        Raises:
            ConfigurationError: It does not.
        """
        config = self._config
        mapped = 0x1A00 + config.tpdo - 1
        wanted = config.index << 16 | config.subindex << 8 | 8 * self._struct.size
        offset_bits = 0
        for place in range((yield from read_unsigned(mapped, 0))):
            entry = yield from read_unsigned(mapped, place + 1)
            if offset_bits == 8 * config.byte_offset and entry == wanted:
                break
            offset_bits += entry & 0xFF
        else:
            raise ConfigurationError(
                f"TPDO{config.tpdo} has no {config.index:04X}h:{config.subindex:02X} as {config.format} at byte "
                f"{config.byte_offset}: mend the configuration or {mapped:04X}h"
            )
        if self._struct.size <= 4:
            reply = yield Read(config.index, config.subindex)
            if len(reply.data) < self._struct.size:
                raise ConfigurationError(
                    f"{config.index:04X}h has {len(reply.data)} bytes, {config.format} does not fit"
                )
            self._initial = reply.host_ns, Sample(int(self._struct.unpack_from(reply.data)[0]))

    def decode(self, data: bytes) -> Sample:
        """The object's bytes out of the TPDO. Raises FrameError."""
        config = self._config
        if len(data) < config.byte_offset + self._struct.size:
            raise FrameError(f"{self.name}: TPDO of {len(data)} bytes ends before byte {config.byte_offset}: check it")
        return Sample(int(self._struct.unpack_from(data, config.byte_offset)[0]))

    def initial(self) -> tuple[int, Sample] | None:
        """The value read while setting up, and when the answer came."""
        return self._initial
