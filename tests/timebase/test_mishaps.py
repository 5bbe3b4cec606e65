"""No sequence of misses, duplicates, resets, wraps, slips and stalls makes a clock that says it is locked wrong."""

import pytest
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st

from onboard.timebase.clock import ClockState
from tests.timebase.streams import Fleet, Mishap

WHAT = ("miss", "deaf", "twice", "echo", "reset", "told reset", "wrap", "jump", "slip", "late batch")
UNSHRUNK = (Phase.explicit, Phase.reuse, Phase.generate)  # a flight is slow to shrink
STEPS = 120  # 6 s
mishaps = st.lists(
    st.builds(Mishap, st.integers(1, STEPS), st.sampled_from(tuple(Fleet.PERIOD_NS)), st.sampled_from(WHAT)),
    max_size=10,
)


class NeverLockedAndWrong:
    """Judges a fleet after each step, and counts the locked clocks that it has judged."""

    def __init__(self) -> None:
        self.judged = dict.fromkeys(Fleet.PERIOD_NS, 0)

    def __call__(self, fleet: Fleet) -> None:
        for name in fleet.newest:
            if fleet.states.get(name) is ClockState.LOCKED:
                self.judged[name] += 1
                assert abs(fleet.error_ns(name)) < Fleet.PERIOD_NS[name], name


@settings(max_examples=5, deadline=None, phases=UNSHRUNK)
@example(265_383, 623, [Mishap(34, "sync", "jump")])  # as the clock locks on marks of before
@given(seed=st.integers(0, 2**31), first=st.integers(0, 70_000), mishaps=mishaps)
def test_a_locked_clock_is_never_wrong_by_a_sample(seed: int, first: int, mishaps: list[Mishap]) -> None:
    judge = NeverLockedAndWrong()
    Fleet(seed, first, tuple(mishaps)).run(STEPS, judge)
    assert sum(judge.judged.values()) > 200, judge.judged


@pytest.mark.parametrize("what", WHAT)
def test_every_clock_is_locked_again_after_one(what: str) -> None:
    fleet = Fleet(3, 500, tuple(Mishap(60, device, what) for device in Fleet.PERIOD_NS))
    judge = NeverLockedAndWrong()
    fleet.run(140, judge)
    assert min(judge.judged.values()) > 40
    assert fleet.states == dict.fromkeys(Fleet.PERIOD_NS, ClockState.LOCKED)
