"""A slice of the campaigns ``bench/plans/coverage.toml`` and ``lies.toml``."""

import numpy as np
import pytest
from scipy.special import chdtri

from bench.identification.coverage import BOXES, Lies, flight, flown
from onboard.ground.campaign.results import Outcome

FAR = 3.291  # half a 99.9 % interval, sigmas


def test_flights_of_an_arm_off_its_drawing_are_covered_together() -> None:
    found = [flown(BOXES[name], Lies(), seed) for name, seed in (("0.5 kg", 401), ("30 kg", 403))]
    one_in_ten_thousand = 1e-4
    nees = sum(one.nees for one in found)
    assert chdtri(20.0, 1.0 - one_in_ten_thousand) < nees < chdtri(20.0, one_in_ten_thousand)
    for one in found:
        assert np.isfinite(one.z).all()
        assert np.abs(one.z).max() < FAR
        assert one.changes == 0
        assert not one.refused


def test_an_imu_that_warms_up_is_followed() -> None:
    one = flown(BOXES["5 kg"], Lies(warming_K=15.0), 404)
    assert one.changes == 0
    assert not one.refused
    assert np.abs(one.z).max() < FAR


@pytest.mark.parametrize(("seed", "off"), [(201, 0.05), (202, -0.05)])
def test_a_joint_of_a_wrong_scale_is_named_and_the_payload_inside(seed, off) -> None:
    """The windows are not explained as stated, and solved with what contradicts them most."""
    mass, *others = flight(seed, {"payload": "5 kg", "joint_scale": off}).answers
    assert mass.low < mass.truth < mass.high
    assert mass.high - mass.low < 0.05 * mass.truth
    assert {one.outcome() for one in (mass, *others)} == {Outcome.WEAK}
    assert "not as stated: scale_joint_2" in mass.why
