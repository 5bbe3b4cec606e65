"""Writing logs: ours beside the stock Python ``mcap`` package, in one run.

::

    python bench/recording.py [--records N] [--directory DIR]

Records are those of a flight: two IMUs and two scalar channels in turn. Ours repeats the definitions in every chunk of
16 KiB and syncs to the disk every 150 ms, as in flight; the batch is what the recorder finds in a ring at a step. The
``flight`` lines are a DYMAFLEX's mix (2 IMUs at 1 kHz, 5 joints and a load cell at 500 Hz), a recorder's step of 50 ms
at a time: through the writer alone, in segments, and from shared-memory rings through the recorder. Each line is
measured in a process of its own, whose peak memory is given; on a machine that does something else too, the column per
second of processor time tells more than the one by the clock. The C++ library is not here to be measured; published
for it are 1.7 million records/s. Reading and dumping: ``bench/reading.py``.
"""

import argparse
import multiprocessing
import resource
import shutil
import tempfile
import time
from collections.abc import Callable
from multiprocessing.queues import SimpleQueue
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from drivers import records
from drivers.records import Rows
from onboard.recording.format.schema import ros2msg
from onboard.recording.format.segments import segments
from onboard.recording.recorder import Recorder
from onboard.recording.segmented import Preamble, SegmentedLog
from onboard.recording.writer import LogWriter
from onboard.ring import RingReader, RingWriter

CHANNELS = {"imu_0": records.IMU, "imu_1": records.IMU, "joint_1": records.SCALAR, "load_cell": records.SCALAR}
FLIGHT_ROWS = {"imu_0": 50, "imu_1": 50, **{f"joint_{n}": 25 for n in range(1, 6)}, "load_cell": 25}  # in 50 ms
BATCHES = (1, 5, 20, 50, 200, 1000)
Seconds = NDArray[np.float64]  # (2,): of the clock, and of the processor
Answer = SimpleQueue[tuple[Seconds, float]]


def now() -> Seconds:
    """What a clock and the processor's account of this process show."""
    return np.array([time.perf_counter(), time.process_time()])


def rows_of(dtype: np.dtype[np.void], count: int) -> Rows:
    """Rows as a device makes them: noise of some hundred counts, a period of 1 ms."""
    rng = np.random.default_rng(1)
    rows = np.zeros(count, dtype)
    rows["sequence"] = rows["tick"] = np.arange(count)
    rows["host_ns"] = 1_000_000_000 + np.arange(count) * 1_000_000 + rng.integers(0, 50_000, count)
    if dtype == records.IMU:
        rows["accel_raw"] = rng.normal([0, 0, 8192], 200, (count, 3)).astype(np.int16)
        rows["gyro_raw"] = rng.normal(0, 300, (count, 3)).astype(np.int16)
        rows["temperature_raw"] = rng.normal(-500, 5, count).astype(np.int16)
        rows["accel_scale_m_s2"], rows["gyro_scale_rad_s"] = 9.80665 / 8192, np.deg2rad(1 / 131)
    else:
        rows["value_raw"] = np.cumsum(rng.integers(-30, 31, count))
        rows["scale"], rows["unit"] = 1e-4, b"N"
    return rows


def write_ours(path: Path, count: int, batch: int) -> Seconds:
    """Seconds to write ``count`` records in batches of ``batch``."""
    per_channel = count // len(CHANNELS)
    rows = {name: rows_of(dtype, per_channel) for name, dtype in CHANNELS.items()}
    start = now()
    with LogWriter.create(path, overwrite=True) as writer:
        for name, dtype in CHANNELS.items():
            writer.register(name, dtype)
        for first in range(0, per_channel, batch):
            for name, part in rows.items():
                writer.write(name, part[first : first + batch])
            writer.sync(time.monotonic_ns())
    return now() - start


def flight_rows(count: int) -> tuple[dict[str, Rows], int]:
    """Rows of a flight by channel, ``count`` in all, and how many steps of 50 ms they are."""
    steps = count // sum(FLIGHT_ROWS.values())
    kinds = {name: records.IMU if name.startswith("imu") else records.SCALAR for name in FLIGHT_ROWS}
    return {name: rows_of(kinds[name], steps * n) for name, n in FLIGHT_ROWS.items()}, steps


def write_flight(path: Path, count: int) -> Seconds:
    """Seconds to write ``count`` records of a flight in segments of 64 MiB, a step at a time."""
    rows, steps = flight_rows(count)
    start = now()
    log = SegmentedLog(path, Preamble("bench"))
    for name, part in rows.items():
        log.register(name, part.dtype)
    for step in range(steps):
        for name, n in FLIGHT_ROWS.items():
            log.write(name, rows[name][step * n : (step + 1) * n])
        log.sync(time.monotonic_ns())
    log.close()
    return now() - start


def record_flight(path: Path, count: int) -> Seconds:
    """Seconds of the recorder for the same, from rings filled between its steps."""
    rows, steps = flight_rows(count)
    seconds = np.zeros(2)
    with tempfile.TemporaryDirectory(dir="/dev/shm") as directory:
        rings = {
            name: RingWriter(Path(directory) / f"{name}.ring", part.dtype, 20 * FLIGHT_ROWS[name])
            for name, part in rows.items()
        }
        recorder = Recorder(SegmentedLog(path, Preamble("bench")), [RingReader(ring.path) for ring in rings.values()])
        for step in range(steps):
            for name, n in FLIGHT_ROWS.items():
                rings[name].push(rows[name][step * n : (step + 1) * n])
            start = now()
            recorder.step(time.monotonic_ns())
            seconds += now() - start
        start = now()
        recorder.close(time.monotonic_ns())
        return seconds + now() - start


def write_stock(path: Path, count: int, chunk_bytes: int, compression: str) -> Seconds:
    """Seconds for the stock writer, which is handed messages that are bytes already."""
    per_channel = count // len(CHANNELS)
    messages = {
        name: [b"\0\1\0\0" + row.tobytes() for row in rows_of(dtype, per_channel)] for name, dtype in CHANNELS.items()
    }
    start = now()
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_bytes, compression=CompressionType[compression])
        writer.start(profile="ros2", library="stock")
        numbers = {}
        for name, dtype in CHANNELS.items():
            schema = writer.register_schema(f"heft/msg/{name}", "ros2msg", ros2msg(dtype).encode())
            numbers[name] = writer.register_channel(name, "cdr", schema)
        for n in range(per_channel):
            for name, number in numbers.items():
                writer.add_message(number, n * 1_000_000, messages[name][n], n * 1_000_000, n)
        writer.finish()  # type: ignore[no-untyped-call]  # the package annotates only in part
    return now() - start


def _measure(
    answer: "multiprocessing.SimpleQueue[tuple[Seconds, float]]", work: Callable[..., Seconds], *arguments: object
) -> None:
    seconds = work(*arguments)
    answer.put((seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024))


def measured(work: Callable[..., Seconds], *arguments: object) -> tuple[Seconds, float]:
    """What ``work`` says, and peak MiB, in a fresh process."""
    context = multiprocessing.get_context("spawn")
    answer: Answer = context.SimpleQueue()
    process = context.Process(target=_measure, args=(answer, work, *arguments))
    process.start()
    process.join()
    return answer.get()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=1_000_000)
    parser.add_argument("--directory", type=Path, help="where the logs go while measuring (default: a new one in /tmp)")
    arguments = parser.parse_args()
    count: int = arguments.records
    table = Table("what", "how", "k records/s", "per CPU s", "peak MiB", "file MB", box=None)

    def line(what: str, how: str, records_done: int, result: tuple[Seconds, float], path: Path | None = None) -> None:
        size = "" if path is None else f"{sum(part.stat().st_size for part in segments(path)) / 1e6:.1f}"
        rates = (f"{rate:,.0f}" for rate in records_done / result[0] / 1e3)
        table.add_row(what, how, *rates, f"{result[1]:.0f}", size)

    folder = Path(tempfile.mkdtemp(dir=arguments.directory))
    try:
        ours, stock = folder / "ours.mcap", folder / "stock.mcap"
        for batch in BATCHES:
            line("write", f"ours, {batch} rows a batch", count, measured(write_ours, ours, count, batch), ours)
        for how, work in (("ours, in segments", write_flight), ("ours, recorder from rings", record_flight)):
            log = folder / "flight.mcap"
            line("write flight", how, count, measured(work, log, count), log)
            for path in segments(log):
                path.unlink()
        for size, compression in ((16384, "NONE"), (1 << 20, "NONE"), (1 << 20, "ZSTD")):
            result = measured(write_stock, stock, count, size, compression)
            line("write", f"stock, {size >> 10} KiB chunks, {compression.lower()}", count, result, stock)
    finally:
        shutil.rmtree(folder)
    Console().print(table)


if __name__ == "__main__":
    main()
