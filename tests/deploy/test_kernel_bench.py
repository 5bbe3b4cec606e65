"""deploy/kernel_bench.sh with a guest that is a shell script: what is checked, how it is started, what comes back."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
TOOLS = (
    *("sh", "cat", "cut", "dirname", "rm", "mkdir", "cp", "chmod", "sha256sum", "mktemp", "ln", "df", "awk", "sed"),
    *("timeout", "id", "tr", "env", "true", "uname", "sleep", "grep"),
)
UNAVAILABLE, DIED, TEMPORARY_FAILURE, TIMED_OUT = 69, 70, 75, 124  # sysexits.h, timeout(1)

PYTHON = """#!/bin/sh
case "$*" in
    *'print(sys.version_info'*) echo '(3, 11)' ;;
    '-m compileall'*) echo compiled >>"$CALLS" ;;
    *) exit 1 ;;
esac
"""

# The guest: writes down its command line, does what init's WORK/command says by the host's own means.
GUEST = """#!/bin/sh
for word; do
    case $word in init=*) init=${word#init=} ;; esac
done
[ "$init" != /bin/true ] || { echo "panic - not syncing: Attempted to kill init! exitcode=$TRUE" >&2; exit 134; }
work=${init%/init}
{ echo "$*"; cat "$init"; tr '\\0' '|' <"$work/command"; echo; } >>"$CALLS"
[ -z "${HANG:-}" ] || exec sleep 60
[ -z "${STATUS:-}" ] || echo "$STATUS" >"$work/results/status"
echo "$OUTPUT"
echo 'no ptrace here' >&2
"""


class Machine:
    """A checkout that is installed already, and the packages fetched."""

    def __init__(self, directory: Path) -> None:
        self.checkout = directory / "a checkout"
        shutil.copytree(DEPLOY, self.checkout / "deploy")
        (self.checkout / "pyproject.toml").write_text("[project]\n")
        python = self.checkout / ".venv/bin/python"
        python.parent.mkdir(parents=True)
        python.write_text(PYTHON)
        python.chmod(0o755)
        self.bin = directory / "bin"
        self.bin.mkdir()
        for tool in TOOLS:
            (self.bin / tool).symlink_to(shutil.which(tool) or tool)
        for tool in ("apt-get", "dpkg-deb"):
            self.program(tool, "exit 1")
        self.log = directory / "calls"
        self.cache = directory / "cache"
        guest = self.cache / "kernel/usr/bin/linux.uml"
        guest.parent.mkdir(parents=True)
        guest.write_text(GUEST)
        guest.chmod(0o755)
        (self.cache / "kernel/complete").write_text("user-mode-linux can-utils i2c-tools libi2c0")
        self.stamp()

    def program(self, name: str, text: str) -> None:
        (self.bin / name).unlink(missing_ok=True)
        (self.bin / name).write_text(f"#!/bin/sh\n{text}\n")
        (self.bin / name).chmod(0o755)

    def stamp(self) -> None:
        """Say that .venv holds what it should, as deploy/env.sh does."""
        key = subprocess.run(
            ["sh", "-c", 'root=$1; . "$root/deploy/env.sh"; heft_venv=$root/.venv; heft_key', "sh", str(self.checkout)],
            env={"PATH": str(self.bin)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        (self.checkout / ".venv/heft-test").write_text(key)

    def run(self, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        self.log.unlink(missing_ok=True)
        return subprocess.run(
            ["sh", str(self.checkout / "deploy/kernel_bench.sh"), *arguments],
            env={
                "PATH": str(self.bin),
                "CALLS": str(self.log),
                "HEFT_KERNEL_CACHE": str(self.cache),
                "OUTPUT": "tested",
                "TRUE": "0x00000000",
                **environment,
            },
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_the_tests_run_in_the_guest_and_their_status_comes_back(machine: Machine) -> None:
    done = machine.run("-k", "can bus", STATUS="0")
    assert (done.returncode, done.stdout) == (0, "tested\n"), done.stderr
    compiled, line, *init, command = machine.log.read_text().splitlines()
    assert compiled == "compiled"
    assert "mem=1536M rootfstype=hostfs rootflags=/ root=/dev/root ro init=/tmp/heft-kernel." in line
    assert init[0] == "#!/bin/sh"
    assert [words.split("/deploy/kernel/")[1].split()[0] for words in init[3:]] == ["guest.py", "power_off.py"]
    assert command == "python|-m|pytest|-p|no:cacheprovider|-o|testpaths=tests/kernel|-k|can bus|"
    assert machine.run(STATUS="3").returncode == 3


def test_another_command(machine: Machine) -> None:
    assert machine.run("--exec", "python", "a file.py", STATUS="0").returncode == 0
    assert machine.log.read_text().splitlines()[-1] == "python|a file.py|"
    assert machine.run("--exec").returncode == 64


def test_results_are_kept_where_asked_and_an_old_status_is_not_taken_for_a_new_one(
    machine: Machine, tmp_path: Path
) -> None:
    results = tmp_path / "kept here"
    assert machine.run(STATUS="0", HEFT_KERNEL_RESULTS=str(results)).returncode == 0
    assert (results / "status").read_text() == "0\n"
    assert machine.run(HEFT_KERNEL_RESULTS=str(results)).returncode == DIED


def test_a_guest_that_dies_or_hangs_is_told_apart_from_tests_that_fail(machine: Machine) -> None:
    died = machine.run()
    assert died.returncode == DIED
    assert "no ptrace here" in died.stderr
    assert "ended without a result (code 0)" in died.stderr
    hung = machine.run(HANG="1", HEFT_KERNEL_TIMEOUT="1", STATUS="0")
    assert hung.returncode == TIMED_OUT
    assert "stopped after 1 s" in hung.stderr


def test_a_machine_on_which_no_program_runs_in_the_guest_cannot_run_the_tier(machine: Machine) -> None:
    done = machine.run(TRUE="0x0000000b")  # as on a processor with AMX, whose registers are too many for the guest
    assert done.returncode == UNAVAILABLE
    assert "--cap-add SYS_PTRACE" in done.stderr


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("uname", 'case $1 in -m) echo aarch64 ;; -s) echo Linux ;; *) echo "Linux aarch64" ;; esac', "Linux aarch64"),
        ("apt-get", "", "needs apt-get"),
        ("df", "echo; echo tmpfs 9 9 65536 1% /dev/shm", "needs 1536 MB"),
    ],
)
def test_what_this_machine_lacks_is_named(machine: Machine, name: str, text: str, message: str) -> None:
    if text:
        machine.program(name, text)
    else:
        (machine.bin / name).unlink()
    done = machine.run(STATUS="0")
    assert (done.returncode, done.stdout) == (UNAVAILABLE, "")
    assert message in done.stderr
    assert not machine.log.exists()


def test_packages_are_fetched_once_and_a_broken_fetch_is_taken_up_again(machine: Machine) -> None:
    complete = machine.cache / "kernel/complete"
    guest = (machine.cache / "kernel/usr/bin/linux.uml").read_text()
    complete.unlink()
    broken = machine.run(STATUS="0")
    assert broken.returncode == TEMPORARY_FAILURE
    assert not complete.exists()
    (machine.bin / "guest").write_text(guest)
    machine.program("apt-cache", "echo there")
    machine.program(
        "apt-get",
        'echo "apt $*" >>"$CALLS"; cat "$APT_CONFIG" >/dev/null || exit 1\n'
        'case $2 in download) for p; do : >"$p.deb"; done ;; esac',
    )
    machine.program(
        "dpkg-deb",
        f'mkdir -p "$3/usr/bin"; cp "{machine.bin}/guest" "$3/usr/bin/linux.uml"; chmod +x "$3/usr/bin/linux.uml"',
    )
    whole = machine.run(STATUS="0")
    assert (whole.returncode, whole.stdout) == (0, "tested\n"), whole.stderr
    apt = [line for line in machine.log.read_text().splitlines() if line.startswith("apt ")]
    assert apt == ["apt -qq update", "apt -qq download user-mode-linux can-utils i2c-tools libi2c0"]
    assert machine.run(STATUS="0").returncode == 0
    assert "apt " not in machine.log.read_text()


def test_nothing_is_left_behind(machine: Machine) -> None:
    before = set(Path("/tmp").glob("heft-kernel.*"))
    machine.run(STATUS="0")
    machine.run()
    assert set(Path("/tmp").glob("heft-kernel.*")) <= before


def test_the_script_is_posix_and_executable() -> None:
    script = DEPLOY / "kernel_bench.sh"
    assert os.access(script, os.X_OK)
    assert script.read_text().startswith("#!/bin/sh\n")
