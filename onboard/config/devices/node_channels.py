"""``[[device.NAME.channel]]`` of a node frame device: what each channel of the node is to the estimator."""

from typing import Annotated, Literal, get_args

from pydantic import Field

from onboard.config.devices.base import LoadCellKeys
from onboard.config.types import NotNegative, Positive, Section


class _Channel(Section):
    name: Annotated[str, Field(max_length=16)]


class RecordChannel(_Channel):
    """It is logged, and may tell the phases of the mission."""

    role: Literal["record"]


class JointChannel(_Channel):
    """Angle of a joint, rad or deg; ``zero_count``: its counts at angle zero.

    ``absolute``: after a reset of the node it still counts from there; where not, rows that need it are refused then.
    """

    role: Literal["joint"]
    joint: str
    zero_count: int = 0
    absolute: bool = False
    noise_rad: Positive
    delay_ms: NotNegative = 0.0


class ForceChannel(_Channel, LoadCellKeys):
    """A load cell, N or kg."""

    role: Literal["force"]


class GyroChannel(_Channel):
    """Angular rate about an axis of the device's ``frame``, rad/s or deg/s."""

    role: Literal["gyro"]
    axis: Literal["x", "y", "z"]
    noise_rad_s: Positive
    delay_ms: NotNegative = 0.0


class AccelChannel(_Channel):
    """Specific force along an axis of the device's ``frame``, m/s^2 or g."""

    role: Literal["accel"]
    axis: Literal["x", "y", "z"]
    noise_m_s2: Positive
    delay_ms: NotNegative = 0.0


AnyChannel = RecordChannel | JointChannel | ForceChannel | GyroChannel | AccelChannel
CHANNELS: dict[str, type[Section]] = {
    get_args(role.model_fields["role"].annotation)[0]: role for role in get_args(AnyChannel)
}
NodeChannel = Annotated[AnyChannel, Field(discriminator="role")]
