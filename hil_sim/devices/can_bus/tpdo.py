"""One transmit PDO of a CANopen node (CiA 301, 7.5.2.35 to 7.5.2.38): its objects, and when it is to be sent."""

import numpy as np
from numpy.typing import NDArray

from hil_sim.devices.can_bus.object_dictionary import Abort, Access, DataType, DictionaryError, Entry, ObjectDictionary
from hil_sim.devices.can_bus.pdo import FIRST_EVENT, LAST_CYCLIC, Pdo

ANSWER_NS = 40_000  # from the end of a SYNC until the TPDO that answers it is offered to the bus


class Tpdo(Pdo):
    """Communication parameter 18xxh, mapping 1Axxh and the SYNC counting of one TPDO.

    Type 0 (on the SYNC after an event) is not offered.

    Args:
        dictionary: Where its objects go.
        number: 1 to 4.
        cob_id: Default COB-ID, bit 31 set when the PDO does not exist at first.
        transmission_type: 1..240 (every n-th SYNC), 254 or 255 (event).
        mapping: Mapped objects as (index << 16 | sub << 8 | bits).
        event_timer_ms: Default of sub-index 5.
    """

    _LOWEST_TYPE = 1

    def __init__(
        self,
        dictionary: ObjectDictionary,
        number: int,
        cob_id: int,
        transmission_type: int,
        mapping: tuple[int, ...],
        event_timer_ms: int = 0,
    ) -> None:
        self.number = number
        self.produced = 0
        self.pending = False  # an event that waits for the inhibit time
        self._syncs = 0
        self._started = False
        index = 0x1800 + number - 1
        super().__init__(dictionary, index, 6, cob_id, transmission_type, mapping, self._compile)
        self._inhibit = dictionary.add(index, 3, Entry(DataType.U16, Access.RW, 0, check=self._check_not_valid))
        self.event_timer = dictionary.add(index, 5, Entry(DataType.U16, Access.RW, event_timer_ms))
        self._start = dictionary.add(index, 6, Entry(DataType.U8, Access.RW, 0, check=self._check_not_valid))
        self._mapped: list[Entry] = []

    @property
    def on_event(self) -> bool:
        """Whether events and the event timer send it (types 254 and 255)."""
        return self._type.value >= FIRST_EVENT

    @property
    def inhibit_ns(self) -> int:
        """Shortest time between two event-driven transmissions."""
        return self._inhibit.value * 100_000

    @property
    def every_sync(self) -> bool | None:
        """Whether it answers each SYNC from now on, or none; None where it counts them or waits for a first one."""
        kind = self._type.value
        if kind > LAST_CYCLIC or not self.valid:
            return False
        return True if kind == 1 and self._started and self._mapped else None

    def restart(self) -> None:
        """Forget SYNCs and events; to be called on entering Operational and after the dictionary was reset."""
        self._syncs = 0
        self._started = False
        self.pending = False
        self._compile(0, 0)

    def on_sync(self, counter: int | None) -> bool:
        """Count a SYNC; True when the PDO answers this one.

        Args:
            counter: The SYNC counter, None for a SYNC without one.
        """
        kind = self._type.value
        if kind > LAST_CYCLIC or not self.valid:
            return False
        if not self._started:
            start = self._start.value
            if start and counter is not None and counter != start:
                return False
            self._started = True
        self._syncs += 1
        if self._syncs < kind:
            return False
        self._syncs = 0
        return True

    def sample(self, now_ns: int) -> bytes:
        """Contents at ``now_ns``; counts as produced."""
        self.produced += 1
        self.pending = False
        mapped = self._mapped
        return mapped[0].pack(now_ns) if len(mapped) == 1 else b"".join([entry.pack(now_ns) for entry in mapped])

    def samples(self, times_ns: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Contents at each of ``times_ns`` (n,), which do not count as produced before ``answered``: (n, bytes)."""
        return np.concatenate([entry.pack_many(times_ns) for entry in self._mapped], axis=1)

    def answered(self, count: int) -> None:
        """So many of ``samples`` are sent."""
        self.produced += count
        self.pending = False

    def _compile(self, value: int, now_ns: int) -> None:
        del value, now_ns
        self._mapped = self._entries()

    def _check_not_valid(self, value: int, now_ns: int) -> None:
        del value, now_ns
        if self.valid:
            raise DictionaryError(Abort.VALUE_RANGE)
