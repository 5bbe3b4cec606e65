"""Without which instrument a window is explained best."""

import numpy as np
import pytest

from onboard.identification.exiddm.trials import Trials
from onboard.identification.exiddm.window import Hypothesis, Solved


def solved(strained: float) -> Solved:
    return Solved(Hypothesis.SAME, np.zeros(3), np.zeros(3), np.eye(3), 100, 0, strained)


@pytest.mark.parametrize(
    ("strains", "instrument", "clear"),
    [
        ((None, 5.0), 4, True),
        ((200.0, None), 7, True),
        ((12.0, 40.0), 7, True),
        ((40.0, 12.0), 4, True),
        ((30.0, 12.0), 4, False),
    ],
)
def test_the_least_strained_fit_is_chosen_and_clear_if_it_is_by_far(
    strains: tuple[float | None, ...], instrument: int, clear: bool
) -> None:
    trials = Trials([7, 4])
    for doubted, strained in zip((7, 4), strains, strict=True):
        assert trials.next() == doubted
        trials.take(None if strained is None else solved(strained))
    assert trials.next() is None
    choice = trials.choice
    assert choice is not None
    assert (choice.instrument, choice.clear) == (instrument, clear)
    assert choice.found.strained == min(one for one in strains if one is not None)
    assert choice.doubt("abcdefgh") == (
        "" if clear else "e and h contradict each other, and nothing tells which is wrong"
    )
    assert set(choice.others) == ({7, 4} - {instrument} if None not in strains else set())


def test_none_is_chosen_where_none_explains_the_window() -> None:
    trials = Trials([0])
    trials.take(None)
    assert trials.choice is None
