"""libFuzzer by atheris, in legs.

Each leg is a process of its own that goes on from the inputs the one before kept: atheris 3.0 leaks what a comparison
of NumPy arrays gives, 45 kB an execution of the MPU-6050 target, and libFuzzer ends a process at 2 GB.
"""

import importlib
import os
import re
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

from bench.fuzzing.findings import FOLDER, HANG_S, ROOT, FuzzFindings, Result

LEG_S = 60.0


def fuzz(name: str, seed: int, seconds: float) -> Result:
    """One decoder, for so long.

    Raises:
        RuntimeError: A leg ended before its time: it crashed, or ran out of memory.
    """
    (FOLDER / name).mkdir(parents=True, exist_ok=True)
    legs = max(round(seconds / LEG_S), 1)
    executions, took, paths = 0, 0.0, 0
    files: dict[str, Path] = {}  # by place: a leg does not know what the one before found
    with tempfile.TemporaryDirectory() as corpus:
        for leg in range(legs):
            command = [sys.executable, "-m", "bench.fuzzing.atheris_engine", name, corpus]
            command += [str(seed + 1000 * leg), str(round(seconds / legs))]
            environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
            done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(f"{name}: libFuzzer ended with {done.returncode}:\n{done.stderr[-3000:]}")
            told = _report(done.stderr)
            executions, took, paths = executions + told[0], took + told[1], told[2]
            for line in done.stdout.splitlines():
                place, _, file = line.partition("\t")
                files.setdefault(place, Path(file))
    return Result(executions, took, paths, list(files.values()))


def _report(text: str) -> tuple[int, float, int]:
    """Executions, seconds, and inputs kept, out of libFuzzer's report."""
    units = re.findall(r"stat::number_of_executed_units:\s+(\d+)", text)
    kept = re.findall(r"corp: (\d+)", text)
    seconds = re.findall(r"Done \d+ runs in (\d+) second", text)
    if not units or not seconds:
        raise RuntimeError(f"libFuzzer did not come to its end:\n{text[-3000:]}")
    return int(units[-1]), float(seconds[-1]), int(kept[-1]) if kept else 0


def run_leg(name: str, corpus: Path, seed: int, **limit: int) -> None:
    """Fuzz in this process, which ends with it. Its report goes to stderr, findings (place, tab, file) to stdout.

    ``limit`` is libFuzzer's: ``max_total_time`` in s, or ``runs``, which finds the same on any computer.
    """
    atheris = importlib.import_module("atheris")  # it may not be there, and ships no type hints
    from bench.fuzzing import target as of  # noqa: PLC0415 - what is ours is instrumented as they are imported

    with atheris.instrument_imports(include=["drivers", "onboard"], enable_loader_override=False):
        target = of(name)
    findings = FuzzFindings(target.call, FOLDER / name)
    warnings.simplefilter("error")

    def one(data: bytes) -> None:
        known = len(findings.files)
        findings.run(data)
        for place, file in list(findings.files.items())[known:]:
            print(place, file, sep="\t", flush=True)

    for number, data in enumerate(target.seeds):
        (corpus / f"seed_{number}").write_bytes(data)
    options = {
        "seed": seed,
        "max_len": target.most_bytes,
        "timeout": round(6 * HANG_S),
        "print_final_stats": 1,
        "artifact_prefix": f"{FOLDER / name}/",
        **limit,
    }
    atheris.Setup([sys.argv[0], *(f"-{key}={value}" for key, value in options.items()), str(corpus)], one)
    atheris.Fuzz()


if __name__ == "__main__":
    run_leg(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), max_total_time=int(sys.argv[4]))
