"""The MPU-6050 twin against RM-MPU-6000A rev. 4.2 and PS-MPU-6000A rev. 3.4, addresses and values typed here."""

import errno

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from hil_sim.devices.mpu6050.chip import Mpu6050Twin
from hil_sim.devices.mpu6050.registers import FactoryTrim
from tests.hil_sim.devices.mpu6050_bench import AD, Bench
from tests.hil_sim.devices.twin_bench import START_NS, FlatImu, RateClock, StairImu


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
