"""The MPU-6050 twin's FIFO and its FSYNC input, by RM-MPU-6000A rev. 4.2.

The MPU-6050 twin with faults: supply, acknowledge, identity, inputs, FSYNC.
"""

import errno

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from hil_sim.faults import Fault, FaultKind
from tests.hil_sim.devices.mpu6050_bench import Bench, plan
from tests.hil_sim.devices.twin_bench import MS, START_NS, FlatImu


def test_a_brown_out_brings_the_reset_values_back():
    bench = Bench(faults=plan(Fault(FaultKind.RESET, "imu", 0.05))).wake()
    bench.write("ACCEL_CONFIG", 0x08)
    bench.start_fifo()
    bench.wait(49)
    assert bench.fill() == 49 * 14
    bench.wait(3)
    assert bench.read("PWR_MGMT_1") == b"\x40"
    assert bench.read("ACCEL_CONFIG") == b"\x00"
    assert bench.fill() == 0
    assert bench.chip.produced in (49, 50)  # made before the supply dipped; nobody can have them


def test_without_supply_nothing_acknowledges():
    bench = Bench(faults=plan(Fault(FaultKind.OFF, "imu", 0.01, 0.02))).wake()
    bench.wait(15)
    with pytest.raises(OSError, match="Remote") as caught:
        bench.read("WHO_AM_I")
    assert caught.value.errno == errno.EREMOTEIO
    bench.wait(10)
    assert bench.read("PWR_MGMT_1") == b"\x40"
    assert max(bench.analog.times_s, default=0) <= 0.010


def test_nack_carries_its_errno():
    bench = Bench(faults=plan(Fault(FaultKind.NACK, "imu", 0.0, 0.01, errno.ETIMEDOUT)))
    with pytest.raises(OSError, match="timed out") as caught:
        bench.read("WHO_AM_I")
    assert caught.value.errno == errno.ETIMEDOUT
    assert bench.wait(10).read("WHO_AM_I") == b"\x68"


def test_wrong_who_am_i():
    bench = Bench(faults=plan(Fault(FaultKind.WHO_AM_I, "imu", 0.0, value=0x98)))
    assert bench.read("WHO_AM_I") == b"\x98"


def test_stuck_and_saturated():
    faults = plan(Fault("stuck", "imu", 0.010, 0.020), Fault("saturated", "imu", 0.030, 0.040, -1))
    bench = Bench(faults=faults).wake()
    bench.start_fifo()
    bench.wait(50)
    words = np.frombuffer(bench.read("FIFO_R_W", bench.fill()), ">i2").reshape(-1, 7)
    steps = words[:, 0]
    assert steps[8] == 9  # sample k is made at k ms
    assert (steps[9:19] == 9).all()
    assert steps[19] == 20
    assert (words[29:39][:, [0, 1, 2, 4, 5, 6]] == -32768).all()
    assert (words[29:39, 3] == 300 + np.arange(30, 40)).all()


def test_stuck_holds_across_batches():
    bench = Bench(faults=plan(Fault("stuck", "imu", 0.010))).wake()
    for _ in range(5):
        bench.wait(7)
        last = bench.words()[0]
    assert last == 9


def test_dropped_and_spurious_fsync():
    faults = plan(Fault("pulse_drop", "imu", 0.0, 0.010), Fault("pulse_spurious", "imu", 0.0152, 0.0252, 0.005))
    bench = Bench(FlatImu([0] * 7), faults=faults).wake()
    bench.write("CONFIG", 0x0A)
    bench.start_fifo(0x80)
    bench.chip.fsync(START_NS + 5 * MS, 300_000)
    bench.wait(30)
    marks = np.frombuffer(bench.read("FIFO_R_W", bench.fill()), ">i2")
    assert (np.flatnonzero(marks) + 1).tolist() == [16, 21]


def test_fifo_packets_are_in_register_order():
    bench = Bench().wake()
    bench.start_fifo()
    bench.wait(30)
    words = np.frombuffer(bench.read("FIFO_R_W", bench.fill()), ">i2").reshape(-1, 7)
    assert len(words) == bench.chip.produced == 30
    steps = words - 100 * np.arange(7)
    assert (steps == steps[:, :1]).all()
    assert (np.diff(steps[:, 0]) == 1).all()


@pytest.mark.parametrize(
    ("enable", "columns"), [(0x08, [0, 1, 2]), (0x80, [3]), (0x10, [6]), (0x78, [0, 1, 2, 4, 5, 6]), (0xA0, [3, 5])]
)
def test_fifo_holds_the_enabled_sensors(enable, columns):
    bench = Bench().wake()
    bench.start_fifo(enable)
    bench.wait(2)
    words = np.frombuffer(bench.read("FIFO_R_W", bench.fill()), ">i2").reshape(-1, len(columns))
    assert (words[0] // 100 == columns).all()


def test_an_overflow_loses_the_oldest_bytes_and_sets_the_flag():
    bench = Bench().wake()
    bench.start_fifo()
    bench.wait(73)
    assert bench.fill() == 73 * 14
    assert bench.read("INT_STATUS") == b"\x01"
    bench.wait(1)
    assert bench.fill() == 1024
    assert bench.read("INT_STATUS") == b"\x11"
    assert bench.read("INT_STATUS") == b"\x00"
    data = bench.read("FIFO_R_W", 1024)
    assert bench.chip.produced == 74
    tail = np.frombuffer(data[1024 - 73 * 14 :], ">i2").reshape(-1, 7)  # 1024 mod 14 = 2: the head is a torn packet
    assert (tail[:, 3] // 100 == 3).all()
    assert data[:2] == int(600 + tail[0, 0] - 1).to_bytes(2, "big")


def test_an_empty_fifo_repeats_its_last_byte():
    bench = Bench().wake()
    bench.start_fifo()
    bench.wait(1)
    data = bench.read("FIFO_R_W", 20)
    assert data[14:] == data[13:14] * 6
    assert bench.read("FIFO_R_W", 3) == data[13:14] * 3


def test_a_disabled_fifo_keeps_its_bytes_and_gives_none():
    bench = Bench().wake()
    bench.start_fifo()
    bench.wait(5)
    bench.write("USER_CTRL", 0x00)
    assert bench.wait(5).fill() == 70
    assert set(bench.read("FIFO_R_W", 14)) == {0}
    assert bench.fill() == 70
    bench.write("USER_CTRL", 0x40)
    assert np.frombuffer(bench.read("FIFO_R_W", 14), ">i2")[0] < 100


def test_fifo_reset_acts_only_while_the_fifo_is_disabled():
    bench = Bench().wake()
    bench.start_fifo()
    bench.wait(5)
    bench.write("USER_CTRL", 0x44)
    assert bench.fill() == 70
    assert bench.read("USER_CTRL") == b"\x40"
    bench.write("USER_CTRL", 0x04)
    assert bench.fill() == 0
    assert bench.read("USER_CTRL") == b"\x00"


def test_the_count_is_latched_by_its_high_byte():
    bench = Bench().wake()
    bench.start_fifo()
    bench.wait(20)
    assert bench.read("FIFO_COUNT_L") == b"\x00"
    assert bench.read("FIFO_COUNT_H") == bytes([280 >> 8])
    bench.wait(1)
    assert bench.read("FIFO_COUNT_L") == bytes([280 & 0xFF])
    bench.read("FIFO_COUNT_H")
    assert bench.read("FIFO_COUNT_L") == bytes([294 & 0xFF])


def test_produced_counts_from_the_last_enable():
    bench = Bench().wake()
    bench.start_fifo()
    bench.wait(5)
    bench.start_fifo()
    bench.chip.advance(bench.wait(3).now_ns)
    assert bench.chip.produced == 3
    assert bench.chip.produced_by_enable == (5, 3)


@given(reads=st.lists(st.tuples(st.integers(0, 90), st.integers(0, 300)), max_size=12))
def test_fifo_is_a_byte_queue_that_forgets_its_oldest(reads):
    bench = Bench().wake()
    bench.start_fifo()
    model, made, last = b"", 0, 0
    for ms, count in reads:
        bench.wait(ms)
        made += ms
        first = bench.analog
        new = first.counts(np.arange(made - ms + 1, made + 1) * 1e-3, 1.0, 1.0, 0)
        model = (model + new.astype(">i2").tobytes())[-1024:]
        expected, model = model[:count], model[count:]
        last = expected[-1] if expected else last
        expected += bytes([last]) * (count - len(expected))
        if count:
            assert bench.read("FIFO_R_W", count) == expected
        assert bench.fill() == len(model)


def test_one_burst_is_one_instant_and_two_reads_tear():
    bench = Bench(FlatImu([0x0100] * 7)).wake()
    bench.wait(2)
    assert bench.read("ACCEL_XOUT_H", 14) == b"\x01\x00" * 7
    high = bench.read("ACCEL_XOUT_H")
    bench.analog.words[:] = 0x00FF
    low = bench.wait(1).read(0x3C)
    assert high + low == b"\x01\xff"  # a word that never was


@pytest.mark.parametrize(("code", "column"), [(1, 3), (2, 4), (3, 5), (4, 6), (5, 0), (6, 1), (7, 2)])
def test_fsync_replaces_the_lsb_that_is_selected(code, column):
    bench = Bench(FlatImu([101] * 7)).wake()
    bench.write("CONFIG", code << 3 | 2)
    bench.start_fifo()
    bench.wait(3.4)
    bench.chip.fsync(bench.now_ns, 300_000)
    bench.wait(4)
    samples = np.frombuffer(bench.read("FIFO_R_W", bench.fill()), ">i2").reshape(-1, 7)
    assert samples[:, column].tolist() == [100, 100, 100, 101, 100, 100, 100]
    others = np.delete(samples, column, axis=1)
    assert (others == 101).all()


def test_without_ext_sync_set_no_bit_is_touched():
    bench = Bench(FlatImu([100] * 7)).wake()
    bench.chip.fsync(bench.now_ns + 500_000, 300_000)
    assert (bench.wait(3).words() == 100).all()


@pytest.mark.parametrize(
    ("edge_ms", "high_ms", "marked"),
    [
        (2.2, 0.3, [3]),
        (2.9, 0.3, [3, 4]),  # still high at sample 3: the latch resets to the present level
        (2.0, 0.3, [2, 3]),  # rises with a sample: high at its instant, and still high after it
        (2.5, 3.0, [3, 4, 5, 6]),
        (0.1, 0.3, [1]),
    ],
)
def test_a_strobe_marks_every_period_in_which_it_was_high(edge_ms, high_ms, marked):
    bench = Bench(FlatImu([0] * 7)).wake()
    bench.write("CONFIG", 0x0A)
    bench.start_fifo()
    bench.chip.fsync(bench.now_ns + round(edge_ms * MS), round(high_ms * MS))
    bench.wait(8)
    temperature = np.frombuffer(bench.read("FIFO_R_W", bench.fill()), ">i2").reshape(-1, 7)[:, 3]
    assert (np.flatnonzero(temperature) + 1).tolist() == marked


@settings(max_examples=40)
@given(
    edges_us=st.lists(st.integers(0, 400_000), unique=True, max_size=8),
    polls_ms=st.lists(st.integers(1, 60), min_size=1, max_size=8),
    rate_error=st.sampled_from([-0.01, 0.0, 0.0037]),
)
def test_marks_do_not_depend_on_when_anybody_looks(edges_us, polls_ms, rate_error):
    def marks(polls):
        bench = Bench(FlatImu([0] * 7), rate_error).wake()
        bench.write("CONFIG", 0x0A)
        bench.start_fifo(0x80)
        waiting = sorted(START_NS + 1000 * us for us in edges_us)
        data = b""
        for ms in polls:
            bench.wait(ms)
            while waiting and waiting[0] <= bench.now_ns:
                bench.chip.fsync(waiting.pop(0), 300_000)
            data += bench.read("FIFO_R_W", n) if (n := bench.fill()) else b""
        return data

    total = sum(polls_ms)
    assert marks(polls_ms) == marks([1] * total)


def test_an_edge_in_the_past_is_refused():
    bench = Bench().wake()
    bench.wait(10).words()
    with pytest.raises(ValueError, match="advance the pulse source"):
        bench.chip.fsync(bench.now_ns - 5 * MS, 300_000)


def test_fsync_interrupt_status_clears_on_read():
    bench = Bench().wake()
    bench.chip.fsync(bench.now_ns, 300_000)
    assert bench.read(0x36) == b"\x00"
    bench.write("INT_PIN_CFG", 0x04)
    bench.chip.fsync(bench.now_ns, 300_000)
    assert bench.read(0x36) == b"\x80"
    assert bench.read(0x36) == b"\x00"


def test_int_rd_clear_makes_any_read_clear_the_status():
    bench = Bench().wake()
    bench.write("INT_PIN_CFG", 0x10)
    bench.wait(2).words()
    assert bench.read("INT_STATUS") == b"\x00"


def test_a_burst_from_the_count_runs_into_the_fifo():
    bench = Bench().wake()
    bench.start_fifo()
    bench.wait(2)
    data = bench.read("FIFO_COUNT_H", 2 + 28)
    assert data[:2] == b"\x00\x1c"
    assert (np.frombuffer(data[2:], ">i2").reshape(-1, 7) // 100 == np.arange(7)).all()
    assert bench.chip.fifo_fill == 0


def test_the_fifo_can_be_written_while_it_is_enabled():
    bench = Bench()
    bench.write("FIFO_R_W", 1, 2, 3)
    assert bench.chip.fifo_fill == 0
    bench.write("USER_CTRL", 0x40)
    bench.write("FIFO_R_W", 1, 2, 3)
    assert bench.read("FIFO_R_W", 3) == b"\x01\x02\x03"
