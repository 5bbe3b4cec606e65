"""Channels of imported recordings (``heft import``): no bus; host stamps are sample times."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from drivers.records import IMU, SCALAR
from onboard.devices import roles
from onboard.devices.base import Channels, DeviceSection, ImuDevice, Surroundings
from onboard.devices.roles import JointRole, LoadCellKeys, LoadCellRole, Roles, ThrusterRole, TorqueKeys
from onboard.section import Direction, NotNegative, Positive, Real
from onboard.timebase.timebase import ChannelClock, RecordedChannel

Repeats = Annotated[bool, Field(description="The recorder writes a reading more than once; none is judged stuck.")]
Quantum = Annotated[
    float, Field(gt=0.0, description="Counts between readings that differ least; heft identify finds it in the log.")
]

Delay = Annotated[
    Real, Field(description="Of its samples against the joints'; negative: they are stamped before they were taken.")
]


class RecordedDevice(DeviceSection):
    """A recorded channel."""

    about_clock = "The recording's times."
    period_ms: Positive

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        return {name: RecordedChannel(0.0)}


class RecordedImu(RecordedDevice, ImuDevice):
    """An IMU."""

    records = IMU
    kind: Literal["recorded_imu"]
    repeats: Repeats = False

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        read = super().roles(name, period_s)
        return read._replace(signals={key: of._replace(repeats=self.repeats) for key, of in read.signals.items()})


class RecordedAngle(RecordedDevice):
    """A joint angle; ``zero_count``: the raw value at angle zero."""

    about_role = "joint angle"
    records = SCALAR
    kind: Literal["recorded_angle"]
    joint: str
    zero_count: Annotated[int, Field(description="Raw value at angle zero.")] = 0
    noise_rad: Positive
    repeats: Repeats = False
    quantum_counts: Quantum = 1.0
    scale_sigma: NotNegative = 0.0
    zero_sigma_rad: NotNegative = roles.ZERO_SIGMA_RAD

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        angle = roles.scalar(0.0, self.noise_rad, period_s, roles.ANGLE)._replace(
            zero_count=self.zero_count, repeats=self.repeats, quantum_counts=self.quantum_counts
        )
        joint = JointRole(self.joint, name, False, self.scale_sigma, self.zero_sigma_rad)
        return Roles([], [joint], [], [], [], {name: angle})


class RecordedRate(RecordedDevice):
    """A joint rate; the joint turns a body of revolution, so that its angle is not needed."""

    about_role = "joint rate"
    records = SCALAR
    kind: Literal["recorded_rate"]
    joint: str
    noise_rad_s: Positive
    repeats: Repeats = False
    scale_sigma: Annotated[
        float, Field(ge=0.0, description="Of its scale since it was calibrated, relative; intervals carry it.")
    ] = 0.01
    delay_sigma_ms: Annotated[float, Field(ge=0.0, description="Of its samples' times; intervals carry it.")] = 0.0

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        rate = roles.scalar(0.0, self.noise_rad_s, period_s, roles.RATE)._replace(repeats=self.repeats)
        delay_s = 1e-3 * self.delay_sigma_ms
        joint = JointRole(self.joint, name, True, self.scale_sigma, delay_sigma_s=delay_s)
        return Roles([], [joint], [], [], [], {name: rate})


class RecordedLoadCell(RecordedDevice, LoadCellKeys):
    """A load cell, or an axis of a six-axis cell: a moment is in N m, where ``lever_m`` is not given."""

    about_role = "load cell"
    records = SCALAR
    kind: Literal["recorded_load_cell"]
    delay_ms: Delay = 0.0
    repeats: Repeats = False
    quantum_counts: Quantum = 1.0

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        force = roles.force(self, period_s)._replace(repeats=self.repeats, quantum_counts=self.quantum_counts)
        return Roles([], [], [LoadCellRole(name, name, self)], [], [], {name: force})


class RecordedTorque(RecordedDevice, TorqueKeys):
    """The torque of a joint, N m (N of a sliding joint), or its motor's current."""

    about_role = "joint torque"
    records = SCALAR
    kind: Literal["recorded_torque"]
    repeats: Repeats = False
    between_recordings_sigma: Annotated[
        NotNegative,
        Field(description="Relative 1 sigma of its gain with the payload against that without, recorded before."),
    ] = 0.0

    @property
    def changed_sigma(self) -> float:
        """See ``TorqueKeys``."""
        return self.between_recordings_sigma

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        si = {b"N m": 1.0, b"N": 1.0} | ({b"A": self.gain_N_m_A} if self.gain_N_m_A else {})
        noise = 0.0  # of a sample: not stated, sigma_N_m is of the model; equal readings tell nothing without it
        torque = roles.scalar(self.delay_ms, noise, period_s, si)._replace(repeats=self.repeats)
        return Roles([], [], [LoadCellRole(name, name, self)], [], [], {name: torque})


class RecordedThruster(RecordedDevice):
    """Commands of a thruster: its level from each sample to the next, or for how long it is opened from then on.

    The force is along ``axis`` of ``frame``, a frame of the URDF that is fixed in the base, and through its origin.
    """

    about_role = "known force on a body"
    records = SCALAR
    kind: Literal["recorded_thruster"]
    frame: Annotated[str, Field(description="Of the URDF, fixed in the base; the force goes through its origin.")]
    axis: Annotated[Direction, Field(description="Direction of the force on the vehicle, in the frame's axes.")]
    force_N: Annotated[Positive, Field(description="Its force at full level.")]  # noqa: N815
    scale_sigma: Annotated[NotNegative, Field(description="Relative 1 sigma of its force.")] = 0.05
    reads: Annotated[
        Literal["level", "on_time"],
        Field(description="A sample is the share of the force until the next sample, or an on-time in s from then on."),
    ] = "level"

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``; of a body without joints (``[body]``) they are read by themselves."""
        force = roles.scalar(0.0, 0.0, period_s, {b"1": self.force_N})._replace(repeats=True)
        role = ThrusterRole(name, name, self.frame, self.axis, self.scale_sigma)
        return Roles([], [], [], [role], [], {name: force})


class RecordedPose(RecordedDevice):
    """Tracked pose of ``frame`` on a table, in three channels: NAME_x, NAME_y (m) and NAME_yaw (rad) of fixed axes."""

    about_role = "pose of a body without joints"
    records = SCALAR
    kind: Literal["recorded_pose"]
    frame: Annotated[str, Field(description="Frame of the URDF, fixed in the base, that the markers stand for.")]
    position_noise_m: Annotated[Positive, Field(description="1 sigma of a sample, each axis.")]
    yaw_noise_rad: Annotated[Positive, Field(description="1 sigma of a sample.")]
    repeats: Annotated[
        bool,
        Field(
            description="An unchanged pose is a measurement; false: the tracker held the last pose, and it is left out."
        ),
    ] = False
    misalignment_sigma_rad: Annotated[
        NotNegative, Field(description="Standard deviation of the markers' yaw against that of `frame`.")
    ] = 0.02
    place_sigma_m: Annotated[
        NotNegative, Field(description="Standard deviation of the markers' place against that of `frame`, each axis.")
    ] = 5e-3
    scale_sigma: Annotated[NotNegative, Field(description="Relative standard deviation of the tracker's lengths.")] = (
        2e-3
    )

    def channels(self, name: str) -> Channels:
        """See ``DeviceSection``."""
        return dict.fromkeys((f"{name}_x", f"{name}_y", f"{name}_yaw"), SCALAR)

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        return {channel: RecordedChannel(0.0) for channel in self.channels(name)}


class RecordedValue(RecordedDevice):
    """A value without a role in the estimator: a phase, say."""

    about_role = "none, or the phases"
    records = SCALAR
    kind: Literal["recorded_value"]


ThrusterKeys = RecordedThruster
"""What the estimators of a body without joints read of a thruster."""
PoseKeys = RecordedPose
"""The same of its tracked pose."""


def thrusters_among(devices: Mapping[str, object]) -> dict[str, ThrusterKeys]:
    """The thrusters whose commands were recorded, by name."""
    return {name: device for name, device in devices.items() if isinstance(device, RecordedThruster)}


def tracked_among(devices: Mapping[str, object]) -> tuple[str, PoseKeys]:
    """The first tracked pose that was recorded, with its name.

    Raises:
        StopIteration: there is none.
    """
    return next((name, device) for name, device in devices.items() if isinstance(device, RecordedPose))
