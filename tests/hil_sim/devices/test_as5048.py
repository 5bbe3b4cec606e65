"""The simulated AS5048: registers and words, angle, magnet, faults; B read as public Python drivers read it."""

import errno
from math import radians, tau

import numpy as np
import pytest
from smbus2 import SMBus

from hil_sim.buses.i2c_dev import install_i2c
from hil_sim.devices.i2c.as5048 import As5048aTwin, As5048bTwin
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog

ANGLE, MAGNITUDE, STATE, ERRORS, NOTHING = 0xFFFF, 0x7FFE, 0x7FFD, 0x4001, 0x0000  # as public drivers send them


def chip(function=lambda t: 1.0, faults=(), kind=As5048bTwin, **options):
    plan = FaultPlan([Fault(*one) for one in faults], START_NS)
    return kind(Analog(function), START_NS, faults=plan.of("joint"), **options)


def spi(*arguments, **options):
    return chip(*arguments, kind=As5048aTwin, **options)


def read(twin, register, count=1, ms=20.0, address=0x40):
    return twin.transfer(address, bytes([register]), count, START_NS + round(ms * MS))


def word(twin, asked, ms=20.0):
    return int.from_bytes(twin.exchange(asked.to_bytes(2, "big"), START_NS + round(ms * MS)), "big")


def answer(twin, asked, ms=20.0):
    word(twin, asked, ms)
    got = word(twin, NOTHING, ms)
    assert bin(got).count("1") % 2 == 0
    return got & 0x7FFF


def angle(twin, ms=20.0):
    if isinstance(twin, As5048aTwin):
        return answer(twin, ANGLE, ms)
    high, low = read(twin, 0xFE, 2, ms)
    return high << 6 | low


def test_registers_after_power_up():
    assert read(chip(), 0xFA, 6, 5.0) == bytes(6)
    gain, state, *magnitude, high, low = read(chip(), 0xFA, 6)
    assert (gain, state, magnitude) == (60, 0x01, [73, 28])
    assert low < 64
    assert (high << 6 | low) == pytest.approx(16384 / tau, abs=15)


def test_words_after_power_up():
    twin = spi()
    assert answer(twin, STATE, 5.0) == 0
    assert (answer(twin, STATE), answer(twin, MAGNITUDE)) == (0x0100 | 60, 4700)
    assert answer(twin, ANGLE) == pytest.approx(16384 / tau, abs=15)
    word(twin, STATE)
    assert word(twin, ANGLE) & 0x3FFF == answer(twin, STATE)  # each answer comes with the next command


@pytest.mark.parametrize("kind", [As5048aTwin, As5048bTwin])
@pytest.mark.parametrize(("turns", "zero"), [(1.0, 0), (1.0, 1000), (-1.0, 0), (4.0, 16000)])
def test_an_angle_in_counts(kind, turns, zero):
    twin = chip(lambda t: t, kind=kind, turns=turns, zero_count=zero)
    for second in (0.1, 0.7, 3.0, 6.1):
        true = (second * turns / tau * 16384 + zero) % 16384
        assert (angle(twin, 1e3 * second) - true + 8192) % 16384 - 8192 == pytest.approx(0.0, abs=15.0)


def test_it_is_late_by_its_propagation_and_half_a_sample_and_noisy():
    twin = chip(lambda t: 2.0 * t)
    times_ms = np.arange(20.0, 3000.0, 0.737)
    found = np.unwrap([angle(twin, ms) / 16384 * tau for ms in times_ms])
    late_s = (2e-3 * times_ms - found).mean() / 2.0
    assert late_s == pytest.approx(100e-6 + 0.5 / 11_250.0, abs=30e-6)
    assert (found - 2e-3 * times_ms).std() == pytest.approx(radians(0.06), rel=0.1)


@pytest.mark.parametrize(("value", "state", "gain"), [(-0.6, 0x09, 255), (0.6, 0x05, 0), (1.5, 0x07, 0), (-0.3, 1, 86)])
def test_a_field_that_is_off_shows(value, state, gain):
    faults = [("field", "joint", 1.0, 2.0, value)]
    b, a = chip(faults=faults), spi(faults=faults)
    for ms, expected in ((500.0, (60, 1)), (1500.0, (gain, state)), (2500.0, (60, 1))):
        assert tuple(read(b, 0xFA, 2, ms)) == expected
        assert answer(a, STATE, ms) == expected[1] << 8 | expected[0]


def test_without_a_magnet_its_angle_is_noise_and_it_says_that_it_is_weak():
    twin = chip(faults=[("field", "joint", 0.0, 9.0, -1.0)])
    angles = [angle(twin, ms) for ms in range(20, 120)]
    assert np.std(angles) > 2000
    assert read(twin, 0xFB) == b"\x09"


def test_its_zero_position_is_taken_off_and_lost_without_power():
    for kind, writes in (
        (As5048bTwin, lambda twin: twin.transfer(0x40, b"\x16\x10\x01", 0, START_NS + 20 * MS)),
        (As5048aTwin, lambda twin: [word(twin, one) for one in (0x8016, 0x8010, 0x0017, 0x8001)]),
    ):
        twin = chip(kind=kind, faults=[("off", "joint", 1.0, 1.1)])
        before = angle(twin)
        writes(twin)
        assert before - angle(twin, 30.0) == pytest.approx(0x10 << 6 | 1, abs=20)
        assert angle(twin, 1200.0) == pytest.approx(before, abs=20)


@pytest.mark.parametrize(
    ("sent", "errors"), [(b"\x7f\xff", 4), (b"\x40\x02\x00\x00", 1), (b"\x40\x02", 2), (b"\x00\x05", 2)]
)
def test_a_frame_that_is_none_raises_its_error_flag_until_it_is_read(sent, errors):
    twin = spi()
    twin.exchange(sent, START_NS + 20 * MS)
    assert word(twin, ANGLE) & 0x4000
    assert answer(twin, ERRORS) == errors
    assert not answer(twin, ANGLE) & 0x4000


def test_their_other_faults():
    b = chip(
        lambda t: t, faults=[("stuck", "joint", 1.0, 2.0), ("nack", "joint", 3.0, 4.0), ("off", "joint", 5.0, 6.0)]
    )
    angle(b, 999.0)
    assert abs(angle(b, 1100.0) - angle(b, 1900.0)) < 30
    for ms in (3500.0, 5500.0):
        with pytest.raises(OSError, match=r"\w+") as raised:
            read(b, 0xFA, 1, ms)
        assert raised.value.errno == errno.EREMOTEIO
    a = spi(faults=[("silent", "joint", 1.0, 2.0), ("off", "joint", 3.0, 4.0), ("garbage", "joint", 5.0, 6.0)])
    assert [word(a, ANGLE, ms) for ms in (1500.0, 3500.0)] == [0, 0]
    assert len({word(a, ANGLE, 5000.0 + ms) for ms in range(100)}) > 90
    with pytest.raises(FaultError, match="cannot have the fault nack"):
        spi(faults=[("nack", "joint", 0.0, 1.0)])


def test_it_is_read_register_by_register_with_smbus2_as_public_drivers_do():
    """Bytes FEh and FFh for the angle, FBh for the flags: github.com/neurobionics/opensourceleg, sensors/encoder."""
    clock = iter(range(START_NS + 20 * MS, START_NS + 10_000 * MS, MS // 2))
    installed = install_i2c("/dev/i2c-1", [chip(address=0x41)], lambda: next(clock))
    with SMBus(1) as bus:
        high, low = bus.read_byte_data(0x41, 0xFE), bus.read_byte_data(0x41, 0xFF)
        assert high == pytest.approx(16384 / tau / 64, abs=1)
        assert low < 64
        assert bus.read_i2c_block_data(0x41, 0xFA, 2) == [60, 1]
    installed.uninstall()
