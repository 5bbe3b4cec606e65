"""Custom sensor node with the node frame, on a serial line."""

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Annotated, Literal

from pydantic import Field

from drivers.marks import MARK
from drivers.node_frame.device import NodeFrame
from drivers.node_frame.frame import NodeFrameConfig
from drivers.records import SCALAR, Rows
from onboard.devices.base import Channels, Clock, Problem, Surroundings, first_leads
from onboard.devices.buses import OpenSerial, PollPeriod, SerialLineDevice
from onboard.devices.roles import ImuRole, Roles
from onboard.devices.serial_line.node_channels import InertialChannel, NodeChannel
from onboard.section import Positive
from onboard.timebase.delays import Delay
from onboard.timebase.timebase import ChannelClock, MarkedChannel

IMU_PARTS = tuple((role, axis) for role in ("gyro", "accel") for axis in "xyz")


class NodeFrameDevice(SerialLineDevice):
    """Custom sensor node (``docs/node_frame.md``), its channels in the order of its descriptor.

    ``frame``: of the URDF, for its gyro and accel channels. ``tick_hz``: nominal rate of its clock. ``rate_hz``: of its
    data frames.
    """

    about_role = "by channel"
    about_clock = "The node's ticks, fitted to the sync edges that it stamps."
    driver_configs = (NodeFrameConfig,)
    first_row_s = 0.15  # it talks unasked
    kind: Literal["node_frame"]
    node: int = NodeFrameConfig.node
    tick_hz: Positive
    rate_hz: Positive
    frame: Annotated[
        str | None, Field(description="Link, joint or frame of the URDF that its gyro and accel channels measure in.")
    ] = None
    channel: Annotated[tuple[NodeChannel, ...], Field(min_length=1)]
    poll_period_ms: PollPeriod = NodeFrameConfig.poll_period_ms
    silence_ms: Positive = NodeFrameConfig.silence_ms

    def channels(self, name: str) -> Channels:
        """Its channels, and the sync line's edges by its clock."""
        return {**{f"{name}_{channel.name}": SCALAR for channel in self.channel}, f"{name}_mark": MARK}

    def clocks(self, name: str, around: Surroundings) -> dict[str, ChannelClock]:
        """See ``DeviceSection``."""
        samples = {channel: records for channel, records in self.channels(name).items() if records == SCALAR}
        return first_leads(samples, MarkedChannel(1e9 / self.tick_hz, f"{name}_mark"))

    def delays(self, name: str, around: Surroundings) -> list[Delay]:
        """See ``DeviceSection``."""
        delays = (channel.delay(f"{name}_{channel.name}") for channel in self.channel)
        return [delay for delay in delays if delay is not None]

    def roles(self, name: str, period_s: float) -> Roles:
        """See ``DeviceSection``."""
        found = Roles.none()
        parts: dict[tuple[str, str], str] = {}
        for channel in self.channel:
            found.add(channel.roles(f"{name}_{channel.name}", period_s))
            if isinstance(channel, InertialChannel):
                parts[channel.role, channel.axis] = f"{name}_{channel.name}"
        if self.frame is not None and parts.keys() == set(IMU_PARTS):
            found.imus.append(ImuRole(tuple(parts[part] for part in IMU_PARTS), self.frame))
        return found

    def problems(self, name: str, around: Surroundings) -> Iterator[Problem]:
        """See ``DeviceSection``: gyro and accel channels are an IMU together, or not there."""
        axes = Counter((c.role, c.axis) for c in self.channel if isinstance(c, InertialChannel))
        if axes:
            if len(axes) != len(IMU_PARTS) or max(axes.values()) > 1:
                text = f"{name!r} is an IMU by parts; give gyro x, y, z and accel x, y, z, each once"
                yield ["device", name], text
            if self.frame is None:
                text = f"{name!r} has gyro and accel channels; give the frame that they measure in"
                yield ["device", name], text
        elif self.frame is not None:
            yield ["device", name, "frame"], f"{name!r} has no gyro or accel channels; leave frame out"

    @property
    def tick_rate_hz(self) -> float:
        """See ``BusDevice``."""
        return self.tick_hz

    def marks(self, name: str, rows: Mapping[str, Rows]) -> int:
        """See ``BusDevice``."""
        return len(rows.get(f"{name}_mark", ()))

    def settings(self, name: str) -> NodeFrameConfig:
        """See ``BusDevice``."""
        return self._settings(NodeFrameConfig, channels=tuple(channel.name for channel in self.channel))

    def driver(self, name: str, open_port: OpenSerial, clock: Clock, baud: int) -> NodeFrame:
        """See ``SerialLineDevice``."""
        return NodeFrame(name, open_port, clock, self.settings(name))
