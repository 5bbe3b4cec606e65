"""Filter of predicted motion: onboard estimate of a free-flyer's payload from joints and base IMU.

The same likelihood as :mod:`onboard.identification.free_flyer.batch`, processed in batches of ticks by an extended
Kalman filter with all unknowns as its state: the base's rate, payload, IMU errors, uncertain links. Linearisation far
from the truth is wrong, so the first seconds are solved as one growing window
(:mod:`onboard.identification.free_flyer.recursion.window`); after that every batch is one filter step. Steps linearised
about a payload that is still far off are replaced by a window that has them all
(:mod:`onboard.identification.free_flyer.recursion.stepped`). Where a motion tells little (a light payload, slow
motions), the window grows until it determines the mass.

At a change the estimates of rate and payload are reset, all others are kept, and a new window begins. The hypothesis
that fits that window classifies it: nothing held (an ejection, or a contact if nothing was), the same payload (a
contact), that payload with a part lost or added, a payload where nothing was held (a capture), or another payload
without a release (an instrument's change).

The effect of the joints' noise, mainly gear transmission error, is added to the IMU's noise.

The work of a call is bounded (:mod:`onboard.identification.free_flyer.recursion.bounded_work`).
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from onboard.estimation.arrays import BoolArray
from onboard.estimation.errors import SingularError
from onboard.estimation.policy import HALF
from onboard.identification.free_flyer.fusion import Accusation
from onboard.identification.free_flyer.guesses import first_state
from onboard.identification.free_flyer.innovation import TickBatch
from onboard.identification.free_flyer.prediction.joint_noise import LineNoise, NoiseAdded, sigma_of
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS, Ticks
from onboard.identification.free_flyer.recursion.solved import (
    HeldPayload,
    Solved,
    SOLVED_AT_s,
    WINDOWS_s,
    after_a_change,
    kind_of,
)
from onboard.identification.free_flyer.recursion.stepped import SteppedTicks
from onboard.identification.free_flyer.recursion.trials import Exclusion, WindowProblem
from onboard.identification.free_flyer.recursion.window import WindowSolve
from onboard.identification.free_flyer.recursion.windowed import Windowed
from onboard.identification.free_flyer.steps import JumpedJoint
from onboard.identification.online import Change
from onboard.identification.quantities import Useful
from onboard.regressor.signals import EncoderJump

DETERMINED = Useful().mass / HALF  # relative sigma of the payload's mass below which filter steps are used


class MotionFilter(Windowed):
    """Recursive estimate of a payload; arguments and attributes as of :class:`Windowed`."""

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

    def _announced(self, held: bool, time_s: float) -> None:
        if held != self.held:
            self.exchanged, self.altered, self._suspected = False, False, None
            self.changes.append(Change("capture" if held else "ejection", time_s, time_s, np.nan))
            self._reopen(self._claim.make(held, self.estimate() is not None), 0)

    # ------------------------------------------------------------------ a window, as a whole

    def _ready(self) -> None:
        self.fusion.run(float(self._pending.time_s[-1]))
        self._begin_window() if self._hypotheses else self._step()

    def _begin_window(self) -> None:
        """Ask for the window; where one instrument is accused, for the fits that tell whether it is wrong."""
        self._window = self._pending.part(slice(-self._window_ticks(), None))
        self.fusion.expect(self._window.measured)
        self._trials = None if self._accused is None else self._trials_now(self._accused.instrument)
        self._ask()

    def _ask(self) -> None:
        """Ask for the window with all instruments, or for the next trial."""
        self._asked = self._window, (self._trials and self._trials.next()) or WindowProblem(self._hypotheses)

    def _end_of(self, solve: WindowSolve) -> None:
        """Take in the result of a window."""
        if self._trials is None and self._earlier is None:
            touched = self._suspected is not None or self._claim.held is not None
            if (more := self._rounds.next(self._of[1], solve, disturbed=touched)) is not None:
                self._asked = self._of[0], more
                return
            solve = self._rounds.result
            self._free_before(self._rounds.settle())
            if self._rounds.altered and not self.altered:
                self.altered, (since_s, *_, now_s) = True, self._of[0].time_s.tolist()
                self.changes += [] if self._suspected else [Change("altered", now_s, since_s, np.nan)]
        found, self._left = solve.found, solve.left
        self._linearised.forget()
        if self._stepped is not None and self._earlier is not None:
            if found is not None and found.hypothesis is HeldPayload.NOTHING:
                self._prior, self._noise_before = self._earlier.known, self._earlier.noise
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
            self.snapshots.append(self.state, self.covariance, self.noise_added)
            return
        if self._trials is not None:
            self._trials.take(found)
        elif found is not None or self._grown > 1.0 or self._claim.unseen:  # a change before a wrong instrument
            self._not_explained() if found is None else self._explained(found, instrument=self._rounds.wrong)
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
        elif not choice.clear and self._solves + 1 < len(WINDOWS_s):
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
        """Take in a solved window; ``instrument``: one was found to be wrong."""
        ticks, hypothesis = self._pending.part(slice(-self._window_ticks(), None)), solved.hypothesis
        if self._suspected is not None:
            altered = self._part or self._rounds.altered
            kind = kind_of(bool(self._before), hypothesis, instrument, altered=altered)
            self.changes.append(self._suspected._replace(kind=kind))
            self._suspected, self._part = None, False
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
                self.rivals.begin(None)
                self._rounds.forget()
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
        self.noise_added = solved.noise_added
        self.lines.begin(solved.residual)
        self.rivals.steps.begin(solved.steps, solved.state)

    # ------------------------------------------------------------------ a batch, as a step

    def _step(self) -> None:
        assert self.state is not None
        ticks, self._due, self._window = self._pending, self._due - self._step_work, self._none
        step, correction = self.rivals.step(*self.known) if self.held else None, self.correction
        with np.errstate(over="ignore", invalid="ignore"):
            about, predicted, values = self._linearised.predict(ticks, self.state)
            sigmas = self.predictor.rippled(ticks, self.rivals.freed_at), ticks.sample_sigma  # all there is; of samples
            of_joints, of_samples = self.predictor.joint_noises(ticks.q, self.state, *sigmas)
        self.covariance = self._linearised.known(self.covariance)
        noise = LineNoise.of(ticks.sigma, of_joints).part(slice(1, -1))
        batch = TickBatch(predicted, ticks.measured[1:-1], noise, ticks.time_s[1:-1], correction)
        state, covariance, suspect, used = self.state, self.covariance, False, 0
        added = NoiseAdded.none(len(state))
        there = self.fusion.whole(batch.measured)
        try:
            innovation = self.innovations.of_batch(batch, there, covariance)
        except SingularError:
            self.glitches += BATCH_TICKS
            self._reopen((HeldPayload.SAME if self.held else HeldPayload.NOTHING,), 1)
            return
        own = self.predictor.lines[self.fusion.reference]
        base, judged = np.flatnonzero(there[:, own.start]), innovation.judged(step)  # ticks with the reference
        if base.size:
            verdict = self._detector.check((judged.of_reference[base] ** 2).sum(axis=1))
            if verdict.alarm:
                self._alarm(verdict.score, verdict.batches)
                return
            suspect = verdict.suspect
            if verdict.glitches.any() and not suspect:
                self.glitches += int(verdict.glitches.sum())
                there[base[verdict.glitches], own] = False
                innovation = self.innovations.of(batch, there, self.fusion.order, covariance)
                judged = innovation.judged(step)
            self.lines.add(self.innovations.judge(judged, there, self.misfit), there[:, own.start])
        if not suspect:
            both = innovation, judged
            innovation, used = self.innovations.agreeing(batch, there, covariance, both, self.misfit, step)
            state, covariance = innovation.corrected(used, state, covariance)
            self.ticks_used += int(there[:, own.start].sum())
            seen = np.isfinite(self.fusion.without(self.fusion.left_out, batch.measured))
            at = about, predicted._replace(values=values)
            added = self._noise_of(ticks, sigma_of(of_samples), noise, there & seen, at)
        # symmetric, else what rounding leaves of P - P' grows until S is not positive definite
        self.state, self.covariance = self.predictor.carried(predicted, about, state, covariance, ticks.joint_sigma)
        # of an arm at rest, accelerations are noise of its encoders, and would show a lighter payload or a cell's zero
        told = innovation.first(0 if ticks.rest else used)
        self.rivals.steps.step(told, predicted.transition, self.state, added)
        self._pending = ticks.part(slice(BATCH_TICKS, None))
        if self._stepped is not None and self._solved_anew(self._stepped, ticks):
            return
        adds = self.rivals.adds(*self.known) if self.held else None
        self.snapshots.append(self.state, self.covariance, self.noise_added, adds)
        self.snapshots.moves(None if ticks.rest else ticks)
        if not suspect:
            self._compare()

    def _solved_anew(self, stepped: SteppedTicks, ticks: Ticks) -> bool:
        """Whether ticks since a window, a batch more, are a window, or one is asked for."""
        self._prior, begun = stepped.add(ticks, self.predictor, self._prior)
        if begun is not None:
            self._open((HeldPayload.NOTHING,), self._prior, begun)
            return True
        if stepped.due(apart=self._linearised.apart):
            self._asked = stepped.asked if self._earlier is None else self._earlier.asked
            return True
        self._stepped = None if stepped.over else stepped
        return False

    def _compare(self) -> None:
        """Begin a window without an instrument that contradicts the others over some time, if nothing else is wrong."""
        known = self.known
        if self.held and (back := self.rivals.altered(*known)) is not None:
            self._begin_altered(back)
            return
        if (free := self.rivals.freeing(*known, held=bool(self.held))) is not None:
            self._free(free)
            return
        accused = self.fusion.standing(self.innovations.contradicting(*known))
        if accused is not None:
            self._before = bool(self.held)
            kept = HeldPayload.SAME if accused.batches else HeldPayload.NEW
            self._reopen((kept if self.held else HeldPayload.NOTHING,), accused.back)
            self._accused = accused

    def _begin_altered(self, batches: int) -> None:
        """A window follows: what the filter knows is linear in a change of the payload, of which the motion is not."""
        now_s = float(self._pending.time_s[-1])
        since_s = now_s - batches * BATCH_TICKS * self.predictor.period_s
        self.altered = self._before = self._part = True
        self._suspected = Change("change", now_s, since_s, np.nan)
        self.changes.append(self._suspected)
        self._reopen((HeldPayload.SAME,), batches, altered=True)

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
        self._begin_anew()

    def _jumped(self, joint: str, jump: EncoderJump) -> None:
        self._begin_anew()
        self._free_before(self.rivals.jumped(JumpedJoint(self.predictor, joint, jump)))

    def _begin_anew(self) -> None:
        """Begin a window with what is known now."""
        if self._hypotheses or self.state is None:
            self._open(self._hypotheses, self._prior)
        else:
            self._reopen((HeldPayload.SAME if self.held else HeldPayload.NOTHING,), 0)


def feed_filter(
    ekf: MotionFilter,
    ticks: Ticks,
    held: BoolArray,
    jumps: Sequence[tuple[str, EncoderJump]],
    before: bool | None,
    take: Callable[[Ticks], None],
) -> bool | None:
    """Give a filter ticks, and before those that they are of jumps of encoders, captures and releases.

    Args:
        ekf: the filter.
        ticks: further ones.
        held: whether a payload is at each of them, (n,).
        jumps: of encoders, by joint.
        before: whether one was before them; None: not known.
        take: gives it ticks between which nothing is announced.

    Returns:
        Whether one is at the last of them.
    """
    n = len(held)
    jumped_at = [int(np.searchsorted(ticks.time_s, 1e-9 * jump.vehicle_ns)) for _, jump in jumps]
    later = sorted({*(np.flatnonzero(np.diff(held)) + 1).tolist(), *jumped_at, n} - ({0} if n else set()))
    for first, last in pairwise([0, *later]):
        for at, jump in zip(jumped_at, jumps, strict=True):
            if at == first:
                ekf.jumped(*jump)
        now = bool(held[first]) if n else before
        if now is not None and before is not None and now != before:
            ekf.announce(now, float(ticks.time_s[first]))
        before = now
        take(ticks.part(slice(first, last)))
    return before
