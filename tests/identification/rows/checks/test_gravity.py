"""An IMU on a base that stands has to read gravity."""

import numpy as np
import pytest

from onboard.identification.rows.checks.gravity import judged_gravity
from onboard.identification.rows.stated_errors.considered import Considered
from tests.identification.rows import test_grasped as bench
from tests.identification.rows.checks.arm_on_bench import identifier, run

G = 9.80665
STATED = (
    Considered("scale", "imu", "accelerometer_scale", 0.003),
    *(Considered(f"bias {axis}", "imu", "accelerometer_bias", 0.03, axis=axis) for axis in range(3)),
)  # sigma of what it reads, in all: 0.044 m/s^2


@pytest.mark.parametrize(
    ("off_m_s2", "against", "doubts"),
    [(0.0, 0, 0), (0.1, 0, 0), (0.16, 0, 1), (-0.16, 0, 1), (0.3, 1, 0), (-0.3, 1, 0)],
)
def test_it_is_doubted_and_refused_by_the_sigma_of_what_it_reads(off_m_s2, against, doubts):
    """Shaken by more than that: the mean counts."""
    shaken = np.random.default_rng(1).standard_normal((400, 3)) * 0.05
    force = np.array([0.0, 0.6, 0.8]) * (G + off_m_s2) + shaken - shaken.mean(axis=0)
    made = judged_gravity(force, G, STATED)
    assert tuple(map(len, made)) == (against, doubts)
    assert all("calibrate it, or state gravity_m_s2" in one for said in made for one in said)


def test_a_calibrated_one_is_judged_by_what_gravity_is_known_to():
    force = np.array([[0.0, 0.0, 1.0055 * G]])
    assert judged_gravity(force, G, STATED) == ((), ())
    assert judged_gravity(force, G, ())[1]


@pytest.mark.parametrize(("gravity_m_s2", "refused"), [(G, True), (0.0, False)])
def test_an_arm_whose_imu_reads_too_much_is_not_answered(gravity_m_s2, refused):
    who, given = identifier(), run()
    who._bank._gravity_m_s2 = gravity_m_s2
    motion = given.motion._replace(specific_force_m_s2=1.1 * given.motion.specific_force_m_s2)
    bench.feed(who, given._replace(motion=motion, measured=1.1 * given.measured))
    assert any("the IMU reads 10.79" in one for one in who.findings().against) is refused
