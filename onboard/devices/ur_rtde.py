"""Universal Robots controllers by RTDE: joints, wrench and other outputs; read, never commanded."""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.device import Device
from drivers.transports.network import TCP_URLS, TcpPort
from drivers.ur_rtde import RtdeChannel, RtdeConfig, UrRtde
from drivers.ur_rtde.device import answering
from onboard.devices.base import Answering, OpeningBus, Problem, Surroundings
from onboard.devices.buses import ComponentDevice, PollPeriod, StreamedDevice
from onboard.devices.driven import MotorDevice
from onboard.section import Positive

TICK_NS = 1000.0  # rows count microseconds
COUNTS = 1 << 32  # of a turn: the controller tells doubles
STEP = 2.0**-32  # of quantities in other units
Place = Annotated[int, Field(ge=1, le=6)]


class UrOutputs(StreamedDevice):
    """A part of what a controller sends; all on one bus come in the same packages."""

    bus_type = "TCP"
    urls = TCP_URLS
    driver_configs = (RtdeConfig,)
    tick_ns = TICK_NS
    new_bus = "robot"
    new_url = "tcp://192.168.56.101:30004"
    about_clock = (
        "The controller's `timestamp`, fitted to the least delayed arrivals; `latency_ms` and half of `poll_period_ms` "
        "are taken off. All devices of a controller have the same times: an error of them is common to all."
    )
    rate_hz: Positive = RtdeConfig.rate_hz
    poll_period_ms: PollPeriod = RtdeConfig.poll_period_ms
    silence_ms: Positive = RtdeConfig.silence_ms

    def outputs(self, name: str) -> Sequence[RtdeChannel]:
        """Channels, and what of the controller they are."""
        raise NotImplementedError

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``: all of one controller are one driver."""
        parts = {name: one for name, one in bus.devices.items() if isinstance(one, UrOutputs)}
        channels = [channel for name, one in parts.items() for channel in one.outputs(name)]
        config = next(iter(parts.values())).settings(bus.name)
        return [UrRtde(bus.name, channels, partial(TcpPort.open, bus.url), bus.clock, config)]

    def parts(self, name: str) -> Mapping[str, str]:
        """See ``StreamedDevice``."""
        return {one.channel: f"{one.variable} {one.place + 1}" for one in self.outputs(name)}


class UrJointDevice(UrOutputs, MotorDevice):
    """A joint of a UR arm: its angle, and its rate and motor's current where wanted.

    `torque`: the motor's current; with `gain_N_m_A` and `torque_sigma_N_m` it is the joint's torque.
    `counts_per_revolution = -4294967296` where the URDF's joint turns against the controller's. While the arm has no
    power its angles are not valid; a protective stop is an event.
    """

    kind: Literal["ur_joint"]
    answering: ClassVar[Answering | None] = staticmethod(answering)
    new_keys: ClassVar[
        str
    ] = """number = {number}                     # of the controller: 1 base, 2 shoulder, 3 elbow, 4 to 6 wrist
rate_hz = 125                  # an e-Series has up to 500
noise_rad = 2e-5               # of a sample: yours, of an arm at rest
"""
    new_torque = """gain_N_m_A = 10.0              # yours: joint torque per ampere, gear included
torque_scale_sigma = 0.1       # yours: of that, relative
"""
    number: Annotated[Place, Field(description="Joint of the controller: 1 base to 6 wrist 3.")]
    counts_per_revolution: int = COUNTS
    gain_N_m_A: Annotated[  # noqa: N815
        Positive | None, Field(description="Joint torque per ampere, gear included.")
    ] = None

    def outputs(self, name: str) -> Sequence[RtdeChannel]:
        """See ``UrOutputs``."""
        place, step = self.number - 1, math.copysign(STEP, self.counts_per_revolution)
        parts = [RtdeChannel(name, "actual_q", place, math.tau / self.counts_per_revolution, "rad")]
        parts += [RtdeChannel(f"{name}_velocity", "actual_qd", place, step, "rad/s")] if self.velocity else []
        return parts + ([RtdeChannel(f"{name}_torque", "actual_current", place, step, "A")] if self.torque else [])

    @property
    def torque_units(self) -> Mapping[bytes, float]:
        """See ``MotorDevice``: of its motor's current."""
        return {b"A": self.gain_N_m_A or 0.0}

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``."""
        yield from super().problems(name, around)
        if self.torque_sigma_N_m is not None and self.gain_N_m_A is None:
            yield ["device", name, "torque_sigma_N_m"], f"{name!r} measures a current; give gain_N_m_A"


class UrWrenchDevice(UrOutputs, ComponentDevice):
    """A component of an e-Series' wrist sensor, `ft_raw_wrench`, in the axes of the flange: nothing is taken off it."""

    new_keys = "rate_hz = 125                  # as of the joints\n"
    kind: Literal["ur_wrench"]

    def outputs(self, name: str) -> Sequence[RtdeChannel]:
        """See ``UrOutputs``."""
        return [RtdeChannel(name, "ft_raw_wrench", self.component - 1, STEP, self.unit)]


class UrOutputDevice(UrOutputs):
    """Another output of a controller, of six numbers: `actual_TCP_force`, `target_moment`. It is recorded.

    `actual_TCP_force` is in the axes of the robot's base, and what the controller believes to be the payload is taken
    off it; `target_moment` is what its own model asks of the joints. Neither is a measurement of a payload.
    """

    kind: Literal["ur_output"]
    output: Annotated[str, Field(pattern=r"^[A-Za-z0-9_]{1,40}$", description="Its name, of type VECTOR6D.")]
    unit: Annotated[str, Field(max_length=8, description="Unit that its rows carry.")] = "1"

    def outputs(self, name: str) -> Sequence[RtdeChannel]:
        """See ``UrOutputs``."""
        return [RtdeChannel(f"{name}_{place + 1}", self.output, place, STEP, self.unit) for place in range(6)]
