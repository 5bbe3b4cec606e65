"""Any object that a node maps into a TPDO: a phase, a mode, a motor current, a joint torque."""

import struct
from collections.abc import Generator
from dataclasses import dataclass
from typing import NamedTuple

from drivers.canopen_pdo import frame
from drivers.canopen_pdo.profiles.channel import ProcessData, Sample
from drivers.canopen_pdo.sdo import SdoData, SdoRead, SdoWrite, Setup, read_unsigned
from drivers.errors import ConfigurationError, FrameError

FORMATS = {"u8": "<B", "i8": "<b", "u16": "<H", "i16": "<h", "u32": "<I", "i32": "<i", "u64": "<Q", "i64": "<q"}
EXPEDITED_BYTES = 4  # what a single SDO transfer carries


@dataclass(frozen=True)
class CanopenObjectConfig:
    """A mapped object.

    Attributes:
        name: Channel.
        node: Node number.
        tpdo: Number of the TPDO that carries it, 1..4.
        byte_offset: Where it begins in the TPDO.
        format: u8, i8, u16, i16, u32, i32, i64, or u64 up to 2^63 - 1.
        index: Its place in the object dictionary, checked against the mapping and read back by SDO.
        subindex: The same.
        unit: Unit of the scaled value.
        scale: ``unit`` per count.
        counter_subindex: Of an object of the same index in the same TPDO that counts the changes; None: there is none.
        synchronous: The TPDO answers every SYNC (transmission type 1); otherwise it is sent on events.
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
    counter_subindex: int | None = None
    synchronous: bool = False

    def __post_init__(self) -> None:
        if self.format not in FORMATS:
            raise ConfigurationError(f"{self.name}: format {self.format!r} is unknown: use any of {', '.join(FORMATS)}")
        if not 1 <= self.tpdo <= 4:
            raise ConfigurationError(f"{self.name}: tpdo = {self.tpdo}: use 1..4")
        if not 0 <= self.byte_offset <= 8 - struct.calcsize(FORMATS[self.format]):
            raise ConfigurationError(f"{self.name}: byte_offset = {self.byte_offset}: the object must end in 8 bytes")
        if self.synchronous and self.counter_subindex is not None:
            raise ConfigurationError(f"{self.name}: its losses are counted by SYNC: drop counter_subindex")

    def process_data(self) -> "list[MappedObject]":
        """Its one channel."""
        return [MappedObject(self)]


class Reading(NamedTuple):
    """An object read by SDO: arrival time of the answer, value, and change counter if there is one."""

    host_ns: int
    sample: Sample
    counter: int | None


class MappedObject(ProcessData):
    """The object's value, unscaled, as often as the node sends it.

    Attributes:
        initial: Value read during set-up, if it fits in one transfer and is not synchronous.
        is_readable: It fits in one SDO transfer.
    """

    def __init__(self, config: CanopenObjectConfig) -> None:
        super().__init__(config.name, config.node, frame.TPDO[config.tpdo] + config.node)
        self.unit = config.unit
        self.scale = config.scale
        self.synchronous = config.synchronous
        self.initial: Reading | None = None
        self._config = config
        self._struct = struct.Struct(FORMATS[config.format])
        self.is_readable = self._struct.size <= EXPEDITED_BYTES
        self._counter_at: slice | None = None
        self._modulus = 1  # modulus of the counter

    def setup(self) -> Setup:
        """Check that the TPDO carries the object where the configuration says, and read its present value.

        Raises:
            ConfigurationError: The mapping differs, or a synchronous object is not sent on SYNC.
        """
        config = self._config
        mapping = 0x1A00 + config.tpdo - 1
        mapped = {}  # object and its bits, by the bit it begins at
        offset_bits = 0
        for place in range((yield from read_unsigned(mapping, 0))):
            mapped[offset_bits] = entry = yield from read_unsigned(mapping, place + 1)
            offset_bits += entry & 0xFF
        wanted = config.index << 16 | config.subindex << 8 | 8 * self._struct.size
        if mapped.get(8 * config.byte_offset) != wanted:
            raise ConfigurationError(
                f"TPDO{config.tpdo} has no {config.index:04X}h:{config.subindex:02X} as {config.format} at byte "
                f"{config.byte_offset}: correct the configuration or {mapping:04X}h"
            )
        self._find_counter(mapped)
        if self.synchronous:
            kind = yield from read_unsigned(mapping - 0x200, 2)
            if kind != 1:
                raise ConfigurationError(
                    f"TPDO{config.tpdo} has transmission type {kind}, not 1: write {mapping - 0x200:04X}h"
                )
        elif self.is_readable:
            counter = yield from self.read_counter()
            self.initial = (yield from self.read_value())._replace(counter=counter)

    def decode(self, data: bytes) -> Sample:
        """The object's bytes out of the TPDO. Raises FrameError."""
        config = self._config
        end = config.byte_offset + self._struct.size if self._counter_at is None else self._counter_at.stop
        if len(data) < max(end, config.byte_offset + self._struct.size):
            raise FrameError(f"{self.name}: TPDO of {len(data)} bytes ends before its objects do: check the mapping")
        return Sample(int(self._struct.unpack_from(data, config.byte_offset)[0]))

    def counter(self, data: bytes) -> int | None:
        """The counter of changes out of a TPDO that ``decode`` takes; None where there is none."""
        return None if self._counter_at is None else int.from_bytes(data[self._counter_at], "little")

    def steps(self, before: int, counter: int) -> int:
        """Changes from one value of the counter to another."""
        return (counter - before) % self._modulus

    def read_counter(self) -> Generator[SdoRead | SdoWrite, SdoData, int | None]:
        """Part of a sequence: read the counter of changes; None where there is none."""
        subindex = self._config.counter_subindex
        return None if subindex is None else (yield from read_unsigned(self._config.index, subindex))

    def read_value(self) -> Generator[SdoRead | SdoWrite, SdoData, Reading]:
        """Part of a sequence: read the object.

        Raises:
            ConfigurationError: It is shorter than its format.
        """
        config = self._config
        reply = yield SdoRead(config.index, config.subindex)
        if len(reply.data) < self._struct.size:
            raise ConfigurationError(f"{config.index:04X}h has {len(reply.data)} bytes, {config.format} does not fit")
        return Reading(reply.host_ns, Sample(int(self._struct.unpack_from(reply.data)[0])), None)

    def _find_counter(self, mapped: dict[int, int]) -> None:
        config = self._config
        if config.counter_subindex is None:
            return
        wanted = config.index << 8 | config.counter_subindex
        for offset_bits, entry in mapped.items():
            if entry >> 8 == wanted:
                self._counter_at = slice(offset_bits // 8, (offset_bits + (entry & 0xFF)) // 8)
                self._modulus = 1 << (entry & 0xFF)
                return
        counter = f"{config.index:04X}h:{config.counter_subindex:02X}"
        raise ConfigurationError(f"TPDO{config.tpdo} has no {counter}: drop counter_subindex, or map it")
