"""A free-flyer's samples, of MuJoCo's motion, as signals and rows; an identifier of its payload, the rest exact."""

import numpy as np
from numpy.typing import NDArray

from bench.identification.free_flyer import PAYLOAD_SIGMA
from hil_sim.plants import free_flyer
from hil_sim.sensing.free_flyer_sensors import Samples
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.smoothing import SmoothingWindow, correlation_inflation
from onboard.identification.rows.identifier import Identifier
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.rows import BaseMotion, RowModel, base_force_rows, base_moment_rows, base_motion
from onboard.regressor.signals import SignalNoise, Signals

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


def signals_of(model: VehicleModel, samples: Samples, smoothing_s: float) -> Signals:
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
