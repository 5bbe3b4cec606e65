"""Bodies put together and taken apart; truth from point masses."""

import numpy as np
import pytest

from onboard.dynamics.model import inertia
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from tests.dynamics.mujoco_twin import random_vehicle, to_mujoco, to_urdf


def of_points(masses, points):
    m = masses.sum()
    c = masses @ points / m
    return inertia.RigidBody(m, c, sum(inertia.parallel_axis(k, r - c) for k, r in zip(masses, points, strict=True)))


def test_taking_a_part_away_leaves_the_rest(rng):
    masses, points = rng.uniform(0.1, 1, 9), rng.normal(size=(9, 3))
    whole, part, rest = of_points(masses, points), of_points(masses[:4], points[:4]), of_points(masses[4:], points[4:])
    found = inertia.take_away(whole, part)
    assert found.mass_kg == pytest.approx(rest.mass_kg)
    np.testing.assert_allclose(found.centre_of_mass_m, rest.centre_of_mass_m, atol=1e-12)
    np.testing.assert_allclose(found.inertia_kg_m2, rest.inertia_kg_m2, atol=1e-12)
    with pytest.raises(SignalError, match="check the masses"):
        inertia.take_away(part, whole)


def test_elements_and_tensor_are_inverse(rng):
    values = rng.normal(size=6)
    np.testing.assert_array_equal(inertia.elements(inertia.symmetric(values)), values)
    np.testing.assert_array_equal(inertia.symmetric(values), inertia.symmetric(values).T)


def test_principal_moments_of_a_turned_cuboid(rng):
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    body = inertia.RigidBody(1.0, np.zeros(3), R @ np.diag([3.0, 1.0, 2.0]) @ R.T)
    np.testing.assert_allclose(inertia.principal_moments(body), [1.0, 2.0, 3.0])


def test_composite_of_a_tree_equals_mujocos(rng):
    import mujoco  # noqa: PLC0415

    links = random_vehicle(rng, ["revolute", "fixed", "revolute", "fixed"], [0, 1, 0, 3])
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(BaseKind.FREE, "base"))
    found = inertia.composite_functional(vehicle) @ vehicle.chi
    model = to_mujoco(links)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    # free joint at the origin: mass, mass x [c x]', inertia about the origin
    assert found[0] == pytest.approx(M[0, 0])
    np.testing.assert_allclose(found[1:4], [M[4, 2] * -1, M[3, 2], M[4, 0]] * np.array([1, 1, 1]), atol=1e-9)
    np.testing.assert_allclose(inertia.symmetric(found[4:]), M[3:6, 3:6], atol=1e-9)
