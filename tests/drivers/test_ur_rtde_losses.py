"""RTDE: lost packages, restarts of controller and connection, and whatever bytes come; no loss goes uncounted."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.drivers.batches import codes, of, texts, whole
from tests.drivers.rtde_flight import BAD, CHANNELS, MS, PERIOD_S, RESET, Flight
from tests.drivers.rtde_model import framed
from tests.drivers.serial_script import fuzzed


@pytest.fixture
def up():
    flight = Flight()
    flight.start()
    return flight.packages(3)


def test_lost_packages_are_counted_by_its_clock(up):
    up.time_s += 5 * PERIOD_S
    up.packages(2)
    up.stop()
    assert whole(up.batches, "q1")["sequence"].tolist() == [0, 1, 2, 8, 9]
    gaps = of(up.batches, "gap")
    assert len(gaps) == len(CHANNELS)
    assert set(gaps["cause"]) == {b"packages_lost"}
    assert gaps["counted"].all()
    assert set(gaps["duration_ns"]) == {40 * MS}


def test_a_connection_that_is_lost_and_returns(up):
    up.port.broken = True
    up.packages(50)
    up.port.broken = False
    up.packages(150)
    up.stop()
    rows = whole(up.batches, "q1")
    assert rows["sequence"][-1] == 202
    assert not rows["status"].any()
    assert codes(up.batches)[2:] == ["bus_error", "bus_recovered", "stopped"]
    assert set(of(up.batches, "gap")["cause"]) == {b"port_lost"}
    assert of(up.batches, "gap")["counted"].all()


@pytest.mark.parametrize("time_s", [0.0, 95.0, 100.5, 200.0])
def test_a_controller_that_was_started_again(up, time_s):
    up.port.broken = True
    up.packages(500)
    up.port.broken, up.time_s = False, time_s  # of a boot before, it may have been on for less than now
    up.packages(150)
    up.stop()
    rows = whole(up.batches, "q1")
    assert np.flatnonzero(rows["status"] & RESET).tolist() == [3]
    assert codes(up.batches).count("restarted") == 1
    assert rows["sequence"][-1] == pytest.approx(652, abs=1)  # estimated, by arrivals
    assert not of(up.batches, "gap")["counted"].any()


def test_a_time_that_stands_still_or_is_none(up):
    up.packages(1, step_s=0.0)
    assert of(up.batches, "q1")["status"].tolist() == [0, 0, 0, BAD]
    for time_s in (math.nan, -1.0, 1e10):
        opened = up.port.opened
        up.pump(8 * MS, up.model.data(time_s))
        up.packages(200)
        assert up.port.opened == opened + 1
        assert texts(up.batches, "out_of_step")
    assert len(of(up.batches, "q1")) > 500


@pytest.mark.parametrize("recipe_and_size", [(2, 0), (1, 1), (1, -1)])
def test_data_of_another_recipe_or_length_open_the_connection_anew(up, recipe_and_size):
    recipe, size = recipe_and_size
    payload = up.model.data(up.time_s + PERIOD_S, recipe)[3:]
    up.pump(8 * MS, framed("U", payload + bytes(1) if size > 0 else payload[: len(payload) + size]))
    up.packages(20)
    assert up.device.bad_frames == 1
    assert up.port.opened == 2
    assert len(whole(up.batches, "q1")) > 15


def test_data_of_a_session_before_are_not_taken():
    flight = Flight()
    flight.model.sends = ["timestamp", "robot_mode", "safety_status_bits", "actual_q"]
    before = flight.model.data(5.0)
    flight.port.answer = lambda data: before + flight.model.receive(data)
    flight.start()
    flight.packages(3)
    assert of(flight.batches, "q1")["tick"][0] == 100_008_000
    assert flight.device.bad_frames == 0


def test_a_stop_tells_what_is_missing_at_the_end(up):
    up.pump(900 * MS)
    up.stop()
    rows, gaps = whole(up.batches, "q1"), of(up.batches, "gap")
    assert len(rows) == 3
    assert set(gaps["last_missing"]) == {3 + 112 - 1}
    assert set(gaps["cause"]) == {b"silent"}


FUZZED = st.one_of(
    st.builds(framed, st.sampled_from("VvMOSUIP"), st.binary(max_size=60)),
    st.sampled_from(["data", "data", "old", "far"]),
    st.binary(max_size=30),
)


@settings(max_examples=60)
@given(
    moves=st.lists(
        st.tuples(st.sampled_from([0, MS, 8 * MS, 600 * MS, 10_000 * MS]), FUZZED, st.integers(0, 40)), max_size=25
    )
)
def test_nothing_that_comes_in_can_raise_or_be_lost_in_silence(moves):
    flight = Flight()
    flight.start()

    def pump(after_ns, said):
        flight.time_s += {"old": -20.0, "far": 9e8}.get(said, 1e-9 * after_ns)
        if isinstance(said, bytes):
            flight.pump(after_ns, said)
        else:
            flight.pump(after_ns, flight.model.data(max(0.0, flight.time_s % 1e9)) if flight.model.sends else b"")

    fuzzed(flight, moves, pump)


@pytest.mark.parametrize(
    ("away_s", "behind_s", "restarts"),
    [(4.0, 0.15, 0), (4.0, 0.3, 1), (4.0, -0.15, 0), (4.0, -0.3, 1), (1000.0, 0.5, 0), (1000.0, 1.5, 1)],
)
def test_a_crystal_and_a_late_package_are_no_restart(up, away_s, behind_s, restarts):
    up.port.broken = True
    up.packages(2)
    up.packages(1, step_s=away_s)
    up.port.broken = False
    up.time_s -= behind_s
    up.packages(150)
    assert codes(up.batches).count("restarted") == restarts


def test_a_time_that_goes_back_within_a_connection_began_anew(up):
    up.time_s = 1.0
    up.packages(2)
    up.stop()
    assert whole(up.batches, "q1")["status"].tolist() == [0, 0, 0, RESET, 0]
    assert codes(up.batches).count("restarted") == 1
