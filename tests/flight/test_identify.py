"""``heft identify`` on a flight's own log: steps of log time, not the flight's ticks, and the same answer."""

import pytest

from onboard import config
from onboard.offline.identify import identify
from onboard.offline.identify_view import render
from onboard.offline.table import last_answers
from tests.flight.missions import Result


def test_a_flights_log_says_again_what_the_flight_said(mission: Result) -> None:
    found = identify(config.load(config.packaged("rocksat")), [mission.path])
    (log,) = found.logs
    flown = last_answers(mission.log)
    again = {answer.name: answer for answer in log.answers}
    assert found.supported
    assert set(again) == set(flown)
    asked = [name for name, answer in flown.items() if answer["unit"] and answer["supported"]]
    assert len(asked) >= 3
    for name in asked:
        assert again[name].value == pytest.approx(flown[name]["value"], abs=0.5 * flown[name]["sigma"])
    assert found.calibration is None
    assert found.summaries == []
    assert render(found)
