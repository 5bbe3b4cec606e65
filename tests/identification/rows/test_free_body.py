"""The whole vehicle as a rigid body, its carrier taken away, its rotor calibrated; what is read off the estimator."""

from typing import NamedTuple

import numpy as np
import pytest

from onboard.config import packaged
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import RigidBody, elements, parallel_axis, principal_moments, symmetric
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.estimation.recursive.consistency import Interval
from onboard.identification.rows import free_body
from onboard.identification.rows.identifier import Identifier
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.prior import prior_root
from onboard.regressor.rows import RowModel, base_force_rows, base_moment_rows

URDF = packaged("tudelft").with_name("tudelft.urdf").read_text()
I_C = np.array([[1.5e-3, 4e-5, -3e-5], [4e-5, 2.5e-4, 2e-5], [-3e-5, 2e-5, 1.6e-3]])
C = np.array([0.011, 0.002, 0.039])
HELD = {"body": 3.0, "wheel": 1e-6}


def model_of(urdf=URDF):
    vehicle = VehicleModel(urdf, VehicleSpec(BaseKind.FREE, "body"))
    model = RowModel(vehicle, (*base_force_rows(vehicle), *base_moment_rows(vehicle)))
    return model, base_parameters(model, np.random.default_rng(0))


def quantities_of(urdf=URDF, held=5e-7):
    model, base = model_of(urdf)
    return model, base, free_body.free_body_quantities(model, base, prior_root(model, HELD, {"M_body": held}))


class Gaussian(NamedTuple):
    """Stands for an JackknifeEstimate of nine parameters that are the nine quantities."""

    covariance: np.ndarray

    def combination(self, weights):
        sigma = np.sqrt(np.einsum("ij,jk,ik->i", weights, self.covariance, weights))
        mean = np.zeros_like(sigma)
        return Interval(
            mean,
            sigma,
            np.full_like(sigma, np.inf),
            mean - 1.959964 * sigma,
            mean + 1.959964 * sigma,
            np.ones_like(sigma),
        )


def test_the_quantities_of_the_urdf_are_the_urdf():
    model, base, quantities = quantities_of()
    assert tuple(quantity.name for quantity in quantities) == free_body.FREE_BODY
    assert [quantity.unit for quantity in quantities] == ["m"] * 3 + ["kg m^2"] * 6
    chi = model.chi.copy()
    chi[1:4] = 0.52 * C  # first moment of the whole, with the wheel's 0.02 kg at the origin
    chi[4:10] = elements(I_C)
    found = np.array([quantity.weights @ base.value(chi) for quantity in quantities])
    np.testing.assert_allclose(found[:3], C, atol=1e-12)
    wheel = np.diag([8.4349e-7, 8.4349e-7, 1.68698e-6])
    np.testing.assert_allclose(symmetric(found[3:]), I_C + wheel, atol=1e-12)


@pytest.mark.parametrize("held", [0.05, 8e-5])  # kg, of 0.52
def test_a_mass_that_nothing_holds_is_refused_with_the_remedy(held):
    with pytest.raises(SignalError, match="give M_body an absolute sigma"):
        quantities_of(held=held)


def test_a_joint_that_moves_the_centre_of_mass_is_refused():
    old = '<origin xyz="0 0 0" rpy="0 0 0"/>\n      <mass value="0.02"/>'
    assert old in URDF
    with pytest.raises(SignalError, match="balanced rotors only"):
        quantities_of(URDF.replace(old, '<origin xyz="0.01 0 0"/>\n      <mass value="0.02"/>'))


def test_an_identifier_that_cannot_tell_says_why():
    model, base, quantities = quantities_of()
    sigma = prior_root(model, HELD, {"M_body": 5e-7})
    with pytest.raises(SignalError, match="no free-body quantities"):
        free_body.whole_body(Identifier(model, base, sigma, 0.1), 0.5)
    with pytest.raises(SignalError, match="no row could be used"):
        free_body.whole_body(Identifier(model, base, sigma, 0.1, quantities), 0.5)


def test_what_is_left_without_the_carrier_and_its_intervals(rng):
    """Against drawing whole, carrier and rotor scale from their distributions."""
    covariance = np.diag([1e-10] * 3 + [1e-12] * 6)
    whole = free_body.Whole(RigidBody(0.5, C, I_C), np.eye(9), Gaussian(covariance))
    carrier_sigma = np.array([1e-5] * 3 + [3e-7] * 6)
    carrier = free_body.KnownBody(RigidBody(0.1, C - 0.02, np.diag([8e-5, 3e-5, 9e-5])), carrier_sigma)
    load, found = free_body.without_carrier(whole, carrier, rotor_sigma=0.004)
    assert load.mass_kg == pytest.approx(0.4)
    np.testing.assert_allclose(found.moments, principal_moments(load))
    np.testing.assert_allclose(0.5 * (found.low + found.high), found.moments)
    np.testing.assert_allclose(found.high - found.moments, 1.959964 * found.sigma, rtol=1e-4)
    exact = free_body.Whole(whole.body, np.eye(9), Gaussian(np.zeros((9, 9))))
    draws = []
    for _ in range(800):
        scale = 1.0 + 0.004 * rng.normal()

        def draw(body, sigma, scale=scale):
            x = sigma * rng.normal(size=9)
            return RigidBody(
                body.mass_kg, body.centre_of_mass_m + x[:3], scale * (body.inertia_kg_m2 + symmetric(x[3:]))
            )

        part = carrier._replace(body=draw(carrier.body, carrier_sigma))
        total = exact._replace(body=draw(whole.body, np.sqrt(np.diag(covariance))))
        draws.append(free_body.without_carrier(total, part)[1].moments)
    np.testing.assert_allclose(np.std(draws, axis=0), found.sigma, rtol=0.1)
    np.testing.assert_allclose(found.moments, np.mean(draws, axis=0), rtol=0.01)


def test_without_a_carrier_the_whole_is_the_load():
    whole = free_body.Whole(RigidBody(0.5, C, I_C), np.eye(9), Gaussian(np.zeros((9, 9))))
    load, found = free_body.without_carrier(whole, None, rotor_sigma=0.01)
    assert load is whole.body
    np.testing.assert_allclose(found.sigma, 0.01 * found.moments, rtol=1e-6)


@pytest.mark.parametrize("factor", [0.95, 1.0, 1.05])
def test_a_wrong_wheel_is_found_by_calibration(factor):
    """Every inertia comes out by the same factor too small, and a known body says so."""
    device = RigidBody(0.1, np.array([0.011, 0.0016, 0.009]), np.diag([7.5e-5, 2.5e-5, 9e-5]))
    known = RigidBody(0.346, np.array([0.012, 0.0, 0.05]), np.diag([1.676e-4, 1.3e-4, 2.45e-4]))
    c = (0.1 * device.centre_of_mass_m + 0.346 * known.centre_of_mass_m) / 0.446
    inertia = sum(
        part.inertia_kg_m2 + parallel_axis(part.mass_kg, part.centre_of_mass_m - c) for part in (device, known)
    )
    seen = [body._replace(inertia_kg_m2=body.inertia_kg_m2 / factor) for body in (device, RigidBody(0.446, c, inertia))]
    found = free_body.calibrate_rotor(*seen, known._replace(centre_of_mass_m=np.zeros(3)))
    assert found.factor == pytest.approx(factor)
    assert found.misfit < 1e-9
    wrong = known._replace(centre_of_mass_m=np.zeros(3), inertia_kg_m2=1.03 * known.inertia_kg_m2[::-1, ::-1])
    assert free_body.calibrate_rotor(*seen, wrong).sigma > 0.01
