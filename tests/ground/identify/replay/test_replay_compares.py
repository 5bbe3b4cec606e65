"""The comparison of a replay: many steps at a time give the verdict of one at a time."""

from typing import NamedTuple

import numpy as np
import pytest

from drivers import records
from onboard.channels import QUANTITY
from onboard.flight.store.flight_log import computed_on
from onboard.ground.identify.replay import comparison, kernels
from onboard.ground.identify.replay.comparison import Comparison
from onboard.ground.identify.replay.replay import elsewhere, judged


def rows(first, count, wrong_at=None):
    made = np.zeros(count, records.SCALAR)
    made["sequence"] = np.arange(first, first + count)
    made["host_ns"] = 1000 * made["sequence"]
    if wrong_at is not None and first <= wrong_at < first + count:
        made["value_raw"][wrong_at - first] = 1
    return made


def compared(monkeypatch, at_once, recorded=200, replayed=200, wrong_at=None, behind=3):
    """Steps of ten rows, of which the log has what was said ``behind`` steps later."""
    monkeypatch.setattr(comparison, "_AT_ONCE", at_once)
    said = Comparison(records.SCALAR)
    for step in range(0, 200 + 10 * behind, 10):
        log = rows(step - 10 * behind, 10)[: max(0, recorded - step + 10 * behind)]
        again = rows(step, 10, wrong_at)[: max(0, replayed - step)]
        said.add(log if step >= 10 * behind else log[:0], [again])
    counted = said.recorded, said.replayed
    said.end(10**9)
    return said.differs_from, said.farthest_sigmas, counted


@pytest.mark.parametrize("case", [{}, {"recorded": 190}, {"replayed": 185}, {"wrong_at": 77}, {"wrong_at": 0}])
def test_the_verdict_does_not_hang_on_how_many_rows_are_compared_at_once(case, monkeypatch):
    found = [compared(monkeypatch, at_once, **case) for at_once in (1, 64, 10_000)]
    assert found[0] == found[1] == found[2]
    differs_from, sigmas, counted = found[0]
    assert differs_from == case.get("wrong_at", min(case.values(), default=None))
    assert sigmas == (np.inf if case else 0.0)
    assert counted == (case.get("recorded", 200), case.get("replayed", 200))


@pytest.mark.parametrize("at_once", [1, 10_000])
def test_rows_of_an_estimator_that_began_anew_are_compared_after_those_of_the_one_before(at_once, monkeypatch):
    monkeypatch.setattr(comparison, "_AT_ONCE", at_once)
    said = Comparison(records.SCALAR)
    said.until = 25  # the second one says rows 25 to 39
    said.add(rows(0, 20), [rows(0, 20)])
    said.add(rows(20, 20), [rows(20, 10)])  # of the last step five rows had been published
    said.forget(25)
    said.until = None
    said.add(rows(40, 0), [rows(25, 15)])
    said.end(10**9)
    assert (said.differs_from, said.recorded, said.replayed) == (None, 40, 40)


def test_outputs_of_the_last_steps_may_be_missing(monkeypatch):
    for answered_ns, differs in ((1000 * 189, False), (1000 * 195, True)):
        monkeypatch.setattr(comparison, "_AT_ONCE", 10_000)
        said = Comparison(records.SCALAR)
        said.add(rows(0, 190), [rows(0, 200)])
        said.end(answered_ns)
        assert (said.differs_from is not None) is differs


def quantities(count=3):
    made = np.zeros(count, QUANTITY)
    made["sequence"], made["value"], made["sigma"] = np.arange(count), 5.0, 0.02
    made["low"], made["high"], made["supported"], made["name"] = 4.96, 5.04, 1, b"m_payload"
    made["low_999"], made["high_999"] = 4.9, 5.1
    return made


def apart(field, value, row=1, supported=1):
    recorded, replayed = quantities(), quantities()
    recorded["supported"] = replayed["supported"] = supported
    replayed[field][row] = value
    said = Comparison(QUANTITY)
    said.add(recorded, [replayed])
    said.end(0)
    assert said.differs_from == row
    return said.farthest_sigmas


def test_answers_that_differ_by_rounding_are_so_many_sigmas_apart():
    assert apart("value", 5.0 + 2e-9) == pytest.approx(1e-7, rel=1e-6)
    assert apart("high", 5.04 - 2e-6) == pytest.approx(1e-4, rel=1e-6)
    assert apart("low_999", 4.9 - 2e-6) == pytest.approx(1e-4, rel=1e-6)
    assert apart("value", 7.0, supported=0) == 0.0  # no answer


@pytest.mark.parametrize(("field", "value"), [("level", 1), ("why", b"weak"), ("sequence", 7), ("sigma", np.nan)])
def test_what_is_no_number_must_be_the_same(field, value):
    assert apart(field, value) == np.inf


def replayed_answers(value, metadata):
    recorded, replayed = quantities(), quantities()
    replayed["value"][1] = value
    said = Comparison(QUANTITY)
    said.add(recorded, [replayed])
    said.end(0)
    return judged({"quantity": said}, elsewhere(metadata), "", ())


def test_rounding_is_allowed_for_where_the_log_was_computed_elsewhere_and_only_there():
    here = {"flight": computed_on(), "versions": {}}
    there = {"flight": computed_on() | {"blas_kernels": "Nehalem"}, "versions": {}}
    for value, metadata, agrees in (
        (5.0, here, True),
        (5.0 + 2e-12, here, False),  # the same computer: not one bit
        (5.0 + 2e-12, there, True),
        (5.0 + 1.6e-8, there, True),  # 8e-7 sigmas
        (5.0 + 3e-8, there, False),  # 1.5e-6 sigmas
    ):
        assert replayed_answers(value, metadata).agrees is agrees
    said = replayed_answers(5.0 + 2e-12, there).summary
    assert f"blas_kernels: Nehalem in the log, {computed_on()['blas_kernels']} here" in said
    assert "1e-10 sigmas apart" in said
    assert "quantity differs from row 1: 3 recorded, 3 replayed" in replayed_answers(5.1, there).summary
    assert "blas_kernels: the log does not say" in elsewhere({"flight": {}, "versions": {}})


class Log(NamedTuple):
    metadata: dict[str, dict[str, str]]


@pytest.mark.parametrize(
    ("flown_with", "found", "chosen", "needed"),
    [
        ("Sandybridge", ["X86_V3"], "", "Sandybridge"),
        ("Nehalem", [], "Haswell", "Nehalem"),
        ("SkylakeX", ["X86_V3"], "", None),  # this processor cannot
        ("SkylakeX", ["X86_V3", "X86_V4"], "SkylakeX", None),  # chosen in vain: not once more
        ("Haswell, Nehalem", ["X86_V3"], "", None),  # of two libraries
        ("neoversen1", ["NEON"], "", None),
        ("", ["X86_V3"], "", None),  # a log that does not say
    ],
)
def test_the_kernels_of_a_flight_are_needed_where_this_processor_has_them(
    flown_with: str, found: list[str], chosen: str, needed: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    level = {"SIMD Extensions": {"baseline": ["X86_V2"], "found": found}}
    monkeypatch.setattr(kernels.np, "show_config", lambda mode: level)
    monkeypatch.setattr(kernels, "blas_kernels", lambda: "another")
    monkeypatch.setenv("OPENBLAS_CORETYPE", chosen)
    assert kernels.kernels_needed(Log({"flight": {"blas_kernels": flown_with}})) == needed


def test_no_other_kernels_are_needed_where_these_are_those_of_the_flight() -> None:
    assert kernels.kernels_needed(Log({"flight": {"blas_kernels": computed_on()["blas_kernels"]}})) is None
