"""ODrive motor controllers on CAN, by the messages that they send unasked (CANSimple); read, never commanded."""

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers import transports
from drivers.device import Device
from drivers.odrive import COUNTS, OdriveAxis, Odrives
from drivers.odrive.message import heard
from drivers.records import SCALAR
from onboard.devices.base import BusDevice, Channels, Heard, OpeningBus, Problem, Surroundings
from onboard.devices.driven import MotorDevice
from onboard.section import NotNegative, Positive
from onboard.timebase.delays import Delay
from onboard.timebase.timebase import ChannelClock, FollowerChannel, FreeChannel

MESSAGES = 2  # of an axis in a period: estimates, torques
FRAME_BITS = 135  # of a frame of 8 bytes, with all the bits that may be stuffed (Davis, Burns, Bril, Lukkien 2007)


class OdriveDevice(MotorDevice):
    """An axis of an ODrive (firmware 0.6: S1, Pro, Micro) on a joint, with others on its bus.

    `counts_per_revolution`: 1048576 times the motor's revolutions in one of the joint; negative where it counts against
    the joint. `torque`: its own estimate, of the motor, and by the gear that of the joint. A bus without other talkers:
    its identifiers are not those of CANopen.
    """

    bus_type = "CAN without SYNC"
    urls = transports.CAN_URLS
    shares_bus = True
    records = SCALAR
    driver_configs = (OdriveAxis,)
    about_clock = (
        "A line through the arrivals of its messages, counted, that came least late, less `delay_ms`: messages carry "
        "no time. When within its control cycle the estimate is taken is not published, which is part of "
        "`delay_sigma_ms`, and so is a wait for other axes that lasts."
    )
    heard: ClassVar[Heard | None] = staticmethod(heard)
    keeps_zero = False
    new_bus = "odrives"
    new_url = "can+socketcan://can1?bitrate=250000"
    new_keys: ClassVar[str] = """node = {number}                       # its can.node_id
counts_per_revolution = 8388608 # yours: 1048576 x gear, here 8; negative where it turns against the joint
zero_count = 0                 # yours: what it reads at joint angle zero
noise_rad = 5e-5               # yours: of a sample, arm at rest
"""
    new_floating_smoothing_ms: ClassVar[int | None] = 600  # its noise, through less, widens what a free-flyer holds
    kind: Literal["odrive"]
    node: Annotated[int, Field(ge=0, le=63)]
    counts_per_revolution: int = COUNTS
    rate_hz: Annotated[
        Positive, Field(description="Of its messages: 1000 / `encoder_msg_rate_ms`, and of `torques_msg_rate_ms`.")
    ] = OdriveAxis.rate_hz
    delay_ms: Annotated[NotNegative, Field(description="From the estimate to the arrival of its message.")] = 0.5
    delay_sigma_ms: Annotated[
        NotNegative,
        Field(description="Standard deviation of `delay_ms` of an axis alone on its bus. That of waiting is added."),
    ] = 0.2

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``: all axes of a bus are one driver."""
        port = bus.own(transports.open_can(bus.url, bus.clock))
        axes = [one.settings(name) for name, one in bus.devices.items() if isinstance(one, OdriveDevice)]
        return [Odrives(port, axes, bus.name)]

    @classmethod
    def bus_problems(cls, bus: str, devices: Mapping[str, BusDevice]) -> Iterator[Problem]:
        """See ``BusDevice``."""
        by_node: dict[int, str] = {}
        for name, one in devices.items():
            other = by_node.setdefault(one.node, name) if isinstance(one, OdriveDevice) else name
            if other != name:
                yield ["device", name, "node"], f"{name!r} and {other!r} are the same node; change either can.node_id"

    def settings(self, name: str) -> OdriveAxis:
        """See ``BusDevice``."""
        return self._settings(OdriveAxis, name=name)

    def channels(self, name: str) -> Channels:
        """Position, velocity, torque."""
        return dict.fromkeys(self.settings(name).channels, SCALAR)

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``: position and velocity come together."""
        free = FreeChannel(1.0, 1e6 * self.delay_ms, 1e6 * self.delay_sigma_ms)
        return {
            channel: FollowerChannel(name) if channel == f"{name}_velocity" else free for channel in self.channels(name)
        }

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        cause = "from the estimate to the arrival of its message"
        sigma_s = math.hypot(1e-3 * self.delay_sigma_ms, self._wait_s(around))
        return [Delay(channel, "", 1e-3 * self.delay_ms, sigma_s, cause, name) for channel in self.channels(name)]

    def _wait_s(self, around: Surroundings) -> float:
        """Root mean square of how long a message waits for those of other axes: for none, for all, or between.

        Axes on one supply start together and send at one rate, so that one that waits does so for the whole flight.
        """
        axes = sum(isinstance(one, OdriveDevice) for one in around.devices_on(self.bus).values())
        return MESSAGES * (axes - 1) * FRAME_BITS / around.baud(self.bus) / math.sqrt(3.0)
