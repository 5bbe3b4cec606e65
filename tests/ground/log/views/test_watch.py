"""The board of ``heft watch``: what it shows is what the rows say, from a log or from rings."""

import io

import numpy as np
import pytest
from rich.console import Console

from drivers import records
from drivers.records import Batch, Severity
from onboard import channels, cli
from onboard.cli import watch as watching
from onboard.estimation.gates import GateReason
from onboard.flight.store import manifest
from onboard.ground.log.views.watch import Board, trend
from onboard.ring import RingReader, RingWriter
from onboard.timebase.clock import ClockState
from tests.recording.logs import make_log

MS = 1_000_000
SECOND = 1000 * MS


def scalars(first, count, from_ms=0):
    rows = np.zeros(count, records.SCALAR)
    rows["sequence"] = np.arange(first, first + count)
    rows["host_ns"] = SECOND + (from_ms + np.arange(count) * 5) * MS
    return rows


def shown(board, width=110, **how):
    file = io.StringIO()
    Console(width=width, file=file, **how).print(board.render())
    return file.getvalue()


def line(board, name):
    return next(text.split() for text in shown(board).splitlines() if text.split()[:1] == [name])


def test_rates_are_those_of_the_last_two_seconds():
    board = Board("x")
    board.add(Batch("joint", scalars(0, 100)))
    board.add(Batch("joint", scalars(100, 400, 10_000)))
    assert line(board, "joint")[:3] == ["joint", "200", "500"]


def test_what_lay_in_a_ring_before_the_viewer_came_is_no_rate(tmp_path):
    writer = RingWriter(tmp_path / "joint.ring", records.SCALAR, 2400)
    writer.push(scalars(0, 2400))  # 12 s at 200 Hz
    board = Board("x")
    watching.look(board, tmp_path, {})
    assert line(board, "joint")[:3] == ["joint", "200", "2,160"]
    young = Board("x")
    young.add(Batch("joint", scalars(0, 101)))  # half a second
    assert line(young, "joint")[1] == "202"


@pytest.mark.parametrize("width", [80, 120, 200])
def test_a_reason_stands_once_and_cuts_no_name_and_no_number(width):
    board = Board("x")
    rows = np.zeros(12, channels.QUANTITY)
    names = [f"a_quantity_of_payload_{n}" for n in range(12)]
    rows["host_ns"], rows["sequence"], rows["name"], rows["unit"] = SECOND, np.arange(12), names, b"kg m^2"
    rows["value"], rows["low"], rows["high"] = 1.23456e-3, 1.2e-3, 1.3e-3
    rows["low_999"], rows["high_999"] = 1.1e-3, 1.4e-3
    rows["supported"][10:] = 1
    rows["level"][:10], rows["why"] = (
        2,
        b"no payload explains the motion; the gyro swings at 2 Hz: slosh, or a flexible joint",
    )
    for second in range(40):
        rows["host_ns"] = (second + 1) * SECOND
        board.add(Batch("quantity", rows.copy()))
    lines = shown(board, width).splitlines()
    table = [one for one in lines if one.startswith("a_quantity") and not {",", ":"} & set(one)]
    assert [one.split()[0] for one in table] == names
    assert all("do not use" in one for one in table[:10])
    assert all("0.00123456" in one and "5e-05" in one and "kg m^2" in one for one in table[10:])
    assert "…" not in "".join(lines)
    assert "".join(lines).replace(" ", "").count("nopayloadexplains") == 1


def test_missing_rows_are_loud_until_a_gap_record_names_them():
    board = Board("x")
    board.add(Batch("joint", scalars(0, 10)))
    board.add(Batch("joint", scalars(15, 10, 75)))
    assert line(board, "joint")[3] == "5"

    def style():
        table = board.channel_table()
        return str(next(iter(table.columns[3].cells)).style)

    assert "red" in style()
    board.add(records.gap(2 * SECOND, "joint", 10, 14, 0, "test"))
    assert "red" not in style()


def test_a_channel_that_went_quiet_is_marked():
    board = Board("x")
    board.add(Batch("joint", scalars(0, 100)))
    board.add(Batch("cell", scalars(0, 100, 10_000)))
    names = {str(cell): str(cell.style) for cell in board.channel_table().columns[0].cells}
    assert "red" in names["joint"]
    assert "red" not in names["cell"]


def test_clocks_gates_and_answers():
    board = Board("x")
    clock = np.zeros(1, channels.CLOCK)
    clock["host_ns"], clock["channel"], clock["state"], clock["period_ns"] = SECOND, b"imu", ClockState.FLYWHEEL, 1e6
    board.add(Batch("clock", clock))
    gate = np.zeros(4, channels.row_dtype(1, 1))
    gate["host_ns"], gate["sequence"] = SECOND, np.arange(4)
    gate["gate"][:, 0] = [0, 0, 0, GateReason.DRAG | GateReason.PHASE]
    board.add(Batch("row", gate))
    said = np.zeros(2, channels.QUANTITY)
    said["host_ns"], said["name"], said["unit"], said["sequence"] = SECOND, [b"m_arm", b"m_tip"], b"kg", [0, 1]
    said["value"], said["low"], said["high"], said["supported"] = 0.25, 0.22, 0.3, [1, 0]
    board.add(Batch("quantity", said))
    text = shown(board)
    for part in ("flywheel", "1000.00", "rows used 3 of 4", "75 %", "25 % drag", "25 % phase", " 0.05 ", "20.00 %"):
        assert part in text
    assert "not determined yet" in next(one for one in text.splitlines() if one.startswith("m_tip"))


@pytest.mark.parametrize("width", [80, 150])
def test_no_column_is_cut_in_a_narrow_terminal(width):
    board = Board("x")
    names = [b"a_load_cell_with_a_name", b"imu"]
    for name in names:
        clock = np.zeros(1, channels.CLOCK)
        clock["host_ns"], clock["channel"], clock["state"], clock["period_ns"] = SECOND, name, ClockState.LOCKED, 1e6
        clock["sigma_ns"], clock["residual_rms_ns"] = 12_340.0, 288_670.0
        board.add(Batch("clock", clock))
        board.add(Batch(name.decode(), scalars(0, 1_234_567)))
    lines = shown(board, width).splitlines()
    assert "…" not in "".join(lines)
    assert sum("1,234,567" in line for line in lines) == 2
    assert sum("288.67" in line for line in lines) == 2
    side_by_side = [line for line in lines if line.startswith("channel") and "resid us" in line]
    assert len(side_by_side) == (width == 150)
    [clocks] = [k for k, line in enumerate(lines) if "resid us" in line]
    assert side_by_side or not lines[clocks - 1].strip()  # each table under an empty line


def test_the_mode_stands_in_the_head():
    board = Board("x")
    for text in ("boot: the workers", "run: phase 3"):
        board.add(records.event(SECOND, Severity.INFO, "mode", "flight", text))
    assert "run" in shown(board).splitlines()[0]
    assert "boot" not in shown(board)


def test_what_is_said_cannot_steer_the_terminal():
    board = Board("x")
    board.add(records.event(SECOND, Severity.ERROR, "c\x1b[2J", "imu\x1b[31m", "said \x1b[31m so"))
    assert "\x1b" not in shown(board)
    assert "\\x1b[31m so" in shown(board)


@pytest.mark.parametrize(
    ("values", "text"), [([], ""), ([3.0], "▁"), ([8, 4, 2, 1], "█▆▃▁"), ([1, 1], "▁▁"), ([0.0, -1.0], "")]
)
def test_trend(values, text):
    assert trend(values) == text


def test_the_trend_has_always_the_whole_flight():
    board = Board("x")
    said = np.zeros(1, channels.QUANTITY)
    said["name"], said["unit"], said["supported"], said["value"] = b"m", b"kg", 1, 1.0
    for second in range(1000):
        said["host_ns"], said["sequence"], said["high"] = (second + 1) * SECOND, second, 1000.0 - second
        board.add(Batch("quantity", said.copy()))
    widths = board.answers["m"].widths
    assert widths[0] == 1000.0
    assert widths[-1] < 100.0
    assert len(widths) <= 32


def test_rings_as_they_turn_up(tmp_path):
    board = Board("x")
    rings: dict[object, RingReader] = {}
    writer = RingWriter(tmp_path / "joint.ring", records.SCALAR, 50)
    writer.push(scalars(0, 80))
    (tmp_path / "half.ring").write_bytes(b"")
    watching.look(board, tmp_path, rings)
    assert line(board, "joint")[2] == "45"
    assert board.lost == 0  # what was overrun before is not this viewer's loss
    writer.push(scalars(80, 70, 400))
    watching.look(board, tmp_path, rings)
    assert board.lost == 20
    assert "too slow for 20 rows" in shown(board)


def test_a_log_played_without_a_terminal_ends_with_the_board(tmp_path, capsys):
    make_log(tmp_path / "a.mcap", {"joint": scalars(0, 100)})
    assert cli.main(["watch", str(tmp_path / "a.mcap"), "--speed", "0"]) == cli.OK
    assert "joint" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["watch"], "Give a log to play, or --live"),
        (["watch", "a.mcap", "--live"], "Give a log to play, or --live"),
        (["watch", "a.mcap", "--speed", "-1"], "0 or more"),
        (["watch", "--live"], "no flight of yours is running"),
    ],
)
def test_nothing_to_watch(arguments, said, capsys, monkeypatch):
    monkeypatch.setattr(manifest, "running", list)
    assert cli.main(arguments) == cli.BAD_INPUT
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(("factor", "is_marked"), [(1.0, False), (1.3, True)])
def test_prediction_errors_of_the_last_two_seconds_stand_in_their_sigmas(factor, is_marked):
    rows = np.zeros(400, channels.INNOVATION)
    rows["sequence"], rows["host_ns"] = np.arange(400), SECOND + np.arange(400) * 10 * MS
    rows["sigma"] = 0.5
    rows["error"] = np.where(np.arange(400)[:, None] < 190, 50.0, 0.5 * np.where(np.arange(400) % 2, 1, -1)[:, None])
    rows["error"][:, 4] *= factor
    rows["sigma"][350] = np.nan
    board = Board("x")
    for at in range(0, 400, 10):
        board.add(Batch("innovation", rows[at : at + 10]))
    text = shown(board, 160)
    assert f"innovations over sigma: rate 1.00 1.00 1.00, specific force 1.00 {factor:.2f} 1.00" in text
    yellow = "\x1b[33minnovations over sigma"
    assert (yellow in shown(board, 160, force_terminal=True, color_system="standard")) == is_marked
    assert "innovations" not in shown(Board("x"), 160)
