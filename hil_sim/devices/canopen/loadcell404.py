"""A CiA 404 strain-gauge transmitter: process value 9130h:1 in newtons and status 6150h:1 on SYNC in TPDO1.

The converter clips at the cell's capacity. 6150h bit 0 (value not valid) follows an overload only when
``flags_overload`` is set: as in the units that were flown, full scale is otherwise a reading like any other.
"""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hil_sim.devices.can_bus.object_dictionary import Abort, Access, DataType, DictionaryError, Entry
from hil_sim.devices.canopen.can_emulator import CanNodeEmulator
from hil_sim.devices.canopen.canopen_node import CanopenNode
from hil_sim.devices.emulator import FORCES, Bench, Equivalent, Twin
from hil_sim.faults import INPUT_KINDS, NO_FAULTS, DeviceFaults, FaultKind, FaultyScalar
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ScalarAnalog
from hil_sim.sensing.sensors import LoadCellSensor

_PROCESS_VALUE = 0x9130_01_20
_STATUS = 0x6150_01_08
_STRAIN_GAUGE = 0x46
_NEWTON = 0x0021_0000  # CiA 303-2: prefix 10^0, numerator N
_ZERO = 0x6F72_657A  # "zero"
_FIELD_FULL_SCALE = 1 << 23  # 24-bit converter
_MAX_DECIMALS = 6


class LoadCell404(CanopenNode):
    """One transmitter with its cell.

    Args:
        node_id: CANopen node number.
        analog: Force on the cell as the converter sees it, N.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        capacity_n: Full scale, N, either way.
        flags_overload: Whether 6150h:1 says that a clipped value is not valid.
        faults: What breaks.

    Raises:
        FaultError: a fault that a load cell cannot have.
    """

    def __init__(
        self,
        node_id: int,
        analog: ScalarAnalog,
        start_ns: int,
        *,
        capacity_n: float = 50.0,
        flags_overload: bool = False,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        super().__init__(node_id, 0x0002_0194, start_ns, faults, (FaultKind.SATURATED, *INPUT_KINDS))
        self._analog = FaultyScalar(analog, faults, start_ns)
        self._capacity_n = capacity_n
        self._flags_overload = flags_overload
        self._tare_n = 0.0
        u8, u16, i32 = DataType.U8, DataType.U16, DataType.I32
        self._add_channel(0x6110, Entry(u16, Access.RO, _STRAIN_GAUGE))
        self._add_channel(0x6112, Entry(u8, Access.RO, 1))  # operating mode: measuring
        self._add_channel(0x6125, Entry(DataType.U32, Access.WO, check=self._auto_zero))
        self._add_channel(0x6131, Entry(DataType.U32, Access.RO, _NEWTON))
        self._decimals = self._add_channel(0x6132, Entry(u8, Access.RW, 4, check=self._check_decimals))  # 0.1 mN
        self._add_channel(0x6150, Entry(u8, Access.RO, read=self.status, mappable=True, read_many=self.statuses))
        self._add_channel(0x9100, Entry(i32, Access.RO, read=self.field_value, mappable=True))
        self._add_channel(
            0x9130, Entry(i32, Access.RO, read=self.process_value, mappable=True, read_many=self.process_values)
        )
        self._sampled = self._add_tpdo(1, 1, (_PROCESS_VALUE, _STATUS))

    def process_value(self, now_ns: int) -> int:
        """Object 9130h:1 at ``now_ns``: force less tare, in units of 10^-decimals N."""
        return round((self._force_n(now_ns) - self._tare_n) * 10.0**self._decimals.value)

    def process_values(self, times_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """``process_value`` at each of ``times_ns`` (n,)."""
        return np.rint((self._forces_n(times_ns) - self._tare_n) * 10.0**self._decimals.value).astype(np.int64)

    def field_value(self, now_ns: int) -> int:
        """Object 9100h:1 at ``now_ns``: counts of the converter."""
        return round(self._force_n(now_ns) / self._capacity_n * (_FIELD_FULL_SCALE - 1))

    def status(self, now_ns: int) -> int:
        """Object 6150h:1 at ``now_ns``."""
        return int(self._flags_overload and abs(self._force_n(now_ns)) >= self._capacity_n)

    def statuses(self, times_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """``status`` at each of ``times_ns`` (n,)."""
        if not self._flags_overload:
            return np.zeros(len(times_ns), np.int64)
        return (np.abs(self._forces_n(times_ns)) >= self._capacity_n).astype(np.int64)

    def _forces_n(self, times_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        return np.clip(self._analog.values(self._times_s(times_ns)), -self._capacity_n, self._capacity_n)

    def _force_n(self, now_ns: int) -> float:
        force_n = self._analog.value(self._seconds(now_ns))
        return min(max(force_n, -self._capacity_n), self._capacity_n)

    def _add_channel(self, index: int, entry: Entry) -> Entry:
        self.dictionary.add(index, 0, Entry(DataType.U8, Access.RO, 1))
        return self.dictionary.add(index, 1, entry)

    def _before_start(self) -> None:
        self._tare_n = 0.0

    def _auto_zero(self, value: int, now_ns: int) -> None:
        if value != _ZERO:
            raise DictionaryError(Abort.VALUE_RANGE)
        self._tare_n = self._force_n(now_ns)

    def _check_decimals(self, value: int, now_ns: int) -> None:
        del now_ns
        if value > _MAX_DECIMALS:
            raise DictionaryError(Abort.VALUE_RANGE)


class LoadCell404Table(CanNodeEmulator):
    """A CiA 404 transmitter."""

    quantities = FORCES

    kind: Literal["loadcell404"]
    flags_overload: bool = False

    vehicle_kind = "cia404"

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        table = cls.node_keys(said) | {"measures": name, "at": said["frame"]}
        return Equivalent(table, {name: sheets.load_cell(said)}, {})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        cell = bench.sensor(LoadCellSensor)
        twin = LoadCell404(
            self.node,
            cell,
            bench.start_ns,
            capacity_n=cell.capacity_N,
            flags_overload=self.flags_overload,
            faults=bench.faults,
        )
        return self.supervised(twin, bench.name)
