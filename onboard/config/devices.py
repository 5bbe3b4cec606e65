"""``[device.*]``: every kind of device that a vehicle may carry, and the kind of bus it needs."""

from typing import Annotated, Literal, get_args

from pydantic import BaseModel, Field

from onboard.config.types import NotNegative, Positive, Section, Vector3


class _Device(Section):
    bus: str


class Mpu6050Device(_Device):
    """MPU-6050 family IMU over I2C, drained from its FIFO."""

    kind: Literal["mpu6050"]
    address: Annotated[int, Field(ge=0x68, le=0x69)] = 0x68
    frame: str
    sample_rate_hz: Annotated[int, Field(ge=4, le=1000)] = 1000
    accel_range_g: Literal[2, 4, 8, 16] = 4
    gyro_range_deg_s: Literal[250, 500, 1000, 2000] = 250
    filter_code: Annotated[int, Field(ge=0, le=6)] = 2
    poll_period_ms: Positive = 10
    accel_noise_m_s2: Positive
    gyro_noise_rad_s: Positive


class CanopenSyncDevice(_Device):
    """The SYNC messages on a CAN bus; ``delay_ms`` is the time a SYNC frame takes on the wire."""

    kind: Literal["canopen_sync"]
    period_ms: Positive
    delay_ms: NotNegative = 0.0


class Cia406Device(_Device):
    """Encoder node (CiA 406), sampled on SYNC."""

    kind: Literal["cia406"]
    node: Annotated[int, Field(ge=1, le=127)]
    joint: str
    counts_per_revolution: Annotated[int, Field(gt=0)]
    zero_count: int = 0
    noise_rad: Positive


class Cia404Device(_Device):
    """Load cell node (CiA 404), sampled on SYNC.

    ``measures = "moment"``: the cell's force times ``lever_m`` is the moment about ``axis`` of ``frame`` that the
    actuator exerts on everything beyond that frame. ``measures = "force"``: its force along ``axis``.
    """

    kind: Literal["cia404"]
    node: Annotated[int, Field(ge=1, le=127)]
    frame: str
    axis: Vector3
    measures: Literal["moment", "force"]
    lever_m: Positive = 1.0
    lever_sigma_m: NotNegative = 0.0
    capacity_N: Positive  # noqa: N815  (the newton's own letter)
    scale_sigma: NotNegative = 0.0
    noise_N: Positive  # noqa: N815
    delay_ms: NotNegative = 0.0
    delay_sigma_ms: NotNegative = 0.0


class CanopenObjectDevice(_Device):
    """Any object a CANopen node maps into a TPDO that it sends on change."""

    kind: Literal["canopen_object"]
    node: Annotated[int, Field(ge=1, le=127)]
    tpdo: Annotated[int, Field(ge=1, le=4)]
    byte_offset: Annotated[int, Field(ge=0, le=7)] = 0
    format: Literal["u8", "i8", "u16", "i16", "u32", "i32"]
    unit: str = "1"
    scale: float = 1.0
    index: Annotated[int, Field(ge=0, le=0xFFFF)]
    subindex: Annotated[int, Field(ge=0, le=0xFF)]


class RecordedImu(Section):
    """An IMU of a recording from elsewhere (``heft import``): its host stamps are its sample times."""

    kind: Literal["recorded_imu"]
    frame: str
    period_ms: Positive
    accel_noise_m_s2: Positive
    gyro_noise_rad_s: Positive


class RecordedRate(Section):
    """A joint rate of a recording from elsewhere; the joint turns a body of revolution, its angle is of no account."""

    kind: Literal["recorded_rate"]
    joint: str
    period_ms: Positive
    noise_rad_s: Positive


class SyncPulseDevice(_Device):
    """The sync pulse line; intervals between pulses are whole numbers of ``sync_period_ms``."""

    kind: Literal["sync_pulse"]
    sync_period_ms: Positive


BusDevice = Mpu6050Device | CanopenSyncDevice | Cia406Device | Cia404Device | CanopenObjectDevice | SyncPulseDevice
RecordedDevice = RecordedImu | RecordedRate
BUS_OF: dict[type[BaseModel], str] = {
    Mpu6050Device: "I2C",
    CanopenSyncDevice: "CAN",
    Cia406Device: "CAN",
    Cia404Device: "CAN",
    CanopenObjectDevice: "CAN",
    SyncPulseDevice: "a pulse line",
}
DEVICES: tuple[type[BaseModel], ...] = (*get_args(BusDevice), *get_args(RecordedDevice))
Device = Annotated[BusDevice | RecordedDevice, Field(discriminator="kind")]
