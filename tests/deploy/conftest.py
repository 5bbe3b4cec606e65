"""The RockSat-X mission that the flight's tests share."""

from tests.flight.conftest import short_mission

__all__ = ["short_mission"]
