"""Files in memory that fail in known ways, and rows to fill logs with."""

import errno
import io
from pathlib import Path

import numpy as np
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

from bench.true_flights.free_flyer_sensors import COUNTS_PER_TURN
from drivers.records import IMU, SCALAR
from onboard.recording.writer import LogWriter

READING = np.dtype([("sequence", "<u8"), ("host_ns", "<i8"), ("value", "<i4"), ("code", "u1")], align=True)
LABEL = np.dtype([("sequence", "<u8"), ("host_ns", "<i8"), ("name", "S5"), ("matrix", "<f4", (2, 3))], align=True)

LARGE = np.dtype([("sequence", "<u8"), ("host_ns", "<i8"), ("used", "<u4", (4,)), ("root", "<f8", (2500,))], align=True)


def reading_rows(first, count, step_ns=1000):
    """Rows of READING with numbers ``first ..`` whose every field follows from the number."""
    rows = np.zeros(count, READING)
    rows["sequence"] = np.arange(first, first + count)
    rows["host_ns"] = rows["sequence"].astype(np.int64) * step_ns
    rows["value"] = (rows["sequence"].astype(np.int64) * 7919) % 100_003
    rows["code"] = rows["sequence"] % 251
    return rows


def label_rows(first, count, step_ns=1000):
    """The same for LABEL."""
    rows = np.zeros(count, LABEL)
    rows["sequence"] = np.arange(first, first + count)
    rows["host_ns"] = rows["sequence"].astype(np.int64) * step_ns + 500
    rows["name"] = [b"n%d" % (n % 1000) for n in range(first, first + count)]
    rows["matrix"] = rows["sequence"][:, None, None] + np.arange(6).reshape(2, 3)
    return rows


def make_log(path, channels, overwrite=False):
    """A log of rows by channel; its path."""
    with LogWriter.create(path, durable=False, overwrite=overwrite) as writer:
        for name, rows in channels.items():
            writer.register(name, rows.dtype)
        for name, rows in channels.items():
            writer.write(name, rows)
    return path


def sampled_rows(samples, begin_s=0.0):
    """Rows of the base IMU and the joints by channel, of samples of a simulated free flyer."""
    count = len(samples.time_s)
    imu = np.zeros(count, IMU)
    imu["sequence"], imu["host_ns"] = np.arange(count), np.rint(1e9 * (begin_s + samples.time_s))
    imu["gyro_scale_rad_s"], imu["accel_scale_m_s2"] = 1e-4, 1e-3
    imu["gyro_raw"] = np.rint(samples.rate_rad_s / 1e-4)
    imu["accel_raw"] = np.rint(samples.specific_force_m_s2 / 1e-3)
    made = {"imu_base": imu}
    for number, angle_rad in enumerate(samples.angle_rad.T, 1):
        made[f"joint_{number}"] = rows = np.zeros(count, SCALAR)
        rows["sequence"], rows["host_ns"] = imu["sequence"], imu["host_ns"]
        rows["scale"], rows["unit"] = 2.0 * np.pi / COUNTS_PER_TURN, b"rad"
        rows["value_raw"] = np.rint(angle_rad * COUNTS_PER_TURN / (2.0 * np.pi))
    return made


def random_rows(rng, dtype, count):
    """Rows of any bytes, except that time does not run backwards and numbers count up. NaN are made plain zeros."""
    rows = np.frombuffer(rng.bytes(count * dtype.itemsize), dtype).copy()
    for name in dtype.names:
        if dtype[name].base.kind == "f":
            rows[name] = np.nan_to_num(rows[name])
        elif dtype[name].base.kind == "b":
            rows[name] = rng.integers(0, 2, rows[name].shape)
    rows["sequence"] = np.arange(count)
    rows["host_ns"] = np.sort(rng.integers(0, 10**12, count))
    return rows


def same_fields(a, b):
    """Whether two sets of rows agree in every field, whatever lies in the padding."""
    return a.dtype == b.dtype and len(a) == len(b) and all(np.array_equal(a[name], b[name]) for name in a.dtype.names)


SMALL = 40  # rows of `reading` in the small log
LEAST = 20  # where a log is tried at each of its bytes: five chunks


def small_labels():
    """The rows of `label` in the small log."""
    return np.concatenate([label_rows(first, 1 + first // 4 % 2) for first in range(0, SMALL, 4)])


def write_small(path, rows=SMALL):
    """A log of some eight chunks with two of everything: channels, attachments, metadata; fewer of fewer rows."""
    with LogWriter(MemorySink(path), chunk_bytes=600) as writer:
        writer.add_metadata("host", {"machine": "test"})
        writer.attach("vehicle.toml", "application/toml", b'name = "x"\n')
        writer.register("reading", READING)
        writer.register("label", LABEL)
        for first in range(0, rows, 4):
            writer.write("reading", reading_rows(first, 4))
            writer.write("label", label_rows(first, 1 + first // 4 % 2))
        writer.attach("late.bin", "application/octet-stream", bytes(range(64)))
        writer.add_metadata("end", {"reason": "done"})
    return path


def overwrite(path, data):
    """Make ``data`` the content of a file, in place: ext4 brings to the disk what is emptied and written anew."""
    path.touch()
    with path.open("r+b") as file:
        file.write(data)
        file.truncate()


def chunk_places(data):
    """Start and end of every chunk record, by the stock reader's own account of what stands where."""
    places, at = [], 8
    while at < len(data) - 8:
        length = int.from_bytes(data[at + 1 : at + 9], "little")
        if data[at] == 6:
            places.append((at, at + 9 + length))
        at += 9 + length
    assert len(places) == sum(isinstance(r, Chunk) for r in StreamReader(io.BytesIO(data), emit_chunks=True).records)
    return places


class MemorySink:
    """A sink that keeps the file in memory and writes it to ``path``, if there is one, at the end."""

    def __init__(self, path=None):
        self.path = None if path is None else Path(path)
        self.data = bytearray()
        self.syncs = 0
        self.closed = False

    def write_at(self, offset, data):
        assert offset <= len(self.data), "a hole in the file"
        self.data[offset : offset + len(data)] = data

    def sync(self):
        self.syncs += 1

    def taken(self):
        return None

    def close(self):
        assert not self.closed
        self.closed = True
        if self.path is not None:
            self.path.write_bytes(self.data)


class FailingSink(MemorySink):
    """Refuses on demand; a refused write leaves part of its bytes, a refused sync drops what it was for."""

    def __init__(self, path=None):
        super().__init__(path)
        self.refuse_writes = self.refuse_syncs = 0
        self.durable = 0  # bytes that a sync has brought to the medium

    def write_at(self, offset, data):
        if self.refuse_writes:
            self.data[offset : offset + len(data)] = b"\xee" * (len(data) // 2)
            raise OSError(self.refuse_writes, "refused")
        super().write_at(offset, data)

    def sync(self):
        if self.refuse_syncs:
            # what Linux does: the pages are marked clean, their content never reaches the medium
            self.data[self.durable :] = b"\0" * (len(self.data) - self.durable)
            raise OSError(self.refuse_syncs, "refused")
        super().sync()
        self.durable = len(self.data)


DISK_ERRORS = (errno.ENOSPC, errno.EIO, errno.EROFS)
