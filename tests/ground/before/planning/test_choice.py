"""The choice of the next segment: goals, the information of rows beside what is known, and names of what is left."""

import numpy as np
import pytest

from onboard.config.mission import goals_of
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD
from onboard.identification.free_flyer.segment_choice import Asked, after, choose, in_the_end, reduced, shares


def test_goals():
    mass, centre = goals_of("mass 1 %, centre 5 mm")
    assert (mass.half, mass.unit, centre.half, centre.unit) == (0.01, "", 0.005, "m")
    assert centre.names(("m_p", "c_x_p", "c_y_p", "I_xx_p")) == ("c_x_p", "c_y_p")
    for text in ("mass", "mass 1", "mass -1 %", "mass nan %", "mass 1 lb", ""):
        with pytest.raises(ValueError, match="write WHAT NUMBER UNIT"):
            goals_of(text)


def random_information(rng, p):
    P = rng.standard_normal((p, 2 * p))
    return P @ P.T / p


def test_the_choice_is_that_of_whole_covariances(rng):
    p, durations = 30, np.array([2.0, 4.0, 4.0, 1.0])
    P = random_information(rng, p)
    roots = [scale * rng.standard_normal((8, p)) for scale in (1.0, 0.3, 2.0, 9.0)]
    asked = Asked(rng.standard_normal((2, 10)), np.array([0.1, 2.0]))
    whole = [np.linalg.inv(np.linalg.inv(P) + root.T @ root)[PAYLOAD, PAYLOAD] for root in roots]
    for one, root in zip(whole, roots, strict=True):
        np.testing.assert_allclose(after(P, root), one, atol=1e-9)
    gains = [np.log(asked.ratio(P[PAYLOAD, PAYLOAD]) / asked.ratio(one)) for one in whole] / durations
    allowed = np.array([0, 1, 2])  # the best of all is forbidden
    assert int(np.argmax(gains)) == 3
    found = choose(P, roots, durations, asked, allowed)
    assert found.segment == int(np.argmax(gains[:3]))
    assert found.ratio == pytest.approx(asked.ratio(whole[found.segment]))
    others = np.setdiff1d(allowed, [found.segment])
    short = np.where(np.arange(4) == others[0], 1e-3, durations)  # it tells less, in no time
    assert choose(P, roots, short, asked, allowed).segment == others[0]
    end = np.linalg.inv(np.linalg.inv(P) + 100.0 * sum(root.T @ root for root in roots))
    np.testing.assert_allclose(in_the_end(P, roots, np.arange(4)), end, rtol=1e-6, atol=1e-12)


def test_rows_that_say_less_than_is_known_are_left_out(rng):
    whitened, sigma = rng.standard_normal((40, 12)), np.logspace(-3, 2, 12)
    whole = whitened.T @ whitened * np.outer(sigma, sigma)
    root = reduced(whitened, sigma) * sigma
    assert len(root) < 12
    assert np.abs(np.linalg.eigvalsh(whole - root.T @ root)).max() < 0.003
    assert len(reduced(np.diag(np.sqrt([0.0015, 0.003, 1.0])), np.ones(3))) == 2


def test_what_is_left_is_named_by_what_it_comes_from():
    names = [f"x{k}" for k in range(13)] + ["arm_1_inertial_0", "arm_1_inertial_1", "gyro_scale_x", "gyro_scale_y"]
    P = np.eye(17)
    P[3, 13:15] = P[13:15, 3] = 0.6  # the mass is as uncertain as the link
    told = shares(P, Asked(np.eye(10)[:1], np.ones(1)), names)
    assert [name for name, _ in told] == ["tolerances of arm_1", "gyro_scale"]
    assert told[0][1] == pytest.approx(0.72)
