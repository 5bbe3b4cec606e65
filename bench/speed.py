"""CPU seconds of whole commands by layer, for this checkout and, in turns with it, for another one.

::

    python -m bench.speed [--against PATH] [--only hil-rocksat ...] [--seed 3] [--rounds 5] [--json FILE]

Each command runs as a process of its own, with compiled modules and core (onboard/native) and an otherwise empty cache,
and its CPU time is what the kernel counted (user and system). A profiling timer samples its stack every 2 ms of CPU
time: a sample counts for the layer of the innermost frame that has one, for imports where one is going on, for
foresight where the table before the flight is being made.
Medians of the rounds; the least too, which other work on the machine moves less. ``replay`` and ``identify`` read a
DYMAFLEX log that each checkout flies for itself.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Final

from bench import given

ROOT: Final = Path(__file__).resolve().parents[1]
HIL: Final = "hil {} --seed {seed} --log {out}/flight.mcap"
COMMANDS: Final = {
    "hil-rocksat": HIL.replace("{}", "rocksat"),
    "hil-dymaflex": HIL.replace("{}", "dymaflex"),
    "hil-rocksat_serial": HIL.replace("{}", "rocksat_serial"),
    "replay-dymaflex": "replay {log}",
    "identify-exiddm": "identify --method exiddm {log}",
}
LAYERS: Final = (
    ("imports", ("<frozen importlib",)),
    ("foresight", ("onboard/ground/before/foresee/", "onboard/offline/foresee/", "hil_sim/plants/planned")),
    ("plant, sensing noise", ("hil_sim/plants/", "hil_sim/sensing/")),
    (
        "emulators, wires, drivers, ring, recorder",
        (
            "hil_sim/",
            "drivers/",
            "onboard/flight/acquire/",
            "onboard/ring",
            "onboard/recording/",
            "onboard/flight/store/",
        ),
    ),
    ("clocks", ("onboard/timebase/", "onboard/flight/clocks")),
    (
        "free-flyer's filter and windows",
        ("onboard/identification/free_flyer/", "onboard/dynamics/free_flight", "onboard/identification/whole_flight/"),
    ),
    ("rows, answers", ("onboard/identification/", "onboard/regressor/", "onboard/flight/estimate/answers")),
    (
        "smoothing, signals, gates",
        (
            "onboard/estimation/smoothing",
            "onboard/estimation/gates",
            "onboard/estimation/stuck",
            "onboard/flight/estimate/",
        ),
    ),
)
OTHER: Final = "other"

# Runs in the measured process, of either checkout: no module of heft is known to it.
SAMPLER: Final = """
import atexit, collections, json, os, signal, sys, time
layers, root, found, last = json.loads(os.environ["SPEED_LAYERS"]), os.getcwd() + "/", collections.Counter(), [0.0]
layer_of, first = {}, {name for name, _ in layers[:2]}
def layer(file):
    if file not in layer_of:
        path = file.removeprefix(root)
        layer_of[file] = next((name for name, starts in layers if path.startswith(tuple(starts))), None)
    return layer_of[file]
def sample(_, frame):
    now, inner = time.process_time(), None
    while frame is not None:
        of = layer(frame.f_code.co_filename)
        if of in first:
            inner = of
            break
        inner, frame = inner or of, frame.f_back
    found[inner or "other"] += now - last[0]
    last[0] = now
def tell():
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    found["other"] += time.process_time() - last[0]
    with open(os.environ["SPEED_OUT"], "w") as file:
        json.dump(found, file)
atexit.register(tell)
signal.signal(signal.SIGPROF, sample)
signal.setitimer(signal.ITIMER_PROF, 0.002, 0.002)
from onboard.cli import main
sys.exit(main())
"""


def compile_modules(checkout: Path, cache: Path) -> None:
    """Compile its modules, and its core into a cache, as they are where it is installed."""
    rooms = [str(checkout / room) for room in ("onboard", "hil_sim", "drivers")]
    subprocess.run([sys.executable, "-m", "compileall", "-q", *rooms], check=True)
    cache.mkdir(parents=True)
    if (checkout / "onboard" / "native").exists():
        environment = os.environ | {"PYTHONPATH": str(checkout), "XDG_CACHE_HOME": str(cache)}
        made = [sys.executable, "-c", "import onboard.native.library"]
        subprocess.run(made, cwd=checkout, env=environment, check=True)


def run(checkout: Path, command: str, compiled: Path) -> dict[str, float]:
    """CPU seconds of a command of a checkout by layer, and in ``whole`` what the kernel counted.

    ``compiled``: a cache with the core alone.

    Raises:
        RuntimeError: it did not end with 0.
    """
    with tempfile.TemporaryDirectory() as directory:
        told = Path(directory) / "layers.json"
        shutil.copytree(compiled, f"{directory}/cache")
        environment = os.environ | {
            "OPENBLAS_NUM_THREADS": "1",
            "PYTHONPATH": str(checkout),
            "XDG_CACHE_HOME": f"{directory}/cache",
            "SPEED_LAYERS": json.dumps(LAYERS),
            "SPEED_OUT": str(told),
        }
        child = subprocess.Popen(
            [sys.executable, "-c", SAMPLER, *command.split()],
            cwd=checkout,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        assert child.stderr is not None
        said = child.stderr.read().decode()
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode != 0:
            raise RuntimeError(f"{checkout}: heft {command} ended with {child.returncode}: {said}")
        seconds: dict[str, float] = json.loads(told.read_text(encoding="utf-8"))
        return seconds | {"whole": used.ru_utime + used.ru_stime}


def measure(
    checkouts: list[Path], only: list[str], seed: int, rounds: int
) -> dict[str, dict[str, list[dict[str, float]]]]:
    """CPU seconds by layer of each command, checkout and round."""
    found: dict[str, dict[str, list[dict[str, float]]]] = {name: {str(one): [] for one in checkouts} for name in only}
    with tempfile.TemporaryDirectory() as directory:
        logs = {one: Path(directory) / str(number) for number, one in enumerate(checkouts)}
        compiled = {one: Path(directory) / f"compiled-{number}" for number, one in enumerate(checkouts)}
        for one, cache in compiled.items():
            compile_modules(one, cache)
        if any("{log}" in COMMANDS[name] for name in only):
            for one, out in logs.items():
                out.mkdir()
                run(one, COMMANDS["hil-dymaflex"].format(seed=seed, out=out), compiled[one])
        for _ in range(rounds):
            for name in only:
                for one, its in logs.items():
                    with tempfile.TemporaryDirectory() as scratch:
                        command = COMMANDS[name].format(seed=seed, out=scratch, log=its / "flight.mcap")
                        found[name][str(one)].append(run(one, command, compiled[one]))
    return found


def show(found: dict[str, dict[str, list[dict[str, float]]]]) -> None:
    """The table: a line a layer, and of each command the medians of this checkout, of the other, and their ratio."""
    for name, of in found.items():
        sides = list(of.values())
        print(f"\n{name:<44}" + "".join(f"{side:>9}" for side in ("here", "there", "ratio")[: 2 * len(sides) - 1]))
        for layer in (*(layer for layer, _ in LAYERS), OTHER, "whole"):
            print(f"  {layer:<42}" + _row([median(one.get(layer, 0.0) for one in rounds) for rounds in sides]))
        print(f"  {'whole, the least':<42}" + _row([min(one["whole"] for one in rounds) for rounds in sides]))


def _row(values: list[float]) -> str:
    ratio = f"{values[1] / values[0]:9.2f}" if len(values) > 1 and values[0] > 0.0 else ""
    return "".join(f"{value:9.2f}" for value in values) + ratio


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    checkout = given.directory_with("onboard", "drivers", "hil_sim")
    parser.add_argument("--against", type=checkout, help="another checkout, run with this Python and its packages")
    parser.add_argument("--only", nargs="+", choices=COMMANDS, default=list(COMMANDS), metavar="COMMAND")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    checkouts = [ROOT] + ([arguments.against.resolve()] if arguments.against else [])
    found = measure(checkouts, arguments.only, arguments.seed, arguments.rounds)
    show(found)
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
