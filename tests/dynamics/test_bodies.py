"""Bodies in spatial algebra against the links' own columns, of random trees with revolute and prismatic joints."""

import numpy as np
import pytest

from bench.identification.momentum import momentum_columns
from onboard.dynamics.bodies import Bodies
from onboard.dynamics.kinematics import chain_motion, frames_of, link_motions, wrench_columns
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.dynamics.spatial import coad, crf, crm
from tests.dynamics.mujoco_twin import random_vehicle, to_urdf
from tests.native.oracle.bodies import Columns

KINDS = ["revolute", "fixed", "prismatic", "revolute", "fixed", "revolute"]
PARENTS = [0, 1, 2, 0, 4, 3]
TICKS = 4


@pytest.fixture
def flown(rng):
    vehicle = VehicleModel(to_urdf(random_vehicle(rng, KINDS, PARENTS)), VehicleSpec(BaseKind.FREE, "base"))
    motion = rng.normal(size=(3, TICKS, len(vehicle.joints)))
    twist, thrust = rng.normal(size=(2, TICKS, 6))
    bodies = Bodies.of(chain_motion(vehicle, *motion).links, vehicle.chi, twist, thrust)
    return vehicle, link_motions(vehicle, *motion), bodies, twist, thrust


def close(found, truth):
    np.testing.assert_allclose(found, truth, rtol=1e-9, atol=1e-9 * np.abs(truth).max())


def test_products_of_spatial_vectors_are_dual(rng):
    V, U, F = rng.normal(size=(3, TICKS, 6, 1))
    power = F.swapaxes(1, 2) @ crm(V[..., 0]) @ U  # of a wrench that moves with the frame
    np.testing.assert_allclose(power, -(crf(V[..., 0]) @ F).swapaxes(1, 2) @ U)
    np.testing.assert_allclose(coad(F[..., 0]) @ V, crf(V[..., 0]) @ F)
    assert np.abs(power).min() > 0.0


def test_columns_and_sums_are_those_of_the_links(flown):
    vehicle, links, bodies, twist, thrust = flown
    v, w, f, dw = twist[:, :3], twist[:, 3:], thrust[:, :3], thrust[:, 3:]
    which = (len(links) - 1, 0)
    H, W = np.empty((2, TICKS, 6, 20))
    Columns(which).into(H, bodies.X, bodies.V)
    Columns(which).into(W, bodies.X, bodies.V, bodies.A)
    close(H, np.concatenate([momentum_columns(links[k], v, w) for k in which], axis=2))
    close(W, np.concatenate([wrench_columns(links[k], w, f, dw) for k in which], axis=2))
    halves = np.random.default_rng(2).normal(size=(2, 10, 10))
    mixed = np.empty_like(W)
    Columns(which, list(halves)).into(mixed, bodies.X, bodies.V, bodies.A)
    close(mixed, np.concatenate([W[..., :10] @ halves[0], W[..., 10:] @ halves[1]], axis=2))
    groups = np.eye(len(links))[[0, 1]] + np.eye(len(links))[[2, 3]]
    found, own = bodies.sums(groups), vehicle.chi.reshape(-1, 10)
    for group, members in enumerate([(0, 2), (1, 3)]):
        close(found.momentum[:, group], sum(momentum_columns(links[k], v, w) @ own[k] for k in members))
        close(found.wrench[:, group], sum(wrench_columns(links[k], w, f, dw) @ own[k] for k in members))


def test_the_slope_of_the_wrench_is_a_finite_difference(flown):
    vehicle, links, bodies, twist, _ = flown
    frames, still, every = frames_of(links), np.zeros_like(twist), np.ones((1, len(links)))

    def wrench(at):
        return Bodies.of(frames, vehicle.chi, at, still).sums(every).wrench[:, 0]

    for axis in range(3):
        step = np.zeros(6)
        step[3 + axis] = 1e-6
        change = (wrench(twist + step) - wrench(twist - step)) / 2e-6
        np.testing.assert_allclose(bodies.slope[..., axis], change, atol=1e-6 * np.abs(wrench(twist)).max())
