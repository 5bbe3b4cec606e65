"""Serial buses: T0 ports on a virtual clock, T1 pseudo-terminals for pyserial, and what can break on the line."""

import os
import time

import hypothesis.strategies as st
import pytest
import serial
from hypothesis import given

from hil_sim.buses.serial_bus import SerialBus
from hil_sim.buses.serial_port import PtySerial, VirtualSerial, install_serial
from hil_sim.devices.serial_line.dsc_load_cell import DscLoadCellTwin
from hil_sim.devices.serial_line.nimu import NimuTwin
from hil_sim.devices.serial_line.qsb import QsbTwin
from hil_sim.devices.serial_line.serial_twin import SerialTwin
from hil_sim.devices.serial_line.serial_wire import LineFormat
from hil_sim.faults import NO_FAULTS, Fault, FaultError, FaultPlan
from tests.hil_sim.devices.serial_bench import RealTime
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock, StairImu

FAST = LineFormat(115_200)


class Echo(SerialTwin):
    """Sends back what it hears."""

    def __init__(self, start_ns=START_NS, line=FAST):
        super().__init__(line, start_ns, NO_FAULTS)
        self.heard = bytearray()

    def _on_byte(self, byte, now_ns):
        self.heard.append(byte)
        self._send(bytes([byte]), now_ns)


class Rig:
    """An echo behind a T0 adapter."""

    def __init__(self, *faults, seed=0, device=None, latency_ns=0):
        self.adapter = VirtualSerial("/dev/hil-echo")
        self.bus = SerialBus(self.adapter, seed, latency_ns=latency_ns)
        self.device = device or Echo()
        self.bus.add(self.device)
        self.bus.inject(FaultPlan(faults, START_NS).of("line"))
        self.now_ns = START_NS
        self.bus.advance(START_NS)

    def run(self, ms):
        self.now_ns += round(ms * MS)
        self.bus.advance(self.now_ns)


# T0


def test_a_port_reads_what_has_arrived_and_no_more():
    rig = Rig()
    port = rig.adapter.open(FAST)
    assert port.write(b"hello") == 5
    assert (port.in_waiting, port.read(10)) == (0, b"")
    rig.run(0.27)  # three characters of 87 us: two of them are back
    assert port.in_waiting == 2
    assert port.read() == b"h"
    assert port.read(10) == b"e"
    rig.run(1)
    assert port.read(100) == b"llo"


def test_what_is_written_starts_at_the_last_advance():
    rig = Rig()
    port = rig.adapter.open(FAST)
    rig.run(10)
    port.write(b"a")
    rig.run(0.17)
    assert port.in_waiting == 0
    rig.run(0.01)
    assert port.in_waiting == 1


def test_one_user_at_a_time_and_a_closed_port_says_so():
    rig = Rig()
    with rig.adapter.open(FAST) as port, pytest.raises(serial.SerialException, match="exclusively lock"):
        rig.adapter.open(FAST)
    for use in (lambda: port.read(1), lambda: port.write(b"a"), lambda: port.in_waiting, port.reset_input_buffer):
        with pytest.raises(serial.PortNotOpenError):
            use()
    assert rig.adapter.open(FAST).is_open


def test_what_comes_while_nobody_has_it_open_is_lost():
    rig = Rig(device=NimuTwin(StairImu(), RateClock(), START_NS))
    rig.run(500)
    port = rig.adapter.open(FAST)
    assert port.in_waiting == 0
    rig.run(100)
    assert port.in_waiting == pytest.approx(15 * 38, abs=38)


def test_buffers_can_be_emptied_and_overflow_is_counted():
    rig = Rig(device=NimuTwin(StairImu(), RateClock(), START_NS))
    port = rig.adapter.open(FAST)
    rig.run(15_000)
    assert port.in_waiting == 65_536
    assert rig.adapter.overrun == rig.bus.to_host - 65_536 > 10_000
    port.reset_input_buffer()
    assert port.in_waiting == 0
    port.write(b"never")
    port.reset_output_buffer()
    port.flush()
    rig.run(10)
    assert rig.bus.to_device == 0


def test_the_speed_of_the_port_is_honoured():
    rig = Rig()
    port = rig.adapter.open(LineFormat(9600))
    port.write(b"hello")
    rig.run(50)
    assert bytes(rig.device.heard) != b"hello"
    port.reset_input_buffer()
    port.baudrate = 115_200
    rig.device.heard.clear()
    port.write(b"hello")
    rig.run(50)
    assert (bytes(rig.device.heard), port.read(99)) == (b"hello", b"hello")


def test_dtr_reaches_the_adapter_that_wants_it():
    qsb = QsbTwin(Analog(lambda t: 0.0), RateClock(), START_NS)
    bus = SerialBus(adapter := VirtualSerial("/dev/hil-qsb", lambda level: qsb.drive_dtr(level, bus_now[0])))
    bus.add(qsb)
    bus_now = [START_NS]
    port = adapter.open(LineFormat(230_400))

    def run(ms):
        bus_now[0] += round(ms * MS)
        bus.advance(bus_now[0])
        return port.read(1000)

    assert run(150) == b"QSB-D  0E!\r\n"
    assert port.dtr
    port.dtr = False
    port.dtr = True
    assert run(150) == b"QSB-D  0E!\r\n"


def test_serial_opens_the_path_while_it_is_installed(tmp_path):
    rig = Rig()
    installed = install_serial(rig.adapter)
    try:
        port = serial.Serial("/dev/hil-echo", 115_200, parity="N", stopbits=1, timeout=0.0, exclusive=True)
        port.set_low_latency_mode(True)
        port.write(b"x")
        rig.run(1)
        assert port.read(9) == b"x"
        with pytest.raises(serial.SerialException, match="could not open port"):
            serial.Serial(str(tmp_path / "nothing"), 9600)
        link = PtySerial()
        with serial.Serial(link.path, 9600) as real:
            assert real.is_open
            assert isinstance(real, serial.SerialBase)
        link.close()
    finally:
        installed.uninstall()
    with pytest.raises(serial.SerialException, match="No such file"):
        serial.Serial("/dev/hil-echo", 115_200)


def test_a_run_is_the_same_to_the_byte_each_time():
    def run():
        fault = Fault("byte_garble", "line", 0.0, value=0.05)
        rig = Rig(fault, Fault("byte_loss", "line", 0.0, value=0.05), seed=7)
        port = rig.adapter.open(FAST)
        received = b""
        for _ in range(50):
            port.write(b"the quick brown fox")
            rig.run(2)
            received += port.read(999)
        return received

    assert run() == run()
    assert len(run()) > 700


def test_a_bus_without_a_device_does_nothing():
    bus = SerialBus(VirtualSerial("/dev/hil-none"))
    bus.advance(START_NS)
    assert bus.due_ns > START_NS + 1_000_000 * MS
    assert (bus.to_host, bus.to_device) == (0, 0)


def test_stations_on_one_line_answer_for_themselves_and_obey_broadcasts_together():
    force = [5.0]
    cells = [DscLoadCellTwin(Analog(lambda t, k=k: k * force[0]), RateClock(), START_NS, station=k) for k in (1, 2, 3)]
    bus = SerialBus(adapter := VirtualSerial("/dev/hil-line"))
    for cell in cells:
        bus.add(cell)
    port = adapter.open(FAST)
    now_ns = START_NS

    def ask(command, ms=20):
        nonlocal now_ns
        port.write(command)
        now_ns += ms * MS
        bus.advance(now_ns)
        return port.read(99)

    bus.advance(now_ns)
    assert ask(b"", 300) == b""
    assert ask(b"!000:SNAP\r") == b""
    force[0] = 1.0
    bus.advance(now_ns + MS)
    assert [ask(b"!%03d:SYSN?\r" % k) for k in (1, 2, 3)] == [b"+00005.000\r", b"+00010.000\r", b"+00015.000\r"]
    assert ask(b"!002:SOUT?\r") == b"+00002.000\r"
    assert ask(b"!004:SOUT?\r") == b""


def test_a_usb_adapter_hands_over_when_its_timer_expires():
    rig = Rig(latency_ns=MS)
    port = rig.adapter.open(FAST)
    port.write(b"hello")
    rig.run(0.8)
    assert port.in_waiting == 0
    assert rig.bus.due_ns == START_NS + MS
    rig.run(0.2)
    assert port.read(99) == b"hello"
    assert rig.bus.due_ns > START_NS + 1000 * MS


def test_a_usb_adapter_hands_over_full_packets_at_once():
    rig = Rig(latency_ns=16 * MS)
    rig.run(16 - START_NS / MS % 16)  # the timer has just expired
    port = rig.adapter.open(FAST)
    port.write(bytes(100))
    rig.run(61 * 10 / 115.2 + 0.05)
    assert port.in_waiting == 0
    rig.run(2 * 10 / 115.2)
    assert port.in_waiting == 62
    rig.run(9)
    assert port.in_waiting == 62
    rig.run(2)
    assert port.in_waiting == 100


def test_what_a_usb_adapter_holds_goes_with_it():
    rig = Rig(Fault("unplug", "line", 0.0009, 0.01), latency_ns=MS)
    rig.adapter.open(FAST).write(b"hello")
    rig.run(20)
    assert rig.bus.to_host == 0


def test_the_bus_says_when_something_happens_next():
    rig = Rig(Fault("unplug", "line", 0.05, 0.07))
    assert rig.bus.due_ns == START_NS + 50 * MS
    port = rig.adapter.open(FAST)
    port.write(b"a")
    rig.run(0.01)
    assert rig.bus.due_ns == START_NS + 86_806
    rig.run(55)
    assert rig.bus.due_ns == START_NS + 70 * MS


# What breaks


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


# T1


@pytest.fixture
def pty(tmp_path):
    """A link and a bus with an echo in real time."""
    link = PtySerial(tmp_path / "by-id-echo")
    bus = SerialBus(link)
    bus.add(Echo(time.monotonic_ns()))
    with RealTime(bus):
        yield link, bus
    link.close()


@pytest.mark.realtime
def test_pyserial_on_a_pseudo_terminal(pty):
    link, _ = pty
    with serial.Serial(link.path, 115_200, timeout=1.0) as port:
        port.write(bytes(range(256)))
        assert port.read(256) == bytes(range(256))


@pytest.mark.realtime
@pytest.mark.parametrize("baud_rate", [9600, 57_600, 128_000, 230_400])
def test_the_speed_that_pyserial_sets_is_seen(pty, baud_rate):
    link, bus = pty
    with serial.Serial(link.path, baud_rate, timeout=0.3) as port:
        port.write(b"hello")
        assert port.read(5) != b"hello"
        assert link.line == LineFormat(baud_rate)
        port.baudrate = 115_200
        time.sleep(0.05)
        port.reset_input_buffer()
        port.write(b"hello")
        assert port.read(5) == b"hello"
    assert link.line is None
    assert bus.to_device == 10


def test_closing_a_terminal_sends_what_is_still_in_it():
    link, echo = PtySerial(), Echo()
    bus = SerialBus(link)
    bus.add(echo)
    with serial.Serial(link.path, 115_200) as port:
        bus.advance(START_NS)
        port.write(b"stop")
    for ms in range(5):
        bus.advance(START_NS + ms * MS)
    assert bytes(echo.heard) == b"stop"
    link.close()


@pytest.mark.realtime
def test_pulled_out_and_put_back(pty):
    link, bus = pty
    now_ns = time.monotonic_ns()
    with serial.Serial(link.path, 115_200, timeout=5.0) as port:
        bus.inject(FaultPlan([Fault("unplug", "line", 0.1, 0.6)], now_ns).of("line"))
        with pytest.raises(serial.SerialException):
            port.read(1)
    assert not os.path.lexists(link.path)
    with pytest.raises(serial.SerialException, match="No such file"):
        serial.Serial(link.path, 115_200)
    while not os.path.lexists(link.path):
        time.sleep(0.01)
    assert time.monotonic_ns() - now_ns > 590 * MS
    with serial.Serial(link.path, 115_200, timeout=1.0) as port:
        port.write(b"again")
        assert port.read(5) == b"again"


def test_a_terminal_that_nobody_opens_gives_and_takes_nothing():
    link = PtySerial()
    assert (link.line, link.take(), link.files) == (None, b"", [])
    link.give(b"into the void")
    assert link.take() == b""
    with serial.Serial(link.path, 9600, timeout=0.05) as port:
        assert link.files
        assert port.read(5) == b""
    link.unplug()
    assert (link.line, link.take(), link.files) == (None, b"", [])
    link.give(b"x")


def test_what_is_given_is_not_echoed_to_a_user_who_sets_nothing():
    link = PtySerial()
    user = os.open(link.path, os.O_RDWR | os.O_NOCTTY)
    link.give(b"a\x03\r\n\x04")
    assert os.read(user, 99) == b"a\x03\r\n\x04"
    assert link.take() == b""
    os.close(user)
    link.close()


def test_a_user_who_never_reads_loses_characters():
    link = PtySerial()
    with serial.Serial(link.path, 115_200):
        for _ in range(300):
            link.give(bytes(1000))
        assert link.overrun > 100_000
    link.close()
