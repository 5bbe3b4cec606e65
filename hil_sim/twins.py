"""From a scenario's ``[device.*]`` tables to twins on their buses."""

from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np

from hil_sim.buses.media import Bus, CanBus, I2cBus, PulseLine
from hil_sim.buses.serial_bus import SerialBus
from hil_sim.devices.arm_controller import ArmController
from hil_sim.devices.drive402 import Drive402
from hil_sim.devices.dsc_load_cell import DscLoadCell
from hil_sim.devices.encoder406 import Encoder406
from hil_sim.devices.loadcell404 import LoadCell404
from hil_sim.devices.modbus_load_cell import ModbusLoadCell
from hil_sim.devices.mpu6050 import Mpu6050
from hil_sim.devices.nimu import Nimu
from hil_sim.devices.node_frame import FrameNode, NodeChannel, ValueType
from hil_sim.devices.qsb import TICK_512_HZ, TICK_1900_US, Qsb
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.devices.sync_box import SYNC_COB_ID, Pin, SyncBox
from hil_sim.faults import DeviceFaults, FaultError
from hil_sim.plants.world import Plant
from hil_sim.scenario.device_tables import (
    DSC_BAUD_RATES,
    ArmControllerTable,
    CanBusTable,
    DeviceTable,
    Drive402Table,
    DscLoadCellTable,
    Encoder406Table,
    LoadCell404Table,
    ModbusLoadCellTable,
    Mpu6050Table,
    NimuTable,
    NodeChannelTable,
    NodeFrameTable,
    PulseLineTable,
    QsbTable,
    SerialBusTable,
    SyncBoxTable,
)
from hil_sim.scenario.load import Scenario, ScenarioError
from hil_sim.scenario.sensor_tables import Encoder, ForceCell, Imu, LoadCell, MotorTorque, Phase
from hil_sim.scenario.sensor_tables import Sensor as SensorTable
from hil_sim.sensing.analog import ChipClock
from hil_sim.sensing.controller_sensors import MotorTorqueSensor, PhaseSensor
from hil_sim.sensing.sensors import EncoderSensor, ImuSensor, LoadCellSensor

Sensor = ImuSensor | EncoderSensor | LoadCellSensor | MotorTorqueSensor | PhaseSensor
Kind = TypeVar("Kind")


def sensor(plant: Plant, table: SensorTable, rng: np.random.Generator, at: str) -> Sensor:
    """An example of the sensor that ``table`` describes, at a place in the plant.

    Raises:
        ScenarioError: no such place.
    """
    match table:
        case Imu():
            return ImuSensor(plant, table, rng, at)
        case Encoder():
            return EncoderSensor(plant, table, rng, at)
        case LoadCell() | ForceCell():
            return LoadCellSensor(plant, table, rng, at)
        case MotorTorque():
            return MotorTorqueSensor(plant, table, rng, at)
        case Phase():
            return PhaseSensor(plant)


class Twins:
    """The devices of a mission, made and plugged in.

    Args:
        scenario: Its wiring.
        buses: Those of the scenario, by name.
        sensors: What every signal of the devices measures, by name.
        clocks: Every oscillator, by name.
        faults: Gives the faults of a device.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up.
        seed: Of what a twin draws for itself.

    Raises:
        ScenarioError: a device that cannot be as its table says.
        FaultError: a fault that its device cannot have.
    """

    def __init__(
        self,
        scenario: Scenario,
        buses: Mapping[str, Bus],
        sensors: Mapping[str, Sensor],
        clocks: Mapping[str, ChipClock],
        faults: Callable[[str], DeviceFaults],
        start_ns: int,
        seed: int,
    ) -> None:
        self._scenario = scenario
        self._buses = buses
        self._sensors = sensors
        self._clocks = clocks
        self._faults = faults
        self._start_ns = start_ns
        self._seed = seed
        self._pins: list[Pin] = []
        self._produced: list[Callable[[], dict[str, int]]] = []
        box: tuple[SyncBox, PulseLine] | None = None
        for name, table in scenario.device.items():
            try:
                if isinstance(table, SyncBoxTable):
                    box = self._sync_box(name, table)
                else:
                    self._plug(name, table)
            except FaultError:
                raise
            except ValueError as error:
                raise ScenarioError(f"device.{name}: {error} Correct its table.") from error
        if box is not None:
            for pin in (*self._pins, box[1].edge):
                box[0].connect_pin(pin)
        for name, bus in buses.items():
            bus.inject(faults(name))

    def produced(self) -> dict[str, int]:
        """Samples made so far, per channel of the flight log."""
        counts: dict[str, int] = {}
        for produced in self._produced:
            counts |= produced()
        for name, table in self._scenario.bus.items():
            bus = self._buses[name]
            if isinstance(table, CanBusTable) and isinstance(bus, CanBus) and table.sync_channel is not None:
                counts[table.sync_channel] = bus.heard[SYNC_COB_ID]
            elif isinstance(table, PulseLineTable) and isinstance(bus, PulseLine):
                counts[table.channel] = bus.heard
        return counts

    def _sync_box(self, name: str, table: SyncBoxTable) -> tuple[SyncBox, PulseLine]:
        period_ns = round(table.period_ms * 1e6)
        box = SyncBox(self._clocks[name], self._start_ns, period_ns=period_ns, faults=self._faults(name))
        line = self._bus(table.line, PulseLine)
        if table.bus is None:
            line.drive(box)
        else:
            self._bus(table.bus, CanBus).add(box)
        return box, line

    def _plug(self, name: str, table: DeviceTable) -> None:
        match table:
            case Mpu6050Table():
                self._mpu6050(name, table)
            case Encoder406Table() | Drive402Table() | LoadCell404Table() | ArmControllerTable():
                self._can_node(name, table)
            case QsbTable():
                self._qsb(name, table)
            case NimuTable():
                self._nimu(name, table)
            case NodeFrameTable():
                self._node_frame(name, table)
            case ModbusLoadCellTable() | DscLoadCellTable():
                bus = self._bus(table.bus, SerialBus)
                bus.add(self._asked(name, table))
                self._produced.append(lambda: {name: bus.questions})

    def _mpu6050(self, name: str, table: Mpu6050Table) -> None:
        imu = Mpu6050(
            self._sensor(name, ImuSensor),
            self._clocks[name],
            self._start_ns,
            address=table.address,
            faults=self._faults(name),
            rc_clock=self._clocks[f"{name}_rc"],
        )
        self._bus(table.bus, I2cBus).add(imu)
        if table.sync_input:
            self._pins.append(imu.fsync)
        self._produced.append(lambda: {name: imu.sampled or imu.shown})

    def _can_node(
        self, name: str, table: Encoder406Table | Drive402Table | LoadCell404Table | ArmControllerTable
    ) -> None:
        node, start_ns, faults = table.node, self._start_ns, self._faults(name)
        channels = [name]
        twin: Encoder406 | Drive402 | LoadCell404 | ArmController
        match table:
            case Encoder406Table():
                encoder = self._sensor(name, EncoderSensor)
                counts = encoder.counts_per_revolution
                twin = Encoder406(
                    node, encoder, start_ns, zero_count=table.zero_count, counts_per_revolution=counts, faults=faults
                )
            case Drive402Table():
                encoder = self._sensor(name, EncoderSensor)
                twin = Drive402(
                    node,
                    encoder,
                    self._sensor(f"{name}_torque", MotorTorqueSensor),
                    start_ns,
                    increments_per_revolution=encoder.counts_per_revolution,
                    zero_increments=table.zero_count,
                    rated_torque_nm=table.rated_torque_Nm,
                    velocity_window_ns=round(table.velocity_window_ms * 1e6),
                    faults=faults,
                )
                channels += [f"{name}_{channel}" for channel in table.channels]
            case LoadCell404Table():
                cell = self._sensor(name, LoadCellSensor)
                twin = LoadCell404(
                    node,
                    cell,
                    start_ns,
                    capacity_n=cell.capacity_N,
                    flags_overload=table.flags_overload,
                    faults=faults,
                )
            case ArmControllerTable():
                twin = ArmController(node, self._sensor(name, PhaseSensor).changes, start_ns, faults=faults)
        if table.supervision == "guarding":
            twin.guard_for_heartbeat()
        self._bus(table.bus, CanBus).add(twin)
        self._produced.append(lambda: dict.fromkeys(channels, twin.produced))

    def _qsb(self, name: str, table: QsbTable) -> None:
        encoder = self._sensor(name, EncoderSensor)
        qsb = Qsb(
            encoder,
            self._clocks[name],
            self._start_ns,
            counts_per_revolution=encoder.counts_per_revolution,
            tick_ns=TICK_512_HZ if table.tick == "1/512 s" else TICK_1900_US,
            sync_input=table.sync_input,
            faults=self._faults(name),
        )
        self._talker(table.bus, qsb, [name], _position_length)
        if table.sync_input:
            self._pins.append(qsb.dig_io)

    def _nimu(self, name: str, table: NimuTable) -> None:
        nimu = Nimu(
            self._sensor(name, ImuSensor),
            self._clocks[name],
            self._start_ns,
            rate_hz=table.rate_Hz,
            line=self._line(table.bus),
            checksum=table.checksum,
            faults=self._faults(name),
        )
        magnetometer = [f"{name}_mag_{axis}" for axis in "xyz"] if table.magnetometer else []
        self._talker(table.bus, nimu, [name, *magnetometer], len)

    def _node_frame(self, name: str, table: NodeFrameTable) -> None:
        node = FrameNode(
            [self._channel(name, channel) for channel in table.channel],
            self._clocks[name],
            self._start_ns,
            node=table.node,
            rate_hz=table.rate_Hz,
            tick_hz=table.tick_Hz,
            line=self._line(table.bus),
            faults=self._faults(name),
        )
        self._talker(table.bus, node, [f"{name}_{channel.name}" for channel in table.channel], _data_frame_length)
        if table.sync_input:
            self._pins.append(node.sync_edge)

    def _talker(
        self, line: str, twin: Qsb | Nimu | FrameNode, channels: list[str], sample_length: Callable[[bytes], int]
    ) -> None:
        """Plug in a device that says its samples unasked."""
        bus = self._bus(line, SerialBus)
        bus.add(twin, lambda: twin.produced, sample_length)
        self._produced.append(lambda: dict.fromkeys(channels, bus.samples))

    def _asked(self, name: str, table: ModbusLoadCellTable | DscLoadCellTable) -> ModbusLoadCell | DscLoadCell:
        """A device that says a sample when it is asked."""
        clock, start_ns, faults = self._clocks[name], self._start_ns, self._faults(name)
        cell, line = self._sensor(name, LoadCellSensor), self._line(table.bus)
        if isinstance(table, ModbusLoadCellTable):
            return ModbusLoadCell(
                cell,
                clock,
                start_ns,
                station=table.station,
                line=line,
                capacity_n=cell.capacity_N,
                division=table.division_code,
                signs_in_status=table.signs_in_status,
                reply_ns=round(table.reply_ms * 1e6),
                faults=faults,
            )
        shortest_ms, longest_ms = table.delay_ms
        return DscLoadCell(
            cell,
            clock,
            start_ns,
            station=table.station,
            baud_code=DSC_BAUD_RATES.index(line.baud_rate),
            rate_code=table.rate_code,
            capacity_n=cell.capacity_N,
            delay_ns=(round(shortest_ms * 1e6), round(longest_ms * 1e6)),
            seed=self._seed,
            faults=faults,
        )

    def _channel(self, node: str, table: NodeChannelTable) -> NodeChannel:
        analog = self._sensors[f"{node}_{table.name}"]
        if isinstance(analog, ImuSensor):
            raise ScenarioError(f"device.{node}: channel {table.name} has one value; name a sensor that has one too")
        kind = ValueType[table.type.upper()]
        return NodeChannel(table.name, table.unit, kind, analog, table.mantissa, table.exponent, table.wraps)

    def _bus(self, name: str, kind: type[Kind]) -> Kind:
        bus = self._buses[name]
        if not isinstance(bus, kind):
            raise ScenarioError(f"bus.{name} was opened as {type(bus).__name__}; give one of kind {kind.__name__}")
        return bus

    def _sensor(self, name: str, kind: type[Kind]) -> Kind:
        sensor = self._sensors[name]
        if not isinstance(sensor, kind):
            raise ScenarioError(f"device.{name} measures with {type(sensor).__name__}; name another sensor")
        return sensor

    def _line(self, bus: str) -> LineFormat:
        table = self._scenario.bus[bus]
        assert isinstance(table, SerialBusTable)
        return LineFormat(table.baud_rate, table.parity, table.stop_bits)


def _position_length(line: bytes) -> int:
    """Of a QSB's line of the stream of register 0E: up to its exclamation mark."""
    return line.find(b"!") + 1 if line[:4].replace(b" ", b"").startswith(b"s0E") else 0


def _data_frame_length(frame: bytes) -> int:
    """Of a node's frame of kind 10h, which stands behind the first byte of its stuffing."""
    return len(frame) if frame[1:2] == b"\x10" else 0
