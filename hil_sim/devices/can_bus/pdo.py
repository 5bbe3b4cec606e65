"""What transmit and receive PDOs of a CANopen node have in common (CiA 301, 7.5.2.31 to 7.5.2.38)."""

from collections.abc import Callable
from typing import Final

from hil_sim.devices.can_bus.object_dictionary import Abort, Access, DataType, DictionaryError, Entry, ObjectDictionary

LAST_CYCLIC, FIRST_EVENT = 240, 254  # transmission types
_INVALID: Final = 0x8000_0000  # COB-ID bit 31: the PDO does not exist
_MAX_MAPPED: Final = 8


class Pdo:
    """COB-ID, transmission type and mapping.

    A parameter that must not change while the PDO exists is refused with 06090030h, a mapping that must not change
    with 06010000h: it can be changed while the PDO does not exist (COB-ID bit 31) and its count is 0.

    Args:
        dictionary: Where its objects go.
        index: Of its communication parameter; its mapping is 200h further.
        highest: Sub-index of the communication parameter.
        cob_id: Default COB-ID, bit 31 set when the PDO does not exist at first.
        transmission_type: Default of sub-index 2.
        mapping: Mapped objects as (index << 16 | sub << 8 | bits).
        remapped: Called with a new count of mapped objects and the time.
    """

    _LOWEST_TYPE = 0

    def __init__(
        self,
        dictionary: ObjectDictionary,
        index: int,
        highest: int,
        cob_id: int,
        transmission_type: int,
        mapping: tuple[int, ...],
        remapped: Callable[[int, int], None] | None = None,
    ) -> None:
        self._dictionary = dictionary
        add, u8, u32, ro, rw = dictionary.add, DataType.U8, DataType.U32, Access.RO, Access.RW
        add(index, 0, Entry(u8, ro, highest))
        self._cob_id = add(index, 1, Entry(u32, rw, cob_id, check=self._check_cob_id))
        self._type = add(index, 2, Entry(u8, rw, transmission_type, check=self._check_type))
        index += 0x200
        self._count = add(index, 0, Entry(u8, rw, len(mapping), check=self._check_count, changed=remapped))
        entries = (*mapping, *(0,) * (_MAX_MAPPED - len(mapping)))
        self._slots = [
            add(index, 1 + k, Entry(u32, rw, value, check=self._check_slot)) for k, value in enumerate(entries)
        ]

    @property
    def valid(self) -> bool:
        """Whether the PDO exists."""
        return not self._cob_id.value & _INVALID

    @property
    def cob_id(self) -> int:
        """Identifier of its frames."""
        return self._cob_id.value & 0x7FF

    def _entries(self) -> list[Entry]:
        return [self._entry(slot.value) for slot in self._slots[: self._count.value]]

    def _entry(self, mapping: int) -> Entry:
        entry = self._dictionary.find(mapping >> 16, mapping >> 8 & 0xFF)
        if not entry.mappable or mapping & 0xFF != 8 * entry.size:
            raise DictionaryError(Abort.NOT_MAPPABLE)
        return entry

    def _check_cob_id(self, value: int, now_ns: int) -> None:
        del now_ns
        if value & 0x3FFF_F800 or (self.valid and not value & _INVALID and value & 0x7FF != self.cob_id):
            raise DictionaryError(Abort.VALUE_RANGE)

    def _check_type(self, value: int, now_ns: int) -> None:
        del now_ns
        if value < self._LOWEST_TYPE or LAST_CYCLIC < value < FIRST_EVENT:
            raise DictionaryError(Abort.VALUE_RANGE)

    def _check_slot(self, value: int, now_ns: int) -> None:
        del now_ns
        if self.valid or self._count.value:
            raise DictionaryError(Abort.UNSUPPORTED_ACCESS)
        if value:
            self._entry(value)

    def _check_count(self, value: int, now_ns: int) -> None:
        del now_ns
        if self.valid:
            raise DictionaryError(Abort.UNSUPPORTED_ACCESS)
        if value > _MAX_MAPPED:
            raise DictionaryError(Abort.VALUE_RANGE)
        if sum(self._entry(slot.value).size for slot in self._slots[:value]) > 8:
            raise DictionaryError(Abort.PDO_LENGTH)
