"""A sensor node that speaks the node frame, version 1 (``docs/node_frame.md``, from which this is typed).

The node samples all channels at once at its own rate, the first time one period after its start, sends a data frame for
each sample and a descriptor at its start and once a second. Its clock is a counter from power-up; from its start on the
sync line latches it by input capture. A frame that finds the UART's queue full is not sent, and its number is left out.
"""
# ruff: noqa: N815 - field names are the file's keys, and a key ends in its SI symbol

import binascii
import math
import struct
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Annotated, Any, Final, Literal, NamedTuple

from pydantic import Field, PositiveFloat, PositiveInt

from hil_sim.devices.emulator import FORCES, Bench, Emulator, Equivalent, Signal, Twin
from hil_sim.devices.serial_line.serial_twin import SerialTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import CLOCK_KINDS, INPUT_KINDS, NO_FAULTS, DeviceFaults, FaultKind, FaultyClock, FaultyScalar
from hil_sim.scenario.sensor_tables import MeasuredQuantity, Table
from hil_sim.scenario.sheets import Sheets
from hil_sim.scenario.tables import ScenarioError
from hil_sim.sensing.analog import ChipClock, ScalarAnalog
from hil_sim.sensing.sensors import ImuSensor

_DATA, _DESCRIPTOR = 0x10, 0x11
_SATURATED: Final = 0x02  # status
_FULL_BLOCK: Final = 254
_MOST_CHANNELS: Final = 65
_WIDTH_32: Final = 1 << 32
_SECOND_NS: Final = 1_000_000_000
_MEASURABLE: Final[tuple[MeasuredQuantity, ...]] = ("joint_angle", *FORCES, "servo_torque", "phase")
_CONVERSION_NS: Final = 50_000  # from a sample to the first bit of its frame
_LOOK_AHEAD_NS: Final = 1_000_000_000
_QUEUE_BYTES: Final = 1024  # room in its UART's queue


class ValueType(IntEnum):
    """Types of values, by their code in the descriptor."""

    U8 = 0
    I8 = 1
    U16 = 2
    I16 = 3
    U32 = 4
    I32 = 5
    I64 = 6


_BITS: Final = (8, 8, 16, 16, 32, 32, 64)
_SIGNED: Final = (ValueType.I8, ValueType.I16, ValueType.I32, ValueType.I64)


class NodeChannel(NamedTuple):
    """One channel.

    Attributes:
        name: Up to 16 ASCII characters.
        unit: Up to 8 ASCII characters.
        value_type: How its counts are packed.
        analog: Its input, in ``unit``.
        mantissa: One count is ``mantissa`` x 10^``exponent`` units.
        exponent: See ``mantissa``.
        wraps: A counter that wraps at the width of its type; one that does not is clipped there.
    """

    name: str
    unit: str
    value_type: ValueType
    analog: ScalarAnalog
    mantissa: int = 1
    exponent: int = 0
    wraps: bool = False


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE."""
    return binascii.crc_hqx(data, 0xFFFF)


def stuff(data: bytes) -> bytes:
    """Consistent overhead byte stuffing (Cheshire and Baker, 1999), without the delimiter."""
    blocks = data.split(b"\0")
    if len(data) < _FULL_BLOCK:
        return b"".join([bytes([len(block) + 1]) + block for block in blocks])
    out = bytearray()
    for number, block in enumerate(blocks, 1):
        full, rest = divmod(len(block), _FULL_BLOCK)
        for k in range(full):
            out += b"\xff" + block[k * _FULL_BLOCK : (k + 1) * _FULL_BLOCK]
        if rest or not full or number < len(blocks):
            out += bytes([rest + 1]) + block[full * _FULL_BLOCK :]
    return bytes(out)


def frame(payload: bytes) -> bytes:
    """A payload as it goes over the line."""
    return stuff(payload + crc16(payload).to_bytes(2, "big")) + b"\0"


class FrameNode(SerialTwin):
    """One node.

    Args:
        channels: What it measures, 1 to 65 channels.
        clock: Its oscillator.
        start_ns: ``CLOCK_MONOTONIC`` ns of power-up, mission time 0.
        node: Node number.
        rate_hz: Samples a second on its own clock.
        tick_hz: Nominal rate of its counter.
        line: Speed and format.
        boot_ns: From power-up to the descriptor.
        counts_boots: Whether the descriptor's ``boot`` counts starts from 1; 0 otherwise.
        faults: What breaks; those of its inputs hit all channels.

    Raises:
        FaultError: a fault that the node cannot have.
        ValueError: no channels or too many, or a name, unit or scale that has no room in a descriptor.
    """

    _outside = frozenset({"spurious"})

    def __init__(
        self,
        channels: Sequence[NodeChannel],
        clock: ChipClock,
        start_ns: int,
        *,
        node: int = 1,
        rate_hz: float = 200.0,
        tick_hz: int = 1_000_000,
        line: LineFormat = LineFormat(115_200),  # noqa: B008  (a constant)
        boot_ns: int = 100_000_000,
        counts_boots: bool = True,
        faults: DeviceFaults = NO_FAULTS,
    ) -> None:
        kinds = (FaultKind.SATURATED, FaultKind.PULSE_DROP, FaultKind.PULSE_SPURIOUS, *INPUT_KINDS, *CLOCK_KINDS)
        super().__init__(line, start_ns, faults, kinds)
        self.produced = 0  # samples, sent or not
        self.overrun = 0  # samples that were not sent
        self.pulses = 0  # counted since the node's start
        self._channels = tuple(channels)
        self._inputs = [FaultyScalar(channel.analog, faults, start_ns) for channel in channels]
        self._description = _describe(tick_hz, self._channels)
        self._schema = crc16(self._description)
        self._clock: ChipClock = FaultyClock(clock, faults)
        self._node = node
        self._period_ns = 1e9 / rate_hz
        self._tick_hz = tick_hz
        self._boot_ns = boot_ns
        self._counts_boots = counts_boots
        self._boots = 0
        self._edges: list[int] = []
        self._clear_state(0)
        if any(w.kind is FaultKind.PULSE_SPURIOUS for w in faults.windows):
            self._spurious(start_ns)

    def sync_edge(self, edge_ns: int, high_ns: int) -> None:
        """The sync line goes high at ``edge_ns``.

        Raises:
            ValueError: the node is past that instant; advance the source of the pulses first.
        """
        del high_ns
        if edge_ns < self._until_ns:
            raise ValueError(
                f"The sync line rose at {self._seconds(edge_ns):.6f} s and the node is at "
                f"{self._seconds(self._until_ns):.6f} s; advance the pulse source before the node."
            )
        if self._faults.active(FaultKind.PULSE_DROP, edge_ns) is None:
            self._edges.append(edge_ns)
            self._edges.sort()

    # Start-up and clock

    def _power_up(self, now_ns: int) -> None:
        self._boots += 1
        self._clear_state(self._clock.chip_ns(now_ns))
        self._at("boot", now_ns + self._boot_ns, self._boot)

    def _clear_state(self, origin_chip_ns: int) -> None:
        self._origin_chip_ns = self._started_chip_ns = origin_chip_ns
        self._started_ns = 0
        self._sequence = 0
        self._taken = 0
        self.pulses = 0
        self._pulse_tick = 0
        self._line_free_ns = 0

    def _boot(self, now_ns: int) -> None:
        self._started_ns = now_ns
        self._started_chip_ns = self._clock.chip_ns(now_ns)
        self._send_descriptor(now_ns)
        self._arm_sample(now_ns)

    def _tick(self, now_ns: int) -> int:
        """The counter, whole."""
        return (self._clock.chip_ns(now_ns) - self._origin_chip_ns) * self._tick_hz // _SECOND_NS

    def _spurious(self, now_ns: int) -> None:
        self._edges = sorted(self._edges + self._faults.spurious_edges(now_ns, now_ns + _LOOK_AHEAD_NS))
        self._at("spurious", now_ns + _LOOK_AHEAD_NS, self._spurious)

    def _see_pulses(self, now_ns: int) -> None:
        while self._edges and self._edges[0] <= now_ns:
            edge_ns = self._edges.pop(0)
            if edge_ns >= self._started_ns:
                self.pulses += 1
                self._pulse_tick = self._tick(edge_ns)

    # Frames

    def _arm_sample(self, now_ns: int) -> None:
        due_chip_ns = self._started_chip_ns + round((self._taken + 1) * self._period_ns)
        self._at("sample", max(self._clock.time_ns(due_chip_ns), now_ns), self._sample)

    def _sample(self, now_ns: int) -> None:
        self._see_pulses(now_ns)
        status, values, time_s = 0, b"", self._seconds(now_ns)
        for channel, analog in zip(self._channels, self._inputs, strict=True):
            packed, clipped = _pack(channel, analog.value(time_s))
            values += packed
            status |= _SATURATED if clipped else 0
        head = struct.pack(
            "<BBHIIIIB",
            _DATA,
            self._node,
            self._schema,
            self._sequence % _WIDTH_32,
            self._tick(now_ns) % _WIDTH_32,
            self.pulses % _WIDTH_32,
            self._pulse_tick % _WIDTH_32,
            status,
        )
        self.produced += 1
        self._sequence += 1
        if not self._queue(frame(head + values), now_ns + _CONVERSION_NS):
            self.overrun += 1
        own_ns = self._clock.chip_ns(now_ns) - self._started_chip_ns
        self._taken = max(self._taken + 1, int(own_ns // self._period_ns))  # none of times that it never showed
        self._arm_sample(now_ns)

    def _send_descriptor(self, now_ns: int) -> None:
        head = struct.pack(
            "<BBHIQI",
            _DESCRIPTOR,
            self._node,
            self._schema,
            self._sequence % _WIDTH_32,
            self._tick(now_ns),
            self._boots if self._counts_boots else 0,
        )
        self._queue(frame(head + self._description), now_ns)
        second_ns = self._clock.chip_ns(now_ns) + _SECOND_NS
        self._at("descriptor", self._clock.time_ns(second_ns), self._send_descriptor)

    def _queue(self, data: bytes, now_ns: int) -> bool:
        waiting = max(0, self._line_free_ns - now_ns) / self.line.character_ns
        if waiting + len(data) > _QUEUE_BYTES:
            return False
        self._line_free_ns = self._send(data, now_ns)
        return True


def _describe(tick_hz: int, channels: Sequence[NodeChannel]) -> bytes:
    """A descriptor from its offset 20 on."""
    if not 1 <= len(channels) <= _MOST_CHANNELS:
        raise ValueError(f"A node has 1 to {_MOST_CHANNELS} channels, not {len(channels)}.")
    description = struct.pack("<IB", tick_hz, len(channels))
    for channel in channels:
        name, unit = channel.name.encode("ascii"), channel.unit.encode("ascii")
        if len(name) > 16 or len(unit) > 8:
            raise ValueError(f"Channel {channel.name!r} in {channel.unit!r}: 16 characters for a name, 8 for a unit.")
        try:
            description += struct.pack(
                "<BBib8s16s", channel.value_type, channel.wraps, channel.mantissa, channel.exponent, unit, name
            )
        except struct.error as error:
            raise ValueError(f"Channel {channel.name!r}: its scale has no room in a descriptor: {error}.") from error
    return description


def _pack(channel: NodeChannel, value: float) -> tuple[bytes, bool]:
    """Counts of one channel, and whether they had to be clipped."""
    bits = _BITS[channel.value_type]
    signed = channel.value_type in _SIGNED
    low = -(1 << bits - 1) if signed else 0
    high = low + (1 << bits) - 1
    scaled = value / channel.mantissa * 10.0**-channel.exponent
    limited = min(max(scaled, -(2.0**62)), 2.0**62)
    counts = round(limited)
    if channel.wraps:
        return ((counts - low) % (1 << bits) + low).to_bytes(bits // 8, "little", signed=signed), False
    clipped = min(max(counts, low), high)
    return clipped.to_bytes(bits // 8, "little", signed=signed), clipped != counts or limited != scaled


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


class NodeFrameTable(Emulator):
    """A microcontroller of one's own that speaks the node frame."""

    kind: Literal["node_frame"]
    bus: str
    node: Annotated[int, Field(ge=0, le=255)] = 1
    rate_Hz: PositiveFloat = 200.0
    tick_Hz: PositiveInt = 1_000_000
    sync_input: bool = True
    channel: Annotated[tuple[NodeChannelTable, ...], Field(min_length=1, max_length=65)]

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``: joints, forces and the phase; the joints count 1e-6 rad, the forces 0.1 mN."""
        channels: list[dict[str, Any]] = []
        sensors: dict[str, dict[str, Any]] = {}
        for own in said["channel"]:
            signal = f"{name}_{own['name']}"
            match own["role"]:
                case "joint":
                    shape = {"at": own["joint"], "unit": "rad", "type": "i32", "exponent": -6}
                    counts = round(2e6 * math.pi)
                    sensors[signal] = sheets.encoder(signal, {"counts_per_revolution": counts, **own})
                case "force":
                    shape = {"at": own["frame"], "unit": "N", "type": "i32", "exponent": -4}
                    sensors[signal] = sheets.load_cell(own)
                case "record" if sheets.phase_channel == signal:
                    shape = {"unit": "1", "type": "u8"}
                    sensors[signal] = {"quantity": "phase"}
                case role:
                    raise ScenarioError(
                        f"device.{name}: channel {own['name']!r} ({role}) cannot be rehearsed; joints, forces and the "
                        "phase can"
                    )
            channels.append({"name": own["name"], "measures": signal} | shape)
        table = {
            "node": said.get("node", 1),
            "rate_Hz": said["rate_hz"],
            "tick_Hz": round(said["tick_hz"]),
            "sync_input": sheets.pulse,
            "channel": channels,
        }
        return Equivalent(table, sensors, {name: "converter"})

    def signals(self, name: str) -> dict[str, Signal]:
        """See ``Emulator``."""
        return {f"{name}_{channel.name}": Signal(channel.measures, _MEASURABLE, channel.at) for channel in self.channel}

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        node = FrameNode(
            [_channel(bench, channel) for channel in self.channel],
            bench.clock,
            bench.start_ns,
            node=self.node,
            rate_hz=self.rate_Hz,
            tick_hz=self.tick_Hz,
            line=bench.line,
            faults=bench.faults,
        )
        channels = tuple(f"{bench.name}_{channel.name}" for channel in self.channel)
        pin = node.sync_edge if self.sync_input else None
        return Twin(node, lambda: node.produced, channels, _data_frame_length, pin)


def _channel(bench: Bench, table: NodeChannelTable) -> NodeChannel:
    analog = bench.sensors[f"{bench.name}_{table.name}"]
    if isinstance(analog, ImuSensor):
        raise ValueError(f"channel {table.name} is a single value; name a sensor that gives a single value.")
    kind = ValueType[table.type.upper()]
    return NodeChannel(table.name, table.unit, kind, analog, table.mantissa, table.exponent, table.wraps)


def _data_frame_length(frame: bytes) -> int:
    """Of a node's frame of kind 10h, which stands behind the first byte of its stuffing."""
    return len(frame) if frame[1:2] == b"\x10" else 0
