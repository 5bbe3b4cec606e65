"""Events of answers that are withdrawn and come back."""

import numpy as np

from onboard import channels
from onboard.flight.estimate.answers import Answers
from onboard.identification.quantities import Estimate, Findings, QuantityEstimate, Useful
from onboard.identification.standing import LEVELS, Level


def why(findings: Findings) -> bytes:
    """The reason beside a mass, as it is recorded."""
    mass, none = QuantityEstimate("m_arm", "kg", 5.0, 0.1, 4.8, 5.2, True, shrinkage=0.1), np.zeros(0)
    estimate = Estimate((), none, none, none, none, none.astype(bool), (mass,), 10, {})
    _, rows, _ = Answers(channels.estimate_dtype(0, 0), (), Useful()).rows(0, 0, estimate, findings, np.zeros((0, 0)))
    return bytes(rows["why"][0])


def test_a_reason_that_is_longer_than_its_field_ends_between_words_and_says_so() -> None:
    size = channels.QUANTITY["why"].itemsize
    whole = "a flexible joint " * 8
    assert why(Findings((), (whole[:size],))) == whole[:size].encode()
    assert why(Findings((), (whole,))) == b"a flexible joint " * 7 + b"a ..."
    assert why(Findings((), ("\xb2" * size + " swing",))).decode().endswith(" ...")


def test_a_parameter_that_is_not_determined_is_told_with_what_weakens_the_others() -> None:
    none, one = np.zeros(1), np.array([False])
    estimate = Estimate(("MX_arm",), none, none, none, none, one, (), 10, {})
    dtype, jumps = channels.estimate_dtype(1, 1), Findings((), ("a3: its angle jumps",))
    _, rows, _ = Answers(dtype, (), Useful()).rows(0, 0, estimate, jumps, np.zeros((1, 1)))
    assert rows["why"].tolist() == [b"not determined by the data so far; a3: its angle jumps"]
    assert LEVELS[rows["level"][0]] is Level.WEAK


def said(answers: Answers, supported: bool, level: Level) -> list[str]:
    """Events of a mass by its level, and whether the data determine it."""
    mass, none = QuantityEstimate("m_arm", "kg", 5.0, 0.1, 4.8, 5.2, supported, shrinkage=0.1), np.zeros(0)
    estimate = Estimate((), none, none, none, none, none.astype(bool), (mass,), 10, {})
    findings = Findings(("refused",) * (level is Level.DO_NOT_USE), ("doubted",) * (level is Level.WEAK))
    _, rows, events = answers.rows(0, 0, estimate, findings, np.zeros((0, 0)))
    assert rows["level"].tolist() == [LEVELS.index(level)]
    return [rows["code"][0].decode() for _, rows in events]


def test_an_answer_that_was_told_and_is_not_to_be_used_is_withdrawn_once() -> None:
    answers = Answers(channels.estimate_dtype(0, 0), (), Useful())
    assert said(answers, False, Level.DO_NOT_USE) == []  # nothing was reported yet
    assert said(answers, True, Level.GOOD) == []
    assert said(answers, False, Level.WEAK) == []  # not determined for some ticks
    assert said(answers, False, Level.DO_NOT_USE) == ["withdrawn"]
    assert said(answers, False, Level.DO_NOT_USE) == []
    assert said(answers, True, Level.WEAK) == ["answers_again"]
    assert said(answers, False, Level.DO_NOT_USE) == ["withdrawn"]


def test_of_many_withdrawn_quantities_the_first_are_named_and_the_reason_ends_between_words() -> None:
    answers, none = Answers(channels.estimate_dtype(0, 0), (), Useful()), np.zeros(0)
    many = tuple(QuantityEstimate(f"mass_{n}", "kg", 5.0, 0.1, 4.8, 5.2, True, shrinkage=0.1) for n in range(10))
    estimate = Estimate((), none, none, none, none, none.astype(bool), many, 10, {})
    for findings in (Findings((), ()), Findings(("the load cell reads too much " * 8,), ())):
        _, _, events = answers.rows(0, 0, estimate, findings, np.zeros((0, 0)))
    [(_, rows)] = events
    [text] = rows["text"].tolist()
    assert text.startswith(b"mass_0, mass_1, mass_2, 7 more: the load cell reads")
    assert text.endswith(b"the load ...")
