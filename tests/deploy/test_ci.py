"""The gates of .ci/run, by programs that only say how they ended: one failure fails the run, a missing kernel none."""

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import is_alive

Done = subprocess.CompletedProcess[str]
Run = Callable[..., Done]
ROOT = Path(__file__).resolve().parents[2]

PYTHON = """#!/bin/sh
case "$*" in
    *'print(sys.version_info'*) echo '(3, 11)' ;;
    "-m $FAILS"*) shift 3; exit 1 ;;
    "-m $HANGS"*) echo $$ >>"$ALIVE"; exec sleep 100 ;;
    '-m mypy') [ -z "${MEETS:-}" ] || { : >"$MEETS.mypy"; until [ -e "$MEETS.kernel" ]; do sleep 0.05; done; } ;;
    '-m pytest'*)
        shift 2
        case ${MEETS:+$2} in
            'realtime and not campaign') sleep 0.5; : >"$MEETS.realtime" ;;
            'not realtime and not campaign') until [ -e "$MEETS.kernel" ]; do sleep 0.05; done ;;
        esac
        echo "$1 $2: 1 passed" ;;
esac
"""

KERNEL_TIER = """echo "kernel tier: $*"
case $KERNEL in hangs) echo $$ >>"$ALIVE"; exec sleep 100 ;; esac
if [ -n "${MEETS:-}" ]; then
    [ -e "$MEETS.realtime" ] || exit 1
    : >"$MEETS.kernel"
    until [ -e "$MEETS.mypy" ]; do sleep 0.05; done
fi
echo "over" >&2
exit "$KERNEL"
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout that is installed already."""
    checkout = tmp_path / "a checkout"
    for folder in (".ci", "deploy"):
        shutil.copytree(ROOT / folder, checkout / folder)
    (checkout / "pyproject.toml").write_text("[project]\n")
    python = checkout / ".venv/bin/python"
    python.parent.mkdir(parents=True)
    python.write_text(PYTHON)
    python.chmod(0o755)
    (checkout / "deploy/kernel_bench.sh").write_text(KERNEL_TIER)
    key = subprocess.run(
        ["sh", "-c", 'root=$1; . "$root/deploy/env.sh"; heft_venv=$root/.venv; heft_key', "sh", str(checkout)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    (checkout / ".venv/heft-test").write_text(key)
    return checkout


@pytest.fixture
def run(checkout: Path) -> Run:
    """Runs the gates; the kernel tier ends with the code given."""

    def run_it(*arguments: str, kernel: int = 0, fails: str = "nothing", **environment: str) -> Done:
        return subprocess.run(
            ["bash", str(checkout / ".ci/run"), *arguments],
            env={**os.environ, "KERNEL": str(kernel), "FAILS": fails, "HANGS": "nothing", **environment},
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )

    return run_it


def gates(done: Done) -> list[str]:
    return [line[3:] for line in done.stdout.splitlines() if line.startswith("== ")]


def test_all_gates_run_and_the_tests_have_the_last_word(run: Run) -> None:
    done = run()
    assert done.returncode == 0, done.stdout + done.stderr
    assert gates(done) == ["ruff check", "ruff format", "tests", "mypy --strict", "other processors", "kernel tier"]
    assert done.stdout.endswith(
        "cannot: none\nfailed gates: none\n-m not realtime and not campaign: 1 passed\n"
        "-m realtime and not campaign: 1 passed\n"
    )


def test_arguments_go_to_one_run_of_all_tests(run: Run) -> None:
    done = run("-k", "some of them")
    assert done.returncode == 0, done.stdout + done.stderr
    assert gates(done)[2:4] == ["tests", "mypy --strict"]
    assert done.stdout.endswith("-k some of them: 1 passed\n")


@pytest.mark.parametrize(
    ("fails", "gate"),
    [
        ("ruff check", "ruff check"),
        ("ruff format", "ruff format"),
        ("mypy", "mypy --strict"),
        ("pytest -m not", "tests"),
        ("pytest -m realtime", "tests"),
        ("pytest -q", "other processors"),
    ],
)
def test_one_failure_fails_the_run_and_the_rest_is_run_all_the_same(run: Run, fails: str, gate: str) -> None:
    done = run(fails=fails)
    assert done.returncode == 1
    assert f"\nfailed gates: {gate}\n" in done.stdout
    assert "kernel tier: " in done.stdout


def test_a_machine_that_cannot_run_the_kernel_tier_is_told_of_and_fails_nothing(run: Run) -> None:
    done = run(kernel=69)
    assert done.returncode == 0
    assert "\nnot run, for this machine cannot: kernel tier\nfailed gates: none\n" in done.stdout


@pytest.mark.parametrize("code", [1, 70, 75, 124])
def test_any_other_end_of_the_kernel_tier_fails(run: Run, code: int) -> None:
    done = run(kernel=code)
    assert done.returncode == 1
    assert "cannot: none\nfailed gates: kernel tier\n" in done.stdout


def test_the_kernel_tier_runs_beside_what_is_not_in_real_time_and_is_shown_whole(run: Run, tmp_path: Path) -> None:
    """It begins when the tests against the wall clock are over, with those of all cores and mypy beside it."""
    done = run(MEETS=str(tmp_path / "at work"))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "\n== kernel tier\nkernel tier: -q --durations=5\nover\n-- kernel tier: " in done.stdout
    assert done.stdout.index("-- other processors: ") < done.stdout.index("== kernel tier")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    ("hangs", "kernel", "hang"), [("pytest -m", "0", 2), ("mypy", "hangs", 2), ("none", "hangs", 1)]
)
def test_a_signal_ends_every_gate(
    checkout: Path, tmp_path: Path, hangs: str, kernel: str, hang: int, number: signal.Signals
) -> None:
    alive = tmp_path / "alive"
    environment = {"KERNEL": kernel, "FAILS": "nothing", "HANGS": hangs, "ALIVE": str(alive), "TMPDIR": str(tmp_path)}
    with subprocess.Popen(
        ["bash", str(checkout / ".ci/run")], env={**os.environ, **environment}, stdout=subprocess.PIPE, text=True
    ) as gates_run:
        wait_for(lambda: alive.exists() and len(alive.read_text().split()) == hang)
        gates_run.send_signal(number)
        gates_run.communicate(timeout=60)
    assert gates_run.returncode == 130
    wait_for(lambda: not any(map(is_alive, map(int, alive.read_text().split()))))
    wait_for(lambda: not list(tmp_path.glob("tmp.*")))


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)
