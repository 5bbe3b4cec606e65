"""Reading logs: dumps beside the stock ``mcap`` package and the csv module; the report of a long flight.

::

    python bench/reading.py [--records N] [--minutes M] [--directory DIR]

The dumps are of N records (10^6) of one IMU, raw and SI. Each line is measured in a process of its own, whose peak
memory is given. The flight is RockSat-X with its sweeps repeated to M minutes (10; 0 leaves it out), flown in virtual
time first, which takes a minute or two by itself. The stock reader gets a quarter of the records: it is that slow.
"""

import argparse
import csv
import multiprocessing
import os
import shutil
import tempfile
import time
import tomllib
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory
from rich.console import Console
from rich.table import Table

from bench.recording import rows_of
from drivers import records
from onboard.ground.log.export.dump import dump
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter

STOCK_SHARE = 4
BARS = {"csv": 500, "parquet": 600}  # k records/s
PEAK_MIB = 250
REPORT_S, READING_MIB = 15.0, 300


def write_imu(path: Path, count: int) -> None:
    """A log of one IMU: noise of some hundred counts at 1 kHz."""
    rows = rows_of(records.IMU, count)
    with LogWriter.create(path, overwrite=True, durable=False) as writer:
        writer.register("imu_0", records.IMU)
        for first in range(0, count, 100):
            writer.write("imu_0", rows[first : first + 100])


def read_ours(path: Path) -> None:
    """Read every row."""
    assert sum(len(batch.rows) for batch in LogReader(path).batches())


def read_stock(path: Path) -> None:
    """Read every message with the stock reader, without decoding it."""
    with path.open("rb") as file:
        assert sum(1 for _ in NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False))


def dump_ours(path: Path, directory: Path, kind: str) -> None:
    """Dump a log, raw and SI."""
    dump(path, directory, kind=kind)


def dump_stock(path: Path, directory: Path) -> None:
    """The stock reader, ``mcap-ros2-support`` and the csv module, raw only."""
    directory.mkdir(parents=True, exist_ok=True)
    with path.open("rb") as file, (directory / "stock.csv").open("w", newline="") as out:
        table = csv.writer(out)
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, _, _, message in reader.iter_decoded_messages():
            cells: list[object] = []
            for name in message.__slots__:
                value = getattr(message, name)
                cells += value if isinstance(value, list | tuple) else [value]
            table.writerow(cells)


def write_report(path: Path, output: Path) -> None:
    """Make the report."""
    from onboard.ground.report import report

    report(path, output)


def replay_all(path: Path) -> None:
    """Replay a flight, which must be identical."""
    from onboard.ground.identify.replay.replay import replay

    assert replay(path).identical


def fly_long(path: Path, minutes: float) -> float:
    """Fly RockSat-X with its sweeps repeated, with the tip mass and without; returns its length in s."""
    from hil_sim.mission import open_in_process
    from hil_sim.scenario.load import load
    from onboard import config
    from onboard.flight import hil
    from onboard.ground.log.tables import truth

    table = tomllib.loads(files("hil_sim.scenario").joinpath("packaged", "rocksat.toml").read_text(encoding="utf-8"))
    sequence = table["sequence"]
    eject = next(n for n, part in enumerate(sequence) if part["phase"] == 5)
    sweeps = [n for n, part in enumerate(sequence) if part["action"] == "strokes"]
    held, free = sequence[sweeps[0] : eject], sequence[sweeps[2] : sweeps[3] + 2]
    times = max(1, round((60 * minutes - 22) / 41.8))  # s of both pairs of sweeps
    flown = [*sequence[: sweeps[0]], *held * times, sequence[eject], *free * times, *sequence[sweeps[3] + 2 :]]
    scenario = load("rocksat", {"sequence": flown, "air": {"reference_s": 60 * minutes}})
    vehicle = config.load(config.packaged("rocksat"))
    world, urls = open_in_process(scenario, 1)
    with world:
        made = hil.fly_simulated(vehicle, world, urls, path)
    truth.write(path, made.truth)
    return float(made.truth["duration_s"])


def _measure(
    answer: "multiprocessing.SimpleQueue[tuple[float, float]]", work: Callable[..., None], *what: object
) -> None:
    started = time.perf_counter()
    work(*what)
    seconds = time.perf_counter() - started
    # not ru_maxrss, which begins with what the parent had when it forked
    status = Path("/proc/self/status").read_text(encoding="ascii")
    answer.put((seconds, int(status.split("VmHWM:")[1].split()[0]) / 1024))


def measured(work: Callable[..., None], *arguments: object) -> tuple[float, float]:
    """Seconds, and peak MiB, in a fresh process."""
    context = multiprocessing.get_context("spawn")
    answer = context.SimpleQueue()
    process = context.Process(target=_measure, args=(answer, work, *arguments))
    process.start()
    process.join()
    if process.exitcode:
        raise RuntimeError(f"{work.__name__} failed; its message stands above")
    seconds, peak_MiB = answer.get()
    return seconds, peak_MiB


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=1_000_000)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument(
        "--directory", type=Path, help="where the files go while measuring (default: a new one in /tmp)"
    )
    arguments = parser.parse_args()
    count: int = arguments.records
    table = Table("what", "how", "measured", "bar", "peak MiB", "bar", box=None)
    folder = Path(tempfile.mkdtemp(dir=arguments.directory))

    def rate(what: str, how: str, done: int, result: tuple[float, float], bar: int | None, peak: int | None) -> None:
        bars = ["" if limit is None else str(limit) for limit in (bar, peak)]
        table.add_row(what, how, f"{done / result[0] / 1e3:,.0f} k records/s", bars[0], f"{result[1]:.0f}", bars[1])

    try:
        imu = folder / "imu.mcap"
        write_imu(imu, count)
        rate("read", "ours, decoded", count, measured(read_ours, imu), None, PEAK_MIB)
        rate("read", "stock mcap, not decoded", count, measured(read_stock, imu), None, None)
        for kind in ("csv", "parquet", "npz", "mat"):
            result = measured(dump_ours, imu, folder / kind, kind)
            rate(f"dump IMU to {kind}", "ours, raw and SI", count, result, BARS.get(kind), PEAK_MIB)
            shutil.rmtree(folder / kind)
        write_imu(imu, count // STOCK_SHARE)
        result = measured(dump_stock, imu, folder / "stock")
        rate("dump IMU to csv", "stock mcap + csv module, raw", count // STOCK_SHARE, result, None, None)
        if arguments.minutes:
            flight = folder / "flight.mcap"
            length_s = fly_long(flight, arguments.minutes)
            size = f"{length_s:.0f} s, {flight.stat().st_size / 1e6:.0f} MB"
            seconds, peak = measured(write_report, flight, folder / "report.html")
            table.add_row(
                f"report of {size}", "", f"{seconds:.1f} s", f"{REPORT_S:.0f}", f"{peak:.0f}", str(READING_MIB)
            )
            seconds, peak = measured(replay_all, flight)
            table.add_row(
                f"replay of {size}", "", f"{length_s / seconds:.0f} x real time", "", f"{peak:.0f}", str(READING_MIB)
            )
    finally:
        shutil.rmtree(folder)
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
