"""Motion of a prescribed base: at rest, then growing; each column the derivative of the one before."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil_sim.plants.motions.carrier import Sway
from hil_sim.scenario.vehicle_tables import BaseSway

TIME_s = np.arange(0.0, 12.0, 0.002)


@pytest.mark.parametrize("still_s", [0.0, 4.0])
def test_pose_rate_and_acceleration_belong_together(rng, still_s):
    path = Sway(BaseSway(still_s=still_s), rng).take(TIME_s)
    np.testing.assert_allclose(np.gradient(path.velocity, TIME_s, axis=0)[5:-5], path.acceleration[5:-5], atol=2e-5)
    np.testing.assert_allclose(np.gradient(path.pose[:, :3], TIME_s, axis=0)[5:-5], path.velocity[5:-5, :3], atol=2e-5)
    attitude = Rotation.from_quat(np.roll(path.pose[:, 3:], -1, axis=1))
    turned = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / 0.002
    np.testing.assert_allclose(turned, 0.5 * (path.velocity[1:, 3:] + path.velocity[:-1, 3:]), atol=1e-9)


def test_a_base_that_coasts_at_first_grows_into_the_same_motion(rng):
    table = BaseSway(still_s=4.0, ramp_s=2.0, rate_rad_s=0.05, acceleration_m_s2=0.1)
    path = Sway(table, rng).take(TIME_s)
    resting, after = TIME_s <= 4.0, TIME_s > 6.0
    assert not path.acceleration[resting].any()
    assert not path.velocity[resting].any()
    assert 0.02 < np.std(path.velocity[after, 3:]) < 0.1
    assert 0.04 < np.std(path.acceleration[after, :3]) < 0.2
