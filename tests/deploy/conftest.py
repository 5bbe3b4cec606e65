"""The RockSat-X mission that the flight's tests share."""

from tests.flight.conftest import mission

__all__ = ["mission"]
