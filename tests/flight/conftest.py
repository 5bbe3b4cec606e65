"""One whole RockSat-X mission, flown once and looked at by many tests; a fork server."""

from collections.abc import Iterator

import pytest

from onboard.flight.runner_forks import ForkServer
from tests.flight.missions import Result, fly


@pytest.fixture(scope="session")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return fly(tmp_path_factory.mktemp("mission") / "rocksat.mcap")


@pytest.fixture(scope="module")
def light() -> Iterator[ForkServer]:
    server = ForkServer()
    yield server
    server.close()
