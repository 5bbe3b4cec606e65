"""Recursive non-linear ExIDDM: onboard estimate of a free-flyer's payload from joints and base IMU.

The same likelihood as :mod:`onboard.identification.exiddm.batch`, processed in batches of ticks by an extended Kalman
filter with all unknowns as its state: the base's rate, payload, IMU errors, uncertain links. Linearisation far from
the truth is wrong, so the first seconds are solved as one growing window
(:mod:`onboard.identification.exiddm.recursion.window`); after that every batch is one filter step. Steps linearised
about a payload that is still far off are replaced by a window that has them all
(:mod:`onboard.identification.exiddm.recursion.stepped`). Where a motion tells little (a light payload, slow motions),
the window grows until it determines the mass.

At a change the estimates of rate and payload are reset, all others are kept, and a new window begins. The hypothesis
that fits that window classifies it: nothing held (an ejection, or a contact if nothing was), the same payload (a
contact), a payload where nothing was held (a capture), or another payload without a release (an instrument's change).

The effect of the joints' noise, mainly gear transmission error, is added to the IMU's noise.

The work of a call is bounded (:mod:`onboard.identification.exiddm.recursion.bounded_work`).
"""

from collections.abc import Callable

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.change import ChangeDetector
from onboard.estimation.errors import SingularError
from onboard.identification.change import Change
from onboard.identification.evidence.bank import Known
from onboard.identification.exiddm.fusion import Accusation, Fusion
from onboard.identification.exiddm.guesses import first_state
from onboard.identification.exiddm.innovation import Innovations, TickBatch
from onboard.identification.exiddm.misfit import InnovationMisfit
from onboard.identification.exiddm.prediction.imu_prediction import ImuPredictor
from onboard.identification.exiddm.prediction.ticks import BATCH_TICKS, Ticks
from onboard.identification.exiddm.recursion.claims import Claim, after_a_change, at_first, kind_of
from onboard.identification.exiddm.recursion.holding import Holding
from onboard.identification.exiddm.recursion.linearised import Linearised
from onboard.identification.exiddm.recursion.lines import InnovationLines, Unexplained
from onboard.identification.exiddm.recursion.snapshots import Before, Snapshots, initially
from onboard.identification.exiddm.recursion.stepped import SteppedTicks
from onboard.identification.exiddm.recursion.trials import CellTrials, Exclusion, WindowFits, WindowProblem, trials_of
from onboard.identification.exiddm.recursion.window import HeldPayload, Solved, WindowSolve
from onboard.identification.exiddm.suspects import Rivals

SOLVED_AT_s = (1.0, 2.0, 4.0)  # times after the start or a change at which the window is solved
_WINDOWS_s = *SOLVED_AT_s, 8.0  # the longest where two IMUs contradict each other
DETERMINED = 0.1  # relative sigma of the payload's mass below which filter steps are used


class RecursiveExiddm(Holding):
    """Recursive estimate of a payload.

    Args:
        predictor: of the vehicle's IMU.
        payload_sigma: wide prior: standard deviations of the payload's standard parameters about zero, (10,).
        held: a payload is held at the start.
        false_alarms_per_hour: of the change detector, at most.
        call_ticks: ticks of a call that does not come late.
        known: standard parameters of the payload held last, (10,), and their covariance, (10, 10): the first window
            decides whether it is still held, or nothing or another one, regardless of ``held``.

    Attributes:
        ticks_used: with an IMU, taken in since the start or the last change.
        glitches: number of ticks left out as outliers.
        changes: changes detected or announced so far: each detected one as ``change``, again when it is classified.
        exchanged: the payload was replaced by another one without a release, which no gripper does: an instrument or
            the model changed, and the estimate contradicts what was known before.
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
        false_alarms_per_hour: float = 0.1,
        known: Known | None = None,
        call_ticks: int = BATCH_TICKS,
    ) -> None:
        super().__init__(predictor, call_ticks)
        self.payload_sigma = np.asarray(payload_sigma, np.float64)
        self.held = self._before = held if known is None else None
        self._suspected: Change | None = None  # not yet classified
        self._claim, self._none = Claim(), predictor.no_ticks
        self._left: FloatArray | None = None  # by the last one
        self.exchanged, self.undecided, self.ticks_used, self.glitches = False, "", 0, 0
        self.changes: list[Change] = []
        self.lines, self.unexplained = InnovationLines(predictor.period_s), Unexplained(predictor.period_s)
        self.fusion, self.misfit = Fusion(predictor.instruments, predictor.lines), InnovationMisfit()
        self._detector = ChangeDetector(false_alarms_per_hour, 3600.0 / (BATCH_TICKS * predictor.period_s), 6)
        self.snapshots, self._linearised = Snapshots(predictor.period_s), Linearised(predictor)
        self.rivals, self.initial = Rivals(predictor), initially(predictor, known)
        self.innovations = Innovations(predictor, self.fusion, self.rivals)
        self._open(at_first(held, known is not None), self.initial)

    def settled(self) -> bool:
        """What is known only gets better: no window is open but one that grows, none will replace the last steps."""
        replaced = self._stepped is not None and self._stepped.first
        return (not self._hypotheses or self._grown > 1.0) and not (replaced or self.solving)

    @property
    def confirmed(self) -> bool:
        """What is held was not found by a second or two alone, in which a swing of the vehicle's looks like it.

        Nor without the motion before it, where that has shown that something is not as stated and is yet to be taken
        in.
        """
        return not self._awaits and (not self._hypotheses or self.ticks_used * self._period_s > SOLVED_AT_s[1])

    def _posed(self, ticks: Ticks, trial: WindowProblem) -> WindowSolve:
        seen = ticks._replace(measured=self.fusion.without([*self.fusion.left_out, *trial.without], ticks.measured))
        imu = next(k for k in self.fusion.imus if k not in trial.without)
        prior, start = self.innovations.freed(self.initial if trial.anew else self._prior, trial.freed), self._start
        if self._stepped is not None and self._earlier is not None and self.state is not None:
            prior, start = self._earlier.if_held(self._prior, (self.state, self.covariance), self.predictor, seen, imu)
        steps = self.rivals.steps.inside(len(seen.time_s) - 2)
        return WindowSolve(self.predictor, self.payload_sigma, seen, prior, trial.hypotheses, start, imu, steps)

    def _announced(self, held: bool, time_s: float) -> None:
        if held != self.held:
            self.exchanged, self._suspected = False, None
            self.changes.append(Change("capture" if held else "ejection", time_s, time_s, np.nan))
            self._reopen(self._claim.make(held, self.estimate() is not None), 0)

    # ------------------------------------------------------------------ a window, as a whole

    def _open(self, hypotheses: tuple[HeldPayload, ...], prior: Known, begun: Ticks | None = None) -> None:
        """Begin a window with this prior and an unknown rate; ``begun``: with these ticks, and solve it at 2 s."""
        self._hypotheses, self._prior = hypotheses, prior
        self._solves, self._grown, self._awaits = int(begun is not None), 1.0, False  # what was before a change
        self.unexplained.begin(change=self._suspected is not None)
        self._start: FloatArray | None = None
        self._window, self._pending = self._none, self._none if begun is None else begun
        self._trials: WindowFits | CellTrials | None = None  # fits that tell which instrument is wrong
        self._stepped: SteppedTicks | None = None  # ticks of the window and of the steps since
        self._earlier: Before | None = None  # motion before the change, while it is not known what was held
        self._accused: Accusation | None = None  # the window is solved without it
        for one in (self._detector, self.misfit, self.lines, self.fusion, self._linearised, self.rivals.steps):
            one.forget()
        self.snapshots.clear()

    def _reopen(self, hypotheses: tuple[HeldPayload, ...], batches_back: int | None) -> None:
        """Begin a window with what was known so many batches ago; None: before the first tick."""
        now = self._prior if self.state is None else (self.state, self.covariance)
        self._noise_before = self.noise_added * (batches_back is not None)
        if batches_back is None:
            now = self.initial
        elif len(self.snapshots):
            now, self.initial = self.rivals.adopting(*self.snapshots.back(batches_back), self.initial)
        self.state, self.held, self.ticks_used = None, None, 0
        self._open(hypotheses, now)

    def _ready(self) -> None:
        self.fusion.run(float(self._pending.time_s[-1]))
        self._begin_window() if self._hypotheses else self._step()

    def _wanted(self) -> int:
        whole = self._window_ticks() + self.unexplained.wait if self._hypotheses else BATCH_TICKS + 2
        return max(whole - len(self._pending.time_s), 0)

    def _window_ticks(self) -> int:
        return round(self._grown * _WINDOWS_s[self._solves] / self.predictor.period_s)

    def _begin_window(self) -> None:
        """Ask for the window; where one instrument is accused, for the fits that tell whether it is wrong."""
        self._window = self._pending.part(slice(-self._window_ticks(), None))
        self.fusion.expect(self._window.measured)
        self._trials = None if self._accused is None else self._trials_now(self._accused.instrument)
        self._ask()

    def _trials_now(self, accused: int | None) -> WindowFits | CellTrials:
        window = self._solves or int(accused is None and self.unexplained.count > 0)  # no contact takes so long
        return trials_of(self.fusion, self._hypotheses, accused, window, len(_WINDOWS_s))

    def _ask(self) -> None:
        """Ask for the window with all instruments, or for the next trial."""
        self._asked = self._window, (self._trials and self._trials.next()) or WindowProblem(self._hypotheses)

    def _end_of(self, solve: WindowSolve) -> None:
        """Take in the result of a window."""
        found, self._left = solve.found, solve.left
        self._linearised.forget()
        if self._stepped is not None and self._earlier is not None:
            if found is not None and found.hypothesis is HeldPayload.NOTHING:
                self._prior = self._earlier.known
            self._earlier, self._asked = None, self._stepped.asked
            return
        if not self._hypotheses:  # steps since the window are replaced; unexplained, they stay, and are not to be used
            stepped, self._stepped, self._awaits = self._stepped, None, False
            assert stepped is not None
            self.unexplained.count += found is None and stepped.first
            if found is not None:
                self._stepped = stepped.after(found)
                self._go_on_from(found)
            assert self.state is not None
            self.snapshots.append(self.state, self.covariance)
            return
        if self._trials is not None:
            self._trials.take(found)
        elif found is not None or self._grown > 1.0 or self._claim.unseen:  # a change before a wrong instrument
            self._not_explained() if found is None else self._explained(found)
            return
        else:
            self._trials = self._trials_now(None)
        self._ask() if self._trials.next() is not None else self._judge(self._trials.choice)

    def _judge(self, choice: Exclusion | None) -> None:
        """Leave out the instrument without which the window is explained, if that is one, or one much better."""
        accused = self._accused
        if choice is None and accused is not None:
            self._acquit(accused)
        elif choice is None or (accused is None and not choice.clear):
            self._not_explained(choice.doubt(self.fusion.names) if choice else "")
        elif not choice.clear and self._solves + 1 < len(_WINDOWS_s):
            self._solves += 1  # wait for a longer window
        else:
            self._accused, self.undecided = None, self.undecided or choice.doubt(self.fusion.names)
            self._do_without(choice, accused)

    def _do_without(self, choice: Exclusion, accused: Accusation | None) -> None:
        """Go on from the window without an instrument; anew, if what was known before may come from it.

        That of an accused one is from before it was, but a tracker tells of all the time that it was used.
        """
        anew, length = choice.instrument in self.fusion.trackers, self._solves
        old = self._prior[0] is not self.initial[0] and (accused is None or choice.instrument == self.fusion.reference)
        self.fusion.leave_out(choice.instrument, for_good=accused is None or accused.for_good)
        self._explained(choice.found, instrument=True)
        if anew or (old and (not self.held or self.innovations.misled(choice.found.state))):
            window, self._asked = self._window, None
            self._reopen((HeldPayload.NEW if self.held else HeldPayload.NOTHING,), None)
            self._pending, self._solves = window, length

    def _not_explained(self, between: str = "") -> None:
        """The contact may not be over; estimates of the other unknowns are kept.

        Args:
            between: which instruments contradict each other, if it is explained without either of them.
        """
        self._hypotheses, unseen = self._claim.otherwise(self._hypotheses, self._window.time_s)
        if unseen is not None:
            self._before, self._suspected = HeldPayload.SAME in self._hypotheses, unseen
            self.changes.append(unseen)
        # a window that has grown contradicts none before it: they determined nothing
        longer = self._solves > 0 and self._grown == 1.0
        self.unexplained.add(float(self._window.time_s[-1]), self._left, longer=longer, between=between)
        self.state, self.held, self._start, self._solves, self._grown = None, None, None, 0, 1.0
        self._pending = self._pending.part(slice(-self._window_ticks(), None))

    def _explained(self, solved: Solved, *, instrument: bool = False) -> None:
        """Take in a solved window; ``instrument``: an instrument was wrong, and is left out of it."""
        ticks, hypothesis = self._pending.part(slice(-self._window_ticks(), None)), solved.hypothesis
        if self._suspected is not None:
            self.changes.append(self._suspected._replace(kind=kind_of(bool(self._before), hypothesis, instrument)))
            self._suspected = None
        self.changes += self._claim.settle(hypothesis, float(ticks.time_s[-1]))
        if len(self._hypotheses) > 1:
            self.exchanged = hypothesis is HeldPayload.NEW and self._before is True
        self.held = hypothesis is not HeldPayload.NOTHING
        self._go_on_from(solved)
        self._hypotheses, self.unexplained.wait, self._pending = (hypothesis,), 0, ticks
        if hypothesis is HeldPayload.NEW and self._solves + 1 < len(SOLVED_AT_s):
            self._solves += 1
        elif hypothesis is HeldPayload.NEW and solved.mass_sigma >= DETERMINED:
            told, grown = solved.growth(self._grown, float(self.payload_sigma[0]))
            whole, self._grown, self._start = grown > self._grown, grown, solved.start if told else None
            if self._claim.held and not solved.tells_mass:  # is anything held at all?
                self._hypotheses = (HeldPayload.NOTHING,)
                self._begin_window()
            elif not whole:
                self._pending = ticks.part(slice(len(ticks.time_s) // 2, None))
                if told:
                    self._start = first_state(self.predictor, self._pending, solved.start, self.fusion.imus[0])
        else:
            self.glitches += solved.glitches
            self._hypotheses, self._pending, self.covariance = (), ticks.part(slice(-2, None)), solved.kept
            self.unexplained.settle()
            self._stepped = SteppedTicks.since(ticks, solved, self.predictor, self._prior, grown=self._grown > 1.0)
            if self._stepped and self._earlier and self.rivals.weighed(*self._earlier.known).names:
                self._asked, self._awaits = self._earlier.asked, True

    def _go_on_from(self, solved: Solved) -> None:
        self._start, self.state, self.covariance, self.ticks_used = solved[1:5]
        self.noise_added = solved.noise_added + (solved.hypothesis is HeldPayload.SAME) * self._noise_before
        self.lines.begin(solved.residual)
        self.rivals.steps.begin(solved.steps)

    # ------------------------------------------------------------------ a batch, as a step

    def _step(self) -> None:
        assert self.state is not None
        ticks, self._due, self._window = self._pending, self._due - self._step_work, self._none
        step = self.rivals.step(self.corrected(self.state), self.covariance) if self.held else None
        with np.errstate(over="ignore", invalid="ignore"):
            about, predicted = self._linearised.predict(ticks, self.state)
            noise, of_samples = self.predictor.joint_noises(ticks.q, self.state, ticks.joint_sigma, ticks.sample_sigma)
        self.covariance = self._linearised.known(self.covariance)
        batch = TickBatch(predicted, ticks.measured[1:-1], np.hypot(ticks.sigma, noise)[1:-1], ticks.time_s[1:-1])
        state, covariance, suspect, used = self.state, self.covariance, False, 0
        there = self.fusion.whole(batch.measured)
        try:
            innovation = self.innovations.of_batch(batch, there, covariance)
        except SingularError:
            self.glitches += BATCH_TICKS
            self._reopen((HeldPayload.SAME if self.held else HeldPayload.NOTHING,), 1)
            return
        own = self.predictor.lines[self.fusion.reference]
        base = np.flatnonzero(there[:, own.start])  # ticks with the reference
        if base.size:
            verdict = self._detector.check((innovation.judged(step).of_reference[base] ** 2).sum(axis=1))
            if verdict.alarm:
                self._alarm(verdict.score, verdict.batches)
                return
            suspect = verdict.suspect
            if verdict.glitches.any() and not suspect:
                self.glitches += int(verdict.glitches.sum())
                there[base[verdict.glitches], own] = False
                innovation = self.innovations.of(batch, there, self.fusion.order, covariance)
            judged = self.innovations.judge(innovation.judged(step), there, self.misfit)
            self.lines.add(judged, there[:, own.start])
        if not suspect:
            innovation, used = self.innovations.agreeing(batch, there, covariance, innovation, self.misfit, step)
            state, covariance = innovation.corrected(used, state, covariance)
            self.ticks_used += int(there[:, own.start].sum())
            seen = np.isfinite(self.fusion.without(self.fusion.left_out, batch.measured))
            self._noise_of(ticks, of_samples, batch.sigma, there & seen)
        self.state, P = self.predictor.carried(predicted, about, state, covariance, ticks.joint_sigma)
        self.covariance = 0.5 * (P + P.T)  # else what rounding leaves of P - P' grows until S is not positive definite
        self.rivals.steps.step(innovation.first(used), predicted.transition)
        self._pending = ticks.part(slice(BATCH_TICKS, None))
        if self._stepped is not None:
            self._prior, begun = self._stepped.add(ticks, self.predictor, self._prior)
            if begun is not None:
                self._open((HeldPayload.NOTHING,), self._prior, begun)
                return
            if self._stepped.due(apart=self._linearised.apart):
                self._asked = self._stepped.asked if self._earlier is None else self._earlier.asked
                return
            self._stepped = None if self._stepped.over else self._stepped
        adds = self.rivals.adds(self.corrected(self.state), self.covariance) if self.held else None
        self.snapshots.append(self.state, self.covariance, adds)
        self.snapshots.moves(None if ticks.rest else ticks)
        if not suspect:
            self._compare()

    def _free(self, free: Callable[[Known], Known]) -> None:
        """Go on as if everything may be wrong that is suspected."""
        assert self.state is not None
        first, self.initial = self._prior[0] is self.initial[0], free(self.initial)
        self._prior = self.initial if first else free(self._prior)
        self.state, self.covariance = free((self.state, self.covariance))
        self.snapshots.become(free)
        self._earlier, self._asked = None, None if self._stepped is None else self._stepped.asked
        self._linearised.begin_anew()

    def _compare(self) -> None:
        """Begin a window without an instrument that contradicts the others over some time, if nothing else is wrong."""
        assert self.state is not None
        # an empty arm that seems to be heavier than drawn may hold something: a change decides
        if self.held and (free := self.rivals.freeing(self.corrected(self.state), self.covariance)) is not None:
            self._free(free)
            return
        accused = self.fusion.standing(self.innovations.contradicting(self.corrected(self.state), self.covariance))
        if accused is not None:
            self._before = bool(self.held)
            kept = HeldPayload.SAME if accused.batches else HeldPayload.NEW
            self._reopen((kept if self.held else HeldPayload.NOTHING,), accused.back)
            self._accused = accused

    def _acquit(self, accused: Accusation) -> None:
        """It is a change that the accused instrument has shown; of what kind, the trials may have found."""
        back_s = (accused.batches + 1) * BATCH_TICKS * self.predictor.period_s
        times = float(self._pending.time_s[-1]), float(self._pending.time_s[0]) - back_s
        self._accused, self._suspected = None, Change("change", *times, np.nan)
        self.changes.append(self._suspected)
        if self._trials is not None and self._trials.changed is not None:
            self._explained(self._trials.changed)
            return
        self._solves, self._hypotheses = 0, after_a_change(bool(self._before), self._prior[0] is not self.initial[0])
        self._begin_window()

    def _alarm(self, score: float, batches: int) -> None:
        now_s, back_s = float(self._pending.time_s[-1]), batches * BATCH_TICKS * self.predictor.period_s
        suspected = Change("change", now_s, now_s - back_s, score)
        self._claim.held, self._before, self._suspected = None, bool(self.held), suspected
        self.changes.append(self._suspected)
        back, earlier = (batches, None) if self.held else self.snapshots.since_rest(batches)
        self._reopen(after_a_change(bool(self.held)), back + 1)
        self._earlier = earlier

    def _interrupted(self) -> None:
        self._claim.unseen = True
        if self._hypotheses or self.state is None:
            self._open(self._hypotheses, self._prior)
        else:
            self._reopen((HeldPayload.SAME if self.held else HeldPayload.NOTHING,), 0)
