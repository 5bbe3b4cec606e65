"""Fit of a base on an air-bearing table: motion from joints, initial velocity, drag and tilt.

Drag depends on velocity, which is not measured but predicted (:mod:`onboard.dynamics.air_bearing`). Regression rows
would contain the IMU's noise and an integrated velocity in their columns; a prediction does not, so noise causes no
bias.

Known limit: an accelerometer does not sense gravity along the table; the tilt is observable through the velocity only,
and weakly.
"""

from collections.abc import Mapping
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from onboard.dynamics.air_bearing import PLANAR
from onboard.dynamics.joint_errors import JointErrors
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.ticks import FlightSignals
from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.estimation.errors import ConvergenceError, EstimationError
from onboard.estimation.maximum_likelihood import ITERATIONS, MINIMUM, NEAR_MINIMUM, Descent, Fit, Normal, fit
from onboard.estimation.policy import MISFIT_DOUBTED, MISFIT_PART
from onboard.identification.corrections import refused_from
from onboard.identification.free_flyer.batch import MotionFit, PayloadFit
from onboard.identification.free_flyer.guesses import GUESSES
from onboard.identification.free_flyer.prediction.further import PlacedImu
from onboard.identification.free_flyer.prediction.joint_noise import JointNoise, sigma_of
from onboard.identification.free_flyer.prediction.parameters import Unknowns
from onboard.identification.free_flyer.prediction.ticks import RESTS_rad_s
from onboard.identification.quantities import SUPPORTED_SHRINKAGE
from onboard.identification.table.floating_base import (
    NO_MULTIPLES,
    PATIENT,
    AirBearingBase,
    AirBearingPrior,
    DragPrior,
)

_ROUGHLY = 100.0  # tolerance of the sum in a search, before drags are free
_SEARCH_PERIOD_s = 0.02  # between ticks
_OF_LOGARITHM = 1.0  # sigma of a mass's or a drag's about where a search begins
_FINISHED = 2  # results of searches, the likeliest
_MOST_TICKS = 1_000_000  # predicted in all searches of a run, 13 s of CPU time; light robots take up to 621,780
_BODIES = GUESSES[1], GUESSES[0], GUESSES[2]  # light ones first: they are predicted by the bare vehicle's motion
DRAGS = ((1.0 / 60.0, 1.5e-3), (1.0 / 25.0, 4e-3))  # of all pucks, in the bare vehicle's masses: 1/s, m/s^2


class TableFit(MotionFit):
    """The fit of a run on the table.

    Velocity at the start, tilt and drag have many minima between them, since a puck that pushes speeds up without end,
    and Coulomb drag turns about where a puck hardly slips; a run that begins at rest shows nothing of the payload in
    its first seconds. Where the fit of growing parts fails, or the pucks together or one of them would push, minima are
    searched for at coarser ticks and in few steps, by growing parts from several payloads and drags that stay positive.
    The searches end where the likeliest minimum explains the run and was reached twice. All ticks are fitted from the
    likeliest two, and the likeliest of all results is kept. Where an instrument is wrong nothing explains the run:
    searches are bounded, and results far from an answer are not fitted to all ticks.

    Arguments and errors are those of :class:`AirBearingBase` and :class:`MotionFit`; ``likely``: the payload at which
    the noise of the joints is weighed; None: the first guess.
    """

    _base: AirBearingBase
    _likely: FloatArray | None = None  # standard parameters of all links with which the noise of the joints is weighed

    def __init__(
        self,
        vehicle: VehicleModel,
        imu_frame: str,
        signals: FlightSignals,
        payload_sigma: FloatArray,
        link_covariance: Mapping[str, FloatArray],
        prior: AirBearingPrior,
        likely: RigidBody | None = None,
    ) -> None:
        base = AirBearingBase(vehicle, signals, prior)
        super().__init__(base, imu_frame, payload_sigma, link_covariance, prior.imu)
        if base.signals.joint_sigma is not None and base.signals.joint_sigma.any():
            self._likely = base.vehicle.chi.copy()
            with suppress(SignalError):  # no mass can be seen so: that of the file
                self._likely[base.vehicle.payload_columns()] = standard_of(likely or self.rough())
            self._take(base)

    def _of_joints(self) -> FloatArray:
        """See :class:`MotionFit`; by :mod:`onboard.identification.free_flyer.prediction.joint_noise`."""
        signals, vehicle = self._base.signals, self._base.vehicle
        if self._likely is None or signals.joint_sigma is None:
            return super()._of_joints()
        imu = PlacedImu(self._R_BS, self._p_BoSo_B, signals.samples, slice(0, 0), slice(0, 0))
        noise = JointNoise(vehicle, JointErrors(vehicle), [imu], [], [slice(0, 6)], PLANAR)
        return sigma_of(noise.by_joint(signals.q, self._likely, signals.joint_sigma)[0])

    def fit(self) -> PayloadFit:
        """See :meth:`MotionFit.fit`."""
        if np.abs(self._base.signals.dq).max(initial=0.0) <= RESTS_rad_s:
            raise ConvergenceError("no joint moves: these data do not determine a payload")
        found, failure = list[PayloadFit](), list[EstimationError | SignalError]()
        try:
            found.append(self._dragged(super().fit()))
        except (EstimationError, SignalError) as error:
            failure.append(error)
        if not found or self.pushes(found[0].fit):
            try:
                near = self.searched()
            except ConvergenceError as error:
                near, failure = [], [error]
            for x in near:
                try:
                    found.append(self.near(x))
                except (EstimationError, SignalError) as error:
                    failure.append(error)
        if not found:
            raise failure[0]
        return min(found, key=lambda one: one.fit.residual_sum)

    def near(self, x: FloatArray) -> PayloadFit:
        """The fit of all ticks from parameters ``x``, (p,), without a search.

        Raises:
            EstimationError, SignalError: as :meth:`MotionFit.fit`.
        """
        return self._dragged(self._finished(x))

    def _finished(self, x: FloatArray) -> PayloadFit:
        return self.found(fit(self.residuals, x, np.zeros_like(x), self.prior_information, PATIENT, MINIMUM))

    def _dragged(self, found: PayloadFit) -> PayloadFit:
        """The same, or where pucks push in it the fit from where these drags are zero, if it is likelier."""
        drag = self.layout.estimated("drag")
        pushing, x = drag[found.fit.x[drag] < 0.0], found.fit.x.copy()
        if not pushing.size:
            return found
        x[pushing] = 0.0
        try:
            x = self.held(x, pushing, NEAR_MINIMUM, self.ticks, Work(ITERATIONS * self.ticks)).x
            return min(found, self._finished(x), key=lambda one: one.fit.residual_sum)
        except EstimationError:
            return found

    def with_errors(self, errors: FloatArray, since: int = 0, multiples: FloatArray = NO_MULTIPLES) -> "TableFit":
        """The same if the joints had these errors, as :meth:`AirBearingBase.with_errors` takes them."""
        return self.of(self._base.with_errors(errors, since, multiples))

    @property
    def period_s(self) -> float:
        """Between ticks."""
        return self._base.signals.period_s

    @property
    def ticks(self) -> int:
        """Of the run."""
        return len(self._base.signals.q)

    @property
    def joints(self) -> Unknowns:
        """The errors of the joints and what is stated of them, (6 x joints,)."""
        return self._base.prior.geometry.blocks(self._base.vehicle)["joints"]

    @property
    def cyclic(self) -> Unknowns:
        """Multiples of the functions of cyclic errors of the encoders, (m,), of a run that has these functions."""
        return self._base.prior.geometry.blocks(self._base.vehicle)["cyclic"]

    def pushes(self, found: Fit) -> bool:
        """Whether all pucks together would push, by viscous or by Coulomb drag, or one of them beyond its sigma."""
        at = self.layout.estimated("drag")
        each, sigma = found.x[at], np.sqrt(np.diag(found.covariance)[at])
        return bool((each.reshape(-1, 2).sum(axis=0) < 0.0).any() or (each < -sigma).any())

    def searched(self) -> list[FloatArray]:
        """Parameters to begin with, (p,) each, the likeliest first.

        Raises:
            ConvergenceError: all results are far from an answer.
        """
        base = self._base
        coarse = self.of(base.coarser(max(1, round(_SEARCH_PERIOD_s / base.signals.period_s))))
        work, rows = Work(_MOST_TICKS), 6 * int(coarse.valid.sum())
        found = list[Searched]()
        for guess in _BODIES:
            for drags in DRAGS:
                with suppress(EstimationError):
                    found.append(coarse.grown(guess, drags, work))
            found.sort(key=lambda one: one.squares)
            squares = [one.squares for one in found[:_FINISHED]]
            if len(squares) > 1 and np.ptp(squares) < NEAR_MINIMUM and squares[0] < MISFIT_DOUBTED * rows:
                break
        near = [one.x for one in found[:_FINISHED] if one.squares < MISFIT_PART * rows]
        if found and not near:
            times = np.sqrt(found[0].squares / rows)
            raise ConvergenceError(f"IMU and joints contradict each other: {times:.1f} times the noise is left")
        return near

    def grown(self, guess: RigidBody, drags: tuple[float, float], work: "Work") -> "Searched":
        """The minimum near a payload and drags, by a third of the ticks, two, and all of them."""
        x, n, none = self.start(guess), len(self.valid), np.zeros(0, np.intp)
        x[self.layout.estimated("drag")] = self._drag(*drags)
        for ticks in (n // 3, 2 * n // 3):
            x = self.held(x, none, _ROUGHLY, ticks, work).x
        return self.held(x, none, NEAR_MINIMUM, n, work)

    def _drag(self, viscous_1_s: float, coulomb_m_s2: float) -> FloatArray:
        """Fv and Fc of each puck that slow the bare vehicle down so, (2 x pucks,)."""
        pucks = len(self._base.prior.pucks)
        mass_kg = self._base.vehicle.chi[::10].sum()
        return np.tile([viscous_1_s * mass_kg / pucks, coulomb_m_s2 * mass_kg / pucks], pucks)

    def held(self, x: FloatArray, held: IndexArray, tolerance: float, ticks: int, work: "Work") -> "Searched":
        """The best in a few steps, for the first ticks, with some unknowns kept as they are.

        Mass and drags that are not kept are positive, and stay so: the steps are of their logarithms.
        """
        free = np.setdiff1d(np.arange(x.size), held)
        positive = np.isin(free, [self.layout.estimated("payload")[0], *self.layout.estimated("drag")])
        tried, prior, mean = x.copy(), self.prior_information[np.ix_(free, free)], x[free]
        own, prior = np.diag(prior) * positive, np.where(np.add.outer(positive, positive), 0.0, prior)
        prior[positive, positive] = 1.0 / _OF_LOGARITHM**2
        mean[positive] = np.log(mean[positive])
        descent = Descent(mean, mean * positive, prior, ITERATIONS, tolerance)
        for _ in range(ITERATIONS):
            work.spend(ticks)
            with np.errstate(over="ignore", invalid="ignore"):
                tried[free] = np.where(positive, np.exp(descent.at), descent.at)
                by = np.where(positive, tried[free], 1.0)
                r, J = self.residuals(tried, ticks)
                stated = Normal(np.diag(own * by * by), own * by * by, float(own @ (by * by)))
                predicted = Normal.of(r, J[:, free] * by).plus(stated)
                if not np.isfinite(predicted.information).all():  # it gains speed without end: a step too long
                    predicted = predicted._replace(squares=np.inf)
            descent.take(predicted)
            if descent.found is not None:
                break
        best = descent.best if descent.found is None else descent.found.x
        whole = x.copy()
        whole[free] = np.where(positive, np.exp(best), best)
        return Searched(whole, descent.squares)


class Work:
    """Ticks that searches may still predict."""

    def __init__(self, ticks: int) -> None:
        self._left = ticks

    def spend(self, ticks: int) -> None:
        """So many are predicted.

        Raises:
            ConvergenceError: there are none left.
        """
        if self._left <= 0:
            raise ConvergenceError("no minimum was reached in the time that a search has; check IMU and joints")
        self._left -= ticks


class Searched(NamedTuple):
    """What a search came to."""

    x: FloatArray  # (p,)
    squares: float  # sum of its whitened residuals


class DragFit(NamedTuple):
    """Drag of each puck, Fv, N s/m, and Fc, N, (2 x pucks,), and the reason for refusing the fit; empty if none."""

    names: tuple[str, ...]
    drag: FloatArray
    sigma: FloatArray
    reason: str


def drag_of(found: PayloadFit, pucks: Mapping[str, DragPrior]) -> DragFit:
    """Drag coefficients of a fit, with the checks that may refuse it."""
    names = tuple(f"{kind}_{frame}" for frame in pucks for kind in ("Fv", "Fc"))
    places = [found.names.index(name) for name in names]
    drag, spread = found.fit.x[places], np.sqrt(np.diag(found.fit.covariance)[places])
    mass, sigma = found.payload.body.mass_kg, float(np.sqrt(found.payload.covariance[0, 0]))
    pushing = [name for name, off in zip(names, drag / spread, strict=True) if off < -refused_from(len(names))]
    reason = ""
    if found.misfit > MISFIT_DOUBTED:
        times = np.sqrt(found.misfit)
        reason = f"IMU and joints contradict each other: {times:.1f} times the noise is left; check their signs"
    elif pushing:
        reason = f"pucks drag and do not push, but {', '.join(pushing)} came out negative; check pucks and motion"
    elif sigma > SUPPORTED_SHRINKAGE * mass:
        reason = f"the motion does not determine the payload: {mass:.3g} kg, give or take {sigma:.2g} kg; move more"
    return DragFit(names, drag, spread, reason)
