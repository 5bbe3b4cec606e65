"""What the page costs a flight in real time: 20 viewers, 300 sockets that say nothing, streams that nobody reads.

    python -m bench.page [--vehicle rocksat] [--seconds 20] [--load 0]

The same flight without a page, and then with one that everybody looks at: rows missing, the age of the newest row in a
device's ring (median and p99, looked at every 5 ms), CPU and memory of the page's process, frames that the viewers had
and that they were left out, how soon the first answer of the page comes. One viewer has 200 kbit/s.

Bars (exit code 1 where one is missed): nothing missing or unrecorded, the page at most 5 % of a core and 60 MB, every
fast viewer has every frame. Latency is printed and not judged: on a busy computer it is the computer's.
"""

import argparse
import contextlib
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench import given
from bench.real_flight import RealFlight, busy, cpu_s, flying, longer, pss_mb
from onboard.recording.reader import LogReader
from onboard.ring import RingReader

VIEWERS, SILENT, STALLED = 20, 300, 15
SLOW_BYTES_S = 25_000  # 200 kbit/s
CORE_PERCENT, MEMORY_MB = 5.0, 60.0
BUFFER = 4096


class Ages(NamedTuple):
    """Of the newest row of a ring, ms."""

    median: float
    p99: float


class Viewer(threading.Thread):
    """Takes frames, at most ``bytes_s`` bytes a second."""

    def __init__(self, port: int, over: threading.Event, bytes_s: float = 0.0) -> None:
        super().__init__(daemon=True)
        self._port, self._over, self._bytes_s = port, over, bytes_s
        self.frames = self.skipped = 0

    def run(self) -> None:
        """Until it is over."""
        with stream(self._port, BUFFER if self._bytes_s else None) as connection:
            connection.settimeout(5.0)
            got = b""
            while not self._over.is_set():
                block = connection.recv(BUFFER if self._bytes_s else 1 << 16)
                if not block:
                    return
                got += block
                *whole, got = got.split(b"\n\n")
                for one in whole:
                    if one.startswith(b"data: "):
                        self.frames += 1
                        self.skipped = int(json.loads(one[6:])["skipped"])
                if self._bytes_s:
                    time.sleep(len(block) / self._bytes_s)


def stream(port: int, buffer: int | None) -> socket.socket:
    """A connection that has asked for frames."""
    connection = socket.socket()
    if buffer is not None:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
    connection.connect(("127.0.0.1", port))
    connection.sendall(f"GET /live HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n".encode())
    return connection


def ages(flight: RealFlight, channel: str, seconds: float) -> Ages:
    """Of the newest row of ``channel``, looked at every 5 ms."""
    reader, found = RingReader(flight.rings / f"{channel}.ring"), []
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        reader.position = max(0, reader.published - 1)
        rows, _ = reader.read(1)
        if len(rows):
            found.append((time.monotonic_ns() - int(rows["host_ns"][-1])) * 1e-6)
        time.sleep(0.005)
    reader.close()
    return Ages(float(np.median(found)), float(np.percentile(found, 99.0)))


def silent(port: int, over: threading.Event) -> None:
    """Keep :data:`SILENT` sockets open of which half have begun a request; the server ends them after a while."""
    while not over.is_set():
        with contextlib.ExitStack() as stack:
            for number in range(SILENT):
                with contextlib.suppress(OSError):
                    one = stack.enter_context(socket.create_connection(("127.0.0.1", port), 5.0))
                    if number % 2:
                        one.sendall(b"GET /live HT")
            over.wait(6.0)


def looked_at(flight: RealFlight, channel: str, seconds: float) -> tuple[Ages, list[str], list[str]]:
    """Ages while everybody looks; what came of the page, and the bars missed."""
    command = [sys.executable, "-m", "onboard.page", str(flight.log), ":0"]
    over, began_s = threading.Event(), time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as page:
        assert page.stdout is not None
        port = int(page.stdout.readline().rstrip("/\n").rpartition(":")[2])
        viewers = [Viewer(port, over) for _ in range(VIEWERS)]
        slow = Viewer(port, over, SLOW_BYTES_S)
        with contextlib.ExitStack() as stack:
            for _ in range(STALLED):
                stack.enter_context(stream(port, BUFFER))
            threads = [*viewers, slow, threading.Thread(target=silent, args=(port, over), daemon=True)]
            for one in threads:
                one.start()
            while not all(one.frames for one in viewers):
                time.sleep(0.01)
            first_s, before_s, then_s = time.monotonic() - began_s, cpu_s(page.pid), time.monotonic()
            had = [one.frames for one in viewers]
            found = ages(flight, channel, seconds)
            lasted_s = time.monotonic() - then_s
            core = 100.0 * (cpu_s(page.pid) - before_s) / lasted_s
            memory, taken = pss_mb(page.pid), [one.frames - then for one, then in zip(viewers, had, strict=True)]
            over.set()
            for one in threads:
                one.join(20.0)
        page.terminate()
    skipped = sum(one.skipped for one in viewers)
    lines = [
        f"first frame {first_s:.1f} s after the process was started; page {core:.1f} % of a core, PSS {memory:.0f} MB",
        f"{VIEWERS} viewers: {min(taken)} to {max(taken)} frames in {lasted_s:.0f} s, {skipped} left out",
        f"viewer of {8e-3 * SLOW_BYTES_S:.0f} kbit/s: {slow.frames} frames, {slow.skipped} left out; "
        f"{SILENT} silent sockets, {STALLED} streams that nobody reads",
    ]
    missed = [f"the page took {core:.1f} % of a core"] if core > CORE_PERCENT else []
    missed += [f"the page has {memory:.0f} MB"] if memory > MEMORY_MB else []
    missed += [f"{skipped} frames left out of fast viewers"] if skipped else []
    return found, lines, missed


def main() -> int:
    """Print both halves, and the bars missed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--vehicle", choices=given.rehearsed(), default="rocksat")
    parser.add_argument("--channel", default="joint_1")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each half (default 20)")
    parser.add_argument("--load", type=int, default=0, help="processes that only compute (default 0)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch, busy(options.load):
        place = Path(scratch)
        over = longer(options.vehicle, 2.0 * options.seconds + 40.0, place)
        with flying(options.vehicle, place, name="page", over=over) as flight:
            time.sleep(5.0)
            alone = ages(flight, options.channel, options.seconds)
            seen, lines, missed = looked_at(flight, options.channel, options.seconds)
            code = flight.end()
        log = LogReader(flight.log)
        health = log.read("health")[-1]
        gaps = len(log.read("gap"))
    told = zip(("without the page", "with it"), (alone, seen), strict=True)
    ages_said = "; ".join(f"{name} {one.median:.1f} ms, p99 {one.p99:.1f} ms" for name, one in told)
    print(f"{options.vehicle}, {options.load} busy processes; age of the newest row of {options.channel}: {ages_said}")
    print(*lines, sep="\n")
    lost = f"missing {int(health['missing'])} rows in {gaps} gaps, not recorded {int(health['not_recorded'])}"
    print(f"{lost}; exit code {code}")
    missed += ["rows are missing"] if health["missing"] or health["not_recorded"] or code else []
    print(*(f"MISSED: {one}" for one in missed), sep="\n", end="\n" if missed else "")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
