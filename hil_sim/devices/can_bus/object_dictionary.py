"""A CANopen object dictionary of numbers, and the reasons for which it refuses an access (CiA 301)."""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum

import numpy as np
from numpy.typing import NDArray


class Abort(IntEnum):
    """SDO abort codes (CiA 301, table of abort codes)."""

    COMMAND = 0x05040001
    UNSUPPORTED_ACCESS = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_LENGTH = 0x06040042
    LENGTH = 0x06070010
    NO_SUBINDEX = 0x06090011
    VALUE_RANGE = 0x06090030


class DictionaryError(Exception):
    """An access that the dictionary refuses."""

    def __init__(self, code: Abort) -> None:
        super().__init__(f"SDO abort {code:08X}h")
        self.code = code


class DataType(StrEnum):
    """Number types, as ``struct`` writes them."""

    U8 = "<B"
    U16 = "<H"
    U32 = "<I"
    I8 = "<b"
    I16 = "<h"
    I32 = "<i"


class Access(StrEnum):
    """Who may do what over SDO."""

    RO = "ro"
    RW = "rw"
    WO = "wo"


Read = Callable[[int], int]
ReadMany = Callable[[NDArray[np.int64]], NDArray[np.int64]]
Write = Callable[[int, int], None]


@dataclass(slots=True)
class Entry:
    """One sub-object.

    Attributes:
        data_type: Its type on the wire.
        access: SDO access.
        value: The stored value, used where ``read`` is None.
        read: The live value at a time in ns.
        check: Called with (value, now_ns) before a write is stored; refuses by ``DictionaryError``.
        changed: Called with (value, now_ns) after a write was stored.
        mappable: Whether a TPDO may carry it.
        read_many: ``read`` at many times at once.
    """

    data_type: DataType
    access: Access
    value: int = 0
    read: Read | None = None
    check: Write | None = None
    changed: Write | None = None
    mappable: bool = False
    read_many: ReadMany | None = None
    _number: struct.Struct = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._number = struct.Struct(self.data_type.value)

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return self._number.size

    def now(self, now_ns: int) -> int:
        """Value at ``now_ns``."""
        return self.value if self.read is None else self.read(now_ns)

    def pack(self, now_ns: int) -> bytes:
        """Value at ``now_ns`` as it goes over the wire."""
        return self._number.pack(self.value if self.read is None else self.read(now_ns))

    def pack_many(self, times_ns: NDArray[np.int64]) -> NDArray[np.uint8]:
        """``pack`` at each of ``times_ns`` (n,): shape (n, bytes)."""
        values = np.empty(len(times_ns), self.data_type.value)
        if self.read is None:
            values[:] = self.value
        elif self.read_many is not None:
            values[:] = self.read_many(times_ns)
        else:
            values[:] = [self.read(now_ns) for now_ns in times_ns.tolist()]
        return values.view(np.uint8).reshape(len(values), -1)


class ObjectDictionary:
    """Sub-objects by (index, sub-index), with the values they had at power-up."""

    def __init__(self) -> None:
        self._entries: dict[tuple[int, int], Entry] = {}
        self._defaults: dict[tuple[int, int], int] = {}
        self._indices: set[int] = set()

    def add(self, index: int, sub: int, entry: Entry) -> Entry:
        """Put a sub-object in; its present value is what a reset brings back."""
        self._entries[index, sub] = entry
        self._defaults[index, sub] = entry.value
        self._indices.add(index)
        return entry

    def remove(self, index: int, sub: int) -> None:
        """Take a sub-object out."""
        del self._entries[index, sub], self._defaults[index, sub]
        self._indices = {index for index, _ in self._entries}

    def find(self, index: int, sub: int) -> Entry:
        """The sub-object.

        Raises:
            DictionaryError: there is none.
        """
        entry = self._entries.get((index, sub))
        if entry is None:
            raise DictionaryError(Abort.NO_SUBINDEX if index in self._indices else Abort.NO_OBJECT)
        return entry

    def upload(self, index: int, sub: int, now_ns: int) -> bytes:
        """Answer an SDO read.

        Raises:
            DictionaryError: no such object, or write-only.
        """
        entry = self.find(index, sub)
        if entry.access is Access.WO:
            raise DictionaryError(Abort.WRITE_ONLY)
        return entry.pack(now_ns)

    def download(self, index: int, sub: int, data: bytes, *, sized: bool, now_ns: int) -> None:
        """Obey an SDO write.

        Args:
            index: Object.
            sub: Sub-object.
            data: Its bytes; all four of the frame when ``sized`` is False.
            sized: Whether the client said how many bytes it means.
            now_ns: Time of the write.

        Raises:
            DictionaryError: no such object, read-only, wrong length, or a value that the device refuses.
        """
        entry = self.find(index, sub)
        if entry.access is Access.RO:
            raise DictionaryError(Abort.READ_ONLY)
        if sized and len(data) != entry.size:
            raise DictionaryError(Abort.LENGTH)
        value: int = struct.unpack(entry.data_type, data[: entry.size])[0]
        if entry.check is not None:
            entry.check(value, now_ns)
        entry.value = value
        if entry.changed is not None:
            entry.changed(value, now_ns)

    def reset(self, first: int = 0x0000, last: int = 0xFFFF) -> None:
        """Bring the power-up values of the objects ``first..last`` back."""
        for (index, sub), value in self._defaults.items():
            if first <= index <= last:
                self._entries[index, sub].value = value
