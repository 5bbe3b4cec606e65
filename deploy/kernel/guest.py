"""First program of the guest: brings the kernel's interfaces up and runs one command in the checkout.

    guest.py WORK     with WORK/checkout, WORK/kernel (the packages), WORK/results and WORK/command (NUL-separated)

The root file system is the host's, read-only. ``/run`` is a tmpfs with everything that is written; ``/run/results`` is
WORK/results of the host. The command's exit status goes to WORK/results/status: a guest that dies leaves none.
"""

import ctypes
import os
import subprocess
import sys
import termios
from pathlib import Path

import modules
import network

MODULES = ("can", "can-raw", "can-bcm", "vcan", "slcan", "i2c-dev", "cuse", "pps-ktimer")
INTERFACES = ("vcan0", "vcan1")
_libc = ctypes.CDLL(None, use_errno=True)


def mount(kind: str, where: str, options: str = "") -> None:
    """``mount -t KIND -o OPTIONS none WHERE``, made if it is not there. Raises OSError."""
    os.makedirs(where, exist_ok=True)
    if _libc.mount(b"none", where.encode(), kind.encode(), 0, options.encode()) != 0:
        code = ctypes.get_errno()
        raise OSError(code, f"mounting {kind} on {where}: {os.strerror(code)}")


def bring_up(work: Path) -> None:
    """File systems, modules, network. Raises OSError."""
    mount("proc", "/proc")
    mount("sysfs", "/sys")
    mount("devpts", "/dev/pts")
    mount("tmpfs", "/dev/shm")
    mount("tmpfs", "/run")
    mount("hostfs", "/run/results", str(work / "results"))
    os.makedirs("/run/tmp")
    loader = modules.Modules(work / "kernel/usr/lib/uml/modules")
    for name in MODULES:
        loader.load(name)
    for name in INTERFACES:
        network.add(name)
        network.set_up(name)
    network.set_up("lo")


def environment(checkout: Path, packages: Path) -> dict[str, str]:
    """The command's: the packages' programs are found, and nothing is written beside the sources."""
    kept = {name: value for name, value in os.environ.items() if name.startswith("OPENBLAS")}
    programs = [str(checkout / ".venv/bin"), *(str(packages / "usr" / name) for name in ("bin", "sbin"))]
    return {
        **kept,
        "HEFT_KERNEL_GUEST": "1",
        "HOME": "/run",
        "TMPDIR": "/run/tmp",
        "LANG": "C.UTF-8",
        "PATH": ":".join([*programs, "/usr/sbin", "/usr/bin", "/sbin", "/bin"]),
        "LD_LIBRARY_PATH": str(packages / "usr/lib/x86_64-linux-gnu"),
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONUNBUFFERED": "1",
    }


def main(work: Path) -> None:
    """Run the command and leave its status."""
    # the console passes text on as it is
    settings = termios.tcgetattr(sys.stdout)
    settings[1] &= ~termios.OPOST
    termios.tcsetattr(sys.stdout, termios.TCSANOW, settings)
    bring_up(work)
    packages = (work / "kernel").resolve()
    command = (work / "command").read_text(encoding="utf-8").split("\0")[:-1]
    checkout = (work / "checkout").resolve()
    done = subprocess.run(command, cwd=checkout, env=environment(checkout, packages), check=False)
    status = done.returncode if done.returncode >= 0 else 128 - done.returncode  # as a shell says "killed by"
    Path("/run/results/status").write_text(f"{status}\n", encoding="ascii")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
