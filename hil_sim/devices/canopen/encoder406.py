"""A CiA 406 absolute encoder: position 6004h by event timer in TPDO1 and on SYNC in TPDO2 (DS 406 v3.1).

The encoder sits on the joint side: one revolution of the joint is ``counts_per_revolution`` counts, gear and x4
decoding included. 6004h is unsigned and wraps modulo 2^32.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hil_sim.devices.can_bus.object_dictionary import Abort, Access, DataType, DictionaryError, Entry
from hil_sim.devices.canopen.can_emulator import CanNodeEmulator
from hil_sim.devices.canopen.canopen_node import CanopenNode
from hil_sim.devices.emulator import Bench, Equivalent, Twin
from hil_sim.faults import ENCODER_KINDS, NO_FAULTS, DeviceFaults, FaultyScalar
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.analog import ScalarAnalog
from hil_sim.sensing.sensors import EncoderSensor

_POSITION = 0x6004_00_20
_CODE_SEQUENCE, _SCALING = 0x0001, 0x0004


class Encoder406(CanopenNode):
    """One encoder.

    Args:
        node_id: CANopen node number.
        analog: Joint angle, rad.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        zero_count: Reading at angle zero.
        counts_per_revolution: 6501h, and the default of 6001h.
        faults: What breaks.

    Raises:
        FaultError: a fault that an encoder cannot have.
    """

    def __init__(
        self,
        node_id: int,
        analog: ScalarAnalog,
        start_ns: int,
        *,
        zero_count: int = 0,
        counts_per_revolution: int = 500_000,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        super().__init__(node_id, 0x0002_0196, start_ns, faults, ENCODER_KINDS)
        self._analog = FaultyScalar(analog, faults, start_ns)
        self._zero_count = zero_count
        add, u16, u32 = self.dictionary.add, DataType.U16, DataType.U32
        self._operating = add(0x6000, 0, Entry(u16, Access.RW, _SCALING, check=self._check_operating))
        self._units = add(0x6001, 0, Entry(u32, Access.RW, counts_per_revolution, check=self._check_units))
        add(0x6003, 0, Entry(u32, Access.RW, 0, changed=self._set_preset))
        add(0x6004, 0, Entry(u32, Access.RO, read=self.position, mappable=True, read_many=self.positions))
        add(0x6200, 0, Entry(u16, Access.RW, read=lambda _: self._tpdo_1.event_timer.value, changed=self._set_cycle))
        add(0x6500, 0, Entry(u16, Access.RO, read=lambda _: self._operating.value))
        add(0x6501, 0, Entry(u32, Access.RO, counts_per_revolution))
        add(0x6502, 0, Entry(u16, Access.RO, 8589 % 65536))  # revolutions in 2^32 counts
        add(0x6503, 0, Entry(u16, Access.RO, 0, mappable=True))  # alarms
        add(0x6505, 0, Entry(u16, Access.RO, 0, mappable=True))  # warnings
        self._tpdo_1 = self._add_tpdo(1, 254, (_POSITION,), event_timer_ms=20)
        self._sampled = self._add_tpdo(2, 1, (_POSITION,))
        self._physical = counts_per_revolution
        self._before_start()

    @property
    def produced_cyclic(self) -> int:
        """TPDO1 samples (event timer)."""
        return self._tpdo_1.produced

    def position(self, now_ns: int) -> int:
        """Object 6004h at ``now_ns``."""
        return (self._counts(now_ns) + self._offset) & 0xFFFF_FFFF

    def positions(self, times_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """``position`` at each of ``times_ns`` (n,)."""
        angles = self._analog.values(self._times_s(times_ns))
        counts = np.rint(angles / math.tau * self._per_revolution).astype(np.int64)
        signed: NDArray[np.int64] = -counts if self._operating.value & _CODE_SEQUENCE else counts
        return signed + self._offset & 0xFFFF_FFFF

    @property
    def _per_revolution(self) -> int:
        return self._units.value if self._operating.value & _SCALING else self._physical

    def _counts(self, now_ns: int) -> int:
        counts = round(self._analog.value(self._seconds(now_ns)) / math.tau * self._per_revolution)
        return -counts if self._operating.value & _CODE_SEQUENCE else counts

    def _before_start(self) -> None:
        self._offset = self._zero_count

    def _set_preset(self, value: int, now_ns: int) -> None:
        self._offset = value - self._counts(now_ns)

    def _set_cycle(self, value: int, now_ns: int) -> None:
        """6200h is hard-wired to 1800h:5."""
        self._tpdo_1.event_timer.value = value
        self._arm_event_timer(self._tpdo_1, now_ns)

    def _check_units(self, value: int, now_ns: int) -> None:
        del now_ns
        if not 1 <= value <= self._physical:
            raise DictionaryError(Abort.VALUE_RANGE)

    def _check_operating(self, value: int, now_ns: int) -> None:
        del now_ns
        if value & ~(_CODE_SEQUENCE | _SCALING):
            raise DictionaryError(Abort.VALUE_RANGE)


class Encoder406Table(CanNodeEmulator):
    """A CiA 406 encoder."""

    quantities = ("joint_angle",)

    kind: Literal["encoder406"]
    zero_count: Annotated[int, Field(ge=0, lt=2**32)] = 0

    vehicle_kind = "cia406"

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        table = {"zero_count": said.get("zero_count", 0) % 2**32, "measures": name, "at": said["joint"]}
        return Equivalent(cls.node_keys(said) | table, {name: sheets.encoder(name, said)}, {})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        encoder = bench.sensor(EncoderSensor)
        counts = encoder.counts_per_revolution
        twin = Encoder406(
            self.node,
            encoder,
            bench.start_ns,
            zero_count=self.zero_count,
            counts_per_revolution=counts,
            faults=bench.faults,
        )
        return self.supervised(twin, bench.name)
