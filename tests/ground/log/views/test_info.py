"""What ``heft info`` says of a log: counts, rates, and above all whether every missing row is accounted for.

What ``heft info``, ``watch`` and ``report`` make of HEALTH records.
"""

import io
import itertools
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from drivers import records
from drivers.records import Batch, Severity
from onboard import channels, cli
from onboard.flight.health.status import Status
from onboard.ground.log.views import summary
from onboard.ground.log.views.health import HealthSummary
from onboard.ground.log.views.info import Continuity, common, count, info, render, union
from onboard.ground.log.views.watch import Board
from onboard.ground.report.flight.flight_data import gather
from onboard.ground.report.flight.health import health
from onboard.identification.standing import LEVELS, Standing
from onboard.recording.reader import LogReader
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
def failing(tmp_path, rows):
    path = tmp_path / "flight.mcap"
    with LogWriter.create(path) as writer:
        writer.register("health", channels.HEALTH)
        writer.register("health_stream", channels.HEALTH_STREAM)
        writer.write("health", rows)
    return path


def test_info_says_both_words_and_the_worst_second(failing, capsys):
    assert cli.main(["info", str(failing)]) == cli.OK
    said = " ".join(capsys.readouterr().out.split())
    assert "health: status ok (before: hot)" in said
    assert "acquisition 12.0;" in said
    assert "PSS at most 30 MB" in said
    assert "slowest stream 80 %" in said
    assert "temperature unknown" in said


def test_json_has_what_is_known_and_no_nan(failing, capsys):
    assert cli.main(["info", str(failing), "--json", "-"]) == cli.OK
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


def test_the_report_has_a_table(failing):
    page = health(gather(failing).health)
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


ranges = st.lists(st.tuples(st.integers(0, 40), st.integers(0, 6)).map(lambda t: (t[0], t[0] + t[1])), max_size=8)


def pulses(numbers, step_ns=10_000_000):
    rows = np.zeros(len(numbers), records.PULSE)
    rows["sequence"] = numbers
    rows["host_ns"] = np.asarray(numbers) * step_ns
    return rows


def as_ranges(pairs):
    return np.array(pairs, np.int64).reshape(-1, 2)


def as_set(pairs):
    return set().union(*(range(first, last + 1) for first, last in pairs))


@given(ranges, ranges)
def test_ranges_are_sets_of_numbers(a, b):
    joined = union(as_ranges(a))
    assert as_set(joined.tolist()) == as_set(a)
    assert count(joined) == len(as_set(a))
    assert all(first <= last for first, last in joined)
    assert all(end + 1 < start for (_, end), (start, _) in itertools.pairwise(joined))
    assert common(as_ranges(a), as_ranges(b)) == len(as_set(a) & as_set(b))


@given(st.sets(st.integers(0, 60), min_size=1), st.integers(1, 9))
def test_missing_numbers_are_found_however_the_rows_are_cut(numbers, size):
    ordered = sorted(numbers)
    seen = Continuity()
    for first in range(0, len(ordered), size):
        seen.add(pulses(ordered[first : first + size]))
    assert as_set(seen.missing.tolist()) == set(range(ordered[0], ordered[-1])) - numbers
    assert (seen.rows, seen.repeated) == (len(ordered), 0)


def test_repeats_and_restarts_are_counted():
    seen = Continuity()
    seen.add(pulses([0, 1, 1, 2]))
    seen.add(pulses([2, 0, 1]))
    assert seen.repeated == 3


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "flight.mcap"
    with LogWriter.create(path) as writer:
        writer.add_metadata("flight", {"vehicle": "rocksat", "host_machine": "aarch64"})
        writer.attach("vehicle.toml", "application/toml", b"x = 1\n")
        writer.register("pulse", records.PULSE)
        writer.register("late", records.PULSE)
        writer.register("joint", records.SCALAR)
        writer.register("driver_gap", records.GAP)
        writer.register("recorder_gap", records.GAP)
        writer.register("event", records.EVENT)
        writer.write("pulse", pulses([0, 1, 2, 3, 7, 8, 9, 12]))
        writer.write("late", pulses([5, 6, 7]))
        joint = np.zeros(4, records.SCALAR)
        joint["sequence"] = np.arange(4)
        joint["status"] = [0, 1, 0, 2]
        writer.write("joint", joint)
        writer.write("driver_gap", records.gap(1, "pulse", 4, 5, 0, "fifo_overflow").rows)
        writer.write("recorder_gap", records.gap(2, "pulse", 5, 6, 0, "ring_overrun").rows)
        writer.write("recorder_gap", records.gap(2, "late", 0, 4, 0, "ring_overrun").rows)
        writer.write("recorder_gap", records.gap(2, "late", 8, 9, 0, "ring_overrun", counted=True).rows)
        for n in range(15):
            severity = Severity.ERROR if n % 2 else Severity.INFO
            writer.write("event", records.event(n, severity, f"code_{n}", "test", "said \x1b[31m so").rows)
    return path


def test_what_is_missing_and_what_is_told(log):
    about = info(log)
    by_name = {channel.name: channel for channel in about.channels}
    pulse = by_name["pulse"]
    assert (pulse.record, pulse.rows, pulse.missing, pulse.gaps, pulse.unexplained) == ("Pulse", 8, 5, 3, 2)
    assert (pulse.first_sequence, pulse.last_sequence, pulse.repeated) == (0, 12, 0)
    assert pulse.rate_hz == pytest.approx(7 / 0.12)
    late = by_name["late"]
    assert (late.missing, late.gaps, late.unexplained) == (0, 7, 0)  # before the first row and after the last
    assert (late.about, pulse.about) == (5, 3)
    assert late.rows + late.gaps == 10
    assert by_name["joint"].flagged == 2
    assert by_name["joint"].rate_hz is None
    assert (about.exit_code, about.truncated, about.unexplained) == (0, False, 2)
    assert about.duration_s == pytest.approx(0.12)
    assert about.rows == 8 + 3 + 4 + 1 + 3 + 15


def test_events_are_counted_and_the_last_that_matter_shown(log):
    about = info(log)
    assert about.event_counts == {Severity.INFO: 8, Severity.ERROR: 7}
    assert [event.code for event in about.events] == [f"code_{n}" for n in range(3, 15, 2)]


def text_of(about, width=110):
    file = io.StringIO()
    Console(width=width, file=file).print(render(about))
    return file.getvalue()


def test_the_screen_shows_it(log):
    shown = text_of(info(log))
    assert len(shown.splitlines()) < 40
    for part in ("rocksat", "vehicle.toml (6 B)", "0.120 s", "7 error", "code_13", "2 rows are missing", "intact"):
        assert part in shown
    assert "\x1b" not in shown  # text in a log cannot steer the terminal


def test_it_says_which_gaps_are_about_and_when_which_mode_began(tmp_path):
    path = tmp_path / "flight.mcap"
    with LogWriter.create(path) as writer:
        for name, dtype in (("pulse", records.PULSE), ("gap", records.GAP), ("event", records.EVENT)):
            writer.register(name, dtype)
        writer.write("pulse", pulses([0, 1, 9, 10]))
        writer.write("gap", records.gap(1, "pulse", 2, 4, 0, "a", counted=True).rows)
        writer.write("gap", records.gap(1, "pulse", 4, 8, 0, "b").rows)
        for n, text in enumerate(("boot: x", "checkout: y\x1b[31m")):
            writer.write("event", records.event(n * 10**9, Severity.INFO, "mode", "flight", text).rows)
    found = info(path)
    [pulse] = [channel for channel in found.channels if channel.name == "pulse"]
    assert (pulse.missing, pulse.gaps, pulse.about, pulse.unexplained) == (7, 7, 4, 0)
    shown = text_of(found, 80)
    assert "about 7" in shown
    assert "modes" in shown
    assert "boot 0.0 s, checkout 1.0 s" in shown


def test_json_holds_what_the_screen_shows(log, capsys):
    assert cli.main(["info", str(log), "--json", "-"]) == cli.OK
    told = json.loads(capsys.readouterr().out)
    assert told["channels"][0]["name"] == "pulse"
    assert told["channels"][0]["missing"] == 5
    assert told["metadata"]["flight"]["host_machine"] == "aarch64"
    assert told["event_counts"] == {"0": 8, "2": 7}
    assert told["clocks"] == {}
    assert told["rows"] == {"total": 0, "used": 0, "refused": {}}


@pytest.mark.parametrize(
    ("level", "why", "units", "names"),
    [
        (2, "5% of the rows contradict the others", [b"", b""], "MX_arm, ZZ_arm"),  # base parameters, all refused
        (1, "not determined by the data so far", [b"kg", b""], "MX_arm"),  # nothing is answered
    ],
)
def test_answers_that_are_not_there_are_named_with_the_reason(tmp_path, level, why, units, names):
    rows = np.zeros(2, channels.QUANTITY)
    rows["name"], rows["unit"], rows["level"], rows["why"] = [b"MX_arm", b"ZZ_arm"], units, level, why.encode()
    rows["value"], rows["sequence"] = 1.25, [0, 1]
    with LogWriter.create(tmp_path / "flight.mcap") as writer:
        writer.register("quantity", channels.QUANTITY)
        writer.write("quantity", rows)
    seen = summary.summary(LogReader(tmp_path / "flight.mcap"))
    out = io.StringIO()
    Console(file=out, width=110).print(summary.render(seen))
    assert f"{names}: {Standing(LEVELS[level], why).text}" in out.getvalue()
    assert "1.25" not in out.getvalue()


def test_a_log_without_clocks_has_nothing_to_plot(log, tmp_path, capsys):
    assert cli.main(["info", str(log), "--clocks", str(tmp_path / "clocks.png")]) == cli.BAD_INPUT
    assert "has no clock" in capsys.readouterr().err
    assert not (tmp_path / "clocks.png").exists()


def test_a_cut_log_says_so(log):
    log.write_bytes(log.read_bytes()[:-200])
    about = info(log)
    assert (about.exit_code, about.truncated) == (3, True)
    assert "not closed" in text_of(about) or "incomplete" in text_of(about)
    assert "whole" not in text_of(about)


def test_an_empty_log(tmp_path):
    LogWriter.create(tmp_path / "a.mcap").close()
    about = info(tmp_path / "a.mcap")
    assert (about.rows, about.duration_s, about.channels) == (0, 0.0, ())
    assert "0 rows" in text_of(about)
