"""Linear estimators on a free-flyer's rows: what noise in the regressor does to them; the truth is MuJoCo's.

The identifier as it flies, ten parameters of the payload unknown, the rest exact: plain least squares, the same with
the known power of the noise taken out, and instrumental variables.
"""

import os
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from bench.identification.free_flyer import BOXES, NORMAL, PAYLOAD_SIGMA, DURATION_s, vehicle
from hil_sim.plants import free_flyer
from hil_sim.sensing.free_flyer_sensors import ImuErrors, Samples, sample
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.recursive.consistency import JackknifeEstimate
from onboard.estimation.smoothing import SmoothingWindow, correlation_inflation
from onboard.ground.campaign.results import Answer, FlightResult
from onboard.identification.rows.identifier import Identifier
from onboard.identification.standing import Level
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.rows import BaseMotion, RowModel, base_force_rows, base_moment_rows, base_motion
from onboard.regressor.signals import SignalNoise, Signals

Floats = NDArray[np.float64]

ROW_s, STEP_TICKS, SMOOTHING_s = 0.01, 5, 0.2
ENCODER_rad = 2.0 * np.pi / 500_000 / np.sqrt(12.0)
EQUATION_SIGMA = np.array([1e-3] * 3 + [1e-4] * 3)  # N, N m: what is left of the rows with exact signals
METHODS = ("least squares", "less known noise", "instrumental")
STANDARD = (  # parameters about the frame's origin
    ("m", "kg"),
    *((f"m c_{axis}", "kg m") for axis in "xyz"),
    *((f"J_{of}", "kg m^2") for of in ("xx", "xy", "yy", "xz", "yz", "zz")),
)


def identifier(model: VehicleModel, instruments: bool, smoothing_s: float = SMOOTHING_s) -> Identifier:
    """Six zero-wrench rows of the free-flyer, all but the payload taken for exact."""
    rows = RowModel(model, [*base_force_rows(model), *base_moment_rows(model)])
    sigma = np.zeros(len(rows.names))
    sigma[model.payload_columns()] = PAYLOAD_SIGMA
    base = base_parameters(rows, np.random.default_rng(0), known=sigma == 0.0)
    lag_s = smoothing_s if instruments else None
    return Identifier(rows, base, np.diag(sigma), 5 * smoothing_s, imu_frame="imu_base", instruments_lag_s=lag_s)


def signals_of(model: VehicleModel, samples: Samples, smoothing_s: float = SMOOTHING_s) -> Signals:
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


def flight(seed: int, settings: dict[str, Any]) -> FlightResult:
    """One flight of ``bench/plans/linear.toml``.

    Args:
        seed: of everything drawn.
        settings: ``payload``: kg, of ``BOXES``; ``method``, of ``METHODS``.
    """
    rng, body, method = np.random.default_rng(seed), BOXES[settings["payload"]], settings["method"]
    motion = free_flyer.JointMotion.draw(rng)
    flown = free_flyer.fly(free_flyer.world(body), motion, rng.uniform(-0.05, 0.05, 3), DURATION_s)
    model = vehicle()
    signals = signals_of(model, sample(flown, ImuErrors(), rng))
    truth = RigidBody(body.mass_kg, body.centre_of_mass_m, body.inertia_kg_m2)
    one = identifier(model, method != "least squares")
    if method == "least squares":
        signals = signals._replace(noise=None, sigma=_mean_sigma(one, signals, truth))
    feed(one, signals)
    found = JackknifeEstimate(one.rls, one.blocks) if method == "less known noise" else one.block_jackknife()
    interval, true = found.combination(np.eye(10)), standard_of(truth)
    numbers = zip(true, found.mean, interval.low, interval.high, strict=True)
    return FlightResult(
        tuple(
            Answer(name, unit, *map(float, of), float(of[3] - of[1]) / NORMAL, supported=True, level=str(Level.GOOD))
            for (name, unit), of in zip(STANDARD, numbers, strict=True)
        )
    )


def _mean_sigma(one: Identifier, signals: Signals, truth: RigidBody) -> Floats:
    """What a plain least squares may know: each row's error by sensor noise, the same all along."""
    noise = signals.noise
    assert noise is not None
    mass = one.model.vehicle.chi[::10].sum() + truth.mass_kg
    force = mass * float(np.mean(noise.specific_force))
    return np.broadcast_to([force] * 3 + [0.2 * force] * 3, signals.measured.shape)
