"""Bifilar pendulum: truth by integration at tight tolerance, and by MuJoCo with two strings."""

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from onboard.estimation.calibration.bifilar import Suspension, inertia_tensor, swing
from onboard.estimation.errors import CalibrationError

HANGING = Suspension(23.1, 0.40, 1.80, mass_sigma_kg=0.005, spacing_sigma_m=2e-4, length_sigma_m=5e-4)


def recorded(rng, inertia, amplitude_rad, suspension=HANGING, seconds=35.0, noise=5e-4, drag=(0.002, 0.01), hz=25.0):
    """A gyro on the body: T = I w^2 / 2 + m z'^2 / 2, V = m g z with z(th) exact, drag as (4.3)."""
    m, D, h, g = suspension.mass_kg, suspension.spacing_m, suspension.length_m, suspension.gravity_m_s2

    def slope(_, state):
        th, w = state
        root = np.sqrt(h * h - 0.5 * D * D * (1.0 - np.cos(th)))
        dz = 0.25 * D * D * np.sin(th) / root  # z = h - root
        ddz = 0.25 * D * D * np.cos(th) / root + (0.25 * D * D * np.sin(th)) ** 2 / root**3
        force = -m * g * dz - m * dz * ddz * w * w - (drag[0] + drag[1] * abs(w)) * w
        return w, force / (inertia + m * dz * dz)

    t = np.arange(0.0, seconds, 1.0 / hz)
    solved = solve_ivp(slope, (0.0, seconds), (amplitude_rad, 0.0), "DOP853", t, rtol=1e-10, atol=1e-11)
    return t, solved.y[1] + 0.003 + noise * rng.standard_normal(len(t))


def test_inertia_within_half_a_percent_and_covered(rng):
    inside = 0
    for _ in range(10):
        truth = rng.uniform(0.3, 1.5)
        drawn = Suspension(
            HANGING.mass_kg + 0.005 * rng.standard_normal(),
            HANGING.spacing_m + 2e-4 * rng.standard_normal(),
            HANGING.length_m + 5e-4 * rng.standard_normal(),
        )
        t, w = recorded(rng, truth, np.deg2rad(rng.uniform(10, 35)), drawn)
        found = swing(t, w, HANGING)
        assert abs(found.inertia_kg_m2 / truth - 1.0) < 5e-3
        inside += abs(found.inertia_kg_m2 - truth) < 1.96 * found.sigma_kg_m2
        assert found.parts["string spacing"] == pytest.approx(1e-3)
    assert inside >= 8


def test_large_angles_need_the_non_linear_fit(rng):
    t, w = recorded(rng, 0.8, np.deg2rad(60.0), noise=1e-4, drag=(0.0, 0.0))
    found = swing(t, w, HANGING)
    assert found.inertia_kg_m2 == pytest.approx(0.8, rel=2e-3)
    assert abs(found.linear_kg_m2 / 0.8 - 1.0) > 0.03  # (4.5) takes the angle for small
    assert found.amplitude_rad == pytest.approx(np.deg2rad(60.0), rel=1e-2)


def test_the_swing_of_mujocos_two_strings():
    """A box on two tendons of fixed length: another program's idea of the same pendulum."""
    D, h, m, inertia = 0.40, 1.80, 23.1, 0.8
    model = mujoco.MjModel.from_xml_string(f'''<mujoco>
      <option timestep="0.0005" integrator="implicitfast" tolerance="1e-12"/>
      <worldbody>
        <site name="a" pos="{D / 2} 0 {h}"/><site name="b" pos="{-D / 2} 0 {h}"/>
        <body><freejoint/><inertial pos="0 0 -0.1" mass="{m}" diaginertia="0.7 0.7 {inertia}"/>
          <site name="c" pos="{D / 2} 0 0"/><site name="d" pos="{-D / 2} 0 0"/></body>
      </worldbody>
      <tendon>
        <spatial name="one"><site site="a"/><site site="c"/></spatial>
        <spatial name="two"><site site="b"/><site site="d"/></spatial>
      </tendon>
      <equality>
        <tendon tendon1="one" solref="0.002 1" solimp="0.999 0.9999 1e-5"/>
        <tendon tendon1="two" solref="0.002 1" solimp="0.999 0.9999 1e-5"/>
      </equality></mujoco>''')
    data = mujoco.MjData(model)
    angle = np.deg2rad(25.0)
    data.qpos[3:7] = [np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]
    data.qpos[2] = h - np.sqrt(h * h - 0.5 * D * D * (1.0 - np.cos(angle)))
    rate = []
    for step in range(60_000):
        mujoco.mj_step(model, data)
        if step % 40 == 0:
            rate.append(data.qvel[5])
    found = swing(0.02 * np.arange(len(rate)), np.array(rate), Suspension(m, D, h, gravity_m_s2=9.81))
    assert found.inertia_kg_m2 == pytest.approx(inertia, rel=3e-3)


def test_a_gyro_scale_that_may_be_wrong_widens_the_interval(rng):
    t, w = recorded(rng, 0.8, np.deg2rad(50.0))
    plain, doubtful = swing(t, w, HANGING), swing(t, w, HANGING, gyro_scale_sigma=0.03)
    assert doubtful.parts["swings and gyro scale"] > plain.parts["swings and gyro scale"]
    off = swing(t, 1.02 * w, HANGING, gyro_scale_sigma=0.03)  # the period's dependence on the angle tells the scale
    assert off.inertia_kg_m2 == pytest.approx(0.8, rel=3e-3)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda t, w: (t[:70], w[:70]), "swings; record 5"),
        (lambda t, w: (t, np.zeros_like(w)), "no pendulum|does not swing|swings"),
        (lambda t, w: (t, np.where((t > 15) & (t < 19), w + 0.3, w)), "no pendulum's swing"),
        (lambda t, w: (t, np.clip(w, -0.15, 0.15)), "no pendulum's swing"),
        (lambda t, w: (t[::-1], w), "go back"),
        (lambda t, w: (t, np.where(t > 20, np.nan, w)), "finite"),
        (lambda t, w: (t, np.random.default_rng(1).normal(size=len(t))), "no pendulum's swing|swings"),
    ],
)
def test_a_bad_run_is_refused(rng, spoil, message):
    t, w = recorded(rng, 0.8, np.deg2rad(30.0))
    with pytest.raises(CalibrationError, match=message):
        swing(*spoil(t, w), HANGING)


def test_the_tensor_from_six_axes(rng):
    points = rng.normal(size=(20, 3))
    truth = np.sum(points**2) * np.eye(3) - points.T @ points
    axes = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]], float)
    unit = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    values = np.einsum("ka,ab,kb->k", unit, truth, unit)
    tensor, covariance = inertia_tensor(axes, values, np.full(6, 1e-3))
    np.testing.assert_allclose(tensor, truth, atol=1e-12)
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    with pytest.raises(CalibrationError, match="six elements"):
        inertia_tensor(axes[:5], values[:5], np.full(5, 1e-3))
    with pytest.raises(CalibrationError, match="no rigid body's"):
        inertia_tensor(axes, values * [1, 1, 30, 1, 1, 1], np.full(6, 1e-3))
