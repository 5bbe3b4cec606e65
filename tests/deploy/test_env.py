"""deploy/*.sh with a Python that only writes down what it was asked: what is checked, installed and run, and when.

PATH holds nothing but that Python and the few tools named here, so the scripts cannot lean on anything else.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import is_alive

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
TOOLS = (
    *("sh", "cat", "cut", "dirname", "rm", "mkdir", "cp", "chmod", "sha256sum"),
    *("mktemp", "tee", "tail", "awk", "date", "timeout", "grep", "sort", "nice", "mkfifo", "sleep"),
)
UNAVAILABLE, TEMPORARY_FAILURE = 69, 75  # sysexits.h

# Answers like a Python 3.11 unless LACKS names what it should lack.
PYTHON = """#!/bin/sh
case "$*" in
    *'< (3, 11)'*) case " $LACKS " in *' new '*) exit 1 ;; esac ;;
    *'!= 8'*) case " $LACKS " in *' 64-bit '*) exit 1 ;; esac ;;
    *ensurepip*) case " $LACKS " in *' venv '*) exit 1 ;; esac ;;
    *libgomp*) case " $LACKS " in *' libgomp '*) exit 1 ;; esac ;;
    *'%d.%d'*) echo 3.11 ;;
    *'print(sys.version_info'*) echo "${MINOR:-(3, 11)}" ;;
    -V) echo 'Python 3.9.2' ;;
    '-m venv --clear '*)
        echo venv >>"$CALLS"
        mkdir -p "$4/bin" && cp "$0" "$4/bin/python"
        printf '#!/bin/sh\\necho "flown with $* ${PYTHONPATH-clean} $OPENBLAS_NUM_THREADS"\\n' >"$4/bin/heft"
        chmod +x "$4/bin/heft"
        ;;
    '-m pip --version') ;;
    '-m pip install'*)
        echo "$*" >>"$CALLS"
        for last; do :; done
        case $last in */part.[01]) cat "$last" >"$CALLS.${last##*/}" ;; esac
        case " $LACKS " in *' network '*) exit 1 ;; *' haste '*) echo $$ >>"$CALLS.pids"; exec sleep 60 ;; esac
        ;;
    "-m pytest -m $FAILS"*) echo "= 1 failed, 2 passed, 40 deselected in 1.50s ="; exit 1 ;;
    '-m pytest'*) echo "tested with $*"; echo "= 30 passed, 1 skipped, 3 deselected in 61.50s (0:01:01) =" ;;
    *) echo "unexpected: $*" >&2; exit 99 ;;
esac
"""


class Machine:
    """A checkout, and a machine that has Python and hardly anything else."""

    def __init__(self, directory: Path) -> None:
        self.checkout = directory / "a checkout"
        shutil.copytree(DEPLOY, self.checkout / "deploy")
        (self.checkout / "pyproject.toml").write_text("[project]\n")
        (self.checkout / "onboard/native/src").mkdir(parents=True)
        for name in ("build.py", "src/chain.c"):
            (self.checkout / "onboard/native" / name).write_text("\n")
        for name, text in (("test_b.py", "realtime"), ("test_a.py", "@pytest.mark.realtime"), ("test_c.py", "")):
            (self.checkout / "tests").mkdir(exist_ok=True)
            (self.checkout / "tests" / name).write_text(text)
        self.bin = directory / "bin"
        self.bin.mkdir()
        for tool in TOOLS:
            (self.bin / tool).symlink_to(shutil.which(tool) or tool)
        self.python = self.bin / "python3"
        self.python.write_text(PYTHON)
        self.python.chmod(0o755)
        self.compiler = self.bin / "cc"
        self.compiler.write_text("#!/bin/sh\n")
        self.compiler.chmod(0o755)
        self.elsewhere = directory / "elsewhere"
        self.elsewhere.mkdir()
        self.log = directory / "calls"

    def run(
        self, script: str, *arguments: str, lacks: str = "", **environment: str
    ) -> subprocess.CompletedProcess[str]:
        self.log.unlink(missing_ok=True)
        return subprocess.run(
            ["sh", str(self.checkout / "deploy" / script), *arguments],
            cwd=self.elsewhere,
            env=self.environment(lacks) | environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )

    def environment(self, lacks: str = "") -> dict[str, str]:
        """Of a script."""
        said = {"PATH": str(self.bin), "LACKS": lacks, "FAILS": "nothing", "CALLS": str(self.log)}
        return {**said, "PYTHONPATH": "/opt/ros"}

    @property
    def calls(self) -> list[str]:
        """What the last run asked of venv and pip; of the halves of a lock one."""
        called = self.log.read_text().splitlines() if self.log.exists() else []
        halves = [call for call in called if call.endswith(("/part.0", "/part.1"))]
        assert len(halves) in (0, 2)
        return [call for call in called if call not in halves[1:]]

    def was_asked_for(self, lock: str) -> bool:
        """Whether the halves are this lock, with the hashes of each package beside it."""
        asked = "".join(self.log.with_name(f"calls.part.{half}").read_text() for half in "01")
        pinned = re.split(r"^(?=\w)", (self.checkout / "deploy" / lock).read_text(), flags=re.MULTILINE)
        return sorted(re.split(r"^(?=\w)", asked, flags=re.MULTILINE)) == sorted(pinned)


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_first_run_installs_what_the_lock_pins_and_flies(machine: Machine) -> None:
    done = machine.run("hil.sh", "--seed", "3")
    assert done.returncode == 0, done.stderr
    venv, packages, itself = machine.calls
    assert venv == "venv"
    assert "--no-deps --require-hashes --only-binary :all: -r" in packages
    assert machine.was_asked_for("requirements.lock")
    assert "--no-deps --no-index --no-build-isolation" in itself
    assert itself.endswith(f"--editable {machine.checkout}")
    assert done.stdout == "flown with hil rocksat --seed 3 clean 1\n"


def test_without_a_compiler_one_comes_from_the_package_index(machine: Machine) -> None:
    machine.compiler.write_text("#!/bin/sh\necho 'stdlib.h: no such file' >&2; exit 1\n")
    done = machine.run("hil.sh")
    assert (done.returncode, "stdlib.h" in done.stderr) == (0, False)
    assert machine.calls[2].endswith(
        f"--require-hashes --only-binary :all: -r {machine.checkout}/deploy/requirements-compiler.lock"
    )
    assert machine.calls[3].endswith(f"--editable {machine.checkout}")


def test_another_scenario_is_flown_by_its_name(machine: Machine) -> None:
    assert machine.run("hil.sh", "dymaflex", "--seed", "3").stdout == "flown with hil dymaflex --seed 3 clean 1\n"


def test_second_run_calls_neither_venv_nor_pip(machine: Machine) -> None:
    machine.run("hil.sh")
    again = machine.run("hil.sh", lacks="network venv")
    assert (again.returncode, machine.calls) == (0, [])
    assert (again.stdout, again.stderr) == ("flown with hil rocksat clean 1\n", "")


def test_the_tests_environment_serves_both(machine: Machine) -> None:
    done = machine.run("test.sh", "-k", "ring")
    assert done.stdout.splitlines()[0] == "tested with -m pytest -k ring"
    assert len(done.stdout.splitlines()) == 2
    assert machine.was_asked_for("requirements-test.lock")
    assert machine.run("hil.sh").returncode == 0
    assert machine.calls == []


def test_without_arguments_all_tests_run_and_one_line_says_how_they_ended(machine: Machine) -> None:
    done = machine.run("test.sh")
    assert (done.returncode, done.stderr.count("Error")) == (0, 0)
    tested = [line for line in done.stdout.splitlines() if line.startswith("tested with")]
    assert tested == [
        "tested with -m pytest -m not realtime and not campaign --numprocesses auto --dist loadfile "
        "--no-loadscope-reorder",
        "tested with -m pytest -m realtime and not campaign --numprocesses auto --dist worksteal "
        "tests/test_a.py tests/test_b.py",
    ]
    assert re.fullmatch(r"heft: 60 passed, 2 skipped in \d+ s", done.stdout.splitlines()[-1])


@pytest.mark.parametrize("part", ["not realtime", "realtime"])
def test_a_failure_in_either_part_fails_and_the_other_is_run_all_the_same(machine: Machine, part: str) -> None:
    done = machine.run("test.sh", FAILS=part)
    assert done.returncode == 1
    assert re.fullmatch(r"heft: 1 failed, 32 passed, 1 skipped in \d+ s", done.stdout.splitlines()[-1])
    assert done.stdout.count("tested with") == 1


def test_the_flights_environment_lacks_the_test_tools(machine: Machine) -> None:
    machine.run("hil.sh")
    assert machine.run("test.sh").returncode == 0
    assert machine.was_asked_for("requirements-test.lock")
    assert [call.rsplit("/", 1)[-1] for call in machine.calls[1:]] == ["a checkout"]


@pytest.mark.parametrize(
    "changed",
    [
        *("pyproject.toml", "deploy/requirements.lock", "deploy/requirements-test.lock", "deploy/env.sh"),
        *("deploy/backend.py", "onboard/native/build.py", "onboard/native/src/chain.c"),
    ],
)
def test_what_is_installed_follows_its_sources(machine: Machine, changed: str) -> None:
    machine.run("hil.sh")
    with (machine.checkout / changed).open("a") as file:
        file.write("# changed\n")
    machine.run("hil.sh")
    assert len(machine.calls) == 2
    machine.run("hil.sh")
    assert machine.calls == []


def test_another_python_or_place_installs_again(machine: Machine) -> None:
    machine.run("hil.sh")
    assert machine.run("hil.sh", MINOR="(3, 13)").returncode == 0
    assert len(machine.calls) == 2
    machine.checkout = machine.checkout.rename(machine.checkout.with_name("moved"))
    machine.run("hil.sh", MINOR="(3, 13)")
    assert machine.calls[-1].endswith("--editable " + str(machine.checkout))


def test_a_broken_environment_is_made_anew(machine: Machine) -> None:
    machine.run("hil.sh")
    (machine.checkout / ".venv/bin/python").unlink()
    assert machine.run("hil.sh").returncode == 0
    assert machine.calls[0] == "venv"


def test_an_installation_that_broke_off_is_taken_up_again(machine: Machine) -> None:
    broken = machine.run("hil.sh", lacks="network")
    assert (broken.returncode, broken.stdout) == (TEMPORARY_FAILURE, "")
    assert "Run the same command again" in broken.stderr
    whole = machine.run("hil.sh")
    assert whole.returncode == 0
    assert "venv" not in machine.calls
    assert len(machine.calls) == 2


def test_ctrl_c_ends_both_halves_of_an_installation(machine: Machine) -> None:
    command, pids = ["sh", str(machine.checkout / "deploy/hil.sh")], machine.log.with_name("calls.pids")
    with subprocess.Popen(command, env=machine.environment("haste"), start_new_session=True) as script:
        until(lambda: pids.exists() and len(pids.read_text().split()) == 2)
        os.killpg(script.pid, signal.SIGINT)
    until(lambda: not any(is_alive(int(pid)) for pid in pids.read_text().split()))


def until(holds: Callable[[], bool], seconds: float = 20.0) -> None:
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_broken_update_is_not_taken_for_what_was_there_before(machine: Machine) -> None:
    machine.run("hil.sh")
    lock = machine.checkout / "deploy/requirements.lock"
    before = lock.read_text()
    lock.write_text(before + "# changed\n")
    assert machine.run("hil.sh", lacks="network").returncode == TEMPORARY_FAILURE
    lock.write_text(before)
    machine.run("hil.sh")
    assert len(machine.calls) == 2


@pytest.mark.parametrize(
    ("lacks", "message"),
    [
        ("venv", "heft: this system lacks python3.11-venv. Run: sudo apt install python3.11-venv"),
        ("libgomp", "heft: this system lacks libgomp1. Run: sudo apt install libgomp1"),
        (
            "venv libgomp",
            "heft: this system lacks python3.11-venv libgomp1. Run: sudo apt install python3.11-venv libgomp1",
        ),
        ("64-bit", "heft: this is a 32-bit Python; Pinocchio and MuJoCo need a 64-bit system."),
        (
            "new",
            "heft: python3 is Python 3.9.2; heft needs 3.11 or newer: Debian 12 or Raspberry Pi OS bookworm.",
        ),
    ],
)
@pytest.mark.parametrize("script", ["hil.sh", "test.sh"])
def test_what_the_system_lacks_is_named(machine: Machine, script: str, lacks: str, message: str) -> None:
    done = machine.run(script, lacks=lacks)
    assert (done.returncode, done.stdout, machine.calls) == (UNAVAILABLE, "", [])
    assert done.stderr.splitlines()[0] == message
    assert not (machine.checkout / ".venv").exists()


def test_no_python_at_all(machine: Machine) -> None:
    machine.python.unlink()
    done = machine.run("hil.sh")
    assert (done.returncode, done.stderr) == (
        UNAVAILABLE,
        "heft: there is no Python here. Run: sudo apt install python3 python3-venv\n",
    )


def test_a_newer_python_beside_an_old_one_is_found(machine: Machine) -> None:
    newer = machine.bin / "python3.12"
    shutil.copy(machine.python, newer)
    machine.python.write_text('#!/bin/sh\n[ "$1" != -c ]\n')
    assert machine.run("hil.sh").returncode == 0
    assert machine.calls[0] == "venv"


def test_a_python_named_by_hand_is_the_only_one_tried(machine: Machine) -> None:
    chosen = machine.elsewhere / "python"
    shutil.copy(machine.python, chosen)
    machine.python.write_text("#!/bin/sh\nexit 1\n")
    assert machine.run("hil.sh", HEFT_PYTHON=str(chosen)).returncode == 0
    shutil.rmtree(machine.checkout / ".venv")
    done = machine.run("hil.sh", HEFT_PYTHON="/no/such/python")
    assert done.returncode == UNAVAILABLE
    assert "HEFT_PYTHON=/no/such/python" in done.stderr


def test_the_scripts_are_posix_and_executable() -> None:
    for name in ("hil.sh", "test.sh", "lock.sh"):
        assert os.access(DEPLOY / name, os.X_OK), name
        assert (DEPLOY / name).read_text().startswith("#!/bin/sh\n"), name


def test_the_installed_heft_is_found_beside_a_checkout_of_that_name(tmp_path: Path) -> None:
    """A clone in the home directory is a directory ``heft``, a namespace package to a Python that is started there."""
    for name in ("heft", "onboard", "drivers", "hil_sim"):
        (tmp_path / name).mkdir()
    script = "import heft, onboard.channels, drivers.records, hil_sim.arrays; print(heft.open.__name__)"
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    ran = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, env=clean, capture_output=True, text=True, check=False
    )
    assert (ran.returncode, ran.stdout) == (0, "open_log\n"), ran.stderr
