"""Campaigns whose workers, scheduler and client are killed at random: every flight once, with the bits of a serial run?

Run ``python -m bench.campaign_kills [--seeds 12] [--kills 9] [--rng 1]``. Short missions of RockSat-X are flown one
after the other in this process; then by ``heft campaign`` on two processes of its own, of which one is killed now and
then; then on a scheduler and two workers, of which, and of the client, one after the other is killed and started again.
Exit code 1: a result is missing, doubled, or not the same to the byte.
"""

import argparse
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from onboard.cli.campaign import fly
from onboard.ground.campaign import plan_file
from onboard.ground.campaign.design import items
from onboard.ground.campaign.revision import revision
from onboard.ground.campaign.store import Content, Store

ROOT = Path(__file__).parents[1]
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
_LONGEST_S = 1800.0


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


def until(happens: Callable[[], bool], longest_s: float = _LONGEST_S) -> None:
    """Wait for something.

    Raises:
        TimeoutError: it does not happen.
    """
    end_s = time.monotonic() + longest_s
    while not happens():
        if time.monotonic() > end_s:
            raise TimeoutError("it did not happen")
        time.sleep(0.05)


def kill_workers(directory: Path, plan: Path, kills: int, rng: np.random.Generator) -> int:
    """A campaign here, one of whose processes is killed now and then; how often."""
    killed = 0
    with running(directory / "scratch", *campaign(directory / "here", plan, "--jobs", "2")) as client:
        done = 0
        while client.poll() is None:
            time.sleep(float(rng.uniform(0.5, 4.0)))
            workers = workers_of(client)
            if killed < kills and workers and len(results(directory / "here")) > done:  # a flight is killed once
                done = len(results(directory / "here"))
                os.kill(int(rng.choice(workers)), signal.SIGKILL)
                killed += 1
    return killed


def kill_anything(directory: Path, plan: Path, kills: int, rng: np.random.Generator) -> list[str]:
    """A campaign on a scheduler and two workers; which of these and of the client was killed, in order."""
    port = free_port()
    scheduler, worker = dask(port)
    out, scratch = directory / "cluster", directory / "scratch"
    words = {
        **{"scheduler": scheduler, "worker 1": worker, "worker 2": worker},
        "client": campaign(out, plan, "--scheduler", f"tcp://127.0.0.1:{port}"),
    }
    killed = list[str]()
    live: dict[str, subprocess.Popen[bytes]] = {}
    with ExitStack() as stack:

        def one_more(before: int) -> bool:
            """Whether there is a result more, or the client is done; what has ended is started again, but for it."""
            for name, its in words.items():
                if name not in live or (name != "client" and live[name].poll() is not None):
                    live[name] = stack.enter_context(running(scratch, *its))
            return live["client"].poll() is not None or len(results(out)) > before

        while "client" not in live or live["client"].poll() is None:
            until(partial(one_more, len(results(out))))
            time.sleep(float(rng.uniform(0.5, 4.0)))
            if len(killed) < kills and live["client"].poll() is None:
                name = str(rng.choice(list(words)))
                live.pop(name).kill()
                killed.append(name)
        return killed


def main() -> int:
    """Print what was killed and whether the results are those of the serial run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--kills", type=int, default=9, help="of each of both campaigns")
    parser.add_argument("--rng", type=int, default=1)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.rng)
    with tempfile.TemporaryDirectory() as temporary:
        directory = Path(temporary)
        plan = directory / "plan.toml"
        plan.write_text(MISSION.format(seeds=arguments.seeds), encoding="utf-8")
        expected = serial(directory / "serial", plan)
        workers = kill_workers(directory, plan, arguments.kills, rng)
        same = results(directory / "here") == expected
        print(f"processes here: {workers} workers killed; {len(expected)} flights, same bytes: {same}", flush=True)
        killed = kill_anything(directory, plan, arguments.kills, rng)
        also = results(directory / "cluster") == expected
        print(f"cluster: killed {', '.join(killed) or 'nothing'}; {len(expected)} flights, same bytes: {also}")
    return int(not (same and also and len(expected) == arguments.seeds))


if __name__ == "__main__":
    sys.exit(main())
