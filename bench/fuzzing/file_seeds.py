"""Valid files to begin from, a few for each target of ``files``."""

import io
import tempfile
import zipfile
from pathlib import Path

import numpy as np

from bench.fuzzing.files import MEMBER, ROCKSAT, SPLIT, as_list
from drivers import records
from onboard import channels, config
from onboard.config.segments import Library, to_bytes
from onboard.recording.segmented import Preamble, SegmentedLog, SegmentLimits
from onboard.recording.writer import LogWriter

FACTS = {"flight": {"vehicle": "x", "wall_clock_ns": "1565611200000000000", "monotonic_ns": "0"}}
NEXT = b"\xfe\0\0"  # files.NEXT_FILE with an empty body
CSV_MAPPING = b"""[mapping]
name = "bench"
format = "csv"
[csv]
delimiter = ","
header_line = 1
[time]
column = "t"
unit = "ms"
offset = 1
[channel.imu]
record = "imu"
accel = { columns = ["ax", "ay", "az"], axes = ["-y", "+x", "+z"], scale = [9.81, 2048], unit = "m/s^2" }
gyro = { columns = ["ax", "ay", "az"], scale = 1e-3, unit = "deg/s" }
[channel.force]
record = "scalar"
time = { rate_Hz = 500 }
value = { sum = { "f" = 2.0, "ax" = 1.0 }, sign = "-", values = "physical", scale = 1e-3, unit = "N" }
"""
CSV = b"t,ax,ay,az,f\n0,1,2,3,0.5\n1,2,3,4,0.25\n2,3,4,5,-0.125\n9,4,5,6,1e3\n"
NPZ_MAPPING = b"""[mapping]
name = "npz"
format = "npz"
[time]
column = "t"
unit = "us"
[channel.imu]
record = "imu"
accel = { column = "a", scale = 1e-3, unit = "g" }
gyro = { column = "a", scale = 1e-3, unit = "rad/s" }
[channel.rate]
record = "scalar"
value = { column = "a[1]", scale = 1, unit = "rev/min" }
"""


def _filled(dtype: np.dtype[np.void], count: int) -> np.ndarray:
    rows = np.zeros(count, dtype)
    rows["sequence"] = np.arange(count)
    rows["host_ns"] = 1_000_000 * np.arange(1, count + 1)
    for name in dtype.names or ():
        if dtype[name].kind == "S":
            rows[name] = b"N"
    return rows


def _log(place: Path) -> bytes:
    with LogWriter.create(place / "one.mcap", durable=False) as writer:
        writer.add_metadata("flight", FACTS["flight"])
        writer.attach("notes.txt", "text/plain", b"x")
        for name, dtype in (("force", records.SCALAR), ("event", records.EVENT), ("gap", records.GAP)):
            writer.register(name, dtype)
            writer.write(name, _filled(dtype, 3))
        for name, dtype in (
            ("clock", channels.CLOCK),
            ("quantity", channels.QUANTITY),
            ("row", channels.row_dtype(2, 1)),
        ):
            writer.register(name, dtype)
            writer.write(name, _filled(dtype, 2))
    return (place / "one.mcap").read_bytes()


def _segments(place: Path) -> bytes:
    """A flight in segments, as a list of records."""
    step_ns = 50_000_000
    log = SegmentedLog(
        place / "x.mcap", Preamble("f1", (), FACTS), limits=SegmentLimits(span_ns=2 * step_ns), sync_interval_ns=0
    )
    log.register("a", records.CAN_SYNC)
    for step in range(5):
        rows = _filled(records.CAN_SYNC, 4)
        rows["sequence"] += np.uint64(4 * step)
        rows["host_ns"] += step * step_ns
        log.write("a", rows)
        log.sync(step * step_ns)
    log.close()
    return NEXT.join(as_list(path.read_bytes()) for path in sorted(place.glob("x*.mcap")))


def _array(name: str, values: np.ndarray, place: Path) -> bytes:
    np.save(place / "array.npy", values)
    data = (place / "array.npy").read_bytes()
    return MEMBER.pack(len(name), len(data)) + name.encode() + data


def _library() -> Library:
    """Two segments of one joint."""
    q = np.zeros((2, 6, 1))
    q[:, 2:4] = 0.1
    shares = np.full((2, 1), 0.1)
    return Library(
        ("a", "b"),
        ("joint_1",),
        0.2 * np.arange(6.0),
        q,
        np.array([6, 5]),
        ("rate_x", "rate_y"),
        np.array([1.0]),
        np.ones((2, 1, 3, 2), np.float32),
        5.0,
        np.ones((2, 4, 3)),
        np.zeros((2, 6, 3, 1)),
        shares,
        -shares,
        (("joint_1 rate",), ("joint_1 effort",)),
        1.0,
    )


def _members(archive: bytes) -> bytes:
    """An NPZ as a list of arrays."""
    with zipfile.ZipFile(io.BytesIO(archive)) as file:
        parts = [(name.removesuffix(".npy"), file.read(name)) for name in file.namelist()]
    return b"".join(MEMBER.pack(len(name), len(data)) + name.encode() + data for name, data in parts)


def seeds() -> dict[str, list[bytes]]:
    """Seeds by target."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        log, segments = _log(place), _segments(place)
        arrays = _array("t", np.arange(4, dtype=np.int64), place)
        arrays += _array("a", np.arange(12, dtype=np.int16).reshape(4, 3), place)
        np.savez_compressed(place / "a.npz", t=np.arange(3), a=np.ones((3, 3)))
        archive = (place / "a.npz").read_bytes()
    logs = [b"\3" + as_list(log), b"\0" + log, b"\1" + segments, b"\2" + log[: len(log) // 2]]
    vehicles = [config.loader.packaged(name).read_bytes() for name in ("rocksat", "rocksat_serial", "rocksat_mixed")]
    return {
        "vehicle": vehicles,
        "urdf": [ROCKSAT.with_name("rocksat.urdf").read_bytes()],
        "segments": [b"\0" + to_bytes(_library()), b"\1" + _members(to_bytes(_library()))],
        "log": logs,
        "recover": logs,
        "import": [
            b"\0" + SPLIT.pack(len(CSV_MAPPING)) + CSV_MAPPING + CSV,
            b"\1" + SPLIT.pack(len(NPZ_MAPPING)) + NPZ_MAPPING + arrays,
            b"\0" + SPLIT.pack(len(NPZ_MAPPING)) + NPZ_MAPPING + archive,
        ],
    }
