"""deploy/install.sh without installing: what systemd says of the unit, and dry runs. deploy/try_install.sh installs."""

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
INSTALLER = ROOT / "deploy" / "install.sh"
WORST_EXPOSURE = 3.0
USAGE, DATA = 64, 65  # sysexits.h

systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not on this machine")
debian = pytest.mark.skipif(
    any(
        shutil.which(tool, path="/usr/sbin:/usr/bin:/sbin:/bin") is None for tool in ("systemctl", "apt-get", "runuser")
    ),
    reason="the installer is for Debian with systemd",
)


@pytest.fixture(scope="module", autouse=True)
def _apt_that_has_every_package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Whether apt finds what is missing, which takes it 2 s, is asked by deploy/try_install.sh."""
    directory = tmp_path_factory.mktemp("bin")
    (directory / "apt-get").symlink_to("/bin/true")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", f"{directory}:{os.environ['PATH']}")
        yield


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    """The unit, with a program that every machine has."""
    text = (ROOT / "deploy" / "heft.service").read_text(encoding="utf-8")
    path = tmp_path / "heft.service"
    path.write_text(re.sub("(?m)^ExecStart=.*$", "ExecStart=/bin/true", text), encoding="utf-8")
    return path


def analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemd-analyze", *arguments], capture_output=True, text=True, timeout=60, check=False)


@systemd
def test_the_unit_is_one_and_a_misspelt_one_is_not(unit: Path) -> None:
    done = analyze("verify", str(unit))
    assert (done.returncode, done.stderr) == (0, "")
    unit.write_text(unit.read_text(encoding="utf-8").replace("[Service]", "[Service]\nProtectSystems=strict"))
    assert "ProtectSystems" in analyze("verify", str(unit)).stderr


@systemd
def test_what_a_hostile_file_could_reach_is_little(unit: Path) -> None:
    def exposure() -> float:
        done = analyze("security", "--offline=true", "--no-pager", str(unit))
        found = re.search(r"exposure level for .*: ([0-9.]+)", done.stdout)
        assert found, done.stdout + done.stderr
        return float(found[1])

    assert exposure() <= WORST_EXPOSURE
    unit.write_text("[Service]\nExecStart=/bin/true\nUser=heft\n")
    assert exposure() > 8.0  # without a sandbox


def install(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {"PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin", "HEFT_PYTHON": shutil.which("python3") or "python3"}
    return subprocess.run(
        ["sh", str(INSTALLER), "--dry-run", *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def own_vehicle(directory: Path, url: str) -> str:
    (directory / "mine.urdf").write_text("<robot name='mine'/>")
    file = directory / "mine.toml"
    file.write_text(f"[vehicle]\nurdf = 'mine.urdf'\n[bus.a]\nurl = '{url}'\n", encoding="utf-8")
    return str(file)


@debian
def test_interfaces_are_those_of_the_vehicle_file(tmp_path: Path) -> None:
    done = install("--vehicle", own_vehicle(tmp_path, "can+socketcan://can3?bitrate=250000"))
    assert done.returncode == 0, done.stderr
    assert "would write /etc/systemd/network/60-heft-can3.network" in done.stdout
    assert "would write /etc/heft/mine.urdf" in done.stdout
    assert "modules-load" not in done.stdout  # no I2C
    done = install("--vehicle", own_vehicle(tmp_path, "i2c:///dev/i2c-1"))
    assert done.returncode == 0, done.stderr
    assert "modules-load" in done.stdout
    assert "systemd/network" not in done.stdout


@debian
@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        ([], USAGE, "packaged are: air_bearing"),
        (["--vehicle", "rocksatt"], USAGE, "rocksatt/vehicle.toml; packaged are"),
        (["--frobnicate"], USAGE, "unknown argument --frobnicate"),
        (["--vehicle"], USAGE, "needs a value"),
        (["--name", "A B=/dev/ttyUSB0"], USAGE, "small letters"),
        (["--name", "nimu=/dev/null"], USAGE, "/dev/null"),
        (["--mcp2515", "16 MHz"], USAGE, "OSCILLATOR:PIN"),
    ],
)
def test_what_it_cannot_use_is_refused(arguments: list[str], code: int, said: str) -> None:
    done = install(*arguments)
    assert done.returncode == code, done.stdout
    assert said in done.stderr


@debian
@pytest.mark.parametrize(
    "url", ["can+socketcan://can0%20up?bitrate=500000", "can+socketcan://../x", "can+socketcan://can0?bitrate=1;reboot"]
)
def test_a_crafted_vehicle_file_names_no_file(tmp_path: Path, url: str) -> None:
    done = install("--vehicle", own_vehicle(tmp_path, url))
    assert done.returncode == DATA, done.stdout
    assert "no CAN interface" in done.stderr
    assert "would write" not in done.stdout.replace("would write /etc/heft", "")
