"""What a recursive estimate consists of, the payload in it, and where a window of it begins: see :mod:`.recursive`."""

from collections.abc import Callable

import numpy as np

from onboard.dynamics.model.payload import BodyEstimate, body_estimate
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.change import ChangeDetector
from onboard.estimation.policy import STEPS_PER_HOUR
from onboard.identification.evidence.bodies import changes
from onboard.identification.evidence.mixture import Known
from onboard.identification.free_flyer.fusion import Accusation, Fusion
from onboard.identification.free_flyer.innovation import InnovationMisfit, Innovations
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import (
    LineNoise,
    NoiseAdded,
    NoiseCorrection,
    correction_of,
)
from onboard.identification.free_flyer.prediction.noise_in_gradient import NoiseInPieces
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS, TickPrediction, Ticks
from onboard.identification.free_flyer.recursion.bounded_work import BoundedWork
from onboard.identification.free_flyer.recursion.linearised import Linearised
from onboard.identification.free_flyer.recursion.lines import InnovationLines, Unexplained
from onboard.identification.free_flyer.recursion.rounds import WindowRounds
from onboard.identification.free_flyer.recursion.snapshots import Before, Snapshots, initially
from onboard.identification.free_flyer.recursion.solved import Claim, HeldPayload, WINDOWS_s, at_first
from onboard.identification.free_flyer.recursion.stepped import SteppedTicks
from onboard.identification.free_flyer.recursion.trials import CellTrials, WindowFits, WindowProblem, trials_of
from onboard.identification.free_flyer.recursion.window import WindowSolve
from onboard.identification.free_flyer.suspects import Rivals
from onboard.identification.online import Change


class Windowed(BoundedWork):
    """What a recursive estimate of a payload consists of, and its windows: what is known before one, and its solve.

    Args:
        predictor: of the vehicle's IMU.
        payload_sigma: wide prior: standard deviations of the payload's standard parameters about zero, (10,).
        held: a payload is held at the start.
        false_alarms_per_hour: of the change detector, at most.
        call_ticks: ticks of a call that does not come late.
        known: standard parameters of the payload held last, (10,), and their covariance, (10, 10): the first window
            decides whether it is still held, or nothing or another one, regardless of ``held``.

    Attributes:
        state: mean, (p,), of the parameters that ``predictor`` names; None while nothing is known.
        covariance: (p, p).
        noise_added: what noise of the joints' samples has added since the start, to the payload since the last change:
            see :mod:`~onboard.identification.free_flyer.prediction.noise_in_gradient`.
        held: a payload is held; None while that is not decided.
        ticks_used: with an IMU, taken in since the start or the last change.
        glitches: number of ticks left out as outliers.
        changes: changes detected or announced so far: each detected one as ``change``, again when it is classified.
        exchanged: the payload was replaced by another one without a release, which no gripper does: an instrument or
            the model changed, and the estimate contradicts what was known before.
        altered: the payload has changed by what a part that comes off, or is added, makes; or so it seems.
        unexplained: windows that no hypothesis explains.
        undecided: which IMUs contradict each other without anything that tells the wrong one; empty if none do.
        lines: coherent lines in the reference IMU's innovations.
        innovations: of its batches; takes note of the reference IMU's.
        fusion: the instruments, and which of them are left out.
        rivals: what may not be as stated.
        misfit: of the innovations of ``gyro``, ``accelerometer`` and ``imu`` (both together) since the last window.
    """

    def __init__(
        self,
        predictor: ImuPredictor,
        payload_sigma: FloatArray,
        held: bool,
        false_alarms_per_hour: float = STEPS_PER_HOUR,
        known: Known | None = None,
        call_ticks: int = BATCH_TICKS,
    ) -> None:
        super().__init__(call_ticks, predictor.period_s, predictor.no_ticks, flexible=predictor.bends.size > 0)
        self.predictor, self.payload_sigma = predictor, np.asarray(payload_sigma, np.float64)
        self.state: FloatArray | None = None
        self.covariance = np.zeros((len(predictor.names), len(predictor.names)))
        self.noise_added = self._noise_before = NoiseAdded.none(len(predictor.names))
        # by state, covariance and noise
        self._correction: tuple[FloatArray, FloatArray, NoiseAdded, NoiseCorrection] | None = None
        self._known: tuple[NoiseCorrection, Known] | None = None  # by correction
        self.held = self._before = held if known is None else None
        self._suspected: Change | None = None  # not yet classified
        self._claim, self._none = Claim(), predictor.no_ticks
        self._left: FloatArray | None = None  # by the last one
        self.exchanged = self.altered = self._part = False  # the last: a part of the payload may be off since then
        self.undecided, self.ticks_used, self.glitches = "", 0, 0
        self.changes: list[Change] = []
        self.lines, self.unexplained = InnovationLines(predictor.period_s), Unexplained(predictor.period_s)
        self.fusion, self.misfit = Fusion(predictor.instruments, predictor.lines), InnovationMisfit()
        self._detector = ChangeDetector(false_alarms_per_hour, 3600.0 / (BATCH_TICKS * predictor.period_s), 6)
        self.snapshots, self._linearised = Snapshots(predictor.period_s), Linearised(predictor)
        self.rivals, self.initial = Rivals(predictor), initially(predictor, known)
        self.innovations = Innovations(predictor, self.fusion, self.rivals)
        self._open(at_first(held, known is not None), self.initial)

    @property
    def holds(self) -> bool:
        """A payload is held and its state known, and no release of it is announced, be it taken in or not."""
        return self.state is not None and bool(self.held) and not self.lets_go

    def estimate(self) -> BodyEstimate | None:
        """The payload in its link's frame; None if none is held or it is still unknown (its mass not positive)."""
        if not self.holds or self.state is None or not self.state[PAYLOAD][0] > 0.0:
            return None
        (mean, covariance), doubt = self.known, self.correction.sigma[PAYLOAD]
        return body_estimate(mean[PAYLOAD], covariance[PAYLOAD, PAYLOAD] + np.outer(doubt, doubt))

    @property
    def known(self) -> Known:
        """Mean, (p,), and covariance, (p, p), without what noise of the joints has done; the same for the same."""
        assert self.state is not None
        known = self.state, self.covariance
        if self.noise_added.information.size or self.noise_added.gradient.any():
            of, by = self._known, self.correction
            if of is None or of[0] is not by:
                of = self._known = by, (self.state + by.shift, self.covariance + by.root @ by.root.T)
            known = of[1]
        self.rivals.corrected(known[0], (self.state, self.covariance))
        return known

    def _noise_of(
        self, ticks: Ticks, noise: FloatArray, lines: LineNoise, use: BoolArray, at: tuple[FloatArray, TickPrediction]
    ) -> NoiseAdded:
        """Take in what noise of the joints adds in a batch, of lines in use, (b, m), predicted at a state; that."""
        if self.state is not None and ticks.sample_sigma.any():
            first = round(float(ticks.time_s[0]) / self.predictor.period_s)
            added = NoiseInPieces(self.predictor, ticks, lines, use, self.state, first, noise, at).whole()
            self.noise_added = self.noise_added.plus(added.moved(-self.predictor.lasting * self.state))
            return added
        return NoiseAdded.none(len(self.predictor.names))

    @property
    def correction(self) -> NoiseCorrection:
        """Of the state, for noise of the joints."""
        assert self.state is not None
        of = self._correction
        if of is None or of[0] is not self.state or of[1] is not self.covariance or of[2] is not self.noise_added:
            raw = self.state, self.covariance
            here = self.noise_added.moved(self.predictor.lasting * self.state)
            released = self.rivals.released(self.rivals.freed)
            made = correction_of(raw, here, self.predictor.constant, released)
            of = self._correction = *raw, self.noise_added, made
        return of[3]

    def _posed(self, ticks: Ticks, trial: WindowProblem) -> WindowSolve:
        without = [*self.fusion.left_out, *trial.without]
        off = self.rivals.places(() if trial.stated else (*self.rivals.freed, *trial.free))
        measured, noise = self.fusion.without(without, ticks.measured), self.predictor.rippled(ticks, off)
        seen = ticks._replace(measured=measured, joint_sigma=noise)
        imu = next(k for k in self.fusion.imus if k not in trial.without)
        prior, start = self.innovations.freed(self.initial if trial.anew else self._prior, trial.freed), self._start
        if self._stepped is not None and self._earlier is not None and self.state is not None:
            prior, start = self._earlier.if_held(self._prior, (self.state, self.covariance), self.predictor, seen, imu)
        carried = self._prior[0] is not self.initial[0]
        self._of, steps = (ticks, trial), self.rivals.steps.inside(len(seen.time_s) - 2, carried=carried)
        steps = steps if trial.about is None else steps.about(trial.about)
        if trial.stated or trial.wrong:
            prior = self.rivals.stated(prior) if trial.stated else self.rivals.with_free(prior, trial.free)
            start = trial.start
        parts = seen, prior, trial.hypotheses, start
        before = None if trial.anew else self._noise_before
        free = self.rivals.released(() if trial.stated else (*self.rivals.freed, *trial.free))
        taken = steps.taken(trial.stepped)
        return WindowSolve(self.predictor, self.payload_sigma, *parts, imu, steps, taken, before, free)

    def _open(
        self, hypotheses: tuple[HeldPayload, ...], prior: Known, begun: Ticks | None = None, *, carried: bool = False
    ) -> None:
        """Begin a window with an unknown rate.

        Args:
            hypotheses: on it.
            prior: what is known before it.
            begun: with these ticks, and solve it at 2 s.
            carried: the prior has what the ticks before it told.
        """
        self.rivals.begin(prior if carried else None)
        self._hypotheses, self._prior = hypotheses, prior
        self._solves, self._grown, self._awaits = int(begun is not None), 1.0, False  # what was before a change
        self.unexplained.begin(change=self._suspected is not None)
        self._start: FloatArray | None = None
        self._window, self._pending = self._none, self._none if begun is None else begun
        self._trials: WindowFits | CellTrials | None = None  # fits that tell which instrument is wrong
        self._stepped: SteppedTicks | None = None  # ticks of the window and of the steps since
        self._earlier: Before | None = None  # motion before the change, while it is not known what was held
        self._accused: Accusation | None = None  # the window is solved without it
        self._rounds = WindowRounds(self.rivals)
        for one in (self._detector, self.misfit, self.lines, self.fusion, self._linearised, self.rivals.steps):
            one.forget()
        self.snapshots.clear()

    def _reopen(self, hypotheses: tuple[HeldPayload, ...], batches_back: int | None, *, altered: bool = False) -> None:
        """Begin a window with what was known so many batches ago; None: before the first tick.

        ``altered``: but for the payload, a part of which has come off or been added.
        """
        now, noise, carried = self._prior, self._noise_before, False
        if batches_back is None:
            now, noise = self.initial, NoiseAdded.none(len(self.predictor.names))
        elif len(self.snapshots):
            then, carried = self.snapshots.back(batches_back), True
            (now, self.initial), noise = self.rivals.adopting(then.known, then.step, self.initial), then.noise
        elif self.state is not None:
            now, noise = (self.state, self.covariance), self.noise_added
        self._noise_before = noise
        if altered:
            by, covariance = changes(now[0][PAYLOAD]), now[1].copy()
            covariance[PAYLOAD, PAYLOAD] += by @ by.T
            now = now[0], covariance
        self.state, self.held, self.ticks_used = None, None, 0
        self._open(hypotheses, now, carried=carried)

    def _wanted(self) -> int:
        whole = self._window_ticks() + self.unexplained.wait if self._hypotheses else BATCH_TICKS + 2
        return max(whole - len(self._pending.time_s), 0)

    def _window_ticks(self) -> int:
        return round(self._grown * WINDOWS_s[self._solves] / self.predictor.period_s)

    def _trials_now(self, accused: int | None) -> WindowFits | CellTrials:
        window = self._solves or int(accused is None and self.unexplained.count > 0)  # no contact takes so long
        return trials_of(self.fusion, self._hypotheses, accused, window, len(WINDOWS_s))

    def _free_before(self, free: Callable[[Known], Known]) -> None:
        """The same of what was known before now."""
        first, self.initial = self._prior[0] is self.initial[0], free(self.initial)
        self._prior = self.initial if first else free(self._prior)
        self.snapshots.become(free)

    def _free(self, free: Callable[[Known], Known]) -> None:
        """Go on as if everything may be wrong that is suspected."""
        assert self.state is not None
        self._free_before(free)
        self.state, self.covariance = free((self.state, self.covariance))
        self._earlier, self._asked = None, None if self._stepped is None else self._stepped.asked
        self._linearised.begin_anew()
