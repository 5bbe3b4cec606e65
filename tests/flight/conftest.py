"""RockSat-X missions, a whole and a short one, flown once for many tests; a fork server; rings of a test's own."""

import fcntl
import os
import pickle
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from onboard.flight.supervise.runner_forks import ForkServer
from tests.flight.missions import SHORT, Result, fly


def flown_once(factory: pytest.TempPathFactory, name: str, **overrides: Any) -> Result:
    """Flown by the first process of the run that asks for it; each has its own copy of the log."""
    own = factory.mktemp("mission") / f"{name}.mcap"
    of_all = factory.getbasetemp()
    of_all = of_all.parent if "PYTEST_XDIST_WORKER" in os.environ else of_all
    flown = of_all / f"{name}.pickle"
    with (of_all / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not flown.exists():
            flown.write_bytes(pickle.dumps(fly(of_all / own.name, **overrides)))
    result: Result = pickle.loads(flown.read_bytes())
    shutil.copy(result.path, own)
    return result._replace(path=own, flown=result.flown._replace(log=own))


@pytest.fixture(scope="session")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """RockSat-X as packaged: 63 s."""
    return flown_once(tmp_path_factory, "rocksat")


@pytest.fixture(scope="session")
def short_mission(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """For what hangs on no phase and no length of the flight: :data:`SHORT`."""
    return flown_once(tmp_path_factory, "short", sequence=SHORT)


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
