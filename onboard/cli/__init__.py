"""heft's command line. Thin: arguments in, one call, an exit code out.

Each command is a module of this package, named like it, with ``add(commands)``; nothing else names it.

Exit codes: 0 done; 1 it ran and failed (nothing identified, a replay that differs, a worker that died, nothing
recoverable); 2 the input cannot be used (arguments, vehicle file, mapping, no such file); 3 the log is truncated or
damaged, and what could be read was; 4 preflight found the vehicle not ready.
"""

import argparse
import importlib
import importlib.metadata
import os
import pkgutil
import sys
from collections.abc import Callable, Sequence

from onboard.cli.common import BAD_INPUT, DAMAGED, FAILED, OK

__all__ = ["BAD_INPUT", "DAMAGED", "FAILED", "OK", "main", "parser"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``heft`` and return its exit code."""
    # The matrices are small: threads of BLAS wait for each other more than they work (a replay takes a third without).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    arguments = parser().parse_args(argv)
    command: Callable[[argparse.Namespace], int] = arguments.command
    try:
        return command(arguments)
    except KeyboardInterrupt:
        return 130
    except (OSError, ValueError) as error:
        # every error that bad input can cause is one of these by its second parent; a bug is anything else
        if isinstance(error, BrokenPipeError):
            return OK
        sys.stderr.write(f"heft: {_sentence(error)}\n")
        return BAD_INPUT


def _sentence(error: OSError | ValueError) -> str:
    """What went wrong, and what to do: errors of ours say it themselves, those of the system are put into words."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        remedy = {
            FileNotFoundError: "check the path",
            FileExistsError: "it is never written over; name another file",
            PermissionError: "ask for the right to it, or name another",
            IsADirectoryError: "name a file",
            NotADirectoryError: "a file of that name is in the way; name another directory",
        }.get(type(error), "")
        return f"{error.filename}: {error.strerror.lower()}" + (f"; {remedy}" if remedy else "")
    return str(error)


def parser() -> argparse.ArgumentParser:
    """Of the command line, with every command."""
    made = argparse.ArgumentParser(
        prog="heft",
        description="Weigh what an arm holds: acquisition, log and inertial identification for free-flying servicers.",
        epilog="exit codes: 0 done, 1 ran and failed, 2 bad input, 3 log damaged but read, 4 not ready to fly",
    )
    made.add_argument("--version", action="version", version=f"heft {_version()}")
    commands = made.add_subparsers(required=True, metavar="COMMAND")
    for found in sorted(module.name for module in pkgutil.iter_modules(__path__)):
        if found not in ("__main__", "common", "messages"):
            importlib.import_module(f"{__name__}.{found}").add(commands)
    return made


def _version() -> str:
    try:
        return importlib.metadata.version("heft-flight")
    except importlib.metadata.PackageNotFoundError:
        return "of a checkout that is not installed"
