"""The counter of the QSB against the LS7366R data sheet, on a plain model of counting one quarter cycle at a time."""

import hypothesis.strategies as st
import pytest
from hypothesis import given

from hil_sim.devices.serial_line.quadrature import QuadratureCounter

X4_FREE, X2_FREE, X1_FREE = 0x03, 0x02, 0x01
SINGLE, LIMITED, MODULO = 0x04, 0x08, 0x0C
CARRY, BORROW, COMPARE, ENABLED, UP, SIGN = 0x80, 0x40, 0x20, 0x08, 0x02, 0x01
TOP = 0xFFFF_FFFF


def counter(mdr0, mdr1=0, dtr=0x1F3, count=0, position=0):
    made = QuadratureCounter(position)
    made.mdr0, made.mdr1, made.dtr, made.count = mdr0, mdr1, dtr, count
    return made


def test_factory_values():
    made = QuadratureCounter(0)
    assert (made.mdr0, made.mdr1, made.dtr, made.otr, made.count) == (0x4F, 0, 0x1F3, 0, 0)
    assert made.status == 0x0A


@pytest.mark.parametrize(("mdr0", "per_count"), [(X4_FREE, 1), (X2_FREE, 2), (X1_FREE, 4), (0x00, 4)])
def test_resolution(mdr0, per_count):
    made = counter(mdr0)
    made.follow(1000)
    assert made.count == 1000 // per_count
    made.follow(3)
    assert made.count == 3 // per_count


def test_free_running_wraps_at_32_bits_both_ways():
    made = counter(X4_FREE)
    made.follow(-1)
    assert made.count == TOP
    assert made.status & (BORROW | SIGN | UP) == BORROW | SIGN
    made.follow(5)
    assert made.count == 5
    assert made.status & (CARRY | BORROW | SIGN | UP) == CARRY | BORROW | UP


def test_modulo_500_from_the_factory():
    made = counter(X4_FREE | MODULO)
    made.follow(499)
    assert made.count == 499
    made.follow(500)
    assert made.count == 0
    made.follow(-1)
    assert made.count == 499
    made.follow(1234)
    assert made.count == 234


def test_range_limit_holds_at_both_ends():
    made = counter(X4_FREE | LIMITED, dtr=100)
    made.follow(250)
    assert made.count == 100
    made.follow(240)
    assert made.count == 90
    made.follow(0)
    assert made.count == 0


def test_a_single_cycle_ends_with_carry_or_borrow_until_cleared_or_loaded():
    made = counter(X4_FREE | SINGLE, count=TOP - 1)
    made.follow(5)
    assert made.count == 0
    assert made.status & (CARRY | ENABLED) == CARRY
    made.follow(50)
    assert made.count == 0
    made.load()
    made.follow(57)
    assert made.count == 0x1F3 + 7
    assert made.status & ENABLED


def test_count_down_and_disable():
    made = counter(X4_FREE, mdr1=0x100, count=1000)
    made.follow(10)
    assert made.count == 990
    assert not made.status & UP
    made.mdr1 = 0x004
    made.follow(500)
    assert made.count == 990
    assert not made.status & ENABLED
    made.mdr1 = 0
    made.follow(507)
    assert made.count == 997


def test_bit_7_of_mdr1_is_not_count_down():
    made = counter(X4_FREE, mdr1=0x080)
    made.follow(10)
    assert made.count == 10


def test_compare_is_latched_on_the_way_and_cleared():
    made = counter(X4_FREE, dtr=100)
    made.follow(99)
    assert not made.status & COMPARE
    made.follow(300)
    assert made.status == 0x0A | COMPARE
    made.clear_status()
    assert made.status == 0x0A


@given(
    st.sampled_from([X4_FREE, X2_FREE, X1_FREE]),
    st.sampled_from([0, MODULO, LIMITED]),
    st.booleans(),
    st.integers(3, 40),
    st.lists(st.integers(-60, 60), max_size=12),
)
def test_going_straight_is_the_same_as_going_in_single_steps(mdr0, mode, down, dtr, targets):
    straight, stepping = (counter(mdr0 | mode, 0x100 * down, dtr) for _ in range(2))
    here = 0
    for target in targets:
        straight.follow(target)
        while here != target:
            here += 1 if target > here else -1
            stepping.follow(here)
        assert straight.count == stepping.count
        assert straight.status & (UP | ENABLED) == stepping.status & (UP | ENABLED)
