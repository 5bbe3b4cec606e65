"""From a scenario's ``[device.*]`` tables to twins on their buses."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import TypeVar

import numpy as np

from hil_sim.buses.gpio.pair import PairBus
from hil_sim.buses.media import Bus, CanBus, I2cBus, PulseLine
from hil_sim.buses.network import NetworkBus
from hil_sim.buses.serial_bus import SerialBus
from hil_sim.buses.spi import SpiBus
from hil_sim.devices import registry, wiring
from hil_sim.devices.emulator import Bench, Emulator, Twin
from hil_sim.devices.sync.sync_box import SYNC_COB_ID
from hil_sim.faults import DeviceFaults, FaultError
from hil_sim.plants.drives.servo_axis import DriveJoint
from hil_sim.plants.world import Plant
from hil_sim.scenario import sensor_tables
from hil_sim.scenario.bus_tables import CanBusTable, PulseLineTable
from hil_sim.scenario.load import Scenario, ScenarioError
from hil_sim.sensing.analog import ChipClock
from hil_sim.sensing.controller_sensors import MotorTorqueSensor, PhaseSensor, TachoSensor, ThrustSensor, of_actuator
from hil_sim.sensing.pose_sensor import PoseSensor
from hil_sim.sensing.sensors import EncoderSensor, ImuSensor, LoadCellSensor

Sensor = (
    ImuSensor
    | EncoderSensor
    | LoadCellSensor
    | MotorTorqueSensor
    | PhaseSensor
    | PoseSensor
    | TachoSensor
    | ThrustSensor
)
Kind = TypeVar("Kind")


def emulators(scenario: Scenario) -> dict[str, Emulator]:
    """The device tables of a scenario, read and held against its buses, sensors and clocks.

    Raises:
        ScenarioError: naming each wrong key by its dotted path.
    """
    try:
        devices = registry.read(scenario.device, scenario.files)
        wrong = list(wiring.problems(scenario.bus, devices, scenario.sensor, scenario.clock))
        if wrong:
            raise ScenarioError(f"{'; '.join(wrong)}. Correct these keys")
    except ScenarioError as error:
        label = f"scenario {scenario.scenario.name}"
        raise ScenarioError(f"{label} cannot be used: {error}", error.refused, label, error.files) from error
    return devices


def sensor(plant: Plant, table: sensor_tables.SensorTable, rng: np.random.Generator, at: str) -> Sensor:
    """An example of the sensor that ``table`` describes, at a place in the plant.

    Raises:
        ScenarioError: no such place.
    """
    match table:
        case sensor_tables.ImuTable():
            return ImuSensor(plant, table, rng, at)
        case sensor_tables.EncoderTable():
            return EncoderSensor(plant, table, rng, at)
        case sensor_tables.LoadCellTable() | sensor_tables.ForceCellTable():
            return LoadCellSensor(plant, table, rng, at)
        case sensor_tables.MotorTorqueTable():
            return MotorTorqueSensor(plant, table, rng, at)
        case sensor_tables.WheelRateTable() | sensor_tables.ThrustTable():
            return of_actuator(plant, table, rng, at)
        case sensor_tables.PoseTable() | sensor_tables.PhaseTable():
            return (
                PoseSensor(plant, table, rng, at) if isinstance(table, sensor_tables.PoseTable) else PhaseSensor(plant)
            )


class Twins:
    """The devices of a mission, made and plugged in.

    Args:
        scenario: Its wiring.
        devices: Its device tables.
        buses: Those of the scenario, by name.
        sensors: What every signal of the devices measures, by name.
        clocks: Every oscillator, by name.
        faults: Gives the faults of a device.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up.
        seed: Of what the twins draw for themselves, each with its name: two of a kind draw other numbers.
        axes: Joints of the drives that the flight computer commands, by device.

    Attributes:
        devices: What was plugged in, by name.

    Raises:
        ScenarioError: a device that cannot be as its table says.
        FaultError: a fault that its device cannot have.
    """

    def __init__(
        self,
        scenario: Scenario,
        devices: Mapping[str, Emulator],
        buses: Mapping[str, Bus],
        sensors: Mapping[str, Sensor],
        clocks: Mapping[str, ChipClock],
        faults: Callable[[str], DeviceFaults],
        start_ns: int,
        seed: int,
        axes: Mapping[str, DriveJoint],
    ) -> None:
        self._scenario = scenario
        self._buses = buses
        self._produced: dict[str, Callable[[], int]] = {}  # by channel
        twins: dict[str, Twin] = {}
        for name, table in devices.items():
            place = None if table.bus is None else scenario.bus[table.bus]
            try:
                own_seed = int(np.random.SeedSequence([seed, *name.encode()]).generate_state(1)[0])
                bench = Bench(name, sensors, clocks, faults(name), start_ns, own_seed, place, axes.get(name))
                twins[name] = table.build(bench)
                self._plug(table, twins[name])
            except FaultError:
                raise
            except ValueError as error:
                raise ScenarioError(f"device.{name}: {error} Correct its table.") from error
        for name, twin in twins.items():
            line = devices[name].drives
            if twin.drive_pin is not None and line is not None:
                for pin in (*(each.pin for each in twins.values()), self._bus(line, PulseLine).edge):
                    if pin is not None:
                        twin.drive_pin(pin)
        self.devices = {name: twin.device for name, twin in twins.items()}
        for name, bus in buses.items():
            bus.inject(faults(name))

    def produced(self) -> dict[str, int]:
        """Samples made so far, per channel of the flight log."""
        for bus in self._buses.values():
            if isinstance(bus, CanBus):
                bus.look()
        counts = {channel: made() for channel, made in self._produced.items()}
        for name, table in self._scenario.bus.items():
            bus = self._buses[name]
            if isinstance(table, CanBusTable) and isinstance(bus, CanBus) and table.sync_channel is not None:
                counts[table.sync_channel] = bus.heard[SYNC_COB_ID]
            elif isinstance(table, PulseLineTable) and isinstance(bus, PulseLine):
                counts[table.channel] = bus.heard
        return counts

    def _plug(self, table: Emulator, twin: Twin) -> None:
        """Put a twin on its bus, and know how its samples are counted there."""
        made, counted = twin.produced, dict[str, Callable[[], int]]()
        if table.bus is None:
            if table.drives is not None:
                self._bus(table.drives, PulseLine).drive(twin.device)
        elif table.needs == "i2c":
            self._bus(table.bus, I2cBus).add(twin.device)
        elif table.needs == "pair":
            self._bus(table.bus, PairBus).add(twin.device)
        elif table.needs == "spi":
            self._bus(table.bus, SpiBus).add(twin.device)
        elif table.needs == "can":
            bus = self._bus(table.bus, CanBus)
            bus.add(twin.device)
            counted = {c: partial(bus.heard.__getitem__, one) for c, one in (twin.identifiers or {}).items()}
        elif table.needs in ("tcp", "udp"):
            self._bus(table.bus, NetworkBus).add(twin.device)
        else:
            made = self._plug_serial(self._bus(table.bus, SerialBus), twin)
        self._produced |= dict.fromkeys(twin.channels, made) | counted

    @staticmethod
    def _plug_serial(bus: SerialBus, twin: Twin) -> Callable[[], int]:
        if twin.sample_length is None:  # it is asked, and makes a sample for each question
            bus.add(twin.device, asks=twin.asks)
            return lambda: bus.questions
        bus.add(twin.device, twin.produced, twin.sample_length)
        return lambda: bus.samples

    def _bus(self, name: str, kind: type[Kind]) -> Kind:
        bus = self._buses[name]
        if not isinstance(bus, kind):
            raise ScenarioError(f"bus.{name} was opened as {type(bus).__name__}; give a bus of kind {kind.__name__}")
        return bus
