"""Free-body identification: made-up throws with a known answer, real throws against weighed and drawn bodies."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from onboard.config import packaged
from onboard.estimation.gates import GateReason
from onboard.model.composite import RigidBody, elements
from onboard.model.errors import SignalError
from onboard.model.free_body import (
    BodyEstimate,
    FreeBodyIdentifier,
    FreeBodySettings,
    Recording,
    calibrate_rotor,
    without_carrier,
)
from onboard.model.vehicle import BaseKind, Vehicle, VehicleSpec

J = 1.68e-6  # the URDF's
DEVICE_KG = 0.10067


def vehicle():
    text = packaged("tudelft").with_name("tudelft.urdf").read_text()
    return Vehicle(text, VehicleSpec(BaseKind.FREE, "body"))


def throw(I_c, c, w0, wheel_inertia=J, noise=None, rng=None):
    """Euler's equations with a wheel spun up at 0.15 s, integrated; IMU at -c from the centre of mass."""
    t = np.arange(0, 0.78, 0.000248)

    def wheel(time):
        x = np.clip((time - 0.15) / 0.3, 0.0, None)
        return 900.0 * (1 - np.exp(-3 * x)), 900.0 * 3 / 0.3 * np.exp(-3 * x) * (x > 0)

    def rate_of(time, w):
        s, ds = wheel(time)
        h = I_c @ w + wheel_inertia * s * np.array([0, 0, -1.0])
        return np.linalg.solve(I_c, -np.cross(w, h) - wheel_inertia * ds * np.array([0, 0, -1.0]))

    w = solve_ivp(rate_of, (0, t[-1]), w0, t_eval=t, rtol=1e-10, atol=1e-10).y.T
    dw = np.array([rate_of(time, one) for time, one in zip(t, w, strict=True)])
    f = -np.cross(dw, c) - np.cross(w, np.cross(w, c))
    s = wheel(t)[0]
    if rng is not None:
        w = w + noise[0] * rng.normal(size=w.shape)
        f = f + noise[1] * rng.normal(size=f.shape)
        s = np.round((s + noise[2] * rng.normal(size=s.shape)) / 1.496) * 1.496
    return Recording(t, w, f, t, s[:, None])


I_C = np.array([[1.5e-3, 4e-5, -3e-5], [4e-5, 2.5e-4, 2e-5], [-3e-5, 2e-5, 1.6e-3]])
C = np.array([0.011, 0.002, 0.039])
SENSORS = {"gyro_noise_rad_s": 1e-9, "accel_noise_m_s2": 1e-9, "joint_rate_noise_rad_s": 1e-9}  # perfect ones
SLOW = {"width_s": 0.06, "minimum_joint_rate_rad_s": 150.0}


def test_a_throw_without_noise_gives_the_body_back():
    settings = FreeBodySettings("body", force_sigma_n=1e-3, moment_sigma_n_m=2e-6, **SENSORS, **SLOW)
    found = FreeBodyIdentifier(vehicle(), settings).identify([throw(I_C, C, [3.0, 5.0, -4.0])], 0.5)
    np.testing.assert_allclose(found.body.centre_of_mass_m, C, atol=2e-6)
    np.testing.assert_allclose(found.body.inertia_kg_m2, I_C, atol=2e-3 * np.abs(I_C).max())
    assert found.body.mass_kg == 0.5
    assert found.refused[GateReason.PHASE] > 0  # before the wheel runs
    sigma = np.sqrt(np.diag(found.covariance))[[3, 5, 8]]  # XX, YY, ZZ: the wheel's calibration and little else
    np.testing.assert_allclose(sigma, settings.rotor_sigma * np.diag(found.body.inertia_kg_m2), rtol=0.3)


def test_throws_with_noise_are_covered(rng):
    settings = FreeBodySettings("body", rotor_sigma=1e-6, moment_sigma_n_m=1e-4, **SLOW)
    who = FreeBodyIdentifier(vehicle(), settings)
    inside = []
    for _ in range(12):
        recording = throw(I_C, C, rng.normal(size=3) * 6, J, (0.02, 1.0, 5.0), rng)
        found = who.identify([recording], 0.5)
        error = np.concatenate([found.body.centre_of_mass_m - C, elements(found.body.inertia_kg_m2 - I_C)])
        inside.append(np.abs(error) < 2.5 * np.sqrt(np.diag(found.covariance)))
    assert np.mean(inside) > 0.85


def test_a_wrong_wheel_is_found_by_calibration(rng):
    """Wheel 5 % off: every inertia comes out 5 % off, and a known body says so."""
    true_wheel = 1.05 * J
    device = np.diag([7.5e-5, 2.5e-5, 9e-5])
    c_device = np.array([0.011, 0.0016, 0.009])
    known = RigidBody(0.346, np.zeros(3), np.diag([1.676e-4, 1.3e-4, 2.45e-4]))
    at = np.array([0.012, 0.0, 0.05])
    c_both = (DEVICE_KG * c_device + known.mass_kg * at) / (DEVICE_KG + known.mass_kg)

    def about(body_inertia, mass, centre):
        r = centre - c_both
        return body_inertia + mass * (r @ r * np.eye(3) - np.outer(r, r))

    both = about(device, DEVICE_KG, c_device) + about(known.inertia_kg_m2, known.mass_kg, at)
    settings = FreeBodySettings("body", **SENSORS, **SLOW)
    who = FreeBodyIdentifier(vehicle(), settings)
    alone = who.identify([throw(device, c_device, w, true_wheel) for w in ([2.0, 1, 3], [0.0, 4, 1])], DEVICE_KG)
    proof = who.identify([throw(both, c_both, w, true_wheel) for w in ([3.0, 5, -4], [5.0, 1, 2])], DEVICE_KG + 0.346)
    factor, misfit = calibrate_rotor(alone, proof, known)
    assert factor == pytest.approx(1.05, rel=0.01)
    assert misfit < 0.02


def test_what_is_left_without_the_carrier(rng):
    """The sigma of principal moments, against drawing from the two covariances."""
    total = BodyEstimate(RigidBody(0.5, C, I_C), np.diag([1e-10] * 3 + [1e-12] * 6), 1, {})
    carrier = BodyEstimate(
        RigidBody(0.1, C - 0.02, np.diag([8e-5, 3e-5, 9e-5])), np.diag([1e-10] * 3 + [1e-13] * 6), 1, {}
    )
    load, found = without_carrier(total, carrier)
    assert load.mass_kg == pytest.approx(0.4)
    draws = []
    for _ in range(1500):

        def draw(one):
            x = np.linalg.cholesky(one.covariance) @ rng.normal(size=9)
            I = one.body.inertia_kg_m2 + np.array([[x[3], x[4], x[6]], [x[4], x[5], x[7]], [x[6], x[7], x[8]]])  # noqa: E741
            return one._replace(body=RigidBody(one.body.mass_kg, one.body.centre_of_mass_m + x[:3], I))

        draws.append(without_carrier(draw(total), draw(carrier))[1].moments)
    np.testing.assert_allclose(np.std(draws, axis=0), found.sigma, rtol=0.1)
    np.testing.assert_allclose(found.moments, np.mean(draws, axis=0), rtol=0.01)


def test_unusable_vehicles_and_recordings_are_named():
    text = packaged("tudelft").with_name("tudelft.urdf").read_text()
    unbalanced = text.replace(
        '<origin xyz="0 0 0" rpy="0 0 0"/>\n      <mass value="0.02"/>',
        '<origin xyz="0.01 0 0"/>\n      <mass value="0.02"/>',
    )
    assert unbalanced != text
    with pytest.raises(SignalError, match="centre of mass"):
        FreeBodyIdentifier(Vehicle(unbalanced, VehicleSpec(BaseKind.FREE, "body")), FreeBodySettings("body"))
    who = FreeBodyIdentifier(vehicle(), FreeBodySettings("body"))
    recording = throw(I_C, C, [3.0, 5.0, -4.0])
    with pytest.raises(SignalError, match="one column a joint"):
        who.signals(recording._replace(joint_rate_rad_s=recording.joint_rate_rad_s[:, 0]))
    with pytest.raises(SignalError, match="no usable rows"):
        who.identify([recording._replace(joint_rate_rad_s=0.0 * recording.joint_rate_rad_s)], 0.5)


# --- real throws: tudelft_tumbling --------------------------------------------------------------------------------

# Masses, and principal moments in kg mm^2, of the objects thrown with the device (the data set's README).
OBJECTS = {"config_a": (0.4589, (190.0, 1525.0, 1577.0)), "config_b": (0.7393, (437.0, 682.0, 906.0))}
PROOF_KG, PROOF_M = 0.346, np.array([0.060, 0.070, 0.0302])


def recordings(folder, group):
    found = []
    for file in sorted((folder / "tudelft_tumbling").glob(f"*__{group}__*.npz")):
        log = np.load(file)
        axes = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])  # x = -raw y, y = +raw x, z = +raw z
        t = (log["time_us"] - log["time_us"][0]) * 1e-6
        found.append(
            Recording(
                t,
                np.radians(log["gyro_raw"] / 16.384) @ axes.T,
                log["acc_raw"] * (9.81 / 2048) @ axes.T,
                t,
                (log["erpm_raw"] * (100 / 7 * 2 * np.pi / 60))[:, None],
            )
        )
    return found


@pytest.fixture(scope="module")
def calibrated(datasets):
    """The identifier, the device alone, and the factor of the wheel, from throws of known bodies only."""
    who = FreeBodyIdentifier(vehicle(), FreeBodySettings("body"))
    alone = who.identify(recordings(datasets, "device_only"), DEVICE_KG)
    proof = who.identify(recordings(datasets, "proof_body"), DEVICE_KG + PROOF_KG)
    x, y, z = PROOF_M
    cuboid = PROOF_KG / 12 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    factor, misfit = calibrate_rotor(alone, proof, RigidBody(PROOF_KG, np.zeros(3), cuboid))
    assert misfit < 0.015
    return who, alone, factor


def scaled(found, factor):
    by = np.array([1.0] * 3 + [factor] * 6)
    body = found.body._replace(inertia_kg_m2=factor * found.body.inertia_kg_m2)
    return found._replace(body=body, covariance=found.covariance * np.outer(by, by))


@pytest.mark.parametrize(
    ("group", "throws", "mean_bar", "worst_bar"), [("config_a", 11, 0.015, 0.04), ("config_b", 12, 0.016, 0.04)]
)
def test_real_throws(datasets, calibrated, group, throws, mean_bar, worst_bar):
    """One throw at a time: eigenvalue-norm error against the object's drawn and weighed inertia."""
    who, alone, factor = calibrated
    mass, truth = OBJECTS[group]
    errors, inside = [], []
    for recording in recordings(datasets, group):
        total = who.identify([recording], DEVICE_KG + mass)
        _, found = without_carrier(scaled(total, factor), scaled(alone, factor))
        errors.append(np.linalg.norm(found.moments * 1e6 - truth) / np.linalg.norm(truth))
        inside.append(np.abs(found.moments * 1e6 - truth) < 3.0 * found.sigma * 1e6)
    assert len(errors) == throws
    assert np.mean(errors) <= mean_bar, errors
    assert np.max(errors) <= worst_bar, errors
    assert np.mean(inside) > 0.9
