"""Fork servers: processes that have imported and built what a worker needs, and fork it when they are asked.

The first has no threads; it has loaded what acquisition and recording need, and no model of the vehicle. It is forked
from the supervisor where that has no threads yet, else an interpreter of its own. Another is forked from it, builds the
estimator and forks the processes of estimation. They share the memory of what was imported. A forked process waits to
be told to begin, so that there is a spare of each worker: a fork takes 30 to 250 ms on a computer at load 10.

The supervisor is made the one that adopts orphans (``PR_SET_CHILD_SUBREAPER``), and each worker is forked twice: so it
is the supervisor's child, which learns its exit code, and outlives the server that made it.
"""

import contextlib
import ctypes
import gc
import os
import pkgutil
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from importlib import import_module
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path
from typing import NamedTuple

from onboard.flight.supervise import pages

ANSWER_TIMEOUT_S = 60.0
OF_TERMINAL = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # and of a service: to all processes of a flight
_PR_SET_CHILD_SUBREAPER = 36
_PRELOADED = (
    "numpy.random",
    "onboard.flight.supervise.workers",
    "onboard.flight.store.flight_log",
    "onboard.flight.acquire.devices",
)

Body = Callable[..., None]


class ForkError(RuntimeError):
    """A fork server died, or does not answer."""


class Forked(NamedTuple):
    """A new process, and this end of the pipe to it: it waits for the first message before it begins."""

    pid: int
    pipe: Connection


class ForkServer:
    """The process that forks workers, started again where it died.

    Args:
        shared: it is forked from this process, if that has one thread, with all that is loaded here; one that takes its
            place never is.
    """

    def __init__(self, *, shared: bool = False) -> None:
        adopt_orphans()
        self._shared = shared
        self._pid: int | None = None
        self._control: Connection | None = None
        self.look()

    def fork(self, body: Body, *arguments: object) -> Forked:
        """A new process that runs ``body(*arguments, pipe)`` once it is sent something.

        Raises:
            ForkError: there is no server, and none can be started.
        """
        self.look()
        try:
            return _ask(self._control, body, arguments)
        except ForkError:
            self.close()
            self.look()
            return _ask(self._control, body, arguments)

    def look(self) -> bool:
        """Start it where it is not running; whether that was so. Does not wait for it."""
        if self._pid is not None and exit_code(self._pid) is None:
            return False
        self._pid = None
        self.close()
        self._control, end = Pipe()
        self._pid = _split(end) if self._shared and threading.active_count() == 1 else _interpreter(end)
        self._shared = False
        end.close()
        return True

    def close(self) -> None:
        """End it; the processes that it made go on."""
        if self._control is not None:
            self._control.close()
        if self._pid is not None:
            _end(self._pid)
            self._pid = None


class PreparedServer:
    """A fork server with something built in it: its processes run ``body(*arguments, *built, pipe)``.

    Args:
        parent: forks it.
        prepare: runs in it, ``prepare(*arguments, control)``, and calls :func:`serve` in the end.
        arguments: of ``prepare``.
    """

    def __init__(self, parent: ForkServer, prepare: Body, *arguments: object) -> None:
        self._parent, self._prepare, self._arguments = parent, prepare, arguments
        self._forked: Forked | None = None
        self._first: object = None

    def first(self) -> object:
        """Its first message, waited for.

        Raises:
            ForkError: it died before that.
        """
        self.look()
        if self._first is None and self._forked is not None:
            self._first = _answer(self._forked.pipe)
        return self._first

    def fork(self, body: Body, *arguments: object) -> Forked:
        """See :meth:`ForkServer.fork`."""
        try:
            self.first()
            return _ask(self._forked.pipe if self._forked else None, body, arguments)
        except ForkError:
            self.close()
            self.first()
            return _ask(self._forked.pipe if self._forked else None, body, arguments)

    def look(self) -> bool:
        """See :meth:`ForkServer.look`."""
        if self._forked is not None and exit_code(self._forked.pid) is None:
            return False
        self._forked = None
        self.close()
        self._forked = self._parent.fork(self._prepare, *self._arguments)
        self._forked.pipe.send(True)
        return True

    def close(self) -> None:
        """End it; the processes that it made go on."""
        self._first = None
        if self._forked is not None:
            self._forked.pipe.close()
            _end(self._forked.pid)
            self._forked = None


def adopt_orphans() -> None:
    """Make this process the parent of the orphans among its descendants."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def exit_code(pid: int, *, wait: bool = False) -> int | None:
    """Exit code of a child, negative for a signal, once; None while it lives, 0 where it has been asked for before."""
    try:
        ended, status = os.waitpid(pid, 0 if wait else os.WNOHANG)
    except ChildProcessError:
        return 0
    return os.waitstatus_to_exitcode(status) if ended else None


def _end(pid: int) -> None:
    """Kill a child, and wait for its end."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    exit_code(pid, wait=True)


def _interpreter(end: Connection) -> int:
    """Start a server as an interpreter of its own; its process."""
    environment = {
        "OPENBLAS_NUM_THREADS": "1",
        **os.environ,
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
    }
    os.set_inheritable(end.fileno(), True)
    command = [sys.executable, "-m", __name__, str(end.fileno())]
    no_input = (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0)
    return os.posix_spawn(sys.executable, command, environment, file_actions=[no_input])


def _split(end: Connection) -> int:
    """Fork a server from this process; it and all that it forks end in here. Its process."""
    gc.collect()
    gc.freeze()  # else collections write to what is shared
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    if pid := os.fork():
        return pid
    code = 1
    try:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.closerange(3, end.fileno())
        os.closerange(end.fileno() + 1, os.sysconf("SC_OPEN_MAX"))
        _run(end)
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
        if isinstance(ended.code, str):
            sys.stderr.write(f"{ended.code}\n")
    except BaseException:  # noqa: BLE001 - as an interpreter ends
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code)


def _ask(control: Connection | None, body: Body, arguments: tuple[object, ...]) -> Forked:
    if control is None:
        raise ForkError("no fork server")
    pipe, end = Pipe()
    try:
        control.send((body, arguments))
        send_handle(control, end.fileno(), None)
        pid = _answer(control)
    except (OSError, ForkError) as error:
        pipe.close()
        raise ForkError(f"the fork server does not answer ({error})") from error
    finally:
        end.close()
    assert isinstance(pid, int)
    return Forked(pid, pipe)


def _answer(control: Connection) -> object:
    try:
        if not control.poll(ANSWER_TIMEOUT_S):
            raise ForkError(f"no answer for {ANSWER_TIMEOUT_S:g} s")
        return control.recv()
    except (EOFError, OSError) as error:
        raise ForkError("it died; its message stands above") from error


def serve(control: Connection, *built: object) -> None:
    """Fork processes until the other end of ``control`` is closed; returns in each of them when its body ends.

    Args:
        control: to the supervisor.
        built: given to every body.
    """
    gc.collect()
    gc.freeze()  # what is shared with the forked processes is not written to by their collections
    pages.give_back()
    while True:
        try:
            body, arguments = control.recv()
            end = recv_handle(control)
        except (EOFError, OSError):
            return
        reading, writing = os.pipe()
        if middle := os.fork():
            os.close(end)
            os.close(writing)
            told = os.read(reading, 20)
            os.close(reading)
            os.waitpid(middle, 0)  # from now on the process is the supervisor's child
            control.send(int(told))
            continue
        if pid := os.fork():
            os.write(writing, str(pid).encode())
            os._exit(0)
        os.close(reading)
        os.close(writing)
        control.close()
        pipe = Connection(end)
        name_process("spare")
        try:
            pipe.recv()
        except (EOFError, OSError):
            return  # it was not needed
        body(*arguments, *built, pipe)
        return


def leave_signals_to_supervisor() -> None:
    """Ignore what a terminal or a service manager sends to all: the supervisor says what comes of it."""
    for number in OF_TERMINAL:
        signal.signal(number, signal.SIG_IGN)


def name_process(name: str) -> None:
    """For the lists of processes that an operator looks at."""
    with contextlib.suppress(OSError):
        Path("/proc/self/comm").write_text(f"heft-{name}"[:15], encoding="ascii")


def main() -> None:
    """A server that is an interpreter of its own."""
    _run(Connection(int(sys.argv[1])))


def _run(control: Connection) -> None:
    """The process of :class:`ForkServer`."""
    leave_signals_to_supervisor()
    name_process("forks")
    transports = import_module("drivers.transports")
    for found in pkgutil.walk_packages(transports.__path__, "drivers.transports."):
        with contextlib.suppress(ImportError):  # of a bus library that this computer does not have
            import_module(found.name)
    for module in _PRELOADED:
        import_module(module)
    serve(control)


if __name__ == "__main__":
    main()
