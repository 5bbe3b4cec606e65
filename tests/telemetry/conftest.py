"""A flown mission, and the packets of its downlink."""

import pytest

from tests.flight.conftest import flown_once, own_rings
from tests.flight.missions import SHORT, Result

__all__ = ["own_rings"]


@pytest.fixture(scope="session")
def short_mission(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """RockSat-X, 16 s, flown once for all rooms' tests."""
    return flown_once(tmp_path_factory, "short", sequence=SHORT)
