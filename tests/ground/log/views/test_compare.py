"""Flights side by side: means, agreement and trends against numbers made for it."""

import json

import numpy as np
import pytest

from onboard import cli
from onboard.channels import QUANTITY
from onboard.ground.log.views.compare import compare, compared_quantity
from onboard.recording.reader import LogReader
from tests.recording.logs import make_log


def log_of(path, mass, sigma, supported=1):
    rows = np.zeros(2, QUANTITY)
    rows["host_ns"] = [1, 2]
    rows["name"], rows["unit"] = b"mass", b"kg"
    rows["value"], rows["sigma"], rows["supported"] = [99.0, mass], sigma, supported
    return make_log(path, {"quantity": rows})


def compared(tmp_path, *masses, sigma=0.1):
    logs = [log_of(tmp_path / f"{n}.mcap", mass, sigma) for n, mass in enumerate(masses)]
    [one] = compare([LogReader(log) for log in logs]).quantities
    return one


def test_flights_of_one_value_agree_and_their_mean_is_no_surer_than_each(tmp_path):
    one = compared(tmp_path, 5.05, 4.95, 5.0, 5.0)
    assert one.value == (5.05, 4.95, 5.0, 5.0)  # the last word of each
    assert one.mean == pytest.approx(5.0)
    assert one.sigma_mean == pytest.approx(0.1)  # a scale error of the one load cell is in all of them
    assert one.chance > 0.5


def test_a_drift_is_a_trend_and_a_disagreement(tmp_path):
    one = compared(tmp_path, 5.0, 5.5, 6.0, 6.5)
    slope, sigma = one.trend
    assert slope == pytest.approx(0.5)
    assert sigma == pytest.approx(0.1 / np.sqrt(5.0))  # sum of squares of -1.5 .. 1.5 is 5
    assert one.chance < 1e-6


def test_the_trend_s_interval_covers(rng):
    kind = np.dtype([("value", "f8"), ("sigma", "f8"), ("supported", "u1"), ("unit", "S8")])
    at, inside = np.arange(5), 0
    for _ in range(200):
        sigma = rng.uniform(0.05, 0.3, 5)
        x = 2.0 + 0.1 * at + sigma * rng.standard_normal(5)
        flights = [{"mass": np.array([(v, s, 1, b"kg")], kind)[0]} for v, s in zip(x, sigma, strict=True)]
        slope, own = compared_quantity("mass", flights).trend
        design = np.column_stack([np.ones(5), at]) / sigma[:, None]
        reference = np.linalg.inv(design.T @ design)
        assert own == pytest.approx(np.sqrt(reference[1, 1]))
        assert slope == pytest.approx((reference @ design.T @ (x / sigma))[1])
        inside += abs(slope - 0.1) < 1.96 * own
    assert 180 <= inside <= 198


def test_the_command_says_what_disagrees_and_what_was_not_told(tmp_path, capsys):
    logs = [log_of(tmp_path / "a.mcap", 5.0, 0.01), log_of(tmp_path / "b.mcap", 5.2, 0.01)]
    logs.append(log_of(tmp_path / "c.mcap", 7.0, 0.01, supported=0))
    assert cli.main(["compare", *map(str, logs), "--json", str(tmp_path / "told.json")]) == cli.OK
    shown = capsys.readouterr().out
    assert "they disagree" in shown
    assert "5.000 ± 0.020" in shown
    assert "7.0" not in shown
    told = json.loads((tmp_path / "told.json").read_text())
    assert told["quantities"][0]["value"] == [5.0, 5.2, None]


def test_one_log_or_none_that_answers_is_refused(tmp_path, capsys):
    log = log_of(tmp_path / "a.mcap", 5.0, 0.1, supported=0)
    assert cli.main(["compare", str(log)]) == cli.BAD_INPUT
    assert "two logs or more" in capsys.readouterr().err
    other = log_of(tmp_path / "b.mcap", 5.0, 0.1, supported=0)
    assert cli.main(["compare", str(log), str(other)]) == cli.BAD_INPUT
    assert "heft identify" in capsys.readouterr().err


def test_a_page_shows_each_flight_the_mean_the_trend_and_who_disagrees(tmp_path):
    logs = [log_of(tmp_path / f"<b>{n}.mcap", 5.0 + 0.5 * n, 0.1) for n in range(4)]
    page = tmp_path / "made" / "page.html"
    assert cli.main(["compare", *map(str, logs), "--report", str(page)]) == cli.OK
    text = page.read_text()
    assert "mass: the flights disagree" in text
    assert "mass changes by +0.500 ± 0.088 kg from a flight to the next" in text
    assert "5.75 ± 0.20" in text  # together
    assert text.count("<svg") == 1
    assert "&lt;b&gt;3.mcap" in text
    assert "<b>3" not in text
    same = [log_of(tmp_path / f"same_{n}.mcap", 5.0, 0.1) for n in range(2)]
    assert cli.main(["compare", *map(str, same), "--report", str(page)]) == cli.OK
    assert "all agree, none has a trend" in page.read_text()
