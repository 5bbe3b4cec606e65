"""One whole RockSat-X mission, flown once and looked at by many tests."""

import pytest

from tests.flight.missions import Result, fly


@pytest.fixture(scope="session")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return fly(tmp_path_factory.mktemp("mission") / "rocksat.mcap")
