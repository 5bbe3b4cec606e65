"""The sync box and the input that stamps its edges."""

import itertools

import numpy as np
import pytest

from hil_sim.devices.canopen.encoder406 import Encoder406
from hil_sim.devices.sync.sync_box import SyncBox, de_bruijn, pulse_places
from hil_sim.devices.sync.sync_line import EdgeCapture
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, CanRig, RateClock

FIRST_INTERVALS = [30, 30, 31, 30, 30, 32, 30, 30, 33, 30, 30, 34]  # SYNC periods between pulses 0, 1, 2, ...
FIRST_DELAYS = [0, 19, 6, 25, 12, 31, 18, 5, 24, 11, 30, 17, 4]  # after their SYNC, 31.25 us each
STEP_NS = 31_250


def plan(*faults):
    return FaultPlan(faults, START_NS).of("box")


def box(rate_error=0.0, **options):
    return SyncBox(RateClock(rate_error), START_NS, **options)


def edges_of(sync_box, ms, *others):
    edges = []
    sync_box.connect_pin(lambda edge_ns, high_ns: edges.append((edge_ns, high_ns)))
    rig = CanRig(sync_box, *others)
    rig.run(ms)
    return edges, rig


def granddaddy(symbols, order):
    """The same sequence another way: after a word of the largest symbol, always the smallest that is new (Martin)."""
    sequence, seen = [symbols - 1] * order, set()
    seen.add(tuple(sequence))
    while True:
        for symbol in range(symbols):
            word = (*sequence[-(order - 1) :], symbol)
            if word not in seen:
                seen.add(word)
                sequence.append(symbol)
                break
        else:
            return [*sequence[order:], symbols - 1]


@pytest.mark.parametrize(("symbols", "order"), [(2, 3), (2, 4), (3, 3), (32, 3)])
def test_de_bruijn_sequence_by_another_algorithm(symbols, order):
    code = de_bruijn(symbols, order)
    assert len(code) == symbols**order
    assert code == granddaddy(symbols, order)


def test_de_bruijn_of_the_textbook():
    assert "".join(map(str, de_bruijn(2, 4))) == "0000100110101111"


def test_three_intervals_name_the_place():
    code = de_bruijn(32, 3)
    triples = set(zip(code, code[1:] + code[:1], code[2:] + code[:2], strict=True))
    assert len(triples) == 32768
    assert sum(30 + c for c in code) / len(code) * 5 == 227.5  # ms, mean


def test_counter_and_period():
    _, rig = edges_of(box(), 5 * 250 + 1)
    assert {frame.identifier for frame in rig.frames} == {0x080}
    assert [frame.data[0] for frame in rig.frames] == [*range(1, 241), *range(1, 12)]
    starts = [frame.end_ns for frame in rig.frames]
    intervals = np.diff(starts)
    assert abs(intervals.mean() - 5 * MS) < 100
    assert np.abs(intervals - 5 * MS).max() <= 8 * 2000  # stuff bits differ from counter to counter


def test_pulses_lie_in_the_published_sync_periods_and_places():
    edges, rig = edges_of(box(), 1900)
    assert len(edges) == 13
    assert {high_ns for _, high_ns in edges} == {300_000}
    places = zip(itertools.accumulate([0, *FIRST_INTERVALS]), FIRST_DELAYS, strict=True)
    expected = [START_NS + sync * 5 * MS + steps * STEP_NS for sync, steps in places]
    assert [edge_ns for edge_ns, _ in edges] == expected
    ends = np.array([frame.end_ns for frame in rig.frames])
    for (edge_ns, _), steps in zip(edges, FIRST_DELAYS, strict=True):
        sync_ns = edge_ns - steps * STEP_NS
        after = ends[np.searchsorted(ends, sync_ns)] - sync_ns
        assert 52 * 2000 <= after <= 62 * 2000


def test_delays_cover_the_millisecond_evenly():
    places = list(itertools.islice(pulse_places(), 32768))
    delays = [delay for _, delay in places]
    for first in (0, 1, 17, 32_736):
        assert sorted(delays[first : first + 32]) == [k * STEP_NS for k in range(32)]


def test_its_crystal_sets_the_pace():
    edges, rig = edges_of(box(rate_error=50e-6), 10_000)
    assert abs(np.diff([frame.end_ns for frame in rig.frames]).mean() - 5 * MS / (1 + 50e-6)) < 20
    assert edges[1][0] - edges[0][0] == pytest.approx((150 * MS + 19 * STEP_NS) / (1 + 50e-6), abs=2)


def test_a_box_that_was_on_before():
    edges, rig = edges_of(box(first_sync=100), 1000)
    assert rig.frames[0].data[0] == 101
    pulse_syncs = list(itertools.accumulate([0, *FIRST_INTERVALS]))
    assert (edges[0][0] - START_NS) // (5 * MS) + 100 == min(s for s in pulse_syncs if s >= 100)


def test_produced_counts_syncs_and_pulses():
    sync_box = box()
    edges, rig = edges_of(sync_box, 999)
    assert (sync_box.produced, sync_box.pulses) == (len(rig.frames), len(edges)) == (200, 7)


def test_brown_out_counts_from_zero():
    edges, rig = edges_of(box(faults=plan(Fault("reset", "box", 0.5021))), 1000)
    counters = [frame.data[0] for frame in rig.frames]
    assert counters[100:103] == [101, 1, 2]
    times = [edge_ns for edge_ns, _ in edges]
    assert START_NS + 502_100_000 in times
    assert times[-1] - times[-2] == 155 * MS + (25 - 6) * STEP_NS  # pulse 3 after pulse 2


def test_without_supply_neither_frame_nor_edge():
    edges, rig = edges_of(box(faults=plan(Fault("off", "box", 0.3, 0.7))), 1000)
    assert not [t for t, _ in edges if START_NS + 300 * MS <= t < START_NS + 700 * MS]
    assert [f.data[0] for f in rig.frames if f.end_ns > START_NS + 300 * MS][:2] == [1, 2]
    edges, rig = edges_of(box(faults=plan(Fault("off", "box", 0.3))), 1000)
    assert len(rig.frames) == 60


def test_silent_on_can_it_still_pulses():
    edges, rig = edges_of(box(faults=plan(Fault("silent", "box", 0.1, 0.9))), 1000)
    assert len(edges) == 7
    assert len(rig.frames) == 40


def test_sync_waits_for_a_frame_that_is_on_the_wire_and_beats_one_that_waits():
    joint = Encoder406(1, Analog(lambda t: 0.0), START_NS)
    rig = CanRig(box(), joint)
    rig.run(100 - 0.05)
    rig.send(0x601, 0x40, 0, 0x10, 0, 0, 0, 0, 0)  # on the wire at the next SYNC instant
    first = rig.run(10)[0]
    assert first.identifier == 0x080
    assert first.end_ns - (START_NS + 100 * MS) > 250_000


# The input at the flight computer


def test_stamps_are_late_by_microseconds_and_in_order():
    line = EdgeCapture(1)
    for k in range(1000):
        line.edge(START_NS + k * MS, 300_000)
    seen = line.advance(START_NS + 1000 * MS)
    late = np.array([stamp for stamp, _ in seen]) - START_NS - MS * np.arange(1000)
    assert [sequence for _, sequence in seen] == [*range(1, 1001)]
    assert late.min() >= 3000
    assert 1800 < late.mean() - 3000 < 2200
    assert late.max() < 30_000


def test_an_edge_is_reported_once_its_stamp_is_due():
    line = EdgeCapture(1, jitter_ns=0)
    line.edge(START_NS, 300_000)
    assert line.advance(START_NS + 2_999) == []
    assert line.advance(START_NS + 3_000) == [(START_NS + 3_000, 1)]


def test_the_same_seed_gives_the_same_stamps():
    def stamps(seed):
        line = EdgeCapture(seed)
        for k in range(100):
            line.edge(START_NS + k * 10 * MS, 300_000)
        return line.advance(START_NS + 2_000 * MS)

    assert stamps(3) == stamps(3) != stamps(4)


def test_dropped_and_spurious_by_plan():
    line = EdgeCapture(1)
    faults = (Fault("pulse_drop", "box", 0.0, 0.1), Fault("pulse_spurious", "box", 0.2, 0.3, 0.04))
    line.inject(plan(*faults))
    line.advance(START_NS)
    line.edge(START_NS + 50 * MS, 300_000)
    line.edge(START_NS + 150 * MS, 300_000)
    seen = [(round((stamp - START_NS) / MS), sequence) for stamp, sequence in line.advance(START_NS + 1000 * MS)]
    assert seen == [(150, 1), (200, 2), (240, 3), (280, 4)]  # a dropped edge leaves no hole in the numbers
    assert (line.missed, line.spurious) == (1, 3)


def test_a_line_cannot_be_stuck():
    with pytest.raises(FaultError, match="stuck"):
        EdgeCapture().inject(plan(Fault("stuck", "box", 0.0)))
