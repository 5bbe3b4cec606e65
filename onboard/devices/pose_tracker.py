"""Motion capture of a laboratory that sees the vehicle, by MAVLink 2 on a serial line."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.pose_tracker.device import PoseTracker
from drivers.pose_tracker.frame import MESSAGE_BYTES, PoseTrackerConfig
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
        "The tracker's time stamps, fitted to the least delayed arrivals; `latency_ms` and the time on the line are "
        "taken off."
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
        return {name: FreeChannel(TICK_NS, 1e9 * self._delay_s(around), 1e6 * self.latency_sigma_ms)}

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        cause = "tracker: from exposure to message, and on the wire"
        return [Delay(name, "", self._delay_s(around), 1e-3 * self.latency_sigma_ms, cause)]

    def driver(self, name: str, open_port: OpenSerial, clock: Clock, baud: int) -> PoseTracker:
        """See ``SerialLineDevice``."""
        return PoseTracker(name, open_port, clock, self.settings(name))

    def _delay_s(self, around: Surroundings) -> float:
        """From a pose to the arrival of its message."""
        return 1e-3 * self.latency_ms + on_wire_s(MESSAGE_BYTES, around.baud(self.bus))
