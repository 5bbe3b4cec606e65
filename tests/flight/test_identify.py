"""``heft identify`` on a flight's own log: steps of log time, not the flight's ticks, and the same answer."""

from pathlib import Path

import numpy as np
import pytest

from onboard import config
from onboard.ground.identify.identify import identify
from onboard.ground.identify.identify_view import render
from onboard.ground.identify.mission.mission_table import last_answers
from onboard.identification.standing import Level
from onboard.recording.writer import LogWriter
from tests.flight.missions import Result

ROCKSAT = config.load(config.packaged("rocksat"))


def test_a_flights_log_says_again_what_the_flight_said(short_mission: Result) -> None:
    found = identify(ROCKSAT, [short_mission.path])
    (log,) = found.logs
    flown = last_answers(short_mission.log)
    again = {answer.name: answer for answer in log.answers}
    assert log.supported
    assert set(again) == set(flown)
    asked = [name for name, answer in flown.items() if answer["unit"] and answer["supported"]]
    assert len(asked) >= 3
    for name in asked:
        assert again[name].value == pytest.approx(flown[name]["value"], abs=0.5 * flown[name]["sigma"])
    assert log.verdict.level is Level.GOOD
    assert log.held_out is not None
    assert log.held_out.worst.relative_error < 0.3
    assert {one.link for one in log.links} == {"arm", "tip_mass"}
    assert found.calibration is None
    assert found.summaries == []
    assert render(found)


def test_a_load_cell_a_tenth_of_a_second_late_contradicts_the_motion(short_mission: Result, tmp_path: Path) -> None:
    path = tmp_path / "rocksat.mcap"
    with LogWriter.create(path, durable=False) as writer:
        for name, dtype in ROCKSAT.channels.items():
            rows = short_mission.log.read(name).copy()
            if name == "load_cell":
                rows["value_raw"] = np.roll(rows["value_raw"], 20)
            writer.register(name, dtype)
            writer.write(name, rows)
    (found,) = identify(ROCKSAT, [path]).logs
    assert found.verdict.level is Level.DO_NOT_USE
    assert "no body explains what was measured" in found.verdict.text
