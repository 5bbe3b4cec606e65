"""A simulated flight becomes the ticks an identifier takes, errors of the IMU added; and the filter that takes them."""

import numpy as np

from bench.true_flights.free_flyer_sensors import ImuErrors, sample
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.payload import standard_covariance
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.dynamics.ticks import tick_signals
from onboard.identification.free_flyer.prediction.imu_errors import CERTAIN, ImuPrior
from onboard.identification.free_flyer.prediction.imu_prediction import ImuPredictor
from onboard.identification.free_flyer.prediction.parameters import EXACT_GEOMETRY
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.free_flyer.recursion.recursive import MotionFilter
from onboard.identification.free_flyer.recursion.window import WindowSolve
from onboard.regressor.signals import EncoderJump
from tests.dynamics.free_flyer_twin import URDF

WIDE = np.array([50.0, *[20.0] * 3, *[10.0] * 6])
BIASED = ImuErrors(gyro_bias_rad_s=0.01, accelerometer_bias_m_s2=0.1)
BIASES = CERTAIN._replace(gyro_bias_rad_s=0.01, accelerometer_bias_m_s2=0.1)
PRIOR = ImuPrior(0.01, 1e-4, 0.003, 0.0035, 0.1, 1e-3, 0.003, 0.0035, 1e-4)
CAPTURE_s, RELEASE_s, END_s = 3.0, 8.0, 10.5


def ticks_of(signals):
    n = len(signals.q)
    sigma = np.tile(np.r_[signals.rate_sigma, signals.specific_force_sigma], (n, 1))
    measured = np.c_[signals.rate, signals.specific_force]
    joints = (x.copy() for x in (signals.q, signals.dq, signals.ddq))
    exact = *np.zeros((2, n, 2, 5)), np.zeros((n, 3, 0)), np.zeros((n, 0)), np.ones(n)
    return Ticks(0.054 + signals.period_s * np.arange(n), *joints, measured, sigma, *exact)


def recorded(flight, rng, errors=BIASED):
    samples = sample(flight, errors, rng)
    return tick_signals(*samples[:4], samples[4:], 5, 0.1)


def online(signals, held=True, imu_prior=BIASES, links=(), geometry=EXACT_GEOMETRY, **more):
    vehicle = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", "payload"))
    covariance = {
        name: standard_covariance(vehicle.chi[10 * k : 10 * k + 10], 0.01, 1e-3, 0.01)
        for k, name in enumerate(vehicle.links[:-1])
        if name in links
    }
    given = signals.period_s, signals.samples, covariance, imu_prior, geometry
    predictor = ImuPredictor(vehicle, "imu_base", *given, **more)
    return MotionFilter(predictor, WIDE, held)


def jumped(ticks, at_s, scale, zero):
    """The encoder of the second joint is another one from some time on, and its angle goes on smoothly."""
    after, k = ticks.time_s >= at_s, int(np.searchsorted(ticks.time_s, at_s))
    angle, rate = float(ticks.q[k, 1]), float(ticks.dq[k, 1])
    q, dq, ddq = (one.copy() for one in ticks[1:4])
    q[after, 1] += scale * (q[after, 1] - angle)
    for one in (dq, ddq):
        one[after, 1] *= 1.0 + scale
    return ticks._replace(q=q, dq=dq, ddq=ddq), EncoderJump(round(1e9 * at_s), scale * angle + zero, angle, rate)


def same_bits(a, b):
    return a.state.tobytes() == b.state.tobytes() and a.covariance.tobytes() == b.covariance.tobytes()


def solved(predictor, ticks, hypothesis, start=None):
    """The solve at its end, and how many ticks it has predicted."""
    prior = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma) ** 2)
    solve, predicted = WindowSolve(predictor, WIDE, ticks, prior, (hypothesis,), start), 0
    while not solve.over:
        predicted += solve.advance()
    return solve, predicted
