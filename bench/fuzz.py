"""Fuzzes every decoder and what reads files: whatever the bytes, nothing but the named error may come out.

::

    python bench/fuzz.py [--seconds 600] [--seed 1] [--jobs 2] [--engine atheris|own] [DECODER ...]
    python bench/fuzz.py --replay bench/fuzz_findings/qsb/0123456789abcdef.bin

Both engines are guided by coverage of ``drivers`` and ``onboard``: atheris (libFuzzer) where it is installed (extra
``fuzz``: Linux on x86-64, Python 3.11 to 3.13), and one of our own, which mutates inputs and keeps those that go from
one line to another where none went before. By seed and number of executions our own does the same every time; that is
the slice CI runs. Warnings are errors, and a call of more than ``findings.HANG_S`` is a finding as well.

A finding is shortened and saved as ``bench/fuzz_findings/DECODER/HASH.bin``, with the traceback beside it; of those
that end at the same line the first is kept. Exit code 1 when there are any.
"""

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from bench.fuzzing import NAMES, atheris_engine, own_engine, target
from bench.fuzzing.findings import FOLDER, ROOT, FuzzFindings, Result


def fuzz(name: str, engine: str, seed: int, seconds: float) -> Result:
    """Have one decoder fuzzed by a process of its own. Raises RuntimeError when that ends before its time."""
    if engine == "atheris":
        return atheris_engine.fuzz(name, seed, seconds)
    command = [sys.executable, __file__, name, "--child", "--seed", str(seed), "--seconds", str(seconds)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{name}: the fuzzer ended with {done.returncode}:\n{done.stderr[-3000:]}")
    executions, took, paths, *files = json.loads(done.stdout)
    return Result(executions, took, paths, [Path(file) for file in files])


def child(name: str, seed: int, seconds: float) -> None:
    """One decoder by our own engine, in this process; one JSON line."""
    fuzzed = target(name)
    findings = FuzzFindings(fuzzed.call, FOLDER / name)
    result = own_engine.fuzz(fuzzed, seed, findings, None, seconds)
    print(json.dumps([*result[:3], *map(str, result.files)]))


def replay(file: Path) -> None:
    """Give a decoder one input again; what it raises comes out."""
    warnings.simplefilter("error")
    target(file.resolve().parent.name).call(file.read_bytes())
    print("nothing was raised")


def main() -> int:
    """Fuzz, and print the table."""
    there = importlib.util.find_spec("atheris") is not None
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("decoders", nargs="*", metavar="DECODER", help=f"of {', '.join(NAMES)} (default: all)")
    parser.add_argument("--seconds", type=float, default=600.0, help="for each decoder (default 600)")
    parser.add_argument("--seed", type=int, default=1, help="1 or more (default 1)")
    parser.add_argument("--jobs", type=int, default=1, help="decoders at a time (default 1)")
    parser.add_argument("--engine", choices=("atheris", "own"), default="atheris" if there else "own")
    parser.add_argument("--replay", type=Path, metavar="FILE", help="run one saved input and show what it raises")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    unknown = set(arguments.decoders) - set(NAMES)
    if unknown:
        parser.error(f"no decoder is called {', '.join(sorted(unknown))}: choose of {', '.join(NAMES)}")
    if arguments.replay and not (arguments.replay.is_file() and arguments.replay.resolve().parent.name in NAMES):
        parser.error(f"{arguments.replay} is no saved input; they are below {FOLDER}, in the folder of their decoder")
    if arguments.replay:
        replay(arguments.replay)
        return 0
    engine, seed, seconds = arguments.engine, arguments.seed, arguments.seconds
    if arguments.child:
        child(arguments.decoders[0], seed, seconds)
        return 0
    names = arguments.decoders or list(NAMES)
    print(f"engine {engine}, seed {seed}, {seconds:g} s each, Python {sys.version.split()[0]}")
    print(f"{'decoder':12}{'executions':>12}{'seconds':>9}{'a second':>10}{'paths':>8}{'findings':>10}")
    failed = False
    with ThreadPoolExecutor(arguments.jobs) as pool:
        for name, pending in [(name, pool.submit(fuzz, name, engine, seed, seconds)) for name in names]:
            try:
                result = pending.result()
            except RuntimeError as error:
                print(f"{name:12}{error}", flush=True)
                failed = True
                continue
            rate = result.executions / max(result.seconds, 1e-9)
            counts = f"{result.executions:12,}{result.seconds:9.0f}{rate:10,.0f}{result.paths:8,}{len(result.files):10}"
            print(f"{name:12}{counts}", flush=True)
            for file in result.files:
                print(f"    {file.relative_to(ROOT)}: {_last_line(file)}")
            failed |= bool(result.files)
    return int(failed)


def _last_line(file: Path) -> str:
    with suppress(OSError, IndexError):
        return file.with_suffix(".txt").read_text(encoding="utf-8").strip().splitlines()[-1]
    return ""


if __name__ == "__main__":
    sys.exit(main())
