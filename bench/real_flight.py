"""A flight in real time against simulated devices, as the benches here watch it: processes, memory, load."""

import json
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

import tomli_w

import hil_sim.scenario
from hil_sim.scenario import bed
from onboard import config
from onboard.flight.store import manifest

WORKERS = {"heft-record": "recording", "heft-estimate": "estimation", "heft-acquire": "acquisition"}
START_S = 90.0  # beside the time that a long mission takes to be integrated
LONG_S, LONG_STEPS = 200.0, 40


class RealFlight(NamedTuple):
    """One that is under way.

    Attributes:
        process: the supervisor.
        devices: the process of the simulated devices.
        log: where it records.
        rings: its directory in shared memory.
    """

    process: "subprocess.Popen[bytes]"
    devices: "subprocess.Popen[str]"
    log: Path
    rings: Path

    def end(self) -> int:
        """Stop it in order; its exit code."""
        self.process.terminate()
        return self.process.wait(120)


@contextmanager
def busy(count: int) -> Iterator[None]:
    """So many processes that only compute."""
    with ExitStack() as stack:
        for _ in range(count):
            one = subprocess.Popen([sys.executable, "-c", "while True: pass"], start_new_session=True)
            stack.callback(one.wait)
            stack.callback(one.kill)
        yield


def processes(supervisor: int) -> dict[str, int]:
    """Processes of heft below ``supervisor``, by name; of spare ones the last."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, _, rest = entry.read_text().partition("(")[2].rpartition(")")
        except OSError:
            continue
        if int(rest.split()[1]) == supervisor and name.startswith("heft-"):
            found[name] = int(entry.parent.name)
    return found


def all_processes(supervisor: int) -> dict[int, str]:
    """The supervisor and every process below it, with their names."""
    children = Path(f"/proc/{supervisor}/task/{supervisor}/children").read_text().split()
    names = {int(pid): Path(f"/proc/{pid}/comm").read_text().strip() for pid in children}
    return {supervisor: "supervisor", **names}


def pss_mb(pid: int) -> float:
    """Memory of a process [MB], what it shares divided by those that share it."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) * 1.024e-3


def pss_by_kind_mb(pid: int) -> dict[str, float]:
    """:func:`pss_mb` by kind: Anon (a process's own), File (programs), Shmem (rings that it has touched)."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return {line.split(":")[0][4:]: int(line.split()[1]) * 1.024e-3 for line in lines if line.startswith("Pss_")}


def cpu_s(pid: int) -> float:
    """CPU time that a process has had."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def waited_s(pid: int) -> float:
    """Time that a process was ready to run and had no core, all of its threads."""
    threads = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(one.read_text().split()[1]) for one in threads) * 1e-9


def memory_line(supervisor: int) -> str:
    """PSS of every process of a flight, and their sum."""
    found = [(name, pss_mb(pid)) for pid, name in all_processes(supervisor).items()]
    return f"PSS [MB]: {', '.join(f'{name} {mb:.0f}' for name, mb in found)}; sum {sum(mb for _, mb in found):.0f}"


def longer(vehicle: str, seconds: float, place: Path) -> Path:
    """A scenario file that makes the mission of ``vehicle`` last so long: its longest motion does.

    A free-flyer's whole flight is integrated before it begins, at 2.5 times real time; from :data:`LONG_S` on it is
    integrated in steps of 20 ms in place of 4 ms (its tones are of 0.6 Hz at most), ten times as fast.
    """
    flown = bed.find(vehicle)
    packaged = Path(hil_sim.scenario.__file__).parent / "packaged" / f"{vehicle}.toml"
    path = packaged if flown is None else flown.scenario
    sequence = tomllib.loads(path.read_text(encoding="utf-8"))["sequence"]
    longest = max(sequence, key=lambda step: float(step.get("duration_s", 0.0)))
    others_s = sum(step.get("duration_s", 0.0) for step in sequence if step is not longest)
    longest["duration_s"] = max(10.0, seconds - others_s)
    over = place / "longer.toml"
    content = {"sequence": sequence}
    if seconds > LONG_S and flown is not None:
        content["physics"] = {"integration_steps": LONG_STEPS}
    over.write_text(tomli_w.dumps(content), encoding="utf-8")
    return over


@contextmanager
def flying(
    vehicle: str | Path,
    place: Path,
    *,
    name: str,
    scenario: str = "",
    over: Path | None = None,
    nice: int = 0,
    also: Sequence[str] = (),
) -> Iterator[RealFlight]:
    """Simulated devices and a flight of them in a session of its own, every worker at work.

    Args:
        vehicle: a packaged one, or a vehicle file.
        place: for the log and the sockets.
        name: of the log.
        scenario: packaged; that of the vehicle's name if not given.
        over: a scenario file whose tables lie over it.
        nice: level of the flight; where sessions share the CPU equally, theirs is set too.
        also: options of ``heft fly``.
    """
    log = place / f"{name}.mcap"
    sockets = Path(tempfile.mkdtemp(prefix="devices-", dir=place))
    serve = [
        sys.executable,
        "-m",
        "hil_sim.serve",
        scenario or str(vehicle),
        "--seed",
        "3",
        "--directory",
        str(sockets),
    ]
    serve += ["--over", str(over)] if over else []
    with ExitStack() as stack:
        devices = stack.enter_context(subprocess.Popen(serve, stdout=subprocess.PIPE, text=True))
        stack.callback(_end, devices)
        assert devices.stdout is not None
        served = json.loads(devices.stdout.readline())
        urls = [f"--url={bus}={served[bus]}" for bus in config.named(vehicle).buses if bus in served]
        command = ["nice", f"-n{nice}", sys.executable, "-m", "onboard.cli", "fly", str(vehicle), "--log", str(log)]
        flight = subprocess.Popen([*command, *urls, *also, "--quiet"], start_new_session=True)
        stack.callback(flight.wait)
        stack.callback(flight.kill)
        group = Path(f"/proc/{flight.pid}/autogroup")
        if group.exists():
            group.write_text(str(nice))
        deadline = time.monotonic() + START_S
        while not (rings := _rings(log)) or not WORKERS.keys() <= processes(flight.pid).keys():
            if time.monotonic() > deadline or flight.poll() is not None:
                raise RuntimeError("the flight did not start; its message stands above")
            time.sleep(0.05)
        yield RealFlight(flight, devices, log, rings)


def _end(devices: "subprocess.Popen[str]") -> None:
    """End the devices, and take what they say last."""
    devices.terminate()
    if devices.stdout is not None:
        devices.stdout.read()


def _rings(log: Path) -> Path | None:
    return next((one.directory for one in manifest.waiting() if one.log == log), None)
