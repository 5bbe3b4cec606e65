"""What a flight in real time costs and how late its answers are.

    python -m bench.flight [--vehicle dymaflex] [--minutes 1] [--load 0] [--nice 0] [--quick] [--telemetry] [--seen]
        [--json FILE]

Prints CPU time and memory (PSS) of each process, the latency from sample to estimate, what is lost, and the answers.
Latency: a row of the regression is due ``lag_ms`` after its instant of vehicle time, and steps that make rows come
every ``step_ms``; the two are the stated lag. How much later than that the row stands in its ring is printed, seen by a
process that looks every 2 ms. ``--load N``: N processes that only compute, beside it. ``--minutes`` lengthens the
mission's longest motion. ``--quick``: 20 s, and no bar is judged. ``--telemetry``: the flight sends its packets over a
serial line (a pty) at 19,200 baud, which is read all the time, and what came is printed. ``--seen``: that, the page
with a viewer, and the server for Foxglove, all at once; how long the first answer takes from its ring to the viewer is
printed.

Bars (exit code 1 where one is missed): p99 beyond the stated lag 20 ms without load, 1 s with it; no row lost by the
recorder, none missing without a gap record; the answers hold the truth in their 95 % intervals; without load PSS of all
200 MB, and of a core supervisor 1 %, recorder 3 %, acquisition 8 % and estimation 12 %.
"""

import argparse
import json
import os
import pty
import socket
import sys
import tempfile
import threading
import time
import tty
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

import numpy as np

from bench import given
from bench.real_flight import WORKERS, RealFlight, all_processes, busy, cpu_s, flying, longer, pss_mb, waited_s
from onboard import config
from onboard.ground.log.views.info import info
from onboard.recording.reader import LogReader
from onboard.ring import RingReader
from onboard.telemetry.stream import Series, Splitter

LOOK_S = 0.002
WARM_UP_S = 4.0
PRIORITY = 30
PAGE_PORT = 8799
SEEN = ["--live", "--page-address", f"127.0.0.1:{PAGE_PORT}"]
QUICK_S = 20.0
LATEST_MS, LATEST_AT_LOAD_MS = 20.0, 1000.0
PSS_MB = 200.0
CPU_PERCENT = {"supervisor": 1.0, "recording": 3.0, "acquisition": 8.0, "estimation": 12.0}


def watch(flight: RealFlight, seconds: float, lag_ms: float) -> tuple[np.ndarray, dict[str, Any]]:
    """Latency of each row beyond ``lag_ms`` [ms], and by process CPU, waits for a core and PSS, in so many seconds."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        print("the bench has no real-time priority: latencies contain its own")
    reader = RingReader(flight.rings / "row.ring")
    reader.position = reader.published
    before = {pid: (cpu_s(pid), waited_s(pid)) for pid in all_processes(flight.process.pid)}
    began_s = time.monotonic()
    late: list[np.ndarray] = []
    while time.monotonic() - began_s < seconds and flight.process.poll() is None:
        if reader.backlog:
            now_ns = time.monotonic_ns()
            late.append(1e-6 * (now_ns - reader.read()[0]["vehicle_ns"]) - lag_ms)
        time.sleep(LOOK_S)
    passed_s = time.monotonic() - began_s
    used: dict[str, list[float]] = {}
    for pid, name in all_processes(flight.process.pid).items():
        cpu, waits, pss = used.setdefault(WORKERS.get(name, name), [0.0, 0.0, 0.0])
        had = before.get(pid, (0.0, 0.0))
        spent = [100 * (now - past) / passed_s for now, past in zip((cpu_s(pid), waited_s(pid)), had, strict=True)]
        used[WORKERS.get(name, name)] = [cpu + spent[0], waits + spent[1], pss + pss_mb(pid)]
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    keys = ("cpu_percent", "waits_percent", "pss_mb")
    said = {name: dict(zip(keys, numbers, strict=True)) for name, numbers in used.items()}
    return np.concatenate([np.empty(0), *late]), said


class Ground:
    """What came over the line."""

    def __init__(self) -> None:
        self.data = b""

    def told(self, apids: dict[str, int]) -> str:
        """Packets by kind, and bytes a second."""
        stream, series = Splitter(apids), Series()
        found = stream.feed(self.data) + stream.finish()
        kinds = Counter(packet.kind.name for packet in found if series.place(packet).new)
        of = ", ".join(f"{name} {count}" for name, count in sorted(kinds.items()))
        times_ns = [packet.at_ns for packet in found if packet.kind.name == "status"]
        seconds = max(1.0, (times_ns[-1] - times_ns[0]) * 1e-9) if times_ns else 1.0
        said = f"{len(self.data) / seconds:.0f} bytes/s; missing {sum(series.missing.values())}"
        last = [packet.values for packet in found if packet.kind.name == "status"][-1:]
        unsent = {name: value for one in last for name, value in one.items() if name.startswith(("unsent", "overdue"))}
        return f"telemetry: {of}; {said}, bytes of no packet {stream.skipped}; {unsent}"


@contextmanager
def first_answer(flight: RealFlight) -> Iterator[list[str]]:
    """A viewer of the page from the flight's start on; how long the first answer took to it."""
    told: list[str] = []
    over = threading.Event()

    def look() -> None:
        reader = None
        while reader is None and not over.is_set():
            with suppress(OSError, ValueError):
                reader = RingReader(flight.rings / "quantity.ring")
            time.sleep(LOOK_S)
        while reader is not None and not reader.published and not over.is_set():
            time.sleep(LOOK_S)
        began_s = time.monotonic()
        if reader is not None:
            reader.close()
        with suppress(TimeoutError, OSError):
            seen.wait(20.0)
            told.append(f"page: the first answer came to a viewer {at_s[0] - began_s:.2f} s after it stood in its ring")

    def view() -> None:
        with socket.create_connection(("127.0.0.1", PAGE_PORT), 20.0) as connection:
            connection.sendall(f"GET /live HTTP/1.1\r\nHost: localhost:{PAGE_PORT}\r\n\r\n".encode())
            got = b""
            while not over.is_set() and (block := connection.recv(1 << 16)):
                got = (got + block)[-(1 << 20) :]
                if not seen.is_set() and b'"held":[{' in got:
                    at_s.append(time.monotonic())
                    seen.set()

    at_s: list[float] = []
    seen = threading.Event()
    threads = [threading.Thread(target=one, daemon=True) for one in (look, view)]
    for one in threads:
        one.start()
    yield told
    over.set()


@contextmanager
def serial_line() -> Iterator[tuple[str, Ground]]:
    """The link of a line at 19,200 baud, and what comes over it."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    ground = Ground()

    def read() -> None:
        while True:
            try:
                ground.data += os.read(master, 4096)
            except OSError:
                return  # it was closed

    threading.Thread(target=read, daemon=True).start()
    yield f"serial://{os.ttyname(slave)}?baud=19200", ground
    os.close(slave)
    os.close(master)


def answers(log: Path, truth: dict[str, Any]) -> list[dict[str, Any]]:
    """The last answers of a log that have a unit, and what is true of the payload's mass."""
    rows = LogReader(log).read("quantity")
    rows = rows[(rows["supported"] == 1) & (rows["unit"] != b"")]
    last = {row["name"].decode(): row for row in rows}
    known = {name: float(value) for name, value in truth.get("quantities", {}).items()}
    return [
        {
            "name": name,
            **{field: float(row[field]) for field in ("value", "low", "high")},
            "unit": row["unit"].decode(),
            "truth": known.get(name),
        }
        for name, row in last.items()
    ]


def main() -> int:
    """Fly, print, judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--vehicle", choices=given.rehearsed(), default="dymaflex", help="a packaged one with a scenario"
    )
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--load", type=int, default=0)
    parser.add_argument("--nice", type=int, default=0)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--telemetry", action="store_true")
    parser.add_argument("--seen", action="store_true", help="with telemetry, page and Foxglove at once")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    seconds = QUICK_S if options.quick else 60.0 * options.minutes
    options.telemetry |= options.seen
    settings = config.named(options.vehicle).file.estimation
    stated_ms = settings.lag_ms + settings.step_ms
    with tempfile.TemporaryDirectory() as directory:
        place = Path(directory)
        over = longer(options.vehicle, seconds + WARM_UP_S + 20.0, place)
        with (
            serial_line() as (link, ground),
            busy(options.load),
            flying(
                options.vehicle,
                place,
                name="bench",
                over=over,
                nice=options.nice,
                also=[*(["--telemetry", link] if options.telemetry else []), *(SEEN if options.seen else [])],
            ) as flight,
            first_answer(flight) if options.seen else nullcontext("") as answered,
        ):
            time.sleep(WARM_UP_S)
            late_ms, used = watch(flight, seconds, stated_ms)
            load = os.getloadavg()[0]
            code = flight.end()
            flight.devices.terminate()
            assert flight.devices.stdout is not None
            said = json.loads(flight.devices.stdout.readline())
        about = info(flight.log)
        log = LogReader(flight.log)
        result = {
            "vehicle": options.vehicle,
            "seconds": seconds,
            "load_average": load,
            "exit_code": code,
            "rows": len(late_ms),
            "late_ms": shares(late_ms),
            "late_end_ms": shares(late_ms[len(late_ms) // 2 :]),
            "processes": used,
            "pss_mb": sum(one["pss_mb"] for one in used.values()),
            "recorder_gaps": len(log.read("recorder_gap")),
            "unexplained": about.unexplained,
            "missing": sum(one.missing for one in about.channels),
            "restarts": int(log.read("health")["restarts"][-1]),
            "answers": answers(flight.log, said["truth"]),
        }
    show(result, stated_ms)
    if options.telemetry:
        print(ground.told(config.named(options.vehicle).file.telemetry.apids))
    print(*answered, sep="\n", end="\n" if answered else "")
    if options.json:
        options.json.write_text(json.dumps(result), encoding="utf-8")
    missed = [] if options.quick else judge(result, at_load=bool(options.load))
    for text in missed:
        print(f"MISSED {text}")
    return int(bool(missed))


def shares(late_ms: np.ndarray) -> dict[str, float]:
    """Median, p99 and largest; nothing of nothing."""
    return {f"p{share}": float(np.percentile(late_ms, share)) for share in (50, 99, 100)} if len(late_ms) else {}


def show(result: dict[str, Any], stated_ms: float) -> None:
    """Print it."""
    print(
        f"{result['vehicle']}, {result['seconds']:.0f} s, load average {result['load_average']:.1f}, "
        f"exit code {result['exit_code']}"
    )
    for name, one in sorted(result["processes"].items()):
        waits = f"waits for one {one['waits_percent']:5.1f} % of the time"
        print(f"  {name:16}{one['cpu_percent']:6.1f} % of a core, {waits}{one['pss_mb']:8.1f} MB")
    print(f"  all{sum(one['cpu_percent'] for one in result['processes'].values()):19.1f} %{result['pss_mb']:50.1f} MB")
    late = ", ".join(f"{name} {value:.1f}" for name, value in result["late_ms"].items()).replace("p100", "max")
    print(f"sample to estimate, beyond lag_ms + step_ms = {stated_ms:g} ms [ms]: {late} ({result['rows']} rows)")
    if result["late_end_ms"]:  # what it was behind after its start is worked off
        print(f"  of their second half: p50 {result['late_end_ms']['p50']:.1f}, p99 {result['late_end_ms']['p99']:.1f}")
    print(
        f"rows missing {result['missing']}, in no gap record {result['unexplained']}, gaps of the recorder "
        f"{result['recorder_gaps']}, restarts {result['restarts']}"
    )
    for one in result["answers"]:
        truth = "" if one["truth"] is None else f", truth {one['truth']:.6g}"
        print(f"  {one['name']} {one['value']:.6g} {one['unit']} ({one['low']:.6g} to {one['high']:.6g}){truth}")


def judge(result: dict[str, Any], *, at_load: bool) -> list[str]:
    """The bars that were missed."""
    bar_ms = LATEST_AT_LOAD_MS if at_load else LATEST_MS
    late_ms = result["late_ms"].get("p99", float("inf"))
    missed = [f"p99 {late_ms:.1f} ms, bar {bar_ms:g}"] if late_ms > bar_ms else []
    missed += [
        f"{result[key]} {key.replace('_', ' ')}" for key in ("recorder_gaps", "unexplained", "exit_code") if result[key]
    ]
    wrong = [
        one["name"]
        for one in result["answers"]
        if one["truth"] is not None and not one["low"] <= one["truth"] <= one["high"]
    ]
    missed += [f"wrong: {', '.join(wrong)}"] if wrong else []
    missed += [] if result["answers"] else ["no answer"]
    if not at_load:
        missed += [f"PSS {result['pss_mb']:.0f} MB, bar {PSS_MB:g}"] if result["pss_mb"] > PSS_MB else []
        for name, bar in CPU_PERCENT.items():
            used = result["processes"].get(name, {}).get("cpu_percent", float("inf"))
            missed += [f"{name} {used:.1f} % of a core, bar {bar:g}"] if used > bar else []
    return missed


if __name__ == "__main__":
    sys.exit(main())
