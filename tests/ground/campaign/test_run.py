"""Campaigns on real worker processes, a worker, the scheduler or the client killed: the results of a serial run.

Campaigns as processes of their own, and what their results hold.

A flight's files are in memory where there is room, and gone afterwards, also those of a worker that was killed.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

import pyarrow.dataset
import pytest
from dask import config as dask_config
from distributed import Client

from onboard import cli
from onboard.cli.campaign import fly
from onboard.ground.campaign import engine, plan_file
from onboard.ground.campaign import scratch as module
from onboard.ground.campaign.design import Item, items
from onboard.ground.campaign.flights import OtherCodeError
from onboard.ground.campaign.revision import revision
from onboard.ground.campaign.scratch import scratch
from onboard.ground.campaign.store import Content, Store
from onboard.recording.reader import LogReader

_KILLED = """
import os, signal, sys
from pathlib import Path
from onboard.ground.campaign import scratch
scratch.MEMORY = Path(sys.argv[1])
with scratch.scratch() as directory:
    (directory / "flight.mcap").write_text("a log")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def memory(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "MEMORY", tmp_path)
    return tmp_path


def test_files_are_in_memory_and_gone_afterwards(memory):
    before = tempfile.gettempdir()
    with scratch() as directory:
        assert directory.parent == memory
        with tempfile.TemporaryDirectory() as own:  # of a plan's own function
            assert Path(own).parent == directory
    assert list(memory.iterdir()) == []
    assert tempfile.gettempdir() == before


def test_without_room_they_are_on_the_disk(memory, monkeypatch, tmp_path_factory):
    disk = tmp_path_factory.mktemp("disk")
    monkeypatch.setattr(module, "_ROOM", 1 << 62)
    monkeypatch.setattr(tempfile, "tempdir", str(disk))
    with scratch() as directory:
        assert directory.parent == disk
    monkeypatch.setattr(module, "MEMORY", memory / "missing")
    with scratch() as directory:
        assert directory.parent == disk


def test_what_a_killed_worker_left_is_removed_and_nothing_that_is_in_use(memory):
    killed = subprocess.run([sys.executable, "-c", _KILLED, str(memory)], check=False)
    assert killed.returncode == -signal.SIGKILL
    [left] = memory.iterdir()
    assert (left / "flight.mcap").exists()
    with scratch():
        assert left.exists()  # as fresh as one that is about to be locked
    os.utime(left, (0.0, 0.0))
    with scratch() as first:
        assert not left.exists()
        (first / "flight.mcap").write_text("a log")
        os.utime(first, (0.0, 0.0))
        with scratch() as second:
            assert first != second
            assert (first / "flight.mcap").exists()
    assert list(memory.iterdir()) == []


ROOT = Path(__file__).parents[3]
MISSION = """[campaign]
name = "short"
seeds = {seeds}
[flight]
mission = "rocksat"
[scenario]
sequence = [
    {{phase = 0, action = "hold", duration_s = 1.5}},
    {{phase = 3, action = "strokes", strokes = 5, amplitude = {{joint_1 = 0.21}}, stroke_s = 0.6, transfer_s = 0.5}},
    {{phase = 9, action = "hold", duration_s = 0.2}},
]
"""


def serial(directory: Path, plan: Path) -> dict[str, bytes]:
    """What each file of results holds when the flights are flown one after the other in this process, none slowly."""
    read = plan_file.read(plan)
    code = revision(read.file.flight.call or "")
    flights = {item.address(code): item for item in items(read)}
    store = Store(directory)
    store.begin(Content("serial", "", code, flights))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(time, "sleep", lambda _: None)
        one_by_one(flights, code, fly, store)
    return results(directory)


def one_by_one(left: Mapping[str, Item], code: str, fly: engine.Fly, store: Store) -> None:
    """What the engine does, in this process."""
    for address, item in left.items():
        store.take(address, item, code, fly(item, code))


def results(directory: Path) -> dict[str, bytes]:
    """Content of each file of results; empty before the first."""
    return {path.name: path.read_bytes() for path in sorted((directory / "flights").glob("*.parquet"))}


@contextmanager
def running(scratch: Path, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A Python that runs ``words``, with temporary files below ``scratch``; ended with the context."""
    scratch.mkdir(exist_ok=True)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "TMPDIR": str(scratch)}
    with (
        (scratch / f"{time.monotonic_ns()}.log").open("w") as said,
        subprocess.Popen([sys.executable, *words], env=environment, stdout=said, stderr=said) as process,
    ):
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                process.terminate()
                process.wait(60)


def campaign(out: Path, plan: Path, *more: str) -> tuple[str, ...]:
    """Words of a Python that runs a campaign."""
    return ("-m", "onboard.cli", "campaign", str(plan), "-o", str(out), *more)


def dask(port: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Words of a Python that is Dask's scheduler, and of one that is a worker with one process."""
    host = ("--host", "127.0.0.1", "--port", str(port))
    return (
        ("-m", "distributed.cli.dask_scheduler", *host, "--no-dashboard"),
        (
            "-m",
            "distributed.cli.dask_worker",
            f"tcp://127.0.0.1:{port}",
            "--nthreads",
            "1",
            "--no-nanny",
            "--no-dashboard",
        ),
    )


@contextmanager
def configured() -> Iterator[None]:
    """Dask in this process goes by the environment as it is now, and afterwards by none of it."""
    dask_config.refresh()
    try:
        yield
    finally:
        dask_config.refresh(env={})


def free_port() -> int:
    """One that nobody listens on."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def workers_of(process: int) -> list[int]:
    """Processes that one which runs a campaign has spawned to fly."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            if int(fields[1]) == process and b"spawn_main" in path.with_name("cmdline").read_bytes():
                found.append(int(path.parent.name))
    return found


def until(happens: Callable[[], bool], longest_s: float) -> None:
    """Wait for something.

    Raises:
        TimeoutError: it does not happen.
    """
    end_s = time.monotonic() + longest_s
    while not happens():
        if time.monotonic() > end_s:
            raise TimeoutError("it did not happen")
        time.sleep(0.05)


LONGEST_S = 120.0
CALLED = """[campaign]
name = "called"
seeds = 12
[flight]
call = "tests.ground.campaign.called:drawn"
[settings]
seconds = 0.15
"""


def written(tmp_path: Path, text: str) -> Path:
    plan = tmp_path / "plan.toml"
    plan.write_text(text)
    return plan


def test_a_worker_killed_in_flight_costs_nothing_but_the_flight_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))  # of the workers
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    flown = tmp_path / "flown"
    plan = written(tmp_path, CALLED.replace("0.15", "0.4").replace("12", "4") + f'flown = "{flown}"\n')
    expected = serial(tmp_path / "serial", plan)
    flown.unlink()

    def kill() -> int:
        until(flown.exists, LONGEST_S)  # a flight is over, and the next has begun
        time.sleep(0.1)
        (worker,) = workers_of(os.getpid())
        os.kill(worker, signal.SIGKILL)
        return worker

    with ThreadPoolExecutor(1) as beside:
        killed = beside.submit(kill)
        assert cli.main([*campaign(tmp_path / "out", plan, "--jobs", "1")[2:]]) == cli.OK
    assert killed.result()
    assert results(tmp_path / "out") == expected
    table = pyarrow.dataset.dataset(tmp_path / "out" / "flights").to_table().to_pylist()
    assert sorted(row["seed"] for row in table) == [1, 2, 3, 4]
    assert all(row["supported"] for row in table)


def test_one_flight_is_flown_again_and_keeps_its_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    plan = plan_file.read(written(tmp_path, MISSION.format(seeds=2)))
    flight = items(plan)[1].address(revision())
    assert cli.main(["campaign", "plan.toml", "--again", flight[:8]]) == cli.OK
    assert ": right" in capsys.readouterr().out
    assert "imu_base" in LogReader(tmp_path / f"{flight}.mcap").channels
    truth = json.loads((tmp_path / f"{flight}.mcap.truth.json").read_text())
    assert truth["seed"] == 2
    assert cli.main(["campaign", "plan.toml", "--again", "none"]) == cli.BAD_INPUT


def test_what_has_failed_is_flown_again_where_that_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown, out = tmp_path / "flown", tmp_path / "out"
    plan = written(tmp_path, CALLED.replace("12", "3").replace("0.15", "0.0") + f'flown = "{flown}"\nfails = [2]\n')

    def run(
        left: Mapping[str, Item], code: str, fly: engine.Fly, _where: object, store: Store, _watcher: object
    ) -> None:
        one_by_one(left, code, fly, store)

    monkeypatch.setattr(engine, "run", run)
    for more in ((), (), ("--retry",)):
        assert cli.main(["campaign", str(plan), "-o", str(out), *more]) == cli.FAILED
    assert flown.read_text().split() == ["1", "2", "3", "2"]
    (kept,) = (out / "failed").glob("*.json")
    assert "RuntimeError: seed 2 does not fly" in kept.read_text()


@pytest.mark.campaign  # a worker that is killed: above; scheduler, workers and clients of their own: below
def test_scheduler_and_client_are_killed_and_every_flight_is_there_once(tmp_path: Path) -> None:
    """One flight fails, once; and once again when that is asked for."""
    flown = tmp_path / "flown"
    plan = written(tmp_path, f'{CALLED.replace("0.15", "0.4")}flown = "{flown}"\nfails = [12]\n')
    expected = serial(tmp_path / "serial", plan)
    flown.unlink()
    port, out, scratch = free_port(), tmp_path / "out", tmp_path / "scratch"
    scheduler, worker = dask(port)
    told = campaign(out, plan, "--scheduler", f"tcp://127.0.0.1:{port}")

    def done() -> int:
        return len(results(out))

    with running(scratch, *scheduler) as first, running(scratch, *worker), running(scratch, *told) as client:
        until(lambda: done() >= 2, LONGEST_S)
        first.kill()
        first.wait()
        with running(scratch, *scheduler), running(scratch, *worker):
            before = done()
            until(lambda: done() > before, LONGEST_S)
            client.kill()
            client.wait()
            assert done() < len(expected)
            for more in ((), ("--retry",)):
                assert cli.main([*told[2:], *more]) == cli.FAILED
    assert results(out) == expected
    assert len(expected) == 11
    assert flown.read_text().split().count("12") == 2
    (kept,) = (tmp_path / "out" / "failed").glob("*.json")
    assert "RuntimeError: seed 12 does not fly" in kept.read_text()


def test_with_tls_as_the_page_says_a_campaign_flies_and_nobody_else_is_heard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).parents[3] / "docs" / "campaigns.md").read_text(encoding="utf-8")
    [shell] = [block for block in page.split("```sh\n")[1:] if "openssl" in block]
    made = [line for line in shell.splitlines() if line.startswith(("openssl", "cat"))]
    subprocess.run("\n".join(made), shell=True, cwd=tmp_path, check=True, capture_output=True)
    said = [line for line in shell.splitlines() if line.startswith(("export", "for"))]
    told = subprocess.run(
        "\n".join([*said, "env"]), shell=True, cwd=tmp_path, check=True, capture_output=True, text=True
    ).stdout
    environment = dict(line.split("=", 1) for line in told.splitlines() if line.startswith("DASK_DISTRIBUTED__"))
    assert len(environment) == 5
    plan = written(tmp_path, CALLED.replace("12", "2"))
    expected = serial(tmp_path / "serial", plan)
    port, out, scratch = free_port(), tmp_path / "out", tmp_path / "scratch"
    scheduler, worker = ([part.replace("tcp://", "tls://") for part in one] for one in dask(port))
    smaller = "\n".join(made).replace("rsa:3072", "rsa:2048")
    (tmp_path / "other").mkdir()
    subprocess.run(smaller, shell=True, cwd=tmp_path / "other", check=True, capture_output=True)
    theirs = {"DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT": str(tmp_path / "other" / "node.pem")}
    plain = {"DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "false"}
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with running(scratch, *scheduler, "--protocol", "tls"), running(scratch, *worker), configured():
        assert cli.main([*campaign(out, plan, "--scheduler", f"tls://127.0.0.1:{port}")[2:]]) == cli.OK
        assert results(out) == expected
        Client(f"tls://127.0.0.1:{port}", timeout=3, set_as_default=False).close()
        for protocol, more in (("tls", theirs), ("tcp", plain)):
            dask_config.refresh(env={**os.environ, **more})
            with pytest.raises(OSError, match=r"\(closed\)|Timed out trying to connect"):
                Client(f"{protocol}://127.0.0.1:{port}", timeout=3, set_as_default=False)


def test_a_worker_of_another_version_is_refused(tmp_path: Path) -> None:
    (item, *_) = items(plan_file.read(written(tmp_path, CALLED)))
    with pytest.raises(OtherCodeError, match="this heft of another"):
        fly(item, "another")


def test_no_scheduler_is_said_with_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("onboard.ground.campaign.engine._ANSWERS_S", 1)
    plan = written(tmp_path, CALLED)
    told = ["campaign", str(plan), "-o", str(tmp_path / "out"), "--scheduler", f"tcp://127.0.0.1:{free_port()}"]
    assert cli.main(told) == cli.BAD_INPUT
