"""What reads files, under fuzz: vehicle files, logs, their recovery, the import of foreign recordings.

A target writes what the bytes say into a directory of its own and calls what a command calls. Only the error that the
room names may come out. CRCs stand between a fuzzer and what lies behind them, so a log comes either as its bytes, or
as a list of records, which is packed with lengths and CRCs that are right.
"""

import contextlib
import io
import shutil
import struct
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

from mcap.opcode import Opcode
from rich.console import Console

from bench.fuzzing.laws import leading
from onboard import config
from onboard.config.errors import ConfigError
from onboard.config.segments import read
from onboard.dynamics.model.errors import ModelError
from onboard.flight.estimate.estimator import Estimator
from onboard.ground.log.bring_in.errors import ImportFileError
from onboard.ground.log.bring_in.importer import import_recordings
from onboard.ground.log.export.dump import dump
from onboard.ground.log.tables.flight_tables import FlightTables
from onboard.ground.log.views import info, summary
from onboard.recording.format.errors import RecordingError
from onboard.recording.format.mcap_format import MAGIC, RECORD_HEAD, Chunk, Metadata
from onboard.recording.format.segments import with_crc, without_crc
from onboard.recording.reader import LogReader
from onboard.recording.recover import EXIT_NOTHING, recover

PART = struct.Struct("<BH")  # of a list of records: opcode, bytes of its body
NEXT_FILE = 0xFE  # in a list: the records that follow are of the next segment
TIMES = struct.Struct("<QQ")
SPLIT = struct.Struct("<H")  # where the mapping of an import ends
MEMBER = struct.Struct("<BI")  # of an NPZ as a list: bytes of its name, bytes of the array
MOST_MEMBERS = 20
ROCKSAT = config.loader.packaged("rocksat")


@contextlib.contextmanager
def _place() -> Iterator[Path]:
    """A directory in memory that lasts for one call."""
    memory = Path("/dev/shm")
    made = Path(tempfile.mkdtemp(prefix="heft-fuzz-", dir=memory if memory.is_dir() else None))
    try:
        yield made
    finally:
        shutil.rmtree(made)


def vehicle_file(data: bytes) -> None:
    """A vehicle file beside RockSat's URDF; one that is accepted gets an estimator, as ``heft fly`` makes it."""
    with _place() as place, contextlib.suppress(ConfigError, ModelError):
        (place / "rocksat.urdf").symlink_to(ROCKSAT.with_name("rocksat.urdf"))
        (place / "vehicle.toml").write_bytes(data)
        Estimator(config.load(place / "vehicle.toml"))


def urdf_file(data: bytes) -> None:
    """A URDF under RockSat's vehicle file; one that is accepted gets an estimator."""
    with _place() as place, contextlib.suppress(ConfigError, ModelError):
        (place / "vehicle.toml").symlink_to(ROCKSAT)
        (place / "rocksat.urdf").write_bytes(data)
        Estimator(config.load(place / "vehicle.toml", place / "rocksat.urdf"))


def segments_file(data: bytes) -> None:
    """A file of motion segments: NPZ as its bytes, or as a list of arrays."""
    warnings.simplefilter("ignore", UserWarning)  # of names that an archive has twice
    (how,), body = leading(data, 1)
    with _place() as place, contextlib.suppress(ConfigError):
        (place / "segments.npz").write_bytes(_archive(body) if how & 1 else body)
        read(place / "segments.npz")


def log_file(data: bytes) -> None:
    """A log, or the segments of one, read as ``heft info`` and ``heft dump`` read it."""
    (how,), body = leading(data, 1)
    with _place() as place, contextlib.suppress(RecordingError):
        log = LogReader(_laid(place, body, as_list=bool(how & 1)))
        for _ in log.batches():
            pass
        shell = Console(file=io.StringIO(), width=120, markup=False, emoji=False)  # as cli.common has it
        shell.print(info.render(info.info(log)))
        shell.print(summary.render(summary.summary(log)))
        if how & 2:
            dump(FlightTables(log), place / "out", kind="csv")
            inside = {path.parent for path in place.rglob("*") if path.is_file()}
            assert inside <= {place, place / "out"}, inside


def recovered(data: bytes) -> None:
    """A log is recovered; what comes out can be read, is whole, and holds the rows that were said."""
    (how,), body = leading(data, 1)
    with _place() as place:
        out = place / "recovered.mcap"
        try:
            found = recover(_laid(place, body, as_list=bool(how & 1)), out)
        except RecordingError:
            return
        if found.exit_code == EXIT_NOTHING:
            return
        log = LogReader(out)
        rows = dict.fromkeys(log.channels, 0)
        for channel, batch in log.batches():
            rows[channel] += len(batch)
        assert not log.damage, log.damage
        assert {name: rows[name] for name in found.rows if name != "recover_gap"} == {
            name: count for name, count in found.rows.items() if name != "recover_gap"
        }


def imported(data: bytes) -> None:
    """A mapping and a recording: CSV, or NPZ as its bytes or as a list of arrays."""
    warnings.simplefilter("ignore", UserWarning)  # of names that an archive has twice
    (how,), body = leading(data, 1)
    (size,) = SPLIT.unpack(body[:2].ljust(2, b"\0"))
    mapping, recording = body[2 : 2 + size], body[2 + size :]
    with _place() as place, contextlib.suppress(ImportFileError):
        (place / "mapping.toml").write_bytes(mapping)
        source = place / "run.csv"
        source.write_bytes(_archive(recording) if how & 1 else recording)
        for one in import_recordings(place / "mapping.toml", source, place / "out"):
            log = LogReader(one.path)
            assert not log.damage, log.damage
            assert all(path.parent == place / "out" for path in (place / "out").rglob("*"))


def _laid(place: Path, body: bytes, *, as_list: bool) -> Path:
    """The log that the bytes describe, in files."""
    log = place / "run.mcap"
    files = list(packed(body)) if as_list else [body]
    for number, content in enumerate(files):
        (place / (f"run_{number:03d}.mcap" if number else log.name)).write_bytes(content)
    return log


def _parts(body: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at + PART.size <= len(body):
        opcode, size = PART.unpack_from(body, at)
        yield opcode, body[at + PART.size : at + PART.size + size]
        at += PART.size + size


def packed(body: bytes) -> Iterator[bytes]:
    """Whole MCAP files out of a list of records."""
    made = bytearray(MAGIC)
    for opcode, content in _parts(body):
        if opcode == NEXT_FILE:
            yield bytes(made)
            made = bytearray(MAGIC)
        elif opcode == Opcode.CHUNK:
            start_ns, end_ns = TIMES.unpack(content[: TIMES.size].ljust(TIMES.size, b"\0"))
            records = b"".join(RECORD_HEAD.pack(kind, len(c)) + c for kind, c in _parts(content[TIMES.size :]))
            made += Chunk(start_ns, end_ns, records).pack()
        elif opcode == Opcode.METADATA:
            made += _proven(content)
        elif opcode == Opcode.ATTACHMENT:
            crc = zlib.crc32(content[:-4]).to_bytes(4, "little")
            made += RECORD_HEAD.pack(opcode, len(content[:-4]) + 4) + content[:-4] + crc
        else:
            made += RECORD_HEAD.pack(opcode, len(content)) + content
    yield bytes(made)


def _proven(content: bytes) -> bytes:
    """Metadata with its CRC right where it has one."""
    try:
        name, items = Metadata.parse(content)
    except RecordingError:
        return RECORD_HEAD.pack(Opcode.METADATA, len(content)) + content
    if items != without_crc(items):
        items = with_crc(name, without_crc(items))
    return Metadata(name, items).pack()


def as_list(log: bytes) -> bytes:
    """A log as a list of records, without indexes and summary."""
    made, at = bytearray(), len(MAGIC)
    while at + RECORD_HEAD.size <= len(log):
        opcode, size = RECORD_HEAD.unpack_from(log, at)
        content = log[at + RECORD_HEAD.size : at + RECORD_HEAD.size + size]
        at += RECORD_HEAD.size + size
        if opcode == Opcode.DATA_END:
            break
        if opcode == Opcode.CHUNK:
            chunk = Chunk.parse(content)
            inside, records = bytearray(), chunk.records
            place = 0
            while place < len(records):
                kind, length = RECORD_HEAD.unpack_from(records, place)
                inside += PART.pack(kind, length) + records[place + RECORD_HEAD.size :][:length]
                place += RECORD_HEAD.size + length
            content = TIMES.pack(chunk.start_ns, chunk.end_ns) + bytes(inside)
        if opcode != Opcode.MESSAGE_INDEX:
            made += PART.pack(opcode, len(content)) + content
    return bytes(made)


def _archive(body: bytes) -> bytes:
    """An NPZ out of a list of arrays, with sizes and CRCs that are right."""
    made, at = io.BytesIO(), 0
    with zipfile.ZipFile(made, "w") as archive:
        for _ in range(MOST_MEMBERS):
            if at + MEMBER.size > len(body):
                break
            named, size = MEMBER.unpack_from(body, at)
            at += MEMBER.size
            name = body[at : at + named].decode("latin-1") or "x"
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), body[at + named : at + named + size])
            at += named + size
    return made.getvalue()


CALLS = {
    "vehicle": vehicle_file,
    "urdf": urdf_file,
    "segments": segments_file,
    "log": log_file,
    "recover": recovered,
    "import": imported,
}
