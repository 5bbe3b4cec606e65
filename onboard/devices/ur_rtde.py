"""Universal Robots controllers by RTDE: joints, wrench and other outputs; read, never commanded."""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers.device import Device
from drivers.records import SCALAR
from drivers.transports.tcp_port import TCP_URLS, TcpPort
from drivers.ur_rtde import RtdeChannel, RtdeConfig, UrRtde
from drivers.ur_rtde.asking import answering
from onboard.devices.base import Answering, BusDevice, Channels, LoadCellDevice, OpeningBus, Problem, Surroundings
from onboard.devices.buses import PollPeriod
from onboard.devices.driven import MotorDevice
from onboard.section import NotNegative, Positive
from onboard.timebase.delays import Delay
from onboard.timebase.specs import ChannelClock, FollowerChannel, FreeChannel

TICK_NS = 1000.0  # rows count microseconds
COUNTS = 1 << 32  # of a turn: the controller tells doubles
STEP = 2.0**-32  # of what is told in other units
Place = Annotated[int, Field(ge=1, le=6)]


class UrOutputs(BusDevice):
    """A part of what a controller sends; all on one bus come in the same packages."""

    bus_type = "TCP"
    urls = TCP_URLS
    shares_bus = True
    records = SCALAR
    driver_configs = (RtdeConfig,)
    about_clock = (
        "The controller's `timestamp`, fitted to the least delayed arrivals; `latency_ms` and half of `poll_period_ms` "
        "are taken off. All devices of a controller have the same times: an error of them is common to all."
    )
    rate_hz: Positive = RtdeConfig.rate_hz
    poll_period_ms: PollPeriod = RtdeConfig.poll_period_ms
    silence_ms: Positive = RtdeConfig.silence_ms
    latency_ms: Annotated[
        NotNegative | None,
        Field(
            description="From the time stamp to the arrival of its package, as measured; half a period if not given."
        ),
    ] = None
    latency_sigma_ms: Annotated[NotNegative, Field(description="Standard deviation of `latency_ms`.")] = 0.0

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

    @classmethod
    def bus_problems(cls, bus: str, devices: Mapping[str, BusDevice]) -> Iterator[Problem]:
        """See ``BusDevice``: they are asked for at once."""
        first, leader = next(iter(devices.items()))
        taken: dict[tuple[str, int], str] = {}
        for name, one in devices.items():
            if isinstance(one, UrOutputs) and isinstance(leader, UrOutputs):
                if (one.timing, one.delay_ns) != (leader.timing, leader.delay_ns):
                    text = (
                        f"{name!r} and {first!r} come in one package; give both the same rate_hz, periods and latency"
                    )
                    yield ["device", name], text
                for channel in one.outputs(name):
                    other = taken.setdefault((channel.variable, channel.place), name)
                    if other != name:
                        text = f"{name!r} and {other!r} are {channel.variable} {channel.place + 1}; give each its own"
                        yield ["device", name], text

    @property
    def timing(self) -> RtdeConfig:
        """How the controller is read."""
        return self._settings(RtdeConfig)

    @property
    def delay_ns(self) -> tuple[float, float]:
        """From time stamp to arrival, and sigma: within a period where not measured, and till the port is read."""
        period_ms = 1e3 / self.rate_hz
        latency_ms, sigma_ms = 0.5 * period_ms, period_ms / math.sqrt(12.0)
        if self.latency_ms is not None:
            latency_ms, sigma_ms = self.latency_ms, self.latency_sigma_ms
        sigma_ms = math.hypot(sigma_ms, self.poll_period_ms / math.sqrt(12.0))
        return 1e6 * (latency_ms + 0.5 * self.poll_period_ms), 1e6 * sigma_ms

    def channels(self, name: str) -> Channels:
        """See ``DeviceSection``."""
        return dict.fromkeys((one.channel for one in self.outputs(name)), SCALAR)

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``: the first channel of the controller leads."""
        first, leader = next(iter(around.devices_on(self.bus).items()))
        leads = next(iter(leader.channels(first)))
        free: dict[str, ChannelClock] = {leads: FreeChannel(TICK_NS, *self.delay_ns)} if first == name else {}
        return {**dict.fromkeys(self.channels(name), FollowerChannel(leads)), **free}

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        delay_ns, sigma_ns = self.delay_ns
        cause = "controller: from time stamp to package, and till the port is read; the same for all of it"
        common = [Delay(channel, "", 1e-9 * delay_ns, 1e-9 * sigma_ns, cause) for channel in self.channels(name)]
        return [*super().delays(name, around), *common]


class UrJointDevice(UrOutputs, MotorDevice):
    """A joint of a UR arm: its angle, and its rate and motor's current where wanted.

    `torque`: the motor's current; with `gain_N_m_A` and `torque_sigma_N_m` it is the joint's torque.
    `counts_per_revolution = -4294967296` where the URDF's joint turns against the controller's. While the arm has no
    power its angles are not valid; a protective stop is an event.
    """

    kind: Literal["ur_joint"]
    new_bus = "robot"
    answering: ClassVar[Answering | None] = staticmethod(answering)
    new_keys: ClassVar[
        str
    ] = """number = {number}                     # of the controller: 1 base, 2 shoulder, 3 elbow, 4 to 6 wrist
rate_hz = 125                  # an e-Series has up to 500
noise_rad = 2e-5               # one sample: yours, of an arm at rest
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


class UrWrenchDevice(UrOutputs, LoadCellDevice):
    """A component of an e-Series' wrist sensor, `ft_raw_wrench`, in the axes of the flange: nothing is taken off it.

    `component`: 1 to 3 are forces, 4 to 6 moments, about `axis` of `frame`, the flange. Where a known weight reads as
    if it pulled the other way, turn `axis` round.
    """

    kind: Literal["ur_wrench"]
    component: Annotated[Place, Field(description="1 to 3: force along x, y, z; 4 to 6: moment about them.")]

    def outputs(self, name: str) -> Sequence[RtdeChannel]:
        """See ``UrOutputs``."""
        return [RtdeChannel(name, "ft_raw_wrench", self.component - 1, STEP, "N" if self.component < 4 else "N m")]

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``."""
        yield from super().problems(name, around)
        if self.measures != ("force" if self.component < 4 else "moment") or self.lever_m != 1.0:
            text = "components 1 to 3 are forces, 4 to 6 moments, without lever_m"
            yield ["device", name, "measures"], f"{name!r} is component {self.component}: {text}; correct it"


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
