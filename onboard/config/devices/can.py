"""Devices on CAN: CANopen nodes, and the SYNC that all of them on one bus answer."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.canopen_pdo.cia402 import Cia402Config
from drivers.canopen_pdo.cia404 import Cia404Config
from drivers.canopen_pdo.cia406 import Cia406Config
from drivers.canopen_pdo.guarding import GuardConfig
from drivers.canopen_pdo.mapped_object import CanopenObjectConfig
from drivers.canopen_pdo.sync import SyncConfig
from drivers.records import CAN_SYNC, SCALAR
from onboard.config.devices.base import BusDevice, BusType, Channels, JointDevice, LoadCellDevice
from onboard.config.types import NotNegative, Positive


class CanopenSyncDevice(BusDevice):
    """The SYNC messages on a CAN bus; ``delay_ms`` is the time a SYNC frame takes on the wire."""

    bus_type = BusType.CAN
    records = CAN_SYNC
    kind: Literal["canopen_sync"]
    period_ms: Positive
    delay_ms: NotNegative = 0.0

    @property
    def nominal_hz(self) -> float:
        """Nominal."""
        return 1e3 / self.period_ms

    def settings(self, name: str) -> SyncConfig:
        """See ``BusDevice``."""
        return SyncConfig(name, self.period_ms)


class CanopenNode(BusDevice):
    """A CANopen node, or a channel of one.

    ``supervision = "guarding"``: where the node makes no heartbeat it is asked every ``guard_time_ms`` whether it
    lives, and is lost after ``life_time_factor`` questions without an answer.
    """

    bus_type = BusType.CAN
    records = SCALAR
    node: Annotated[int, Field(ge=1, le=127)]
    supervision: Literal["heartbeat", "guarding"] = "heartbeat"
    guard_time_ms: int = GuardConfig.guard_time_ms
    life_time_factor: int = GuardConfig.life_time_factor

    @property
    def nominal_hz(self) -> None:
        """One for each SYNC."""
        return None

    @property
    def guard(self) -> GuardConfig | None:
        """How the node is guarded, if it is.

        Raises:
            ConfigurationError: a time or factor that guarding does not have.
        """
        guarded = self.supervision == "guarding"
        return GuardConfig(self.node, self.guard_time_ms, self.life_time_factor) if guarded else None


class Cia406Device(CanopenNode, JointDevice):
    """Encoder node (CiA 406), sampled on SYNC."""

    kind: Literal["cia406"]
    counts_per_revolution: Annotated[int, Field(gt=0)]

    def settings(self, name: str) -> Cia406Config:
        """See ``BusDevice``."""
        return self._settings(Cia406Config, name=name)


class Cia402Device(CanopenNode, JointDevice):
    """Drive (CiA 402), sampled on SYNC: its position is the joint's, velocity and torque are recorded where wanted.

    ``velocity_scale_rad_s``: the drive's unit of velocity; counts a second where not given. ``rated_torque_N_m``: read
    from the drive where not given. ``gear_ratio``: revolutions of the motor in one of the joint, for the torque.
    """

    kind: Literal["cia402"]
    counts_per_revolution: Annotated[int, Field(gt=0)]
    velocity: bool = False
    torque: bool = False
    velocity_scale_rad_s: float | None = None
    rated_torque_N_m: float | None = None  # noqa: N815
    gear_ratio: float = Cia402Config.gear_ratio
    tpdos: tuple[int, ...] = Cia402Config.tpdos

    def channels(self, name: str) -> Channels:
        """Position, velocity, torque."""
        return dict.fromkeys(self.settings(name).names, SCALAR)

    def settings(self, name: str) -> Cia402Config:
        """See ``BusDevice``."""
        velocity = f"{name}_velocity" if self.velocity else None
        torque = f"{name}_torque" if self.torque else None
        return self._settings(Cia402Config, position=name, velocity=velocity, torque=torque)


class Cia404Device(CanopenNode, LoadCellDevice):
    """Load cell node (CiA 404), sampled on SYNC. ``tare``: zero it when it is first set up, unloaded."""

    kind: Literal["cia404"]
    tare: bool = Cia404Config.tare

    def settings(self, name: str) -> Cia404Config:
        """See ``BusDevice``."""
        return self._settings(Cia404Config, name=name)


class CanopenObjectDevice(CanopenNode):
    """Any object a CANopen node maps into a TPDO that it sends on change, or, where ``synchronous``, on every SYNC.

    ``counter_subindex``: of an object of the same index in the same TPDO that counts the changes.
    """

    kind: Literal["canopen_object"]
    tpdo: Annotated[int, Field(ge=1, le=4)]
    byte_offset: Annotated[int, Field(ge=0, le=7)] = 0
    format: Literal["u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64"]
    unit: Annotated[str, Field(max_length=8)] = CanopenObjectConfig.unit
    scale: float = CanopenObjectConfig.scale
    index: Annotated[int, Field(ge=0, le=0xFFFF)]
    subindex: Annotated[int, Field(ge=0, le=0xFF)]
    counter_subindex: Annotated[int, Field(ge=0, le=0xFF)] | None = None
    synchronous: bool = CanopenObjectConfig.synchronous

    def settings(self, name: str) -> CanopenObjectConfig:
        """See ``BusDevice``."""
        return self._settings(CanopenObjectConfig, name=name)
