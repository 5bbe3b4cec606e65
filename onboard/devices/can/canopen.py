"""CAN: the SYNC of a bus, and the base of all CANopen nodes, which answer it."""

from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drivers import transports
from drivers.canopen_pdo.bus import CanopenBus
from drivers.canopen_pdo.guarding import GuardConfig
from drivers.canopen_pdo.sync import SyncConfig
from drivers.device import Device
from drivers.records import CAN_SYNC, SCALAR
from onboard.devices.base import BusDevice, OpeningBus, Problem, Surroundings
from onboard.section import NotNegative, Positive
from onboard.timebase.delays import Delay
from onboard.timebase.timebase import ChannelClock, FollowerChannel, ProducerChannel


class CanDevice(BusDevice):
    """On CAN: all nodes of a bus and its SYNC are one driver."""

    bus_type = "CAN"
    urls = transports.CAN_URLS
    shares_bus = True

    @classmethod
    def open_on(cls, bus: OpeningBus) -> list[Device]:
        """See ``BusDevice``."""
        port = bus.own(transports.open_can(bus.url, bus.clock))
        sync_name, sync = sync_on(bus.around, bus.name)
        nodes = {name: device for name, device in bus.devices.items() if isinstance(device, CanopenNodeDevice)}
        guards = {device.node: device.guard for device in nodes.values() if device.guard is not None}
        settings = [device.settings(name) for name, device in nodes.items()]
        timing = sync.settings(sync_name)
        return [CanopenBus(port, settings, timing, bus.name, list(guards.values()), bus.around.play(bus.name))]

    @classmethod
    def bus_problems(cls, bus: str, devices: Mapping[str, BusDevice]) -> Iterator[Problem]:
        """See ``BusDevice``."""
        syncs = [name for name, device in devices.items() if isinstance(device, CanopenSyncDevice)]
        if len(syncs) != 1:
            text = f"bus {bus!r} has {len(syncs)} canopen_sync devices; it needs exactly one"
            yield ["device", next(iter(devices))], text
        by_node: dict[int, tuple[str, CanopenNodeDevice]] = {}
        profiles: dict[int, str] = {}
        for name, device in devices.items():
            if not isinstance(device, CanopenNodeDevice):
                continue
            other, first_of_node = by_node.setdefault(device.node, (name, device))
            if device.guard != first_of_node.guard:
                text = f"{name!r} and {other!r} are the same node; give both the same supervision"
                yield ["device", name], text
            if device.is_profile and profiles.setdefault(device.node, name) != name:
                text = f"{name!r} and {profiles[device.node]!r} are both node {device.node}; set the same profile"
                yield ["device", name, "node"], f"{text}: give each its number, or take a canopen_object"


class CanopenSyncDevice(CanDevice):
    """The SYNC messages on a CAN bus; ``delay_ms`` is the time a SYNC frame takes on the wire."""

    about_role = "clock of its bus"
    about_clock = "SYNC numbers, fitted to the sync pulses by counter and code."
    records = CAN_SYNC
    first_row_s = 0.15  # it talks unasked
    driver_configs = (SyncConfig,)
    kind: Literal["canopen_sync"]
    period_ms: Positive
    delay_ms: Annotated[
        NotNegative, Field(description="Time of a SYNC frame on the wire: nodes sample at its end.")
    ] = 0.0

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        return {name: ProducerChannel(self.period_ms * 1e6, self.delay_ms * 1e6)}

    def settings(self, name: str) -> SyncConfig:
        """See ``BusDevice``."""
        return SyncConfig(name, self.period_ms)


class CanopenNodeDevice(CanDevice):
    """A CANopen node, or a channel of one.

    ``supervision = "guarding"``: a node without heartbeat is polled every ``guard_time_ms``, and is lost after
    ``life_time_factor`` requests without an answer.
    """

    new_bus = "can_0"
    is_profile: ClassVar[bool] = True  # it sets its node up, so that there is one of them on a node
    about_clock = "The number of the SYNC that it answers."
    driver_configs: ClassVar[tuple[type, ...]] = (GuardConfig,)
    records = SCALAR
    node: Annotated[int, Field(ge=1, le=127)]
    supervision: Literal["heartbeat", "guarding"] = "heartbeat"
    guard_time_ms: int = GuardConfig.guard_time_ms
    life_time_factor: int = GuardConfig.life_time_factor

    def rate_on(self, around: Surroundings) -> float:
        """One for each SYNC."""
        return sync_on(around, self.bus)[1].nominal_hz

    @property
    def answers_sync(self) -> bool:
        """It samples on every SYNC."""
        return True

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        if not self.answers_sync:
            return {}
        return dict.fromkeys(self.channels(name), FollowerChannel(sync_on(around, self.bus)[0]))

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        if not self.answers_sync:
            return super().delays(name, around)
        sync_name, sync = sync_on(around, self.bus)
        cause = f"SYNC frame of {sync_name} on the wire: nodes sample at its end"
        on_wire = [Delay(channel, "", -sync.delay_ms * 1e-3, 0.0, cause) for channel in self.channels(name)]
        return super().delays(name, around) + on_wire

    def verify(self, name: str) -> None:
        """See ``BusDevice``."""
        super().verify(name)
        self.guard  # noqa: B018 - it refuses what guarding does not have

    @property
    def guard(self) -> GuardConfig | None:
        """How the node is guarded, if it is.

        Raises:
            ConfigurationError: a time or factor that guarding does not have.
        """
        guarded = self.supervision == "guarding"
        return GuardConfig(self.node, self.guard_time_ms, self.life_time_factor) if guarded else None


def sync_on(around: Surroundings, bus: str) -> tuple[str, CanopenSyncDevice]:
    """Name and device of a CAN bus's SYNC; there is one."""
    on_bus = around.devices_on(bus).items()
    return next((name, device) for name, device in on_bus if isinstance(device, CanopenSyncDevice))
