"""The ring against a plain-list model, torn writes, overruns, and a writer that dies."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import records
from onboard.ring import RingFormatError, RingReader, RingWriter


def rows(first: int, count: int) -> records.Rows:
    made = np.zeros(count, records.IMU)
    made["sequence"] = np.arange(first, first + count)
    made["host_ns"] = made["sequence"] * 1000
    made["gyro_raw"] = np.arange(3) + np.arange(first, first + count)[:, None]
    return made


def test_a_reader_gets_every_row_in_order(tmp_path: Path) -> None:
    writer = RingWriter(tmp_path / "imu.ring", records.IMU, 16)
    reader = RingReader(tmp_path / "imu.ring")
    writer.push(rows(0, 5))
    writer.push(rows(5, 7))
    got, lost = reader.read()
    assert got.tobytes() == rows(0, 12).tobytes()
    assert lost == 0
    assert reader.name == "imu"
    assert reader.dtype == records.IMU


@settings(max_examples=200, deadline=None)
@given(
    steps=st.lists(st.tuples(st.sampled_from(["push", "read"]), st.integers(0, 25)), max_size=40),
    capacity=st.integers(1, 10),
)
def test_like_a_list_that_forgets(
    steps: list[tuple[str, int]], capacity: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("ring") / "r.ring"
    writer = RingWriter(path, records.IMU, capacity)
    reader = RingReader(path)
    pushed = read = 0
    for what, n in steps:
        if what == "push":
            assert writer.push(rows(pushed, n)) == pushed
            pushed += n
        else:
            got, lost = reader.read(limit=n)
            oldest = max(read, pushed - capacity)
            assert lost == oldest - read
            expected = list(range(oldest, min(pushed, oldest + n)))
            assert got["sequence"].tolist() == expected
            read = oldest + len(expected)
    assert reader.position == read


def test_rows_being_overwritten_are_lost_not_torn(tmp_path: Path) -> None:
    writer = RingWriter(tmp_path / "imu.ring", records.IMU, 8)
    reader = RingReader(tmp_path / "imu.ring")
    writer.push(rows(0, 8))
    writer.counters[0] = 11  # a writer in the middle of pushing three more
    got, lost = reader.read()
    assert got["sequence"].tolist() == [3, 4, 5, 6, 7]
    assert lost == 3


@pytest.mark.parametrize("byte", range(0, records.IMU.itemsize, 5))
def test_a_damaged_row_is_counted_and_not_handed_out(tmp_path: Path, byte: int) -> None:
    writer = RingWriter(tmp_path / "imu.ring", records.IMU, 8)
    writer.push(rows(0, 6))
    writer.data.view(np.uint8)[2, byte] ^= 0x10
    got, lost = RingReader(tmp_path / "imu.ring").read()
    assert got["sequence"].tolist() == [0, 1, 3, 4, 5]
    assert lost == 1


def test_a_new_writer_goes_on_where_the_old_one_died(tmp_path: Path) -> None:
    path = tmp_path / "imu.ring"
    script = (
        "import os, signal, sys; from pathlib import Path; import numpy as np; from drivers import records\n"
        "from onboard.ring import RingWriter\n"
        "w = RingWriter(Path(sys.argv[1]), records.IMU, 64); r = np.zeros(10, records.IMU); r['sequence'] = range(10)\n"
        "w.push(r); os.kill(os.getpid(), signal.SIGKILL)"
    )
    died = subprocess.run([sys.executable, "-c", script, str(path)], check=False)
    assert died.returncode == -signal.SIGKILL
    writer = RingWriter(path, records.IMU, 64)
    assert writer.published == 10
    writer.push(rows(10, 2))
    got, lost = RingReader(path).read()
    assert got["sequence"].tolist() == list(range(12))
    assert lost == 0


def test_a_ring_of_another_record_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.ring"
    RingWriter(path, records.IMU, 8)
    with pytest.raises(RingFormatError, match="another record or size"):
        RingWriter(path, records.IMU, 9)
    with pytest.raises(RingFormatError, match="pushed into a ring of"):
        RingWriter(path, records.IMU, 8).push(np.zeros(1, records.SCALAR))
    (tmp_path / "not.ring").write_bytes(os.urandom(8192))
    with pytest.raises(RingFormatError, match="not a ring"):
        RingReader(tmp_path / "not.ring")


@pytest.mark.parametrize("pushed", [0, 5, 8, 11, 20])
def test_a_reader_goes_on_after_a_number(tmp_path: Path, pushed: int) -> None:
    writer = RingWriter(tmp_path / "imu.ring", records.IMU, 8)
    for first in range(0, pushed, 3):
        writer.push(rows(10 + first, min(3, pushed - first)))
    held = list(range(10 + max(0, pushed - 8), 10 + pushed))
    for number in range(8, 12 + pushed):
        reader = RingReader(tmp_path / "imu.ring")
        whole = reader.seek_after(number)
        assert whole == (pushed <= 8 or number + 1 >= held[0])
        got, lost = reader.read()
        assert got["sequence"].tolist() == [n for n in held if n > number]
        assert lost == 0
        assert reader.backlog == 0


def test_it_goes_on_after_a_number_beside_damaged_rows_and_jumps(tmp_path: Path) -> None:
    writer = RingWriter(tmp_path / "imu.ring", records.IMU, 16)
    writer.push(rows(0, 5))
    writer.push(rows(9, 5))  # the device lost four
    writer.data[2] ^= 1
    writer.data[7] ^= 1  # number 11
    for number, following in ((1, [3, 4, 9]), (2, [3, 4, 9]), (4, [9, 10, 12]), (6, [9, 10, 12]), (11, [12, 13])):
        reader = RingReader(tmp_path / "imu.ring")
        assert reader.seek_after(number)
        got, _ = reader.read()
        assert got["sequence"].tolist()[:3] == following


def test_the_writer_that_takes_over_sees_what_there_is(tmp_path: Path) -> None:
    writer = RingWriter(tmp_path / "imu.ring", records.IMU, 8)
    assert len(writer.newest()) == 0
    writer.push(rows(0, 13))
    assert writer.newest()["sequence"].tolist() == list(range(5, 13))
