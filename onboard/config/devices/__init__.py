"""``[device.*]``: every kind of device that a vehicle may carry, a file for each kind of bus."""

from typing import Annotated, get_args

from pydantic import Field

from onboard.config.devices.base import (
    BusDevice,
    BusType,
    Channels,
    DeviceSection,
    ImuDevice,
    JointDevice,
    LoadCellDevice,
    LoadCellKeys,
)
from onboard.config.devices.can import (
    CanopenNode,
    CanopenObjectDevice,
    CanopenSyncDevice,
    Cia402Device,
    Cia404Device,
    Cia406Device,
)
from onboard.config.devices.i2c import Mpu6050Device
from onboard.config.devices.node_channels import (
    CHANNELS,
    AccelChannel,
    ForceChannel,
    GyroChannel,
    JointChannel,
    RecordChannel,
)
from onboard.config.devices.pulse import PpsDevice, PulseGeneratorDevice, SyncPulseDevice
from onboard.config.devices.recorded import (
    RecordedAngle,
    RecordedDevice,
    RecordedImu,
    RecordedLoadCell,
    RecordedRate,
    RecordedValue,
)
from onboard.config.devices.serial import (
    DscLoadCellDevice,
    ModbusLoadCellDevice,
    NimuDevice,
    NodeFrameDevice,
    QsbDevice,
)

AnyDevice = (
    Mpu6050Device
    | NimuDevice
    | Cia406Device
    | Cia402Device
    | QsbDevice
    | Cia404Device
    | ModbusLoadCellDevice
    | DscLoadCellDevice
    | NodeFrameDevice
    | CanopenObjectDevice
    | CanopenSyncDevice
    | SyncPulseDevice
    | PpsDevice
    | PulseGeneratorDevice
    | RecordedImu
    | RecordedAngle
    | RecordedRate
    | RecordedLoadCell
    | RecordedValue
)
DEVICES: dict[str, type[DeviceSection]] = {
    get_args(kind.model_fields["kind"].annotation)[0]: kind for kind in get_args(AnyDevice)
}
Device = Annotated[AnyDevice, Field(discriminator="kind")]

__all__ = [
    "CHANNELS",
    "DEVICES",
    "AccelChannel",
    "AnyDevice",
    "BusDevice",
    "BusType",
    "CanopenNode",
    "CanopenObjectDevice",
    "CanopenSyncDevice",
    "Channels",
    "Cia402Device",
    "Cia404Device",
    "Cia406Device",
    "Device",
    "DeviceSection",
    "DscLoadCellDevice",
    "ForceChannel",
    "GyroChannel",
    "ImuDevice",
    "JointChannel",
    "JointDevice",
    "LoadCellDevice",
    "LoadCellKeys",
    "ModbusLoadCellDevice",
    "Mpu6050Device",
    "NimuDevice",
    "NodeFrameDevice",
    "PpsDevice",
    "PulseGeneratorDevice",
    "QsbDevice",
    "RecordChannel",
    "RecordedAngle",
    "RecordedDevice",
    "RecordedImu",
    "RecordedLoadCell",
    "RecordedRate",
    "RecordedValue",
    "SyncPulseDevice",
]
