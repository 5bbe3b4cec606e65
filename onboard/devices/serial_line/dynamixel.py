"""DYNAMIXEL X servos, several on one serial line; read, and driven where the file says so."""

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from drivers import transports
from drivers.device import Device
from drivers.dynamixel.device import DynamixelBus, answering
from drivers.dynamixel.packet import answer_bytes, sync_read_request
from drivers.dynamixel.registers import (
    COUNTS,
    DRIVEN,
    DRIVEN_BYTES,
    PRESENT,
    PRESENT_BYTES,
    DynamixelConfig,
    DynamixelTiming,
)
from drivers.play.axis import AxisConfig
from drivers.records import REGISTER_WRITE, SCALAR
from onboard.devices.base import Answering, BusDevice, Channels, OpeningBus, Problem, Surroundings
from onboard.devices.buses import PollPeriod, SamplePeriod, SerialLineDevice
from onboard.devices.driven import DrivenDevice, MotorDevice
from onboard.devices.roles import Roles
from onboard.section import NotNegative, Positive
from onboard.timebase.delays import Delay, on_wire_s
from onboard.timebase.timebase import ChannelClock, PolledChannel

RETURN_DELAY_S = 500e-6  # as it comes


class DynamixelDevice(SerialLineDevice, MotorDevice, DrivenDevice):
    """DYNAMIXEL X servo (protocol 2.0) on a joint, with others on its line; all are asked at once.

    It is read; with `driven` it is sent goals too (docs/driving.md). `torque`: its motor's current;
    with `gain_N_m_A` and `torque_sigma_N_m` it is the joint's torque. `counts_per_revolution = -4096` where it counts
    against the joint. A hardware error is an event with the remedy, and the current is not valid meanwhile. On the
    motor side of a gear its zero is lost with the supply.
    """

    about_clock = (
        "The middle between the question's end and the moment when its answer is due (return delay, answers before "
        "it), by the host's clock, however late that reads the answer; where it samples in between, and how late "
        "an adapter sends the question, is not known, which is `delay_sigma_ms`. It has no input for the sync line."
    )
    driver_configs = (DynamixelConfig, DynamixelTiming)
    shares_bus = True
    answering: ClassVar[Answering | None] = staticmethod(answering)
    new_bus = "tty_servos"
    new_baud = 1_000_000
    new_keys: ClassVar[
        str
    ] = """id = {number}                         # set each with DYNAMIXEL Wizard, as the baud rate
zero_count = 2048              # yours: what it reads at joint angle zero, 0 to 4095
noise_rad = 7e-4               # of a sample: a count / sqrt(12), and its sensor's 0.03 degrees
"""
    new_torque = """gain_N_m_A = 1.78              # yours: stall torque / stall current, here of an XM430-W350
torque_scale_sigma = 0.1       # yours: of that, relative
"""
    new_driven = DrivenDevice.new_driven + "timeout_ms = 10                # at most half of sync_limit_ms\n"
    new_drive = """# no torque before it is armed: in gravity the motion begins where the arm rests (docs/servos.md)
following_error_rad = 0.25     # a servo's P gain lets it lag by its speed, and sag by its load
after_stop = "hold"            # it has no brake: without torque the arm falls
"""
    new_smoothing_ms = 300  # its noise, through 100 ms, biases the rows
    new_floating_smoothing_ms = 600  # and through 300 ms what a free-flyer holds
    kind: Literal["dynamixel"]
    id: Annotated[int, Field(ge=0, le=252)] = DynamixelConfig.id
    counts_per_revolution: int = COUNTS
    ampere_per_count: Positive | None = None
    gain_N_m_A: Annotated[  # noqa: N815
        Positive | None, Field(description="Joint torque per ampere, gear included.")
    ] = None
    delay_sigma_ms: Annotated[
        NotNegative,
        Field(description="1 sigma of when it samples: (its return delay, 0.5 ms, + 1 ms of the adapter) / sqrt(12)."),
    ] = 0.45
    sample_period_ms: SamplePeriod = DynamixelTiming.sample_period_ms
    timeout_ms: Positive = DynamixelTiming.timeout_ms
    poll_period_ms: PollPeriod = DynamixelTiming.poll_period_ms
    fast_sync_read: bool = DynamixelTiming.fast_sync_read

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``: all servos of a line are one driver."""
        servos = {name: device for name, device in bus.devices.items() if isinstance(device, cls)}
        timing = next(iter(servos.values())).timing
        settings = [servo.settings(name) for name, servo in servos.items()]
        opens, play = partial(transports.open_serial, bus.url), bus.around.play(bus.name)
        return [DynamixelBus(bus.name, settings, opens, bus.clock, timing, play, transports.rest)]

    @classmethod
    def bus_problems(cls, bus: str, devices: Mapping[str, BusDevice]) -> Iterator[Problem]:
        """See ``BusDevice``."""
        first = next(iter(devices))
        by_id: dict[int, str] = {}
        for name, device in devices.items():
            if not isinstance(device, cls):
                yield ["device", name, "bus"], f"{name!r} is no servo and cannot be on their line; give it a bus"
                continue
            other = by_id.setdefault(device.id, name)
            if other != name:
                yield ["device", name, "id"], f"{name!r} and {other!r} have ID {device.id}; give them different ids"
            leader = devices[first]
            if isinstance(leader, cls) and device.timing != leader.timing:
                yield ["device", name], f"{name!r} and {first!r} are asked at once; give both the same periods and keys"

    @property
    def timing(self) -> DynamixelTiming:
        """How the servos of its line are asked."""
        return self._settings(DynamixelTiming)

    def settings(self, name: str) -> DynamixelConfig:
        """See ``BusDevice``."""
        return self._settings(DynamixelConfig, name=name)

    def channels(self, name: str) -> Channels:
        """Position, velocity, current; of a driven one Moving Status and what was written."""
        sent: Channels = {f"{name}_sent": REGISTER_WRITE} if self.driven else {}
        return {**dict.fromkeys(self.settings(name).channels, SCALAR), **sent}

    def axis(self, name: str, limits: Mapping[str, Any], master_node: int) -> AxisConfig:
        """See ``DrivenDevice``; there are no node numbers."""
        from drivers.dynamixel.drive import DynamixelAxisConfig  # noqa: PLC0415  (few flights drive)

        del master_node
        return DynamixelAxisConfig(self.settings(name), **limits)

    @property
    def torque_units(self) -> Mapping[bytes, float]:
        """See ``MotorDevice``: of its motor's current."""
        return {b"A": self.gain_N_m_A or 0.0}

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        before = self._place(name, around)
        question_s, answer_s = self._on_wire_s(around, before)
        turns = 1 if self.fast_sync_read else 1 + before  # each waits for its return delay, or the first for all
        longest_s = RETURN_DELAY_S * turns + self._on_wire_s(around, 0)[1] - answer_s
        spec = PolledChannel(1e9 * question_s, 1e9 * answer_s, 1e9 * longest_s)
        return dict.fromkeys(self.settings(name).channels, spec)

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        cause = "its answer and those after it on the wire; it samples between the question's end and its answer"
        _, answer_s = self._on_wire_s(around, self._place(name, around))
        found = self.settings(name).channels
        return [Delay(channel, "", answer_s, 1e-3 * self.delay_sigma_ms, cause) for channel in found]

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        found = super().roles(name, period_s)
        single = abs(self.counts_per_revolution) <= COUNTS
        return found._replace(signals={**found.signals, name: found.signals[name]._replace(absolute=single)})

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``: what is asked must fit on the line."""
        yield from super().problems(name, around)
        if self.torque_sigma_N_m is not None and self.gain_N_m_A is None:
            yield ["device", name, "torque_sigma_N_m"], f"{name!r} measures a current; give gain_N_m_A"
        servos = list(around.devices_on(self.bus))
        round_ms = 1e3 * (RETURN_DELAY_S + sum(self._on_wire_s(around, 0)))
        if servos[0] == name and round_ms > min(self.sample_period_ms, self.timeout_ms):
            text = f"a round of {len(servos)} servos takes {round_ms:.1f} ms on {self.bus!r}: raise its baud rate"
            yield ["device", name], f"{text}, sample_period_ms or timeout_ms"

    def _place(self, name: str, around: Surroundings) -> int:
        """Servos that answer before it."""
        return list(around.devices_on(self.bus)).index(name)

    def _on_wire_s(self, around: Surroundings, before: int) -> tuple[float, float]:
        """Times of the question, and of the answer less those of the first ``before`` servos, at the least."""
        others, baud = around.devices_on(self.bus).values(), around.baud(self.bus)
        servos, is_driven = len(others), any(isinstance(one, DrivenDevice) and one.driven for one in others)
        block = (DRIVEN, DRIVEN_BYTES) if is_driven else (PRESENT, PRESENT_BYTES)
        question = len(sync_read_request(range(servos), *block))
        whole, first = (answer_bytes(n, block[1], fast=self.fast_sync_read) for n in (servos, before))
        return on_wire_s(question, baud), on_wire_s(whole - (first if before else 0), baud)
