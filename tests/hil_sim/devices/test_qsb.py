"""The QSB twin against "QSB Command List" v1.28: formats, factory values and examples typed here.

Three command sequences that real QSBs have obeyed stand beside it: the one of the adapter's documentation, the
manufacturer's Linux demonstration, and the Thirty Meter Telescope's reader, whose checks of each answer are repeated.
"""

import math
from itertools import pairwise

import hypothesis.strategies as st
import pytest
from hypothesis import given

from hil_sim.devices.serial_line.qsb import TICK_512_HZ, TICK_1900_US, QsbTwin
from hil_sim.devices.serial_line.serial_wire import LineFormat
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.serial_bench import Line
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock

COUNT = math.tau / 500_000  # rad
FREE_X4 = b"W0303"


class Bench(Line):
    """An adapter that has started, on a shaft that turns at ``counts_s`` (or as ``angle`` says)."""

    def __init__(self, counts_s=0.0, angle=None, rate_error=0.0, boot=True, **options):
        self.clock = RateClock(rate_error)
        self._rest = ""
        super().__init__(QsbTwin(Analog(angle or (lambda t: counts_s * COUNT * t)), self.clock, START_NS, **options))
        if boot:
            assert self.run(150) == b"QSB-D  0E!\r\n"

    def do(self, *commands):
        """Send commands one by one; the answers, without their line ends."""
        return [self.ask(command + b"\r\n", 3).decode().removesuffix("\r\n") for command in commands]

    def lines(self, ms):
        """The lines that ended in the next ``ms``."""
        *whole, self._rest = (self._rest + self.run(ms).decode()).split("\r\n")
        return whole

    def pulse(self, after_ms, high_ns=300_000):
        self.device.dig_io(self.now_ns + round(after_ms * MS), high_ns)


def faults(*faults):
    return FaultPlan(faults, START_NS).of("qsb")


def data_of(lines, register):
    return [int(line.split()[2], 16) for line in lines if line.startswith(f"s {register}")]


def stamp_of(lines, register):
    return [int(line.split()[3], 16) for line in lines if line.startswith(f"s {register}")]


# Formats


@pytest.mark.parametrize(
    ("eor", "answer"),
    [
        (b"0", b"r1413FA600E!"),
        (b"1", b"r1413FA600E!\n"),
        (b"2", b"r1413FA600E!\r"),
        (b"3", b"r1413FA600E!\r\n"),
        (b"8", b"r 14 13FA600E !"),
        (b"B", b"r 14 13FA600E !\r\n"),
    ],
)
def test_end_of_response(eor, answer):
    bench = Bench()
    bench.ask(b"W15" + eor + b"\r")
    assert bench.ask(b"R14\r") == answer


def test_a_full_line_is_26_bytes_and_1128_us():
    bench = Bench(angle=lambda t: 0x0001F4A2 * COUNT * (t > 1.0))
    bench.do(b"W15F", FREE_X4, b"W092", b"W0D1")
    bench.run((0x1234 + 0.5) * 1000 / 512 - 3)
    assert bench.ask(b"S0E\r", 2) == b"s 0E 0001F4A2 00001234 !\r\n"
    assert bench.ends_ns[-1] - bench.ends_ns[0] == pytest.approx(25 * 10 / 230_400 * 1e9, abs=1)


@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r\n", b"\n\r"])
def test_any_end_of_command(end):
    assert Bench().ask(b"R15" + end) == b"r 15 0000000B !\r\n"


def test_backspace_deletes():
    assert Bench().ask(b"R16\x085\r") == b"r 15 0000000B !\r\n"
    assert Bench().ask(b"\x08\x08R15\r") == b"r 15 0000000B !\r\n"


def test_data_may_be_short_or_have_eight_digits_in_either_case():
    bench = Bench()
    assert bench.do(b"W081F3", b"W08000001f3", b"W08FFFFFFFF") == [
        "w 08 000001F3 !",
        "w 08 000001F3 !",
        "w 08 FFFFFFFF !",
    ]


@pytest.mark.parametrize(
    "command", [b"Q15", b"r15", b"R", b"R1", b"RXY", b"W15 F", b"W15000000000F", b"\xff\xfe", b"W15G", b"!" * 40]
)
def test_what_is_no_command_is_an_error(command):
    bench = Bench()
    assert bench.do(command, b"R15") == ["e 00 00000000 !", "r 15 0000000B !"]


# Registers


@pytest.mark.parametrize(
    ("register", "value"),
    [
        ("00", "00000000"),
        ("01", "0000000F"),
        ("02", "00000000"),
        ("03", "0000004F"),
        ("04", "00000000"),
        ("05", "00000000"),
        ("06", "0000000A"),
        ("07", "00000000"),
        ("08", "000001F3"),
        ("0B", "00000000"),
        ("0C", "0000FFFF"),
        ("0E", "00000000"),
        ("14", "13FA600E"),
        ("15", "0000000B"),
    ],
)
def test_factory_values(register, value):
    assert Bench(sync_input=False).do(b"R" + register.encode()) == [f"r {register} {value} !"]


@pytest.mark.parametrize("register", ["0F", "10", "13", "17", "7F", "FF"])
def test_other_registers_are_not_supported(register):
    code = register.encode()
    assert Bench().do(b"R" + code, b"W" + code + b"12", b"S" + code) == [
        f"x {register} 00000000 !",
        f"x {register} 00000012 !",
        f"x {register} 00000000 !",
    ]


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        (b"W0512", "e 05 00000012 !"),
        (b"W0612", "e 06 00000012 !"),
        (b"W0712", "e 07 00000012 !"),
        (b"W0E1234", "e 0E 00001234 !"),
        (b"W141", "e 14 00000001 !"),
        (b"W03100", "e 03 00000100 !"),
        (b"W04200", "e 04 00000200 !"),
        (b"W1510", "e 15 00000010 !"),
        (b"W0C10000", "e 0C 00010000 !"),
        (b"W094", "e 09 00000004 !"),
        (b"W0A2", "e 0A 00000002 !"),
        (b"W162", "e 16 00000002 !"),
        (b"W1680A", "e 16 0000080A !"),
        (b"W03", "e 03 00000000 !"),
    ],
)
def test_a_refused_write_echoes_and_writes_nothing(command, answer):
    bench = Bench()
    before = bench.do(*(b"R%02X" % register for register in range(0x0D)))
    assert bench.do(command) == [answer]
    assert bench.do(*(b"R%02X" % register for register in range(0x0D))) == before


def test_streams_of_other_registers_are_not_supported():
    assert Bench().do(b"S03", b"S0D") == ["x 03 00000000 !", "x 0D 00000000 !"]


def test_clear_and_load():
    bench = Bench(angle=lambda t: 1234 * COUNT)
    bench.do(FREE_X4, b"W0877", b"W0A0")
    assert bench.do(b"R0E", b"W0A1", b"R07") == ["r 0E 00000077 !", "w 0A 00000001 !", "r 07 00000077 !"]
    assert bench.do(b"W092", b"R0E") == ["w 09 00000002 !", "r 0E 00000000 !"]
    assert bench.do(b"W04100", b"W091", b"R04") == ["w 04 00000100 !", "w 09 00000001 !", "r 04 00000000 !"]
    assert bench.do(b"W090", b"R03") == ["w 09 00000000 !", "r 03 00000000 !"]


def test_clearing_the_status_forgets_its_flags():
    bench = Bench(angle=lambda t: -3 * COUNT * (t > 0.2))
    bench.do(FREE_X4)
    bench.run(60)
    assert bench.do(b"R06", b"W093", b"R06") == ["r 06 00000049 !", "w 09 00000003 !", "r 06 00000009 !"]


def test_modulo_500_from_the_factory_and_free_running_when_told():
    bench = Bench(angle=lambda t: 1234 * COUNT * (t > 0.2))
    bench.run(100)
    assert bench.do(b"R0E") == [f"r 0E {1234 % 500:08X} !"]
    other = Bench(angle=lambda t: 1234 * COUNT * (t > 0.2))
    other.do(b"W0343")
    other.run(100)
    assert other.do(b"R0E") == [f"r 0E {1234:08X} !"]


def test_the_count_wraps_at_32_bits():
    bench = Bench(angle=lambda t: (-2 if t > 0.3 else 3 if t > 0.2 else 0) * COUNT)
    bench.do(FREE_X4)
    bench.run(80)
    assert bench.do(b"R0E") == ["r 0E 00000003 !"]
    bench.run(100)
    assert bench.do(b"R0E", b"R06") == ["r 0E FFFFFFFE !", "r 06 00000049 !"]  # borrow, enabled, down, negative


def test_bit_8_counts_down_and_bit_7_does_not():
    for mdr1, count in ((b"080", 0x64), (b"100", 0xFFFF_FF9C)):
        bench = Bench(angle=lambda t: 100 * COUNT * (t > 0.2))
        bench.do(FREE_X4, b"W04" + mdr1)
        bench.run(60)
        assert bench.do(b"R0E") == [f"r 0E {count:08X} !"]


# Time stamp


@pytest.mark.parametrize(("tick_ns", "ticks"), [(TICK_512_HZ, 5120), (TICK_1900_US, 5263)])
@pytest.mark.parametrize("rate_error", [0.0, 0.004])
def test_both_ticks_on_its_own_clock(tick_ns, ticks, rate_error):
    bench = Bench(tick_ns=tick_ns, rate_error=rate_error)
    bench.do(b"W15F", b"W0D1")
    first = int(bench.do(b"R0D")[0].split()[2], 16)
    bench.run(10_000 - 3)
    assert int(bench.do(b"R0D")[0].split()[2], 16) - first == pytest.approx(ticks * (1 + rate_error), abs=1)


def test_the_stamp_is_cleared_by_a_one_only_and_wraps_at_32_bits():
    bench = Bench(tick_ns=0.25)  # a fast one: 2^32 ticks in 1.07 s
    bench.do(b"W15F", b"W0D1")
    bench.run(1000)
    assert int(bench.do(b"W0D0", b"R0D")[1].split()[2], 16) > 4_000_000_000
    bench.run(100)
    assert int(bench.do(b"R0D")[0].split()[2], 16) < 300_000_000


# Streams


def test_a_stream_speaks_at_once_and_then_at_each_interval():
    bench = Bench(counts_s=1000.0)
    bench.do(b"W15F", FREE_X4, b"W092", b"W0C4")
    bench.send(b"S0E\r")
    lines = bench.lines(200)
    counts = data_of(lines, "0E")
    assert len(lines) == len(counts) == bench.device.produced == 26  # 200 ms / (4 * 1.953 ms) and the first
    assert lines[0].startswith("s 0E")
    steps = {b - a for a, b in pairwise(counts)}
    assert steps <= {7, 8}  # 7.8 counts in 7.8 ms
    stamps = stamp_of(lines, "0E")
    assert {b - a for a, b in pairwise(stamps[1:])} == {4}
    assert counts[0] == pytest.approx(6, abs=1)  # W092 was 6 ms earlier


def test_interval_ffff_says_it_once():
    bench = Bench(counts_s=1000.0)
    bench.send(b"S0E\r")
    assert len(bench.lines(500)) == 1


def test_interval_zero_goes_as_fast_as_the_line():
    bench = Bench(counts_s=1000.0)
    bench.do(b"W15F", b"W0C0")
    bench.send(b"S0E\r")
    lines = bench.lines(1000)
    assert len(lines) == pytest.approx(886, abs=2)  # 26 B at 230400 baud
    bench.do(b"W153")
    assert len(bench.lines(1000)) == pytest.approx(1645, abs=3)  # 14 B


def test_a_tick_that_finds_the_line_busy_waits_for_it():
    bench = Bench(counts_s=1000.0)
    bench.do(b"W15F", b"W1600A")
    bench.wire.host = LineFormat(9600)
    bench.send(b"W0C1\r")
    bench.run(60)
    bench.send(b"S0E\r")
    lines = bench.lines(1000)
    assert len(lines) == pytest.approx(1000 / (26 * 10 / 9.6), abs=2)
    stamps = stamp_of(lines, "0E")
    assert stamps == sorted(set(stamps))


@pytest.mark.parametrize(("threshold", "step"), [(b"0", 0), (b"1", 1), (b"A", 10), (b"FFFF", 65_535)])
def test_threshold(threshold, step):
    bench = Bench(angle=lambda t: COUNT * max(0.0, t - 0.3) * 200_000)
    bench.do(b"W15F", FREE_X4, b"W092", b"W0C1", b"W0B" + threshold)
    bench.send(b"S0E\r")
    still = data_of(bench.lines(100), "0E")
    assert len(still) == (1 if step else pytest.approx(51, abs=2))
    bench.run(40)
    moving = data_of(bench.lines(1000), "0E")
    assert len(moving) > 2
    assert min(b - a for a, b in pairwise(moving)) >= step


def test_threshold_works_both_ways_and_over_the_wrap():
    bench = Bench(angle=lambda t: COUNT * (-5 if t > 0.4 else 0))
    bench.do(b"W15F", FREE_X4, b"W092", b"W0C1", b"W0B5")
    bench.send(b"S0E\r")
    assert data_of(bench.lines(500), "0E") == [0, 0xFFFF_FFFB]


def test_a_read_ends_its_own_stream_only():
    bench = Bench(counts_s=2000.0)
    bench.do(b"W15F", FREE_X4, b"W0C2", b"S0E", b"S01")
    bench.send(b"R0E\r")
    assert sum(line.startswith("r 0E") for line in bench.lines(8)) == 1
    bench.pulse(2)
    assert [line[:14] for line in bench.lines(50)] == ["s 01 0000000F ", "s 01 0000000E "]


def test_w161_ends_all_streams():
    bench = Bench(counts_s=2000.0)
    bench.do(b"W0C2", b"S0E", b"S06", b"S01", b"W161")
    bench.pulse(2)
    assert bench.lines(100) == []


def test_the_interval_of_a_running_stream_can_be_changed():
    bench = Bench(counts_s=2000.0)
    bench.do(b"W15F", b"W0C1")
    bench.send(b"S0E\r")
    bench.run(10)
    bench.send(b"W0C40\r")
    bench.run(10)
    assert len(bench.lines(1000)) == 8  # 64 ticks are 125 ms
    bench.send(b"W0CFFFF\r")
    bench.run(10)
    assert bench.lines(1000) == []


def test_status_stream_speaks_when_the_direction_changes():
    bench = Bench(angle=lambda t: COUNT * 1000 * abs(t - 0.5))
    bench.do(b"W15F", FREE_X4, b"W092", b"W08FFFFFF", b"S06")
    bench.run(100)
    lines = bench.lines(400)
    assert data_of(lines, "06") == [0x0A | 0x40 | 0x01]


# Capture


def test_the_edge_captures_the_count():
    bench = Bench(counts_s=40_000.0)
    bench.do(b"W15F", FREE_X4, b"W092", b"W02010", b"S05")
    cleared_ns = bench.clock.time_ns(0)
    bench.pulse(5)
    edge_s = (bench.now_ns + 5 * MS - cleared_ns) * 1e-9
    captured = data_of(bench.lines(20), "05")
    bench.pulse(5)
    captured += data_of(bench.lines(20), "05")
    assert len(captured) == 2
    assert captured[1] - captured[0] == 800  # 20 ms
    count = int(bench.do(b"R0E")[0].split()[2], 16)
    read_s = (bench.now_ns - cleared_ns) * 1e-9 - 0.003
    assert count - captured[0] == pytest.approx(40_000 * (read_s - edge_s), abs=20)
    assert bench.do(b"R05")[0].startswith(f"r 05 {captured[1]:08X} ")


@pytest.mark.parametrize(("latency_ns", "count"), [(0, 0), (30_000, 7)])
def test_what_is_captured_is_the_count_at_the_edge_however_late_the_line_speaks(latency_ns, count):
    bench = Bench(angle=lambda t: COUNT * (7 if t > 0.200_02 else 0), capture_latency_ns=latency_ns)
    bench.do(b"W15F", FREE_X4, b"W0C0", b"W02010", b"S05", b"S0E")
    bench.pulse(200 - (bench.now_ns - START_NS) / MS)
    bench.run(60)
    assert bench.device.captures == 1
    bench.do(b"W161")
    assert bench.do(b"R05", b"R0E")[0].split()[2] == f"{count:08X}"


def test_a_falling_edge_is_captured_with_011():
    bench = Bench(counts_s=100_000.0)
    bench.do(b"W15F", FREE_X4, b"W02011", b"S05", b"S01")
    bench.pulse(2, high_ns=10 * MS)
    lines = bench.lines(8)
    assert data_of(lines, "05") == []
    lines = bench.lines(20)
    assert len(data_of(lines, "05")) == 1
    assert stamp_of(lines, "05") == stamp_of(lines, "01")


@pytest.mark.parametrize("configuration", [b"000", b"001", b"020", b"E0E"])
def test_without_its_interrupt_nothing_is_captured(configuration):
    bench = Bench(counts_s=100_000.0)
    bench.do(b"W15F", FREE_X4, b"W02" + configuration, b"S05")
    bench.pulse(2)
    assert bench.lines(20) == []
    assert bench.device.captures == 0


def test_a_shaft_at_rest_gives_no_capture_line_but_an_input_line():
    bench = Bench()
    bench.do(b"W15F", FREE_X4, b"W02010", b"S05", b"S01")
    bench.pulse(2)
    lines = bench.lines(20)
    assert data_of(lines, "05") == []
    assert data_of(lines, "01") == [0xF, 0xE]
    assert bench.device.captures == 1


def test_pulses_that_are_dropped_and_pulses_that_nobody_sent():
    bench = Bench(
        counts_s=10_000.0,
        faults=faults(Fault("pulse_drop", "qsb", 0.5, 1.0), Fault("pulse_spurious", "qsb", 1.5, 1.7, value=0.05)),
    )
    bench.do(b"W15F", FREE_X4, b"W02010", b"S05")
    for _ in range(13):  # every 100 ms from 0.2 s on
        bench.pulse(38)
        bench.lines(100)
    assert bench.device.captures == 8
    bench.lines(1000)
    assert bench.device.captures == 12


def test_a_capture_that_the_supply_does_not_live_to_see():
    bench = Bench(capture_latency_ns=5 * MS, faults=faults(Fault("off", "qsb", 0.203, 0.3)))
    bench.do(b"W02010")
    bench.pulse(200 - (bench.now_ns - START_NS) / MS)
    bench.run(400)
    assert bench.device.captures == 0


def test_a_pulse_in_the_past_is_refused():
    bench = Bench()
    with pytest.raises(ValueError, match="advance the pulse source before the adapter"):
        bench.device.dig_io(bench.now_ns - MS, 300_000)


# Supply, save, baud rate


def test_the_banner_comes_100_ms_after_power_up_and_nothing_is_obeyed_before():
    bench = Bench(boot=False)
    bench.run(10)
    assert bench.ask(b"R15\r", 89) == b""
    assert bench.run(5) == b"QSB-D  0E!\r\n"


def test_saved_registers_survive_and_the_count_does_not():
    angle = 777 * COUNT
    bench = Bench(angle=lambda t: angle * (t > 0.3), faults=faults(Fault("reset", "qsb", 0.5)))
    bench.do(FREE_X4, b"W15F", b"W0C3", b"W02010", b"W163", b"W0B7")
    bench.run(200)
    assert bench.do(b"R0E")[0].startswith("r 0E 00000309")
    bench.run(300)
    values = [answer.split()[2] for answer in bench.do(b"R03", b"R15", b"R0C", b"R02", b"R0B", b"R0E")]
    assert values == ["00000003", "0000000F", "00000003", "00000010", "00000000", "00000000"]


def test_a_reset_without_save_is_the_factory():
    bench = Bench(faults=faults(Fault("off", "qsb", 0.5, 0.6)))
    bench.do(FREE_X4, b"W15F", b"W0C0", b"S0E")
    bench.run(600)
    bench._rest = ""
    assert bench.lines(100) == []
    assert bench.do(b"R03", b"R15") == ["r 03 0000004F !", "r 15 0000000B !"]


def test_dtr_high_low_high_restarts_it():
    bench = Bench()
    bench.do(b"W15F")
    bench.device.drive_dtr(False, bench.now_ns)
    assert bench.run(200) == b""
    bench.device.drive_dtr(True, bench.now_ns)
    assert bench.run(110) == b"QSB-D  0E!\r\n"
    assert bench.do(b"R15") == ["r 15 0000000B !"]


@pytest.mark.parametrize(
    ("code", "baud_rate"),
    [(0, 9600), (1, 19200), (2, 38400), (3, 56000), (4, 115_200), (5, 128_000), (6, 230_400), (7, 256_000)],
)
def test_the_answer_to_a_baud_command_goes_at_the_old_rate(code, baud_rate):
    bench = Bench()
    assert bench.ask(b"W16%X0A\r" % code) == b"w 16 00000%X0A !\r\n" % code
    assert bench.device.line == LineFormat(baud_rate)
    if baud_rate != 230_400:
        assert b"r 15" not in bench.ask(b"R15\r")
        bench.wire.host = LineFormat(baud_rate)
        bench.ask(b"\r\r")  # ends what it heard of the wrong speed
    bench.wire.host = LineFormat(baud_rate)
    assert bench.ask(b"R15\r") == b"r 15 0000000B !\r\n"


def test_a_saved_baud_rate_is_the_one_after_a_reset():
    bench = Bench(faults=faults(Fault("reset", "qsb", 0.5)))
    bench.do(b"W1640A")
    bench.wire.host = LineFormat(115_200)
    bench.do(b"W163")
    assert b"QSB-D" in bench.run(1000)


def test_a_stuck_encoder_counts_no_more():
    bench = Bench(counts_s=10_000.0, faults=faults(Fault("stuck", "qsb", 0.3, 0.6)))
    bench.do(b"W15F", FREE_X4, b"W0C1")
    bench.send(b"S0E\r")
    bench.lines(160)
    assert len(set(data_of(bench.lines(250), "0E"))) == 1
    bench.lines(50)
    assert len(set(data_of(bench.lines(100), "0E"))) > 40


def test_a_fault_that_it_cannot_have_is_refused():
    with pytest.raises(FaultError, match="cannot have the fault saturated"):
        Bench(faults=faults(Fault("saturated", "qsb", 1.0)))


# What others send


def test_the_documented_sequence_for_synchronised_streaming():
    bench = Bench(counts_s=5000.0)
    assert bench.do(b"W15F", FREE_X4, b"W04000", b"W0B0", b"W0C1", b"W0D1", b"W02010") == [
        "w 15 0000000F 0000004C !",
        "w 03 00000003 0000004E !",
        "w 04 00000000 00000050 !",
        "w 0B 00000000 00000051 !",
        "w 0C 00000001 00000053 !",
        "w 0D 00000001 00000000 !",
        "w 02 00000010 00000001 !",
    ]
    for command in (b"S0E\r", b"S05\r", b"S01\r"):
        bench.send(command)
    for _ in range(4):
        bench.pulse(50)
        lines = bench.lines(227.5)
        assert len(data_of(lines, "05")) >= 1
        assert data_of(lines, "01")[-2:] == [0xF, 0xE]
        assert len(data_of(lines, "0E")) == pytest.approx(227.5 / 1.953, abs=3)
        assert all(len(line) == 24 and line.endswith(" !") for line in lines)


def test_the_manufacturers_demonstration():
    bench = Bench(counts_s=400.0)
    assert len(bench.ask(b"W155\n")) == 21  # its RESPONSE_LENGTH_WITH_TIMESTAMP
    for command in (b"W0B1", b"R14", b"W0000", b"W030C", b"W081F3", b"W092", b"W0C0", b"W0D1", b"S0E"):
        answer = bench.ask(command + b"\n", 3)
        assert len(answer) == 21
        assert answer[:1] == command[:1].lower()
        assert answer[1:3] == command[1:3]
        assert answer.endswith(b"!\n")
    counts = [int(line[3:11], 16) for line in bench.run(100).decode().splitlines()]
    assert counts == list(range(counts[0], counts[0] + len(counts)))
    assert len(counts) == 10  # W030C is non-quadrature: the pulses of A, a quarter of 400 Hz


def test_the_telescopes_reader():
    """Five fields, the register and the data as sent, eight digits of stamp; its count-down bug does not count down."""
    bench = Bench(counts_s=1000.0)
    for register, data in ((0x15, 0xF), (0x03, 3), (0x04, 0x80), (0x0B, 0), (0x0C, 1), (0x0D, 1)):
        fields = bench.ask(b"W%02X%08X\r\n" % (register, data), 3).decode().removesuffix("\r\n").split(" ")
        assert fields[:3] == ["w", f"{register:02X}", f"{data:08X}"]
        assert len(fields) == 5
        assert len(fields[3]) == 8
        assert fields[4] == "!"
    counts = data_of(bench.lines(0) + bench.ask(b"S0E\r\n", 500).decode().splitlines()[:-1], "0E")
    assert len(counts) > 250
    assert counts == sorted(counts)


@given(st.binary(max_size=120))
def test_any_bytes_are_survived(data):
    bench = Bench()
    bench.wire.host = LineFormat(230_400)
    bench.send(data + b"\rW161\rW15B\r")
    bench.run(60)
    bench.wire.host = bench.device.line
    bench.run(5)
    assert bench.ask(b"R14\r", 200).startswith(b"r 14 13FA600E !")


@given(
    st.lists(st.sampled_from([b"W0C", b"W0B", b"W15", b"W03", b"W04", b"W08", b"S0E", b"S06", b"R0E", b"W09", b"W0A"]))
)
def test_any_commands_are_each_answered_once(heads):
    bench = Bench(counts_s=3000.0)
    for head in heads:
        bench.ask(head + (b"" if head[:1] in b"RS" else b"1") + b"\r", 4)
    assert bench.device.commands == len(heads)


@pytest.mark.parametrize(("counting", "zero_count"), [(4, 0), (4, 1000), (2, 0), (4, -500)])
def test_a_mission_may_begin_away_from_the_joint_s_zero(counting, zero_count):
    """The adapter was set up at angle zero and the joint moved since; a restart loses that."""
    position = -12_345  # quarter cycles
    mode = {4: b"W0303", 2: b"W0302"}[counting]
    bench = Bench(angle=lambda _: (position + 0.25) * COUNT, zero_count=zero_count, counting=counting)
    bench.do(mode)
    expected = position * counting // 4 + zero_count
    [answer] = bench.do(b"R0E")
    assert int(answer.split()[2].strip("!"), 16) == expected & 0xFFFF_FFFF
    bench.device.restart(bench.now_ns)
    bench.run(150)
    bench.do(mode)
    [answer] = bench.do(b"R0E")
    assert int(answer.split()[2].strip("!"), 16) == 0
