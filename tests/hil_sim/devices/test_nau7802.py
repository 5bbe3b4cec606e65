"""The simulated NAU7802: registers, conversions, calibration, rails, faults."""

import errno

import pytest

from hil_sim.devices.bridge_converter import FILTER
from hil_sim.devices.i2c.nau7802 import Nau7802Twin
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock

COUNTS_N = 2.0 * 128 * (1 << 23) * 2e-3 / 50.0  # of the default bridge at gain 128


class Master:
    """A master of the chip, and its time."""

    def __init__(self, function=lambda t: 0.0, rate_error=0.0, faults=()):
        self.now_ns = START_NS
        plan = FaultPlan([Fault(*one) for one in faults], START_NS)
        self.twin = Nau7802Twin(Analog(function), RateClock(rate_error), START_NS, faults=plan.of("cell"))

    def write(self, register, *values):
        self.twin.transfer(0x2A, bytes([register, *values]), 0, self.now_ns)

    def read(self, register, count=1):
        return self.twin.transfer(0x2A, bytes([register]), count, self.now_ns)

    def wait(self, ms):
        self.now_ns += round(ms * MS)

    def run(self, rate_code=3, gain_code=7):
        self.write(0, 0x02)
        self.wait(1)
        self.write(1, 0x28 | gain_code)
        self.write(2, rate_code << 4)
        self.write(0, 0x96)

    def sample(self):
        while not self.read(0)[0] & 0x20:
            self.wait(0.1)
        return int.from_bytes(self.read(0x12, 3), "big", signed=True)


def test_registers_after_power_up_and_after_a_reset():
    master = Master()
    for _ in range(2):
        values = master.read(0, 0x20)
        assert {at: value for at, value in enumerate(values) if value} == {0x07: 0x80, 0x0E: 0x80, 0x1F: 0x0F}
        master.write(1, 0x2F)
        master.write(3, 1, 2, 3)
        assert master.read(3, 3) == b"\1\2\3"
        master.write(0, 0x01)
        master.write(0, 0x00)


def test_it_is_ready_200_us_after_its_digital_part_has_power():
    master = Master()
    master.write(0, 0x02)
    assert master.read(0) == b"\x02"
    master.wait(0.2)
    assert master.read(0) == b"\x0a"


@pytest.mark.parametrize(("code", "rate"), [(0, 10), (1, 20), (2, 40), (3, 80), (7, 320)])
def test_its_rates_by_its_own_clock(code, rate):
    master = Master(rate_error=0.01)
    master.run(code)
    master.sample()
    began_ns = master.now_ns
    for _ in range(20):
        master.sample()
    assert 20e9 / (master.now_ns - began_ns) == pytest.approx(rate * 1.01, rel=2e-3)


@pytest.mark.parametrize(("code", "gain"), list(enumerate((1, 2, 4, 8, 16, 32, 64, 128))))
def test_a_force_in_counts_by_its_gain(code, gain):
    master = Master(lambda t: 25.0)
    master.run(gain_code=code)
    for _ in range(5):
        counts = master.sample()
    offset = 20e-6 / 3.0 * 2.0 * gain * (1 << 23)
    assert counts == pytest.approx(25.0 * COUNTS_N * gain / 128, abs=4 * offset)


def test_its_filter_delays_by_two_conversions_and_settles_in_four():
    assert FILTER.sum() == pytest.approx(1.0)
    slope = 5.0
    master = Master(lambda t: max(slope * (t - 0.5), 0.0))
    master.run()
    master.write(2, 0x34)
    master.wait(490)
    for _ in range(12):
        counts = master.sample()
    ended_s = (master.now_ns - START_NS) * 1e-9
    assert ended_s - 0.5 > 4.0 / 80
    assert ended_s - 0.5 - counts / COUNTS_N / slope == pytest.approx(2.0 / 80, abs=2e-4)


@pytest.mark.parametrize(("force", "rail"), [(500.0, 0x7FFFFF), (-500.0, -0x800000)])
def test_it_clips_at_its_rails(force, rail):
    master = Master(lambda t: force)
    master.run()
    assert master.sample() == rail


def test_its_offset_calibration_takes_its_own_offset_off():
    master = Master()
    master.run()
    before = master.sample()
    master.write(2, 0x34)
    assert master.read(2)[0] & 0x04
    master.wait(200)
    assert master.read(2) == b"\x30"
    sign, *_ = offset = master.read(3, 3)
    assert bool(sign & 0x80) == (before < 0)
    assert int.from_bytes(bytes([offset[0] & 0x7F, *offset[1:]]), "big") == pytest.approx(abs(before), abs=1)
    for _ in range(3):
        after = master.sample()
    assert abs(after) <= 1


def test_gain_and_offset_registers_act_on_the_result():
    master = Master(lambda t: 10.0)
    master.run()
    plain = master.sample()
    master.write(6, 0x01, 0x00, 0x00, 0x00)  # 2
    assert master.sample() == pytest.approx(2 * plain, abs=2)
    master.write(3, 0x80, 0x10, 0x00)
    assert master.sample() == pytest.approx(2 * (plain + 0x1000), abs=2)


def test_channel_2_has_no_cell():
    master = Master(lambda t: 20.0)
    master.run()
    assert master.sample() > 1e6
    master.write(2, 0xB0)
    master.sample()
    assert abs(master.sample()) < 1e5


def test_system_calibrations_fail():
    master = Master()
    master.run()
    master.write(2, 0x37)
    master.wait(200)
    assert master.read(2)[0] & 0x0C == 0x08


def test_faults_of_its_bus_and_supply():
    faults = [("nack", "cell", 1.0, 2.0), ("timeout", "cell", 3.0, 4.0), ("off", "cell", 5.0, 6.0)]
    master = Master(faults=[*faults, ("who_am_i", "cell", 7.0, 8.0, 0x42), ("reset", "cell", 9.0)])
    master.run()
    for second, code in ((1.5, errno.EREMOTEIO), (3.5, errno.ETIMEDOUT), (5.5, errno.EREMOTEIO)):
        master.now_ns = START_NS + round(second * 1e9)
        with pytest.raises(OSError, match=r"\w+") as raised:
            master.read(0)
        assert raised.value.errno == code
    master.now_ns = START_NS + 6_500 * MS
    assert master.read(0) == b"\0"  # it lost its registers
    master.run()
    master.now_ns = START_NS + 7_500 * MS
    assert master.read(0x1F) == b"\x42"
    assert master.read(0)[0] & 0x06 == 0x06
    master.now_ns = START_NS + 9_500 * MS
    assert master.read(0) == b"\0"
    with pytest.raises(FaultError, match="cannot have the fault byte_loss"):
        Master(faults=[("byte_loss", "cell", 0.0, 1.0, 0.5)])


def test_faults_of_its_input_and_clock():
    faults = [("saturated", "cell", 1.0, 2.0, -1.0), ("wrong", "cell", 3.0, 4.0, 0.5), ("slow", "cell", 5.0, 6.0, 0.5)]
    master = Master(lambda t: 10.0, faults=faults)
    master.run()
    well = master.sample()
    master.now_ns = START_NS + 1_500 * MS
    master.read(0x12, 3)
    assert master.sample() == -0x800000
    master.now_ns = START_NS + 3_500 * MS
    master.read(0x12, 3)
    assert master.sample() == pytest.approx(1.5 * well, rel=0.02)
    master.now_ns = START_NS + 5_100 * MS
    master.read(0x12, 3)
    master.sample()
    began_ns = master.now_ns
    for _ in range(10):
        master.sample()
    assert master.now_ns - began_ns == pytest.approx(10 * 25 * MS, rel=0.01)
