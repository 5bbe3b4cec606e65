"""Names of segments: any name of a log works, and a file of another origin that has one of them stays as it is."""

import pytest

from onboard.recording.format.segments import read_head, segments
from onboard.recording.left import Progress
from onboard.recording.reader import LogReader
from onboard.recording.segmented import Preamble, SegmentedLog
from tests.recording.logs import READING, reading_rows, write_small
from tests.recording.segment_bench import PREAMBLE, Flight


def test_a_log_is_never_begun_over_another(tmp_path):
    write_small(tmp_path / "a.mcap")
    with pytest.raises(FileExistsError):
        SegmentedLog(tmp_path / "a.mcap", PREAMBLE)


def test_neighbours_of_a_like_name_are_no_part(tmp_path):
    for name in ("run.mcap", "run_001.mcap"):
        write_small(tmp_path / name)
    flight = Flight(tmp_path / "flight.mcap")
    flight.steps(25)
    flight.writer.close()
    other = Flight(tmp_path / "other.mcap", PREAMBLE._replace(flight="f2"))
    other.steps(25)
    other.writer.close()
    (tmp_path / "other_001.mcap").rename(tmp_path / "flight_009.mcap")
    assert segments(tmp_path / "run.mcap") == (tmp_path / "run.mcap",)
    names = [path.name for path in segments(tmp_path / "flight.mcap")]
    assert "flight_009.mcap" not in names
    assert len(names) >= 2
    assert segments(tmp_path / names[1]) == (tmp_path / names[1],)


@pytest.mark.parametrize("name", ["run[1].mcap", "run[1]", "a*b?.mcap", "run_001.mcap", "{x}.mcap"])
def test_any_name_of_a_log_works(tmp_path, name):
    flight = Flight(tmp_path / name)
    flight.steps(25)
    flight.writer.abandon()
    again = Flight(tmp_path / name)
    assert again.writer.recorded["reading"].sequence == 24 * 40 - 1  # the last step was not synced
    again.writer.close()
    read = LogReader(tmp_path / name)
    assert len(read.segments) > 2
    assert len(read.read("reading")) == 24 * 40


def test_another_flights_log_is_not_gone_on_with(tmp_path):
    Flight(tmp_path / "flight.mcap").writer.close()
    before = (tmp_path / "flight.mcap").read_bytes()
    with pytest.raises(FileExistsError):
        Flight(tmp_path / "flight.mcap", Preamble("f2"))
    assert (tmp_path / "flight.mcap").read_bytes() == before


def other_flight(path, flight="other"):
    """A whole segment of another flight, with rows, and what is in it."""
    log = SegmentedLog(path, PREAMBLE._replace(flight=flight))
    log.register("reading", READING)
    log.write("reading", reading_rows(0, 40))
    log.close()
    return path.read_bytes()


def contents(paths):
    """Of those files that are there."""
    return [path.read_bytes() for path in paths if path.exists()]


@pytest.mark.parametrize("what", ["a flight's", "a log", "text", "nothing", "a dead link"])
def test_a_file_that_comes_to_the_name_of_the_next_segment_is_gone_past(tmp_path, what):
    flight = Flight(tmp_path / "a.mcap")
    flight.steps(1)
    names = [tmp_path / "a_001.mcap", tmp_path / "a_002.mcap"]  # of the one opened ahead, and of the one after it
    for path in names:
        path.unlink(missing_ok=True)
        if what == "a flight's":
            other_flight(path)
        elif what == "a log":
            write_small(path)
        elif what == "a dead link":
            path.symlink_to(tmp_path / "nowhere")
        else:
            path.write_bytes(b"mine" if what == "text" else b"")
    before = contents(names)
    flight.steps(44)
    flight.writer.abandon()  # it dies, and the next one takes over
    again = Flight(tmp_path / "a.mcap")
    assert again.writer.recorded["reading"].sequence >= 43 * 40
    again.number = again.writer.recorded["reading"].sequence + 1
    again.steps(45)
    again.writer.close()
    assert contents(names) == before
    log = LogReader(tmp_path / "a.mcap")
    assert log.read("reading")["sequence"].tolist() == list(range(again.number))
    ours = [path for path in log.segments if path not in names]
    assert len(ours) > 6
    assert [read_head(path).number for path in ours] == list(range(len(ours)))
    if what in ("a flight's", "a log"):  # a file without a head may be a damaged segment
        assert log.complete
        assert list(log.segments) == ours


@pytest.mark.parametrize("content", ["a flight's", "text"])
def test_a_recorder_that_takes_over_by_the_progress_of_the_one_before_leaves_others_alone(tmp_path, content):
    told = []
    flight = Flight(tmp_path / "a.mcap", told=told.append)
    flight.steps(25)
    flight.writer.abandon()
    ahead = tmp_path / f"a_{told[-1].place + 1:03d}.mcap"
    ahead.unlink()
    if content == "text":
        ahead.write_bytes(b"mine")
    else:
        SegmentedLog(ahead, PREAMBLE._replace(flight="f2")).close()  # no rows in it
    before = ahead.read_bytes()
    again = Flight(tmp_path / "a.mcap", progress=Progress.from_bytes(told[-1].to_bytes()))
    assert again.writer.recorded["reading"].sequence == 24 * 40 - 1
    again.number = 24 * 40
    again.steps(20)
    again.writer.close()
    assert ahead.read_bytes() == before
    assert len(LogReader(tmp_path / "a.mcap").read("reading")) == 44 * 40


def test_of_names_that_other_flights_left_the_free_ones_are_used(tmp_path):
    before = other_flight(tmp_path / "a_001.mcap")
    flight = Flight(tmp_path / "a.mcap")
    flight.steps(25)
    flight.writer.close()
    log = LogReader(tmp_path / "a.mcap")
    assert log.complete
    assert [path.name for path in log.segments[:2]] == ["a.mcap", "a_002.mcap"]
    assert len(log.read("reading")) == 25 * 40
    assert (tmp_path / "a_001.mcap").read_bytes() == before
