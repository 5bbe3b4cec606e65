"""What an IMU should read: derivatives are finite differences, joints' noise what their errors make of it.

Noise of the joints in derivatives: what it adds to a gradient.
"""

import numpy as np
import pytest
from scipy import ndimage, signal

from onboard.dynamics.free_flight import predict_base
from onboard.dynamics.kinematics import link_motions
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import UnknownFrameError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.identification.free_flyer.prediction.further import CellPrior, DisturbancePrior, FurtherCell
from onboard.identification.free_flyer.prediction.imu_errors import CERTAIN
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE, ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import LineNoise
from onboard.identification.free_flyer.prediction.noise_in_gradient import NoiseInPieces
from onboard.identification.free_flyer.prediction.parameters import GeometryPrior, JointPrior, SpringPrior
from tests.dynamics.free_flyer_twin import URDF
from tests.identification.free_flyer.recorded_flights import PRIOR, online, ticks_of
from tests.identification.table.bed_run import once_a_turn


@pytest.fixture(scope="module")
def predictor(held):
    cell = FurtherCell("cell", "link_5", (0.6, 0.5, 0.2, 0.3, -0.7, 0.9), 5, CellPrior(0.03, 1e-4, 0.0025, 2e-4))
    known = {"imu_prior": PRIOR, "links": ["link_4", "base"], "geometry": GeometryPrior(3e-3, {}), "further": [cell]}
    return online(held, **known).predictor


@pytest.fixture
def ticks(held):
    some = ticks_of(held).part(slice(300, 702))
    return some._replace(sample_sigma=np.full(some.sample_sigma.shape, 0.02) * [[1.0], [5.0]])


@pytest.fixture
def state(predictor, ticks):
    """Without momentum, as the effect of the joints' noise on a prediction is computed."""
    x = np.zeros(len(predictor.names))
    x[PAYLOAD] = [5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    links = link_motions(predictor.vehicle, ticks.q[:4], ticks.dq[:4], ticks.ddq[:4])
    x[RATE] = predict_base(links, predictor.period_s, predictor.chi(x), np.zeros(3), ()).rate[0]
    return x


SIGMA, USE = np.tile([*[0.05] * 3, *[0.1] * 3, 1.0], (400, 1)), np.ones((400, 7), np.bool_)
OWN = LineNoise.alone(SIGMA)


def test_what_is_added_to_a_gradient_is_half_the_derivative_of_the_variance(predictor, ticks, state):
    def half_of_the_variance(at):
        noise = predictor.joint_noise(ticks.q, ticks.sample_sigma, at)[1:-1] / SIGMA
        return 0.5 * float((noise**2).sum())

    ticks = ticks._replace(sample_sigma=ticks.sample_sigma * [[0.0], [1.0]])  # products of rates are neglected
    added = NoiseInPieces(predictor, ticks, OWN, USE, state).whole().gradient
    bodies = [k for k, name in enumerate(predictor.names) if name.endswith("_payload") or "inertial" in name]
    size = np.where(np.isfinite(predictor.sigma), predictor.sigma, 0.05)[bodies]
    steps = 1e-4 * np.eye(len(state))[bodies]
    slopes = [(half_of_the_variance(state + one) - half_of_the_variance(state - one)) / 2e-4 for one in steps]
    expected = size * slopes
    np.testing.assert_allclose(added[bodies] * size, expected, atol=0.1 * np.abs(expected).max())
    scales = [k for k, name in enumerate(predictor.names) if "scale" in name and "gyro" not in name]
    assert (added[scales] > 0.0).all()  # of noise a scale of zero is the best
    assert not added[[k for k, name in enumerate(predictor.names) if "delay" in name]].any()


def test_what_is_added_to_a_gradient_is_what_noisy_encoders_add(held):
    """Means over noise that is drawn, of an encoder's cyclic error too, which is a function of the angle it reads."""
    geometry = GeometryPrior(0.0, {"joint_2": JointPrior(scale=0.01, cyclic=((1.0, 0.01),))})
    predictor = online(held, imu_prior=PRIOR, links=["base"], geometry=geometry).predictor
    ticks, state = ticks_of(held).part(slice(300, 702)), np.zeros(len(predictor.names))
    state[PAYLOAD] = [5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    n, motion = len(ticks.q), (ticks.q, ticks.dq, ticks.ddq)
    rng, after = np.random.default_rng(5), [1e-3, 1e-3 / 0.01, 1e-3 / 0.01**2]
    kernels = [after[k] * ndimage.gaussian_filter1d(np.eye(1, 81, 40), 6.0, order=k, mode="constant") for k in range(3)]
    there = np.arange(n + 80) > 80  # none at the first tick: of its momentum the rate there is an unknown
    power = [signal.convolve(there, kernel[0] ** 2, "valid") for kernel in kernels[1:]]
    sample_sigma = np.repeat(np.sqrt(np.maximum(power, 0.0)).T[:, :, None], 5, axis=2)
    cyclic = once_a_turn(*(one[:, 1] for one in motion))
    noisy = ticks._replace(cyclic=cyclic, sample_sigma=sample_sigma), LineNoise.alone(SIGMA[:, :6]), USE[:, :6], state
    added = NoiseInPieces(predictor, *noisy).whole().gradient
    true, drawn = predictor.predict(*motion, state, cyclic).values, np.zeros(len(state))
    for _ in range(draws := 60):
        white = there[:, None] * rng.standard_normal((n + 80, 5))
        error = [signal.fftconvolve(white, kernel.T, "valid", axes=0) for kernel in kernels]
        for sign in (1.0, -1.0):  # what is linear in the noise is nothing in the mean
            read = [one + sign * off for one, off in zip(motion, error, strict=True)]
            found = predictor.predict(*read, state, once_a_turn(*(one[:, 1] for one in read)))
            drawn += np.einsum("bm,bmp->p", (found.values - true) / SIGMA[:, :6] ** 2, found.jacobian) / (2.0 * draws)
    at = [k for k, name in enumerate(predictor.names) if name.endswith("_payload") or "joint_2" in name]
    size = np.where(np.isfinite(predictor.sigma), predictor.sigma, 0.05)[at]
    assert [predictor.names[k] for k in at[-3:]] == ["scale_joint_2", "cyclic_0_cos_joint_2", "cyclic_0_sin_joint_2"]
    one, other = size * added[at], size * drawn[at]
    for some in (slice(10), slice(10, None)):
        np.testing.assert_allclose(one[some], other[some], atol=0.15 * np.abs(other[some]).max())


def test_noise_of_less_than_a_thousandth_of_every_line_is_left_out(predictor, ticks, state):
    share = ((predictor.joint_noise(ticks.q, ticks.sample_sigma, state)[1:-1] / SIGMA) ** 2).max()
    for part, counts in ((0.9e-3, False), (1.5e-3, True)):
        quiet = ticks._replace(sample_sigma=ticks.sample_sigma * np.sqrt(part / share))
        added = NoiseInPieces(predictor, quiet, OWN, USE, state).whole()
        assert added.gradient.any() == added.information.any() == counts


def test_derivatives_of_the_prediction_are_finite_differences(held):
    one, other = JointPrior(1e-3, 1e-3, 1e-3, 1e-3), JointPrior(zero=1e-3, cyclic=((50.0, 1e-4), (100.0, 1e-4)))
    some = GeometryPrior(3e-3, {"joint_2": one, "joint_5": other})
    recursive = online(held, imu_prior=PRIOR, links=["link_4", "base"], geometry=some)
    assert len(recursive.predictor.names) == 3 + 10 + 25 + 20 + 3 + 6 + 1 + 4
    check_derivatives(recursive.predictor, held, np.zeros(0))


def test_derivatives_of_a_flexible_arm_are_finite_differences(held, monkeypatch):
    monkeypatch.setattr("onboard.dynamics.compliance._SETTLED_rad_s2", 1e-11)
    one = JointPrior(1e-3, 1e-3, 1e-3, 1e-3, spring=SpringPrior(20.0, 0.1, 0.05, 0.5))
    other = JointPrior(zero=1e-3, cyclic=((50.0, 1e-4), (100.0, 1e-4)), spring=SpringPrior(0.7, 0.1, None, 0.5))
    some = GeometryPrior(3e-3, {"joint_2": one, "joint_5": other})
    recursive = online(held, imu_prior=PRIOR, links=["link_4", "base"], geometry=some)
    assert len(recursive.predictor.names) == 3 + 10 + 25 + 20 + 3 + 6 + 1 + 4 + 4 + 4
    check_derivatives(recursive.predictor, held, np.array([0.01, 0.02, -0.05, 0.1]))


def test_derivatives_by_a_disturbance_are_finite_differences(held):
    plain = online(held, imu_prior=PRIOR, links=["base"]).predictor
    given = 0.01, 5, {"base": plain.drawn["base"][1] @ plain.drawn["base"][1].T}, PRIOR
    predictor = ImuPredictor(plain.vehicle, "imu_base", *given, disturbance=DisturbancePrior(0.01, 0.002, 60.0))
    each = [f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz"]
    assert predictor.names[-12:] == tuple(f"disturbance_{what}{one}" for what in ("", "drift_") for one in each)
    np.testing.assert_allclose(predictor.sigma[-6:], 0.1 * predictor.sigma[-12:-6])  # rad/s that a base turns by
    check_derivatives(predictor, held, np.zeros(0))


def test_a_disturbance_pushes_the_base_and_wanders(held):
    """A force of 1 N accelerates all by what it weighs; a torque turns the base; both change as they drift."""
    given = online(held).predictor.vehicle, "imu_base", 0.01, 5, {}, CERTAIN
    predictor, ticks = ImuPredictor(*given, disturbance=DisturbancePrior(1.0, 1.0, 60.0)), ticks_of(held)
    x, motion = np.zeros(len(predictor.names)), (ticks.q[:12], ticks.dq[:12], ticks.ddq[:12])
    still = predictor.predict(motion[0][:1].repeat(12, axis=0), *np.zeros((2, *motion[0].shape)), x).values
    x[-12] = 1.0
    pushed = predictor.predict(motion[0][:1].repeat(12, axis=0), *np.zeros((2, *motion[0].shape)), x).values
    mass_kg = predictor.chi(x).reshape(-1, 10)[:, 0].sum()
    at_centre = np.linalg.norm((pushed - still)[:, 3:], axis=1)
    assert at_centre.min() > 0.5 / mass_kg
    x[-12], x[-7] = 0.0, 1.0
    turned = predictor.predict(motion[0][:1].repeat(12, axis=0), *np.zeros((2, *motion[0].shape)), x).values
    assert (np.diff(np.linalg.norm(turned[:, :3], axis=1)) > 0.0).all()
    aged = predictor.aged(np.zeros((len(x), len(x))), 3000)  # half a minute
    np.testing.assert_allclose(np.diag(aged)[-12:-6], 1.0)
    x[-7], x[-12], x[-6] = 0.0, -0.5, 10.0  # N, N/s: none after 50 ms
    predicted = predictor.predict(motion[0][:1].repeat(12, axis=0), *np.zeros((2, *motion[0].shape)), x)
    assert predicted.state[-12] == pytest.approx(0.5)  # ten ticks later
    np.testing.assert_allclose((predicted.values - still)[4, 3:], 0.0, atol=0.02 / mass_kg)


def check_derivatives(predictor, held, bends):
    ticks = ticks_of(held).part(slice(300, 324))
    motion, waves = (ticks.q, ticks.dq, ticks.ddq), np.random.default_rng(2).normal(size=(24, 3, 4))
    p = len(predictor.names)
    x = np.nan_to_num(predictor.sigma) * np.random.default_rng(1).normal(size=p) * 0.1
    x[:13] = [0.1, -0.2, 0.3, 5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    x[predictor.bends] = bends
    found = predictor.predict(*motion, x, waves)
    transition = np.eye(p)
    transition[predictor.changing] = found.transition
    for k in range(p):
        size = 1e-4 if k < 13 else 1e-3 * predictor.sigma[k] if k in predictor.bends else 1e-2 * predictor.sigma[k]
        step = size * np.eye(p)[k]
        up, down = predictor.predict(*motion, x + step, waves), predictor.predict(*motion, x - step, waves)
        slope = (up.values - down.values) / (2.0 * size)
        assert np.abs(found.jacobian[:, :, k] - slope).max() <= 2e-3 * np.abs(slope).max() + 1e-9, predictor.names[k]
        carried = (up.state - down.state) / (2.0 * size)
        assert np.abs(transition[:, k] - carried).max() <= 2e-3 * np.abs(carried).max(), predictor.names[k]


def test_the_noise_of_the_joints_is_what_their_errors_make_of_the_prediction(held):
    predictor = online(held).predictor
    q, still = np.repeat(held.q[300:301], 4, axis=0), np.zeros((4, 5))
    x, chi = np.zeros(len(predictor.names)), predictor.vehicle.chi.copy()
    x[PAYLOAD] = chi[predictor.vehicle.payload_columns()] = [5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    rest = predictor.predict(q, still, still, x).values
    small, variance = 1e-6, np.zeros((4, 6))
    for kind, rows in enumerate([slice(0, 3), slice(3, 6)]):  # of a rate the gyro, of an acceleration the force
        for joint in range(5):
            sigma = np.zeros((4, 2, 5))
            sigma[:, kind, joint] = small
            links = link_motions(predictor.vehicle, q, sigma[:, 0], sigma[:, 1])
            turned = x.copy()  # the base takes up what momentum the joints seem to have: there is none in all
            turned[RATE] = predict_base(links, predictor.period_s, chi, np.zeros(3), ()).rate[0]
            moved = predictor.predict(q, sigma[:, 0], sigma[:, 1], turned).values - rest
            alone = predictor.joint_noise(q, sigma, x)
            np.testing.assert_allclose(alone[1:3, rows], np.abs(moved[:, rows]), rtol=1e-3, atol=1e-3 * small)
            variance += alone**2
    together = predictor.joint_noise(q, np.full((4, 2, 5), small), x)
    np.testing.assert_allclose(together**2, variance, rtol=1e-9)
    assert (together > 0.01 * small).all()


@pytest.mark.parametrize(
    ("payload", "imu", "links", "message"),
    [
        (None, "imu_base", {}, "no payload link"),
        ("payload", "imu_tip", {}, "imu_tip"),
        ("payload", "imu_base", {"payload": np.eye(10)}, "other than the payload"),
        ("payload", "imu_base", {"wheel": np.eye(10)}, "wheel"),
    ],
)
def test_names_that_do_not_fit_are_refused(payload, imu, links, message):
    vehicle = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", payload))
    with pytest.raises(UnknownFrameError, match=message):
        ImuPredictor(vehicle, imu, 0.01, 5, links, CERTAIN)


def test_a_disturbance_that_no_motion_tells_stays_as_large_as_stated(held):
    """Over hundreds of seconds that tell nothing: a drifting random walk would have grown a hundredfold."""
    given = online(held).predictor.vehicle, "imu_base", 0.01, 5, {}, CERTAIN
    predictor, ticks = ImuPredictor(*given, disturbance=DisturbancePrior(1.0, 1.0, 60.0)), ticks_of(held)
    motion = ticks.q[:1].repeat(12, axis=0), *np.zeros((2, *ticks.q[:12].shape))
    x, P = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma) ** 2)
    for _ in range(2000):
        x, P = predictor.carried(predictor.predict(*motion, x), x, x, P)
    sigma = np.sqrt(np.diag(P))[-12:]
    np.testing.assert_allclose(sigma[6:], predictor.sigma[-6:], rtol=0.01)  # drifts
    assert (sigma[:6] < 4.0 * predictor.sigma[-12:-6]).all()
