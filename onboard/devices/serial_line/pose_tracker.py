"""Motion capture of a laboratory that sees the vehicle, by MAVLink 2 on a serial line."""

import math
from typing import Annotated, Literal

from pydantic import Field

from drivers.pose_tracker.device import PoseTracker
from drivers.pose_tracker.frame import LONG_BYTES, SHORT_BYTES, PoseTrackerConfig
from drivers.records import POSE
from onboard.devices.base import Channels, Clock, Surroundings
from onboard.devices.buses import OpenSerial, PollPeriod, SerialLineDevice
from onboard.devices.roles import Roles, SmoothedChannel, TrackerRole
from onboard.section import NotNegative, Positive
from onboard.timebase.delays import Delay, on_wire_s
from onboard.timebase.timebase import ChannelClock, FreeChannel

TICK_NS = 1000.0  # the messages count microseconds


class PoseTrackerDevice(SerialLineDevice):
    """Position and attitude of ``frame`` in the tracker's axes: ATT_POS_MOCAP (138) of motion capture bridges.

    The method of a free base predicts it on board, except for a vehicle with thrusters; place and attitude of the
    tracker's axes are unknowns. Noise is that of a single pose. A pose that repeats the last one to the bit is not
    valid: the tracker holds it while it does not see the markers.
    """

    about_role = "pose of a free base"
    about_clock = (
        "The tracker's time stamps, fitted to the least delayed arrivals; `latency_ms`, the time on the line and half "
        "of `poll_period_ms` are taken off: a tracker may keep step with the reading of its port."
    )
    driver_configs = (PoseTrackerConfig,)
    rate_tolerance = 0.3  # what the tracker does not see it does not send
    kind: Literal["pose_tracker"]
    frame: Annotated[str, Field(description="Frame of the URDF, fixed in the base, that the markers stand for.")]
    rate_hz: Annotated[Positive, Field(description="Nominal rate of its poses.")]
    latency_ms: Annotated[
        NotNegative,
        Field(description="From exposure to the first bit of the message, of the least delayed, as measured."),
    ]
    latency_sigma_ms: Annotated[Positive, Field(description="Standard deviation of `latency_ms`.")]
    covariance: Annotated[
        bool, Field(description="Whether it sends a covariance: a message has 132 bytes then, and 52 without.")
    ] = False
    position_noise_m: Annotated[Positive, Field(description="1 sigma of a pose's position, each axis.")]
    attitude_noise_rad: Annotated[Positive, Field(description="1 sigma of a pose's attitude, each axis.")]
    misalignment_sigma_rad: Annotated[
        Positive, Field(description="Standard deviation of the markers' axes against those of `frame`.")
    ] = 0.02
    place_sigma_m: Annotated[
        Positive, Field(description="Standard deviation of the markers' place against that of `frame`, each axis.")
    ] = 5e-3
    scale_sigma: Annotated[Positive, Field(description="Relative standard deviation of the tracker's lengths.")] = 0.03
    acceleration_sigma_m_s2: Annotated[
        Positive, Field(description="Standard deviation of a steady acceleration of the tracker's axes in free fall.")
    ] = 1e-3
    system: int = PoseTrackerConfig.system
    component: int = PoseTrackerConfig.component
    poll_period_ms: PollPeriod = PoseTrackerConfig.poll_period_ms
    silence_ms: Positive = PoseTrackerConfig.silence_ms

    def channels(self, name: str) -> Channels:
        """Its poses."""
        return {name: POSE}

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        return {name: FreeChannel(TICK_NS, 1e9 * self._delay_s(around), 1e9 * self._delay_sigma_s)}

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        cause = "tracker: from exposure to message, on the wire, and till the port is read"
        return [Delay(name, "", self._delay_s(around), self._delay_sigma_s, cause)]

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        noise = (0.5 * self.attitude_noise_rad,) * 4 + (self.position_noise_m,) * 3
        signal = SmoothedChannel((0.0,) * 7, noise, period_s, {}, is_pose=True)
        acceleration, turn = self.acceleration_sigma_m_s2, self.misalignment_sigma_rad
        errors = acceleration, turn, self.place_sigma_m, self.scale_sigma, self._delay_sigma_s
        return Roles([], [], [], [], [TrackerRole(name, self.frame, *errors, signal)], {})

    def driver(self, name: str, open_port: OpenSerial, clock: Clock, baud: int) -> PoseTracker:
        """See ``SerialLineDevice``."""
        return PoseTracker(name, open_port, clock, self.settings(name))

    def _delay_s(self, around: Surroundings) -> float:
        """From a pose to the arrival of its message."""
        own_s = 1e-3 * (self.latency_ms + 0.5 * self.poll_period_ms)
        return own_s + on_wire_s(LONG_BYTES if self.covariance else SHORT_BYTES, around.baud(self.bus))

    @property
    def _delay_sigma_s(self) -> float:
        """Standard deviation of that: the port is read at any time of its period."""
        return 1e-3 * math.hypot(self.latency_sigma_ms, self.poll_period_ms / 12**0.5)
