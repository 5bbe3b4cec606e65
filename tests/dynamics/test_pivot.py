"""A body on a pivot against MuJoCo's, and against what is conserved."""

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants.vehicle_plant import VehiclePlant
from onboard import config
from onboard.dynamics.model.inertia import RigidBody, composite_functional, symmetric
from onboard.dynamics.model.payload import body_of, standard_of
from onboard.dynamics.pivot import PivotBody, predict_pivot, specific_force
from onboard.flight.estimate.problem.model import build_model

G_m_s2, STEP_s = 9.80665, 0.02


def test_wheels_and_gravity_move_it_as_they_move_mujocos(rng: np.random.Generator) -> None:
    """Five seconds of the packaged bed, without what drags it: rate to 20 urad/s, specific force to 0.1 mm/s^2."""
    still, sweep = (one.model_dump(exclude_unset=True) for one in scenario_of("spherical_bearing").sequence[:2])
    sweep |= {"duration_s": 3.0 / 7.0 * sweep["duration_s"], "strokes": 3}  # of seven, at the packaged pace
    sequence = [still, sweep, {"phase": 2, "action": "hold", "duration_s": 0.5}]
    no_drag = {"viscous_N_m_s": 0.0, "turning_N_m": 0.0}
    scenario = scenario_of("spherical_bearing", {"bearing": no_drag, "sequence": sequence})
    plant = VehiclePlant(scenario, rng)
    plant.advance(10.0)
    model = build_model(config.load(config.packaged("spherical_bearing")))
    whole, functional = np.zeros(10), composite_functional(model)
    for k, link in enumerate(model.links):
        if link in plant.bodies:
            own = plant.bodies[link]
            drawn = standard_of(RigidBody(own.mass_kg, own.centre_of_mass_m, own.inertia_kg_m2))
            body = body_of(functional[:, 10 * k : 10 * k + 10] @ drawn)
            off_m = plant.off_m.get(link, np.zeros(3))
            whole += standard_of(body._replace(centre_of_mass_m=body.centre_of_mass_m + off_m))
    every, count = round(STEP_s / plant.step_s), round(5.0 / STEP_s)
    rows = slice(every * 200, every * (200 + count), every)
    imu, (R, p_drawn) = plant.inertial("imu_base"), model.pose_in_base("imu_base")
    p = p_drawn + plant.off_m["imu_base"]
    rate, force = imu.rate_rad_s[rows] @ R.T, imu.specific_force_m_s2[rows] @ R.T
    axial = np.array([plant.bodies[f"rotor_{axis}"].inertia_kg_m2[k, k] for k, axis in enumerate("xyz")])
    speeds = np.stack([plant.wheel_rate_rad_s(f"wheel_{axis}") for axis in "xyz"], axis=1)
    stored = axial * speeds[rows]
    change = axial * np.gradient(speeds, plant.step_s, axis=0)[rows]
    spin = np.gradient(imu.rate_rad_s @ R.T, plant.step_s, axis=0)[rows.start]
    up = force[0] - np.cross(spin, p) - np.cross(rate[0], np.cross(rate[0], p))
    none = np.zeros(1)
    body = PivotBody(symmetric(whole[4:])[None, None], whole[1:4, None, None], none, none)
    begin = rate[0, :, None, None], (up / np.linalg.norm(up))[:, None, None]
    found = predict_pivot(body, stored[..., None, None], change[..., None, None], *begin, G_m_s2, STEP_s)
    assert np.abs(rate).max() > 0.2
    np.testing.assert_allclose(found.rate[..., 0, 0], rate, rtol=0.0, atol=2e-5)
    felt = specific_force(found, p[:, None], G_m_s2)
    np.testing.assert_allclose(felt[..., 0, 0], force, rtol=0.0, atol=1e-3)


def test_without_gravity_and_drag_its_momentum_is_kept_in_space(rng: np.random.Generator) -> None:
    """``|J w + h|`` is constant while the wheels exchange it, and so is its part along a direction fixed in space."""
    n = 400
    t = 0.05 * np.arange(n)
    stored = np.stack([0.3 * np.sin(t), 0.2 * np.cos(0.7 * t), 0.1 * t / t[-1]], axis=1)[..., None, None]
    change = np.stack([0.3 * np.cos(t), -0.14 * np.sin(0.7 * t), 0.1 / t[-1] + 0.0 * t], axis=1)[..., None, None]
    A = rng.standard_normal((3, 3))
    J, none = np.diag([0.8, 1.0, 1.2]) + 0.02 * (A + A.T), np.zeros(1)
    body = PivotBody(J[None, None], np.zeros((3, 1, 1)), none, none)
    up = np.array([0.0, 0.6, 0.8])[:, None, None]
    found = predict_pivot(body, stored, change, rng.uniform(-0.3, 0.3, (3, 1, 1)), up, G_m_s2, 0.05)
    L = found.rate[..., 0, 0] @ J + stored[..., 0, 0]
    np.testing.assert_allclose(np.linalg.norm(L, axis=1), np.linalg.norm(L[0]), rtol=1e-6)
    np.testing.assert_allclose((L * found.up[..., 0, 0]).sum(axis=1), L[0] @ found.up[0, :, 0, 0], rtol=1e-5)
    np.testing.assert_allclose(
        np.gradient(found.rate[..., 0, 0], 0.05, axis=0)[1:-1], found.acceleration[1:-1, :, 0, 0], atol=1e-3
    )


@pytest.mark.parametrize(("drag", "jets"), [(0.02, 0.0), (0.0, 0.003)])
def test_drag_slows_it_and_jets_turn_it_about_the_vertical(drag: float, jets: float) -> None:
    """About the vertical: ``w = w0 exp(-b t / J) + t / J`` for one of the two."""
    n, J = 200, 1.1
    none = np.zeros((n, 3, 1, 1))
    body = PivotBody(np.diag([0.8, 0.9, J])[None, None], np.zeros((3, 1, 1)), np.full(1, drag), np.full(1, jets))
    start, up = np.array([0.0, 0.0, 0.4])[:, None, None], np.array([0.0, 0.0, 1.0])[:, None, None]
    found = predict_pivot(body, none, none, start, up, G_m_s2, 0.05)
    t = 0.05 * np.arange(n)
    np.testing.assert_allclose(found.rate[:, 2, 0, 0], 0.4 * np.exp(-drag * t / J) + jets * t / J, rtol=1e-9)
