"""What ``heft info``, ``watch`` and ``report`` make of HEALTH records."""

import io
import json

import numpy as np
import pytest
from rich.console import Console

from drivers.records import Batch
from onboard import channels, cli
from onboard.flight.health.status import Status
from onboard.ground.log.views.health import HealthSummary
from onboard.ground.log.views.watch import Board
from onboard.ground.report.flight.flight_data import gather
from onboard.ground.report.flight.health import health
from onboard.recording.writer import LogWriter


@pytest.fixture
def rows():
    made = np.zeros(3, channels.HEALTH)
    made["sequence"], made["host_ns"] = range(3), np.arange(3) * 1_000_000_000
    for name in made.dtype.names or ():
        if made.dtype[name].kind == "f":
            made[name] = np.nan
    made["status_word"] = [0, int(Status.HOT), 0]
    made["status_latched"] = [0, int(Status.HOT), int(Status.HOT)]
    made["acquisition_cpu_percent"], made["recording_pss_mb"] = [np.nan, 10.0, 14.0], 30.0
    made["slowest_percent"], made["throttled"], made["computer_idle_percent"] = [99.0, 80.0, 99.5], -1, 50.0
    return made


@pytest.fixture
def log(tmp_path, rows):
    path = tmp_path / "flight.mcap"
    with LogWriter.create(path) as writer:
        writer.register("health", channels.HEALTH)
        writer.register("health_stream", channels.HEALTH_STREAM)
        writer.write("health", rows)
    return path


def test_info_says_both_words_and_the_worst_second(log, capsys):
    assert cli.main(["info", str(log)]) == cli.OK
    said = " ".join(capsys.readouterr().out.split())
    assert "health: status ok (before: hot)" in said
    assert "acquisition 12.0;" in said
    assert "PSS at most 30 MB" in said
    assert "slowest stream 80 %" in said
    assert "temperature unknown" in said


def test_json_has_what_is_known_and_no_nan(log, capsys):
    assert cli.main(["info", str(log), "--json", "-"]) == cli.OK
    told = json.loads(capsys.readouterr().out)["health"]
    assert (told["status"], told["latched"], told["records"]) == ("ok", "hot", 3)
    assert told["fields"]["acquisition_cpu_percent"] == {"least": 10.0, "mean": 12.0, "most": 14.0}
    assert "temperature_deg_c" not in told["fields"]
    assert "throttled" not in told["fields"]


def test_a_log_without_health_says_nothing(tmp_path, capsys):
    path = tmp_path / "old.mcap"
    with LogWriter.create(path) as writer:
        writer.register("health", channels.QUANTITY)  # of that name, and another record
        writer.write("health", np.zeros(1, channels.QUANTITY))
    assert cli.main(["info", str(path), "--json", "-"]) == cli.OK
    assert json.loads(capsys.readouterr().out)["health"] is None
    assert HealthSummary().lines() == []


def test_the_report_has_a_table(log):
    page = health(gather(log).health)
    assert "Last second: ok. At any time: hot." in page
    assert "unknown" in page


def test_the_board_shows_the_last_second(rows):
    board = Board("flight")
    shown = []
    for row in rows:
        board.add(Batch("health", rows[rows["sequence"] == row["sequence"]]))
        file = io.StringIO()
        Console(width=80, file=file).print(board.render())
        shown.append(file.getvalue())
    assert "status ok\n" in "\n".join(line.rstrip() for line in shown[0].splitlines())
    assert "status hot" in shown[1]
    assert "status ok (before: hot)" in shown[2]
    assert "CPU 14 % of a core, 30 MB, computer 50 % idle, temperature unknown" in shown[2]
