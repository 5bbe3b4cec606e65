"""Room on the disk: old flights make way, nothing else does, and events have room to the last."""

import os

import pytest

from onboard.recording.format.segments import segments
from onboard.recording.recorder import Recorder
from onboard.recording.segmented import Preamble, SegmentedLog, SegmentLimits
from onboard.recording.sink import FileSink, is_locked
from onboard.recording.space import MARGIN, SpaceGuard
from tests.recording.logs import READING, reading_rows, write_small

RESERVE = 1 << 20


def fly(log, flight, count=3):
    """A flight of at least ``count`` segments."""
    writer = SegmentedLog(log, Preamble(flight), limits=SegmentLimits(size=20_000), sync_interval_ns=0)
    writer.register("reading", READING)
    for n in range(count * 4):
        writer.write("reading", reading_rows(n * 100, 100))
        writer.sync(n)
    writer.close()
    return segments(log)


class Disk:
    """A disk of so many bytes, filled by the files in a directory."""

    def __init__(self, directory, size):
        self.directory, self.size, self.others = directory, size, 0

    def free(self, directory):
        assert directory == self.directory
        files = sum(path.stat().st_size for path in self.directory.rglob("*") if path.is_file())
        return self.size - self.others - files


@pytest.fixture
def disk(tmp_path):
    return Disk(tmp_path, 100_000_000)


def guard(disk, **options):
    options = {"min_free": 0, "reserve": 0} | options
    return SpaceGuard(disk.directory, disk.directory / "now.mcap", "now", free=disk.free, **options)


def test_the_oldest_segments_of_earlier_flights_make_way_and_no_more_than_needed(tmp_path, disk):
    old, newer = fly(tmp_path / "old", "f1"), fly(tmp_path / "newer.mcap", "f2")
    now = fly(tmp_path / "now.mcap", "now")
    for age, path in enumerate([*old, *newer, *now]):
        os.utime(path, (age, age))
    disk.size = disk.size - disk.free(tmp_path)  # full to the last byte
    freed = sum(path.stat().st_size for path in [*old, newer[0]])
    room = guard(disk, min_free=freed).look()
    assert room.removed == (*old, newer[0])
    assert not (tmp_path / "old").exists()
    assert all(path.exists() for path in [*newer[1:], *now])
    assert guard(disk, min_free=freed).look().removed == ()


def test_the_present_flight_never_makes_way_nor_what_is_no_flight_s(tmp_path, disk):
    now = fly(tmp_path / "now.mcap", "now")
    write_small(tmp_path / "imported.mcap")
    (tmp_path / "foreign.mcap").write_bytes(b"something else" * 100)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "a.mcap").write_bytes(b"x")
    before = sorted(tmp_path.rglob("*"))
    full = guard(disk, min_free=10**12)
    for _ in range(3):
        assert full.look().removed == ()
    assert sorted(tmp_path.rglob("*")) == before
    assert all(path.exists() for path in now)


def test_a_flight_that_somebody_else_is_writing_stays(tmp_path, disk):
    flying = fly(tmp_path / "other.mcap", "f9")
    over = fly(tmp_path / "over.mcap", "f8")
    flying[-1].unlink()
    writer = SegmentedLog.resume(tmp_path / "other.mcap", Preamble("f9"))
    assert set(guard(disk, min_free=10**12).look().removed) == set(over)
    writer.close()
    over = segments(tmp_path / "other.mcap")
    assert len(over) >= len(flying)
    assert set(guard(disk, min_free=10**12).look().removed) == set(over)


def test_files_are_locked_while_they_are_written(tmp_path):
    sink = FileSink(tmp_path / "a.mcap")
    assert is_locked(tmp_path / "a.mcap")
    sink.close()
    assert not is_locked(tmp_path / "a.mcap")


def test_the_ballast_is_given_up_when_the_disk_is_full_and_filled_when_there_is_room(tmp_path, disk):
    space = guard(disk, reserve=RESERVE)
    assert space.look().for_all
    [ballast] = tmp_path.glob("*.heft-reserve")
    assert ballast.stat().st_size == RESERVE
    assert ballast.stat().st_blocks * 512 >= RESERVE  # it takes the room, and is no hole
    disk.others = disk.size - RESERVE - MARGIN // 2
    assert not space.look().for_all
    assert not ballast.exists()
    assert not space.look().for_all  # the room that the ballast gave is for events
    disk.others = 0
    assert space.look().for_all
    assert ballast.exists()
    space.close()
    assert not ballast.exists()


def test_a_disk_that_says_it_is_full_is_believed(tmp_path, disk):
    space = guard(disk, reserve=RESERVE)
    assert space.look().for_all
    assert not space.look(refused=True).for_all
    assert list(tmp_path.iterdir()) == []
    assert space.look().for_all  # and asked again


def test_without_a_ballast_what_is_free_decides(disk):
    space = guard(disk)
    assert space.look().for_all
    disk.others = disk.size - MARGIN
    assert not space.look().for_all


def test_a_ballast_that_a_dead_flight_left_is_removed_and_a_living_one_s_is_not(tmp_path, disk):
    (tmp_path / "dead.mcap.heft-reserve").write_bytes(bytes(1000))
    living = SpaceGuard(tmp_path, tmp_path / "living.mcap", "f3", min_free=0, reserve=RESERVE, free=disk.free)
    living.look()
    assert [path.name for path in tmp_path.iterdir()] == ["living.mcap.heft-reserve"]
    guard(disk, reserve=RESERVE)
    assert [path.name for path in tmp_path.iterdir()] == ["living.mcap.heft-reserve"]
    living.close()


def lay(path, what):
    """Something in a place whose name can be foreseen."""
    if what == "pipe":
        os.mkfifo(path)
    elif what == "directory":
        path.mkdir()
    else:
        path.symlink_to("/nowhere")
    return path


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["other.mcap.heft-reserve", "now.mcap.heft-reserve"])
@pytest.mark.parametrize("what", ["pipe", "directory", "link"])
def test_what_lies_in_the_ballasts_place_stops_no_flight_and_is_told_by_name(tmp_path, disk, what, name):
    strange = lay(tmp_path / name, what)
    said = []
    writer = SegmentedLog(tmp_path / "now.mcap", Preamble("now"), sync_interval_ns=0)
    recorder = Recorder(writer, [], space=guard(disk, reserve=RESERVE), said=said.append)
    for second in range(1, 5):
        recorder.step(second * 10**9)
    recorder.close(5 * 10**9)
    assert [row["code"] for rows in said for row in rows] == [b"no_reserve_file"]
    assert said[0]["text"][0].decode().startswith(f"{name} is no reserve of a flight and is left as it is")
    assert os.path.lexists(strange)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("what", ["pipe", "directory", "link"])
def test_what_lies_among_the_segments_of_an_earlier_flight_is_not_waited_for(tmp_path, disk, what):
    old = fly(tmp_path / "old", "f1")
    lay(tmp_path / "old" / f"old_{len(old):03d}.mcap", what)
    lay(tmp_path / "pipe.mcap", what)
    assert guard(disk, min_free=10**12).look().removed == old


def test_a_log_is_of_this_user_alone(tmp_path):
    FileSink(tmp_path / "a.mcap").close()
    assert (tmp_path / "a.mcap").stat().st_mode & 0o777 == 0o600
