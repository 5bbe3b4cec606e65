"""A free flight whose joints and IMU were recorded by two clocks: the clock and the payload found together.

The encoders' prediction of the base's rate is aligned with the gyro first (:mod:`onboard.timebase.resync`), which needs
no payload and no momentum and is good to some tens of milliseconds. Then delay and rate of the encoders' clock join
payload and momentum in the maximum likelihood fit (:mod:`onboard.identification.free_flyer.batch`), joints placed anew
after each, until nothing is left to move.
"""

import contextlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from onboard.dynamics.free_flight import predict_base
from onboard.dynamics.kinematics import link_motions
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.ticks import FlightSignals, tick_signals
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.smoothing import smooth
from onboard.identification.free_flyer.batch import MotionFit, PayloadFit
from onboard.identification.free_flyer.guesses import GUESSES
from onboard.identification.free_flyer.prediction.imu_errors import ImuPrior
from onboard.timebase.resync import RecorderStream, ResyncError, align, candidates

PEAK_HZ = 1.0
PREDICTED_EVERY_S = 0.01
SMOOTHING_S = 0.2  # of the joints for the coarse prediction
_SAMPLES, _WIDTH_S = 5, 0.1  # of the IMU in each tick; of the kernel that smooths the joints
COARSE_SIGMA_S = 0.05
ROUNDS = 12
CANDIDATES = 4
BAD_FIT = 2.0  # times the noise
AS_GOOD = 1.2
STILL_S = 2e-6  # a clock that moves by less than this, at either end of the flight, stays


class RecordedPair(NamedTuple):
    """What the two recorders hold; the IMU's clock is the reference."""

    imu_s: FloatArray  # (n,)
    rate: FloatArray  # (n, 3) IMU axes, rad/s
    specific_force: FloatArray  # (n, 3) IMU axes, m/s^2
    sigma: tuple[float, float]  # of a sample of either
    joints_s: FloatArray  # (m,) by the encoders' own clock
    angle: FloatArray  # (m, joints)


class FittedClock(NamedTuple):
    """Reference time = ``pivot_s + offset_s + (1 + rate) * (own time - pivot_s)``."""

    pivot_s: float
    offset_s: float
    rate: float
    sigma_offset_s: float
    sigma_rate: float

    def reference_s(self, own_s: FloatArray) -> FloatArray:
        """Times of the encoders (m,) on the IMU's clock."""
        placed: FloatArray = self.pivot_s + self.offset_s + (1.0 + self.rate) * (own_s - self.pivot_s)
        return placed


class Rescued(NamedTuple):
    """The clock, and what was held."""

    clock: FittedClock
    found: PayloadFit
    rounds: int

    @property
    def misfit(self) -> float:
        """Whitened residual sum over its degrees of freedom: 1 where nothing but noise is left."""
        return self.found.misfit


Build = Callable[[FlightSignals, ImuPrior], MotionFit]


def coarse_clocks(vehicle: VehicleModel, recorded: RecordedPair, rate_limit: float) -> list[FittedClock]:
    """Clocks by correlation, likeliest first: the gyro is a linear map of base rates predicted from the joints.

    One, where it stands out; else the best few, for :func:`rescue` to tell apart.
    """
    at_s = np.arange(recorded.joints_s[0] + SMOOTHING_S, recorded.joints_s[-1] - SMOOTHING_S, PREDICTED_EVERY_S)
    q, dq, ddq = (smooth(recorded.joints_s, recorded.angle, at_s, SMOOTHING_S, order).values for order in range(3))
    links = link_motions(vehicle, q, dq, ddq)
    told = []
    for payload in (None, GUESSES[0]):  # what any other payload does lies near the span of what these do
        chi = vehicle.chi.copy()
        chi[vehicle.payload_columns()] = 0.0 if payload is None else standard_of(payload)
        told.append(predict_base(links, PREDICTED_EVERY_S, chi, np.zeros(3), ()).rate)
    seen, other = RecorderStream(recorded.imu_s, recorded.rate), RecorderStream(at_s, np.hstack(told))
    try:
        found = align(seen, other, PEAK_HZ, rate_limit)
    except ResyncError:
        likely = candidates(seen, other, PEAK_HZ, rate_limit, CANDIDATES)
        return [FittedClock(one.pivot_s, one.offset_s, one.rate, COARSE_SIGMA_S, rate_limit) for one in likely]
    return [FittedClock(found.pivot_s, found.offset_s, found.rate, COARSE_SIGMA_S, rate_limit)]


def placed_signals(recorded: RecordedPair, clock: FittedClock) -> tuple[FlightSignals, float]:
    """Ticks of the time that both recorders share, joints placed by the encoders' ``clock``; and the middle of it."""
    times_s = clock.reference_s(recorded.joints_s)
    inside = (recorded.imu_s >= times_s[0]) & (recorded.imu_s <= times_s[-1])
    grid_s = recorded.imu_s[inside]
    if len(grid_s) < 8 * _SAMPLES:
        raise ResyncError("the two recordings have no common time by this clock: give the ones that belong together")
    angle = CubicSpline(times_s, recorded.angle)(grid_s)
    rate, force = recorded.rate[inside], recorded.specific_force[inside]
    signals = tick_signals(grid_s, angle, rate, force, recorded.sigma, _SAMPLES, _WIDTH_S)
    return signals, 0.5 * float(grid_s[0] + grid_s[-1])


def rescue(recorded: RecordedPair, clocks: Sequence[FittedClock], build: Build, imu_prior: ImuPrior) -> Rescued:
    """Clock and payload from clocks that may be nearly right.

    Args:
        recorded: both recorders.
        clocks: from :func:`coarse_clocks`.
        build: makes the estimator of signals and of a prior on instrument errors.
        imu_prior: on instrument errors; its delay and clock rate error are set here.

    Raises:
        ResyncError: no clock settles on a fit that is as good as the noise allows, or more than one does.
    """
    found: list[Rescued] = []
    for clock in clocks:
        with contextlib.suppress(ConvergenceError, ResyncError):
            found.append(_settled(recorded, clock, build, imu_prior))
    found.sort(key=lambda one: one.misfit)
    if not found or found[0].misfit > BAD_FIT:
        told = f"the best leaves {found[0].misfit:.1f} times the noise" if found else "none leads to a fit"
        raise ResyncError(f"of {len(clocks)} clocks {told}: the recordings have no common motion")
    for other in found[1:]:
        apart_s = abs(other.clock.offset_s - found[0].clock.offset_s)
        if apart_s > COARSE_SIGMA_S and other.misfit < AS_GOOD * found[0].misfit:
            raise ResyncError(
                f"an offset {apart_s:.3f} s away fits as well: the motion repeats itself, give more of it"
            )
    return found[0]


def _settled(recorded: RecordedPair, clock: FittedClock, build: Build, imu_prior: ImuPrior) -> Rescued:
    """The fit with the clock's share in it, joints placed anew until nothing moves."""
    span_s = float(np.ptp(recorded.imu_s))
    for done in range(1, ROUNDS + 1):
        signals, middle_s = placed_signals(recorded, clock)
        widened = imu_prior._replace(delay_s=clock.sigma_offset_s, clock_rate_error=clock.sigma_rate)
        found = build(signals, widened).fit()
        delay_s, rate_error = found.fit.x[-2:]
        sigma_s, sigma_rate = np.sqrt(np.diag(found.fit.covariance)[-2:])
        # the IMU's time at which a joint sample placed at t was taken: t + delay + rate_error (t - middle)
        clock = clock._replace(
            offset_s=clock.offset_s + delay_s + rate_error * (clock.pivot_s + clock.offset_s - middle_s),
            rate=(1.0 + clock.rate) * (1.0 + rate_error) - 1.0,
        )
        if abs(delay_s) + abs(rate_error) * span_s / 2.0 < STILL_S:
            settled = clock._replace(sigma_offset_s=float(sigma_s), sigma_rate=float(sigma_rate))
            return Rescued(settled, found, done)
    raise ResyncError(f"the clock did not settle in {ROUNDS} rounds: the recordings may not belong together")
