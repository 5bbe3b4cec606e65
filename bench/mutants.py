"""Breaks one line of production code at a time, and runs the test that has to fail of it.

    python -m bench.mutants [--only WORD]

``tests/mutants.txt`` has a block of four lines for each: the file, the text that stands there once (``-``), what takes
its place (``+``), and the test that has to fail (``=``). Each is applied to a copy of the checkout, never to itself. A
mutant survives where its test passes, and then the line is tested by nobody; a test that does not fail but break (wrong
name, import error, time over) counts as an error. Exit code 1 where one survives or is in error.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
LIST = ROOT / "tests" / "mutants.txt"
_COPIED = ("heft", "onboard", "drivers", "hil_sim", "bench", "tests", "pyproject.toml")
_LONGEST_S = 1200.0
_FAILED = 1  # pytest's exit code where tests failed; others are errors


class Mutant(NamedTuple):
    """One change and the test that has to fail of it."""

    file: str
    before: str
    after: str
    test: str


def read(path: Path) -> list[Mutant]:
    """The list; blocks of four lines with an empty one between, ``#`` begins a comment.

    Raises:
        ValueError: a block that has other lines.
    """
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    blocks = [block.strip("\n").split("\n") for block in "\n".join(lines).split("\n\n") if block.strip()]
    found = []
    for block in blocks:
        if [line[:2] for line in block[1:]] != ["- ", "+ ", "= "]:
            raise ValueError(f"{path}: {block[0]}: give the file, '- text', '+ text', '= test', one a line")
        found.append(Mutant(block[0], *(line[2:] for line in block[1:])))
    return found


def mutated(mutant: Mutant, root: Path) -> str:
    """The file's text with the change.

    Raises:
        ValueError: its text is not there, or more than once.
    """
    text = (root / mutant.file).read_text(encoding="utf-8")
    if (times := text.count(mutant.before)) != 1:
        raise ValueError(f"{mutant.file} has {mutant.before!r} {times} times: correct tests/mutants.txt")
    return text.replace(mutant.before, mutant.after)


def tried(mutant: Mutant, copy: Path) -> str:
    """Apply it, run its test, and take it back: what came of it."""
    path, whole = copy / mutant.file, (copy / mutant.file).read_text(encoding="utf-8")
    path.write_text(mutated(mutant, copy), encoding="utf-8")
    command = [sys.executable, "-B", "-m", "pytest", "-q", "-x", "-n0", "-p", "no:cacheprovider"]
    command += ["-m", "not campaign", mutant.test]  # what CI runs
    try:
        ended = subprocess.run(
            command,
            cwd=copy,
            env=os.environ | {"PYTHONPATH": str(copy)},
            capture_output=True,
            text=True,
            timeout=_LONGEST_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "error: time over"
    finally:
        path.write_text(whole, encoding="utf-8")
    if ended.returncode == 0:
        return "SURVIVES"
    if ended.returncode != _FAILED:
        return f"error: pytest ends with {ended.returncode}: {(ended.stdout + ended.stderr).strip()[-300:]}"
    said = [line for line in ended.stdout.splitlines() if line.startswith("FAILED")]
    return f"killed by {said[0].split(' ', 1)[1].split(' - ')[0]}" if said else "error: no test failed"


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="those whose file or test has this in its name")
    word = parser.parse_args().only
    mutants = [one for one in read(LIST) if word in one.file or word in one.test]
    left = 0
    with tempfile.TemporaryDirectory(prefix="mutants_") as name:
        copy = Path(name)
        for part in _COPIED:
            if (ROOT / part).is_dir():
                shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(ROOT / part, copy / part)
        for one in mutants:
            began = time.monotonic()
            came = tried(one, copy)
            left += not came.startswith("killed")
            print(f"{time.monotonic() - began:5.0f} s  {one.file}: {one.before} -> {one.after}: {came}", flush=True)
    print(f"{len(mutants)} mutants, {left} survive or are in error")
    return 1 if left or not mutants else 0


if __name__ == "__main__":
    sys.exit(main())
