"""The filter of predicted motion as an :class:`onboard.identification.online.OnlineIdentifier`."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy.linalg.lapack import dpotrf
from scipy.special import ndtri

from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.payload import body_jacobian, body_of, numbers_of, possible_body
from onboard.dynamics.model.vehicle import STANDARD
from onboard.dynamics.tracked_pose import LINES
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.gates import GateReason, ReasonArray, count_refused, none_refused
from onboard.estimation.policy import DOUBT, MISFIT_DOUBTED, MISFIT_PART, REFUSE, contradicted_text, too_often
from onboard.identification.corrections import DOUBTFUL, contradicted, doubtful_from, misfit_text, too_large
from onboard.identification.evidence.bank import Weighed
from onboard.identification.evidence.mixture import REPORTED, Known, Mixture
from onboard.identification.free_flyer.before_capture import Payload
from onboard.identification.free_flyer.captured_body import CapturedBody
from onboard.identification.free_flyer.innovation import Corrections, HeldAgainst, ReferenceErrors
from onboard.identification.free_flyer.prediction.further import Further, FurtherPose
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import NOISE_KEY
from onboard.identification.free_flyer.prediction.ticks import Ticks, gated, ticks_of
from onboard.identification.free_flyer.recursion.bounded_work import last_work
from onboard.identification.free_flyer.recursion.lines import RECENT_s
from onboard.identification.free_flyer.recursion.recursive import DETERMINED, MotionFilter, feed_filter
from onboard.identification.free_flyer.recursion.solved import SOLVED_AT_s
from onboard.identification.online import Change
from onboard.identification.quantities import (
    BODY,
    BODY_UNITS,
    SUPPORTED_SHRINKAGE,
    Causes,
    Estimate,
    Findings,
    QuantityEstimate,
)
from onboard.regressor.signals import Signals

POSE_ROWS = *(f"attitude_{part}" for part in "wxyz"), *(f"position_{axis}" for axis in "xyz")
IMU_ROWS = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accelerometer") for axis in "xyz")

_ALTERED = "the payload changed without a release: a part came off or was added, or an instrument changed"
_EXCHANGED = "the payload changed without a release, so an instrument did: check the IMU and the joints"
_CONTRADICTED = "no payload explains the motion"  # a reason has 128 characters in the log
_SWINGING = "slosh, a flexible joint or a drift"
_GIVEN_UP = "the end of the flight is not taken in: its windows take too long to solve"
_LEANINGS = 2  # keys that an answer leans on: as above


def rows_of(further: Sequence[Further]) -> tuple[str, ...]:
    """Names of the lines of the base IMU and further instruments."""
    names = list(IMU_ROWS)
    for one in further:
        rows = {1: ("",), 6: IMU_ROWS, LINES: POSE_ROWS}[one.width]
        names += [f"{row}_{one.name}" if row else one.name for row in rows]
    return tuple(names)


def keys_of(predictor: ImuPredictor) -> tuple[str, ...]:
    """What states the sigma of each element of the state that is constant; empty for the others."""
    varying = {*predictor.changing.tolist(), *(k for pair in predictor.biases for k in pair)}
    varying |= {k for k, _ in predictor.wandering} | {*range(PAYLOAD.stop)}
    return tuple("" if k in varying else predictor.key_of(name) for k, name in enumerate(predictor.names))


class TickIdentifier:
    """What onboard estimators of a tick's means have in common: rows are the lines of the base IMU and of others.

    Args:
        payload: link that the parameters are of.
        further: instruments besides the base IMU.
        quantities: what is answered of the link, as in :data:`BODY`.

    Attributes:
        follows_jumps: goes on after an encoder has jumped, see ``Signals.jumps``.
    """

    follows_jumps = False

    def __init__(self, payload: str, further: Sequence[Further] = (), quantities: Sequence[str] = ()) -> None:
        self.further = tuple(further)
        self.row_names = rows_of(self.further)
        self.parameter_names: tuple[str, ...] = tuple(f"{kind}_{payload}" for kind in STANDARD)
        self.quantity_names: tuple[str, ...] = tuple(f"{kind}_{payload}" for kind in quantities)
        self.rows_used = 0
        self.refused = none_refused()


class MotionIdentifier(TickIdentifier):
    """The filter of predicted motion. Its rows are the lines of the base IMU, further IMUs and load cells.

    A quantity is supported if the data, not the prior, determine it; all but the mass also require a sigma of the mass
    of at most a fifth of it. Variances are multiplied by the innovations' misfit, of the instrument that has the
    largest, where that is above one (:mod:`onboard.identification.free_flyer.innovation`).

    Args:
        ekf: the estimator.
    """

    follows_jumps = True

    def __init__(self, ekf: MotionFilter) -> None:
        super().__init__(str(ekf.predictor.vehicle.spec.payload_link), ekf.predictor.further, BODY)
        self.ekf = ekf
        self._captured = CapturedBody(ekf)
        self._causes = Causes(keys_of(ekf.predictor), ekf.predictor.sigma, [NOISE_KEY])
        self._corrections = HeldAgainst(ekf.predictor, ekf.fusion, ekf.rivals.spanned)
        self._attached: bool | None = None
        self._told = self._counted = 0  # changes, and outliers of the filter
        self._mixed: tuple[Weighed, Mixture, float] | None = None  # the last answer, and what it is of
        self._newest_s = self._taken_s = 0.0  # times of the last tick, and of the last that a line was measured at
        self._ended = True  # or what the flight's end left to be solved was given up

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        """Takes new ticks; a change of ``attached`` announces a capture or a release of the payload.

        A tick refused as an outlier is counted but not marked, because it is tested some ticks later.

        Raises:
            SignalError: shapes that do not fit.
        """
        self.work()
        n = len(signals.time_s)
        shape = (n, len(self.row_names))
        if signals.measured.shape != shape or signals.sigma.shape != shape or excluded.shape != (n,):
            raise SignalError(f"{n} ticks need {shape} readings; they are {signals.measured.shape}")
        found = gated(signals, excluded)
        measured = np.where((found == 0), signals.measured, np.nan)
        ticks = ticks_of(signals, measured)
        if n:
            self._newest_s = float(signals.time_s[-1])
            self._taken_s = float(signals.time_s[(found == 0).any(axis=1)].max(initial=self._taken_s))
        self._attached = feed_filter(self.ekf, ticks, attached, signals.jumps, self._attached, self.ekf.take)
        self._count()
        self._tell_of_capture(ticks)
        count_refused(self.refused, found)
        return found

    def prediction_errors(self) -> list[ReferenceErrors]:
        """Of the base IMU, since the last call, a batch each."""
        told = self.ekf.innovations.told
        return [told.popleft() for _ in range(len(told))]

    def work(self) -> None:
        """Solves a window that the last update has left to be solved, as far as the bound on a step goes."""
        self.ekf.work()
        self._count()

    def finish(self) -> None:
        """Solves what is under way, and processes the ticks that wait for it, as far as :func:`last_work` goes."""
        self._ended = self.ekf.finish(last_work(len(self.ekf.predictor.vehicle.joints)))
        self._count()
        self._tell_of_capture(self.ekf.predictor.no_ticks)

    def _tell_of_capture(self, ticks: Ticks) -> None:
        self._captured.take(ticks)
        if self._answers and self.ekf.state is not None and self._captured.due:
            self._captured.tell(Payload(*self._known_payload()))

    def _count(self) -> None:
        """After the filter has gone on: count rows, and its outliers since the last call; the last answer is old."""
        self.rows_used, self._mixed = 6 * self.ekf.ticks_used, None
        self.refused[GateReason.RESIDUAL] += 6 * (self.ekf.glitches - self._counted)
        self._counted = self.ekf.glitches

    def estimate(self) -> Estimate:
        """The payload's standard parameters, and mass, centre of mass, inertia about it in its link's axes.

        An estimate that no body has is moved to the most likely one that can exist. Noise that is large against a light
        payload's inertia makes that one heavier: how far a quantity was moved is a part of its sigma.
        """
        nothing, chances = np.full(10, np.nan), np.array(REPORTED)
        mean, sigma, body, spread, shrinkage = nothing, nothing, nothing, nothing, nothing
        ends, z = np.full((4, 10), np.nan), ndtri(chances)[:, None]
        ekf = self.ekf
        note = "nothing is held" if ekf.held is False else "not determined by the data so far"
        if ekf.held is False and self._newest_s - self._taken_s > SOLVED_AT_s[0]:
            note = "nothing was held when motion was last taken in"
        fine = np.zeros(10, np.bool_)
        leans: tuple[str, ...] = ("",) * 10
        if ekf.held and not ekf.holds:
            note = "a release was announced"
        if self._answers and ekf.state is not None:
            mixture, widening = self._payload(self._weighed)
            mean, P = mixture.known
            P *= widening
            sigma = np.sqrt(np.diag(P))
            try:
                possible = possible_body(mean, P)
                D = body_jacobian(mean)
            except (SignalError, ConvergenceError) as error:
                note = str(error)
            else:
                body, estimated = numbers_of(possible), numbers_of(body_of(mean))
                own, moved, side = mixture.ends(D, chances), body - estimated, np.sign(z)
                ends = side * np.hypot(widening**0.5 * np.maximum(side * own, 0.0), z * moved)  # the mean is inside
                spread = np.hypot(np.sqrt(np.einsum("ij,jk,ik->i", D, P, D)), moved)
                wide = np.maximum(spread, (ends[3] - ends[2]) / (z[3] - z[2]))
                shrinkage = wide / np.sqrt((D**2) @ ekf.payload_sigma**2)
                fine = shrinkage <= SUPPORTED_SHRINKAGE
                fine[1:] &= wide[0] <= SUPPORTED_SHRINKAGE * mean[0]
                leans = self._causes.said(self._effects(D, mixture.shares(D, own[2:])), wide, np.abs(body), _LEANINGS)
        ends += body
        quantities = []
        for k, name in enumerate(self.quantity_names):
            numbers = np.array([body[k], spread[k], *ends[:, k]]) if fine[k] else np.full(6, np.nan)
            value, around, low, high, lowest, highest = numbers.tolist()
            told = name, BODY_UNITS[k], value, around, low, high, bool(fine[k])
            more = leans[k], (lowest, highest), float(shrinkage[k]), "" if fine[k] else note
            quantities.append(QuantityEstimate(*told, np.nan, *more))
        supported = sigma <= SUPPORTED_SHRINKAGE * ekf.payload_sigma
        return Estimate(
            self.parameter_names,
            mean,
            sigma,
            mean + z[0] * sigma,
            mean + z[1] * sigma,
            supported,
            tuple(quantities),
            self.rows_used,
            dict(self.refused),
            self._captured.quantities(known=self._answers),
        )

    @property
    def _answers(self) -> bool:
        return self.ekf.holds and self.ekf.confirmed

    def triangle(self) -> FloatArray:
        """Information ``[R z]`` of the payload's ten standard parameters, (11, 11); zeros while there is none."""
        out = np.zeros((11, 11))
        if self._answers and self.ekf.state is not None:
            mean, P = self._known_payload()
            R, failed = dpotrf(np.linalg.inv(P))
            if not failed:
                out[:10, :10], out[:10, 10] = R, R @ mean
        return out

    def findings(self) -> Findings:
        """Too many outliers, a payload replaced without a release, corrections or innovations larger than stated."""
        if refusal := self._refusal():
            return Findings((refusal,))
        predictor, fusion = self.ekf.predictor, self.ekf.fusion
        if self.ekf.state is None:
            return Findings()
        weighed = self._weighed
        names, found = predictor.names, self._corrections.of(weighed)
        slow = self.ekf.lines.slow
        each = {
            **self.ekf.misfit.by_instrument(),
            **{f"{name} below 1.5 Hz": ratio for name, ratio in slow.by_sensor(DOUBT).items()},
        }
        swaying = tuple(
            f"residuals of the {name} below 1.5 Hz are {ratio**0.5:.1f} times its noise: {_SWINGING}"
            for name, ratio in slow.by_sensor(REFUSE).items()
            if ratio > MISFIT_PART
        )
        doubts = [misfit_text(name, ratio) for name, ratio in each.items() if ratio > MISFIT_DOUBTED]
        doubts += [f"not as stated: {' or '.join(weighed.names)}"] if weighed.names else []
        doubts += [_ALTERED] * self.ekf.altered + self._of_trackers(found)
        doubts += [f"without {name}, which contradicts the others" for name in fusion.contradicting]
        doubts += [f"without {fusion.names[k]}, which gives no readings" for k in sorted(fusion.absent)]
        if line := self.ekf.lines.strongest:
            doubts.append(f"residuals of the {line.instrument} swing at {line.frequency_Hz:.2g} Hz: {_SWINGING}")
        against = too_large(dict(zip((names[k] for k in found.known.tolist()), found.in_stated.tolist(), strict=True)))
        moved = (*contradicted(self._by_the_data(found)), *found.at_once.refused())
        doubts += [*found.at_once.doubted(), *([] if self._ended else [_GIVEN_UP])]
        if not self._is_determined(weighed):  # far from it the linear test of what the data tell is not exact
            doubts, moved = [*doubts, *moved], ()
        return Findings((*swaying, *moved, *against), tuple(doubts))

    def _is_determined(self, weighed: Weighed) -> bool:
        """Whether the mass is known so well that what is known of all else follows from a linear model."""
        mean, covariance = weighed.known(weighed.likeliest, PAYLOAD)
        return not self.ekf.held or float(np.sqrt(covariance[0, 0])) < DETERMINED * float(mean[0])

    @property
    def _weighed(self) -> Weighed:
        """What may not be as stated, by the filter's state."""
        assert self.ekf.state is not None
        return self.ekf.rivals.weighed(*self.ekf.known)

    def _by_the_data(self, found: Corrections) -> dict[str, float]:
        """Corrections by name in sigmas of what the data tell of each, but for those that change during the flight."""
        names = self.ekf.predictor.names
        return dict(zip((names[k] for k in found.steady.tolist()), found.in_told.tolist(), strict=True))

    def _of_trackers(self, found: Corrections) -> list[str]:
        """What the data say against a tracker that is used, before it is enough to do without it."""
        ends = tuple(f"_{one.name}" for one in self.further if isinstance(one, FurtherPose))
        if not ends:
            return []
        off = {name: abs(one) for name, one in self._by_the_data(found).items() if name.endswith(ends)}
        return [f"{name} is {one:.1f} sigmas off" for name, one in off.items() if one > doubtful_from(len(off))]

    def _refusal(self) -> str:
        """Why no answer is to be used, whatever the estimate; empty if nothing says so."""
        glitches = self.refused[GateReason.RESIDUAL]
        share = glitches / max(self.rows_used + glitches, 1)
        if contradicted := contradicted_text(share, "ticks", self._of_what_is_left()):
            return contradicted
        if self.ekf.exchanged:
            return _EXCHANGED
        left_out, unexplained = self.ekf.fusion.contradicting, self._unexplained()
        if len(left_out) > 1:
            return f"{' and '.join(left_out)} contradict the other instruments and the joints"
        if self.ekf.undecided or self.ekf.unexplained.count or self.ekf.unexplained.swings:
            between = self.ekf.undecided or self.ekf.unexplained.between
            return between or f"{_CONTRADICTED}; {self._of_what_is_left()}"
        if too_often(unexplained, RECENT_s):
            return f"the motion changed {unexplained} times and the payload did not: {_SWINGING}"
        return "" if self._ended or self.ekf.state is not None else _GIVEN_UP

    def _of_what_is_left(self) -> str:
        """How the residual of a motion that no payload explains swings, or what to check."""
        if (line := self.ekf.unexplained.line) is None:
            return "check the IMU and the joints"
        return f"the {line.instrument} swings at {line.frequency_Hz:.2g} Hz: {_SWINGING}"

    def _known_payload(self) -> Known:
        mixture, widening = self._payload(self._weighed)
        mean, covariance = mixture.known
        return mean, np.asarray(widening * covariance, np.float64)

    def _payload(self, weighed: Weighed) -> tuple[Mixture, float]:
        """Standard parameters, (10,), over all hypotheses that count, and what their covariance is multiplied by.

        That is the largest that is above one: misfit, strongest line, power below 1.5 Hz, the
        square of the most contradicted correction over three of its sigmas, or the like of all of them together.
        """
        if self._mixed is not None and self._mixed[0] is weighed:
            return self._mixed[1:]
        line = self.ekf.lines.strongest
        misfit = max([1.0, 0.0 if line is None else line.beyond, *self.ekf.misfit.by_instrument().values()])
        misfit = max([misfit, *self.ekf.lines.slow.by_sensor(DOUBT).values()])
        found = self._corrections.of(weighed)
        worst = float(np.abs(found.in_told).max(initial=0.0))
        misfit = max(misfit, (worst / DOUBTFUL) ** 2, found.at_once.widening)
        mixture = weighed.mixed(partial(weighed.known, part=PAYLOAD))
        doubt = self.ekf.correction.sigma[PAYLOAD]  # which the misfit does not widen
        self._mixed = weighed, mixture.wider(np.outer(doubt, doubt) / misfit), misfit
        return self._mixed[1:]

    def _effects(self, along: FloatArray, shares: FloatArray) -> FloatArray:
        """What one sigma of each key of the vehicle's file does to linear functions of the payload, (m, c).

        Of what may not be as stated also what that would do, where much of what lies beyond an interval is due to it.

        Args:
            along: the functions, (m, 10).
            shares: of each hypothesis that counts in what lies beyond their intervals, (k, m).
        """
        weighed = self._weighed
        effects = self._causes.effects(along @ weighed.across(weighed.likeliest, PAYLOAD))
        effects[:, -1] = np.abs(along @ self.ekf.correction.sigma[PAYLOAD])
        for one, share in zip(weighed.counting, shares, strict=True):
            if (
                one.suspect is None
                or (cause := self._causes.at[one.suspect.at[0]]) < 0
                or not (large := share > SUPPORTED_SHRINKAGE).any()
            ):
                continue
            shift, root = weighed.effect(one, PAYLOAD)
            moved = np.hypot(along @ shift, np.linalg.norm(along @ root, axis=1))
            effects[large, cause] = np.fmax(effects[large, cause], moved[large])
        return effects

    def _unexplained(self) -> int:
        """Largest number of recent changes at any time that no capture and no ejection explained."""
        times = [one.time_s for one in self.ekf.changes if one.kind in ("contact", "instrument", "altered")]
        return max((sum(at - RECENT_s < other <= at for other in times) for at in times), default=0)

    def news(self) -> tuple[Change, ...]:
        """Captures and ejections, instruments left out and taken back, since the last call."""
        new = tuple(self.ekf.changes[self._told :])
        self._told += len(new)
        return (*new, *self.ekf.fusion.news())
