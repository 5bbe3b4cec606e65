"""Any object that a CANopen node maps into a TPDO."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.canopen_pdo.guarding import GuardConfig
from drivers.canopen_pdo.profiles.mapped_object import CanopenObjectConfig
from onboard.devices.can.canopen import CanopenNodeDevice


class MappedObjectDevice(CanopenNodeDevice):
    """An object that a CANopen node maps into a TPDO."""

    is_profile = False
    driver_configs = (CanopenObjectConfig, GuardConfig)
    tpdo: Annotated[int, Field(ge=1, le=4)]
    byte_offset: Annotated[int, Field(ge=0, le=7)] = 0
    format: Literal["u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64"]
    scale: float = CanopenObjectConfig.scale
    index: Annotated[int, Field(ge=0, le=0xFFFF)]
    subindex: Annotated[int, Field(ge=0, le=0xFF)]

    def settings(self, name: str) -> CanopenObjectConfig:
        """See ``BusDevice``."""
        return self._settings(CanopenObjectConfig, name=name)


class CanopenObjectDevice(MappedObjectDevice):
    """Any object a CANopen node maps into a TPDO that it sends on change, or, where ``synchronous``, on every SYNC.

    ``counter_subindex``: of an object of the same index in the same TPDO that counts the changes.
    """

    about_role = "none, or the phases"
    about_clock = (
        "The number of the SYNC that it answers where `synchronous`, else none: a phase counts from its arrival."
    )
    kind: Literal["canopen_object"]
    unit: Annotated[str, Field(max_length=8)] = CanopenObjectConfig.unit
    counter_subindex: Annotated[
        Annotated[int, Field(ge=0, le=0xFF)] | None,
        Field(description="Of an object of the same index in the same TPDO that counts the changes."),
    ] = None
    synchronous: bool = CanopenObjectConfig.synchronous

    @property
    def answers_sync(self) -> bool:
        """See ``CanopenNodeDevice``."""
        return self.synchronous

    @property
    def tells_changes(self) -> bool:
        """See ``BusDevice``."""
        return not self.synchronous
