"""The pulse code against its definition, and the sync line as a device."""

import errno
import os

import numpy as np
import pytest

from drivers.ports import Edge
from drivers.sync_pulse import SyncPulse, SyncPulseConfig, intervals, sync_numbers
from drivers.sync_pulse.code import cycle_sync_periods, dither_ns
from tests.drivers.batches import codes, of, whole

LENGTH = 32**3


def lyndon_words_of_length_dividing_three():
    """By definition: words smaller than each of their rotations, in lexicographic order. Slow and plain."""
    words = [(a,) for a in range(32)]
    for a in range(32):
        for b in range(32):
            for c in range(32):
                word = (a, b, c)
                if word < (b, c, a) and word < (c, a, b):
                    words.append(word)
    return sorted(words)


def test_the_code_is_the_lyndon_words_joined():
    joined = [symbol for word in lyndon_words_of_length_dividing_three() for symbol in word]
    assert (intervals() - 30).tolist() == joined


def test_every_three_successive_intervals_occur_once():
    symbols = intervals()
    triples = set(zip(symbols.tolist(), np.roll(symbols, -1).tolist(), np.roll(symbols, -2).tolist(), strict=True))
    assert len(triples) == LENGTH == len(symbols)


def test_intervals_are_150_to_305_ms_at_200_hz_and_the_code_lasts_two_hours():
    milliseconds = intervals() * 5
    assert (milliseconds.min(), milliseconds.max(), milliseconds.mean()) == (150, 305, 227.5)
    assert cycle_sync_periods() * 5e-3 / 3600 == pytest.approx(2.07, abs=0.01)


def test_pulse_zero_rises_with_sync_zero_and_each_after_its_interval():
    numbers = sync_numbers()
    assert numbers[0] == 0
    np.testing.assert_array_equal(np.diff(numbers), intervals()[1:])
    assert numbers[-1] + intervals()[0] == cycle_sync_periods()


def test_the_tables_are_sealed():
    for table in (intervals(), sync_numbers(), dither_ns()):
        with pytest.raises(ValueError, match="read-only"):
            table[0] = 1


def test_dither_spreads_pulses_evenly_over_a_millisecond():
    values, counts = np.unique(dither_ns(), return_counts=True)
    assert values.tolist() == [31_250 * place for place in range(32)]
    assert set(counts) == {LENGTH // 32}
    assert dither_ns()[:6].tolist() == [0, 593_750, 187_500, 781_250, 375_000, 968_750]


class Line:
    """A pulse port of the test's own."""

    def __init__(self):
        self.edges = []
        self.failing = False
        self.timeouts = []

    def receive(self, timeout_s):
        self.timeouts.append(timeout_s)
        if self.failing:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
        waiting, self.edges = self.edges, []
        return waiting

    def close(self):
        pass


@pytest.fixture
def device():
    line = Line()
    return line, SyncPulse("pulse", line)


def test_edges_are_rows(device):
    line, pulse = device
    assert pulse.start(0) == []
    line.edges = [Edge(100, 150, 17), Edge(300, 350, 18)]
    (batch,) = pulse.pump(400, 0.25)
    assert line.timeouts == [0.25]
    assert batch.channel == "pulse"
    assert batch.rows.tolist() == [(0, 150, 100, 17), (1, 350, 300, 18)]
    line.edges = [Edge(500, 550, 19)]
    (batch,) = pulse.stop(600)
    assert batch.rows.tolist() == [(2, 550, 500, 19)]


def test_lost_edges_are_a_gap_and_a_jump(device):
    line, pulse = device
    line.edges = [Edge(100, 100, 0xFFFF_FFFE), Edge(900, 910, 3), Edge(1000, 1010, 4)]
    batches = pulse.pump(2000)
    rows = whole(batches, "pulse")
    assert rows["sequence"].tolist() == [0, 5, 6]
    (gap,) = of(batches, "gap")
    assert (gap["first_missing"], gap["last_missing"], gap["duration_ns"], gap["cause"]) == (1, 4, 800, b"edge_lost")


@pytest.mark.parametrize("number", [5, 1, 0xFFFF_FF00])
def test_a_line_number_that_goes_back_is_a_line_requested_anew(device, number):
    line, pulse = device
    line.edges = [Edge(100, 100, 5), Edge(200, 200, number), Edge(300, 300, number + 1)]
    batches = pulse.pump(400)
    assert whole(batches, "pulse")["sequence"].tolist() == [0, 1, 2]
    assert codes(batches) == ["line_restarted"]


def test_a_line_that_was_away_leaves_a_gap_of_about_as_many_edges(device):
    line, pulse = device
    line.edges = [Edge(100, 100, 1), Edge(300, 310, 2), Edge(500, 510, 3)]
    pulse.pump(600)
    line.failing = True
    pulse.pump(700)
    line.failing = False
    line.edges = [Edge(1510, 1510, 1)]  # 4 of these intervals and a bit were missed
    batches = pulse.pump(1600)
    (gap,) = of(batches, "gap")
    assert (gap["first_missing"], gap["last_missing"], gap["duration_ns"], gap["cause"]) == (3, 6, 1010, b"line_lost")
    assert gap["counted"] == 0
    line.edges = [Edge(2110, 2110, 1)]  # away again before it has told another interval
    (again,) = of(pulse.pump(2200), "gap")
    assert (again["first_missing"], again["last_missing"]) == (8, 9)
    line.edges = [Edge(2310, 2310, 2)]
    (batch,) = pulse.pump(2400)
    assert batch.rows["sequence"].tolist() == [11]


def test_a_line_that_fails_is_told_once_and_asks_for_a_pause(device):
    line, pulse = device
    line.failing = True
    batches = [batch for place in range(200) for batch in pulse.pump(place * 20_000_000)]
    assert codes(batches) == ["bus_error"]
    assert pulse.period_ns > 0
    line.failing = False
    assert codes(pulse.pump(5_000_000_000)) == ["bus_recovered"]
    assert pulse.period_ns == 0


def test_the_configuration_has_the_period_of_the_vehicle_file():
    assert SyncPulseConfig().sync_period_ms == 5.0
