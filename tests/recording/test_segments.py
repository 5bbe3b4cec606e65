"""Logs in segments: each whole by itself, together the flight; where a writer dies, another goes on."""

import contextlib
import errno
import os
import shutil

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from onboard.recording.format.errors import LogFormatError
from onboard.recording.format.mcap_format import Attachment
from onboard.recording.format.scan import Scan
from onboard.recording.format.segments import flights, read_head, segment_path, segments
from onboard.recording.left import Progress
from onboard.recording.reader import LogReader
from onboard.recording.recorded import ChannelProgress
from onboard.recording.seal import seal
from onboard.recording.segmented import SEAL_AFTER_NS, Preamble, SegmentedLog, SegmentLimits
from onboard.recording.writer import LogWriter
from tests.recording.logs import LABEL, READING, FailingSink, label_rows, reading_rows, same_fields, write_small

STEP_NS = 50_000_000
PREAMBLE = Preamble(
    "f1",
    (Attachment("vehicle.toml", "application/toml", b'name = "x"\n', 0),),
    {"flight": {"vehicle": "x"}, "versions": {"heft": "1"}},
)


class Flight:
    """Writes 40 rows a step of 50 ms; a segment lasts 10 steps."""

    def __init__(self, log, preamble=PREAMBLE, **options):
        self.writer = SegmentedLog.resume(log, preamble, limits=SegmentLimits(span_ns=10 * STEP_NS), **options)
        self.writer.register("reading", READING)
        self.writer.register("label", LABEL)
        self.now_ns = self.number = 0

    def steps(self, count):
        for _ in range(count):
            self.writer.write("reading", reading_rows(self.number, 40))
            self.writer.write("label", label_rows(self.number, 40))
            self.number += 40
            self.writer.sync(self.now_ns)
            self.now_ns += STEP_NS


@pytest.mark.parametrize("name", ["flight.mcap", "flight"])
def test_each_segment_is_whole_and_says_everything(tmp_path, name):
    log = tmp_path / name
    flight = Flight(log)
    flight.steps(45)
    flight.writer.close()
    found = segments(log)
    assert [path.name for path in found] == [
        *(["flight.mcap"] if log.suffix else ["flight_000.mcap"]),
        *(f"flight_{n:03d}.mcap" for n in range(1, len(found))),
    ]
    assert len(found) >= 4
    seen = []
    for number, path in enumerate(found):
        alone = LogReader([path])
        assert alone.complete
        assert alone.attachments["vehicle.toml"].data == b'name = "x"\n'
        assert alone.metadata["flight"] == {"vehicle": "x"}
        assert alone.metadata["segment"] == {"flight": "f1", "number": str(number)}
        rows = alone.read("reading")
        assert len(rows) <= 40 * 14
        if number:
            assert alone.metadata["recorded"]["reading"].split()[0] == str(seen[-1])
        seen += rows["sequence"].tolist()
        with path.open("rb") as file:
            stock = list(make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["reading"]))
        assert [message.sequence for *_, message in stock] == rows["sequence"].tolist()
    assert seen == list(range(45 * 40))
    together = LogReader(log)
    assert together.complete
    assert same_fields(together.read("reading"), reading_rows(0, 45 * 40))
    assert same_fields(together.read("label"), label_rows(0, 45 * 40))
    assert together.segments == found
    assert together.size == together.position == sum(path.stat().st_size for path in found)


def test_a_segment_is_full_by_size_too(tmp_path):
    writer = SegmentedLog(tmp_path / "a.mcap", PREAMBLE, limits=SegmentLimits(size=50_000), sync_interval_ns=0)
    writer.register("reading", READING)
    for n in range(40):
        writer.write("reading", reading_rows(n * 100, 100))
        writer.sync(n)
    writer.close()
    sizes = [path.stat().st_size for path in segments(tmp_path / "a.mcap")]
    assert len(sizes) > 3
    assert all(40_000 < size < 70_000 for size in sizes[:-1])
    assert LogReader(tmp_path / "a.mcap").read("reading")["sequence"].tolist() == list(range(4000))


def test_the_next_segment_is_there_before_it_is_needed_and_gone_when_it_was_not(tmp_path):
    flight = Flight(tmp_path / "a.mcap")
    flight.steps(5)
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a.mcap", "a_001.mcap"]
    running = LogReader(tmp_path / "a.mcap")
    assert [damage.file for damage in running.damage] == ["a.mcap"]  # the one opened ahead is no damage
    flight.writer.close()
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_a_disk_that_refuses_the_next_segment_keeps_the_present_one(tmp_path):
    refuse = [False]
    sinks = []

    def open_sink(path):
        if refuse[0]:
            raise OSError(errno.ENOSPC, "refused")
        sinks.append(FailingSink(path))
        path.touch()
        return sinks[-1]

    flight = Flight(tmp_path / "a.mcap", open_sink=open_sink)
    refuse[0] = True
    flight.steps(60)
    assert len(sinks) == 1
    refuse[0] = False
    flight.steps(40)
    assert len(sinks) > 2
    flight.writer.close()
    assert LogReader(tmp_path / "a.mcap").read("reading")["sequence"].tolist() == list(range(100 * 40))


@pytest.mark.parametrize("operation", ["refuse_writes", "refuse_syncs"])
def test_a_disk_that_refuses_while_a_segment_is_ended_loses_nothing(tmp_path, operation):
    """At every step around the change of segments, for a while."""
    for at in range(6, 16):
        sinks = []

        def open_sink(path, sinks=sinks):
            path.touch()
            sinks.append(FailingSink(path))
            return sinks[-1]

        log = tmp_path / f"{operation}{at}.mcap"
        flight = Flight(log, open_sink=open_sink)
        flight.steps(at)
        for sink in sinks:
            setattr(sink, operation, errno.EIO)
        for _ in range(8):
            try:
                flight.steps(1)
            except OSError as error:
                assert error.errno == errno.EIO  # noqa: PT017
                flight.now_ns += STEP_NS
        for sink in sinks:
            setattr(sink, operation, 0)
        flight.steps(20)
        flight.writer.close()
        rows = LogReader(log).read("reading")
        assert rows["sequence"].tolist() == list(range(flight.number))
        assert LogReader(log).complete


@pytest.mark.parametrize(
    ("name", "ago"),
    [
        ("flight.mcap", None),
        pytest.param("flight", None, marks=pytest.mark.campaign),
        ("flight", 1),
        pytest.param("flight", 6, marks=pytest.mark.campaign),
    ],
)
def test_taken_over_at_every_byte_it_goes_on_after_the_last_row_that_was_written(tmp_path, name, ago):
    """As ``kill -9`` leaves it: every file as far as it was written, the last one cut anywhere.

    With the progress of the last sync, or of one ``ago``, which the files need not reach.
    """
    log = tmp_path / "whole" / name
    told = []
    flight = Flight(log, told=lambda progress: told.append(progress.to_bytes()))
    flight.steps(31)
    progress = None if ago is None else Progress.from_bytes(told[-ago])
    beyond = 0
    files = {path: path.read_bytes() for path in (log.parent if log.suffix else log).iterdir()}
    flight.writer.abandon()
    found = [segment_path(log, number) for number in range(len(files))]
    used, ahead = found[-2], found[-1]
    assert len(found) > 3
    for size in [*range(0, len(files[used]), 487), len(files[used])]:
        again = tmp_path / str(size) / name
        for path in found:
            copy = again.parent / path.relative_to(log.parent)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(files[path][:size] if path == used else files[path])
        if size % 2:
            (again.parent / ahead.relative_to(log.parent)).write_bytes(files[ahead][: size % 23])
        beyond += progress is not None and progress.number == len(found) - 2 and size >= progress.offset
        second = SegmentedLog.resume(again, PREAMBLE, progress=progress)
        last = second.recorded["reading"].sequence
        assert second.recorded["reading"] == ChannelProgress(last, last * 1000)
        second.register("reading", READING)
        second.write("reading", reading_rows(last + 1, 60))
        second.sync(0)
        second.close()
        read = LogReader(again)
        assert read.complete, size
        assert same_fields(read.read("reading"), reading_rows(0, last + 61))
        shutil.rmtree(again.parent)
    assert beyond > 0 or ago != 1


def test_what_a_dead_recorder_left_is_sealed_once_the_rings_have_been_read(tmp_path):
    told = []
    flight = Flight(tmp_path / "a.mcap", told=told.append)
    flight.steps(5)
    flight.writer.abandon()
    [used, _] = segments(tmp_path / "a.mcap")
    second = Flight(tmp_path / "a.mcap", progress=told[-1])
    while Scan(used).truncated and second.now_ns < 2 * SEAL_AFTER_NS:
        second.steps(1)
    assert SEAL_AFTER_NS < second.now_ns < SEAL_AFTER_NS + 12 * STEP_NS
    second.writer.close()
    assert LogReader([used]).complete


def test_recorders_that_die_one_after_the_other_leave_nothing_open(tmp_path):
    told = []
    for _ in range(6):
        flight = Flight(tmp_path / "a.mcap", told=told.append, progress=told[-1] if told else None)
        flight.steps(5)
        flight.writer.abandon()
    last = Flight(tmp_path / "a.mcap", progress=told[-1])
    last.steps(1)
    last.writer.close()
    found = segments(tmp_path / "a.mcap")
    assert len(found) == 7
    assert not any(Scan(path).truncated for path in found)


def test_a_last_segment_that_tells_nothing_is_no_reason_to_forget(tmp_path):
    """One that was opened ahead, and ended by whoever found it, has neither rows nor how far the flight was."""
    flight = Flight(tmp_path / "a.mcap")
    flight.steps(31)
    flight.writer.abandon()
    *_, used, ahead = segments(tmp_path / "a.mcap")
    assert "recorded" in LogReader([used]).metadata
    assert seal(ahead) == (False, True)
    writer = SegmentedLog.resume(tmp_path / "a.mcap", PREAMBLE)
    last = int(LogReader(tmp_path / "a.mcap").read("reading")["sequence"][-1])
    assert writer.recorded["reading"].sequence == last > 31 * 40 - 200
    writer.close()


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


def test_what_a_command_line_gives_is_grouped_by_flight(tmp_path):
    for name, number in (("a", 1), ("b.mcap", 2)):
        flight = Flight(tmp_path / name, PREAMBLE._replace(flight=f"f{number}"))
        flight.steps(25)
        flight.writer.close()
    write_small(tmp_path / "single.mcap")
    a, b = segments(tmp_path / "a"), segments(tmp_path / "b.mcap")
    assert min(len(a), len(b)) >= 2
    assert flights([tmp_path / "a", tmp_path / "b.mcap", tmp_path / "single.mcap"]) == [
        a,
        b,
        (tmp_path / "single.mcap",),
    ]
    assert flights([a[1], b[0], a[0]]) == [a[:2], b]
    assert flights([a[1]]) == [(a[1],)]


def test_a_directory_that_is_no_flight_says_so(tmp_path):
    write_small(tmp_path / "single.mcap")
    with pytest.raises(LogFormatError, match="not the directory of a flight"):
        LogReader(tmp_path)


def test_the_head_of_a_log_without_segments(tmp_path):
    LogWriter.create(tmp_path / "a.mcap").close()
    assert read_head(tmp_path / "a.mcap")[:2] == ("heft", {})


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


def test_damage_names_its_file(tmp_path):
    flight = Flight(tmp_path / "a.mcap")
    flight.steps(25)
    flight.writer.close()
    second = segments(tmp_path / "a.mcap")[1]
    data = bytearray(second.read_bytes())
    data[len(data) // 2] ^= 1
    second.write_bytes(data)
    log = LogReader(tmp_path / "a.mcap")
    assert {damage.file for damage in log.damage} == {second.name}
    assert str(log.damage[0]).startswith(f"{second.name}: bytes ")
    assert log.exit_code == 3


@pytest.mark.parametrize(
    "garbage", [b"", b"{", b"[1]", b"[1,2,3]", b'[1,2,{"a":[1]}]', b'[1,2,{"a":["x",2]}]', b"\xff"]
)
def test_progress_that_is_none_is_refused(garbage):
    assert Progress.from_bytes(garbage) is None


@pytest.mark.parametrize("with_progress", [False, True])
def test_a_takeover_that_is_itself_killed_at_any_write_forgets_nothing(tmp_path, monkeypatch, with_progress):
    """Killed between any two calls to the kernel, over and over; the next always knows how far the log is."""

    class KilledError(Exception):
        """What stands for SIGKILL."""

    calls = [0]

    def mortal(name):
        real = getattr(os, name)

        def call(*arguments, **options):
            if not calls[0]:
                raise KilledError
            calls[0] -= 1
            return real(*arguments, **options)

        return call

    told = []
    flight = Flight(tmp_path / "a.mcap", told=told.append)
    flight.steps(25)
    progress = told[-1] if with_progress else None
    flight.writer.abandon()
    rows = LogReader(tmp_path / "a.mcap").read("reading")
    for name in ("pwrite", "fsync", "unlink", "open"):
        monkeypatch.setattr(os, name, mortal(name))
    for patience in [*range(60), 10_000]:
        calls[0] = patience
        with contextlib.suppress(KilledError):
            writer = SegmentedLog.resume(tmp_path / "a.mcap", PREAMBLE, progress=progress)
            calls[0] = 10_000
            assert writer.recorded["reading"] == ChannelProgress(len(rows) - 1, (len(rows) - 1) * 1000), patience
            writer.abandon()
        calls[0] = 10_000
    assert same_fields(LogReader(tmp_path / "a.mcap").read("reading"), rows)


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
