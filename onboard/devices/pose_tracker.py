"""Motion capture of a laboratory that sees the vehicle, by MAVLink 2 on a serial line."""

import math
from typing import Annotated, Literal

from pydantic import Field

from drivers.pose_tracker.device import PoseTracker
from drivers.pose_tracker.frame import LONG_BYTES, SHORT_BYTES, PoseTrackerConfig
from drivers.records import POSE
from onboard.devices.base import Channels, Clock, Surroundings
from onboard.devices.buses import OpenSerial, PollPeriod, SerialLineDevice
from onboard.section import NotNegative, Positive
from onboard.timebase.delays import Delay, on_wire_s
from onboard.timebase.specs import ChannelClock, FreeChannel

TICK_NS = 1000.0  # the messages count microseconds


class PoseTrackerDevice(SerialLineDevice):
    """Position and attitude of ``frame`` in the tracker's own axes: ATT_POS_MOCAP (138) of motion capture bridges.

    Recorded and checked, and a witness only: the estimator does not use it. Noise is that of one pose. A pose that
    repeats the one before to the bit is not valid: the tracker holds it while it does not see the markers.
    """

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
    position_noise_m: Annotated[Positive, Field(description="Standard deviation of one pose's position, each axis.")]
    attitude_noise_rad: Annotated[Positive, Field(description="Standard deviation of one pose's attitude, each axis.")]
    system: int = PoseTrackerConfig.system
    component: int = PoseTrackerConfig.component
    poll_period_ms: PollPeriod = PoseTrackerConfig.poll_period_ms
    silence_ms: Positive = PoseTrackerConfig.silence_ms

    @property
    def nominal_hz(self) -> float:
        """Nominal."""
        return self.rate_hz

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
