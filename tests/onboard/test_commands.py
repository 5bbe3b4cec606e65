"""What every command has: progress where it lasts, its answer as JSON."""

import io
import json
import math
import sys
import threading
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from rich.console import Group
from rich.table import Column, Table
from rich.text import Text

from onboard import cli
from onboard.cli import common, lines

ROOM = Path(cli.__file__).parent
PARTS = {"__init__", "__main__", "common", "controller", "lines", "messages"}
COMMANDS = sorted(path.stem for path in ROOM.glob("*.py") if path.stem not in PARTS)
FILES = {"dump", "fly", "report", "telemetry"}  # their answer is what they write; of fly and telemetry, --json-lines
AT_ONCE = {"completion", "init", "schema"}
LIVE = {"watch"}


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - AT_ONCE - LIVE))
def test_a_command_that_may_last_says_how_far_it_is(name: str) -> None:
    text = (ROOM / f"{name}.py").read_text(encoding="utf-8")
    assert "progress(" in text or "busy(" in text


def test_without_a_terminal_it_is_a_line_after_a_while_and_then_now_and_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(lines, "FIRST_S", 0.05)
    monkeypatch.setattr(lines, "EVERY_S", 0.05)
    said = io.StringIO()
    monkeypatch.setattr(sys, "stderr", said)
    with common.progress() as bar:
        task = bar.add_task("rocksat, seed 1", total=4)
        bar.update(task, completed=1)
        while said.getvalue().count("\n") < 3:  # nothing is updated meanwhile
            time.sleep(0.01)
    first, *_ = said.getvalue().splitlines()
    assert first == "heft: rocksat, seed 1: 25 %, 0 s so far"
    said.truncate(0)
    with common.busy("the estimator is built") as told:
        told("the devices run")
        while "\n" not in said.getvalue():
            time.sleep(0.01)
    assert said.getvalue().strip("\0").startswith("heft: the devices run: 0 s so far\n")


def test_of_several_it_is_of_the_last_that_is_not_done(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lines, "FIRST_S", 0.0)
    said = io.StringIO()
    monkeypatch.setattr(sys, "stderr", said)
    with common.progress(threads=False) as bar:
        bar.add_task("read rocksat.mcap", total=1000, completed=999)
        bar.update(bar.add_task("draw rocksat.html", total=None), completed=0)
    assert said.getvalue() == "heft: draw rocksat.html: 0 s so far\n"


def test_what_stands_beside_a_table_that_is_wider_than_the_terminal_is_not(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    table = Table(Column("number", justify="right"), box=None)
    table.add_row("1" * 90)
    common.show(Group(table, Text("so many words " * 10)))
    said = capsys.readouterr().out.splitlines()
    assert "1" * 90 in said[1]
    assert len(said) > 3
    assert max(len(line.rstrip()) for line in said[2:]) <= 80


def test_one_thread_is_kept_where_it_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fork server is forked from a process without threads; lines come with what is updated."""
    monkeypatch.setattr(lines, "FIRST_S", 0.0)
    said = io.StringIO()
    monkeypatch.setattr(sys, "stderr", said)
    threads = threading.active_count()
    with common.progress(threads=False) as bar:
        assert threading.active_count() == threads
        task = bar.add_task("flight", total=1.0)
        bar.update(task, completed=0.5)
        bar.update(task, completed=0.6)
    assert said.getvalue() == "heft: flight: 50 %, 0 s so far\n"


def test_what_is_done_at_once_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with common.progress() as bar:
        bar.update(bar.add_task("quick", total=1.0), completed=1.0)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - AT_ONCE - LIVE - FILES))
def test_a_command_that_answers_does_so_in_json_too(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    what = ["imu"] if name == "calibrate" else []
    with pytest.raises(SystemExit, match="0"):
        cli.main([name.removesuffix("_"), *what, "--help"])
    assert "--json FILE" in capsys.readouterr().out


def test_json_is_alone_on_stdout_and_says_null_of_what_is_no_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    class Answer(NamedTuple):
        mass_kg: float
        centre_m: np.ndarray
        path: Path

    answer = Answer(math.nan, np.array([0.5, math.inf]), Path("a/b"))
    common.write_json(tmp_path / "told.json", [answer, {"n": np.int64(3), "level": None}])
    told = json.loads((tmp_path / "told.json").read_text())
    assert told == [{"mass_kg": None, "centre_m": [0.5, None], "path": "a/b"}, {"n": 3, "level": None}]
    assert cli.main(["mechanics", "dymaflex", "--json", "-"]) == cli.OK
    said = capsys.readouterr()
    assert json.loads(said.out)["vehicle"] == "dymaflex"
    assert "virtual manipulator" in said.err


@pytest.mark.parametrize("name", ["flight.png", "flight.pdf", "flight"])
def test_a_report_is_a_page_and_nothing_else(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "flight.mcap"
    log.write_bytes(b"")
    assert cli.main(["report", str(log), "-o", str(tmp_path / name)]) == cli.BAD_INPUT
    assert "give -o FILE.html" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [log]
