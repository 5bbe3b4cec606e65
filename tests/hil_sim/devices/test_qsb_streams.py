"""Streams and captures of the QSB twin, and three command sequences that real QSBs have obeyed.

The sequences are the one of the adapter's documentation, the manufacturer's Linux demonstration, and the Thirty Meter
Telescope's reader, whose checks of each answer are repeated.
"""

from itertools import pairwise

import hypothesis.strategies as st
import pytest
from hypothesis import given

from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import Fault
from tests.hil_sim.devices.qsb_bench import COUNT, FREE_X4, Bench, data_of, faults, stamp_of
from tests.hil_sim.devices.twin_bench import MS, START_NS

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
