"""The RockSat-X missions that the flight's tests share."""

from tests.flight.conftest import mission, short_mission

__all__ = ["mission", "short_mission"]
