"""Power cuts: after every single write and sync of a flight, with un-synced writes lost in random subsets.

Disks that are cut off from power, with every file on them: what was synced is there, of the rest any part.
"""

from pathlib import Path

import pytest

from onboard.recording.format.segments import segments
from onboard.recording.reader import LogReader
from onboard.recording.segmented import Preamble, SegmentedLog, SegmentLimits
from tests.recording.logs import LABEL, READING, label_rows, reading_rows, same_fields


class PowerCutDisk:
    """Files whose every write and sync is remembered; the medium can be had as of any of these.

    A file's creation is durable at once: ``FileSink`` syncs the directory, as a test of its own says.
    """

    SECTOR = 512

    def __init__(self):
        self.history = []  # (what, path, offset, data)

    def open(self, path):
        self.history.append(("create", Path(path), 0, b""))
        return _Sink(self, Path(path))

    def after_power_cut(self, operations, rng):
        """The files after the first ``operations`` and a power cut: content by path."""
        safe, loose = {}, {}
        for what, path, offset, data in self.history[:operations]:
            if what == "create":
                safe[path], loose[path] = b"", []
            elif what == "write":
                loose[path].append((offset, data))
            else:
                safe[path], loose[path] = _written(safe[path], loose[path]), []
        return {path: self._medium(content, loose[path], rng) for path, content in safe.items()}

    def _medium(self, safe, loose, rng):
        """Any subset of the sectors that were not synced, zeros or no file end elsewhere."""
        image = bytearray(safe)
        for offset, data in loose:
            for sector in range(0, len(data), self.SECTOR):
                if rng.integers(2):
                    part = data[sector : sector + self.SECTOR]
                    image = bytearray(_written(image, [(offset + sector, part)]))
        return bytes(image)


def _written(content, writes):
    image = bytearray(content)
    for offset, data in writes:
        image.extend(bytes(max(0, offset + len(data) - len(image))))
        image[offset : offset + len(data)] = data
    return bytes(image)


class _Sink:
    def __init__(self, disk, path):
        self._disk, self._path = disk, path
        path.touch(exist_ok=False)

    def write_at(self, offset, data):
        self._disk.history.append(("write", self._path, offset, bytes(data)))

    def sync(self):
        self._disk.history.append(("sync", self._path, 0, b""))

    def taken(self):
        return None

    def close(self):
        pass


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


@pytest.mark.parametrize(
    "name", [pytest.param("flight.mcap", marks=pytest.mark.campaign), "flight"]
)  # of segments that are beside others: test_segments
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
