"""Tables of a scenario: the buses, ``[bus.NAME]``, and the devices on them, ``[device.NAME]``.

A device is a twin of ``hil_sim.devices`` by ``kind``, on ``bus``; ``measures`` names the ``[sensor.*]`` table of its
sensing element, and ``at`` the place in the plant where that sits, if there are several. Its name is also the flight
computer's channel name and the key of its faults, clock and random numbers.
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field, PositiveFloat, PositiveInt

from hil_sim.scenario.sensor_tables import NonNegative, Quantity, Table

DSC_BAUD_RATES = (2400, 4800, 9600, 19_200, 38_400, 57_600, 76_800, 115_200)  # by code
_FORCES: tuple[Quantity, ...] = ("joint_moment", "force")
_SCALARS: tuple[Quantity, ...] = ("joint_angle", *_FORCES, "servo_torque", "phase")


class Signal(NamedTuple):
    """A signal that a device measures.

    Attributes:
        sensor: Name of the table of its sensor.
        quantities: What that may be.
        at: Where in the plant; "" where there is one place only.
    """

    sensor: str
    quantities: tuple[Quantity, ...]
    at: str


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


class SerialBusTable(Table):
    """A line to one device; ``adapter_latency_ms``: latency timer of a USB adapter, 0 without one."""

    kind: Literal["serial"]
    baud_rate: PositiveInt = 115_200
    parity: Literal["N", "E", "O"] = "N"
    stop_bits: Literal[1, 2] = 1
    adapter_latency_ms: NonNegative = 0.0


BusTable = Annotated[I2cBusTable | CanBusTable | PulseLineTable | SerialBusTable, Field(discriminator="kind")]


class Device(Table):
    """What every device has."""

    needs: ClassVar[str] = "serial"  # kind of its bus
    has_clock: ClassVar[bool] = True  # a CANopen node has that of its twin
    baud_rates: ClassVar[tuple[int, ...]] = ()  # on a serial line: those it can have, if it cannot have all

    bus: str | None

    @property
    def place(self) -> str:
        """Of which there is one on its bus."""
        return "the line"

    def signals(self, name: str) -> dict[str, Signal]:
        """What it measures, by the name that the signal's random numbers go by."""
        del name
        return {}

    def clocks(self, name: str) -> tuple[str, ...]:
        """Its oscillators."""
        return (name,) if self.has_clock else ()


class _Measuring(Device):
    bus: str
    measures: str
    at: str = ""
    quantities: ClassVar[tuple[Quantity, ...]]

    def signals(self, name: str) -> dict[str, Signal]:
        """See ``Device``."""
        return {name: Signal(self.measures, self.quantities, self.at)}


class _CanNode(_Measuring):
    needs = "can"
    has_clock = False

    node: Annotated[int, Field(ge=1, le=127)]
    supervision: Literal["heartbeat", "guarding"] = "heartbeat"

    @property
    def place(self) -> str:
        """See ``Device``."""
        return f"node {self.node}"


class SyncBoxTable(Device):
    """The box that numbers time: pulses on ``line``, which also reaches every device with ``sync_input``.

    On a CAN bus it sends SYNC too, every ``period_ms``.
    """

    needs = "can"

    kind: Literal["sync_box"]
    line: str
    period_ms: PositiveFloat = 5.0
    bus: str | None = None

    @property
    def place(self) -> str:
        """See ``Device``."""
        return "the sync box"


class Mpu6050Table(_Measuring):
    """An MPU-6050. Its RC oscillator is the clock ``NAME_rc``."""

    needs = "i2c"
    quantities = ("inertial",)

    kind: Literal["mpu6050"]
    address: Annotated[int, Field(ge=0x68, le=0x69)] = 0x68
    sync_input: bool = True

    @property
    def place(self) -> str:
        """See ``Device``."""
        return f"address {self.address:#04x}"

    def clocks(self, name: str) -> tuple[str, ...]:
        """See ``Device``."""
        return name, f"{name}_rc"


class NimuTable(_Measuring):
    """A Memsense nIMU."""

    quantities = ("inertial",)

    kind: Literal["nimu"]
    rate_Hz: PositiveFloat = 150.0
    checksum: Literal["packet", "after_sync", "payload"] = "packet"
    magnetometer: bool = True  # whether its words are recorded, as NAME_mag_x, _y, _z; they are sent always


class QsbTable(_Measuring):
    """A US Digital QSB. It counts from 0 at power-up."""

    baud_rates = (230_400,)
    quantities = ("joint_angle",)

    kind: Literal["qsb"]
    tick: Literal["1/512 s", "1.9 ms"] = "1/512 s"
    sync_input: bool = True


class Encoder406Table(_CanNode):
    """A CiA 406 encoder."""

    quantities = ("joint_angle",)

    kind: Literal["encoder406"]
    zero_count: Annotated[int, Field(ge=0, lt=2**32)] = 0


class Drive402Table(_CanNode):
    """A CiA 402 drive. ``torque`` names its motor's sensor; ``channels``: what is recorded beside the angle."""

    quantities = ("joint_angle",)

    kind: Literal["drive402"]
    torque: str
    zero_count: Annotated[int, Field(ge=-(2**31), lt=2**31)] = 0
    rated_torque_Nm: PositiveFloat
    velocity_window_ms: PositiveFloat = 4.0
    channels: tuple[Literal["velocity", "torque"], ...] = ()

    def signals(self, name: str) -> dict[str, Signal]:
        """See ``Device``."""
        return {**super().signals(name), f"{name}_torque": Signal(self.torque, ("servo_torque",), self.at)}


class LoadCell404Table(_CanNode):
    """A CiA 404 transmitter."""

    quantities = _FORCES

    kind: Literal["loadcell404"]
    flags_overload: bool = False


class ModbusLoadCellTable(_Measuring):
    """A transmitter with the Laumas map; ``signs_in_status``: magnitudes, and their signs in the status word."""

    quantities = _FORCES

    kind: Literal["modbus_load_cell"]
    station: Annotated[int, Field(ge=1, le=247)] = 1
    division_code: Annotated[int, Field(ge=0, le=18)] = 15  # 1 mN
    signs_in_status: bool = True
    reply_ms: NonNegative = 0.5


class DscLoadCellTable(_Measuring):
    """A Mantracourt DSC; ``delay_ms``: shortest and longest time that it takes to answer."""

    baud_rates = DSC_BAUD_RATES
    quantities = _FORCES

    kind: Literal["dsc_load_cell"]
    station: Annotated[int, Field(ge=1, le=999)] = 1
    rate_code: Annotated[int, Field(ge=0, le=9)] = 9  # 500 conversions a second
    delay_ms: tuple[NonNegative, NonNegative] = (1.0, 5.0)


class ArmControllerTable(_CanNode):
    """The arm controller that tells the phase."""

    quantities = ("phase",)

    kind: Literal["arm_controller"]


class NodeChannelTable(Table):
    """One channel of a node; recorded as ``NODE_NAME``. One count is ``mantissa`` x 10^``exponent`` ``unit``."""

    name: Annotated[str, Field(min_length=1, max_length=16)]
    measures: str
    at: str = ""
    unit: Annotated[str, Field(min_length=1, max_length=8)]
    type: Literal["u8", "i8", "u16", "i16", "u32", "i32", "i64"]
    mantissa: int = 1
    exponent: int = 0
    wraps: bool = False


class NodeFrameTable(Device):
    """A microcontroller of one's own that speaks the node frame."""

    kind: Literal["node_frame"]
    bus: str
    node: Annotated[int, Field(ge=0, le=255)] = 1
    rate_Hz: PositiveFloat = 200.0
    tick_Hz: PositiveInt = 1_000_000
    sync_input: bool = True
    channel: Annotated[tuple[NodeChannelTable, ...], Field(min_length=1, max_length=65)]

    def signals(self, name: str) -> dict[str, Signal]:
        """See ``Device``."""
        return {f"{name}_{channel.name}": Signal(channel.measures, _SCALARS, channel.at) for channel in self.channel}


DeviceTable = Annotated[
    SyncBoxTable
    | Mpu6050Table
    | NimuTable
    | QsbTable
    | Encoder406Table
    | Drive402Table
    | LoadCell404Table
    | ModbusLoadCellTable
    | DscLoadCellTable
    | ArmControllerTable
    | NodeFrameTable,
    Field(discriminator="kind"),
]
