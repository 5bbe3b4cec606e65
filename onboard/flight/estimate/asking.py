"""Requests motion segments while intervals are wider than wanted; reports when the goal is met or cannot be reached.

Decisions use only the estimator's state at its steps, so that a replay requests the same segments. A segment is
requested when the arm rests in the posture common to all segments. A segment is allowed if it keeps the limits with
every payload mass in the present interval: at first all masses of the library, so that the first motions are small. A
payload caught at rest becomes visible when the arm moves: if the flight began with nothing held and nothing was
released, a small motion is requested from time to time. If the allowed motions add no information, the event names the
motion that would and the limit that forbids it, or the tolerances that remain.
"""

from typing import NamedTuple

import numpy as np

from drivers.records import Batch, Severity, event
from onboard import channels, config
from onboard.channels import Act
from onboard.config.methods import OF_A_FREE_BASE
from onboard.config.mission import Goal, goals_of
from onboard.config.segments import Library
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.payload import body_jacobian, body_of
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.estimation.policy import AGAIN, HALF
from onboard.flight.estimate.hand_over import EVERY_NS
from onboard.flight.estimate.problem.identification import build_free_flyer
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.free_flyer.prediction.further import TURNING_rad_s
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, RATE
from onboard.identification.free_flyer.prediction.ticks import RESTS_rad_s
from onboard.identification.free_flyer.recursion.recursive import MotionFilter
from onboard.identification.free_flyer.segment_choice import Asked, after, choose, in_the_end, reduced, shares
from onboard.identification.online import OnlineIdentifier
from onboard.identification.quantities import Estimate

_FIRST_LATE_s = 60.0  # of an arm that has other things to do first
_NEAR_rad = 0.05  # an arm at rest in the posture
_LITTLE = AGAIN**-0.5  # of the ratio: a segment that gains less than this may be the last
_FEWEST = 3  # segments that tell nothing, or in which the arm does not move, before it is given up
_PROBES = 5  # motions with nothing known to be held


class _Known(NamedTuple):
    """What is known of the payload at a step."""

    covariance: FloatArray  # (p, p)
    rate_rad_s: float  # of the base now
    masses_kg: tuple[float, float]  # that it may have
    asked: Asked
    widened: float  # variance reported over that of the filter


class Asking:
    """Requests of one flight.

    Args:
        vehicle: with ``[mission]``.
        library: its segments.
        online: the estimator.
        model: of the vehicle.

    Raises:
        ConfigError: the goal or the segments do not fit the vehicle.
    """

    def __init__(
        self, vehicle: config.Vehicle, library: Library, online: OnlineIdentifier, model: VehicleModel
    ) -> None:
        mission = vehicle.file.mission
        assert mission is not None
        if not isinstance(online, MotionIdentifier):
            raise config.ConfigError(f"{vehicle.label}: [mission] needs {OF_A_FREE_BASE}")
        predictor = online.ekf.predictor
        if library.unknowns != tuple(predictor.names) or library.joints != tuple(j.name for j in model.joints):
            text = "segments were made for another vehicle file: make them again with heft plan --segments"
            raise config.ConfigError(f"{vehicle.label}: {text}")
        self.library, names = library, online.quantity_names
        self._give_up_s, self.probe_s = mission.give_up_s, mission.probe_s
        self._wanted = list[tuple[Goal, int]]()  # with the number of each quantity that it means
        for goal in goals_of(mission.until):
            if not (own := goal.names(names)):
                known = f"mass, centre, inertia, {', '.join(names)}"
                raise config.ConfigError(f"{vehicle.label}: until {goal.name}: the quantities are {known}")
            self._wanted += [(goal, names.index(name)) for name in own]
        self._text = mission.until
        self.prior = np.diag(np.nan_to_num(predictor.sigma) ** 2)
        self.prior[PAYLOAD, PAYLOAD] = np.diag(online.ekf.payload_sigma**2)
        self.prior[RATE, RATE] = TURNING_rad_s**2 * np.eye(3)
        identifier, _ = build_free_flyer(vehicle.with_row_rate(library.ticks_hz))
        self._predictor = identifier.ekf.predictor  # of the segments, at their coarse ticks
        self._motions = [_motion(library, k) for k in range(len(library.names))]
        self.own: list[FloatArray | None] = [None] * len(library.names)  # information roots about the present estimate
        self._turn = 0  # segment that is linearised next
        self.ratios: list[float] = []  # at each request
        self._number = self.since_change = self._unmoved = 0  # the last: requests from the last that moved the arm
        self._over = self.moved = self._asks = False
        self._held_s: float | None = None  # since when a payload is
        self._met_s: float | None = None  # since when the goal is met
        self._idle_s: float | None = None  # since when the arm rests with nothing held
        self._until_s = self._late_s = -np.inf  # of the segment that is played: when it is over, and at the latest
        self._changes = 0

    def step(
        self, now_ns: int, time_s: float, joints: FloatArray, rate: FloatArray, online: OnlineIdentifier
    ) -> list[Batch]:
        """A REQUEST and its event, where there is something to say.

        Args:
            now_ns: time of the step.
            time_s: of its last tick.
            joints: angle and rate at its last tick, (2, joints).
            rate: of the base by its gyro, (3,), rad/s.
            online: the estimator.
        """
        assert isinstance(online, MotionIdentifier)
        ekf = online.ekf
        if len(ekf.changes) != self._changes:  # another payload, or none: all begins anew
            self._changes, self.since_change, self._met_s, self._unmoved = len(ekf.changes), 0, None, 0
            self._over, self._held_s, self._idle_s, self.ratios = False, None, None, []
            self.own = [None] * len(self.own)
        if ekf.held is False:
            known = self._known(ekf, online.estimate(), float(np.linalg.norm(rate)))
            ready = self._rests(joints) and bool(np.isfinite(rate).all())
            released = any(change.kind == "ejection" for change in ekf.changes)
            return self._wait(now_ns) if released else self._probe(now_ns, time_s, known, ready=ready)
        if self._over:
            return []
        self._held_s = time_s if self._held_s is None else self._held_s
        estimate = online.estimate()
        known = self._known(ekf, estimate, float(np.linalg.norm(rate)))
        now = known.asked.ratio(known.widened * known.covariance[PAYLOAD, PAYLOAD])
        usable = ekf.settled() and not online.findings().against
        met = usable and self._is_met(estimate, known.asked)
        self._met_s = None if not met else time_s if self._met_s is None else self._met_s
        if self._met_s is not None and time_s - self._met_s >= 1e-9 * EVERY_NS:
            self._over, self._asks = True, False
            took = f"{time_s - self._held_s:.0f} s after the payload was held, {self.since_change} segments"
            return self._say(now_ns, time_s, Act.MET, "", now, now, f"{self._text}: known {took}")
        self._linearise(ekf)
        self.moved |= bool((np.abs(joints[1]) > RESTS_rad_s).any())
        rests = time_s >= self._until_s and self._rests(joints) and bool(np.isfinite(rate).all())
        why = self._stuck(time_s - self._held_s, time_s, rests=rests)
        if why:
            return self._give_up(now_ns, time_s, now, why)
        solved = ekf.state is not None and ekf.settled()
        return self._ask(now_ns, time_s, known, now, solved=solved) if rests else []

    def _wait(self, now_ns: int) -> list[Batch]:
        """Nothing is held: an event if segments were requested until now."""
        asked, self._asks = self._asks, False
        text = f"{self._text}: nothing is held; asks again, with small motions first, when something is"
        return [event(now_ns, Severity.INFO, "goal_waits", "estimation", text)] if asked else []

    def _probe(self, now_ns: int, time_s: float, known: _Known, *, ready: bool) -> list[Batch]:
        """Nothing is known to be held: request a small motion if the arm has rested for long enough."""
        self._idle_s = time_s if self._idle_s is None or not ready else self._idle_s
        waited_s = time_s - max(self._idle_s, self._until_s)
        if not ready or self._over or not self.probe_s or waited_s < self.probe_s:
            return []
        if self.since_change >= _PROBES:
            self._over = True
            text = f"{self._text}: {_PROBES} motions have shown nothing that is held; asks again when something is"
            return [event(now_ns, Severity.WARNING, "goal_waits", "estimation", text)]
        return self._ask(now_ns, time_s, known, known.asked.ratio(known.covariance[PAYLOAD, PAYLOAD]), solved=False)

    def _linearise(self, ekf: MotionFilter) -> None:
        """Linearise the next segment in turn about the present estimate; one segment a step."""
        if ekf.state is None or not ekf.holds or not ekf.state[PAYLOAD][0] > 0.0:
            return
        k, self._turn = self._turn, (self._turn + 1) % len(self.own)
        with np.errstate(over="ignore", invalid="ignore"):  # a state that is no motion is not used
            now = self._predictor.predict(*self._motions[k], ekf.state, self.library.cyclic[k])
        if now.moderate:
            whitened = now.jacobian / self.library.sigma[k][:, :, None]
            self.own[k] = reduced(whitened.reshape(-1, whitened.shape[2]), np.sqrt(np.diag(self.prior)))

    def _stuck(self, held_s: float, time_s: float, *, rests: bool) -> str:
        """Reason why no segment is requested any more, whatever the estimate; empty if there is none."""
        if held_s > self._give_up_s:
            return f"{self._give_up_s:g} s are over (give_up_s)"
        if not rests:
            late = held_s > _FIRST_LATE_s and time_s > self._late_s
            return "the arm does not rest in the posture of the segments" if late else ""
        if self._unmoved >= _FEWEST:
            return "the arm does not move when it is asked to: is it armed, have its drives stopped?"
        return ""

    def _rests(self, joints: FloatArray) -> bool:
        """Whether the arm is where segments begin."""
        q, dq = joints
        return bool(np.abs(q - self.library.posture).max() < _NEAR_rad and np.abs(dq).max() < RESTS_rad_s)

    def _known(self, ekf: MotionFilter, estimate: Estimate, rate: float) -> _Known:
        masses = self.library.masses
        body = estimate.quantities[0]
        if ekf.state is None or not ekf.held or not ekf.state[PAYLOAD][0] > 0.0:
            middle = float(np.sqrt(masses[0] * masses[-1]))
            side = (middle / 1000.0) ** (1.0 / 3.0)  # of a cube of water
            payload = np.array([middle, 0, 0, 0, *np.array([1.0, 0, 1.0, 0, 0, 1.0]) * middle * side**2 / 6.0])
            return _Known(self.prior, rate, (masses[0], masses[-1]), self._asked(payload), 1.0)
        covariance = ekf.predictor.aged(ekf.covariance, round(3.0 / ekf.predictor.period_s))
        spread = float(np.sqrt(ekf.covariance[PAYLOAD.start, PAYLOAD.start]))
        wide = (body.half / HALF / spread) ** 2 if body.supported else 1.0
        between = (max(body.low, 0.0), body.high) if body.supported else (masses[0], masses[-1])
        return _Known(covariance, rate, between, self._asked(ekf.state[PAYLOAD]), wide)

    def _asked(self, payload: FloatArray) -> Asked:
        """Rows and targets of what is asked, about a payload's standard parameters, (10,)."""
        try:
            D, (mass, _, inertia) = body_jacobian(payload), body_of(payload)
        except SignalError:
            D, mass, inertia = np.eye(10), float(payload[0]), np.eye(3)
        half_trace = 0.5 * abs(float(np.trace(inertia)))
        radius = float(np.sqrt(half_trace / mass))
        size = mass, *[radius] * 3, *[half_trace] * 6
        targets = [(goal.half if goal.unit else goal.half * size[at]) / HALF for goal, at in self._wanted]
        return Asked(D[[at for _, at in self._wanted]], np.array(targets))

    def _is_met(self, estimate: Estimate, asked: Asked) -> bool:
        own = [estimate.quantities[at] for _, at in self._wanted]
        return all(one.supported and one.half <= HALF * target for one, target in zip(own, asked.targets, strict=True))

    def _ask(self, now_ns: int, time_s: float, known: _Known, now: float, *, solved: bool) -> list[Batch]:
        library = self.library
        low, high = known.masses_kg
        if high > AGAIN * library.masses[-1] and self.since_change >= _FEWEST:
            text = f"it may weigh {high:.3g} kg, and the segments are for {library.masses[-1]:.3g} kg at most"
            return self._give_up(now_ns, time_s, now, text)
        first = max(int(np.searchsorted(library.masses, low, side="right")) - 1, 0)
        last = min(int(np.searchsorted(library.masses, high)), len(library.masses) - 1)
        between = slice(min(first, last), last + 1)
        rate = library.base_rate[:, between].max(axis=1) + known.rate_rad_s
        fits = (library.excess[:, between].max(axis=1) <= 0.0) & (rate <= library.most)
        allowed = np.flatnonzero(fits)
        at = int(np.argmin(np.abs(np.log(library.masses / np.sqrt(max(low, 1e-3) * max(high, 2e-3))))))
        both = zip(library.roots[:, at], self.own, strict=True)
        roots = [np.asarray(one, np.float64) if own is None else own for one, own in both]
        if not len(allowed):
            return self._give_up(now_ns, time_s, now, self._forbidding(known, np.arange(len(rate)), between))
        found = choose(known.covariance, roots, library.durations_s, known.asked, allowed)
        expected = found.ratio * known.widened**0.5
        stalled = solved and len(self.ratios) >= _FEWEST and now > _LITTLE * self.ratios[-_FEWEST]
        if now > 1.0 and ((expected > _LITTLE * now and self.since_change >= _FEWEST) or stalled):
            why = self._hopeless(known, roots, allowed, between)
            if not why and stalled:
                told = _most(shares(known.covariance, known.asked, library.unknowns))
                why = f"the last {_FEWEST} segments have added no information; most is by {told}"
            if why:
                return self._give_up(now_ns, time_s, now, why)
        if solved:  # else the information of the segments is in a window that is not explained yet
            self.ratios.append(now)
        name = library.names[found.segment]
        self._unmoved = 1 if self.moved or not self.since_change else self._unmoved + 1
        self.since_change, self.moved, self._asks = self.since_change + 1, False, True
        lasts_s = float(library.durations_s[found.segment]) + 1.0
        self._until_s, self._late_s = time_s + lasts_s, time_s + 2.0 * lasts_s
        text = f"{name}: half intervals are {now:.3g} times what is wanted, {expected:.3g} expected after it"
        if self._held_s is None:
            text = f"{name}: nothing is known to be held, and a payload that was caught at rest would show"
        return self._say(now_ns, time_s, Act.SEGMENT, name, now, expected, text)

    def _hopeless(self, known: _Known, roots: list[FloatArray], allowed: IndexArray, between: slice) -> str:
        """Reason why the allowed segments cannot reach the goal; empty if they may."""
        library = self.library
        left = in_the_end(known.covariance, roots, allowed)
        ratio = known.asked.ratio(known.widened * left[PAYLOAD, PAYLOAD])
        if ratio <= 1.0:
            return ""
        every = np.arange(len(roots))
        whole = in_the_end(known.covariance, roots, every)
        best = known.asked.ratio(known.widened * whole[PAYLOAD, PAYLOAD])
        if best <= 1.0:
            others = np.setdiff1d(every, allowed)
            gains = [known.asked.ratio(after(known.covariance, roots[k])) for k in others]
            return self._forbidding(known, others[[int(np.argmin(gains))]], between)
        told = _most(shares(whole, known.asked, library.unknowns))
        return f"no motion of the library would do, all leave {best:.2g} times what is wanted: most by {told}"

    def _forbidding(self, known: _Known, of: IndexArray, between: slice) -> str:
        """Which limit forbids the segment of some that is least forbidden."""
        library = self.library
        rate = library.base_rate[of][:, between].max(axis=1) + known.rate_rad_s
        over = np.maximum(library.excess[of][:, between].max(axis=1), rate / library.most - 1.0)
        k = int(of[int(np.argmin(over))])
        upto = f"with up to {min(known.masses_kg[1], library.masses[-1]):.3g} kg"
        own = float(library.base_rate[k, between].max()) + known.rate_rad_s
        if own > library.most:
            told = (
                f"the base would turn at {own:.2g} rad/s {upto}, now {known.rate_rad_s:.2g}: at most {library.most:g}"
            )
        else:
            worst = between.start + int(np.argmax(library.excess[k, between]))
            told = f"{library.breaks[k][worst]} would be {1.0 + library.excess[k, worst]:.2f} times its limit {upto}"
        return f"the motion that is missing is {library.names[k]}, and {told}"

    def _give_up(self, now_ns: int, time_s: float, now: float, why: str) -> list[Batch]:
        self._over, self._asks = True, False
        text = f"{self._text} is given up: half intervals are {now:.3g} times that"
        said = self._say(now_ns, time_s, Act.GIVEN_UP, "", now, now, text)
        return [*said, event(now_ns, Severity.WARNING, "goal_why", "estimation", why)]

    def _say(self, now_ns: int, time_s: float, act: Act, name: str, now: float, then: float, text: str) -> list[Batch]:
        row = np.zeros(1, channels.REQUEST)
        row["host_ns"], row["vehicle_ns"], row["act"], row["segment"] = now_ns, round(1e9 * time_s), act, name.encode()
        row["number"], row["ratio"], row["expected"] = self._number, now, then
        self._number += 1
        code = {Act.SEGMENT: "segment_asked", Act.MET: "goal_met", Act.GIVEN_UP: "goal_given_up"}[act]
        severity = Severity.WARNING if act is Act.GIVEN_UP else Severity.INFO
        return [Batch("request", row), event(now_ns, severity, code, "estimation", text)]


def _motion(library: Library, k: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angle, rate and acceleration of a segment at its coarse ticks, (n, joints) each."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415 - 12 MB of each process of an estimator that never asks

    ticks = int(library.ticks[k])
    spline = CubicSpline(library.time_s[:ticks], library.q[k, :ticks], bc_type="clamped")
    at = np.arange(library.cyclic.shape[1]) / library.ticks_hz
    return spline(at), spline(at, 1), spline(at, 2)


def _most(told: list[tuple[str, float]]) -> str:
    return " and ".join(f"{name} ({share:.0%})" for name, share in told[:2])
