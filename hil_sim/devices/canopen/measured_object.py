"""A CANopen node that measures one quantity: an object of its dictionary, in TPDO1 on every SYNC."""

from hil_sim.devices.can_bus.object_dictionary import Access, DataType, Entry
from hil_sim.devices.canopen.canopen_node import CanopenNode
from hil_sim.faults import INPUT_KINDS, NO_FAULTS, DeviceFaults, FaultyScalar
from hil_sim.sensing.analog import ScalarAnalog


class MeasuredObject(CanopenNode):
    """One node.

    Args:
        node_id: CANopen node number.
        device_type: Object 1000h.
        mapped: Its object as it is mapped: index, subindex 0, bits.
        kind: Of the object.
        analog: What it measures.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        step: A count of the object, in units of ``analog``.
        faults: What breaks.

    Raises:
        FaultError: a fault that such a node cannot have.
    """

    def __init__(
        self,
        node_id: int,
        device_type: int,
        mapped: int,
        kind: DataType,
        analog: ScalarAnalog,
        start_ns: int,
        *,
        step: float,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        super().__init__(node_id, device_type, start_ns, faults, INPUT_KINDS)
        self._analog, self._step = FaultyScalar(analog, faults, start_ns), step
        self.dictionary.add(mapped >> 16, 0, Entry(kind, Access.RO, read=self._count, mappable=True))
        self._sampled = self._add_tpdo(1, 1, (mapped,))

    def _count(self, now_ns: int) -> int:
        return round(self._analog.value(self._seconds(now_ns)) / self._step)
