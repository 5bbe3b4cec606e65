"""One receive PDO of a CANopen node (CiA 301, 7.5.2.31 to 7.5.2.34): objects that a frame is written into, and when.

A synchronous one (types 0 to 240) is kept until the next SYNC; types 254 and 255 act at once. A frame shorter than its
objects is an error of the master, reported by EMCY 8210h, and written nowhere.
"""

from hil_sim.devices.can_bus.object_dictionary import Abort, Access, DictionaryError, Entry, ObjectDictionary
from hil_sim.devices.can_bus.pdo import LAST_CYCLIC, Pdo


class Rpdo(Pdo):
    """Communication parameter 14xxh and mapping 16xxh.

    Args:
        dictionary: Where its objects go.
        number: 1 to 4.
        cob_id: Default COB-ID, bit 31 set when the PDO does not exist at first.
        mapping: Mapped objects as (index << 16 | sub << 8 | bits).
    """

    def __init__(self, dictionary: ObjectDictionary, number: int, cob_id: int, mapping: tuple[int, ...] = ()) -> None:
        super().__init__(dictionary, 0x1400 + number - 1, 2, cob_id, 255, mapping)
        self._kept = b""

    def restart(self) -> None:
        """Forget a frame that waits for SYNC."""
        self._kept = b""

    def take(self, data: bytes, now_ns: int) -> bool:
        """A frame of its identifier came; False if it is too short for its objects."""
        if len(data) < sum(entry.size for entry in self._entries()):
            return False
        if self._type.value <= LAST_CYCLIC:
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

    def _entry(self, mapping: int) -> Entry:
        entry = super()._entry(mapping)
        if entry.access is Access.RO:
            raise DictionaryError(Abort.NOT_MAPPABLE)
        return entry
