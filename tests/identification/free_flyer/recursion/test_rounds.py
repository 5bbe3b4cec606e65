"""Under what a window is solved, and by which evidence it is told that something is not as stated."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.identification.evidence.bank import Changed
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD
from onboard.identification.free_flyer.prediction.joint_noise import NoiseAdded
from onboard.identification.free_flyer.recursion.rounds import WindowRounds
from onboard.identification.free_flyer.recursion.solved import HeldPayload, Solved
from onboard.identification.free_flyer.recursion.trials import WindowProblem

ODDS, OF_PAYLOAD = 0.01, 20  # of what is likelier; steps from this number on are of the payload
PART = 20, 21
ASKED = WindowProblem((HeldPayload.SAME, HeldPayload.NEW))


class SuspectsThat:
    """What the bank of hypotheses says, and what it is told."""

    def __init__(self, likelier: tuple[tuple[int, ...], tuple[int, ...]], freed: tuple[int, ...] = ()) -> None:
        self.likelier, self.freed = likelier, freed
        self.told: list[tuple[float, bool]] = []
        self.taken_as: list[tuple[tuple[int, ...], tuple[int, ...]]] = []
        self.steps = SimpleNamespace(of_payload=lambda which: tuple(k for k in which if k >= OF_PAYLOAD), altering=PART)

    def wrong(
        self, known: object, inside: object, *, changed: bool, payload: bool = True
    ) -> tuple[tuple[int, ...], tuple[int, ...], float]:
        freed, stepped = self.likelier
        return freed, tuple(k for k in stepped if payload or k < OF_PAYLOAD), ODDS

    def taken(self, freed: Sequence[int], stepped: Sequence[int]) -> None:
        self.taken_as.append((tuple(freed), tuple(stepped)))

    def solved(self, known: object, nats: float, *, at_least: bool) -> None:
        self.told.append((nats, at_least))


def solved(evidence: float, hypothesis: HeldPayload = HeldPayload.NEW, mass_kg: float = 3.0) -> Solved:
    state = np.zeros(PAYLOAD.stop)
    state[PAYLOAD.start] = mass_kg
    P = np.eye(len(state))
    parts = np.zeros((9, 6)), P, Changed.none(len(state)), NoiseAdded.none(len(state)), (state, P)
    return Solved(hypothesis, state, state, P, 100, 0, 0.0, 0.0, *parts, evidence)


def of(found: Solved | None, nearest: Solved | None = None, before_kg: float = 3.0) -> Any:
    """Of a payload that was known to a gram."""
    before = standard_of(RigidBody(before_kg, np.zeros(3), 0.02 * np.eye(3)))
    state = np.concatenate([np.zeros(PAYLOAD.start), before])
    prior = state, 1e-6 * np.eye(len(state))
    return SimpleNamespace(found=found, nearest=nearest, prior=prior, payload_sigma=np.full(10, 10.0))


def rounds(suspects: SuspectsThat) -> WindowRounds:
    told: Any = suspects
    return WindowRounds(told)


def test_where_all_is_as_stated_one_solve_is_all() -> None:
    suspects = SuspectsThat(((), ()))
    one, first = rounds(suspects), of(solved(-10.0))
    assert one.next(ASKED, first, disturbed=False) is None
    assert one.result is first
    one.settle()
    assert not any(part is first for part in vars(one).values())  # a checkpoint would write it
    assert suspects.taken_as == [((), ())]
    assert suspects.told == [(0.0, False)]


@pytest.mark.parametrize(("free", "stepped"), [((3, 4), ()), ((), (7,))])
def test_what_is_likelier_is_solved_under_the_same_hypothesis_and_its_evidence_is_that_of_both(
    free: tuple[int, ...], stepped: tuple[int, ...]
) -> None:
    suspects = SuspectsThat((free, stepped))
    one, first, second = rounds(suspects), of(solved(-10.0)), of(solved(-3.0))
    more = one.next(ASKED, first, disturbed=True)  # also after a change: it is explained
    assert more is not None
    assert more.about is first.found.start
    assert more._replace(about=None) == WindowProblem((HeldPayload.NEW,), free=free, stepped=stepped)
    assert one.next(more, second, disturbed=True) is None
    assert one.result is second
    one.settle()
    assert suspects.taken_as == [(free, stepped)]
    assert suspects.told == [(pytest.approx(7.0), False)]


@pytest.mark.parametrize(
    ("evidence", "mass_kg", "taken"), [(-6.0, 3.0, False), (-5.0, 3.0, True), (-5.0, -3.2, True), (-5.0, -3.4, False)]
)
def test_what_is_likelier_by_the_linear_model_counts_where_its_evidence_exceeds_its_odds(
    evidence: float, mass_kg: float, taken: bool
) -> None:
    """And where the payload may have a mass, of a sigma of 1 kg here."""
    found = solved(evidence, mass_kg=mass_kg)
    one, first, second = rounds(SuspectsThat(((), (7,)))), of(solved(-10.0)), of(found)
    more = one.next(ASKED, first, disturbed=False)
    assert more is not None
    assert one.next(more, second, disturbed=False) is None
    assert one.result is (second if taken else first)


def test_where_that_explains_nothing_it_stays_as_it_was_asked_for() -> None:
    suspects = SuspectsThat(((), (7,)))
    one, first = rounds(suspects), of(solved(-10.0))
    more = one.next(ASKED, first, disturbed=False)
    assert more is not None
    assert one.next(more, of(None, solved(-2.0)), disturbed=False) is None
    assert one.result is first
    one.settle()
    assert suspects.taken_as == [((), ())]
    assert suspects.told == [(0.0, False)]


def test_what_is_free_is_solved_as_stated_too_and_where_that_explains_nothing_its_evidence_is_a_bound() -> None:
    suspects = SuspectsThat(((), ()), freed=(1,))
    one, first = rounds(suspects), of(solved(-10.0))
    more = one.next(ASKED, first, disturbed=False)
    assert more == WindowProblem((HeldPayload.NEW,), stated=True)
    assert one.next(more, of(solved(-25.0)), disturbed=False) is None
    assert one.result is first
    one.settle()
    more = one.next(ASKED, first, disturbed=False)
    assert more is not None
    assert one.next(more, of(None), disturbed=False) is None
    one.settle()
    (exact, exact_at_least), (bound, at_least) = suspects.told
    assert (exact, exact_at_least) == (pytest.approx(15.0), False)
    assert at_least
    assert 9.0 < bound < 15.0  # one window of 16, of one flight in ten thousand


def test_an_unexplained_window_is_solved_with_what_contradicts_it_unless_something_touched_the_vehicle() -> None:
    suspects = SuspectsThat(((5,), ()))
    one, unexplained, second = rounds(suspects), of(None, solved(-80.0)), of(solved(-3.0))
    assert one.next(ASKED, unexplained, disturbed=True) is None
    assert one.result is unexplained
    one.settle()
    more = one.next(ASKED, unexplained, disturbed=False)
    assert more is not None
    assert more._replace(about=None) == WindowProblem((HeldPayload.NEW,), free=(5,))
    assert one.next(more, second, disturbed=False) is None
    assert one.result is second
    one.settle()
    ((nats, at_least),) = suspects.told
    assert at_least
    assert nats > 9.0
    assert one.next(ASKED, of(None, None), disturbed=False) is None


def test_nothing_is_freed_while_nothing_is_held() -> None:
    one, first = rounds(SuspectsThat(((5,), ()))), of(solved(-3.0, HeldPayload.NOTHING))
    assert one.next(ASKED, first, disturbed=False) is None
    assert one.result is first


def test_what_explained_it_in_the_window_before_begins_the_same_in_the_next_one_of_the_same_first_tick() -> None:
    one, first = rounds(SuspectsThat(((), (7,)), freed=(1,))), of(solved(-10.0))
    starts = list[object]()
    for _ in range(2):
        trial: WindowProblem | None = ASKED
        for evidence in (-10.0, -30.0, -1.0):
            assert trial is not None
            starts.append(trial.start)
            trial = one.next(trial, of(solved(evidence)) if trial is not ASKED else first, disturbed=False)
        assert trial is None
        one.settle()
    assert [start is None for start in starts] == [True, True, True, True, False, False]
    one.forget()
    more = one.next(ASKED, first, disturbed=False)
    assert more is not None
    assert more.start is None


def test_a_payload_that_is_not_told_frees_no_constant() -> None:
    """So much explains a window that tells little."""
    one, first = rounds(SuspectsThat(((5,), ()))), of(solved(-3.0, mass_kg=0.5))
    assert one.next(ASKED, first, disturbed=False) is None
    assert one.result is first


def solved_all(one: WindowRounds, first: Any, *, answers: dict[tuple[int, ...], Any]) -> list[WindowProblem]:
    """What is solved of a window after a change; by its steps what comes of each."""
    problems, trial = list[WindowProblem](), one.next(ASKED, first, disturbed=True)
    while trial is not None:
        problems.append(trial)
        assert one.result is first
        trial = one.next(trial, answers.get(trial.stepped, of(None)), disturbed=True)
    return problems


@pytest.mark.parametrize(
    ("evidence", "before_kg", "taken"),
    [(10.0, 3.0, False), (40.0, 3.0, True), (-12.0, 10.0, False), (40.0, -1.0, False), (None, 3.0, False)],
)
def test_another_payload_without_a_release_counts_unless_an_error_with_that_of_before_is_far_likelier(
    evidence: float | None, before_kg: float, taken: bool
) -> None:
    """By its evidence if it was changed by a tenth; the evidence that it has where nothing was known of it is less."""
    new, same = solved(-10.0), solved(-900.0, HeldPayload.SAME)
    suspects = SuspectsThat(((), (0,)))
    found = None if evidence is None else solved(evidence, HeldPayload.SAME)
    one, first, second = rounds(suspects), of(new, same, before_kg), of(found)
    instrument, part = solved_all(one, first, answers={(0,): second})
    assert instrument._replace(about=None) == WindowProblem((HeldPayload.SAME,), stepped=(0,))
    assert part._replace(about=None) == WindowProblem((HeldPayload.SAME,), stepped=PART)
    assert (instrument.about is same.start, part.about is first.prior[0]) == (True, True)
    assert one.result is (second if taken else first)
    assert one.wrong is taken
    one.settle()
    ((_, at_least),) = suspects.told
    assert at_least


@pytest.mark.parametrize(
    ("instrument", "evidence", "before_kg", "taken"),
    [
        *[(None, -9.0, 3.0, True), (None, -11.0, 3.0, False), (-16.0, -9.0, 3.0, True), (-15.0, -9.0, 3.0, False)],
        *[(None, -9.0, 4.2, True), (None, -9.0, 4.4, False)],
    ],
)
@pytest.mark.parametrize("at", [PART, (30, 31)])
def test_a_payload_of_which_a_part_came_off_is_told_where_no_instrument_is_nearly_as_likely(
    at: tuple[int, ...], instrument: float | None, evidence: float, before_kg: float, taken: bool
) -> None:
    """It is likelier than any other payload, and has lost no more than 30 %; at the first time or at a later one."""
    suspects = SuspectsThat(((), (0,) if at == PART else at))
    one, first = rounds(suspects), of(solved(-10.0), solved(-900.0, HeldPayload.SAME), before_kg)
    found = solved(evidence, HeldPayload.SAME)
    found.state[PAYLOAD] = standard_of(RigidBody(3.0, np.zeros(3), 0.02 * np.eye(3)))
    found = found._replace(start=np.concatenate([np.zeros(PAYLOAD.start), first.prior[0][PAYLOAD]]))
    step = of(None if instrument is None or at != PART else solved(instrument, HeldPayload.SAME))
    solved_all(one, first, answers={(0,): step, at: of(found)})
    taken |= at != PART and instrument == -15.0  # of which nothing said that it is likely
    assert one.altered is taken
    assert (one.result is first) is not taken
    assert not one.wrong
    one.settle()
    assert len(suspects.told) == (not taken)  # nothing becomes free


@pytest.mark.parametrize(("alone", "taken"), [(None, True), (-9.0, True), (20.0, False)])
def test_where_it_cannot_be_told_a_part_may_have_come_off_and_an_instrument_changed(
    alone: float | None, taken: bool
) -> None:
    """Solved together, unless the instrument alone is far likelier."""
    suspects = SuspectsThat(((), (0, *PART)))
    one, first = rounds(suspects), of(solved(-10.0), solved(-900.0, HeldPayload.SAME))
    both, instrument = (
        of(solved(-8.0, HeldPayload.SAME)),
        of(None if alone is None else solved(alone, HeldPayload.SAME)),
    )
    problems = solved_all(one, first, answers={(0, *PART): both, (0,): instrument})
    assert [one.stepped for one in problems] == [(0, *PART), (0,), PART]
    assert one.result is (both if taken else instrument)
    assert one.altered is taken
    assert one.wrong


def test_a_payload_taken_up_from_nothing_is_none_exchanged() -> None:
    one = rounds(SuspectsThat(((), (0,))))
    nothing_held_before = of(solved(-10.0), solved(-900.0, HeldPayload.NOTHING))
    more = one.next(ASKED, nothing_held_before, disturbed=True)
    assert more is not None
    assert more._replace(about=None) == WindowProblem((HeldPayload.NEW,), stepped=(0,))
