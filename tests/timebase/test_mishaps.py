"""No sequence of misses, duplicates, resets, wraps, slips and stalls makes a clock that says it is locked wrong."""

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from onboard.timebase.clock import ClockState
from tests.timebase.streams import Fleet, Mishap

WHAT = ("miss", "deaf", "twice", "echo", "reset", "told reset", "wrap", "jump", "slip", "late batch")
UNSHRUNK = (Phase.explicit, Phase.reuse, Phase.generate)  # a flight is slow
STEPS = 120  # 6 s
mishaps = st.lists(
    st.builds(Mishap, st.integers(1, STEPS), st.sampled_from(tuple(Fleet.PERIOD_NS)), st.sampled_from(WHAT)),
    max_size=10,
)


def never_locked_and_wrong(fleet: Fleet) -> None:
    for name in fleet.newest:
        if fleet.states.get(name) is ClockState.LOCKED:
            assert abs(fleet.error_ns(name)) < Fleet.PERIOD_NS[name], name


@settings(
    max_examples=8, deadline=None, phases=(Phase.explicit, Phase.reuse, Phase.generate)
)  # a flight is slow to shrink
@given(seed=st.integers(0, 2**31), first=st.integers(0, 70_000), mishaps=mishaps)
def test_a_locked_clock_is_never_wrong_by_a_sample(seed: int, first: int, mishaps: list[Mishap]) -> None:
    Fleet(seed, first, tuple(mishaps)).run(STEPS, never_locked_and_wrong)


@pytest.mark.parametrize("what", WHAT)
def test_every_clock_is_locked_again_after_one(what: str) -> None:
    fleet = Fleet(3, 500, tuple(Mishap(60, device, what) for device in Fleet.PERIOD_NS))
    fleet.run(140, never_locked_and_wrong)
    assert fleet.states == dict.fromkeys(Fleet.PERIOD_NS, ClockState.LOCKED)
