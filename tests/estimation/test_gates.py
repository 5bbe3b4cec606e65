"""Gates: every refusal has its name, and a wrong estimate cannot lock itself in."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.estimation import gates
from onboard.estimation.errors import RowError
from onboard.estimation.recursive.rls import SquareRootRls


def test_reasons_have_their_own_bits_and_combine():
    assert len({int(r) for r in gates.GateReason}) == len(list(gates.GateReason))
    both = gates.reasons([True, False], gates.GateReason.GAP) | gates.reasons([True, True], gates.GateReason.DRAG)
    assert gates.GateReason(int(both[0])) == gates.GateReason.GAP | gates.GateReason.DRAG
    assert gates.GateReason(int(both[1])) == gates.GateReason.DRAG


@given(
    bad=st.lists(st.booleans(), min_size=1, max_size=60),
    at=st.lists(st.floats(-1, 8), min_size=1, max_size=20),
    width=st.floats(0.01, 3),
)
@settings(max_examples=100)
def test_window_contains_against_plain_search(bad, at, width):
    times = np.arange(len(bad)) * 0.1
    found = gates.window_contains(times, bad, at, width)
    for tick, verdict in zip(at, found, strict=True):
        inside = (times >= tick - 0.5 * width) & (times <= tick + 0.5 * width)
        assert verdict == (np.array(bad) & inside).any()


def test_window_contains_wants_a_flag_a_sample():
    with pytest.raises(RowError):
        gates.window_contains([0.0, 1.0], [True], [0.5], 1.0)


def test_range_gate():
    values = np.array([[0.0, 0.0], [1.1, 0.0], [0.0, -2.1], [np.nan, 0.0], [1.0, -2.0]])
    found = gates.range_gate(values, [-1.0, -2.0], [1.0, 2.0], gates.GateReason.CONTACT)
    assert found.tolist() == [0, 4, 4, 4, 0]
    assert gates.range_gate(np.array([0.5, 2.0]), -1.0, 1.0, gates.GateReason.CONTACT).tolist() == [0, 4]
    with pytest.raises(RowError, match="empty"):
        gates.range_gate(values, 1.0, -1.0, gates.GateReason.CONTACT)


def test_magnitude_gate():
    vectors = np.array([[3.0, 4.0, 0.0], [3.0, 4.0, 0.1], [np.nan, 0.0, 0.0]])
    assert gates.magnitude_gate(vectors, 5.0, gates.GateReason.DRAG).tolist() == [0, 8, 8]


def test_phase_gate():
    at = np.array([0.5, 1.05, 1.35, 2.94, 2.99, 3.5, 9.0])
    found = gates.phase_gate(at, [1.0, 3.0], [3, 5], identify=[3, 4], settle_s=0.25, half_width_s=0.05)
    #     before any, settling, ok, ok, kernel over the change, other phase, other phase
    assert found.tolist() == [16, 16, 0, 0, 16, 16, 16]
    assert gates.phase_gate(at, [], [], [3], 0.1).tolist() == [16] * 7
    with pytest.raises(RowError):
        gates.phase_gate(at, [1.0, 0.5], [3, 4], [3], 0.1)
    with pytest.raises(RowError):
        gates.phase_gate(at, [1.0], [3, 4], [3], 0.1)


def test_residual_gate_refuses_outliers_among_good_rows(rng):
    gate = gates.ResidualGate(6.0)
    innovation = rng.normal(size=1000)
    outliers = np.arange(100, 1000, 97)
    innovation[outliers] = 1000.0
    refused = [k for k in range(1000) if gate.check(innovation[k : k + 1], np.ones(1))[0]]
    assert refused == outliers.tolist()
    assert gate.spread == pytest.approx(1.0, abs=0.25)


def test_rows_that_all_contradict_the_estimate_are_used_from_the_first_on_and_an_outlier_from_the_third_on_is_not():
    gate = gates.ResidualGate(6.0)
    assert gate.spread == 1.0
    for _ in range(9):
        assert gate.check(np.array([100.0]), np.ones(1))[0] == 0
    gate = gates.ResidualGate(6.0)
    verdicts = [gate.check(np.array([one]), np.ones(1))[0] for one in (1.0, 1.0, 100.0)]
    assert verdicts == [0, 0, gates.GateReason.RESIDUAL]


def test_the_spread_is_of_the_newest_innovations_however_they_came(rng):
    innovation = rng.normal(size=70)
    for step in (1, 3, 7):
        gate = gates.ResidualGate(6.0, memory=20)
        for first in range(0, 70, step):
            some = innovation[first : first + step]
            gate.check(some, np.ones(some.size))
        assert gate.spread == pytest.approx(1.4826 * np.median(np.abs(innovation[-20:])))


def test_a_wrong_early_estimate_is_put_right(rng):
    """The first rows are wrong and make the estimate wrong and sure; without re-admission it stays so."""
    rls, gate = SquareRootRls(1), gates.ResidualGate(6.0, memory=100)
    rls.prior(np.zeros(1), np.full(1, 10.0))
    one = np.ones((1, 1))

    def step(y):
        innovation, sigma = rls.innovation(one, y, np.full(1, 0.1))
        verdict = gate.check(innovation, sigma)
        if not verdict[0]:
            rls.update(one, y, np.full(1, 0.1))
        return verdict[0]

    for _ in range(40):
        step(np.array([7.0]))
    assert rls.solve().mean[0] == pytest.approx(7.0, abs=0.01)
    verdicts = [step(3.0 + 0.1 * rng.normal(size=1)) for _ in range(2000)]
    assert 5 < np.count_nonzero(verdicts) < 200  # refused at first, then let in again
    assert rls.solve().mean[0] == pytest.approx(3.0, abs=0.15)


def test_the_gate_refuses_what_is_no_number():
    gate = gates.ResidualGate(6.0)
    for innovation, sigma in (([np.nan], [1.0]), ([1.0], [0.0]), ([1.0], [1.0, 1.0])):
        with pytest.raises(RowError):
            gate.check(np.array(innovation), np.array(sigma))


def test_huber_bounds_the_pull_of_a_row(rng):
    """The pull of a row, residual over sigma squared, is as it was below the threshold and constant beyond."""
    gate = gates.ResidualGate(1000.0, huber=2.0)
    innovation, sigma = np.array([0.1, -1.9, 2.1, -8.0, 100.0]), np.array([1.0, 1.0, 1.0, 2.0, 1.0])
    pull = innovation / (sigma * gate.widening(innovation, sigma)) ** 2 * sigma
    np.testing.assert_allclose(pull, [0.1, -1.9, 2.0, -2.0, 2.0])
    assert (gates.ResidualGate(6.0).widening(innovation, sigma) == 1.0).all()
    for _ in range(50):
        gate.check(10.0 * rng.normal(size=5), np.ones(5))
    limit = 2.0 * gate.spread  # sigmas that promise too much do not make every row an outlier
    np.testing.assert_allclose(gate.widening(np.array([limit, 4 * limit]), np.ones(2)), [1.0, 2.0])


@pytest.mark.parametrize("arguments", [(0.0,), (6.0, 0), (6.0, 10, 0.0), (6.0, 10, 6.0)])
def test_impossible_gates_are_refused(arguments):
    with pytest.raises(RowError):
        gates.ResidualGate(*arguments)
