"""What a record costs from the wire into the ring, beside the loop that makes one object of each sample.

::

    python bench/acquisition.py [--rounds 41] [--json FILE]

CPU time (``process_time_ns``) of a pump of the real driver and a push of all its rows into rings, divided by the
records (samples, frames, lines) of that pump; the port is one in memory unless the line says otherwise, and filling it
is not counted. Each figure is the median of rounds; ours and the naive loop take turns within a round. The naive loop
unpacks each record with ``struct`` (or ``int``), checks it the same way where there is a checksum, makes a dataclass
object of it and keeps that ("objects"); "to ring" is that and a push of a row for each object, to where ours ends. It
unwraps, numbers and accounts for nothing. The collector is frozen and on, as in the worker that flies; nothing else is
tuned. Exit code 1 where a bar is missed.
"""

import argparse
import gc
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from itertools import chain
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import can
import numpy as np

from bench.pumps.can_bus import slcan_case, socket_case, virtual_case
from bench.pumps.case import CAPACITY, PumpCase, Rings, push_one_by_one
from bench.pumps.streams import mpu6050_cases, node_case, qsb_case
from drivers import records
from onboard.ring import RingWriter

ROOT = Path(__file__).resolve().parents[1]
PUMPS = 25  # in a round
IMPORT_ROUNDS = 9
IMPORT_BAR_S = 0.15
ROOMS = (
    *("canopen_pdo", "dsc_load_cell", "modbus_load_cell", "mpu6050", "nimu"),
    *("node_frame", "qsb", "sync_pulse", "transports"),
)


class MeasuredCase(NamedTuple):
    """A case measured, us a record."""

    name: str
    bar: float
    ours: float
    objects: float
    to_ring: float


def measured(case: PumpCase, rounds: int, ring: RingWriter) -> MeasuredCase:
    """Medians over ``rounds`` of the mean of ``PUMPS``, us a record.

    Raises:
        RuntimeError: Other rows came than had to: the measurement is worth nothing.
    """
    clock = time.process_time_ns
    figures: tuple[list[float], list[float], list[float]] = ([], [], [])
    for number in range(rounds + 2):
        ours_ns = objects_ns = pushes_ns = 0
        for _ in range(PUMPS):
            case.fill()
            began = clock()
            rows = case.ours()
            ours_ns += clock() - began
            if rows != case.rows:
                raise RuntimeError(f"{case.name}: {rows} rows where {case.rows} had to come")
            case.naive_fill()
            began = clock()
            case.naive()
            made = clock()
            push_one_by_one(case.samples, ring)
            objects_ns += made - began
            pushes_ns += clock() - made
        if number >= 2:  # two to warm up
            for total_ns, figure in zip((ours_ns, objects_ns, objects_ns + pushes_ns), figures, strict=True):
                figure.append(1e-3 * total_ns / (PUMPS * case.records))
    return MeasuredCase(case.name, case.bar, *map(statistics.median, figures))


def import_seconds(modules: str) -> tuple[float, float]:
    """CPU and wall time that a fresh interpreter takes to import ``modules``, medians, s."""
    code = f"import time; w, c = time.perf_counter(), time.process_time(); import {modules}; "
    code += "print(time.process_time() - c, time.perf_counter() - w)"
    runs = [
        subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
        for _ in range(IMPORT_ROUNDS)
    ]
    times = [tuple(map(float, run.stdout.split())) for run in runs]
    return statistics.median(cpu for cpu, _ in times), statistics.median(wall for _, wall in times)


def machine() -> str:
    """What it is measured on."""
    model = platform.processor() or platform.machine()
    with Path("/proc/cpuinfo").open(encoding="ascii", errors="replace") as file:
        model = next((line.partition(":")[2].strip() for line in file if line.startswith("model name")), model)
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    versions = f"Python {platform.python_version()}, NumPy {np.__version__}, python-can {can.__version__}"
    collector = "on" if gc.isenabled() else "off"
    return f"{model}, {os.cpu_count()} cores, load {load}; {versions}; collector frozen and {collector}"


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=21)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures too")
    arguments = parser.parse_args()
    shared = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=shared if shared.is_dir() else None) as folder:
        rings, ring = Rings(Path(folder)), RingWriter(Path(folder) / "naive.ring", records.SCALAR, CAPACITY)
        cases = chain(  # each made when it is measured: a driver reports that its bus was not read for so long
            mpu6050_cases(rings),
            (node_case(rings, count, channels) for count, channels in ((10, 1), (100, 1), (100, 3))),
            (qsb_case(rings, count) for count in (10, 100)),
            (make(rings, rounds) for make in (virtual_case, slcan_case, socket_case) for rounds in (2, 20)),
        )
        gc.collect()
        gc.freeze()
        print(machine())
        print(f"CPU us a record, medians of {arguments.rounds} rounds of {PUMPS} pumps\n")
        print(f"{'':64}{'ours':>8}{'bar':>8}{'objects':>10}{'to ring':>10}")
        lines = []
        for case in cases:
            gc.freeze()
            lines.append(line := measured(case, arguments.rounds, ring))
            missed = "  MISSED" if line.ours > line.bar else ""
            naive = f"{line.objects:10.2f}{line.to_ring:10.2f}"
            print(f"{line.name:64}{line.ours:8.2f}{line.bar:8.2f}{naive}{missed}", flush=True)
    print(f"\n{'s, fresh interpreter':64}{'CPU':>8}{'bar':>8}{'wall':>8}")
    rooms = ", ".join(f"drivers.{room}" for room in ROOMS)
    slow = False
    for name, modules in (("import numpy alone", "numpy"), ("import drivers, every room", rooms)):
        cpu, wall = import_seconds(modules)
        slow = cpu > IMPORT_BAR_S and modules == rooms
        print(f"{name:64}{cpu:8.3f}{IMPORT_BAR_S:8.3f}{wall:8.3f}{'  MISSED' if slow else ''}", flush=True)
    if arguments.json:
        text = json.dumps({"machine": machine(), "us": [line._asdict() for line in lines], "import_s": [cpu, wall]})
        arguments.json.write_text(text, encoding="utf-8")
    return int(slow or any(line.ours > line.bar for line in lines))


if __name__ == "__main__":
    sys.exit(main())
