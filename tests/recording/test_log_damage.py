"""A log that something happened to: cut at every byte, a bit flipped at every byte, un-synced writes lost."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.recording.format.errors import LogFormatError
from onboard.recording.format.scan import Damage
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.recording import logs


def read(path, data):
    """Rows by channel, and the log, of a file with ``data`` as its content."""
    logs.overwrite(path, data)
    log = LogReader(path)
    rows = {"reading": [], "label": []}
    for batch in log.batches():
        rows[batch.channel].append(batch.rows)
    dtypes = {"reading": logs.READING, "label": logs.LABEL}
    return {name: np.concatenate([np.empty(0, dtypes[name]), *parts]) for name, parts in rows.items()}, log


def rows_by_chunk(path, data, places):
    """What each chunk holds: the log is read with all the other chunks' CRC spoilt."""
    held = []
    for start, _ in places:
        alone = bytearray(data)
        for other, _ in places:
            if other != start:
                alone[other + 9 + 24] ^= 0xFF
        rows, _ = read(path, bytes(alone))
        held.append({name: set(part["sequence"].tolist()) for name, part in rows.items()})
    return held


def all_good(rows):
    """Every row that came back is one that was written."""
    assert logs.same_fields(rows["reading"], logs.reading_rows(0, logs.SMALL)[rows["reading"]["sequence"].astype(int)])
    assert logs.same_fields(rows["label"], logs.label_rows(0, logs.SMALL)[rows["label"]["sequence"].astype(int)])


@pytest.mark.parametrize("step", [19, pytest.param(1, marks=pytest.mark.campaign)])
def test_cut_at_every_byte_it_is_read_to_the_last_whole_chunk(tmp_path, step):
    data = logs.write_small(tmp_path / "least.mcap", logs.LEAST).read_bytes()
    places = logs.chunk_places(data)
    assert len(places) > 3
    held = rows_by_chunk(tmp_path / "alone.mcap", data, places)
    path = tmp_path / "cut.mcap"
    for size in range(0, len(data), step):
        rows, log = read(path, data[:size])
        whole = sum(end <= size for _, end in places)
        for name, part in rows.items():
            assert set(part["sequence"].tolist()) == set().union(*(chunk[name] for chunk in held[:whole]))
        all_good(rows)
        assert log.truncated
        assert log.exit_code == 3
        assert len(log.damage) == 1
        assert log.damage[-1].end == size


def test_a_flipped_bit_in_a_chunk_costs_that_chunk_and_no_name(tmp_path, small, rng):
    data = small.read_bytes()
    places = logs.chunk_places(data)
    held = rows_by_chunk(tmp_path / "alone.mcap", data, places)
    assert sum(len(chunk["reading"]) for chunk in held) == logs.SMALL
    path = tmp_path / "flipped.mcap"
    for number, (start, end) in enumerate(places):
        # every byte of what frames the records, and some of the records
        for at in [*range(start, start + 9 + 40), *rng.integers(start + 49, end, 25).tolist()]:
            flipped = bytearray(data)
            flipped[at] ^= 1 << int(rng.integers(8))
            rows, log = read(path, bytes(flipped))
            all_good(rows)
            others = [chunk for n, chunk in enumerate(held) if n != number]
            for name, part in rows.items():
                assert set(part["sequence"].tolist()) >= set().union(*(chunk[name] for chunk in others)), at - start
            assert list(log.channels) == ["reading", "label"]
            assert list(log.attachments) == ["vehicle.toml", "late.bin"]
            assert len(log.metadata) == 2
            assert log.damage
            assert not log.truncated
            if not 9 <= at - start < 25:  # but for the two times, which no CRC protects, the chunk is lost, by name
                assert any(damage.start == start and damage.end >= end for damage in log.damage)
                assert set(rows["reading"]["sequence"].tolist()) == set().union(*(chunk["reading"] for chunk in others))


@pytest.mark.parametrize("step", [19, pytest.param(1, marks=pytest.mark.campaign)])
def test_a_flipped_bit_anywhere_is_noticed_and_takes_at_most_a_chunk(tmp_path, rng, step):
    data = logs.write_small(tmp_path / "least.mcap", logs.LEAST).read_bytes()
    places = logs.chunk_places(data)
    held = rows_by_chunk(tmp_path / "alone.mcap", data, places)
    largest = max(len(chunk["reading"]) for chunk in held)
    path = tmp_path / "flipped.mcap"
    for at in range(0, len(data), step):
        flipped = bytearray(data)
        flipped[at] ^= 1 << int(rng.integers(8))
        rows, log = read(path, bytes(flipped))
        all_good(rows)
        assert log.exit_code == 3, at
        assert len(rows["reading"]) >= logs.LEAST - largest, at


def test_bytes_put_in_or_taken_out_cost_one_chunk(tmp_path, small, rng):
    data = small.read_bytes()
    places = logs.chunk_places(data)
    path = tmp_path / "shifted.mcap"
    assert len(places) > 3
    largest = max(len(chunk["reading"]) for chunk in rows_by_chunk(path, data, places))
    for start, end in places:
        at = int(rng.integers(start, end))
        for shifted in (data[:at] + rng.bytes(37) + data[at:], data[:at] + data[min(at + 21, end) :]):
            rows, log = read(path, shifted)
            all_good(rows)
            assert len(rows["reading"]) >= logs.SMALL - largest
            assert log.exit_code == 3


def test_a_hole_of_zeros_costs_what_it_covers(tmp_path, small):
    """What a disk leaves that lost the middle of the file."""
    data = bytearray(small.read_bytes())
    places = logs.chunk_places(bytes(data))
    held = rows_by_chunk(tmp_path / "alone.mcap", bytes(data), places)
    first, last = places[3][0] + 50, places[6][0] + 50
    data[first:last] = bytes(last - first)
    rows, log = read(tmp_path / "hole.mcap", bytes(data))
    all_good(rows)
    expected = set().union(*(chunk["reading"] for n, chunk in enumerate(held) if not 3 <= n <= 6))
    assert set(rows["reading"]["sequence"].tolist()) == expected
    assert [damage.start for damage in log.damage][:1] == [places[3][0]]


def test_nothing_but_noise_between_two_chunks(tmp_path, small, rng):
    data = small.read_bytes()
    places = logs.chunk_places(data)
    noise = bytes(rng.choice(np.array([0, 6, 9, 12, 15], np.uint8), 200_000))  # full of what looks like a record
    rows, log = read(tmp_path / "noise.mcap", data[: places[4][0]] + noise + data[places[4][0] :])
    all_good(rows)
    assert len(rows["reading"]) == logs.SMALL
    assert log.damage[0] == Damage(places[4][0], places[4][0] + len(noise), log.damage[0].reason)


def test_what_only_looks_like_metadata_is_not_taken_for_it(tmp_path, small):
    """A small number followed by zeros, as rows are full of, has the lengths of metadata without name and content."""
    data = small.read_bytes()
    start = logs.chunk_places(data)[4][0]
    junk = b"\xff" * 40 + b"\x0c\x08" + bytes(15) + b"\xff" * 40
    rows, log = read(tmp_path / "junk.mcap", data[:start] + junk + data[start:])
    assert len(rows["reading"]) == logs.SMALL
    assert set(log.metadata) == {"host", "end"}
    assert (log.damage[0].start, log.damage[0].end) == (start, start + len(junk))


def test_an_attached_log_is_not_taken_for_part_of_the_log(tmp_path, small):
    inner = small.read_bytes()
    path = tmp_path / "outer.mcap"
    with LogWriter.create(path) as writer:
        writer.register("reading", logs.READING)
        writer.attach("inner.mcap", "application/mcap", inner)
        writer.write("reading", logs.reading_rows(1000, 10))
    data = bytearray(path.read_bytes())
    assert LogReader(path).read("reading")["sequence"].tolist() == list(range(1000, 1010))
    data[data.index(inner) + 200] ^= 4
    path.write_bytes(data)
    log = LogReader(path)
    assert log.read("reading")["sequence"].tolist() == list(range(1000, 1010))
    assert log.attachments == {}
    assert "attachment CRC" in log.damage[0].reason


def test_junk_behind_the_end_is_noticed(tmp_path, small):
    rows, log = read(tmp_path / "junk.mcap", small.read_bytes() + b"junk")
    assert len(rows["reading"]) == logs.SMALL
    assert log.exit_code == 3


def test_a_log_without_magic_is_read_if_a_chunk_proves_it(tmp_path, small):
    data = small.read_bytes()
    rows, log = read(tmp_path / "headless.mcap", bytes(8) + data[8:])
    assert len(rows["reading"]) == logs.SMALL
    assert "magic" in log.damage[0].reason
    with pytest.raises(LogFormatError):
        read(tmp_path / "nothing.mcap", bytes(8) + data[8:40])


@pytest.fixture(scope="module")
def module_log(tmp_path_factory):
    return logs.write_small(tmp_path_factory.mktemp("fuzz") / "small.mcap")


edits = st.lists(
    st.tuples(st.integers(0, 2**16), st.integers(0, 60), st.binary(max_size=60) | st.just(bytes(30))), max_size=6
)


@settings(max_examples=120)
@given(edits)
def test_whatever_is_done_to_it_what_comes_back_was_written(module_log, edits):
    data = module_log.read_bytes()
    for at, taken, put in edits:
        place = at % (len(data) + 1)
        data = data[:place] + put + data[place + taken :]
    try:
        rows, log = read(module_log.with_name("edited.mcap"), data)
    except LogFormatError:
        assert not data.startswith(b"\x89MCAP0\r\n")
        return
    all_good(rows)
    assert log.exit_code == (0 if data == module_log.read_bytes() else 3)


def test_a_log_of_no_bytes_is_empty_and_not_one_that_was_not_closed(tmp_path):
    (tmp_path / "none.mcap").touch()
    log = LogReader(tmp_path / "none.mcap")
    assert list(log.batches()) == []
    [damage] = log.damage
    assert "the log is empty" in str(damage)
    assert "not closed" not in str(damage)
