"""Fuzzes every decoder: whatever the bytes, nothing but its named error may come out.

::

    python bench/fuzz.py [--seconds 600] [--seed 1] [--jobs 2] [--engine atheris|own] [DECODER ...]
    python bench/fuzz.py --replay bench/fuzz_findings/qsb/0123456789abcdef.bin

Both engines are guided by coverage of ``drivers``: atheris (libFuzzer; ``pip install atheris``, it is in no lock)
where it is installed, and one of our own, which mutates inputs and keeps those that go from one line to another where
none went before. By seed and number of executions our own does the same every time; that is the slice CI runs. Warnings
are errors, and a call of more than ``HANG_S`` is a finding as well.

A finding is shortened and saved as ``bench/fuzz_findings/DECODER/HASH.bin``, with the traceback beside it; of those
that end at the same line the first is kept. Exit code 1 when there are any.
"""

import argparse
import hashlib
import importlib
import importlib.util
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
FINDINGS = ROOT / "bench" / "fuzz_findings"
DRIVERS = str(ROOT / "drivers") + os.sep
MOST_BYTES = 1024
HANG_S = 10.0
SHORTENINGS = 2000  # executions spent to shorten a finding
INTERESTING = (b"\0", b"\xff", b"\x7f", b"\x80", b"\r", b"\n", b"!", b" ", b"+", b"0", b"\xff\xff\xff\xff", bytes(4))
NAMES = ("mpu6050", "canopen", "slcan", "nimu", "qsb", "modbus", "dsc", "node_frame")

Call = Callable[[bytes], None]
Edge = tuple[CodeType, int, int]


class Hang(BaseException):
    """A call took longer than ``HANG_S``. No Exception, so that no ``except`` in a decoder takes it."""


class Result(NamedTuple):
    """What came of one decoder.

    Attributes:
        executions: Calls of the target.
        seconds: They took.
        paths: Inputs kept, each of which reached what no other had.
        findings: Files of those that raised.
    """

    executions: int
    seconds: float
    paths: int
    findings: list[Path]


class Findings:
    """Runs a target and keeps what it raises, one input for a place.

    Args:
        call: The target.
        folder: Where they go, made at the first of them; None: they are not written.
    """

    def __init__(self, call: Call, folder: Path | None) -> None:
        self.files: list[Path] = []
        self.places: dict[str, bytes] = {}
        self._call = call
        self._folder = folder

    def run(self, data: bytes) -> None:
        """Call the target, with what it raises taken note of."""
        error = raised(self._call, data)
        if error is None or place_of(error) in self.places:
            return
        place = place_of(error)
        self.places[place] = data
        short = shortened(self._call, data, place)
        self.places[place] = short
        self._save(short)

    def _save(self, data: bytes) -> None:
        if self._folder is None:
            return
        self._folder.mkdir(parents=True, exist_ok=True)
        (self._folder.parent / ".gitignore").write_text("*\n", encoding="ascii")
        file = self._folder / f"{hashlib.sha256(data).hexdigest()[:16]}.bin"
        file.write_bytes(data)
        error = raised(self._call, data)
        text = "".join(traceback.format_exception(error)) if error else "it did not come again\n"
        file.with_suffix(".txt").write_text(f"{data.hex(' ')}\n\n{text}", encoding="utf-8")
        self.files.append(file)


def raised(call: Call, data: bytes) -> BaseException | None:
    """What the target raises; None when it takes the input."""
    try:
        with alarm(HANG_S):
            call(data)
    except (Exception, Hang) as error:  # noqa: BLE001 - whatever it is, it is what we look for
        return error
    return None


@contextmanager
def alarm(seconds: float) -> Iterator[None]:
    """Raise ``Hang`` in the main thread after so long."""

    def ring(number: int, frame: FrameType | None) -> None:
        raise Hang(f"no end after {seconds} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def place_of(error: BaseException) -> str:
    """Kind of the exception, and the last line of ``drivers`` on its way (for a broken law: of the target)."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if frame.filename.startswith(DRIVERS)] or frames
    return f"{type(error).__name__} {ours[-1].filename}:{ours[-1].lineno}"


def shortened(call: Call, data: bytes, place: str) -> bytes:
    """The input with every stretch left out that the finding does not need."""
    left = SHORTENINGS
    size = max(len(data) // 2, 1)
    while size and left > 0:
        at, before = 0, len(data)
        while at < len(data) and left > 0:
            shorter = data[:at] + data[at + size :]
            error = raised(call, shorter)
            left -= 1
            if error is not None and place_of(error) == place:
                data = shorter
            else:
                at += size
        if len(data) == before:  # else what was left out may let more go
            size //= 2
    return data


# Our own engine


class Coverage:
    """Steps from line to line in ``drivers``, as the interpreter's trace function sees them."""

    def __init__(self) -> None:
        self.seen: set[Edge] = set()
        self._now: set[Edge] = set()

    def of(self, run: Callable[[bytes], None], data: bytes) -> bool:
        """Run; whether it went where no run went before."""
        self._now = set()
        before = sys.gettrace()
        sys.settrace(self._trace)
        try:
            run(data)
        finally:
            sys.settrace(before)
        fresh = not self._now <= self.seen
        self.seen |= self._now
        return fresh

    def _trace(self, frame: FrameType, event: str, argument: object) -> Callable[..., Any] | None:
        code = frame.f_code
        if not code.co_filename.startswith(DRIVERS):
            return None
        add = self._now.add
        last = 0

        def line(frame: FrameType, event: str, argument: object) -> Callable[..., Any]:
            nonlocal last
            now = frame.f_lineno
            add((code, last, now))
            last = now
            return line

        return line


def mutated(rng: random.Random, corpus: Sequence[bytes]) -> bytes:
    """One of the corpus after one to six changes: bits, bytes, stretches out, again, in another place, of another."""
    data = bytearray(rng.choice(corpus))
    for _ in range(rng.choice((1, 1, 2, 3, 6))):
        at = rng.randrange(len(data) + 1)
        end = min(len(data), at + rng.choice((1, 2, 4, 16, 64)))
        match rng.randrange(9):
            case 0 if data:
                data[at % len(data)] ^= 1 << rng.randrange(8)
            case 1 if data:
                data[at % len(data)] = rng.randrange(256)
            case 2:
                some = rng.choice(INTERESTING)
                data[at : at + len(some)] = some
            case 3:
                del data[at:end]
            case 4:
                data[at:at] = data[at:end] * rng.choice((1, 1, 2, 8))
            case 5:
                del data[at:]
            case 6:
                other = rng.choice(corpus)
                data[at:] = other[rng.randrange(len(other) + 1) :]
            case 7:
                other = rng.choice(corpus)
                first = rng.randrange(len(other) + 1)
                data[at:at] = other[first : first + rng.choice((1, 8, 32))]
            case _ if data:
                data[at % len(data)] = (data[at % len(data)] + rng.choice((-1, 1))) % 256
    return bytes(data[:MOST_BYTES])


def fuzz_own(
    call: Call, seeds: Sequence[bytes], seed: int, findings: Findings, executions: int | None, seconds: float
) -> Result:
    """Our own engine, for so many executions, or for so long when that is None."""
    rng = random.Random(seed)
    coverage, corpus = Coverage(), list(seeds)
    began = time.monotonic()
    done = paths = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        while done < executions if executions is not None else time.monotonic() - began < seconds:
            data = seeds[done] if done < len(seeds) else mutated(rng, corpus)
            if coverage.of(findings.run, data):
                paths += 1
                corpus.append(data)
            done += 1
    return Result(done, time.monotonic() - began, paths, findings.files)


# atheris


def fuzz_atheris(name: str, seed: int, seconds: float) -> None:
    """Fuzz by libFuzzer in this process, which ends with it. Its report goes to stderr, findings to stdout."""
    atheris = importlib.import_module("atheris")  # it may not be there, and ships no type hints
    with atheris.instrument_imports(include=["drivers"], enable_loader_override=False):
        from bench.fuzz_targets import targets  # noqa: PLC0415 - drivers are instrumented as they are imported
    target = targets()[name]
    findings = Findings(target.call, FINDINGS / name)
    warnings.simplefilter("error")

    def one(data: bytes) -> None:
        known = len(findings.files)
        findings.run(data)
        for file in findings.files[known:]:
            print(file, flush=True)

    with tempfile.TemporaryDirectory() as folder:  # libFuzzer adds what it keeps
        for number, data in enumerate(target.seeds):
            (Path(folder) / f"seed_{number}").write_bytes(data)
        options = {
            "seed": seed,
            "max_total_time": round(seconds),
            "max_len": MOST_BYTES,
            "timeout": round(6 * HANG_S),
            "print_final_stats": 1,
            "artifact_prefix": f"{FINDINGS / name}/",
        }
        atheris.Setup([sys.argv[0], *(f"-{key}={value}" for key, value in options.items()), folder], one)
        atheris.Fuzz()


def told_by_atheris(report: str, output: str) -> Result:
    """Numbers out of libFuzzer's report."""
    found = {name: int(value) for name, value in re.findall(r"stat::(\w+):\s+(\d+)", report)}
    kept = re.findall(r"corp: (\d+)", report)
    seconds = re.findall(r"Done \d+ runs in (\d+) second", report)
    if "number_of_executed_units" not in found or not seconds:
        raise RuntimeError(f"libFuzzer did not come to its end:\n{report[-3000:]}")
    files = [Path(line) for line in output.splitlines()]
    return Result(found["number_of_executed_units"], float(seconds[-1]), int(kept[-1]) if kept else 0, files)


# All of them


def child(name: str, engine: str, seed: int, seconds: float) -> None:
    """One decoder, in a process of its own."""
    if engine == "atheris":
        fuzz_atheris(name, seed, seconds)
        return
    from bench.fuzz_targets import targets  # noqa: PLC0415 - as above

    target = targets()[name]
    result = fuzz_own(target.call, target.seeds, seed, Findings(target.call, FINDINGS / name), None, seconds)
    print(json.dumps(result._replace(findings=[]) + tuple(map(str, result.findings))))


def fuzz(name: str, engine: str, seed: int, seconds: float) -> Result:
    """Have one decoder fuzzed by a child.

    Raises:
        RuntimeError: The child ended before its time: it crashed, or ran out of memory.
    """
    (FINDINGS / name).mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "bench.fuzz", name, "--child"]
    command += ["--engine", engine, "--seed", str(seed), "--seconds", str(seconds)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{name}: the fuzzer ended with {done.returncode}:\n{done.stderr[-3000:]}")
    if engine == "atheris":
        return told_by_atheris(done.stderr, done.stdout)
    executions, took, paths, _, *files = json.loads(done.stdout)
    return Result(executions, took, paths, [Path(file) for file in files])


def replay(file: Path) -> None:
    """Give a decoder one input again; what it raises comes out."""
    from bench.fuzz_targets import targets  # noqa: PLC0415 - as above

    warnings.simplefilter("error")
    targets()[file.resolve().parent.name].call(file.read_bytes())
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
    if arguments.replay:
        replay(arguments.replay)
        return 0
    engine, seed, seconds = arguments.engine, arguments.seed, arguments.seconds
    if arguments.child:
        child(arguments.decoders[0], engine, seed, seconds)
        return 0
    names = arguments.decoders or list(NAMES)
    print(f"engine {engine}, seed {seed}, {seconds:g} s each, Python {sys.version.split()[0]}")
    print(f"{'decoder':12}{'executions':>12}{'a second':>10}{'paths':>8}{'findings':>10}")
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
            counts = f"{result.executions:12,}{rate:10,.0f}{result.paths:8,}{len(result.findings):10}"
            print(f"{name:12}{counts}", flush=True)
            for file in result.findings:
                print(f"    {file.relative_to(ROOT)}: {_last_line(file)}")
            failed |= bool(result.findings)
    return int(failed)


def _last_line(file: Path) -> str:
    with suppress(OSError, IndexError):
        return file.with_suffix(".txt").read_text(encoding="utf-8").strip().splitlines()[-1]
    return ""


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    sys.exit(main())
