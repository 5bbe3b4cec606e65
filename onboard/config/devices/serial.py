"""Devices on a serial line of their own. The line's speed and format stand in the URL of its bus."""

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from drivers.dsc_load_cell.message import DscLoadCellConfig
from drivers.marks import MARK
from drivers.modbus_load_cell.registers import ModbusLoadCellConfig
from drivers.nimu.packet import NimuConfig
from drivers.node_frame.frame import NodeFrameConfig
from drivers.qsb.registers import QsbConfig
from drivers.records import IMU, SCALAR
from onboard.config.devices.base import BusDevice, BusType, Channels, ImuDevice, JointDevice, LoadCellDevice
from onboard.config.devices.node_channels import NodeChannel
from onboard.config.types import NotNegative, Positive


class SerialDevice(BusDevice):
    """A device on a serial line. ``poll_period_ms``: how often the port is read."""

    bus_type = BusType.SERIAL
    records = SCALAR
    poll_period_ms: Positive


class NimuDevice(SerialDevice, ImuDevice):
    """Memsense nIMU. ``gyro_delay_ms`` and ``accel_delay_ms`` are those of its own filters.

    ``latency_ms``: from the sample to the first bit of its packet, as measured; half a sample period, give or take all
    of it, where not given.
    """

    records = IMU
    kind: Literal["nimu"]
    sample_rate_hz: Positive
    gyro_delay_ms: NotNegative = 0.0
    accel_delay_ms: NotNegative = 0.0
    latency_ms: NotNegative | None = None
    latency_sigma_ms: NotNegative = 0.0
    accel_range_g: float = NimuConfig.accel_range_g
    gyro_range_deg_s: float = NimuConfig.gyro_range_deg_s
    accel_scale_g: float = NimuConfig.accel_scale_g
    gyro_scale_deg_s: float = NimuConfig.gyro_scale_deg_s
    magnetometer: bool = NimuConfig.magnetometer
    magnetometer_scale_gauss: float = NimuConfig.magnetometer_scale_gauss
    checksum_span: Literal["packet", "after_sync", "payload"] = "packet"
    poll_period_ms: Positive = NimuConfig.poll_period_ms
    silence_ms: Positive = NimuConfig.silence_ms

    @property
    def nominal_hz(self) -> float:
        """Nominal."""
        return self.sample_rate_hz

    def channels(self, name: str) -> Channels:
        """The IMU, and its magnetometer where wanted."""
        magnetometer = [f"{name}_mag_{axis}" for axis in "xyz"] if self.magnetometer else []
        return {name: IMU, **dict.fromkeys(magnetometer, SCALAR)}

    def settings(self, name: str) -> NimuConfig:
        """See ``BusDevice``."""
        return self._settings(NimuConfig)


class QsbDevice(SerialDevice, JointDevice):
    """US Digital QSB counter of an incremental encoder; ``sync_edge``: of the sync line, on its digital I/O 0."""

    kind: Literal["qsb"]
    counting: Literal[1, 2, 4] = 4
    count_down: bool = QsbConfig.count_down
    interval_ticks: int = QsbConfig.interval_ticks
    tick_jitter: int = QsbConfig.tick_jitter
    sync_edge: Literal["rising", "falling", "none"] = "rising"
    poll_period_ms: Positive = QsbConfig.poll_period_ms
    silence_ms: Positive = QsbConfig.silence_ms
    reply_timeout_ms: Positive = QsbConfig.reply_timeout_ms

    @property
    def nominal_hz(self) -> float:
        """Nominal, give or take 1.4 %."""
        return 1e9 / self.settings("").interval_ns

    def channels(self, name: str) -> Channels:
        """Positions, and what was latched on the sync line's edges."""
        return {name: SCALAR, f"{name}_mark": MARK}

    def settings(self, name: str) -> QsbConfig:
        """See ``BusDevice``."""
        return self._settings(QsbConfig, sync_edge=None if self.sync_edge == "none" else self.sync_edge)


class PolledLoadCellDevice(SerialDevice, LoadCellDevice):
    """A load cell that is asked for each sample; ``sample_period_ms`` shorter than the link allows: back to back."""

    sample_period_ms: Positive
    timeout_ms: Positive

    @property
    def nominal_hz(self) -> float:
        """As it is asked for."""
        return 1e3 / self.sample_period_ms


class ModbusLoadCellDevice(PolledLoadCellDevice):
    """Load cell transmitter on Modbus-RTU (Laumas map). The first of ``values`` is the force that is estimated with.

    ``scale`` and ``unit``: of a count; by the transmitter's own division and unit where not given.
    """

    kind: Literal["modbus_load_cell"]
    address: Annotated[int, Field(ge=1, le=247)] = ModbusLoadCellConfig.address
    values: tuple[Literal["gross", "net"], ...] = ("gross",)
    scale: float | None = None
    unit: str | None = None
    sign: Literal["status", "twos_complement", "positive"] = "status"
    echo: bool = ModbusLoadCellConfig.echo
    timeout_ms: Positive = ModbusLoadCellConfig.timeout_ms
    poll_period_ms: Positive = ModbusLoadCellConfig.poll_period_ms

    def channels(self, name: str) -> Channels:
        """One of the device's name, or one for each of both values."""
        single = len(self.values) == 1
        return dict.fromkeys([name] if single else [f"{name}_{value}" for value in self.values], SCALAR)

    def settings(self, name: str) -> ModbusLoadCellConfig:
        """See ``BusDevice``. The link's bit rate stands in the bus URL: see ``at_baud``."""
        return self._settings(ModbusLoadCellConfig)

    def at_baud(self, name: str, baud: int) -> ModbusLoadCellConfig:
        """The driver's configuration on a link of this bit rate, which decides the silence between frames."""
        return replace(self.settings(name), baud=baud)


class DscLoadCellDevice(PolledLoadCellDevice):
    """Mantracourt DSC digitiser; ``unit`` is what its system calibration makes of it."""

    kind: Literal["dsc_load_cell"]
    station: int = DscLoadCellConfig.station
    command: str = DscLoadCellConfig.command
    unit: str = DscLoadCellConfig.unit
    timeout_ms: Positive = DscLoadCellConfig.timeout_ms
    poll_period_ms: Positive = DscLoadCellConfig.poll_period_ms

    def settings(self, name: str) -> DscLoadCellConfig:
        """See ``BusDevice``."""
        return self._settings(DscLoadCellConfig)


class NodeFrameDevice(SerialDevice):
    """A node of one's own making (``docs/node_frame.md``), its channels in the order of its descriptor.

    ``frame``: of the URDF, for its gyro and accel channels. ``tick_hz``: nominal rate of its clock. ``rate_hz``: of its
    data frames.
    """

    kind: Literal["node_frame"]
    node: int = NodeFrameConfig.node
    tick_hz: Positive
    rate_hz: Positive
    frame: str | None = None
    channel: Annotated[tuple[NodeChannel, ...], Field(min_length=1)]
    poll_period_ms: Positive = NodeFrameConfig.poll_period_ms
    silence_ms: Positive = NodeFrameConfig.silence_ms

    @property
    def nominal_hz(self) -> float:
        """Nominal, of its data frames."""
        return self.rate_hz

    def channels(self, name: str) -> Channels:
        """Its channels, and the sync line's edges by its clock."""
        return {**{f"{name}_{channel.name}": SCALAR for channel in self.channel}, f"{name}_mark": MARK}

    def settings(self, name: str) -> NodeFrameConfig:
        """See ``BusDevice``."""
        return self._settings(NodeFrameConfig, channels=tuple(channel.name for channel in self.channel))
