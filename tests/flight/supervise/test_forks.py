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
from tests.flight import forked


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
    text = config.load(config.packaged("workshop")).text.replace("urdf =", 'base_link = "none"\nurdf =', 1)
    whole = [line for line in text.splitlines() if not line.startswith('base_link = "') or "none" in line]
    source = config.packaged("workshop").parent
    (tmp_path / "workshop.urdf").write_text(next(source.glob("*.urdf")).read_text())
    vehicle = config.parse("\n".join(whole), tmp_path / "vehicle.toml", tmp_path / "workshop.urdf")
    server = PreparedServer(light, workers.prepare_estimation, vehicle)
    first = server.first()
    assert isinstance(first, workers.Refused)
    assert "none" in first.why
    server.close()


def test_servers_that_were_killed_are_replaced_and_their_processes_live_on(
    light: ForkServer, prepared: PreparedServer
) -> None:
    processes = [light.fork(forked.tell), prepared.fork(forked.tell)]
    children = [int(pid) for pid in Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()]
    servers = set(children) - {process.pid for process in processes}
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


def test_a_server_ends_with_its_supervisor(tmp_path: Path) -> None:
    program = (
        "import os\n"
        "from onboard.flight.supervise.runner_forks import ForkServer\n"
        "from tests.flight import forked\n"
        "server = ForkServer()\n"
        "spare, used = (server.fork(forked.tell) for _ in range(2))\n"
        "used.pipe.send(True)\n"
        "used.pipe.recv()\n"
        "print(spare.pid, used.pid, server._process.pid, flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, timeout=120, env=environment, check=False
    )
    left = [int(pid) for pid in done.stdout.split()]
    assert len(left) == 3
    deadline = time.monotonic() + 30
    while any(is_alive(pid) for pid in left) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [pid for pid in left if is_alive(pid)]


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
