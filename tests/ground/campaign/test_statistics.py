"""The numbers of a report, on errors that are known because they were made."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard import cli
from onboard.ground.campaign.design import Item
from onboard.ground.campaign.results import FlightAnswer, FlightResult, Outcome, Returned, kinds
from onboard.ground.campaign.statistics import Summary, share_of, summary
from onboard.ground.campaign.store import Content, Store
from tests.ground.campaign.called import drawn


def kept(directory: Path, flights: list[tuple[dict[str, Any], dict[str, Any]]]) -> Store:
    """A campaign of flights with these points of the design and settings."""
    made = {f"f{seed:04}": Item(seed, point, call="a:b") for seed, (point, _) in enumerate(flights)}
    store = Store(directory)
    store.begin(Content("made", "plan text <b>", "r", made))
    for (address, item), (_, settings) in zip(made.items(), flights, strict=True):
        store.take(address, item, "r", Returned(drawn(item.seed, settings)))
    return store


def summed(directory: Path, flights: list[tuple[dict[str, Any], dict[str, Any]]]) -> Summary:
    store = kept(directory, flights)
    return summary(store.rows(store.content().items))


def test_errors_and_coverage_are_those_of_the_flights(tmp_path: Path) -> None:
    found = summed(tmp_path, [({}, {"spread": 0.01})] * 60)
    (one,) = found.errors
    made = [drawn(seed, {"spread": 0.01}).answers[0] for seed in range(60)]
    percent = np.array([100.0 * (a.value - a.truth) / a.truth for a in made])
    z = np.array([(a.value - a.truth) / 0.01 for a in made])
    assert (one.quantity, one.shown_in, one.flights, one.answered) == ("m", "%", 60, 60)
    expected = np.percentile(abs(percent), 95), np.sqrt(np.mean(percent**2)), percent.mean(), abs(percent).max()
    np.testing.assert_allclose([one.p95, one.rms, one.mean, one.worst], expected)
    np.testing.assert_allclose([one.in_sigma, one.in_bound], np.sqrt(np.mean(z**2)) * np.array([1.0, 1 / 0.9]))
    assert one.covered.part == np.sum(abs(z) <= 1.96)
    assert one.covered.low < 0.95 < one.covered.high


def test_bands_of_shares_are_the_exact_ones() -> None:
    """Clopper and Pearson: 0 of n reaches to 1 - 0.025^(1/n); tables give 8 of 10 as 0.444 to 0.975."""
    assert share_of(0, 20).high == pytest.approx(1.0 - 0.025 ** (1 / 20), rel=1e-9)
    assert share_of(8, 10)[2:] == (pytest.approx(0.444, abs=5e-4), pytest.approx(0.975, abs=5e-4))
    assert np.isnan(share_of(0, 0).share)


def test_the_factor_that_drives_the_error_is_told_and_the_other_is_not(tmp_path: Path) -> None:
    flights = [
        ({"shifts": level, "spreads": spread, "idle": idle}, {"bias": bias, "spread": spread})
        for level, bias in (("low", -0.01), ("high", 0.01))
        for spread in (0.001, 0.01)
        for idle in (1.0, 2.0, 3.0)
        for _ in range(10)
    ]
    found = {one.factor: one for one in summed(tmp_path, flights).effects}
    assert found["shifts"].shifts > 0.5
    assert found["shifts"].shifts_chance < 1e-6
    assert found["spreads"].spreads_chance < 1e-3
    assert found["idle"].shifts < 0.03
    assert min(found["idle"].shifts_chance, found["idle"].spreads_chance) > 0.01


def test_outcomes_of_answers() -> None:
    told = FlightAnswer("m", "kg", 1.0, 1.02, 0.98, 1.06, 0.02, supported=True, level="good")
    assert told.outcome() is Outcome.RIGHT
    assert told._replace(truth=0.90).outcome() is Outcome.NONSENSE
    assert told._replace(truth=0.96).outcome() is Outcome.RIGHT  # outside 95 %, inside 99.9 %
    assert told._replace(truth=0.90, level="weak").outcome() is Outcome.NONSENSE
    assert told._replace(truth=0.90).outcome(unseen=True) is Outcome.LEANS
    assert told._replace(supported=False, level="weak").outcome() is Outcome.WEAK
    assert told._replace(supported=False, level="do not use").outcome() is Outcome.DO_NOT_USE
    assert told._replace(truth=float("nan")).outcome() is Outcome.UNKNOWN
    assert not FlightResult((told,)).nonsense
    assert FlightResult((told._replace(truth=0.9),)).nonsense


def test_faults_stand_beside_what_came_of_them(tmp_path: Path) -> None:
    assert kinds(["stuck:load_cell:5:8", "links 3 %"]) == ("stuck load_cell", "links 3 %")
    lie = {"bias": 1.0, "faults": ["wrong:cell:1:2:0.1", "off:imu:1:2"]}
    found = summed(tmp_path, [({}, {})] * 3 + [({}, lie)] * 2 + [({}, lie | {"unseen": True})])
    assert found.outcomes["none"] == {"right": 3}
    assert found.outcomes["wrong cell"] == {"confident nonsense": 2, "wrong, unseen": 1} == found.outcomes["off imu"]
    assert found.flights_of == {"none": 3, "wrong cell": 3, "off imu": 3}
    assert found.nonsense_of == {"wrong cell": 2, "off imu": 2}
    assert [one.faults for one in found.nonsense] == [tuple(lie["faults"])] * 2
    assert found.answers == {"right": 3, "confident nonsense": 2, "wrong, unseen": 1}


def test_the_page_says_what_is_wrong_and_needs_no_network(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flights = [({"cell": "good"}, {})] * 10 + [({"cell": "<lies>"}, {"bias": 1.0, "faults": ["wrong:cell:1::0.1"]})]
    store = kept(tmp_path / "c", flights)
    (store.directory / "failed" / "none.json").write_text("{}")  # of another plan
    assert cli.main(["campaign", "report", str(store.directory), "--json", str(tmp_path / "c.json")]) == cli.OK
    said = capsys.readouterr().out
    assert "NONSENSE: f0010 a:b seed 10: m " in " ".join(said.split())
    page = (store.directory / "report.html").read_text()
    assert page.count("confident nonsense") >= 3
    assert "wrong cell" in page
    assert "plan text &lt;b&gt;" in page
    assert "<lies>" not in page
    assert not re.search(r"""(?:src|href|url)\s*[=(]\s*["']?(?:https?:|//)""", page.split("<script")[0])
    told = json.loads((tmp_path / "c.json").read_text())
    assert (told["flights"], told["answers"]) == (11, {"right": 10, "confident nonsense": 1})


def test_the_answers_of_each_level_of_a_factor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = kept(tmp_path / "c", [({"<cell>": "good"}, {})] * 3 + [({"<cell>": "bent"}, {"bias": 1.0})] * 2)
    report = ["campaign", "report", str(store.directory)]
    assert cli.main([*report, "--by", "<cell>", "--json", str(tmp_path / "c.json")]) == cli.OK
    told = json.loads((tmp_path / "c.json").read_text())
    answers = {level: (of["flights"], of["answers"]) for level, of in told["by"].items()}
    assert answers == {"<cell> = good": (3, {"right": 3}), "<cell> = bent": (2, {"confident nonsense": 2})}
    assert told["flights"] == 5
    said = capsys.readouterr().out
    assert said.index("<cell> = good") < said.index("<cell> = bent") < said.index("5 flights; answers")
    assert "Answers, &lt;cell&gt; = bent" in (store.directory / "report.html").read_text()
    assert cli.main([*report, "--by", "moon"]) == cli.BAD_INPUT
    assert "no flight has a factor 'moon'; there are: <cell>" in capsys.readouterr().err


def test_a_campaign_of_nothing_yet_has_a_page_too(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.begin(Content("none", "", "r", {"a": Item(1)}))
    assert cli.main(["campaign", "report", str(tmp_path)]) == cli.FAILED
    assert "no flight is done yet" in (tmp_path / "report.html").read_text()


def test_what_is_no_campaign_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["campaign", "report", str(tmp_path)]) == cli.BAD_INPUT
    assert "is not the directory of a campaign" in capsys.readouterr().err
    assert cli.main(["campaign", "report"]) == cli.BAD_INPUT


def test_a_file_cut_short_is_none_and_a_result_is_never_replaced(tmp_path: Path) -> None:
    store = kept(tmp_path, [({}, {})] * 2)
    first = (store.flights / "f0000.parquet").read_bytes()
    (store.flights / ".f0001.parquet.part").write_bytes(first[:100])
    (store.flights / "f0001.parquet").unlink()
    content = store.content()
    assert len(summary(store.rows(content.items)).errors[0].whitened) == 1
    store.begin(content)
    assert not list(store.flights.glob(".*"))
    store.take("f0000", Item(5), "r", Returned(None, "no"))
    assert (store.flights / "f0000.parquet").read_bytes() == first
    assert not store.has_failed("f0000")
