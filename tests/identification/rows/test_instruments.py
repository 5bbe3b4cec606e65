"""Predicted motion is true at the truth and shares no noise with the tick; rows made of it take the bias out.

A free-flyer's samples, of MuJoCo's motion, as signals and rows; an identifier of its payload, the rest exact.
"""

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.identification.free_flyer import PAYLOAD_SIGMA
from hil_sim.plants import free_flyer
from hil_sim.sensing.free_flyer_sensors import SampledSignals
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.estimation.smoothing import SmoothingWindow, correlation_inflation
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.instruments import MotionRows, whitening
from onboard.identification.rows.predicted_motion import PredictedMotion
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.rows import BaseMotion, RowModel, base_force_rows, base_moment_rows, base_motion
from onboard.regressor.signals import SignalNoise, Signals
from tests.dynamics.free_flyer_twin import PAYLOAD, URDF, twin

Floats = NDArray[np.float64]

ROW_s, STEP_TICKS = 0.01, 5
ENCODER_rad = 2.0 * np.pi / 500_000 / np.sqrt(12.0)
EQUATION_SIGMA = np.array([1e-3] * 3 + [1e-4] * 3)  # N, N m: what is left of the rows with exact signals


def identifier(model: VehicleModel, instruments: bool, smoothing_s: float) -> Identifier:
    """Six zero-wrench rows of the free-flyer, all but the payload taken for exact."""
    rows = RowModel(model, [*base_force_rows(model), *base_moment_rows(model)])
    sigma = np.zeros(len(rows.names))
    sigma[model.payload_columns()] = PAYLOAD_SIGMA
    base = base_parameters(rows, np.random.default_rng(0), known=sigma == 0.0)
    lag_s = smoothing_s if instruments else None
    return Identifier(rows, base, np.diag(sigma), 5 * smoothing_s, imu_frame="imu_base", instruments_lag_s=lag_s)


def signals_of(model: VehicleModel, samples: SampledSignals, smoothing_s: float) -> Signals:
    """Every signal through the flight's kernel at the row rate, with its noise."""
    t = samples.time_s
    at = np.arange(t[0] + 0.5 * smoothing_s + ROW_s, t[-1] - 0.5 * smoothing_s, ROW_s)
    window = SmoothingWindow(t, at, smoothing_s)
    joints = [window.apply(samples.angle_rad, derivative) for derivative in range(3)]
    imu = [
        window.apply(samples.rate_rad_s),
        window.apply(samples.rate_rad_s, 1),
        window.apply(samples.specific_force_m_s2),
    ]
    spread = (samples.rate_sigma_rad_s, samples.rate_sigma_rad_s, samples.specific_force_sigma_m_s2)
    q_sigma, dq_sigma, ddq_sigma = (
        np.repeat(one.noise_gain[:, None] * ENCODER_rad, free_flyer.JOINTS, axis=1) for one in joints
    )
    w_sigma, dw_sigma, f_sigma = (
        np.repeat(one.noise_gain[:, None] * sigma, 3, axis=1) for one, sigma in zip(imu, spread, strict=True)
    )
    inflation = correlation_inflation(smoothing_s, ROW_s)
    noise = SignalNoise(q_sigma, dq_sigma, ddq_sigma, w_sigma, dw_sigma, f_sigma, inflation)
    motion = base_motion(model, "imu_base", *(one.values for one in imu))
    rows = np.zeros((at.size, 6))
    q, dq, ddq = (one.values for one in joints)
    return Signals(at, q, dq, ddq, motion, rows, rows + EQUATION_SIGMA, None, noise)


def part(signals: Signals, which: slice) -> Signals:
    """Some of the ticks."""
    noise = signals.noise
    arrays = {name: getattr(signals, name)[which] for name in ("time_s", "q", "dq", "ddq", "measured", "sigma")}
    if noise is not None:
        own = {name: value[which] for name, value in noise._asdict().items() if isinstance(value, np.ndarray)}
        noise = noise._replace(**own)
    return signals._replace(**arrays, motion=BaseMotion(*(v[which] for v in signals.motion)), noise=noise)


def feed(one: Identifier, signals: Signals) -> None:
    """Steps of 50 ms, as they come in flight."""
    for first in range(0, len(signals.time_s), STEP_TICKS):
        step = part(signals, slice(first, first + STEP_TICKS))
        n = len(step.time_s)
        one.update(step, np.ones(n, bool), np.zeros(n, np.int64))


WIDTH_S = 0.2


@pytest.fixture(scope="module")
def flown():
    return twin(7.0)


def predicted(vehicle, chi, signals, rate, held=None):
    motion = PredictedMotion(vehicle, WIDTH_S)
    assert motion.set(chi)
    flags = np.ones(len(signals.time_s), bool) if held is None else held
    return motion.predict(signals.time_s, signals.q, signals.dq, signals.ddq, rate, flags)


def test_at_the_truth_the_prediction_is_the_motion(flown, rng):
    signals = signals_of(flown.vehicle, flown.samples(rng, noise=False), WIDTH_S)
    found = predicted(flown.vehicle, flown.chi, signals, signals.motion.rate_rad_s)
    for guess, truth in zip(found, signals.motion, strict=True):
        assert np.abs(guess - truth).max() < 2e-3 * np.abs(truth).max()


def test_a_tick_is_predicted_from_what_was_seen_a_lag_before(flown, rng):
    signals = signals_of(flown.vehicle, flown.samples(rng, noise=False), WIDTH_S)
    rate = signals.motion.rate_rad_s
    spoilt = rate.copy()
    spoilt[300:] += 0.1
    one, two = (predicted(flown.vehicle, flown.chi, signals, w) for w in (rate, spoilt))
    lag = round(WIDTH_S / 0.01)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a[: 300 + lag], b[: 300 + lag])
        assert np.abs(a[300 + lag + 1] - b[300 + lag + 1]).max() > 0.0


def test_parameters_put_right_are_as_if_they_had_been_so(flown, rng):
    """The last seconds are seen anew: a wrong payload before leaves nothing in the momentum."""
    signals = signals_of(flown.vehicle, flown.samples(rng, noise=False), WIDTH_S)
    parts = signals.time_s, signals.q, signals.dq, signals.ddq, signals.motion.rate_rad_s
    held = np.ones(len(signals.time_s), bool)
    motion = PredictedMotion(flown.vehicle, WIDTH_S)  # as drawn: without payload
    motion.predict(*(x[:400] for x in parts), held[:400])
    assert motion.set(flown.chi)
    found = motion.predict(*(x[400:] for x in parts), held[400:])
    np.testing.assert_allclose(found.rate_rad_s, signals.motion.rate_rad_s[400:], atol=2e-3)
    motion.forget()
    late = signals.time_s[400:] + 100.0
    again = motion.predict(late, *(x[400:] for x in parts[1:]), held[400:])  # a hole: begins with the first tick
    np.testing.assert_allclose(again.rate_rad_s[0], signals.motion.rate_rad_s[400], atol=1e-9)


def test_a_vehicle_that_cannot_be_is_not_predicted_with(flown):
    motion = PredictedMotion(flown.vehicle, WIDTH_S)
    for change in (lambda chi: -chi, lambda chi: chi * np.tile([1.0, 50.0, *[1.0] * 8], len(chi) // 10)):
        assert not motion.set(change(flown.chi))
    with pytest.raises(SignalError, match="lag"):
        PredictedMotion(flown.vehicle, 0.0)


def test_without_the_payload_the_vehicle_without_it_is_predicted(flown, rng):
    signals = signals_of(flown.vehicle, flown.samples(rng, noise=False), WIDTH_S)
    rate, none = signals.motion.rate_rad_s, np.zeros(len(signals.time_s), bool)
    found = predicted(flown.vehicle, flown.chi, signals, rate, none)
    drawn = predicted(flown.vehicle, flown.vehicle.chi, signals, rate)
    np.testing.assert_allclose(found.rate_rad_s, drawn.rate_rad_s, atol=1e-12)


def test_instruments_take_the_bias_out_of_a_flight(flown, rng):
    signals = signals_of(flown.vehicle, flown.samples(rng), WIDTH_S)
    truth, errors = standard_of(PAYLOAD), []
    for instruments in (False, True):
        one = identifier(flown.vehicle, instruments, WIDTH_S)
        feed(one, signals)
        errors.append(np.abs((one.block_jackknife().mean if instruments else one.rls.solve().mean) / truth - 1.0)[0])
        if instruments:
            interval = one.block_jackknife().combination(np.eye(10))
            assert np.mean((interval.low <= truth) & (truth <= interval.high)) >= 0.8
    assert errors[0] > 0.03
    assert errors[1] < 0.015


def test_whitening_makes_the_errors_of_a_tick_independent(rng):
    used = np.array([[True] * 3, [True, False, True], [False] * 3, [True] * 3])
    r = int(used.sum())
    noise, mean, sigma = rng.normal(size=(2, 3, 4, 3)), rng.normal(size=2), rng.uniform(0.5, 1.0, r)
    none, held, group = np.zeros((4, 1)), np.ones(4, bool), np.array([0, 1, 1, 0])
    Y = rng.normal(size=(r, 2))
    rows = MotionRows(np.arange(4.0), *[none] * 4, held, used, Y, none, sigma, noise, group, None)
    spread, parts = whitening(rows, mean)
    effect = np.concatenate([noise[g, use] for g, use in zip(group, used, strict=True)]) @ [*mean, -1.0]
    np.testing.assert_allclose(spread**2, sigma**2 + (effect**2).sum(axis=1))
    seen = 0
    for index, inverse in parts:
        for mine, L in zip(index, inverse, strict=True):
            S = effect[mine] @ effect[mine].T + np.diag(sigma[mine] ** 2)
            own = L / spread[mine]
            np.testing.assert_allclose(own @ S @ own.T, np.eye(len(mine)), atol=1e-6)
            seen += len(mine)
    assert seen == r
    assert whitening(rows._replace(noise=None), mean)[1] == []


def test_a_base_that_is_held_has_no_instruments():
    spec = VehicleSpec(BaseKind.PRESCRIBED, "base", "payload")
    with pytest.raises(SignalError, match="free bases only"):
        identifier(VehicleModel(URDF.read_text(), spec), True, WIDTH_S)
