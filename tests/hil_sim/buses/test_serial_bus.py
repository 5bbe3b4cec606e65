"""Serial buses: T0 ports on a virtual clock, T1 pseudo-terminals for pyserial, and what can break on the line.

Serial buses in real time: pseudo-terminals, opened by pyserial.
"""

import os
import time

import pytest
import serial

from hil_sim.buses.serial_bus import SerialBus
from hil_sim.buses.serial_port import PtySerial, VirtualSerial, install_serial
from hil_sim.devices.serial_line.dsc_load_cell import DscLoadCellTwin
from hil_sim.devices.serial_line.nimu import NimuTwin
from hil_sim.devices.serial_line.qsb import QsbTwin
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import Fault, FaultPlan
from tests.hil_sim.buses.serial_rig import FAST, Echo, Rig
from tests.hil_sim.devices.serial_bench import RealTime
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock, StairImu


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


def test_what_is_written_to_a_terminal_is_heard_after_it_was_written():
    """The line was looked at 5 ms before; a device that answered from there would show what was before the question."""
    link, heard_ns = PtySerial(), []

    class Dated(Echo):
        def _on_byte(self, byte, now_ns):
            heard_ns.append(now_ns)

    bus = SerialBus(link)
    bus.add(Dated())
    with serial.Serial(link.path, 115_200) as port:
        bus.advance(START_NS)
        port.write(b"?")
        for ms in (5, 6):
            bus.advance(START_NS + ms * MS)
        bit_ns = 1e9 / 115_200
        assert heard_ns == [pytest.approx(START_NS + 5 * MS + 10 * bit_ns, abs=bit_ns)]
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


def test_samples_that_were_not_read_before_a_port_was_closed_are_not_counted():
    for latency_ns in (0, 16 * MS):
        nimu = NimuTwin(StairImu(), RateClock(), START_NS)
        rig = Rig(device=nimu, latency_ns=latency_ns)
        rig.bus = SerialBus(rig.adapter, latency_ns=latency_ns)
        rig.bus.add(nimu, lambda nimu=nimu: nimu.produced, len)
        rig.run(500)
        with rig.adapter.open(FAST) as port:
            rig.run(1000)
            read = port.read(port.in_waiting)
            rig.run(40)
            assert rig.bus.samples > 150
        rig.run(10)
        assert rig.bus.samples == len(read) // 38 > 140


def test_samples_that_were_not_read_before_a_terminal_was_closed_are_not_counted():
    link, nimu = PtySerial(), NimuTwin(StairImu(), RateClock(), START_NS)
    bus = SerialBus(link)
    bus.add(nimu, lambda: nimu.produced, len)
    with serial.Serial(link.path, 115_200, timeout=0) as port:
        for ms in range(1000):
            bus.advance(START_NS + ms * MS)
        read = port.read(4000)
        for ms in range(1000, 1020):  # it does not read these
            bus.advance(START_NS + ms * MS)
        made = bus.samples
    assert bus.samples == len(read) // 38 > 70
    assert made > bus.samples
    bus.advance(START_NS + 1020 * MS)
    assert bus.samples == len(read) // 38
    link.close()


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
