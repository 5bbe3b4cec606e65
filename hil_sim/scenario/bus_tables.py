"""Tables of a scenario: the buses, ``[bus.NAME]``, and that of a device, ``[device.NAME]``, as far as all have it."""

from typing import Annotated, Literal

from pydantic import ConfigDict, Field, PositiveInt

from hil_sim.scenario.sensor_tables import NonNegative, Table


class I2cBusTable(Table):
    """Two wires."""

    kind: Literal["i2c"]
    bit_rate: PositiveInt = 400_000


class CanBusTable(Table):
    """A CAN bus. ``sync_channel``: what the flight computer records its SYNCs as."""

    kind: Literal["can"]
    bit_rate: PositiveInt = 500_000
    sync_channel: str | None = None


class PulseLineTable(Table):
    """The line of the sync pulse. ``channel``: what the flight computer records its edges as."""

    kind: Literal["pulse"]
    channel: str


class PairBusTable(Table):
    """A clock line and a data line to one chip."""

    kind: Literal["pair"]


class SpiBusTable(Table):
    """SPI with one chip on a select line."""

    kind: Literal["spi"]


class SerialBusTable(Table):
    """A line to one device; ``adapter_latency_ms``: latency timer of a USB adapter, 0 without one."""

    kind: Literal["serial"]
    baud_rate: PositiveInt = 115_200
    parity: Literal["N", "E", "O"] = "N"
    stop_bits: Literal[1, 2] = 1
    adapter_latency_ms: NonNegative = 0.0


class TcpBusTable(Table):
    """A network with one device that listens."""

    kind: Literal["tcp"]


class UdpBusTable(Table):
    """A network with one device that sends datagrams."""

    kind: Literal["udp"]


BusTable = Annotated[
    I2cBusTable
    | CanBusTable
    | PulseLineTable
    | PairBusTable
    | SpiBusTable
    | SerialBusTable
    | TcpBusTable
    | UdpBusTable,
    Field(discriminator="kind"),
]


class DeviceTable(Table):
    """``[device.NAME]``. The rest of its keys are those of the emulator of its ``kind``, which reads them."""

    model_config = ConfigDict(extra="allow")

    kind: str
