"""Logs in segments: each whole by itself, together the flight; where a writer dies, another goes on."""

import contextlib
import errno
import os
import shutil

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from onboard.recording.format.errors import LogFormatError
from onboard.recording.format.scan import Scan
from onboard.recording.format.segments import flights, read_head, segment_path, segments
from onboard.recording.left import Progress
from onboard.recording.reader import LogReader
from onboard.recording.recorded import ChannelProgress
from onboard.recording.seal import seal
from onboard.recording.segmented import SEAL_AFTER_NS, SegmentedLog, SegmentLimits
from onboard.recording.writer import LogWriter
from tests.recording.logs import READING, FailingSink, label_rows, reading_rows, same_fields, write_small
from tests.recording.segment_bench import PREAMBLE, STEP_NS, Flight


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
    for size in [*range(0, len(files[used]), 997), len(files[used])]:
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
    "garbage", [b"", b"{", b"[1]", b"[1,1,2,3]", b'[1,1,2,{"a":[1]}]', b'[1,1,2,{"a":["x",2]}]', b"\xff"]
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
