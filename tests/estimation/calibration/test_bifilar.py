"""Bifilar pendulum: truth by integration at tight tolerance, and by MuJoCo with two strings."""

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from onboard.estimation.calibration.bifilar import AxisErrors, Suspension, axis_errors, inertia_tensor, swing, swung
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
    for _ in range(6):
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
    assert inside >= 5


def test_the_derivatives_of_a_swing_are_its_differences():
    span, at = np.linspace(0.0, 20.0, 201), np.array([0.8, 0.003, 0.02, 0.6, 0.2])
    found = swung(at, span, HANGING, carried=True)
    np.testing.assert_allclose(found[:, :2], swung(at, span, HANGING), atol=1e-5)
    for number, step in enumerate((1e-5, 1e-5, 1e-4, 1e-5, 1e-5)):
        off = step * np.eye(5)[number]
        wanted = (swung(at + off, span, HANGING) - swung(at - off, span, HANGING)) / (2.0 * step)
        columns = found[:, 2 + 2 * number : 4 + 2 * number]
        np.testing.assert_allclose(columns, wanted, rtol=0.0, atol=1e-4 * np.abs(wanted).max())


def test_the_last_bits_of_the_readings_do_not_move_the_answer(rng):
    """Another processor sums in another order: a fit that ends where it has converged hardly notices."""
    t, w = recorded(rng, 0.8, np.deg2rad(20.0), seconds=60.0, noise=1e-4)
    found = [swing(t, w * (1.0 + 1e-15 * k), HANGING, 0.03) for k in (-2, 0, 2)]
    own = found[0].parts["swings"] * found[0].inertia_kg_m2
    assert np.ptp([one.inertia_kg_m2 for one in found]) < 0.01 * own


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
    assert doubtful.parts["gyro scale"] > plain.parts["gyro scale"] == 0.0
    off = swing(t, 1.02 * w, HANGING, gyro_scale_sigma=0.03)  # the period's dependence on the angle tells the scale
    assert off.inertia_kg_m2 == pytest.approx(0.8, rel=3e-3)


@pytest.fixture(scope="module")
def of_thirty_degrees():
    return recorded(np.random.default_rng(30), 0.8, np.deg2rad(30.0))


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
def test_a_bad_run_is_refused(of_thirty_degrees, spoil, message):
    t, w = (part.copy() for part in of_thirty_degrees)
    with pytest.raises(CalibrationError, match=message):
        swing(*spoil(t, w), HANGING)


def test_the_tensor_from_six_axes(rng):
    points = rng.normal(size=(20, 3))
    truth = np.sum(points**2) * np.eye(3) - points.T @ points
    axes = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]], float)
    unit = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    values = np.einsum("ka,ab,kb->k", unit, truth, unit)
    tensor, covariance = inertia_tensor(axes, values, 1e-6 * np.eye(6))
    np.testing.assert_allclose(tensor, truth, atol=1e-12)
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    with pytest.raises(CalibrationError, match="six elements"):
        inertia_tensor(axes[:5], values[:5], 1e-6 * np.eye(5))
    with pytest.raises(CalibrationError, match="no rigid body's"):
        inertia_tensor(axes, values * [1, 1, 30, 1, 1, 1], 1e-6 * np.eye(6))


@pytest.mark.parametrize(
    "errors",
    [  # the last has all of them
        *(pytest.param(one, marks=pytest.mark.campaign) for one in (AxisErrors(8.7e-3), AxisErrors(0.0, scale=0.01))),
        AxisErrors(2e-3, scale=3e-3, cross_axis=0.01),
    ],
)
def test_what_errors_of_the_gyros_axes_do_to_the_tensor(rng, errors):
    """Covariance against 1000 draws: one gyro in all six hangs, its axes turned in the body."""
    axes = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]], float)
    unit = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    R_BS = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    truth = np.array([[0.72, 0.02, -0.01], [0.02, 0.71, 0.006], [-0.01, 0.006, 0.79]])
    values, own = np.einsum("ka,ab,kb->k", unit, truth, unit), np.full(6, 1e-6)
    by_scale = np.linspace(-0.02, -0.01, 6)
    draws = []
    for _ in range(1000):
        x, y, z = errors.misalignment_rad * rng.standard_normal(3)
        E = np.diag(errors.scale * rng.standard_normal(3)) - np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        E += errors.cross_axis * rng.standard_normal((3, 3)) * (1.0 - np.eye(3))
        shown = unit @ R_BS @ (np.eye(3) + E).T @ R_BS.T
        covariance = axis_errors(shown, values, own, by_scale, errors, np.zeros(6), R_BS)
        told = values + by_scale * np.einsum("ka,ab,kb->k", unit @ R_BS, E, unit @ R_BS)
        tensor, _ = inertia_tensor(shown, told, covariance)
        draws.append((tensor - truth)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    _, said = inertia_tensor(unit, values, axis_errors(unit, values, own, by_scale, errors, np.zeros(6), R_BS))
    of_draws = np.cov(np.array(draws).T)
    np.testing.assert_allclose(said, of_draws, atol=0.1 * of_draws.max())


def test_a_run_that_sways_knows_its_own_axis_less_well():
    axes = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]], float)
    values = np.array([0.7, 0.7, 0.8, 0.7, 0.75, 0.75])
    still, swayed = (
        axis_errors(
            axes, values, np.full(6, 1e-4), np.zeros(6), AxisErrors(0.0), np.array([0, 0, 0, 0, 0, sway]), np.eye(3)
        )
        for sway in (0.0, 0.01)
    )
    np.testing.assert_allclose(still, 1e-8 * np.eye(6), atol=1e-15)
    assert swayed[5, 5] == pytest.approx(1e-8 + (0.01 * 0.1) ** 2)  # I u - v u: half the difference of the moments


def test_what_the_gyros_scale_does_to_the_inertia(rng):
    """A narrow swing does not tell the scale: what the gyro shows too much, the inertia has too little of."""
    t, w = recorded(rng, 0.8, np.deg2rad(25.0), noise=1e-4)
    less, more = (swing(t, f * w, HANGING, gyro_scale_sigma=0.003) for f in (0.995, 1.005))
    assert (more.inertia_kg_m2 - less.inertia_kg_m2) / 0.01 == pytest.approx(more.by_scale_kg_m2, rel=0.1)
    assert abs(more.by_scale_kg_m2) > 0.005
