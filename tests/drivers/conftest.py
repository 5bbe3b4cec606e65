import pytest


@pytest.fixture
def flight(request, clock):
    """The ``Flight`` of the test's module, started."""
    flight = request.module.Flight(clock)
    flight.start()
    return flight
