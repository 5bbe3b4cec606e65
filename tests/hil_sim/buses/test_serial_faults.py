"""What can break on a serial line: characters, the connector, the adapter's buffers."""

import hypothesis.strategies as st
import pytest
import serial
from hypothesis import given

from hil_sim.devices.serial_line.nimu import NimuTwin
from hil_sim.faults import Fault, FaultError
from tests.hil_sim.buses.serial_rig import FAST, Rig
from tests.hil_sim.devices.twin_bench import START_NS, RateClock, StairImu


@pytest.mark.parametrize("kind", ["byte_loss", "byte_garble"])
def test_characters_break_with_their_probability_both_ways(kind):
    rig = Rig(Fault(kind, "line", 0.1, 1.1, value=0.1))
    port = rig.adapter.open(FAST)
    received = b""
    for _ in range(100):
        port.write(bytes(100))
        rig.run(10)
        received += port.read(999)
    rig.run(10)
    received += port.read(999)
    hit = rig.bus.lost if kind == "byte_loss" else rig.bus.garbled
    if kind == "byte_loss":
        assert len(received) == 10_000 - hit
        assert len(rig.device.heard) == pytest.approx(10_000 * 0.91, abs=150)
    else:
        assert len(received) == 10_000
        assert hit == sum(byte != 0 for byte in rig.device.heard) + sum(
            after != before for after, before in zip(received, rig.device.heard, strict=True)
        )
        assert all(byte.bit_count() <= 2 for byte in received)
    assert hit == pytest.approx(1800, abs=150)
    assert received[:900] == bytes(900)  # before 0.1 s


def test_all_of_them():
    rig = Rig(Fault("byte_loss", "line", 0.0, value=1.0))
    port = rig.adapter.open(FAST)
    port.write(b"hello")
    rig.run(10)
    assert (bytes(rig.device.heard), port.read(99), rig.bus.lost) == (b"", b"", 5)


def test_unplugged_the_port_dies_and_must_be_opened_again():
    rig = Rig(Fault("unplug", "line", 0.1, 0.2))
    port = rig.adapter.open(FAST)
    rig.run(99.85)
    port.write(b"hello")
    rig.run(0.1)
    rig.run(10)
    assert rig.bus.to_host == 0
    assert bytes(rig.device.heard) == b"h"
    with pytest.raises(serial.SerialException, match="returned no data"):
        port.read(1)
    with pytest.raises(serial.SerialException, match="write failed"):
        port.write(b"a")
    with pytest.raises(OSError, match="Input/output error"):
        _ = port.in_waiting
    port.close()
    with pytest.raises(serial.SerialException, match="could not open port") as caught:
        rig.adapter.open(FAST)
    assert isinstance(caught.value, OSError)
    assert caught.value.errno == 2
    rig.run(100)
    again = rig.adapter.open(FAST)
    again.write(b"again")
    rig.run(2)
    assert again.read(99) == b"again"


def test_unplugged_twice_in_a_row_is_once():
    rig = Rig(Fault("unplug", "line", 0.1, 0.2), Fault("unplug", "line", 0.2, 0.3))
    rig.run(250)
    with pytest.raises(serial.SerialException, match="could not open port"):
        rig.adapter.open(FAST)
    rig.run(50)
    assert rig.adapter.open(FAST).baudrate == 115_200


def test_the_twin_lives_on_while_it_is_unplugged():
    nimu = NimuTwin(StairImu(), RateClock(), START_NS)
    rig = Rig(Fault("unplug", "line", 0.5, 1.0), device=nimu)
    rig.run(1500)
    assert nimu.produced == pytest.approx(1.25 * 150, abs=1)


def test_a_loose_connector_loses_the_first_half_of_every_period():
    rig = Rig(Fault("intermittent", "line", 0.1, 0.2, value=0.02))
    port = rig.adapter.open(FAST)
    rig.run(95)
    for _ in range(110):  # a character a millisecond, from 95 ms on
        port.write(b"a")
        rig.run(1)
    assert len(rig.device.heard) == pytest.approx(110 - 50, abs=5)


@pytest.mark.parametrize("kind", ["nack", "frame_drop", "off"])
def test_a_fault_that_a_line_cannot_have_is_refused(kind):
    with pytest.raises(FaultError, match=f"line cannot have the fault {kind}; it can have: byte_loss"):
        Rig(Fault(kind, "line", 0.0))


@given(st.lists(st.tuples(st.binary(max_size=30), st.floats(0.0, 3.0)), max_size=8), st.floats(0.01, 1.0))
def test_what_arrives_is_what_was_sent_less_what_was_lost(pieces, probability):
    rig = Rig(Fault("byte_loss", "line", 0.0, value=probability))
    port = rig.adapter.open(FAST)
    received = b""
    for data, pause_ms in pieces:
        port.write(data)
        rig.run(pause_ms)
        received += port.read(999)
    rig.run(50)
    received += port.read(999)
    sent = iter(b"".join(data for data, _ in pieces))
    assert all(byte in sent for byte in received)  # in order: ``in`` consumes
    assert len(received) + rig.bus.lost == sum(len(data) for data, _ in pieces)
