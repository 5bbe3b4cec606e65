"""The simulated Robotous sensor byte for byte, by commands as clients of others send them."""

import struct

import pytest

from hil_sim.buses.serial_bus import SerialBus
from hil_sim.buses.serial_port import VirtualSerial
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.devices.wrist.robotous_rft import RftTwin, sample_length
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.serial_bench import Line
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock

START, STOP = bytes.fromhex("550b000000000000000baa"), bytes.fromhex("550c000000000000000caa")
BIASED, UNBIASED = bytes.fromhex("55110100000000000012aa"), bytes.fromhex("55110000000000000011aa")


def sensor(*faults, fz=2.0, component=2, most=100.0, **options):
    """A sensor that feels a force along z, a number or a function of mission time."""
    felt = Analog(fz if callable(fz) else lambda _: fz)
    plan = FaultPlan([Fault(*fault) for fault in faults], START_NS)
    options = {"jitter_ns": 0, "faults": plan.of("wrist"), **options}
    return RftTwin({component: (felt, most)}, RateClock(), START_NS, **options)


def bench(*faults, **options):
    line = Line(sensor(*faults, **options))
    line.run(1)
    return line


def asked(*field):
    data = bytes(field).ljust(8, b"\0")
    return b"\x55" + data + bytes([sum(data) % 256, 0xAA])


def fields(data):
    """Data fields, their sums checked; the last packet may be under way."""
    found = []
    for at in range(0, len(data) // 19 * 19, 19):
        one = data[at : at + 19]
        assert (one[0], one[17], one[18]) == (0x55, sum(one[1:17]) % 256, 0xAA)
        found.append(one[1:17])
    return found


def samples(data):
    """Counts and overload byte of each sample."""
    assert all(field[0] == 11 for field in fields(data))
    return [(list(struct.unpack(">6h", field[1:13])), field[13]) for field in fields(data)]


def test_it_is_idle_until_it_is_started_and_stops():
    line = bench()
    assert line.run(100) == b""
    assert all(counts == [0, 0, 100, 0, 0, 0] for counts, _ in samples(line.ask(START, 1008)))
    assert 200 <= line.device.produced <= 202  # as it comes
    line.ask(STOP, 20)
    assert line.run(100) == b""


@pytest.mark.parametrize(
    ("code", "rate_hz"), [(0, 200), (1, 10), (2, 20), (3, 50), (4, 100), (5, 200), (6, 333), (7, 500), (8, 1000)]
)
def test_its_rate_is_set_and_survives_without_power(code, rate_hz):
    line = Line(sensor(("off", "wrist", 0.2, 0.3), line=LineFormat(921_600)))
    line.run(1)
    assert fields(line.ask(asked(15, code), 10))[0][:3] == bytes([15, 1, 0])
    line.run(400)
    assert fields(line.ask(asked(16), 10))[0][:2] == bytes([16, code])
    assert abs(len(samples(line.ask(START, 1003))) - rate_hz) <= 1


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        *(((1,), b"\1RFT40-SA01\0"), ((7,), b"\7\4\4"), ((9,), b"\x09\0\0"), ((8, 1, 14), b"\x08\1\0")),
        *(((8, 2, 1), b"\x08\0\2"), ((8, 1, 15), b"\x08\0\2"), ((15, 9), b"\x0f\0\2"), ((6, 1), b"\6\0\1")),
        *(((99,), b"c\0\1"), ((18,), b"\x12" + bytes(6))),
    ],
)
def test_a_command_is_answered(command, answer):
    assert fields(bench().ask(asked(*command), 10))[0].startswith(answer)


def test_a_command_with_a_wrong_sum_or_end_is_not_and_junk_before_it_is_left_out():
    line = bench()
    assert line.ask(asked(1)[:-2] + b"\0\xaa", 10) == b""
    assert line.ask(asked(1)[:-1] + b"\0", 10) == b""
    assert fields(line.ask(b"junk" + asked(1), 10))[0][0] == 1


def test_while_it_sends_it_takes_stop_and_bias_alone():
    line = bench()
    line.ask(START, 20)
    assert {tuple(counts) for counts, _ in samples(line.ask(asked(1) + asked(15, 1), 40))} == {(0, 0, 100, 0, 0, 0)}
    line.ask(BIASED, 10)
    assert {tuple(counts) for counts, _ in samples(line.ask(b"", 40))} == {(0,) * 6}
    line.ask(UNBIASED, 10)
    assert samples(line.ask(b"", 40))[-1][0] == [0, 0, 100, 0, 0, 0]


@pytest.mark.parametrize(("fz", "overload"), [(119.0, 0), (121.0, 8), (-121.0, 8), (9999.0, 8)])
def test_beyond_120_percent_it_says_which_component(fz, overload):
    line = bench(fz=fz)
    counts, said = samples(line.ask(START, 20))[-1]
    assert counts[2] == max(min(round(50 * fz), 32767), -32768)
    assert said == overload
    line.ask(STOP, 10)
    assert (fields(line.ask(asked(18), 10))[0][3] > 0) == bool(overload)


def test_a_newton_metre_is_2000_or_1000_counts():
    for counts in (2000, 1000):
        line = bench(fz=1.5, component=5, torque_counts=counts)
        assert samples(line.ask(START, 20))[-1][0][5] == 1.5 * counts


def test_a_sample_is_that_of_its_time():
    line = bench(fz=lambda time_s: 100.0 * time_s)
    begun_s = 1e-9 * (line.now_ns - START_NS)
    for number, (counts, _) in enumerate(samples(line.ask(START, 98))):
        at_s = begun_s + 1.9e-3 + 5e-3 * (number + 1)  # the command on the line, and its millisecond
        assert counts[2] == pytest.approx(5000 * at_s, abs=2)


def test_without_power_it_is_idle_and_its_bias_is_off():
    line = bench(("off", "wrist", 0.2, 0.3))
    line.ask(START, 100)
    line.ask(BIASED, 300)
    assert line.run(100) == b""
    assert samples(line.ask(START, 20))[-1][0][2] == 100


def test_several_tables_are_one_sensor():
    adapter = VirtualSerial("/dev/hil-wrist")
    bus, now_ns = SerialBus(adapter), START_NS
    parts = [sensor(fz=1.0), sensor(("silent", "wrist", 0.5, 0.6), fz=-4.0, component=5)]
    for part in parts:
        bus.add(part, lambda part=part: part.produced, sample_length)
    bus.advance(START_NS)
    port = adapter.open(LineFormat(115_200))
    port.write(START)
    for _ in range(999):
        now_ns += MS
        bus.advance(now_ns)
    heard = samples(port.read(1_000_000))
    assert {tuple(counts) for counts, _ in heard} == {(0, 0, 50, 0, 0, -8000)}
    assert parts[0].produced == parts[1].produced == 199
    assert abs(len(heard) - (bus.samples - 20)) <= 1  # it was silent for a tenth of a second


def test_a_fault_that_it_cannot_have_is_refused():
    for kind in ("nack", "clock_jump"):
        with pytest.raises(FaultError, match=kind):
            sensor((kind, "wrist", 1.0, 2.0))
