"""The MPU-6050 twin against RM-MPU-6000A rev. 4.2 and PS-MPU-6000A rev. 3.4, addresses and values typed here."""

import errno

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from hil_sim.devices.mpu6050.registers import FactoryTrim
from hil_sim.faults import Fault, FaultKind, FaultPlan
from tests.hil_sim.devices.twin_bench import MS, START_NS, FlatImu, RateClock, StairImu

AD = 0x68
REGISTER = {
    "SMPLRT_DIV": 0x19,
    "CONFIG": 0x1A,
    "GYRO_CONFIG": 0x1B,
    "ACCEL_CONFIG": 0x1C,
    "FIFO_EN": 0x23,
    "INT_PIN_CFG": 0x37,
    "INT_STATUS": 0x3A,
    "ACCEL_XOUT_H": 0x3B,
    "USER_CTRL": 0x6A,
    "PWR_MGMT_1": 0x6B,
    "PWR_MGMT_2": 0x6C,
    "FIFO_COUNT_H": 0x72,
    "FIFO_COUNT_L": 0x73,
    "FIFO_R_W": 0x74,
    "WHO_AM_I": 0x75,
}


class Bench:
    """A chip and a master that names registers."""

    def __init__(self, analog=None, rate_error=0.0, **options):
        self.analog = analog or StairImu()
        self.clock = RateClock(rate_error)
        self.chip = Mpu6050Twin(self.analog, self.clock, START_NS, **options)
        self.now_ns = START_NS

    def wait(self, ms):
        self.now_ns += round(ms * MS)
        return self

    def write(self, name, *values):
        self.chip.transfer(AD, bytes([REGISTER.get(name, name), *values]), 0, self.now_ns)

    def read(self, name, count=1):
        return self.chip.transfer(AD, bytes([REGISTER.get(name, name)]), count, self.now_ns)

    def wake(self):
        self.write("PWR_MGMT_1", 0x01)
        self.write("CONFIG", 0x02)  # 1 kHz
        return self

    def start_fifo(self, sensors=0xF8):
        self.write("FIFO_EN", sensors)
        self.write("USER_CTRL", 0x00)
        self.write("USER_CTRL", 0x04)
        self.write("USER_CTRL", 0x40)

    def fill(self):
        return int.from_bytes(self.read("FIFO_COUNT_H", 2), "big")

    def words(self):
        return np.frombuffer(self.read("ACCEL_XOUT_H", 14), ">i2")


def test_reset_values_are_zero_but_for_sleep_and_identity():
    bench = Bench(trim=FactoryTrim((0, 0, 0), (0, 0, 0)))
    values = dict(enumerate(bench.read(0x00, 0x72)))  # up to the FIFO registers
    values |= dict(enumerate(bench.read(0x72, 2), 0x72)) | {0x75: bench.read(0x75)[0]}
    assert {address: value for address, value in values.items() if value} == {0x6B: 0x40, 0x75: 0x68}


@pytest.mark.parametrize("address", [0x68, 0x69])
def test_identity_is_68_whatever_the_address(address):
    chip = Mpu6050Twin(StairImu(), RateClock(), START_NS, address=address)
    assert chip.transfer(address, b"\x75", 1, START_NS) == b"\x68"
    with pytest.raises(OSError, match="Remote I/O") as caught:
        chip.transfer(address ^ 1, b"\x75", 1, START_NS)
    assert caught.value.errno == errno.EREMOTEIO


def test_it_wakes_up_asleep():
    bench = Bench().wait(100)
    assert not bench.words().any()
    assert bench.read("INT_STATUS") == b"\x00"
    assert bench.analog.calls == []
    bench.wake()
    bench.wait(1.5)
    assert bench.words().any()
    bench.write("PWR_MGMT_1", 0x41)
    frozen = bench.words()
    assert (bench.wait(10).words() == frozen).all()


@pytest.mark.parametrize("register", [0x3B, 0x48, 0x3A, 0x75, 0x72, 0x73, 0x36, 0x0D])
def test_read_only_registers_keep_their_value(register):
    bench = Bench()
    before = bench.read(register)
    bench.write(register, 0x5A)
    assert bench.read(register) == before


@pytest.mark.parametrize("register", [0x19, 0x1A, 0x1B, 0x1C, 0x23, 0x24, 0x37, 0x38, 0x6C, 0x13, 0x06])
def test_configuration_registers_read_back(register):
    bench = Bench()
    bench.write(register, 0x15)
    assert bench.read(register) == b"\x15"


def test_a_burst_increments_through_registers_and_stays_on_the_fifo():
    bench = Bench().wake()
    bench.write("SMPLRT_DIV", 0x07, 0x02, 0x18, 0x10)
    assert bench.read("SMPLRT_DIV", 4) == bytes([0x07, 0x02, 0x18, 0x10])
    bench.start_fifo()
    bench.wait(40)
    n = bench.fill()
    assert n > 28
    packets = [np.frombuffer(bench.read("FIFO_R_W", 14), ">i2") for _ in range(2)]
    assert (packets[1] - packets[0] == 8).all()  # SMPLRT_DIV 7; not 0x74, 0x75 (WHO_AM_I), ...
    assert bench.fill() == n - 28


def test_a_read_without_a_register_goes_on_from_the_pointer():
    bench = Bench()
    bench.write("WHO_AM_I")
    assert bench.chip.transfer(AD, b"", 1, bench.now_ns) == b"\x68"


@pytest.mark.parametrize(("fs", "lsb"), [(0, 131.0), (1, 65.5), (2, 32.8), (3, 16.4)])
@pytest.mark.parametrize(("afs", "lsb_g"), [(0, 16384.0), (1, 8192.0), (2, 4096.0), (3, 2048.0)])
def test_ranges_and_filter_reach_the_sensing_elements(fs, lsb, afs, lsb_g):
    bench = Bench().wake()
    bench.write("GYRO_CONFIG", fs << 3)
    bench.write("ACCEL_CONFIG", afs << 3)
    bench.write("CONFIG", 0x0B)
    bench.wait(5).words()
    assert bench.analog.calls[-1][1:] == (lsb_g, lsb, 3)


@pytest.mark.parametrize(
    ("dlpf", "divider", "rate_hz"),
    [(2, 0, 1000), (1, 1, 500), (6, 9, 100), (3, 255, 3.90625), (0, 7, 1000), (7, 79, 100)],
)
def test_sample_rate(dlpf, divider, rate_hz):
    bench = Bench()
    bench.write("PWR_MGMT_1", 0x01)
    bench.write("SMPLRT_DIV", divider)
    bench.write("CONFIG", dlpf)
    bench.start_fifo(0x80)
    bench.wait(2000).fill()
    assert abs(bench.chip.produced - 2 * rate_hz) <= 1


def test_the_accelerometer_repeats_above_one_kilohertz():
    bench = Bench()
    bench.write("PWR_MGMT_1", 0x01)
    bench.start_fifo(0x08 | 0x40)
    bench.wait(4)
    n = bench.fill()
    samples = np.frombuffer(bench.read("FIFO_R_W", n), ">i2").reshape(-1, 4)
    assert n == 8 * 32
    assert len(np.unique(samples[:, 0])) <= 5
    assert (np.diff(samples[8:, 0]) != 0).sum() == 3 - 1 + 1


def test_its_own_clock_sets_the_rate_and_the_instants():
    bench = Bench(rate_error=0.01).wake()
    bench.start_fifo()
    for _ in range(100):
        bench.wait(10).fill()
    assert abs(bench.chip.produced - 1010) <= 1
    assert len(bench.analog.times_s) == bench.chip.produced
    intervals = np.diff(bench.analog.times_s)
    np.testing.assert_allclose(intervals, 1e-3 / 1.01, rtol=0, atol=3e-9)
    assert all(0 < t <= 1.0 for t in bench.analog.times_s)


def test_nothing_is_asked_of_the_physics_beyond_the_present():
    bench = Bench(rate_error=0.0037).wake()
    for _ in range(300):
        bench.wait(1.0 / 1.0037).words()
        assert bench.analog.times_s[-1:] <= [(bench.now_ns - START_NS) * 1e-9]
    assert len(bench.analog.times_s) >= 299


class ScaledImu(StairImu):
    """Words that tell every setting; what it will say is known."""

    known_s = 10.0

    def counts(self, times_s, accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg):
        words = super().counts(times_s, accel_lsb_per_g, gyro_lsb_per_dps, dlpf_cfg)
        words[:, :3] += np.int16(accel_lsb_per_g / 1024)
        words[:, 4:] += np.int16(gyro_lsb_per_dps + 1000 * dlpf_cfg)
        return words


@given(
    st.lists(
        st.tuples(
            st.sampled_from(
                [
                    ("CONFIG", 0x02),
                    ("CONFIG", 0x0B),
                    ("CONFIG", 0x00),
                    ("GYRO_CONFIG", 0x18),
                    ("GYRO_CONFIG", 0xE0),
                    ("ACCEL_CONFIG", 0x10),
                    ("SMPLRT_DIV", 3),
                    ("SMPLRT_DIV", 0),
                    ("PWR_MGMT_2", 0x07),
                    ("PWR_MGMT_2", 0x00),
                    ("PWR_MGMT_1", 0x01),
                    ("PWR_MGMT_1", 0x40),
                    ("PWR_MGMT_1", 0x80),
                ]
            ),
            st.floats(0.3, 60.0),
        ),
        max_size=12,
    )
)
def test_words_converted_ahead_are_those_of_a_chip_that_knows_no_future(writes):
    said = []
    for known_s in (0.0, 10.0):
        analog = ScaledImu()
        analog.known_s = known_s
        bench = Bench(analog, rate_error=-0.004).wake()
        bench.start_fifo()
        words = []
        for (name, value), ms in writes:
            bench.chip.fsync(bench.now_ns + 700_000, 300_000)
            for _ in range(4):
                bench.wait(ms / 4)
                words.append(bench.read("FIFO_R_W", 1024) + bench.read("ACCEL_XOUT_H", 14))
            bench.write(name, value)
        said.append(words)
    assert said[0] == said[1]


def test_words_are_converted_ahead_where_the_future_is_known():
    bench = Bench(ScaledImu()).wake()
    for _ in range(50):
        bench.wait(10).read("INT_STATUS")
    assert len(bench.analog.calls) < 5


def test_the_internal_oscillator_is_another_one():
    bench = Bench(rc_clock=RateClock(-0.04))
    bench.write("CONFIG", 0x02)
    bench.write("PWR_MGMT_1", 0x00)
    bench.start_fifo()
    bench.wait(1000).fill()
    assert abs(bench.chip.produced - 960) <= 1
    bench.write("PWR_MGMT_1", 0x07)  # clock stopped
    n = bench.chip.produced
    bench.wait(100).fill()
    assert bench.chip.produced == n


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


def test_device_reset_clears_itself_and_everything_else():
    bench = Bench().wake()
    bench.write("ACCEL_CONFIG", 0x18)
    bench.start_fifo()
    bench.wait(10)
    bench.write("PWR_MGMT_1", 0x80)
    assert bench.read("PWR_MGMT_1") == b"\xc0"
    bench.write("ACCEL_CONFIG", 0x08)  # lost: the chip is busy
    bench.wait(1)
    assert bench.read("PWR_MGMT_1") == b"\x40"
    assert bench.read("ACCEL_CONFIG") == b"\x00"
    assert bench.fill() == 0
    assert not bench.words().any()


def test_standby_and_temperature_disable_hold_their_word():
    bench = Bench().wake()
    bench.wait(3).words()
    held = bench.words()
    bench.write("PWR_MGMT_2", 0b00_100_001)  # accel x, gyro z
    bench.write("PWR_MGMT_1", 0x09)  # TEMP_DIS
    words = bench.wait(5).words()
    assert [k for k in range(7) if words[k] == held[k]] == [0, 3, 6]


@pytest.mark.parametrize(("lp", "period_ms"), [(0, 800), (1, 200), (2, 50), (3, 25)])
def test_cycle_mode_samples_the_accelerometer_slowly(lp, period_ms):
    bench = Bench().wake()
    bench.write("PWR_MGMT_2", lp << 6)
    bench.write("PWR_MGMT_1", 0x20)
    bench.start_fifo(0x08)
    bench.wait(1600.5).fill()
    assert abs(bench.chip.produced - 1600 // period_ms) <= 1
    assert bench.words()[4] == 0  # the gyro rests


def test_self_test_response_follows_the_factory_trim():
    trim = FactoryTrim(gyro=(10, 20, 0), accel=(1, 31, 0))
    bench = Bench(FlatImu([0] * 7), trim=trim).wake()
    assert bench.read(0x0D, 4) == bytes([0 << 5 | 10, 7 << 5 | 20, 0, 1 << 4 | 3 << 2])
    bench.write("GYRO_CONFIG", 0xE0)  # 250 deg/s
    bench.write("ACCEL_CONFIG", 0xF0)  # 8 g
    words = bench.wait(3).words()
    assert words[4] == round(25 * 131 * 1.046**9)
    assert words[5] == -round(25 * 131 * 1.046**19)
    assert words[6] == 0
    assert words[:3].tolist() == [round(4096 * 0.34), round(4096 * 0.92), 0]
    bench.write("GYRO_CONFIG", 0x80)
    assert bench.wait(3).words()[5] == 0


def test_self_test_of_a_bad_chip_is_off_and_saturates():
    bench = Bench(FlatImu([0, 0, 0, 0, 32000, 0, 0]), trim=FactoryTrim((30, 30, 0)), self_test_error=-0.3).wake()
    bench.write("GYRO_CONFIG", 0x80)
    assert bench.wait(3).words()[4] == 32767
    bench.analog.words[4:6] = -32768
    bench.write("GYRO_CONFIG", 0xC0)
    assert bench.wait(3).words()[5] == -32768  # y answers the other way
    bench.analog.words[4] = 0
    assert bench.wait(3).words()[4] == round(0.7 * 25 * 131 * 1.046**29)


def plan(*faults):
    return FaultPlan(faults, START_NS).of("imu")


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


def test_signal_condition_reset_clears_the_sensor_registers():
    bench = Bench().wake()
    assert bench.wait(2).words().any()
    bench.write("USER_CTRL", 0x01)
    assert not bench.words().any()
    assert bench.read("WHO_AM_I") == b"\x68"  # nothing beyond them moved
    assert bench.read("USER_CTRL") == b"\x00"


def test_samples_are_made_in_batches_when_nobody_looks():
    bench = Bench().wake()
    bench.start_fifo()
    for _ in range(49):
        bench.chip.advance(bench.wait(1).now_ns)
    assert bench.analog.calls == []
    bench.chip.advance(bench.wait(1).now_ns)
    assert [call[0] for call in bench.analog.calls] == [50]


def test_samples_shown_are_counted_from_the_first_to_the_last_read_as_new():
    bench = Bench().wake()
    assert bench.chip.shown == 0
    bench.wait(5.5).read("INT_STATUS")  # what was there before is not new any more
    for ms in (1, 0.1, 3, 1, 0.2):  # a new one, the same, two missed and a new one, a new one, the same
        bench.wait(ms).read("INT_STATUS", 15)
    bench.wait(3).read("ACCEL_XOUT_H", 14)  # nothing says that these are new
    assert bench.chip.shown == 5
