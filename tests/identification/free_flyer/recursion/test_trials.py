"""Without which instrument a window is explained best."""

import numpy as np
import pytest

from onboard.identification.evidence.bank import Changed
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD
from onboard.identification.free_flyer.prediction.joint_noise import NoiseAdded
from onboard.identification.free_flyer.recursion.solved import HeldPayload, Solved
from onboard.identification.free_flyer.recursion.trials import CellTrials, WindowFits, WindowProblem

HYPOTHESES, NONE = (HeldPayload.SAME,), Changed.none(0)


def solved(strained: float) -> Solved:
    return Solved(
        HeldPayload.SAME,
        np.zeros(3),
        np.zeros(3),
        np.eye(3),
        100,
        0,
        strained,
        0.0,
        np.zeros((98, 6)),
        np.eye(3),
        NONE,
        NoiseAdded.none(3),
        (np.zeros(3), np.eye(3)),
        0.0,
    )


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
    trials = WindowFits([7, 4], HYPOTHESES)
    for doubted, strained in zip((7, 4), strains, strict=True):
        assert trials.next() == WindowProblem(HYPOTHESES, without=(doubted,))
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
    trials = WindowFits([0], HYPOTHESES)
    trials.take(None)
    assert trials.choice is None


def of_payload(hypothesis: HeldPayload, cost: float, mass_kg: float = 0.5) -> Solved:
    state = np.zeros(PAYLOAD.stop)
    state[PAYLOAD.start] = mass_kg
    return Solved(
        hypothesis,
        state,
        state,
        np.eye(PAYLOAD.stop),
        100,
        0,
        0.0,
        cost,
        np.zeros((98, 6)),
        np.eye(PAYLOAD.stop),
        NONE,
        NoiseAdded.none(PAYLOAD.stop),
        (state, np.eye(PAYLOAD.stop)),
        0.0,
    )


@pytest.mark.parametrize(
    ("last", "mass_kg", "freed", "clear"),  # clear: the cell is wrong; None: the payload changed
    [
        (False, -0.2, None, True),  # a cell that reads too little looks like a mass below zero
        (False, 0.5, 319.0, None),
        (False, 0.5, np.nan, None),  # not explained by the cell's errors, whatever their size
        (False, 0.5, 318.0, False),
        (True, 0.5, 318.0, True),
        (True, 0.5, 319.0, None),
    ],
)
def test_an_accused_cell_is_wrong_unless_a_changed_payload_is_far_more_likely(
    last: bool, mass_kg: float, freed: float | None, clear: bool | None
) -> None:
    nothing = (HeldPayload.NOTHING,)
    trials = CellTrials(2, nothing, last=last)
    assert trials.next() == WindowProblem(nothing, without=(2,))
    trials.take(of_payload(HeldPayload.NOTHING, 200.0, 0.0))
    assert trials.next() == WindowProblem((HeldPayload.NEW,))
    trials.take(of_payload(HeldPayload.NEW, 300.0, mass_kg))
    if freed is not None:
        assert trials.next() == WindowProblem(nothing, freed=2)
        trials.take(None if np.isnan(freed) else of_payload(HeldPayload.NOTHING, freed, 0.0))
    assert trials.next() is None
    choice, changed = trials.choice, trials.changed
    assert (None if choice is None else choice.clear) == clear
    assert (None if changed is None else changed.hypothesis) == (HeldPayload.NEW if clear is None else None)


def test_of_a_held_payload_the_change_is_a_release_and_of_a_new_one_there_is_none() -> None:
    trials = CellTrials(2, HYPOTHESES, last=False)
    trials.take(solved(0.0))
    assert trials.next() == WindowProblem((HeldPayload.NOTHING,))
    trials.take(None)
    assert trials.choice is not None
    assert (trials.choice.instrument, trials.choice.clear) == (2, True)
    anew = CellTrials(2, (HeldPayload.NEW,), last=False)
    anew.take(solved(0.0))
    assert anew.next() is None
    assert anew.choice is not None
    assert anew.choice.clear


def test_a_window_that_is_not_explained_without_the_cell_does_not_accuse_it() -> None:
    trials = CellTrials(2, HYPOTHESES, last=False)
    trials.take(None)
    assert (trials.next(), trials.choice, trials.changed) == (None, None, None)
