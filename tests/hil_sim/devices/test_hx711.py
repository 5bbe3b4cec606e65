"""The HX711 twin at its two lines, and two libraries that know nothing of us, unmodified, on them.

In their place for pins stands the electrical line: set, get, and the time of a call.
"""

import errno
import importlib
import itertools
import sys
import types

import gpiod
import pytest
from gpiod.line import Direction, Value

from hil_sim.buses.gpio.chip import install_pair
from hil_sim.buses.gpio.pair import PairBus
from hil_sim.devices.bridge_converter import FILTER
from hil_sim.devices.hx711 import Hx711Twin
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock

US = 1_000
COUNTS_N = 2.0 * 128 * (1 << 23) * 2e-3 / 50.0


class Master:
    """The other end of the two lines; a call takes 2 us."""

    def __init__(self, force=lambda t: 0.0, rate_error=0.0, faults=(), call_ns=2 * US, **options):
        self.now_ns, self.call_ns = START_NS, call_ns
        plan = FaultPlan([Fault(*one) for one in faults], START_NS)
        self.twin = Hx711Twin(Analog(force), RateClock(rate_error), START_NS, faults=plan.of("cell"), **options)
        self.bus = PairBus()
        self.bus.add(self.twin)
        self.bus.inject(plan.of("lines"))

    def set(self, high):
        self.now_ns += self.call_ns
        self.bus.drive(bool(high), self.now_ns)

    def get(self):
        self.now_ns += self.call_ns
        return int(self.bus.level(self.now_ns))

    def pulse(self, high_ns=0):
        self.set(1)
        self.now_ns += high_ns
        self.set(0)
        return self.get()

    def bits(self, pulses):
        return "".join(str(self.pulse()) for _ in range(pulses))

    def wait(self, ms):
        self.now_ns += round(ms * MS)
        self.bus.advance(self.now_ns)

    def ready(self):
        while self.get():
            self.wait(0.02)

    def sample(self, pulses=25):
        self.ready()
        bits = self.bits(pulses)
        assert bits[24:] == "1" * (pulses - 24)
        value = int(bits[:24], 2)
        return value - (1 << 24) * (value >> 23)


@pytest.mark.parametrize(("rate", "settling_s"), [(10, 0.4), (80, 0.1)])
def test_after_power_up_and_a_reset_it_settles(rate, settling_s):
    master = Master(rate_hz=rate)
    began_ns = START_NS
    for _ in range(2):
        master.ready()
        assert (master.now_ns - began_ns) / 1e9 == pytest.approx(settling_s, abs=1e-3)
        master.set(1)
        master.wait(1)
        assert master.get()  # asleep
        master.wait(900)
        master.set(0)
        began_ns = master.now_ns


@pytest.mark.parametrize(("high_us", "resets"), [(49, False), (56, False), (62, True), (500, True)])
def test_a_pulse_of_more_than_60_us_is_power_down(high_us, resets):
    master = Master(lambda t: 20.0)
    master.sample()
    master.ready()
    for number in range(25):
        level = master.pulse((high_us - 2) * US if number == 5 else 0)
        if resets and number >= 5:
            assert level
    began_ns = master.now_ns
    master.ready()
    assert (master.now_ns - began_ns > 90 * MS) == resets


def test_every_bit_is_that_of_the_force_and_the_25th_is_high():
    master = Master(lambda t: 25.0)
    for _ in range(6):
        counts = master.sample()
    assert counts == pytest.approx(25.0 * COUNTS_N, abs=2)
    assert master.get()
    assert master.bits(5) == "11111"  # more than there are


@pytest.mark.parametrize(("pulses", "gain"), [(25, 128), (26, 0), (27, 64)])
def test_pulses_choose_what_is_converted_next(pulses, gain):
    """26: channel B with 32, which is shorted here."""
    master = Master(lambda t: 20.0)
    assert master.sample(pulses) == pytest.approx(20.0 * COUNTS_N, abs=2)
    began_ns = master.now_ns
    counts = master.sample(pulses)
    assert counts == pytest.approx(20.0 * COUNTS_N * gain / 128, abs=2)
    conversions = (master.now_ns - began_ns) / (12.5 * MS)
    assert round(conversions) == (1 if pulses == 25 else 9)


def test_its_rate_is_that_of_its_own_oscillator():
    master = Master(rate_error=0.17)
    master.sample()
    began_ns = master.now_ns
    for _ in range(80):
        master.sample()
    assert 80e9 / (master.now_ns - began_ns) == pytest.approx(80 * 1.17, rel=1e-3)


def test_its_filter_delays_by_two_conversions():
    assert FILTER.sum() == pytest.approx(1.0)
    master = Master(lambda t: 100.0 * t)
    for _ in range(20):
        counts = master.sample()
    ended_s = (master.now_ns - START_NS) * 1e-9
    assert ended_s - counts / COUNTS_N / 100.0 == pytest.approx(2.0 / 80, abs=4e-4)


@pytest.mark.parametrize(("force", "rail"), [(500.0, 0x7FFFFF), (-500.0, -0x800000)])
def test_it_clips_at_its_rails(force, rail):
    assert Master(lambda t: force).sample() == rail


def test_a_conversion_that_is_not_read_is_replaced_and_one_being_read_is_not():
    master = Master(lambda t: 5.0 * t)
    old = master.sample()
    master.wait(500)
    assert master.sample() - old > 0.45 * 5.0 * COUNTS_N
    master.ready()
    first = master.bits(12)
    master.wait(30)
    rest = master.bits(12)
    assert 0 < int(first + rest, 2) - old < 0.55 * 5.0 * COUNTS_N
    assert not master.pulse()  # the next one has waited


def test_without_supply_its_line_is_low_and_with_an_open_connector_high():
    master = Master(faults=[("off", "cell", 1.0, 2.0), ("silent", "cell", 3.0, 4.0)])
    for _ in range(400):
        master.wait(10)
        time_s = (master.now_ns - START_NS) * 1e-9
        if 1.0 <= time_s < 2.0:
            assert master.bits(25) == "0" * 25
        elif 3.0 <= time_s < 4.0:
            assert master.bits(25) == "1" * 25
    master.wait(200)
    assert abs(master.sample()) < 2


def test_garbage_is_random_bits_of_the_right_form():
    master = Master(faults=[("garbage", "cell", 0.0, 9.0)])
    found = {master.sample() for _ in range(20)}
    assert len(found) == 20
    assert max(abs(one) for one in found) > 1 << 21


def test_what_it_counts_as_shown_is_what_was_there_from_the_first_to_the_last_reading():
    master = Master(rate_error=0.1)
    for _ in range(10):
        master.sample()
    assert master.twin.conversions.shown == 10
    master.wait(1000)
    master.sample()
    assert master.twin.conversions.shown == pytest.approx(10 + 88, abs=1)


def test_faults_that_it_cannot_have_are_refused():
    with pytest.raises(FaultError, match="cannot have the fault nack"):
        Master(faults=[("nack", "cell", 0.0, 1.0)])
    with pytest.raises(FaultError, match="cannot have the fault stuck_bus"):
        Master(faults=[("stuck_bus", "lines", 0.0, 1.0)])


# The lines


@pytest.fixture
def lines():
    master = Master(lambda t: 20.0, faults=[("unplug", "lines", 5.0, 6.0)])
    uninstall = install_pair("/dev/gpiochip9", master.bus, lambda: master.now_ns)
    yield master
    uninstall()


def test_libgpiod_finds_the_two_lines(lines):
    config = {
        5: gpiod.LineSettings(direction=Direction.INPUT),
        6: gpiod.LineSettings(direction=Direction.OUTPUT),
    }
    request = gpiod.request_lines("/dev/gpiochip9", config)
    lines.wait(110)
    assert request.get_value(5) is Value.INACTIVE
    with pytest.raises(PermissionError):
        request.set_value(5, Value.ACTIVE)
    bits = ""
    for _ in range(25):
        request.set_value(6, Value.ACTIVE)
        request.set_value(6, Value.INACTIVE)
        bits += str(int(request.get_value(5) is Value.ACTIVE))
    assert int(bits[:24], 2) == pytest.approx(20.0 * COUNTS_N, abs=2)
    with pytest.raises(FileNotFoundError):
        gpiod.request_lines("/dev/gpiochip-none", config)
    lines.wait(5000)
    with pytest.raises(OSError, match="No such device"):
        request.get_value(5)
    with pytest.raises(OSError, match="No such device"):
        gpiod.request_lines("/dev/gpiochip9", config)
    lines.wait(1000)
    gpiod.request_lines("/dev/gpiochip9", config).release()


def test_requests_of_another_process_are_the_same_pulses(lines):
    lines.wait(110)
    assert lines.bus.transfer(0, b"", 1, lines.now_ns) == b"\0"
    answer = lines.bus.transfer(0, bytes([25]), 8, lines.now_ns)
    bits, high_ns = int.from_bytes(answer[:4], "little"), int.from_bytes(answer[4:], "little")
    assert bits & 1
    assert bits >> 1 == pytest.approx(20.0 * COUNTS_N, abs=2)
    assert high_ns == US
    assert lines.bus.pulses == 25
    lines.bus.transfer(0, b"\1", 0, lines.now_ns)
    lines.wait(1)
    lines.bus.transfer(0, b"\0", 0, lines.now_ns)
    assert lines.bus.transfer(0, b"", 1, lines.now_ns) == b"\1"
    for wrong in [(1, b"", 1), (0, b"", 2), (0, b"\0\0", 0), (0, b"\0", 1)]:
        with pytest.raises(OSError, match="Invalid argument") as raised:
            lines.bus.transfer(*wrong, lines.now_ns)
        assert raised.value.errno == errno.EINVAL


def test_two_lines_carry_one_chip(lines):
    with pytest.raises(ValueError, match="two other lines"):
        lines.bus.add(lines.twin)


# Strangers


def slept(master):
    """The library's ``time`` on the master's."""
    return types.SimpleNamespace(
        sleep=lambda seconds: master.wait(1e3 * seconds), perf_counter=lambda: master.now_ns * 1e-9
    )


@pytest.fixture
def of_roose(monkeypatch):
    """Package ``hx711`` on a stand-in for RPi.GPIO: its lines are the master's."""

    def make(master, **options):
        gpio = types.ModuleType("RPi.GPIO")
        gpio.BCM, gpio.IN, gpio.OUT = 11, 1, 0
        gpio.setmode = gpio.setup = lambda *arguments: None
        gpio.output = lambda pin, level: master.set(level)
        gpio.input = lambda pin: master.get()
        above = types.ModuleType("RPi")
        above.GPIO = gpio
        for name, module in (("RPi", above), ("RPi.GPIO", gpio)):
            monkeypatch.setitem(sys.modules, name, module)
        monkeypatch.delitem(sys.modules, "hx711", raising=False)
        library = pytest.importorskip("hx711", reason="deploy/requirements-test.lock has it")
        monkeypatch.setattr(library, "time", slept(master))
        return library.HX711(5, 6, **options)

    yield make
    sys.modules.pop("hx711", None)


@pytest.mark.parametrize("gain", [128, 64])
@pytest.mark.parametrize("force", [20.0, -7.5])
def test_hx711_reads_weighs_and_resets(of_roose, force, gain):
    master = Master(lambda t: force)
    library = of_roose(master, gain=gain)
    data = library.get_raw_data(5)
    assert data == pytest.approx([force * COUNTS_N * gain / 128] * 5, abs=2)
    began_ns = master.now_ns
    assert library.reset()
    assert library.get_raw_data(2)[-1] == pytest.approx(force * COUNTS_N * gain / 128, abs=2)
    assert (master.now_ns - began_ns) / MS > 50 + 6 * 12.5


def test_hx711_reads_the_other_channel_and_says_what_is_saturated(of_roose):
    library = of_roose(Master(lambda t: 500.0, offset=1e-5))  # its fault: a reading of 0 is taken for none
    assert library._read() is False
    library.channel = "B"
    assert library.get_raw_data(2)[-1] == pytest.approx(1e-5 * 2.0 * 32 * (1 << 23), abs=2)


def test_hx711_notices_that_a_pulse_lasted_too_long(of_roose):
    master = Master(lambda t: 20.0)
    library = of_roose(master)
    calls, plain = itertools.count(), master.set

    def stalled(level):
        plain(level)
        master.now_ns += 100 * US if level and next(calls) == 7 else 0

    master.set = stalled
    assert library._read() is False
    assert library.get_raw_data(2) == pytest.approx([20.0 * COUNTS_N] * 2, abs=2)


class Pin:
    def __init__(self, master):
        self.master = master

    @property
    def value(self):
        return bool(self.master.get())

    @value.setter
    def value(self, level):
        self.level = level
        self.master.set(level)


class ClockPin(Pin):
    """What is read of an output is what was set."""

    @property
    def value(self):
        return self.level

    @value.setter
    def value(self, level):
        self.level = level
        self.master.set(level)


@pytest.fixture
def of_adafruit(monkeypatch):
    """Package ``adafruit_hx711`` on pins that are the master's lines."""

    def make(master):
        digital, controller = types.ModuleType("digitalio"), types.ModuleType("microcontroller")
        digital.DigitalInOut = Pin
        controller.disable_interrupts = controller.enable_interrupts = lambda: None
        controller.delay_us = lambda us: master.wait(1e-3 * us)
        for name, module in (("digitalio", digital), ("microcontroller", controller)):
            monkeypatch.setitem(sys.modules, name, module)
        pytest.importorskip("adafruit_hx711", reason="deploy/requirements-test.lock has it")
        library = importlib.import_module("adafruit_hx711.hx711")
        monkeypatch.setattr(library, "time", slept(master))
        return library.HX711(Pin(master), ClockPin(master))

    yield make
    for name in ("adafruit_hx711", "adafruit_hx711.hx711"):
        sys.modules.pop(name, None)


def test_adafruit_hx711_reads_both_gains_and_the_other_channel(of_adafruit):
    library = of_adafruit(Master(lambda t: 20.0))
    assert library.read(library.CHAN_A_GAIN_128) == pytest.approx(20.0 * COUNTS_N, abs=2)
    assert library.read(library.CHAN_A_GAIN_64) == pytest.approx(20.0 * COUNTS_N / 2, abs=2)
    counts = library.read(library.CHAN_B_GAIN_32)
    assert min(counts, abs(counts - (1 << 32))) < 2  # its fault: 32 bits without a sign
