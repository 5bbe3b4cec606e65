"""``heft identify`` of a flight that drag pushes all the time: it turns in the base's axes as the base turns."""

import numpy as np

from bench.honest_flights.flown import flight


def test_drag_is_neither_another_payload_nor_a_wrong_imu():
    """A push that is constant in the base's axes left so much of it that the halves of the motion disagreed."""
    found = flight(35002, {"class": "drag", "identify": True})
    answers = [one for one in found.answers if one.supported]
    assert len(answers) == 10
    assert {one.level for one in answers} == {"good"}
    assert max(abs(one.value - one.truth) / one.sigma for one in answers) < 3.29
    mass = next(one for one in answers if one.quantity == "m_payload")
    assert np.isclose(mass.sigma, 0.004 * mass.truth, rtol=0.1)
