"""Flights with segments missing, altered, exchanged or crafted: named, never a traceback, never called whole."""

import os
import random
import struct

import numpy as np
import pytest

from drivers import records
from onboard import cli, config
from onboard.recording.format import mcap_format
from onboard.recording.format.mcap_format import RECORD_HEAD, Chunk
from onboard.recording.format.scan import Scan, ScannedRecord
from onboard.recording.reader import LogReader
from onboard.recording.segmented import Preamble, SegmentedLog, SegmentLimits
from onboard.recording.writer import LogWriter

STEP_NS = 50_000_000
ROWS = 45 * 40
FACTS = {"flight": {"vehicle": "x", "wall_clock_ns": "1565611200000000000", "monotonic_ns": "0"}}


def scalars(first, count):
    rows = np.zeros(count, records.SCALAR)
    rows["sequence"] = rows["tick"] = range(first, first + count)
    rows["host_ns"] = (first + np.arange(count)) * 1_000_000
    rows["scale"], rows["unit"] = 1e-3, b"N"
    return rows


def write(path, flight, facts=FACTS):
    """Two channels of 40 rows a step, 10 steps a segment."""
    log = SegmentedLog(
        path, Preamble(flight, (), facts), limits=SegmentLimits(span_ns=10 * STEP_NS), sync_interval_ns=0
    )
    for name in ("a", "b"):
        log.register(name, records.SCALAR)
    for step in range(ROWS // 40):
        for name in ("a", "b"):
            log.write(name, scalars(40 * step, 40))
        log.sync(step * STEP_NS)
    log.close()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The segments of a flight, by name."""
    place = tmp_path_factory.mktemp("whole")
    write(place / "x.mcap", "f1")
    return {path.name: path.read_bytes() for path in sorted(place.iterdir())}


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    place = tmp_path_factory.mktemp("other")
    write(place / "x.mcap", "f2")
    return {path.name: path.read_bytes() for path in sorted(place.iterdir())}


def lay(place, files):
    place.mkdir(exist_ok=True)
    for name, data in files.items():
        (place / name).write_bytes(data)
    return place / "x.mcap"


def test_a_flight_that_ended_in_order_says_so(tmp_path, whole):
    log = LogReader(lay(tmp_path, whole))
    assert len(whole) == len(log.segments) == 5
    assert log.complete
    assert log.metadata["flight_end"] == {"flight": "f1", "segments": "5"}
    assert log.metadata["recorded"].keys() == {"a", "b"}


EACH_NUMBER = pytest.mark.parametrize(
    "number", [0, 1, *(pytest.param(one, marks=pytest.mark.campaign) for one in (2, 3)), 4]
)  # between others, as the second


@pytest.mark.parametrize("harm", ["delete", "zero", "empty", "noise"])
@EACH_NUMBER
def test_a_segment_that_is_gone_is_named_with_what_it_held(tmp_path, whole, capsys, harm, number):
    name = sorted(whole)[number]
    files = dict(whole)
    rows = LogReader([lay(tmp_path / "whole", whole).with_name(name)]).read("a")
    if harm == "delete":
        del files[name]
    else:
        size = len(files[name])
        files[name] = {"zero": bytes(size), "empty": b"", "noise": random.Random(1).randbytes(size)}[harm]
    log = lay(tmp_path / "log", files)
    read = LogReader(log)
    assert read.exit_code == cli.DAMAGED
    said = "\n".join(map(str, read.damage))
    assert f"segment {number} " in said or name in said
    if number < 4 and harm != "empty":
        assert f"held {2 * len(rows)} rows" in said
        assert f"a {rows['sequence'][0]} to {rows['sequence'][-1]}" in said
    assert cli.main(["info", str(log)]) == cli.DAMAGED
    recovered = tmp_path / "recovered.mcap"
    assert cli.main(["recover", str(log), "-o", str(recovered)]) == cli.DAMAGED
    assert "lossless" not in capsys.readouterr().out
    assert len(LogReader(recovered).read("a")) == ROWS - len(rows)
    gaps = LogReader(recovered).read("recover_gap")
    if number < 4:
        assert [(int(g["first_missing"]), int(g["last_missing"])) for g in gaps] == [
            (int(rows["sequence"][0]), int(rows["sequence"][-1]))
        ] * 2


@EACH_NUMBER
def test_recordings_joined_in_turn_tell_a_segment_that_is_gone(tmp_path, whole, other, capsys, number):
    second = str(lay(tmp_path / "second", other))
    name = sorted(whole)[number]
    log = str(lay(tmp_path / "log", {key: data for key, data in whole.items() if key != name}))
    joined = ["merge", "--in-turn", "recording", "-o", str(tmp_path / "joined.mcap")]
    assert cli.main([*joined, log, second]) == cli.DAMAGED
    assert f"segment {number} " in capsys.readouterr().err


def test_exchanged_segments_are_put_in_order_and_a_neighbours_is_no_part(tmp_path, whole, other):
    files = whole | {"x_001.mcap": whole["x_003.mcap"], "x_003.mcap": whole["x_001.mcap"]}
    log = LogReader(lay(tmp_path / "exchanged", files))
    assert log.complete
    assert log.read("a")["sequence"].tolist() == list(range(ROWS))
    log = LogReader(lay(tmp_path / "foreign", whole | {"x_002.mcap": other["x_002.mcap"]}))
    assert [str(one).split(";")[0] for one in log.damage] == ["segment 2 is missing"]
    copied = LogReader(lay(tmp_path / "copied", whole | {"x_002.mcap": whole["x_001.mcap"]}))
    assert [str(one).split(";")[0] for one in copied.damage] == ["segment 2 is missing"]


@pytest.mark.parametrize("number", [0, 2])
@pytest.mark.parametrize("word", [b"segment", b"flight", b"f1", b"number", b"#crc"])
@pytest.mark.parametrize("every", [3, pytest.param(1, marks=pytest.mark.campaign)])  # bits between those of the other
def test_a_flipped_bit_of_the_segments_own_metadata_drops_nothing(tmp_path, whole, number, word, every):
    name = sorted(whole)[number]
    place = whole[name].index(word)
    for bit in range(8 * place, 8 * (place + len(word)), every):
        data = bytearray(whole[name])
        data[bit // 8] ^= 1 << bit % 8
        log = LogReader(lay(tmp_path, whole | {name: bytes(data)}))
        assert len(log.segments) == 5
        assert len(log.read("a")) == ROWS
        assert log.exit_code == cli.DAMAGED
        assert {one.file for one in log.damage} == {name}


def test_a_killed_flight_whose_first_head_is_altered_is_whole_but_for_its_end(tmp_path, whole):
    """Without the CRC of a whole file, which only a closed one has."""
    data = whole["x.mcap"][: -mcap_format.FOOTER_BYTES].replace(b"segment", b"segmenu", 1)
    log = LogReader(lay(tmp_path, whole | {"x.mcap": data}))
    assert len(log.read("a")) == ROWS
    assert log.metadata["segment"]["flight"] == "f1"
    assert str(log.damage[0]) == "x.mcap: its metadata 'segment' is altered"


def test_a_line_end_in_a_name_hides_no_segment(tmp_path):
    write(tmp_path / "two\nlines.mcap", "f1")
    log = LogReader(tmp_path / "two\nlines.mcap")
    assert len(log.segments) == 5
    assert log.complete


@pytest.mark.parametrize("what", ["loop", "dangling", "pipe", "directory"])
def test_what_lies_in_a_segments_place_is_named(tmp_path, whole, capsys, what):
    log = lay(tmp_path, {name: data for name, data in whole.items() if name != "x_001.mcap"})
    place = tmp_path / "x_001.mcap"
    if what == "pipe":
        os.mkfifo(place)
    elif what == "directory":
        place.mkdir()
    else:
        place.symlink_to(place if what == "loop" else tmp_path / "nowhere")
    for command in (["info"], ["recover", "-o", str(tmp_path / "out.mcap")], ["dump", "--to", "npz", str(tmp_path)]):
        assert cli.main([command[0], str(log), *command[1:]]) == cli.DAMAGED
    said = " ".join(capsys.readouterr().out.split())
    assert said.count("x_001.mcap: segment 1 cannot be read: ") == 2
    assert said.count("it held 800 rows over 0.4 s: a 440 to 839, b 440 to 839") == 2


@pytest.mark.parametrize("name", ["x", "x.mcap"])
@pytest.mark.parametrize("gone", [0, 1, 3, None])
def test_a_segment_that_is_recovered_alone_is_not_called_the_flight(tmp_path, capsys, name, gone):
    write(tmp_path / name, "f1")
    files = sorted(path for path in tmp_path.rglob("*.mcap") if path.is_file())
    if gone is not None:
        files.pop(gone).unlink()
    part = next(path for path in files if path.name == "x_002.mcap")
    code = cli.main(["recover", str(part), "-o", str(tmp_path / "out.mcap")])
    said = capsys.readouterr().out
    assert code == (cli.OK if gone is None else cli.DAMAGED)
    others = ", ".join(path.name for path in files if path != part)
    assert f"segments of the flight that are not in it: {others}" in said
    assert "all that was recorded is there" not in said
    assert (f"segment {gone} of its flight is not beside it" in said) == (gone is not None)


def test_segments_of_another_flight_in_its_directory_are_no_part(tmp_path, other):
    write(tmp_path / "x", "f1")
    (tmp_path / "x" / "x_002.mcap").write_bytes(other["x_002.mcap"])
    log = LogReader(tmp_path / "x")
    assert [str(one).split(";")[0] for one in log.damage] == ["segment 2 is missing"]


HARMS = ("flip", "flip head", "cut", "zero", "noise", "delete", "exchange", "copy", "foreign", "append", "rewrite")


def harmed(files, other, rng):
    """Something done to one of ``files``."""
    kind, name = rng.choice(HARMS), rng.choice(sorted(files))
    data = bytearray(files[name])
    at = rng.randrange(max(1, min(len(data), 700 if kind == "flip head" else len(data))))
    if kind.startswith("flip") and data:
        data[at] ^= 1 << rng.randrange(8)
    elif kind == "cut":
        data = data[:at]
    elif kind == "zero":
        data[at : at + rng.choice([1, 100, 10**6])] = bytes(len(data[at : at + rng.choice([1, 100])]))
    elif kind == "noise":
        noise = rng.randbytes(rng.choice([4, 64, 1000]))
        data[at : at + len(noise)] = noise
    elif kind in ("exchange", "copy"):
        second = rng.choice(sorted(files))
        data, files[second] = files[second], files[name] if kind == "exchange" else files[second]
    elif kind == "foreign":
        data = other[name]
    elif kind == "append":
        data += rng.randbytes(rng.randrange(1, 200))
    elif kind == "rewrite":
        data = bytearray(crafted(bytes(data), rng))
    files[name] = bytes(data)
    if kind == "delete":
        del files[name]
    return kind, name


def crafted(data, rng):
    """With numbers of its messages changed, and every CRC right: as only somebody who means it writes it."""
    if not data.startswith(mcap_format.MAGIC):
        return data
    parts = [data[: len(mcap_format.MAGIC)]]
    for number, value in enumerate(_records(data)):
        if value[0] == 6 and rng.randrange(2):  # a chunk
            body = bytearray(value[9 + 40 :])
            for _ in range(rng.randrange(1, 6)):
                word = rng.choice([0, 1, 2**63 - 1, 2**63, 2**64 - 1, rng.getrandbits(64)])
                at = rng.randrange(max(1, len(body) - 8))
                body[at : at + 8] = struct.pack("<Q", word)
            parts.append(Chunk(number, number, bytes(body)).pack())
        else:
            parts.append(value)
    return b"".join(parts)


def _records(data):
    at = len(mcap_format.MAGIC)
    while at + 9 <= len(data):
        _, length = RECORD_HEAD.unpack_from(data, at)
        if length > len(data):
            return
        yield data[at : at + 9 + length]
        at += 9 + length


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.campaign) for seed in (1, 2, 3, 4))])
@pytest.mark.timeout(300)
def test_whatever_is_done_to_a_flight_it_is_never_called_whole_when_rows_are_missing(
    tmp_path, whole, other, capsys, seed
):
    rng = random.Random(seed)
    lossy = 0
    for case in range(12):
        files = dict(whole)
        done = [harmed(files, other, rng) for _ in range(rng.choice([1, 1, 2, 3])) if files]
        log = lay(tmp_path / str(case), files)
        codes = [
            cli.main(["info", str(log)]),
            cli.main(["recover", str(log), "-o", str(log.with_name("out.mcap"))]),
            cli.main(["dump", str(log), "--to", "npz", str(log.with_name("dump"))]),
        ]
        said = capsys.readouterr().out
        rewritten = any(kind == "rewrite" for kind, _ in done)
        got = 0
        if log.with_name("out.mcap").exists():
            out = LogReader(log.with_name("out.mcap"))
            got = min(len(np.unique(out.read(name)["sequence"])) if name in out.channels else 0 for name in "ab")
        if got < ROWS and not rewritten:
            lossy += 1
            assert 0 not in codes, (case, done, codes)
            assert "lossless" not in said
    assert lossy > 2


def test_a_crafted_chunk_with_extreme_numbers_is_read_or_refused(tmp_path, whole, capsys):
    """Sequence numbers and times that no flight has, and that overflow where somebody subtracts them."""
    data = whole["x.mcap"]
    chunks = [found for found in Scan(lay(tmp_path, {"x.mcap": data})).records() if isinstance(found, ScannedRecord)]
    chunk = next(one for one in chunks if isinstance(one.content, Chunk))
    row = scalars(0, 1).tobytes()
    tail = chunk.content.records.index(row[:24])
    extremes = [0, 2**63 - 1, 2**63, 2**64 - 1]
    for number, (sequence, host_ns) in enumerate([(a, b) for a in extremes for b in extremes]):
        body = bytearray(chunk.content.records)
        body[tail : tail + 16] = struct.pack("<QQ", sequence, host_ns)
        packed = Chunk(0, 1, bytes(body)).pack()
        log = lay(tmp_path / str(number), {"x.mcap": data[: chunk.start] + packed + data[chunk.end :]})
        dump = ["dump", "--to", "csv", str(log.with_name("dump"))]
        for command in (["info"], ["recover", "-o", str(log.with_name("out.mcap"))], dump):
            assert cli.main([command[0], str(log), *command[1:]]) in (cli.OK, cli.DAMAGED)
    capsys.readouterr()


@pytest.mark.parametrize(
    "facts",
    [{"recorded": {"a": "x", "b": "9" * 40}}, {"flight": {"wall_clock_ns": "9" * 400, "monotonic_ns": "-" + "9" * 30}}],
)
def test_metadata_that_makes_no_sense_stops_nobody(tmp_path, capsys, facts):
    write(tmp_path / "x.mcap", "f1", facts)
    for command in (["info"], ["recover", "-o", str(tmp_path / "out.mcap")], ["dump", "--to", "csv", str(tmp_path)]):
        assert cli.main([command[0], str(tmp_path / "x.mcap"), *command[1:]]) == cli.OK
    capsys.readouterr()


@pytest.mark.timeout(20)
def test_what_is_no_file_is_refused_at_once(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe.mcap")
    for path in (tmp_path / "pipe.mcap", "/dev/zero", "/dev/null"):
        for command in (["info"], ["dump", "--to", "csv", str(tmp_path)], ["replay"], ["report"]):
            assert cli.main([command[0], str(path), *command[1:]]) == cli.BAD_INPUT
        assert cli.main(["recover", str(path), "-o", str(tmp_path / "out.mcap")]) in (cli.BAD_INPUT, cli.FAILED)
    assert capsys.readouterr().err.count("is no file") == 15


def test_names_that_a_terminal_would_obey_are_damage(tmp_path, capsys):
    with LogWriter.create(tmp_path / "x.mcap") as writer:
        for name in ("joint", "red\x1b[31m"):
            writer.register(name, records.SCALAR)
            writer.write(name, scalars(0, 5))
            writer.flush()
        writer.add_metadata("facts", {"a": "\x1b]0;title\x07"})
    for command in (["info"], ["recover", "-o", str(tmp_path / "out.mcap")], ["dump", "--to", "csv", str(tmp_path)]):
        assert cli.main([command[0], str(tmp_path / "x.mcap"), *command[1:]]) == cli.DAMAGED
    said = capsys.readouterr()
    assert "\x1b" not in said.out + said.err
    assert len(LogReader(tmp_path / "out.mcap").read("joint")) == 5


def test_a_flight_whose_phase_channel_stayed_empty_can_be_read_and_replaying_nothing_is_no_success(tmp_path, capsys):
    vehicle = config.load(config.packaged("rocksat"))
    with LogWriter.create(tmp_path / "x.mcap") as writer:
        writer.attach("vehicle.toml", "application/toml", vehicle.text.encode())
        writer.attach(vehicle.file.vehicle.urdf, "application/xml", vehicle.urdf_path.read_bytes())
        for name, dtype in vehicle.channels.items():
            writer.register(name, dtype)
        writer.write("joint_1", scalars(0, 100))
    log = str(tmp_path / "x.mcap")
    assert cli.main(["report", log, "-o", str(tmp_path / "x.html")]) == cli.OK
    assert cli.main(["dump", log, "--to", "csv", str(tmp_path), "--phase", "sweep 1"]) == cli.BAD_INPUT
    assert "has no phase sweep 1; it has no phases" in capsys.readouterr().err
    assert cli.main(["replay", log]) == cli.FAILED
    assert "nothing to compare" in capsys.readouterr().out
