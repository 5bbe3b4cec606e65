"""The benches behind the numbers of README.md, one after another: what each printed, its time, its exit code.

::

    python -m bench.all --quick [--only NAME ...] [--out DIR] [--pages docs/evidence]

``--quick`` takes few seeds and short flights of each, ten minutes in all on a machine that is otherwise idle; without
it each runs as ``bench/README.md`` names it, for hours. Benches that need recordings look for them in
``$HEFT_DATASETS`` or ``../shared/datasets`` and are left out where they are not. ``--pages`` writes what each printed
as a page of evidence. Exit code 1 where one failed or missed a bar that it judges.
"""

import argparse
import os
import platform
import re
import resource
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[1]
DATASETS: Final = Path(os.environ.get("HEFT_DATASETS", ROOT.parent / "shared/datasets"))

_PROGRESS: Final = re.compile(r"s so far$|^dashboard: |^next: |^\S*report\.html$")  # of a campaign


class Job(NamedTuple):
    """A command, and its arguments for a short run and for the whole one."""

    module: str
    quick: str
    whole: str = ""
    recordings: str = ""  # directory of the recordings that it needs
    label: str = ""  # where one module is run twice

    @property
    def name(self) -> str:
        """By which ``--only`` knows it."""
        return self.label or self.module


BENCHES: Final = (
    Job("acquisition", "--rounds 7", "--rounds 21"),
    Job("recording", "--records 100000"),
    Job("reading", "--records 100000 --minutes 1"),
    Job("kill_recorder", "--kills 10", "--kills 200"),
    Job("timebase", "--seeds 4 --hour 120 --field 1", "--real"),
    Job("mechanics", "--calls 100 --block-seconds 1", "--calls 2000"),
    Job("speed", "--only hil-rocksat --rounds 1"),
    Job("flight", "--quick", "--minutes 1"),
    Job("page", "--seconds 10", "--vehicle dymaflex --seconds 30"),
    Job("page_drawing", "--seconds 3", "--seconds 10"),
    Job("restarts", "--kills 1", "--kills 50 --load 4 --nice -10"),
    Job("mission_accuracy", "rocksat --first 501 --seeds 2", "rocksat --first 501 --seeds 6", label="rocksat"),
    Job("mission_accuracy", "dymaflex --first 1101 --seeds 2", "dymaflex --first 1101 --seeds 8", label="dymaflex"),
    Job("mission_accuracy", "noise --seeds 2", "noise", label="noise"),
    Job("mission_accuracy", "recursive --seeds 1", "recursive --seeds 40", label="recursive"),
    Job(
        "mission_accuracy",
        "student_arm --first 9501 --seeds 1",
        "student_arm --first 9501 --seeds 20",
        label="student_arm",
    ),
    Job("mission_accuracy", "lab_ur --first 9701 --seeds 1", "lab_ur --first 9701 --seeds 20", label="lab_ur"),
    Job("captures", "--seeds 2", "", "workshop_tools"),
    Job(
        "mission_accuracy",
        "tools --seeds 1 --first 101",
        "tools --seeds 3 --first 101",
        recordings="workshop_tools",
        label="tools",
    ),
    Job("mission_accuracy", "planar --seeds 1", "planar --seeds 33", label="planar"),
    Job("resync", "--seeds 2", "--seeds 100"),
    Job("tudelft_accuracy", "{recordings} --offsets 1", "{recordings}", "tudelft_tumbling"),
    Job("arms", "", "", "staubli_tx40"),
    Job("bodies", "planar --seeds 1 --seconds 30", "planar", label="planar_bodies"),
    Job("bodies", "spherical --seeds 1", "spherical", label="spherical_bearing"),
    Job(
        "faults",
        "--flights 4 --first 7601 --without-estimator",
        "--flights 40 --first 7601 --without-estimator",
        label="faults_random",
    ),
)


class BenchResult(NamedTuple):
    """Of one bench."""

    name: str
    command: str
    said: str  # "ok", "1: failed, or missed a bar", or why it was not run
    wall_s: float = 0.0
    cpu_s: float = 0.0


def run(bench: Job, quick: bool, out: Path) -> BenchResult:
    """Run one; what it prints goes to the terminal and into a file."""
    recordings = DATASETS / bench.recordings
    arguments = (bench.quick if quick else bench.whole).format(recordings=recordings)
    command = f"python -m bench.{bench.module} {arguments}".strip()
    if bench.recordings and not recordings.is_dir():
        return BenchResult(bench.name, command, f"not run: no {recordings}")
    print(f"\n== {command}", flush=True)
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "HEFT_DATASETS": str(DATASETS)}
    before, began = _children_cpu_s(), time.monotonic()
    call = [sys.executable, "-m", f"bench.{bench.module}", *arguments.split()]
    with (
        (out / f"{bench.name}.txt").open("w", encoding="utf-8") as kept,
        subprocess.Popen(
            call, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as process,
    ):
        assert process.stdout is not None
        for line in process.stdout:
            kept.write(line)
            print(line, end="", flush=True)
    code = process.returncode
    said = "ok" if code == 0 else f"{code}: failed, or missed a bar"
    return BenchResult(bench.name, command, said, time.monotonic() - began, _children_cpu_s() - before)


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def machine() -> str:
    """Processor, cores, Python and load at the moment, for the head of a table."""
    model = next(
        (line.split(":", 1)[1].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")),
        platform.machine(),
    )
    now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    return f"{now}, {model}, {os.cpu_count()} cores, Python {platform.python_version()}, load {os.getloadavg()[0]:.1f}"


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text(encoding="utf-8").splitlines()
    except OSError:
        return []


def head_of(name: str) -> str:
    """Title and first sentence of a page of evidence, as the table of these pages has them; of another its name."""
    listed = (ROOT / "docs" / "evidence" / "index.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| \[(.+?)\]\({name}\.md\) \| (.+?) \|", listed, re.MULTILINE)
    if row is None:
        return f"# {name.replace('_', ' ').capitalize()}"
    title, shows = (text[0].upper() + text[1:] for text in row.groups())
    return f"# {title}\n\n{shows}."


def page(done: BenchResult, about: str, printed: str, path: Path) -> None:
    """Write a page of evidence: command, revision, machine, and what the bench printed, without lines of progress."""
    revision = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    command = done.command.replace(str(DATASETS), "$HEFT_DATASETS")
    kept = [line.rstrip() for line in printed.splitlines() if not _PROGRESS.search(line)]
    printed = "\n".join(kept).strip("\n").replace(str(DATASETS), "$HEFT_DATASETS")
    printed = re.sub(rf"{re.escape(tempfile.gettempdir())}/\S+/", "", printed)  # of logs that are gone
    shown = printed if printed.startswith("|") else f"```text\n{printed}\n```"  # a table, or as on a terminal
    text = f"""{head_of(done.name)}

Made by `python -m bench.all --only {done.name} --pages docs/evidence`, which ran `{command}`: {about}, code
{revision.stdout.strip()}, {done.cpu_s:.0f} s of CPU time, {done.said}.

{shown}
"""
    path.write_text(text, encoding="utf-8")


def main() -> int:
    """Run them, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="ten minutes instead of hours")
    parser.add_argument("--only", nargs="+", choices=[bench.name for bench in BENCHES], metavar="NAME")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep what each printed (default: a new one in /tmp)")
    parser.add_argument("--pages", type=Path, metavar="DIR", help="also write what each printed as a page, NAME.md")
    options = parser.parse_args()
    out: Path = options.out or Path(tempfile.mkdtemp(prefix="heft-benches-"))
    out.mkdir(parents=True, exist_ok=True)
    about, began = machine(), time.monotonic()
    print(about)
    done = [run(bench, options.quick, out) for bench in BENCHES if not options.only or bench.name in options.only]
    if options.pages:
        for one in (one for one in done if one.wall_s):
            page(one, about, (out / f"{one.name}.txt").read_text(encoding="utf-8"), options.pages / f"{one.name}.md")
    table = ["| bench | s | CPU s | exit |", "|---|---|---|---|"]
    table += [f"| `{one.command}` | {one.wall_s:.0f} | {one.cpu_s:.0f} | {one.said} |" for one in done]
    text = "\n".join([about, "", *table, "", f"{time.monotonic() - began:.0f} s in all; load {os.getloadavg()[0]:.1f}"])
    (out / "summary.md").write_text(text + "\n", encoding="utf-8")
    print(f"\n{text}\nwhat each printed: {out}")
    return 0 if all(one.said == "ok" or one.said.startswith("not run") for one in done) else 1


if __name__ == "__main__":
    sys.exit(main())
