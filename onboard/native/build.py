"""Compiles the library: with the compiler at hand, else with the one that the package ``ziglang`` brings.

Used when heft is installed (deploy/backend.py) and, for a checkout, at the first import
(:mod:`onboard.native.library`). Imports the standard library alone: nothing else is there when a wheel is made.
"""

import hashlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from onboard.native.errors import NativeError

SOURCES = Path(__file__).parent / "src"
FLAGS = (
    *("-std=c11", "-O3", "-fPIC", "-shared", "-fvisibility=hidden"),
    *("-ffp-contract=off", "-fno-fast-math", "-fno-math-errno"),
)
SYSTEM = ("cc", "gcc", "clang")
ZIG = "ziglang==0.17.1"  # deploy/requirements-compiler.lock has its hashes
_TRIAL = "#include <stdlib.h>\n"  # a compiler alone, without the C library's headers, is none
REMEDY = "Run: sudo apt install gcc libc6-dev, or: pip install ziglang"


def key() -> str:
    """Of the sources and how they are compiled; a library of another key is not loaded."""
    digest = hashlib.sha256(repr(FLAGS).encode())
    for path in sorted(SOURCES.iterdir()):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def file_name(machine: str = "") -> str:
    """Of the library, for this machine or another."""
    return f"heft-{key()}-{machine or platform.machine()}.so"


def system_compilers() -> list[list[str]]:
    """Commands of the system's compilers that work."""
    return [[path] for name in SYSTEM if (path := shutil.which(name)) and _works(path)]


def _works(compiler: str) -> bool:
    command = [compiler, "-fsyntax-only", "-x", "c", "-"]
    try:
        return subprocess.run(command, input=_TRIAL, capture_output=True, text=True, check=False).returncode == 0
    except OSError:
        return False


def compilers() -> list[list[str]]:
    """Commands of the compilers that are here, the system's first."""
    return system_compilers() + ([zig(platform.machine())] if importlib.util.find_spec("ziglang") else [])


def zig(machine: str) -> list[str]:
    """Command of ``ziglang`` for a machine, ``x86_64`` or ``aarch64``: no newer instructions or glibc than any has."""
    target = ["-target", f"{machine}-linux-gnu.2.28", f"-mcpu={'baseline' if machine == 'x86_64' else 'generic'}"]
    return [sys.executable, "-m", "ziglang", "cc", *target, "-fno-sanitize=undefined", "-s"]  # no paths in it


def compile_into(path: Path, command: Sequence[str], flags: Sequence[str] = FLAGS) -> None:
    """Make the library, all or nothing: another process that makes it at the same time disturbs nothing.

    Args:
        path: of the library.
        command: of the compiler.
        flags: for it.

    Raises:
        NativeError: it failed.
    """
    sources = [str(one) for one in sorted(SOURCES.glob("*.c"))]
    with tempfile.TemporaryDirectory(prefix=".making-", dir=path.parent) as directory:
        made = Path(directory) / path.name
        arguments = [*command, *flags, f'-DHEFT_KEY="{key()}"', "-o", str(made), *sources]
        try:
            done = subprocess.run(arguments, capture_output=True, text=True, check=False, errors="replace")
        except OSError as error:
            raise NativeError(f"{command[0]}: {error.strerror}") from error
        if done.returncode != 0:
            raise NativeError(f"{' '.join(command)}: exit code {done.returncode}: {done.stderr.strip()[-500:]}")
        os.replace(made, path)


def build(directory: Path) -> Path:
    """Make the library in a directory with the first compiler that can.

    Raises:
        NativeError: there is none.
    """
    path, failed = directory / file_name(), []
    for command in compilers():
        try:
            compile_into(path, command)
        except NativeError as error:
            failed.append(str(error))
        else:
            return path
    why = "\n".join(failed) if failed else f"none of {', '.join(SYSTEM)} works here, nor is there the package ziglang"
    raise NativeError(f"heft's compiled core cannot be made: {why}. {REMEDY}")
