"""The scoreboard's numbers, from rows whose outcome is known."""

import math
from pathlib import Path
from typing import Any

import pytest

from bench import honesty
from bench.honest_flights import scores
from bench.honest_flights.classes import CLASSES, of_class
from bench.honest_flights.drawn import MISSIONS
from hil_sim.devices.vehicle_file import scenario_of
from onboard.ground.campaign.design import Item
from onboard.ground.campaign.instants import Instants
from onboard.ground.campaign.results import FlightAnswer, FlightResult, Returned
from onboard.ground.campaign.store import Content, Store


def row(flight: str = "a", **fields: Any) -> dict[str, Any]:
    """A mass of 1 kg, reported as 1.0 +- 0.1 kg (95 %), good."""
    told = {"quantity": "m_payload", "unit": "kg", "truth": 1.0, "value": 1.0, "low": 0.9, "high": 1.1}
    told |= {"sigma": 0.04, "low_999": 0.5, "high_999": 1.2}
    said = {"supported": True, "level": "good", "why": "", "leans": "", "outcome": "right", "events": []}
    instants = {"instants_beyond": 0, "instants_good_beyond": 0}
    return {"flight": flight, **told, **said, **instants, **fields}


def test_a_right_answer_scores_its_width() -> None:
    score = scores.of_class([row()], ())
    assert (score.flights, score.answered, score.lied, score.inside, score.rms) == (1, 1, 0, 1.0, 0.0)
    assert score.half_width == pytest.approx(0.1)
    assert score.score == pytest.approx(0.2)
    assert math.isnan(score.named)


def test_a_truth_outside_costs_forty_times_what_it_is_outside_by() -> None:
    score = scores.of_class([row(value=1.2, low=1.1, high=1.3)], ())
    assert score.score == pytest.approx(0.2 + 40.0 * 0.1)
    assert score.rms == pytest.approx(0.2 / 0.04)
    assert score.inside == 0.0


def test_a_number_that_is_not_told_costs_two_hundred_per_cent() -> None:
    score = scores.of_class([row(supported=False, value=None, low=None, high=None, level="do not use")], ())
    assert score.score == 2.0
    assert score.answered == 0


def test_a_mass_that_is_known_to_half_of_it_is_no_answer() -> None:
    assert scores.of_class([row(low=0.5, high=1.5)], ()).answered == 0


def test_a_lie_for_a_while_is_a_lie_of_the_flight() -> None:
    score = scores.of_class([row(instants_beyond=3, instants_good_beyond=1), row("b")], ())
    assert (score.flights, score.lied, score.lied_at_end, score.good_beyond) == (2, 1, 0, 1)


@pytest.mark.parametrize(
    ("event", "named", "blamed"),
    [
        ("estimation: base contradicts its drawing", 1, 0),
        ("estimation: load_cell contradicts the other instruments", 0, 1),
        ("estimation: a gap of joint_1", 0, 0),
    ],
)
def test_the_culprit_is_named_or_another_is_blamed(event: str, named: int, blamed: int) -> None:
    score = scores.of_class([row(events=[event])], ("base",))
    assert (score.named, score.blamed) == (named, blamed)


@pytest.mark.parametrize("name", CLASSES)
def test_each_class_can_be_flown_and_is_its_seeds(name: str) -> None:
    one, two = (of_class(name, seed)[0] for seed in (1, 2))
    if CLASSES[name].group != "healthy":
        assert (one.overrides, one.faults) != ({}, [])
    assert one == of_class(name, 1)[0]
    assert one.seed != two.seed
    scenario_of(one.vehicle, {**MISSIONS[one.vehicle], "fault": one.faults, **one.overrides})  # or ScenarioError


def test_a_class_that_is_unknown_is_refused() -> None:
    with pytest.raises(ValueError, match="base mass 10 %"):
        of_class("base mass 11 %", 1)


def campaign(directory: Path, beyond: int) -> Path:
    """A directory of one flight whose mass was beyond its interval so many times."""
    store = Store(directory)
    item = Item(1, call="bench", point={"class": "base mass 10 %"})
    store.begin(Content("scoreboard", "", f"revision {beyond}", {"f": item}))
    told = FlightAnswer("m_payload", "kg", 1.0, 1.0, 0.9, 1.1, 0.05, supported=True, level="good")
    told = told._replace(instants=Instants(9, beyond, 0, 1.5))
    store.take("f", item, f"revision {beyond}", Returned(FlightResult((told,), events=("base is wrong",))))
    return directory


def test_the_page_has_both_revisions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    after, before = campaign(tmp_path / "after", 0), campaign(tmp_path / "before", 4)
    page = tmp_path / "scoreboard.md"
    monkeypatch.setattr("sys.argv", ["honesty", str(after), "--before", str(before), "--page", str(page)])
    assert honesty.main() == 0
    lines = page.read_text(encoding="utf-8").splitlines()
    assert "| base mass 10 % | 1 | 1 | 0 (1) | 0 | 0 | 100 % | 0.00 | 10 % | 20 % | 1 | 0 |" in lines
    assert any("code revision 0; in brackets that of revision 4" in line for line in lines)
    monkeypatch.setattr("sys.argv", ["honesty", str(before)])
    assert honesty.main() == 1
