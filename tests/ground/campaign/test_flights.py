"""What a worker does with one item."""

import gc

import pytest

from onboard.ground.campaign import flights
from onboard.ground.campaign.design import Item
from onboard.ground.campaign.revision import revision
from tests.ground.campaign.called import World

CALL = "tests.ground.campaign.called:in_a_world"


@pytest.mark.parametrize("fails", [False, True])
def test_a_world_does_not_outlive_its_flight(fails: bool) -> None:
    """However seldom Python looks for what refers to itself: a worker kept the arrays of seventy flights."""
    gc.disable()
    try:
        found = flights.done(
            Item(1, call=CALL, settings={"fails": [1] if fails else []}), revision(CALL), lambda *_: None
        )
        assert World.last() is None
    finally:
        gc.enable()
    assert (found.result is None) == fails
