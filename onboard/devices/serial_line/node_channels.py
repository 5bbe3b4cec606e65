"""``[[device.NAME.channel]]`` of a node frame device: role of each channel of the node."""

from typing import Annotated, Literal, get_args

from pydantic import Field

from onboard.devices import roles
from onboard.devices.roles import JointRole, LoadCellKeys, LoadCellRole, Roles, SmoothedChannel
from onboard.section import NotNegative, Positive, Section, ZeroCount
from onboard.timebase.delays import Delay


class ChannelSection(Section):
    """A channel. ``role`` says what it is."""

    name: Annotated[str, Field(max_length=16)]
    role: str

    def roles(self, channel: str, period_s: float) -> Roles:
        """What it is to the estimator on its own; ``channel`` is what it is recorded as."""
        return Roles.none()

    def delay(self, channel: str) -> Delay | None:
        """Of its own filter."""
        return None


class FilteredChannel(ChannelSection):
    """A channel behind a filter of the node."""

    delay_ms: NotNegative = 0.0

    def delay(self, channel: str) -> Delay:
        """See ``ChannelSection``."""
        return Delay(channel, "", self.delay_ms * 1e-3, 0.0, "filter of the node")


class RecordChannel(ChannelSection):
    """It is logged, and may tell the phases of the mission."""

    role: Literal["record"]


class JointChannel(FilteredChannel):
    """Angle of a joint, rad or deg; ``zero_count``: its counts at angle zero.

    ``absolute``: after a reset of the node it still counts from there; where not, rows that need it are refused then.
    """

    role: Literal["joint"]
    joint: str
    zero_count: ZeroCount = 0
    absolute: bool = False
    noise_rad: Positive
    scale_sigma: NotNegative = 0.0
    zero_sigma_rad: NotNegative = roles.ZERO_SIGMA_RAD

    def roles(self, channel: str, period_s: float) -> Roles:
        """See ``ChannelSection``."""
        angle = roles.scalar(self.delay_ms, self.noise_rad, period_s, roles.ANGLE)._replace(
            zero_count=self.zero_count, absolute=self.absolute
        )
        joint = JointRole(self.joint, channel, False, self.scale_sigma, self.zero_sigma_rad)
        return Roles([], [joint], [], [], [], {channel: angle})


class ForceChannel(ChannelSection, LoadCellKeys):
    """A load cell, N or kg."""

    role: Literal["force"]

    def roles(self, channel: str, period_s: float) -> Roles:
        """See ``ChannelSection``."""
        return Roles([], [], [LoadCellRole(channel, channel, self)], [], [], {channel: roles.force(self, period_s)})

    def delay(self, channel: str) -> Delay:
        """See ``ChannelSection``."""
        return Delay(channel, "", self.delay_ms * 1e-3, self.delay_sigma_ms * 1e-3, "filter of the node")


class InertialChannel(FilteredChannel):
    """One of the six of an IMU by parts."""

    axis: Annotated[Literal["x", "y", "z"], Field(description="Axis of `frame` of the device.")]

    def signal(self, period_s: float) -> SmoothedChannel:
        """How its rows read."""
        raise NotImplementedError

    def roles(self, channel: str, period_s: float) -> Roles:
        """See ``ChannelSection``: the IMU is made of all six by their device."""
        return Roles([], [], [], [], [], {channel: self.signal(period_s)})


class GyroChannel(InertialChannel):
    """Angular rate about an axis of the device's ``frame``, rad/s or deg/s."""

    role: Literal["gyro"]
    noise_rad_s: Positive

    def signal(self, period_s: float) -> SmoothedChannel:
        """See ``InertialChannel``."""
        return roles.scalar(self.delay_ms, self.noise_rad_s, period_s, roles.RATE)


class AccelChannel(InertialChannel):
    """Specific force along an axis of the device's ``frame``, m/s^2 or g."""

    role: Literal["accel"]
    noise_m_s2: Positive

    def signal(self, period_s: float) -> SmoothedChannel:
        """See ``InertialChannel``."""
        return roles.scalar(self.delay_ms, self.noise_m_s2, period_s, roles.SPECIFIC_FORCE)


AnyChannel = RecordChannel | JointChannel | ForceChannel | GyroChannel | AccelChannel
CHANNELS: dict[str, type[ChannelSection]] = {
    get_args(role.model_fields["role"].annotation)[0]: role for role in get_args(AnyChannel)
}
NodeChannel = Annotated[AnyChannel, Field(discriminator="role")]
