"""The fault vocabulary in the serial twins: output differs from a healthy twin's while a fault lasts."""

import struct

import numpy as np
import pytest
from cobs import cobs

from hil_sim.devices.serial_line.dsc_load_cell import DscLoadCellTwin
from hil_sim.devices.serial_line.modbus_load_cell import ModbusLoadCellTwin
from hil_sim.devices.serial_line.nimu import NimuTwin
from hil_sim.devices.serial_line.node_frame import FrameNode, NodeChannel, ValueType
from hil_sim.devices.serial_line.qsb import QsbTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import Fault, FaultPlan
from tests.hil_sim.devices.serial_bench import Line
from tests.hil_sim.devices.twin_bench import START_NS, Analog, RateClock, StairImu

MODBUS_READ = bytes.fromhex("01 03 00 07 00 02 75 CA")  # gross weight of station 1
DSC_READ = b"!001:SOUT?\r"


def ramp(t):
    """Ten units a second."""
    return 10.0 * t


def nimu(faults):
    return NimuTwin(StairImu(), RateClock(), START_NS, faults=faults)


def qsb(faults):
    return QsbTwin(Analog(ramp), RateClock(), START_NS, faults=faults)


def node(faults):
    channel = NodeChannel("a", "N", ValueType.I32, Analog(ramp), exponent=-3)
    return FrameNode([channel], RateClock(), START_NS, faults=faults)


def modbus(faults):
    return ModbusLoadCellTwin(Analog(ramp), RateClock(), START_NS, faults=faults)


def dsc(faults):
    return DscLoadCellTwin(Analog(ramp), RateClock(), START_NS, faults=faults)


TALKERS = {"nimu": nimu, "qsb": qsb, "node": node}
POLLED = {"modbus": (modbus, MODBUS_READ), "dsc": (dsc, DSC_READ)}


def broken(*fault):
    return FaultPlan([Fault(fault[0], "x", *fault[1:])], START_NS).of("x")


def stream(make, faults, ms=2_000):
    """(end of a character in ms of mission time, byte) of all that a twin says when it has been set to talk."""
    line = Line(make(faults))
    line.run(600)
    if make is qsb:
        line.wire.host = LineFormat(230_400)
        for command in (b"W15F\r", b"W0C1\r", b"S0E\r"):
            line.ask(command, 5)
    heard = []
    while line.now_ns < START_NS + ms * 1_000_000:
        data = line.run(5)
        heard += [((end - START_NS) * 1e-6, byte) for end, byte in zip(line.ends_ns, data, strict=True)]
    return heard


@pytest.mark.parametrize("name", TALKERS)
def test_garbage_is_as_many_characters_at_the_same_times(name):
    healthy = stream(TALKERS[name], broken("off", 90.0))
    garbled = stream(TALKERS[name], broken("garbage", 1.0, 1.5))
    assert [end for end, _ in garbled] == [end for end, _ in healthy]
    differ = [end for (end, byte), (_, was) in zip(garbled, healthy, strict=True) if byte != was]
    assert len(differ) > 0.9 * sum(1010 < end < 1500 for end, _ in healthy)
    assert min(differ) > 999
    assert max(differ) < 1520


@pytest.mark.parametrize("name", TALKERS)
def test_a_loose_connector_is_silent_in_every_first_half(name):
    healthy = stream(TALKERS[name], broken("off", 90.0))
    heard = stream(TALKERS[name], broken("intermittent", 1.0, 1.6, 0.2))
    away = [(1000, 1100), (1200, 1300), (1400, 1500)]
    inside = [any(start + 10 < end < stop for start, stop in away) for end, _ in heard]
    assert not any(inside)
    assert len(heard) < len(healthy)
    assert [b for b in heard if b[0] > 1620][-50:] == [b for b in healthy if b[0] > 1620][-50:]


def last_tick_s(name, heard):
    """What the twin's clock says in its last whole message, s since some start, and when that message ended."""
    data, ends = bytes(byte for _, byte in heard), [end for end, _ in heard]
    if name == "qsb":
        at = data.rindex(b"!\r\n")
        return int(data[at - 9 : at - 1], 16) / 512.0, ends[at]
    if name == "nimu":
        at = data.rindex(b"\xff\xff\xff\xff\x26", 0, -38)
        return struct.unpack(">H", data[at + 7 : at + 9])[0] * 2.1701e-6, ends[at + 37]
    ends_at = [k for k, byte in enumerate(data) if byte == 0]
    for first, last in zip(ends_at[-3:-1], ends_at[-2:], strict=True):
        payload = cobs.decode(data[first + 1 : last])
        if payload[0] == 0x10:
            return struct.unpack_from("<I", payload, 8)[0] * 1e-6, ends[last]
    raise AssertionError("two descriptors in a row")


@pytest.mark.parametrize("name", TALKERS)
@pytest.mark.parametrize(
    ("kind", "value", "behind_s"), [("clock_jump", -0.05, 0.05), ("clock_jump", 0.05, -0.05), ("slow", 0.1, 0.05)]
)
def test_a_clock_that_is_slow_or_jumps_is_behind_or_ahead(name, kind, value, behind_s):
    """Half a second of a tenth too slow is 50 ms; the nIMU's timer goes round in 142 ms."""
    healthy = last_tick_s(name, stream(TALKERS[name], broken("off", 90.0)))
    faulty = last_tick_s(name, stream(TALKERS[name], broken(kind, 1.0, 1.5, value)))
    behind = (healthy[0] - faulty[0]) - 1e-3 * (healthy[1] - faulty[1])
    if name == "nimu":
        turn_s = 65536 * 2.1701e-6
        behind = (behind + turn_s / 2) % turn_s - turn_s / 2
    assert behind == pytest.approx(behind_s, abs=3e-3)


@pytest.mark.parametrize("name", ["nimu", "node"])
def test_a_clock_put_forward_makes_no_samples_of_times_it_never_showed(name):
    healthy = stream(TALKERS[name], broken("off", 90.0))
    ahead = stream(TALKERS[name], broken("clock_jump", 1.0, 1.5, 0.05))
    behind = stream(TALKERS[name], broken("clock_jump", 1.0, 1.5, -0.05))
    longest_ms = [max(np.diff([end for end, _ in heard if end > 700.0])) for heard in (healthy, ahead, behind)]
    assert longest_ms[1] < 2.0 * longest_ms[0]  # it samples on, by its own clock
    assert longest_ms[2] == pytest.approx(50.0, abs=10.0)
    # a burst would be as many characters as usual, and ten more samples
    assert abs(len(ahead) - len(healthy)) < 80
    data = bytes(byte for end, byte in ahead if 990.0 < end < 1060.0)
    samples = data.split(b"\xff\xff\xff\xff\x26")[1:-1] if name == "nimu" else data.split(b"\0")[1:-1]
    assert len(set(samples)) == len(samples)


@pytest.mark.parametrize("name", POLLED)
def test_a_slow_load_cell_answers_late_and_a_loose_one_not_at_all(name):
    make, question = POLLED[name]
    line = Line(make(broken("slow", 1.0, 2.0, 0.2)))
    line.run(1100)
    assert line.ask(question, 100) == b""
    assert line.ask(b"", 130)
    assert line.run(1000) == b""
    assert line.ask(question, 60)
    line = Line(make(broken("intermittent", 1.0, 2.0, 0.4)))
    line.run(1010)
    assert line.ask(question, 100) == b""
    line.run(110)
    assert line.ask(question, 60)


def weight(name, answer):
    return int.from_bytes(answer[3:7], "big") * 1e-3 if name == "modbus" else float(answer)


@pytest.mark.parametrize("name", POLLED)
def test_a_load_cell_that_is_wrong_or_late_in_what_it_measures(name):
    make, question = POLLED[name]
    for kind, value, expected in (("wrong", 0.5, 15.0), ("delayed", 0.3, 7.0)):
        line = Line(make(broken(kind, 0.9, 2.0, value)))
        line.run(1_000)
        assert weight(name, line.ask(question)) == pytest.approx(expected, abs=0.2)
        line.run(1_500)
        assert weight(name, line.ask(question)) == pytest.approx(25.6, abs=0.2)


@pytest.mark.parametrize("name", POLLED)
def test_the_garbage_of_a_load_cell_is_as_long_as_its_answer(name):
    make, question = POLLED[name]
    line = Line(make(broken("garbage", 1.0, 2.0)))
    line.run(900)
    good = line.ask(question)
    line.run(100)
    bad = line.ask(question)
    assert len(bad) == len(good)
    assert np.count_nonzero(np.frombuffer(bad, "u1") != np.frombuffer(good, "u1")) > len(good) // 2
