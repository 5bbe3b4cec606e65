"""heft's command line: parses arguments, makes one call, returns an exit code.

Each command is a module of this package, named like it, with ``add(commands)``; nothing else names it.

Exit codes: 0 done; 1 it ran and failed (nothing identified, replay differs, a worker died, nothing recoverable); 2 the
input cannot be used (arguments, vehicle file, mapping, missing file); 3 the log is truncated or damaged, the readable
part was processed; 4 preflight found the vehicle not ready; 69 there is no compiled core
and no compiler to make it.
"""

import argparse
import atexit
import contextlib
import errno
import gc
import importlib
import importlib.metadata
import os
import pkgutil
import sys
from collections.abc import Callable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType

from onboard.cli.common import BAD_INPUT, DAMAGED, FAILED, OK, UNAVAILABLE, complain
from onboard.native.errors import NativeError

_SHARED = "__main__", "common", "controller", "lines", "messages"  # modules that are no commands
_LATE = "numpy.f2py", "numpy.testing"
_COLLECTED_EVERY = 20_000  # objects made more than given back

__all__ = ["BAD_INPUT", "DAMAGED", "FAILED", "OK", "UNAVAILABLE", "main", "parser"]


class _LateParts(MetaPathFinder):
    """Loads parts of NumPy where they are used: SciPy names them all, and these, which nothing needs, are a sixth."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(fullname, path, target) if fullname in _LATE else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``heft`` and return its exit code."""
    # The matrices are small: BLAS threads cost more than they save (a replay takes a third of the time without).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if "numpy" in sys.modules:  # which has read that by now: called from a script
        from threadpoolctl import threadpool_limits

        threadpool_limits(1, user_api="blas")
    # Pydantic looks for plugins in the metadata of every installed package: 0.03 s of every start.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    if not any(isinstance(finder, _LateParts) for finder in sys.meta_path):
        sys.meta_path.insert(0, _LateParts())
    gc.set_threshold(_COLLECTED_EVERY)  # what is imported stays: looking through it takes a tenth of a start
    atexit.register(gc.freeze)  # nor is it looked through when the process ends
    argv = sys.argv[1:] if argv is None else argv
    arguments = parser(*argv[:1]).parse_args(argv)
    command: Callable[[argparse.Namespace], int] = arguments.command
    try:
        if str(getattr(arguments, "json", None)) != "-":
            return command(arguments)
        arguments.json = sys.stdout  # which gets nothing else
        with contextlib.redirect_stdout(sys.stderr):
            return command(arguments)
    except KeyboardInterrupt:
        return 130
    except NativeError as error:
        complain(str(error))
        return UNAVAILABLE
    except (OSError, ValueError) as error:
        # errors of bad input have one of these as second parent; any other exception is a bug
        if isinstance(error, BrokenPipeError):
            return OK
        complain(_sentence(error))
        return BAD_INPUT


def _sentence(error: OSError | ValueError) -> str:
    """Message with remedy; heft's errors contain it, for system errors it is added here."""
    if refused := getattr(error, "refused", ()):  # a scenario's, which the simulator lists itself
        from onboard.config.errors import Origin
        from onboard.config.explain import explained

        origins = [Origin(str(getattr(error, "label", ""))), *(Origin(*file) for file in getattr(error, "files", ()))]
        return "\n".join(line for one in refused for line in explained(one[0], one[2], one[1], origins, one[3]))
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EFBIG, errno.EDQUOT):
        from onboard.recording.space import refusal

        return refusal(error)
    if isinstance(error, OSError) and error.strerror and error.filename:
        remedy = {
            FileNotFoundError: "check the path",
            FileExistsError: "files are not overwritten; name another file",
            PermissionError: "get permission for it, or name another",
            IsADirectoryError: "name a file",
            NotADirectoryError: "a file of that name exists; name another directory",
        }.get(type(error), "")
        return f"{error.filename}: {error.strerror.lower()}" + (f"; {remedy}" if remedy else "")
    return str(error)


def parser(command: str = "") -> argparse.ArgumentParser:
    """Of the command line, with one command, or with every one where there is none of that name."""
    made = argparse.ArgumentParser(
        prog="heft",
        description="Identify the payload of a free-flying servicer's arm: acquisition, log, inertial estimation.",
        epilog="exit codes: 0 done, 1 ran and failed, 2 bad input, 3 log damaged but read, 4 not ready to fly, "
        "69 no compiled core",
    )
    made.add_argument("--version", action="version", version=f"heft {_version()}")
    commands = made.add_subparsers(required=True, metavar="COMMAND")
    every = {one.name.rstrip("_"): one.name for one in pkgutil.iter_modules(__path__) if one.name not in _SHARED}
    for name in [command] if command in every else sorted(every):
        importlib.import_module(f"{__name__}.{every[name]}").add(commands)
    return made


def _version() -> str:
    try:
        return importlib.metadata.version("heft-flight")
    except importlib.metadata.PackageNotFoundError:
        return "of a checkout that is not installed"
