"""What a device's table in a scenario says and does: ``[device.NAME]``, one class for each kind, which builds the twin.

A device is on ``bus``; ``measures`` names the ``[sensor.*]`` table of its sensing element, and ``at`` the place in the
plant where that sits, if there are several. Its name is also the flight computer's channel name and the key of its
faults, clock and random numbers. ``registry`` finds the kinds.
"""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Literal, NamedTuple, TypeVar

from hil_sim.devices.serial_wire import LineFormat
from hil_sim.devices.sync.sync_box import Pin
from hil_sim.faults import DeviceFaults
from hil_sim.plants.drives.servo_axis import DriveJoint
from hil_sim.scenario.bus_tables import SerialBusTable
from hil_sim.scenario.sensor_tables import MeasuredQuantity, Table
from hil_sim.scenario.sheets import Sheets
from hil_sim.scenario.tables import ScenarioError
from hil_sim.sensing.analog import ChipClock

FORCES: tuple[MeasuredQuantity, ...] = ("joint_moment", "force")
Sensor = TypeVar("Sensor")


class Signal(NamedTuple):
    """A signal that a device measures.

    Attributes:
        sensor: Name of the table of its sensor.
        quantities: What that may be.
        at: Where in the plant; "" where there is one place only.
    """

    sensor: str
    quantities: tuple[MeasuredQuantity, ...]
    at: str


class Bench(NamedTuple):
    """What a twin is made of.

    Attributes:
        name: Of the device.
        sensors: What every signal of the devices measures, by name.
        clocks: Every oscillator, by name.
        faults: What breaks in it.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up.
        seed: Of what it draws for itself, of this device alone.
        bus: The table of its bus.
        axis: The joint that it turns, where it is a drive that the flight computer commands.
    """

    name: str
    sensors: Mapping[str, Any]
    clocks: Mapping[str, ChipClock]
    faults: DeviceFaults
    start_ns: int
    seed: int
    bus: Table | None
    axis: DriveJoint | None = None

    @property
    def clock(self) -> ChipClock:
        """Its oscillator."""
        return self.clocks[self.name]

    @property
    def line(self) -> LineFormat:
        """Speed and format of its serial line.

        Raises:
            ValueError: it is on another bus.
        """
        if not isinstance(self.bus, SerialBusTable):
            raise ValueError("it is on no serial line.")
        return LineFormat(self.bus.baud_rate, self.bus.parity, self.bus.stop_bits)

    def sensor(self, kind: type[Sensor], signal: str = "") -> Sensor:
        """What one of its signals measures: ``NAME``, or ``NAME_signal``.

        Raises:
            ValueError: that is a sensor of another kind.
        """
        sensor = self.sensors[f"{self.name}_{signal}" if signal else self.name]
        if not isinstance(sensor, kind):
            raise ValueError(f"it measures with {type(sensor).__name__}; name another sensor.")
        return sensor


class Twin(NamedTuple):
    """A device that was made, and how it is plugged in.

    Attributes:
        device: What its bus carries.
        produced: Samples made so far.
        channels: Of the flight log, each with a row a sample.
        sample_length: On a serial line, where it talks unasked: bytes of a message that is a sample; 0 for others.
        pin: Its input for the sync line.
        drive_pin: Of the sync box: wires the sync line to an input.
        asks: On a serial line, where it is asked: how many samples a message of the flight computer asks for;
            None: each for one.
        identifiers: On a CAN bus, where it talks unasked: by channel, of the message that is a sample.
    """

    device: Any
    produced: Callable[[], int]
    channels: tuple[str, ...]
    sample_length: Callable[[bytes], int] | None = None
    pin: Pin | None = None
    drive_pin: Callable[[Pin], None] | None = None
    asks: Callable[[bytes], int] | None = None
    identifiers: Mapping[str, int] | None = None


class Equivalent(NamedTuple):
    """What stands in a scenario for a device of a vehicle file.

    Attributes:
        device: its emulator's table, but for ``kind`` and ``bus``.
        sensors: tables of what it measures with, by name.
        clocks: names of its oscillators in the data sheets, by clock; a crystal where not given.
    """

    device: dict[str, Any]
    sensors: dict[str, dict[str, Any]]
    clocks: dict[str, str]


class Emulator(Table):
    """What every device has."""

    needs: ClassVar[str] = "serial"  # kind of its bus
    where: ClassVar[str] = "the line"  # its place on that, with its keys in braces
    has_clock: ClassVar[bool] = True  # a CANopen node has that of its twin
    baud_rates: ClassVar[tuple[int, ...]] = ()  # on a serial line: those it can have, if it cannot have all
    turns_axis: ClassVar[bool] = False  # it can be a drive that the flight computer commands: ``Bench.axis``
    vehicle_kind: ClassVar[str | None] = None  # kind of device in a vehicle file, where it is another than its own

    kind: str
    bus: str | None

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """What stands for a device of a vehicle file in a scenario.

        Args:
            name: of the device.
            said: its table in the file, as it was written.
            sheets: what the file does not say.

        Raises:
            ScenarioError: it cannot be rehearsed, with the reason.
        """
        raise ScenarioError(
            f"device.{name}: the emulator of {said.get('kind')} has no from_vehicle (docs/extending.md); add it, or "
            "take the device out to rehearse"
        )

    @property
    def place(self) -> str:
        """Of which there is one on its bus."""
        return self.where.format_map(dict(self))

    @property
    def drives(self) -> str | None:
        """The pulse line that it drives."""
        return None

    def signals(self, name: str) -> dict[str, Signal]:
        """What it measures, by the name that the signal's random numbers go by."""
        del name
        return {}

    def clocks(self, name: str) -> tuple[str, ...]:
        """Its oscillators."""
        return (name,) if self.has_clock else ()

    def build(self, bench: Bench) -> Twin:
        """Make the device.

        Raises:
            FaultError: a fault that it cannot have.
            ValueError: it cannot be as this table says.
        """
        raise NotImplementedError


class MeasuringEmulator(Emulator):
    """A device that measures one thing."""

    bus: str
    measures: str
    at: str = ""
    quantities: ClassVar[tuple[MeasuredQuantity, ...]]

    def signals(self, name: str) -> dict[str, Signal]:
        """See ``Emulator``."""
        return {name: Signal(self.measures, self.quantities, self.at)}


class JointEmulator(MeasuringEmulator):
    """A joint's drive; ``torque`` names the sensor of its torque, ``channels``: recorded beside the angle."""

    quantities = ("joint_angle",)

    torque: str
    channels: tuple[Literal["velocity", "torque", "status"], ...] = ()

    def signals(self, name: str) -> dict[str, Signal]:
        """See ``Emulator``."""
        return {**super().signals(name), f"{name}_torque": Signal(self.torque, ("servo_torque",), self.at)}

    def recorded(self, name: str) -> tuple[str, ...]:
        """Channels that the flight computer records of it."""
        return name, *(f"{name}_{channel}" for channel in self.channels)
