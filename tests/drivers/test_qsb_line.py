"""QSB lines and commands: the manufacturer's bytes, any feeding, any bytes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import FrameError
from drivers.qsb import LineStream, QsbConfig, SyncEdges, setup_commands
from drivers.qsb.counter import TickCounter
from drivers.qsb.registers import greeting_commands
from tests.drivers.serial_script import bytewise, fed, pieces, whole

LINE = b"s 0E 0001F4A2 00001234 !\r\n"  # QSB Command List, response format with EOR = F


def numbers(lines):
    """(kind, register, data, stamp) of each line."""
    columns = lines.kind.tolist(), lines.register.tolist(), lines.data.tolist(), lines.stamp.tolist()
    return [(chr(kind), *rest) for kind, *rest in zip(*columns, strict=True)]


def test_the_manufacturers_line():
    assert len(LINE) == 26
    other = b"w 0d ffffffff ABCDEF01 !\r\n"
    lines, errors = fed(LineStream(), LINE + other, whole(LINE + other))
    assert [numbers(one) for one in lines] == [
        [("s", 0x0E, 0x1F4A2, 0x1234)],
        [("w", 0x0D, 0xFFFFFFFF, 0xABCDEF01)],
    ]
    assert lines[0].stamped
    assert errors == []


FORMATS = {  # EOR bits: 1 LF, 2 CR, 4 timestamp, 8 spaces
    0x0: b"s0E0001F4A2!",
    0x1: b"s0E0001F4A2!\n",
    0x2: b"s0E0001F4A2!\r",
    0x3: b"s0E0001F4A2!\r\n",
    0x4: b"s0E0001F4A200001234!",
    0x5: b"s0E0001F4A200001234!\n",
    0x7: b"s0E0001F4A200001234!\r\n",
    0x8: b"s 0E 0001F4A2 !",
    0xB: b"s 0E 0001F4A2 !\r\n",
    0xC: b"s 0E 0001F4A2 00001234 !",
    0xD: b"s 0E 0001F4A2 00001234 !\n",
    0xF: LINE,
}


@pytest.mark.parametrize("feed", [whole, lambda _: bytewise()], ids=["whole", "bytewise"])
@pytest.mark.parametrize("eor", FORMATS)
def test_every_format_of_a_line_is_read(eor, feed):
    data = 3 * FORMATS[eor]
    taken, errors = fed(LineStream(), data, feed(data))
    lines = [line for piece in taken for line in numbers(piece)]
    assert lines == [("s", 0x0E, 0x1F4A2, 0x1234 if eor & 4 else 0)] * 3
    assert {piece.stamped for piece in taken} == {bool(eor & 4)}
    assert errors == []


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (b"QSB-D  0E!\r\n", ("Q", 0, 0x0E, 0)),
        (b"QSB-S 0A!", ("Q", 0, 0x0A, 0)),
        (b"\x00\xffQSB-D  0E!\r\n", ("Q", 0, 0x0E, 0)),
        (b"e 0E 00000005 00001234 !\r\n", ("e", 0x0E, 5, 0x1234)),
        (b"e0E00000005!\r\n", ("e", 0x0E, 5, 0)),
        (b"x 2A !\r\n", ("x", 0x2A, 0, 0)),
        (b"x2A!", ("x", 0x2A, 0, 0)),
    ],
)
def test_greetings_and_complaints_are_read(data, line):
    taken, errors = fed(LineStream(), data, bytewise())
    assert [numbers(piece) for piece in taken] == [[line]]
    assert errors == []


@pytest.mark.parametrize(
    "bad",
    [
        LINE.replace(b" ", b"_"),
        b"q" + LINE[1:],
        LINE.replace(b"A2", b"G2"),
        LINE.replace(b"!", b"?"),
        b" " * 26,
    ],
)
def test_what_is_no_line_between_lines_is_none(bad):
    data = LINE + bad + LINE
    taken, errors = fed(LineStream(), data, whole(data))
    assert [line for piece in taken for line in numbers(piece)] == [("s", 0x0E, 0x1F4A2, 0x1234)] * 2
    assert len(errors) == 1


RUN = [b"s 0E %08X %08X !\r\n" % (1000 + 7 * n, n) for n in range(300)]
WANTED = [("s", 0x0E, 1000 + 7 * n, n) for n in range(300)]
FEEDS = {"whole": whole, "bytewise": lambda _: bytewise(), "pieces": lambda _: pieces(5)}


@pytest.mark.parametrize("feed", FEEDS.values(), ids=FEEDS)
@pytest.mark.parametrize(("before", "told"), [(b"", 0), (b"\r\n", 0), (LINE[9:], 1), (b"\xff\x00", 1), (b"!", 1)])
@pytest.mark.parametrize("after", [b"", LINE[:13]])
def test_fed_any_way_the_same_comes_out(feed, before, told, after):
    data = before + b"".join(RUN) + after
    taken, errors = fed(LineStream(), data, feed(data))
    assert [line for piece in taken for line in numbers(piece)] == WANTED
    assert len(errors) == told


@pytest.mark.parametrize("at", range(26))
def test_a_lost_byte_costs_one_line_at_most(at):
    data = b"".join([*RUN[:50], RUN[50][:at] + RUN[50][at + 1 :], *RUN[51:]])
    taken, errors = fed(LineStream(), data, whole(data))
    lines = [line for piece in taken for line in numbers(piece)]
    assert [line for line in lines if line != WANTED[50]] == WANTED[:50] + WANTED[51:]
    assert len(errors) == (WANTED[50] not in lines)


def test_a_broken_stream_forgets_its_half_line():
    stream = LineStream()
    stream.receive(LINE[:9])
    stream.clear()
    stream.receive(LINE[9:] + LINE)
    with pytest.raises(FrameError):
        stream.take()
    assert numbers(stream.take()) == [("s", 0x0E, 0x1F4A2, 0x1234)]


def test_bytes_without_an_end_are_thrown_away():
    noise = b"\x55" * 200
    taken, errors = fed(LineStream(), noise + b"!" + LINE, pieces(3))
    assert [numbers(piece) for piece in taken] == [[("s", 0x0E, 0x1F4A2, 0x1234)]]
    assert len(errors) == 4
    assert "without the '!'" in errors[0]


@given(st.lists(st.binary(max_size=90) | st.sampled_from([LINE, LINE[3:], b"!", b"\r\n", b"QSB-D  0E!"]), max_size=12))
def test_any_bytes_give_lines_nothing_or_frame_error(chunks):
    stream = LineStream()
    for chunk in chunks:
        taken, _ = fed(stream, chunk, whole(chunk))
        assert all(len(lines.kind) == len(lines.stamp) > 0 for lines in taken)
        assert len(stream.waiting) < 64


@given(st.binary(max_size=100))
def test_a_line_after_any_junk_that_ends_is_found(junk):
    data = junk + b"!\r\n" + LINE
    taken, _ = fed(LineStream(), data, bytewise())
    assert numbers(taken[-1])[-1] == ("s", 0x0E, 0x1F4A2, 0x1234)


# Commands


def test_the_setting_up_is_the_manuals():
    assert [command.text for command in greeting_commands()] == ["W161", "W15F", "R14"]
    assert [command.text for command in setup_commands(QsbConfig())] == [
        *("W000", "W0303", "W04000", "W0B0", "W0C1", "W0D1", "W02010", "R05", "R01", "S05", "S01", "S0E")
    ]
    config = QsbConfig(counting=1, count_down=True, interval_ticks=300, sync_edge=None)
    assert [command.text for command in setup_commands(config, clear_timestamp=False)] == [
        *("W000", "W0301", "W04100", "W0B0", "W0C12C", "S0E")
    ]
    assert "W02011" in [command.text for command in setup_commands(QsbConfig(sync_edge="falling"))]


# Edges

CAPTURE, DIGIO = 5, 1


def test_two_lines_of_an_edge_are_one_mark_in_either_order():
    edges = SyncEdges()
    edges.preset(CAPTURE, 100)
    edges.preset(DIGIO, 0xE)
    edges.line(CAPTURE, 150, 1000, 11)
    edges.line(DIGIO, 0xF, 1001, 12)
    edges.line(DIGIO, 0xE, 1001, 12)
    assert edges.take(1002) == []
    assert edges.take(1003) == [(1000, 11, 150)]
    edges.line(DIGIO, 0xF, 1100, 13)
    edges.line(CAPTURE, 190, 1100, 13)
    assert edges.take(1103) == [(1100, 13, 190)]
    assert edges.take() == []


def test_a_joint_that_stands_still_makes_marks_with_the_same_count():
    edges = SyncEdges()
    edges.preset(CAPTURE, 100)
    for tick in (1000, 1100):
        edges.line(DIGIO, 0xF, tick, tick)
        edges.line(DIGIO, 0xE, tick + 1, tick)
    assert edges.take() == [(1000, 1000, 100), (1100, 1100, 100)]


def test_falling_edges_and_lines_that_are_no_edge():
    edges = SyncEdges(rising=False)
    edges.preset(DIGIO, 0xF)
    edges.preset(CAPTURE, 7)
    edges.line(CAPTURE, 7, 5, 5)  # the answer to S05
    edges.line(DIGIO, 0xF, 6, 6)  # another input changed
    edges.line(DIGIO, 0xD, 7, 7)  # bit 0 still high
    assert edges.take() == []
    edges.line(DIGIO, 0xE, 8, 8)
    assert edges.take() == [(8, 8, 7)]
    edges.line(0x06, 1, 9, 9)
    assert edges.take() == []


# Timestamps


def ticks(counter, stamps, host_ns):
    placed = counter.place(np.array(stamps, np.uint32), host_ns)
    return placed.ticks.tolist(), placed.jump


def test_the_timestamp_is_unwrapped_over_its_rollover():
    counter = TickCounter()
    start = 2**32 - 3
    assert ticks(counter, [start, start + 1, start - 1, start + 2], 10**9) == (
        [start, start + 1, start - 1, start + 2],
        None,
    )
    assert ticks(counter, [0, 5], 2 * 10**9) == ([2**32, 2**32 + 5], None)
    assert counter.runs_on(5 + 512, 3 * 10**9)
    assert not counter.runs_on(5 + 5120, 3 * 10**9)
    assert not counter.runs_on(0, 60 * 10**9)
    counter.restart()
    assert not counter.runs_on(5 + 512, 3 * 10**9)


@pytest.mark.parametrize("tick_ns", [1_900_000, 1_953_125])
@pytest.mark.parametrize("days", [1, 94, 200])
def test_it_runs_on_over_an_outage_of_days(tick_ns, days):
    counter = TickCounter()
    ticks(counter, [100], 10**9)
    away_ns = days * 86_400 * 10**9
    stamp = (100 + away_ns // tick_ns) % 2**32
    assert counter.runs_on(stamp, 10**9 + away_ns) == (days * 86_400 * 10**9 // tick_ns < 2**32)


def test_a_timestamp_that_began_anew_or_jumped_is_seen():
    counter = TickCounter()
    ticks(counter, [5000], 10**9)
    assert ticks(counter, [5001, 5002, 3, 4], 10**9 + 8_000_000) == ([5001, 5002, 3, 4], 2)
    assert ticks(counter, [5, 100_000], 10**9 + 16_000_000) == ([5, 100_000], 1)
    assert ticks(counter, [100_001], 10**9 + 18_000_000) == ([100_001], None)
