"""Campaigns as processes of their own, and what their results hold."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from onboard.cli.campaign import fly
from onboard.ground.campaign import plan_file
from onboard.ground.campaign.design import items
from onboard.ground.campaign.revision import revision
from onboard.ground.campaign.store import Content, Store

ROOT = Path(__file__).parents[3]
MISSION = """[campaign]
name = "short"
seeds = {seeds}
[flight]
mission = "rocksat"
[scenario]
sequence = [
    {{phase = 0, action = "hold", duration_s = 1.5}},
    {{phase = 3, action = "strokes", strokes = 5, amplitude = {{joint_1 = 0.21}}, stroke_s = 0.6, transfer_s = 0.5}},
    {{phase = 9, action = "hold", duration_s = 0.2}},
]
"""


def serial(directory: Path, plan: Path) -> dict[str, bytes]:
    """What each file of results holds when the flights are flown one after the other in this process."""
    read = plan_file.read(plan)
    code = revision(read.file.flight.call or "")
    flights = {item.address(code): item for item in items(read)}
    store = Store(directory)
    store.begin(Content("serial", "", code, flights))
    for address, item in flights.items():
        store.take(address, item, code, fly(item, code))
    return results(directory)


def results(directory: Path) -> dict[str, bytes]:
    """Content of each file of results; empty before the first."""
    return {path.name: path.read_bytes() for path in sorted((directory / "flights").glob("*.parquet"))}


@contextmanager
def running(scratch: Path, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A Python that runs ``words``, with temporary files below ``scratch``; ended with the context."""
    scratch.mkdir(exist_ok=True)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "TMPDIR": str(scratch)}
    with (
        (scratch / f"{time.monotonic_ns()}.log").open("w") as said,
        subprocess.Popen([sys.executable, *words], env=environment, stdout=said, stderr=said) as process,
    ):
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                process.terminate()
                process.wait(60)


def campaign(out: Path, plan: Path, *more: str) -> tuple[str, ...]:
    """Words of a Python that runs a campaign."""
    return ("-m", "onboard.cli", "campaign", str(plan), "-o", str(out), *more)


def dask(port: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Words of a Python that is Dask's scheduler, and of one that is a worker with one process."""
    host = ("--host", "127.0.0.1", "--port", str(port))
    return (
        ("-m", "distributed.cli.dask_scheduler", *host, "--no-dashboard"),
        (
            "-m",
            "distributed.cli.dask_worker",
            f"tcp://127.0.0.1:{port}",
            "--nthreads",
            "1",
            "--no-nanny",
            "--no-dashboard",
        ),
    )


def free_port() -> int:
    """One that nobody listens on."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def workers_of(process: subprocess.Popen[bytes]) -> list[int]:
    """Processes that a campaign has spawned to fly."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            if int(fields[1]) == process.pid and b"spawn_main" in path.with_name("cmdline").read_bytes():
                found.append(int(path.parent.name))
    return found


def until(happens: Callable[[], bool], longest_s: float) -> None:
    """Wait for something.

    Raises:
        TimeoutError: it does not happen.
    """
    end_s = time.monotonic() + longest_s
    while not happens():
        if time.monotonic() > end_s:
            raise TimeoutError("it did not happen")
        time.sleep(0.05)
