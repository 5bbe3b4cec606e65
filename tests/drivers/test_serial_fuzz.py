"""Every serial device under any bytes, frames of any content, stalls and faults: it never raises, and its sequence
numbers and gaps leave nothing out."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.dsc_load_cell import DscLoadCell, DscLoadCellConfig
from drivers.modbus_load_cell import ModbusLoadCell, ModbusLoadCellConfig
from drivers.nimu import Nimu, NimuConfig
from drivers.node_frame import NodeFrame, NodeFrameConfig
from drivers.pose_tracker import PoseTracker
from drivers.qsb import Qsb, QsbConfig
from tests.conftest import VirtualClock
from tests.drivers.batches import of
from tests.drivers.modbus_model import TransmitterModel
from tests.drivers.modbus_model import framed as modbus_framed
from tests.drivers.nimu_model import NimuModel
from tests.drivers.node_model import NodeModel, framed
from tests.drivers.pose_model import message
from tests.drivers.qsb_model import QsbModel
from tests.drivers.serial_script import ScriptedSerial, SerialFlight

CHANNELS = [("a", "N", 5, 0, 1, -4), ("b", "1", 4, 1, 1, 0)]
U8, U16, U32 = st.integers(0, 255), st.integers(0, 65535), st.integers(0, 2**32 - 1)
NEAR = st.integers(0, 40)


def node_data(sequence, tick, pulse, pulse_tick, status):
    schema = NodeModel(CHANNELS).schema
    head = struct.pack("<BBHIIIIB", 0x10, 1, schema, sequence, tick, pulse, pulse_tick, status)
    return framed(head + struct.pack("<iI", sequence % 2**31, tick))


def node_descriptor(sequence, tick, boot):
    model = NodeModel(CHANNELS, boot=boot)
    model.sequence = sequence
    return model.descriptor(tick)


def nimu_packet(timer, words):
    return NimuModel(timer=timer).packet(words)


def qsb_line(kind, register, data, stamp):
    return f"{kind} {register:02X} {data:08X} {stamp:08X} !\r\n".encode()


REGISTERS = st.sampled_from([0x01, 0x05, 0x0E, 0x0E, 0x0E, 0x14, 0x15, 0x16, 0x03])
FRAMES = {
    "node": st.builds(node_data, NEAR | U32, NEAR | U32, NEAR | U32, U32, U8)
    | st.builds(node_descriptor, NEAR | U32, NEAR | st.integers(0, 2**62 - 1), st.integers(0, 1))
    | st.builds(framed, st.binary(min_size=2, max_size=40)),
    "nimu": st.builds(nimu_packet, U16, st.lists(st.integers(-32768, 32767), min_size=12, max_size=12)),
    "qsb": st.builds(qsb_line, st.sampled_from("rwsex"), REGISTERS, NEAR | U32, NEAR | U32)
    | st.sampled_from([b"QSB-D  0E!\r\n", b"e0E00000005!", b"s 0E 00000001 !\r\n"]),
    "pose": st.builds(
        message,
        st.binary(max_size=130),
        st.sampled_from([138, 138, 138, 0, 2, 111, 30]),
        U8,
        st.sampled_from([1, 1, 2]),
        st.sampled_from([0, 0, 0, 1, 2]),
    ),
    "modbus": st.builds(modbus_framed, st.binary(min_size=2, max_size=21)),
    "dsc": st.sampled_from([b"?\r", b"\r", b"+00032.100\r", b"-1\r", b"+99999999.9\r"]),
}


def devices(clock):
    """Each device and what answers it."""
    qsb, cell = QsbModel(clock), TransmitterModel()
    return {
        "node": (lambda *a: NodeFrame("x", *a, NodeFrameConfig(("a", "b"))), lambda _: b""),
        "nimu": (lambda *a: Nimu("x", *a, NimuConfig()), lambda _: b""),
        "pose": (lambda *a: PoseTracker("x", *a), lambda _: b""),
        "qsb": (lambda *a: Qsb("x", *a, QsbConfig()), qsb.receive),
        "modbus": (lambda *a: ModbusLoadCell("x", *a, ModbusLoadCellConfig()), cell.receive),
        "dsc": (lambda *a: DscLoadCell("x", *a, DscLoadCellConfig()), lambda _: b"+00032.100\r"),
    }


def nothing_left_out(batches, channel):
    """Rows and gaps of a channel follow on one another, without expanding gaps that may be billions long."""
    rows = of(batches, channel)
    spans = [(int(number), int(number)) for number in rows["sequence"]]
    for gap in of(batches, "gap"):
        if gap["channel"] == channel.encode():
            assert gap["first_missing"] <= gap["last_missing"]
            spans.append((int(gap["first_missing"]), int(gap["last_missing"])))
    at = 0
    for first, last in sorted(spans):
        assert first == at, channel
        at = last + 1
    assert np.all(np.diff(rows["sequence"].astype(np.int64)) > 0)
    if len(rows):
        assert rows["tick"].max() < 2**63  # never below 0


@pytest.mark.parametrize("kind", FRAMES)
@settings(max_examples=150)
@given(data=st.data())
def test_nothing_that_comes_in_can_raise_or_be_lost_in_silence(kind, data):
    clock = VirtualClock()
    make, answer = devices(clock)[kind]
    port = ScriptedSerial(answer)
    flight = SerialFlight(clock, port, make(port.open, clock))
    flight.start()
    times = st.sampled_from([0, 1_000_000, 10_000_000, 10_000_000, 600_000_000, 10**10])
    moves = st.tuples(times, FRAMES[kind] | st.binary(max_size=50), st.integers(0, 40))
    for after_ns, said, fault in data.draw(st.lists(moves, max_size=25)):
        port.fail_at = port.calls + fault if fault in {1, 2, 3} else -1
        port.broken = fault == 4
        flight.pump(after_ns, said)
    port.fail_at, port.broken = -1, False
    flight.pump()
    flight.stop()
    for channel in flight.device.channels:
        if not channel.endswith("_mark"):
            nothing_left_out(flight.batches, channel)
