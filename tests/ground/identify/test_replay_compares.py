"""The comparison of a replay: many steps at a time give the verdict of one at a time."""

import numpy as np
import pytest

from drivers import records
from onboard.ground.identify.replay import replay
from onboard.ground.identify.replay.replay import _Said


def rows(first, count, wrong_at=None):
    made = np.zeros(count, records.SCALAR)
    made["sequence"] = np.arange(first, first + count)
    made["host_ns"] = 1000 * made["sequence"]
    if wrong_at is not None and first <= wrong_at < first + count:
        made["value_raw"][wrong_at - first] = 1
    return made


def compared(monkeypatch, at_once, recorded=200, replayed=200, wrong_at=None, behind=3):
    """Steps of ten rows, of which the log has what was said ``behind`` steps later."""
    monkeypatch.setattr(replay, "_COMPARED_AT_ONCE", at_once)
    said = _Said(records.SCALAR)
    for step in range(0, 200 + 10 * behind, 10):
        log = rows(step - 10 * behind, 10)[: max(0, recorded - step + 10 * behind)]
        again = rows(step, 10, wrong_at)[: max(0, replayed - step)]
        said.add(log if step >= 10 * behind else log[:0], [again])
    counted = said.recorded, said.replayed
    said.end(10**9)
    return said.differs, said.same, counted


@pytest.mark.parametrize("case", [{}, {"recorded": 190}, {"replayed": 185}, {"wrong_at": 77}, {"wrong_at": 0}])
def test_the_verdict_does_not_hang_on_how_many_rows_are_compared_at_once(case, monkeypatch):
    found = [compared(monkeypatch, at_once, **case) for at_once in (1, 64, 10_000)]
    assert found[0] == found[1] == found[2]
    differs, same, counted = found[0]
    assert differs == bool(case)
    assert same == case.get("wrong_at", min(case.get("recorded", 200), case.get("replayed", 200)))
    assert counted == (case.get("recorded", 200), case.get("replayed", 200))


@pytest.mark.parametrize("at_once", [1, 10_000])
def test_rows_of_an_estimator_that_began_anew_are_compared_after_those_of_the_one_before(at_once, monkeypatch):
    monkeypatch.setattr(replay, "_COMPARED_AT_ONCE", at_once)
    said = _Said(records.SCALAR)
    said.until = 25  # the second one says rows 25 to 39
    said.add(rows(0, 20), [rows(0, 20)])
    said.add(rows(20, 20), [rows(20, 10)])  # of the last step five rows had been published
    said.forget(25)
    said.until = None
    said.add(rows(40, 0), [rows(25, 15)])
    said.end(10**9)
    assert (said.differs, said.same) == (False, 40)


def test_outputs_of_the_last_steps_may_be_missing(monkeypatch):
    for answered_ns, differs in ((1000 * 189, False), (1000 * 195, True)):
        monkeypatch.setattr(replay, "_COMPARED_AT_ONCE", 10_000)
        said = _Said(records.SCALAR)
        said.add(rows(0, 190), [rows(0, 200)])
        said.end(answered_ns)
        assert said.differs is differs
