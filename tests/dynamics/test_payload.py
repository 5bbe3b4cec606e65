"""The payload as people say it, its covariance, and bodies that can exist."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from onboard.dynamics.model import payload
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import RigidBody, pseudo_inertia
from onboard.estimation.errors import ConvergenceError


@pytest.fixture
def body(rng):
    points, masses = rng.normal(scale=0.2, size=(9, 3)) + np.array([0.1, -0.2, 0.05]), rng.uniform(0.1, 1.0, 9)
    m = masses.sum()
    c = masses @ points / m
    away = points - c
    squares = np.einsum("k,ki,kj->ij", masses, away, away)
    return RigidBody(m, c, np.trace(squares) * np.eye(3) - squares)


def ten(body):
    return np.r_[body.mass_kg, body.centre_of_mass_m, body.inertia_kg_m2[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]]


def test_standard_parameters_and_body_are_inverse(body):
    np.testing.assert_allclose(ten(payload.body_of(payload.standard_of(body))), ten(body), rtol=1e-12)


def test_jacobian_is_the_finite_difference(body):
    chi = payload.standard_of(body)
    for k, unit in enumerate(np.eye(10)):
        step = 1e-6 * unit
        slope = (ten(payload.body_of(chi + step)) - ten(payload.body_of(chi - step))) / 2e-6
        np.testing.assert_allclose(payload.body_jacobian(chi)[:, k], slope, atol=1e-7)


def test_covariance_of_a_weighed_part_comes_back(body):
    chi = payload.standard_of(body)
    found = payload.body_estimate(chi, payload.standard_covariance(chi, 0.01, 1e-3, 0.02)).covariance
    half_trace = 0.5 * np.trace(body.inertia_kg_m2)
    sigma = np.r_[0.01 * body.mass_kg, [1e-3] * 3, [0.02 * half_trace] * 6]
    np.testing.assert_allclose(found, np.diag(sigma**2), atol=1e-12 * half_trace)


def test_a_body_that_can_exist_stays_as_it_is(body):
    chi = payload.standard_of(body)
    np.testing.assert_allclose(ten(payload.possible_body(chi, np.diag((0.1 * chi) ** 2))), ten(body), rtol=1e-12)


def test_what_cannot_exist_becomes_the_likeliest_that_can(rng):
    """A long rod's thin axis, pushed below zero by noise: what is well known stays, what is not becomes possible."""
    R = Rotation.random(rng=rng).as_matrix()
    impossible = RigidBody(2.0, np.array([0.1, 0.0, 0.2]), R @ np.diag([0.1, 0.1, -0.02]) @ R.T)
    chi = payload.standard_of(impossible)
    covariance = np.diag(np.r_[1e-4, [1e-4] * 3, [2e-2] * 6] ** 2)
    found = payload.possible_body(chi, covariance)
    assert np.linalg.eigvalsh(pseudo_inertia(payload.standard_of(found)))[0] > 0.0
    assert found.mass_kg == pytest.approx(2.0, abs=5e-4)
    np.testing.assert_allclose(found.centre_of_mass_m, impossible.centre_of_mass_m, atol=5e-4)
    away = np.linalg.solve(np.linalg.cholesky(covariance), payload.standard_of(found) - chi)
    assert 1.0 < np.linalg.norm(away) < 3.0


def test_nothing_that_can_exist_is_likelier_by_much(rng):
    """Half the squared distance is at most 0.1 x 4 above the least (a barrier of 0.1, 4 x 4 matrices)."""
    for _ in range(20):
        R = Rotation.random(rng=rng).as_matrix()
        moments = R @ np.diag(rng.normal(size=3) * 10.0 ** rng.uniform(-4, 0)) @ R.T
        chi = payload.standard_of(RigidBody(rng.uniform(0.1, 20.0), rng.normal(scale=0.3, size=3), moments))
        root = 10.0 ** rng.uniform(-3, -1) * rng.normal(size=(10, 10))
        found = payload.standard_of(payload.possible_body(chi, root @ root.T))
        assert np.linalg.eigvalsh(pseudo_inertia(found))[0] > 0.0

        def half(theta, chi=chi, root=root):
            body = pin.LogCholeskyParameters(theta)  # Rucker and Wensing 2022
            away = np.linalg.solve(root, body.toDynamicParameters() - chi)
            return 0.5 * away @ away, away @ np.linalg.solve(root, body.calculateJacobian())

        U = np.linalg.cholesky(pseudo_inertia(found)[::-1, ::-1])[::-1, ::-1]  # upper: P = U U'
        shape = U / U[3, 3]
        start = np.r_[np.log(U[3, 3]), np.log(np.diag(shape)[:3]), shape[[0, 1, 0], [1, 2, 2]], shape[:3, 3]]
        with np.errstate(all="ignore"):
            better = minimize(half, start, jac=True, method="BFGS", options={"maxiter": 300}).fun
        assert half(start)[0] - better < 0.4


@pytest.mark.parametrize("covariance", [np.full((10, 10), np.nan), np.diag([np.inf] * 10)])
def test_a_covariance_that_is_none_has_no_likeliest_body(covariance):
    impossible = np.array([1.0, 0.5, 0.0, 0.0, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1])
    with np.errstate(invalid="ignore"), pytest.raises(ConvergenceError, match="likeliest possible body"):
        payload.possible_body(impossible, covariance)


def test_no_mass_is_no_body():
    with pytest.raises(SignalError, match="no centre of mass"):
        payload.body_of(np.zeros(10))
