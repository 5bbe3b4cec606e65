"""Flights flown once for many tests: RockSat-X's, the free-flyer's, and one of every kind of device.

And a fork server; rings of a test's own.
"""

import fcntl
import os
import pickle
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from onboard.flight.supervise.runner_forks import ForkServer
from tests.flight.missions import CATCH, CATCH_SEED, SHORTER, Result, fly
from tests.flight.mixed_flight import MixedFlight, fly_mixed


def once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], Any]) -> Any:
    """What ``make`` returns, given the run's directory; made by the first process of the run that asks for it."""
    of_all = factory.getbasetemp()
    of_all = of_all.parent if "PYTEST_XDIST_WORKER" in os.environ else of_all
    made = of_all / f"{name}.pickle"
    with (of_all / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not made.exists():
            made.write_bytes(pickle.dumps(make(of_all)))
    return pickle.loads(made.read_bytes())


def flown_once(factory: pytest.TempPathFactory, name: str, **overrides: Any) -> Result:
    """A mission; each process has its own copy of the log."""
    own = factory.mktemp("mission") / f"{name}.mcap"
    result: Result = once(factory, name, lambda of_all: fly(of_all / own.name, **overrides))
    shutil.copy(result.path, own)
    return result._replace(path=own, flown=result.flown._replace(log=own))


@pytest.fixture(scope="session")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """RockSat-X as packaged: 63 s."""
    return flown_once(tmp_path_factory, "rocksat")


@pytest.fixture(scope="session")
def short_mission(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """For what hangs on no phase and no length of the flight: :data:`SHORTER`."""
    return flown_once(tmp_path_factory, "shorter", sequence=SHORTER)


@pytest.fixture(scope="session")
def catch(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """The free-flyer catches something: :data:`CATCH`."""
    return flown_once(tmp_path_factory, "catch", seed=CATCH_SEED, vehicle="dymaflex", **CATCH)


@pytest.fixture(scope="session")
def mixed_flight(tmp_path_factory: pytest.TempPathFactory) -> MixedFlight:
    """Of the vehicle with a device of every kind."""
    flown: MixedFlight = once(tmp_path_factory, "mixed", lambda _: fly_mixed(tmp_path_factory.mktemp("mixed")))
    return flown


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
