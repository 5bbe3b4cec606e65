"""One receive PDO of a CANopen node (CiA 301, 7.5.2.31 to 7.5.2.34): objects that a frame is written into, and when.

A synchronous one (types 0 to 240) is kept until the next SYNC; types 254 and 255 act at once. A mapping can be changed
while the PDO does not exist (COB-ID bit 31) and its count is 0. A frame shorter than its objects is an error of the
master, reported by EMCY 8210h, and written nowhere.
"""

from typing import Final

from hil_sim.devices.can_bus.object_dictionary import Abort, Access, DataType, DictionaryError, Entry, ObjectDictionary

_INVALID: Final = 0x8000_0000
_LAST_CYCLIC, _FIRST_EVENT = 240, 254
_MAX_MAPPED: Final = 8


class Rpdo:
    """Communication parameter 14xxh and mapping 16xxh.

    Args:
        dictionary: Where its objects go.
        number: 1 to 4.
        cob_id: Default COB-ID, bit 31 set when the PDO does not exist at first.
        transmission_type: 0..240, 254 or 255.
        mapping: Mapped objects as (index << 16 | sub << 8 | bits).
    """

    def __init__(
        self,
        dictionary: ObjectDictionary,
        number: int,
        cob_id: int,
        transmission_type: int = 255,
        mapping: tuple[int, ...] = (),
    ) -> None:
        self._dictionary, self._kept = dictionary, b""
        add, u8, u32, ro, rw = dictionary.add, DataType.U8, DataType.U32, Access.RO, Access.RW
        index = 0x1400 + number - 1
        add(index, 0, Entry(u8, ro, 2))
        self._cob_id = add(index, 1, Entry(u32, rw, cob_id, check=self._check_cob_id))
        self._type = add(index, 2, Entry(u8, rw, transmission_type, check=_check_type))
        index += 0x200
        self._count = add(index, 0, Entry(u8, rw, len(mapping), check=self._check_count))
        entries = (*mapping, *(0,) * (_MAX_MAPPED - len(mapping)))
        self._slots = [
            add(index, 1 + k, Entry(u32, rw, value, check=self._check_slot)) for k, value in enumerate(entries)
        ]

    @property
    def cob_id(self) -> int | None:
        """Identifier that it listens to; None while it does not exist."""
        return None if self._cob_id.value & _INVALID else self._cob_id.value & 0x7FF

    def restart(self) -> None:
        """Forget a frame that waits for SYNC."""
        self._kept = b""

    def take(self, data: bytes, now_ns: int) -> bool:
        """A frame of its identifier came; False if it is too short for its objects."""
        if len(data) < sum(entry.size for entry in self._entries()):
            return False
        if self._type.value <= _LAST_CYCLIC:
            self._kept = data
        else:
            self._write(data, now_ns)
        return True

    def on_sync(self, now_ns: int) -> None:
        """What waited for the SYNC acts."""
        if self._kept:
            data, self._kept = self._kept, b""
            self._write(data, now_ns)

    def _write(self, data: bytes, now_ns: int) -> None:
        at = 0
        for entry in self._entries():
            value = int.from_bytes(data[at : at + entry.size], "little", signed=entry.data_type.value[1].islower())
            at += entry.size
            try:
                if entry.check is not None:
                    entry.check(value, now_ns)
            except DictionaryError:
                continue  # a value that the device does not take
            entry.value = value
            if entry.changed is not None:
                entry.changed(value, now_ns)

    def _entries(self) -> list[Entry]:
        return [self._entry(slot.value) for slot in self._slots[: self._count.value]]

    def _entry(self, mapping: int) -> Entry:
        entry = self._dictionary.find(mapping >> 16, mapping >> 8 & 0xFF)
        if not entry.mappable or entry.access is Access.RO or mapping & 0xFF != 8 * entry.size:
            raise DictionaryError(Abort.NOT_MAPPABLE)
        return entry

    def _check_cob_id(self, value: int, now_ns: int) -> None:
        del now_ns
        if value & 0x3FFF_F800 or (self.cob_id is not None and not value & _INVALID and value & 0x7FF != self.cob_id):
            raise DictionaryError(Abort.VALUE_RANGE)

    def _check_slot(self, value: int, now_ns: int) -> None:
        del now_ns
        if self.cob_id is not None or self._count.value:
            raise DictionaryError(Abort.UNSUPPORTED_ACCESS)
        if value:
            self._entry(value)

    def _check_count(self, value: int, now_ns: int) -> None:
        del now_ns
        if self.cob_id is not None:
            raise DictionaryError(Abort.UNSUPPORTED_ACCESS)
        if value > _MAX_MAPPED:
            raise DictionaryError(Abort.VALUE_RANGE)
        if sum(self._entry(slot.value).size for slot in self._slots[:value]) > 8:
            raise DictionaryError(Abort.PDO_LENGTH)


def _check_type(value: int, now_ns: int) -> None:
    del now_ns
    if _LAST_CYCLIC < value < _FIRST_EVENT:
        raise DictionaryError(Abort.VALUE_RANGE)
