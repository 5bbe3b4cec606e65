"""Fork servers: what their processes have loaded, whose children they are, and what a server's death costs."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from onboard import config
from onboard.flight.supervise import workers
from onboard.flight.supervise.runner_forks import Forked, ForkServer, PreparedServer, exit_code
from tests.conftest import is_alive
from tests.flight import forked


@pytest.fixture(scope="module", autouse=True)
def others() -> set[int]:
    """Processes that earlier tests of this worker have left."""
    return children()


def children() -> set[int]:
    """Of this process, by their names of heft's."""
    pids = map(int, Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split())
    return {pid for pid in pids if Path(f"/proc/{pid}/comm").read_text().startswith("heft-")}


@pytest.fixture(scope="module")
def prepared(light: ForkServer) -> Iterator[PreparedServer]:
    server = PreparedServer(light, workers.prepare_estimation, config.load(config.packaged("workshop")))
    yield server
    server.close()


def told(process: Forked) -> tuple[int, list[str]]:
    """How many arguments a process was given, and what it has loaded; it is ours, and ends with 3 when told to."""
    process.pipe.send(True)
    assert process.pipe.poll(60)
    given, pid, parent, loaded = process.pipe.recv()
    assert (pid, parent) == (process.pid, os.getpid())
    assert exit_code(pid) is None
    process.pipe.send(True)
    assert exit_code(pid, wait=True) == 3
    return given, loaded


def test_recording_and_acquisition_load_no_model(light: ForkServer) -> None:
    assert told(light.fork(forked.tell, 1, 2)) == (2, [])


def test_the_supervisor_loads_no_model(tmp_path: Path) -> None:
    program = (
        "import sys\n"
        "from onboard import cli\n"
        "from tests.flight import forked\n"
        f"code = cli.main(['fly', 'rocksat', '--log', {str(tmp_path / 'a.mcap')!r}, '--duration', '0.1', '--quiet',\n"
        "    '--url=i2c_1=i2c:///none', '--url=can_0=can+slcan:///none?bitrate=500000',\n"
        "    '--url=sync_line=gpio:///dev/none?line=1'])\n"
        "print(code, forked.heavy())\n"
    )
    environment = {**os.environ, "HEFT_RINGS": str(tmp_path / "rings"), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, env=environment, check=True
    )
    assert done.stdout.splitlines()[-1] == "1 []", done.stderr


def test_estimation_is_forked_with_its_estimator_built(prepared: PreparedServer) -> None:
    first = prepared.first()
    assert isinstance(first, workers.Prepared)
    assert {"estimate", "quantity", "tick"} <= first.channels.keys()
    given, loaded = told(prepared.fork(forked.tell))
    assert given == 2  # the estimator and its places
    assert "pinocchio" in loaded
    assert not set(loaded) & set(forked.NOT_IN_FLIGHT)  # megabytes of each process of an estimator


def test_a_vehicle_that_cannot_be_estimated_is_refused(light: ForkServer, tmp_path: Path) -> None:
    """Its drawing is another one than when its file was read."""
    packaged = config.packaged("workshop")
    urdf = tmp_path / "workshop.urdf"
    urdf.write_text(packaged.with_name("workshop.urdf").read_text())
    vehicle = config.load(packaged, urdf)
    urdf.write_text("<robot/>")
    server = PreparedServer(light, workers.prepare_estimation, vehicle)
    first = server.first()
    assert isinstance(first, workers.Refused)
    assert "it has no <link>" in first.why
    server.close()


def test_servers_that_were_killed_are_replaced_and_their_processes_live_on(
    light: ForkServer, prepared: PreparedServer, others: set[int]
) -> None:
    processes = [light.fork(forked.tell), prepared.fork(forked.tell)]
    servers = children() - others - {process.pid for process in processes}
    assert len(servers) == 2
    for server in servers:
        os.kill(server, signal.SIGKILL)
    time.sleep(0.2)
    for process, given in zip(processes, (0, 2), strict=True):
        assert told(process)[0] == given
    assert told(prepared.fork(forked.tell))[0] == 2
    assert told(light.fork(forked.tell, 1))[0] == 1


def test_an_error_of_the_system_in_a_process_is_no_end_in_order(light: ForkServer) -> None:
    process = light.fork(forked.fail)
    process.pipe.send(True)
    assert exit_code(process.pid, wait=True) == 1
    unneeded = light.fork(forked.fail)
    unneeded.pipe.close()
    assert exit_code(unneeded.pid, wait=True) == 0


def ran(program: str) -> subprocess.CompletedProcess[str]:
    """A program of its own, at its end."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, env=environment, check=False
    )


@pytest.mark.parametrize("shared", [False, True])
def test_a_server_ends_with_its_supervisor(*, shared: bool) -> None:
    program = (
        "import os\n"
        "from onboard.flight.supervise.runner_forks import ForkServer\n"
        "from tests.flight import forked\n"
        f"server = ForkServer(shared={shared})\n"
        "spare, used = (server.fork(forked.tell) for _ in range(2))\n"
        "used.pipe.send(True)\n"
        "used.pipe.recv()\n"
        "print(spare.pid, used.pid, server._pid, flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    done = ran(program)
    left = [int(pid) for pid in done.stdout.split()]
    assert len(left) == 3
    deadline = time.monotonic() + 30
    while any(is_alive(pid) for pid in left) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [pid for pid in left if is_alive(pid)]


def test_a_server_shares_what_is_loaded_where_there_is_one_thread_and_its_successor_does_not() -> None:
    """What ends in a process that it forked ends there: the supervisor alone goes on, and its files are its own."""
    program = (
        "import os, signal, sys, threading, time\n"
        "from onboard.flight.supervise.runner_forks import ForkServer, exit_code\n"
        "from tests.flight import forked\n"
        "sys.modules['scipy.stats'] = os  # as if it were loaded\n"
        "held = open(os.devnull)\n"
        "def loaded(server):\n"
        "    process = server.fork(forked.tell)\n"
        "    process.pipe.send(True)\n"
        "    found = process.pipe.recv()[3]\n"
        "    files = os.listdir(f'/proc/{process.pid}/fd')\n"
        "    process.pipe.send(True)\n"
        "    return found, exit_code(process.pid, wait=True), str(held.fileno()) in files\n"
        "server = ForkServer(shared=True)\n"
        "print(loaded(server))\n"
        "failing = [server.fork(body) for body in (forked.fail, forked.refuse)]\n"
        "for process in failing:\n"
        "    process.pipe.send(True)\n"
        "    print(exit_code(process.pid, wait=True))\n"
        "os.kill(server._pid, signal.SIGKILL)\n"
        "time.sleep(0.2)\n"
        "print(loaded(server)[:2])\n"
        "server.close()\n"
        "threading.Thread(target=time.sleep, args=(2,), daemon=True).start()\n"
        "print(loaded(ForkServer(shared=True))[:2])\n"
    )
    done = ran(program)
    here, *others = done.stdout.splitlines()
    assert (here, others) == ("(['scipy.stats'], 3, False)", ["1", "1", "([], 3)", "([], 3)"]), done.stderr
    assert "OSError: no space left on device" in done.stderr
    assert "why it cannot go on\n" in done.stderr
