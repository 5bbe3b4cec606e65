"""One whole RockSat-X mission, flown once and looked at by many tests; a fork server; rings of a test's own."""

import fcntl
import os
import pickle
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from onboard.flight.supervise.runner_forks import ForkServer
from tests.flight.missions import Result, fly


@pytest.fixture(scope="session")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """Flown by the first process of the run that asks for it; each has its own copy of the log."""
    own = tmp_path_factory.mktemp("mission") / "rocksat.mcap"
    of_all = tmp_path_factory.getbasetemp()
    of_all = of_all.parent if "PYTEST_XDIST_WORKER" in os.environ else of_all
    flown = of_all / "rocksat.pickle"
    with (of_all / "rocksat.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not flown.exists():
            flown.write_bytes(pickle.dumps(fly(of_all / "rocksat.mcap")))
    result: Result = pickle.loads(flown.read_bytes())
    shutil.copy(result.path, own)
    return result._replace(path=own, flown=result.flown._replace(log=own))


@pytest.fixture(scope="module")
def light() -> Iterator[ForkServer]:
    server = ForkServer()
    yield server
    server.close()


@pytest.fixture
def own_rings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Shared memory in which no other flight is: of a test beside this one, or of one that was killed."""
    place = Path(f"/dev/shm/heft-test-{os.getpid()}-{tmp_path.name}")
    monkeypatch.setenv("HEFT_RINGS", str(place))
    yield
    shutil.rmtree(place, ignore_errors=True)
