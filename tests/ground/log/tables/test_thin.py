"""Thinning for plots: nothing that stands out is hidden, whatever the length."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.ground.log.tables.thin import Envelope, Thinned


@given(
    st.lists(st.lists(st.tuples(st.integers(0, 10_000), st.floats(-1e6, 1e6)), max_size=20), min_size=1, max_size=5),
    st.integers(2, 16),
)
def test_an_envelope_holds_every_sample_in_its_bin(blocks, bins):
    envelope = Envelope(0, 1, bins, width_ns=3)
    for block in blocks:
        envelope.add(np.array([t for t, _ in block], np.int64), np.array([[v] for _, v in block]).reshape(-1, 1))
    samples = [sample for block in blocks for sample in block]
    trace = envelope.trace(0)
    bins += bins % 2
    assert len(trace.time_s) <= bins
    if not samples:
        assert len(trace.time_s) == 0
        return
    width_ns = 3
    while max(t for t, _ in samples) // width_ns >= bins:
        width_ns *= 2
    by_bin: dict[int, list[float]] = {}
    for t, v in samples:
        by_bin.setdefault(t // width_ns, []).append(v)
    assert trace.time_s == pytest.approx([(b + 0.5) * width_ns * 1e-9 for b in sorted(by_bin)])
    for found, expected in ((trace.low, min), (trace.high, max)):
        assert found[:, 0].tolist() == [expected(by_bin[b]) for b in sorted(by_bin)]
    assert trace.mean[:, 0] == pytest.approx([np.mean(by_bin[b]) for b in sorted(by_bin)], abs=1e-6)


def test_a_sample_that_is_none_leaves_its_column_alone():
    envelope = Envelope(0, 2, 8)
    envelope.add(np.array([0, 1]), np.array([[1.0, np.nan], [3.0, np.nan]]))
    trace = envelope.trace(0)
    assert (trace.low[0, 0], trace.mean[0, 0], trace.high[0, 0]) == (1.0, 2.0, 3.0)
    assert np.isnan([trace.low[0, 1], trace.mean[0, 1], trace.high[0, 1]]).all()


@given(st.lists(st.integers(0, 50), min_size=1, max_size=20), st.integers(2, 30))
def test_thinned_rows_are_evenly_chosen_and_end_with_the_last(sizes, capacity):
    thinned, number = Thinned(capacity), 0
    for size in sizes:
        rows = np.zeros(size, [("sequence", "<u8")])
        rows["sequence"] = np.arange(number, number + size)
        number += size
        thinned.add(rows)
    if not number:
        assert thinned.rows is None
        return
    assert thinned.rows is not None
    kept = thinned.rows["sequence"].tolist()
    stride = kept[1] - kept[0] if len(kept) > 2 else 1
    assert kept[0] == 0
    assert kept[-1] == number - 1
    assert len(kept) <= capacity + 1
    assert kept[:-1] == list(range(0, kept[-2] + 1, stride)) if len(kept) > 2 else True
    assert number <= stride * 2 * capacity
