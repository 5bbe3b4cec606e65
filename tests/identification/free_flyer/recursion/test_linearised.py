"""Steps linearised about what the last window found: what no motion shows stays unknown as the estimate moves."""

import numpy as np
import pytest

from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import body_of, standard_of
from onboard.identification.free_flyer.prediction.further import DisturbancePrior
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE
from onboard.identification.free_flyer.prediction.parameters import GeometryPrior, JointPrior
from onboard.identification.free_flyer.recursion import linearised as module
from onboard.identification.free_flyer.recursion.linearised import Linearised
from tests.identification.free_flyer.recorded_flights import PRIOR, online, ticks_of

LINKS = ["base", *(f"link_{k}" for k in range(1, 6))]
LAST = GeometryPrior(joints={"joint_5": JointPrior(place_m=5e-4)})
FEW = 0.02  # of a sigma of a tick
NOTHING = 2e-3  # sigmas of a tick for all masses twice as large: what a step of the integration leaves


@pytest.fixture
def predictor(held):
    return online(held, imu_prior=PRIOR, links=LINKS, geometry=LAST).predictor


def some_state(predictor):
    x = np.zeros(len(predictor.names))
    x[RATE] = [0.05, -0.02, 0.03]
    x[PAYLOAD] = [5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    return x


def all_heavier(predictor, x):
    """The direction in which all masses and inertias grow by one factor, (p,): nothing in a free flight shows it."""
    along, eye = np.zeros(len(x)), 1e-4 * np.eye(len(x))
    links = [k for k, name in enumerate(predictor.names) if "_inertial_" in name]
    own = [k for k, link in enumerate(predictor.vehicle.links) if link != "payload"]
    rows = (10 * np.repeat(own, 10) + np.tile(np.arange(10), len(own))).astype(np.intp)
    basis = np.column_stack([(predictor.chi(x + eye[k]) - predictor.chi(x - eye[k])) / 2e-4 for k in links])[rows]
    along[PAYLOAD], along[links] = x[PAYLOAD], np.linalg.solve(basis, predictor.chi(x)[rows])
    return along


def farther_out(predictor, x):
    """The direction in which the last joint is placed farther along its axis, what hangs on it where it was, (p,)."""

    def of(chi):
        mass_kg, centre_m, inertia = body_of(chi)
        up, down = (standard_of(RigidBody(mass_kg, centre_m - [0.0, 0.0, by], inertia)) for by in (1e-4, -1e-4))
        return (up - down) / 2e-4

    along = np.zeros(len(x))
    along[predictor.names.index("place_z_joint_5")] = 1.0
    first = 10 * predictor.vehicle.links.index("link_5")
    own = [k for k, name in enumerate(predictor.names) if name.startswith("link_5_inertial_")]
    half = predictor.drawn["link_5"][1]
    along[PAYLOAD], along[own] = of(x[PAYLOAD]), np.linalg.solve(half, of(predictor.chi(x)[first : first + 10]))
    return along


def moved(predictor, x, rng, by):
    there = x.copy()
    there[PAYLOAD] *= 1.0 + by * rng.normal(size=10)
    others = np.setdiff1d(np.arange(PAYLOAD.stop, len(x)), predictor.changing)
    there[others] += by * predictor.sigma[others] * rng.normal(size=len(others))
    there[predictor.changing] += 1e-4 * rng.normal(size=len(predictor.changing))
    return there


def test_what_no_motion_shows_stays_unknown_while_the_estimate_moves(held, predictor, rng):
    linearised, ticks, x = Linearised(predictor), ticks_of(held).part(slice(300, 312)), some_state(predictor)
    about, first, _ = linearised.predict(ticks, x)
    np.testing.assert_array_equal(about, x)
    scale = all_heavier(predictor, x)
    sigma = ticks.sigma[1:-1]
    assert np.abs(first.jacobian @ scale / sigma).max() < NOTHING
    for _ in range(5):
        there = moved(predictor, x, rng, 1e-2)
        about, found, values = linearised.predict(ticks, there)
        assert about[PAYLOAD][0] != there[PAYLOAD][0]
        np.testing.assert_array_equal(about[predictor.changing], there[predictor.changing])
        of_about, by_itself = (
            predictor.predict(ticks.q, ticks.dq, ticks.ddq, one, ticks.cyclic, ticks.thrust) for one in (about, there)
        )
        np.testing.assert_array_equal(values, of_about.values)
        gained, kept = (np.abs(one.jacobian @ scale / sigma).max() for one in (by_itself, found))
        assert kept < NOTHING
        assert gained > 0.1
        assert np.abs((found.values - by_itself.values) / sigma).max() < FEW
        carried, _ = predictor.carried(found, about, there, np.eye(len(x)))
        from_there, _ = predictor.carried(by_itself, there, there, np.eye(len(x)))
        assert np.abs((carried - from_there)[RATE]).max() < FEW * sigma[0, 0]


def test_a_push_that_changes_tells_nothing_of_all_masses(held, rng):
    given = {"imu_prior": PRIOR, "links": LINKS, "geometry": LAST, "disturbance": DisturbancePrior(1.0, 0.2, 60.0)}
    predictor = online(held, **given).predictor
    linearised, ticks, x = Linearised(predictor), ticks_of(held).part(slice(300, 312)), some_state(predictor)
    pushes, sigma = np.ravel(predictor.pushes), ticks.sigma[1:-1]
    linearised.predict(ticks, x)
    for by in (1.0, -1.0):
        there = moved(predictor, x, rng, 1e-3)
        there[pushes] = by * predictor.sigma[pushes]
        about, found, _ = linearised.predict(ticks, there)
        scale = all_heavier(predictor, about)
        by_itself = predictor.predict(ticks.q, ticks.dq, ticks.ddq, there, ticks.cyclic, ticks.thrust)
        assert np.abs(found.jacobian @ scale / sigma).max() < NOTHING
        assert np.abs((found.values - by_itself.values) / sigma).max() < FEW
        np.testing.assert_array_equal(about[PAYLOAD], x[PAYLOAD])


def not_linear(predictor, ticks, x, there):
    """Rms of what linearisation about constants x leaves out of a prediction, in sigmas of a tick."""
    about = x.copy()
    about[predictor.changing] = there[predictor.changing]
    near, own = (predictor.predict(ticks.q, ticks.dq, ticks.ddq, one, ticks.cyclic) for one in (about, there))
    return np.sqrt(np.mean(((own.values - near.values - near.jacobian @ (there - about)) / ticks.sigma[1:-1]) ** 2))


def test_where_a_prediction_is_not_linear_any_more_steps_are_linearised_anew(held, predictor, rng):
    """Not where it has only changed much: beyond 0.1 of a sigma of a tick of what is not linear."""
    ticks, x = ticks_of(held).part(slice(300, 312)), some_state(predictor)
    step = moved(predictor, x, rng, 0.5) - x
    step[predictor.changing] = 0.0
    step *= np.sqrt(0.1 / not_linear(predictor, ticks, x, x + 0.2 * step)) * 0.2
    for by, anew in ((0.85, False), (1.2, True)):
        linearised, there = Linearised(predictor), x + by * step
        linearised.predict(ticks, x)
        about, found, values = linearised.predict(ticks, there)
        np.testing.assert_array_equal(about, there if anew else x)
        by_itself = predictor.predict(ticks.q, ticks.dq, ticks.ddq, there, ticks.cyclic, ticks.thrust)
        np.testing.assert_array_equal(found.values, by_itself.values)
        assert (values == found.values).all() == anew
        near = moved(predictor, there, rng, 1e-3)
        np.testing.assert_array_equal(linearised.predict(ticks, near)[0][PAYLOAD], about[PAYLOAD])
        assert linearised.apart is anew
        linearised.forget()
        assert not linearised.apart
        np.testing.assert_array_equal(linearised.predict(ticks, near)[0], near)


def test_instruments_that_are_not_there_do_not_count(held, predictor, rng):
    linearised, ticks, x = Linearised(predictor), ticks_of(held).part(slice(300, 312)), some_state(predictor)
    linearised.predict(ticks, x)
    there = moved(predictor, x, rng, 0.3)
    ticks.measured[:] = np.nan
    np.testing.assert_array_equal(linearised.predict(ticks, there)[0][PAYLOAD], x[PAYLOAD])


@pytest.mark.parametrize(("direction", "size"), [(all_heavier, 0.1), (farther_out, 0.01)])
def test_what_no_motion_shows_stays_unknown_when_the_payload_is_found_to_be_another(held, predictor, direction, size):
    """Steps go on about a payload and a base that are found to be 20 to 30 % heavier."""
    ticks, x = ticks_of(held).part(slice(300, 312)), some_state(predictor)
    linearised, sigma = Linearised(predictor), np.where(np.isnan(predictor.sigma), 10.0, predictor.sigma)
    _, found, _ = linearised.predict(ticks, x)
    prior = linearised.known(np.diag(sigma**2))
    H = found.jacobian.reshape(-1, len(x)) / ticks.sigma[1:-1].reshape(-1, 1)
    gain = np.linalg.solve(H @ prior @ H.T + np.eye(len(H)), H @ prior)
    told = prior - prior @ H.T @ gain
    there = x + 0.2 * all_heavier(predictor, x) * (np.arange(len(x)) > PAYLOAD.stop)
    there[PAYLOAD] *= 1.3
    linearised.begin_anew()
    assert linearised.apart
    linearised.predict(ticks, there)
    now = linearised.known(told)
    for covariance, state, alike in ((told, x, True), (told, there, False), (now, there, True)):
        g = size * direction(predictor, state) / sigma
        by_data = g @ np.linalg.solve(covariance / np.outer(sigma, sigma), g) - g @ g
        assert abs(by_data) < 0.01 if alike else by_data > 1.0  # rounding: 1e-5 of what the prior tells along g
    np.testing.assert_array_equal(linearised.known(now), now)


def test_what_was_found_to_be_linear_is_not_predicted_twice_until_it_may_not_be(held, predictor, rng, monkeypatch):
    """Of a change of 2 sigmas of which 0.01 is not linear, 0.019 is expected not to be at 2.75 sigmas."""
    ticks, x = ticks_of(held).part(slice(300, 312)), some_state(predictor)
    step = moved(predictor, x, rng, 0.5) - x
    step[predictor.changing] = 0.0
    step *= np.sqrt(0.01 / not_linear(predictor, ticks, x, x + 0.1 * step)) * 0.1
    calls, predict = [], predictor.predict
    monkeypatch.setattr(predictor, "predict", lambda *given: (calls.append(1), predict(*given))[1])
    monkeypatch.setattr(module, "_MOVED", 0.0)
    linearised = Linearised(predictor)
    linearised.predict(ticks, x)
    for by, predictions in ((1.0, 2), (1.0, 1), (1.37, 1), (1.45, 2)):
        calls.clear()
        linearised.predict(ticks, x + by * step)
        assert len(calls) == predictions
