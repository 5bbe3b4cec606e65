"""Objects of a CiA 402 servo drive beside those that every drive has; ``servo402`` says what each does."""

from typing import Final

from hil_sim.devices.can_bus.object_dictionary import (
    Abort,
    Access,
    DataType,
    DictionaryError,
    Entry,
    ObjectDictionary,
    Write,
)
from hil_sim.devices.canopen.rpdo import Rpdo

PP, CSP, CST = 1, 8, 10  # modes of operation
NO_WINDOW: Final = 0xFFFF_FFFF


class ServoObjects:
    """Its entries.

    Args:
        dictionary: Where they go.
        node_id: CANopen node number.
        per_rad: Increments in a radian of the joint, for the values at power-up.
    """

    def __init__(self, dictionary: ObjectDictionary, node_id: int, per_rad: float) -> None:
        add, u8, u16, u32 = dictionary.add, DataType.U8, DataType.U16, DataType.U32
        i8, i16, i32, ro, rw = DataType.I8, DataType.I16, DataType.I32, Access.RO, Access.RW
        add(0x1016, 0, Entry(u8, ro, 1))
        self.consumer = add(0x1016, 1, Entry(u32, rw, 0))
        self.abort_option = add(0x6007, 0, Entry(i16, rw, 1, check=_one_of(0, 1, 2, 3)))
        self.stop_option = add(0x605A, 0, Entry(i16, rw, 2, check=_one_of(0, 2, 6)))
        self.fault_option = add(0x605E, 0, Entry(i16, rw, 2, check=_one_of(0, 2)))
        self.mode = add(0x6060, 0, Entry(i8, rw, CSP, check=_one_of(PP, CSP, CST), mappable=True))
        add(0x6061, 0, Entry(i8, ro, read=lambda _: self.mode.value, mappable=True))
        self.demand = add(0x6062, 0, Entry(i32, ro, mappable=True))
        self.window = add(0x6065, 0, Entry(u32, rw, NO_WINDOW))
        self.window_ms = add(0x6066, 0, Entry(u16, rw, 0))
        self.target_torque = add(0x6071, 0, Entry(i16, rw, mappable=True))
        self.target = add(0x607A, 0, Entry(i32, rw, mappable=True))
        add(0x607D, 0, Entry(u8, ro, 2))
        self.least = add(0x607D, 1, Entry(i32, rw))
        self.most = add(0x607D, 2, Entry(i32, rw))
        self.velocity = add(0x6081, 0, Entry(u32, rw, round(0.2 * per_rad), mappable=True))
        self.acceleration = add(0x6083, 0, Entry(u32, rw, round(per_rad)))
        self.deceleration = add(0x6084, 0, Entry(u32, rw, round(per_rad)))
        self.quick_deceleration = add(0x6085, 0, Entry(u32, rw, round(5.0 * per_rad)))
        add(0x60C2, 0, Entry(u8, ro, 2))
        self.interpolation = add(0x60C2, 1, Entry(u8, rw, 1))
        self.interpolation_power = add(0x60C2, 2, Entry(i8, rw, -2))
        self.error = add(0x60F4, 0, Entry(i32, ro, mappable=True))
        add(0x6502, 0, Entry(u32, ro, 1 << PP - 1 | 1 << CSP - 1 | 1 << CST - 1))
        off = 0x8000_0000
        self.rpdos = [Rpdo(dictionary, k, off | 0x100 + 0x100 * k + node_id) for k in (2, 3, 4)]


def _one_of(*values: int) -> Write:
    def check(value: int, now_ns: int) -> None:
        del now_ns
        if value not in values:
            raise DictionaryError(Abort.VALUE_RANGE)

    return check
