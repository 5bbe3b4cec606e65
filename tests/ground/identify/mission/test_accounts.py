"""Accounts of a rehearsal: what is in no gap record is named by channel, number and time."""

from pathlib import Path

import numpy as np
import pytest

from drivers import records
from onboard.ground.identify.mission.accounts import Account, Seen, render
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter

START_NS = 5_000_000_000
PERIOD_NS = 5_000_000


def written(path: Path, numbers: list[int], *gaps: tuple[int, int, bool], cause: str = "test") -> Account:
    """The account of 200 samples, of which ``numbers`` were recorded; gaps: first, last, counted."""
    rows = np.zeros(len(numbers), records.SCALAR)
    rows["sequence"] = numbers
    rows["host_ns"] = START_NS + PERIOD_NS * np.array(numbers)
    with LogWriter.create(path) as writer:
        writer.register("joint", records.SCALAR)
        writer.register("gap", records.GAP)
        writer.write("joint", rows)
        for first, last, counted in gaps:
            end_ns, span_ns = START_NS + PERIOD_NS * (last + 1), PERIOD_NS * (last + 1 - first)
            writer.write("gap", records.gap(end_ns, "joint", first, last, span_ns, cause, counted=counted).rows)
            writer.write("gap", records.gap(end_ns, "tick", first, last, span_ns, "of no device").rows)
    seen = Seen({"joint": 200}, START_NS)
    for batch in LogReader(path).batches():
        seen.see(batch)
    return seen.accounts()["joint"]


def but(first: int, last: int) -> list[int]:
    return [n for n in range(200) if not first <= n <= last]


def test_a_loss_without_a_gap_is_named_with_its_number_and_time(tmp_path: Path) -> None:
    account = written(tmp_path / "log.mcap", but(100, 104))
    assert (account.left, account.is_whole) == (5, False)
    assert [tuple(span) for span in account.silent] == [(0.495, 0.525)]
    (line,) = render({"joint": account})
    assert line.startswith("SAMPLES UNACCOUNTED FOR: joint: 200 made, 195 recorded, 0 in gap records: 5 in no gap")
    assert "0.495 to 0.525 s" in line
    assert account.as_json()["unaccounted"] == 5


def test_the_pause_of_a_gap_is_not_where_the_rest_was_lost(tmp_path: Path) -> None:
    lost = [n for n in but(20, 29) if n not in (150, 151, 152)]
    account = written(tmp_path / "log.mcap", lost, (20, 29, True))
    assert (account.left, account.is_whole) == (3, False)
    assert [span.from_s for span in account.silent] == [0.745]


@pytest.mark.parametrize(
    ("named", "counted", "is_whole"),
    [
        ((100, 109), True, True),
        ((100, 108), True, False),
        ((100, 110), True, False),
        ((100, 110), False, True),  # one more than was lost, and said to be about
        ((100, 107), False, True),  # two fewer
        ((100, 106), False, False),
    ],
)
def test_counted_gaps_are_exact_and_estimated_ones_nearly(
    tmp_path: Path, named: tuple[int, int], counted: bool, is_whole: bool
) -> None:
    account = written(tmp_path / "log.mcap", but(100, 109), (*named, counted))
    assert account.is_whole is is_whole
    assert account.about == (0 if counted else named[1] - named[0] + 1)
    (line,) = render({"joint": account})
    assert ("about" in line) is (not counted and is_whole)


@pytest.mark.parametrize(("last", "is_whole"), [(96, True), (94, False)])
def test_of_many_samples_an_estimate_may_miss_two_and_two_in_a_hundred(
    tmp_path: Path, last: int, is_whole: bool
) -> None:
    assert written(tmp_path / "log.mcap", but(0, 99), (0, last, False)).is_whole is is_whole


@pytest.mark.parametrize(("cause", "is_whole"), [("test", False), ("changes_unheard", True)])
def test_changes_that_nobody_heard_may_be_any_number(tmp_path: Path, cause: str, is_whole: bool) -> None:
    account = written(tmp_path / "log.mcap", but(0, 99), (0, 0, False), cause=cause)
    assert (account.left, account.is_whole) == (99, is_whole)


def test_a_channel_without_a_row_is_said_to_have_none(tmp_path: Path) -> None:
    account = written(tmp_path / "log.mcap", [])
    assert render({"joint": account}) == [
        "SAMPLES UNACCOUNTED FOR: joint: 200 made, 0 recorded, 0 in gap records: 200 in no gap record, no row"
    ]
