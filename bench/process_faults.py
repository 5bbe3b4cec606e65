"""Real-time rehearsals in which processes are killed or stopped, the wall clock steps, or the disk is full.

Run ``python bench/process_faults.py --flights 20 --first 7001 [--results process_faults.jsonl]``; flights run one after
the other, 25 s each on an idle computer; seeds that are in the results are not flown again. Drawn by seed:

- ``kill`` or ``stop`` (SIGKILL; SIGSTOP for 0.5 to 9 s) of the recorder, the estimator, acquisition, the simulated
  devices or the supervisor, at a random time,
- ``clock``: CLOCK_REALTIME of all processes steps by up to an hour, by a preloaded library (needs a C compiler),
- ``disk``: the log lies on a file system of its own that is full after 2 MB (needs root: a mount of its own),
- with ``--only`` also ``term`` and ``hup``, signals to the supervisor, and ``removed``: the log's directory is.

After a killed supervisor the rings are harvested as by the next start. Promised: no traceback, an end, an exit code of
0 or 1 (1 where rows that came are not in the log), every number of every channel in the log once or in a gap record,
and every sample that was made accounted for (where the devices live to tell). Exit code 1: a promise was broken.
"""

import argparse
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from onboard.flight.store.harvest import harvest
from onboard.ground.log.views.info import info

TARGETS = {"recorder": "heft-record", "estimator": "heft-estimate", "acquisition": "heft-acquire"}
KINDS = ("kill", "stop", "clock", "disk", "term", "hup", "removed")
LIMIT_S = 180.0  # after which a rehearsal hangs
_STROKES = "amplitude = { joint_1 = 0.2007 }, stroke_s = 0.6, strokes = 4, pause_s = 0.05, transfer_s = 0.5"
_SWEEP = f'{{ phase = 4, action = "strokes", {_STROKES} }}'
SCENARIO = f"""sequence = [
  {{ phase = 0, action = "hold", duration_s = 3.0 }},
  {_SWEEP},
  {{ phase = 5, action = "hold", duration_s = 0.8 }},
  {_SWEEP},
  {{ phase = 9, action = "hold", duration_s = 1.0 }},
]
"""
STEPPED_CLOCK = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <time.h>
int clock_gettime(clockid_t id, struct timespec *t) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int result = real(id, t);
    struct timespec now;
    if (result == 0 && id == CLOCK_REALTIME && real(CLOCK_MONOTONIC, &now) == 0 && now.tv_sec > atol(getenv("STEP_AT")))
        t->tv_sec += atol(getenv("STEP_BY"));
    return result;
}
"""


def draw(seed: int, only: str | None) -> dict[str, Any]:
    """What happens in a flight."""
    rng = np.random.default_rng([seed, 0xF0])
    kind = only or str(rng.choice(KINDS[:4], p=[0.4, 0.35, 0.1, 0.15]))
    drawn: dict[str, Any] = {"seed": seed, "kind": kind, "at_s": round(float(rng.uniform(1.0, 12.0)), 2)}
    if kind in ("kill", "stop"):
        drawn["who"] = str(rng.choice([*TARGETS, "devices", "supervisor"], p=[0.25, 0.2, 0.25, 0.15, 0.15]))
    if kind == "stop":
        drawn["for_s"] = round(float(0.5 * 18.0 ** rng.random()), 2)
    if kind == "clock":
        drawn["by_s"] = int(rng.choice([-3600, -30, 30, 3600]))
    return drawn


def fly(drawn: dict[str, Any]) -> dict[str, Any]:
    """Fly one, and judge it."""
    with tempfile.TemporaryDirectory(prefix="process_faults_") as place, _own_rings() as rings:
        directory = Path(place)
        log, result = directory / "disk" / "log.mcap", directory / "result.json"
        log.parent.mkdir()
        (directory / "short.toml").write_text(SCENARIO, encoding="utf-8")
        command = [sys.executable, "-m", "onboard.cli", "hil", "rocksat", "--realtime", f"--seed={drawn['seed']}"]
        command += [f"--scenario={directory / 'short.toml'}", f"--log={log}", f"--json={result}"]
        if drawn["kind"] == "disk":
            on_its_own = (
                f'mount -t tmpfs -o size=2m none {log.parent}; "$@"; code=$?; cp {log.parent}/* {directory}; exit $code'
            )
            command = ["unshare", "--mount", "sh", "-c", on_its_own, "sh", *command]
            log = directory / log.name
        environment = os.environ | {"HEFT_RINGS": str(rings)} | _clock(drawn, directory)
        began_s = time.monotonic()
        with (
            (directory / "stderr").open("w") as errors,
            subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=errors) as flight,
        ):
            hung = not _disturb(flight, drawn, log, began_s)
        os.environ["HEFT_RINGS"] = str(rings)
        harvested = len(harvest(time.monotonic_ns()))
        said = (directory / "stderr").read_text(encoding="utf-8", errors="replace")
        return drawn | {
            "said": said.strip().splitlines()[-1:],
            "code": flight.returncode,
            "hung": hung,
            "harvested": harvested,
            "traceback": _traceback(said),
            "took_s": round(time.monotonic() - began_s, 1),
            **_judged(log, result),
        }


@contextlib.contextmanager
def _own_rings() -> Any:
    place = Path(f"/dev/shm/heft-process-faults-{os.getpid()}")
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _clock(drawn: dict[str, Any], directory: Path) -> dict[str, str]:
    if drawn["kind"] != "clock":
        return {}
    (directory / "step.c").write_text(STEPPED_CLOCK, encoding="ascii")
    library = str(directory / "step.so")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, str(directory / "step.c"), "-ldl"], check=True)
    at_s = int(time.monotonic() + 8.0 + drawn["at_s"])
    return {"LD_PRELOAD": library, "STEP_AT": str(at_s), "STEP_BY": str(drawn["by_s"])}


def _disturb(flight: subprocess.Popen[bytes], drawn: dict[str, Any], log: Path, began_s: float) -> bool:
    """Wait for the flight, disturb it, wait for its end; whether it ended by itself."""
    while flight.poll() is None and time.monotonic() < began_s + LIMIT_S and len(_workers(flight.pid)) < len(TARGETS):
        time.sleep(0.1)
    time.sleep(drawn["at_s"])
    victim = _victim(flight.pid, drawn.get("who", ""))
    with contextlib.suppress(ProcessLookupError):
        if victim and drawn["kind"] == "kill":
            os.kill(victim, signal.SIGKILL)
        elif victim and drawn["kind"] == "stop":
            os.kill(victim, signal.SIGSTOP)
            time.sleep(drawn["for_s"])
            os.kill(victim, signal.SIGCONT)
        elif drawn["kind"] in ("term", "hup"):
            flight.send_signal(signal.SIGTERM if drawn["kind"] == "term" else signal.SIGHUP)
        elif drawn["kind"] == "removed":
            shutil.rmtree(log.parent)
    while flight.poll() is None and time.monotonic() < began_s + LIMIT_S:
        time.sleep(0.1)
    hung = flight.poll() is None
    if hung:
        for pid in _descendants(flight.pid):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        flight.kill()
    deadline_s = time.monotonic() + 30.0
    while drawn.get("who") == "supervisor" and time.monotonic() < deadline_s and _belonging(log):
        time.sleep(0.2)  # the workers of a dead supervisor end by themselves
    return not hung


def _parents() -> dict[int, tuple[int, str]]:
    """Parent and name of every process."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            name, _, rest = entry.read_text(errors="replace").partition("(")[2].rpartition(")")
            found[int(entry.parent.name)] = int(rest.split()[1]), name
    return found


def _descendants(root: int) -> dict[int, str]:
    """Names of the processes below ``root``."""
    parents, found = _parents(), {root: ""}
    for _ in range(6):
        found |= {pid: name for pid, (parent, name) in parents.items() if parent in found}
    del found[root]
    return found


def _workers(root: int) -> dict[str, int]:
    return {name: pid for pid, name in _descendants(root).items() if name in TARGETS.values()}


def _command_line(pid: int) -> str:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_text(errors="replace").replace("\0", " ")
    return ""


def _victim(root: int, who: str) -> int | None:
    if who in TARGETS:
        return _workers(root).get(TARGETS[who])
    if who == "devices":
        return next((pid for pid in _descendants(root) if "hil_sim.serve" in _command_line(pid)), None)
    return root if who == "supervisor" else None


def _belonging(log: Path) -> list[int]:
    """Workers that have the log open yet."""
    names = tuple(TARGETS.values())
    pids = [pid for pid, (_, name) in _parents().items() if name in names]
    return [pid for pid in pids if any(str(log.parent) in str(f) for f in _open_files(pid))]


def _open_files(pid: int) -> list[str]:
    with contextlib.suppress(OSError):
        return [str(os.readlink(file)) for file in Path(f"/proc/{pid}/fd").iterdir()]
    return []


def _traceback(said: str) -> str:
    return said[said.index("Traceback") :][-2000:] if "Traceback" in said else ""


def _judged(log: Path, result: Path) -> dict[str, Any]:
    """What the log and the table say."""
    judged: dict[str, Any] = {"logged": log.exists() or bool(list(log.parent.glob("log.*")))}
    if judged["logged"]:
        about = info(log)
        judged["jumps"] = {c.name: [c.repeated, c.unexplained] for c in about.channels if c.repeated or c.unexplained}
        judged["rows"] = sum(channel.rows for channel in about.channels)
    if result.exists():
        channels = json.loads(result.read_text(encoding="utf-8"))["channels"]
        judged["unnamed"] = {name: c["unaccounted"] for name, c in channels.items() if not c["accounted"]}
        judged["missing"] = sum(c["missing"] for c in channels.values())
    return judged


def is_bad(told: dict[str, Any]) -> bool:
    """A broken promise."""
    is_killed = told.get("who") == "supervisor" and told["kind"] == "kill"
    odd = told["code"] not in (0, 1) and not is_killed
    odd |= told["code"] == 0 and told["kind"] in ("disk", "removed") and told.get("missing", 0) > 0
    return bool(odd or told["hung"] or told["traceback"] or told.get("jumps") or told.get("unnamed"))


def table(flights: Iterable[dict[str, Any]]) -> str:
    """Results by what happened."""
    rows = [
        "| what happened | flights | ended by itself | tracebacks | something in no gap | samples lost, median, worst |"
    ]
    rows.append("|---|" + "---:|" * 5)
    flown = list(flights)
    kinds = sorted({f"{told['kind']} {told.get('who', '')}".strip() for told in flown})
    for kind in [*kinds, "all"]:
        mine = [t for t in flown if kind in ("all", f"{t['kind']} {t.get('who', '')}".strip())]
        missing = [t["missing"] for t in mine if "missing" in t]
        lost = f"{np.median(missing):.0f}, {max(missing)}" if missing else "—"
        unnamed = sum(bool(t.get("jumps") or t.get("unnamed")) for t in mine)
        ended, traces = sum(not t["hung"] for t in mine), sum(bool(t["traceback"]) for t in mine)
        rows.append(f"| {kind} | {len(mine)} | {ended} | {traces} | {unnamed} | {lost} |")
    return "\n".join(rows)


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=10)
    parser.add_argument("--first", type=int, default=7001, help="seed")
    parser.add_argument("--only", choices=KINDS, help="what happens in each (default: drawn)")
    parser.add_argument("--results", type=Path, default=Path("process_faults.jsonl"))
    arguments = parser.parse_args()
    lines = arguments.results.read_text(encoding="utf-8").splitlines() if arguments.results.exists() else []
    flown = {told["seed"]: told for told in map(json.loads, lines)}
    for seed in range(arguments.first, arguments.first + arguments.flights):
        if seed in flown:
            continue
        told = flown[seed] = fly(draw(seed, arguments.only))
        with arguments.results.open("a", encoding="utf-8") as results:
            results.write(json.dumps(told) + "\n")
        if is_bad(told):
            print(json.dumps(told, indent=1), flush=True)
    print(table(flown.values()))
    return int(any(map(is_bad, flown.values())))


if __name__ == "__main__":
    sys.exit(main())
