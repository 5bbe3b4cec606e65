"""Power cuts: after every single write and sync of a flight, with un-synced writes lost in random subsets."""

import pytest

from onboard.recording.format.segments import segments
from onboard.recording.reader import LogReader
from onboard.recording.segmented import Preamble, SegmentedLog, SegmentLimits
from tests.recording.disks import PowerCutDisk
from tests.recording.logs import LABEL, READING, label_rows, reading_rows, same_fields

STEP_NS = 50_000_000
OLDEST_NS = 200_000_000
STEPS = 70


def fly(log, rng):
    """A flight of several segments; the disk, and after how many operations how many rows are promised."""
    disk = PowerCutDisk()
    writer = SegmentedLog(
        log,
        Preamble("f1", (), {"flight": {"vehicle": "x"}}),
        limits=SegmentLimits(span_ns=20 * STEP_NS),
        sync_interval_ns=OLDEST_NS - STEP_NS,
        open_sink=disk.open,
    )
    writer.register("reading", READING)
    writer.register("label", LABEL)
    number, promised, safe, oldest_ns = 0, [], 0, 0
    for step in range(STEPS):
        now_ns = step * STEP_NS
        count = int(rng.integers(1, 60))
        writer.write("reading", reading_rows(number, count))
        writer.write("label", label_rows(number, count))
        number += count
        synced = writer.sync(now_ns)
        if synced:
            safe, oldest_ns = number, now_ns
        assert now_ns + STEP_NS - oldest_ns <= OLDEST_NS  # until the next step, nothing un-synced is older
        promised.append((len(disk.history), safe))
    return disk, promised, number


def lay_out(files, directory):
    """The files of a medium, in a directory of their own, in the order of the flight."""
    directory.mkdir()
    for path, content in files.items():
        (directory / path.name).write_bytes(content)
    return [directory / path.name for path in files]


@pytest.mark.parametrize("name", ["flight.mcap", "flight"])
def test_everything_before_the_last_sync_reads_back_from_every_prefix(tmp_path, rng, name):
    disk, promised, total = fly(tmp_path / name, rng)
    assert len({path for _, path, *_ in disk.history}) > 3
    assert promised[-1][1] > 1000
    seen = set()
    for operations in range(1, len(disk.history) + 1):
        safe = max((rows for after, rows in promised if after <= operations), default=0)
        paths = lay_out(disk.after_power_cut(operations, rng), tmp_path / f"cut{operations}")
        try:
            log = LogReader(paths)
        except ValueError:  # the first file's magic had not been synced
            assert safe == 0
            continue
        if "reading" not in log.channels:
            assert safe == 0
            continue
        for channel, made in (("reading", reading_rows), ("label", label_rows)):
            rows = log.read(channel)
            got = rows["sequence"].astype(int)
            assert same_fields(rows, made(0, total)[got])
            assert len(set(got.tolist())) == len(got)
            assert set(range(safe)) <= set(got.tolist())
        seen.add(safe)
    assert len(seen) > 10


def test_a_flight_goes_on_after_a_power_cut_anywhere(tmp_path, rng):
    """A second flight computer boot: the log is taken over, and numbers go on after the last that survived."""
    disk, promised, total = fly(tmp_path / "flight.mcap", rng)
    for operations in range(5, len(disk.history), 17):
        directory = tmp_path / f"cut{operations}"
        lay_out(disk.after_power_cut(operations, rng), directory)
        log = directory / "flight.mcap"
        before = LogReader(segments(log)) if log.read_bytes()[:8] else None
        kept = before.read("reading")["sequence"].tolist() if before and "reading" in before.channels else []
        writer = SegmentedLog.resume(log, Preamble("f1"))
        following = max(kept, default=-1) + 1
        assert writer.recorded["reading"].sequence + 1 == following if kept else "reading" not in writer.recorded
        writer.register("reading", READING)
        writer.write("reading", reading_rows(following, 100))
        writer.close()
        after = LogReader(log)
        assert after.read("reading")["sequence"].tolist() == [*kept, *range(following, following + 100)]
        safe = max((rows for done, rows in promised if done <= operations), default=0)
        assert following >= safe
    assert total > safe > 1000
