"""Events of answers that are withdrawn and come back."""

import numpy as np

from onboard import channels
from onboard.flight.estimate.answers import Answers
from onboard.identification.standing import LEVELS, Level
from onboard.identification.useful import Useful


def said(answers: Answers, supported: bool, level: Level) -> list[str]:
    row = np.zeros(1, channels.QUANTITY)
    row["name"], row["supported"], row["level"] = b"m_arm", supported, LEVELS.index(level)
    return [rows["code"][0].decode() for _, rows in answers._changes(0, row)]


def test_an_answer_that_was_told_and_is_not_to_be_used_is_withdrawn_once() -> None:
    answers = Answers(np.dtype([("host_ns", "i8")]), (), Useful())
    assert said(answers, False, Level.DO_NOT_USE) == []  # nothing was told yet
    assert said(answers, True, Level.GOOD) == []
    assert said(answers, False, Level.WEAK) == []  # not determined for some ticks
    assert said(answers, False, Level.DO_NOT_USE) == ["withdrawn"]
    assert said(answers, False, Level.DO_NOT_USE) == []
    assert said(answers, True, Level.WEAK) == ["answers_again"]
    assert said(answers, False, Level.DO_NOT_USE) == ["withdrawn"]
