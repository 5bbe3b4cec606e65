"""Maximum likelihood fit of a body without joints on a table: its tracked pose, predicted from its thrusters' commands.

Unknown are mass, moment of inertia (both as logarithms) and centre of mass; of each thruster scale, direction, lever,
leak and delay; scale, delay and loss of all alike; tilt of the table and drag; place, direction and scale of the
tracker. For every window of :data:`WINDOW_s` there are the state at its first pose, and steady accelerations within the
stated sigmas: what drives the body besides its thrusters does not add up. The pulse below which a valve does not open
is the one of those commanded that explains the poses best; so is whether commands came when they are written, or at any
time since the sample before (:mod:`onboard.identification.body.sampling`).

Forces set the scale of mass and inertia; a stated mass sets that of the forces.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.floating import Floating, predict_floating
from onboard.estimation.arrays import OF_STEP, FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.maximum_likelihood import ITERATIONS, MINIMUM, NEAR_MINIMUM, Descent, Fit
from onboard.estimation.policy import MISFIT_REFUSED, MOSTLY, ODDS_OF_PART
from onboard.identification.body.sampling import DrivenWindow, Lateness, Whitener, by_steps, lateness, whitener
from onboard.identification.body.start import PoseAxes, PoseWindow, Products, guess, products, state
from onboard.identification.body.stated import BodySigmas, Opening, Thrusters, Tracker
from onboard.identification.free_flyer.prediction.parameters import UnknownLayout, Unknowns
from onboard.identification.windows import SHORTEST, Part, WINDOW_s, WindowedFit, judged, total

_MOST_WINDOWS = 240
STEP_s = 0.02  # of the prediction
STEPS = int(np.ceil(WINDOW_s / STEP_s)) + 1  # in a window


class TrackedPoses(NamedTuple):
    """Poses of the tracked frame in the order of their times, and when the commands of the thrusters are known.

    (n,) and (n, 3): x, y, yaw, which goes on beyond half a turn.
    """

    time_s: FloatArray
    measured: FloatArray
    late_s: float = 0.0  # each may be as much as half of it earlier or later
    known_s: tuple[float, float] = (-np.inf, np.inf)  # from when to when commands are known
    unknown: tuple[tuple[float, float], ...] = ()  # times between them in which they are not


class PoseWindows(NamedTuple):
    """The windows of a recording."""

    start_s: FloatArray  # (k,)
    time_s: list[FloatArray]  # of the poses of each, (u,)
    measured: list[FloatArray]  # (u, 3)
    noise: list[FloatArray]  # (u, 3)

    @property
    def grid_s(self) -> FloatArray:
        """(k, steps + 1)."""
        return self.start_s[:, None] + STEP_s * np.arange(STEPS + 1)


def windows_of(poses: TrackedPoses, noise: FloatArray, longest_s: float) -> PoseWindows:
    """Windows of poses, at all of which the commands are known, the largest delay earlier too.

    Args:
        poses: of a recording.
        noise: sigma of x, y, yaw, (3,).
        longest_s: the largest delay.

    Raises:
        ConvergenceError: there is none.
    """
    kept, (begin_s, last_s) = list[slice](), poses.known_s
    moved = np.gradient(poses.measured, poses.time_s, axis=0) * poses.late_s * OF_STEP
    at_s, end_s = max(float(poses.time_s[0]), begin_s + longest_s), min(float(poses.time_s[-1]), last_s)
    while at_s < end_s and len(kept) < _MOST_WINDOWS:
        until_s = min(at_s + WINDOW_s, end_s)
        inside = slice(*np.searchsorted(poses.time_s, [at_s, until_s]).tolist())
        lost = any(a < until_s and b > at_s - longest_s for a, b in poses.unknown)
        if inside.stop - inside.start >= SHORTEST and not lost:
            kept.append(inside)
        at_s = until_s
    if not kept:
        text = f"no {WINDOW_s:g} s with {SHORTEST} poses and known commands"
        raise ConvergenceError(f"{text}: check that both are on the same clock")
    time_s, measured = ([of[inside] for inside in kept] for of in (poses.time_s, poses.measured))
    noises = [np.hypot(noise, moved[inside]) for inside in kept]
    return PoseWindows(np.array([of[0] for of in time_s]), time_s, measured, noises)


STATE = 9  # unknowns of a window: x, y, yaw, their rates, steady accelerations
BODY = 4  # unknowns of the body
_UNKNOWN = 3.0  # sigma of the logarithm of a mass or moment of inertia of which nothing is known
_SEARCHED, _SEARCH_s = 24, 0.025  # windows, and step of the delays that a fit begins from
_LOOKS = 8  # predictions by which pulses that do nothing are judged
_LEAST_TRIED = 12  # lengths of pulses that may not open a valve
_BETTER = -2.0 * np.log(ODDS_OF_PART)  # squares by which valves that stay shut explain the poses
_SENSORS = 3
_AS_WRITTEN = Opening(0.0, 0.0, 0.0)


class BodyFit(NamedTuple):
    """A fit."""

    found: WindowedFit
    start_s: FloatArray  # of the windows
    settled: bool  # it is the minimum
    lateness: Lateness  # of commands and poses, which is in the delay

    @property
    def x(self) -> FloatArray:
        """The unknowns that all windows share."""
        return self.found.fit.x[: self.found.globals]


class Begun(NamedTuple):
    """The first steps of a fit, for which all pulses open the valves."""

    windows: PoseWindows
    fit: Fit


class BodyModel:
    """Predicts the tracked pose of a body without joints.

    Args:
        drawn: mass, kg, centre of mass on the table, m, and moment of inertia about it, kg m^2, as drawn; mass 0 or
            inertia 0 are no guess.
        thrusters: of it.
        tracker: of it.
        stated: sigmas.

    Attributes:
        thrusters: the same.
        tracker: the same.
        names: of the unknowns that all windows share.
        sigma: of these beforehand.
        steady_sigma: of the accelerations of each window, (3,).
        weighed: its mass is stated.
        axes: of the tracked frame, as stated.
    """

    def __init__(
        self, drawn: tuple[float, FloatArray, float], thrusters: Thrusters, tracker: Tracker, stated: BodySigmas
    ):
        self._drawn, self.thrusters, self.tracker, self._stated = drawn, thrusters, tracker, stated
        mass_kg, centre_m, inertia = drawn
        reach = float(np.abs(thrusters.place_m - centre_m).max())
        size = max(reach, float(np.sqrt(inertia / mass_kg)))
        j, each = len(thrusters.names), thrusters.names
        low, high = stated.delay_s
        mass_sigma = stated.mass_sigma or _UNKNOWN
        blocks = {
            "body": Unknowns(
                ("mass", "com_x", "com_y", "I_zz"), np.array([mass_sigma, 2.0 * size, 2.0 * size, _UNKNOWN])
            ),
            "scale": Unknowns(tuple(f"scale_{name}" for name in each), thrusters.scale_sigma),
            "turn": Unknowns(tuple(f"turn_{name}" for name in each), np.full(j, stated.turn_sigma_rad)),
            "lever": Unknowns(tuple(f"lever_{name}" for name in each), np.full(j, stated.place_sigma_m)),
            "leak": Unknowns(tuple(f"leak_{name}" for name in each), np.full(j, stated.leak_sigma)),
            "each": Unknowns(tuple(f"delay_{name}" for name in each), np.full(j, 1e-3 * stated.each_delay_sigma_ms)),
            "common": Unknowns(("common_force",), np.array([thrusters.common_sigma])),
            "valves": Unknowns(("delay", "loss"), np.array([high - low, 1e-3 * stated.loss_sigma_ms])),
            "table": Unknowns(("tilt_x", "tilt_y"), np.full(2, stated.tilt_sigma_m_s2)),
            "drag": Unknowns(("drag", "spin_drag"), np.array([stated.drag_sigma_1_s, stated.spin_drag_sigma_1_s])),
            "tracker": Unknowns(
                ("tracker_turn", "tracker_place_x", "tracker_place_y", "tracker_scale"),
                np.array([tracker.turn_sigma_rad, *[tracker.place_sigma_m] * 2, tracker.scale_sigma]),
            ),
        }
        self._layout = UnknownLayout(blocks)
        self.names, self.sigma = self._layout.names, self._layout.sigma
        self.weighed = stated.mass_sigma is not None
        self.steady_sigma = np.array([*[stated.uneven_sigma_m_s2] * 2, stated.turning_sigma_rad_s2])
        self.axes = PoseAxes(turn_rad=-tracker.yaw_rad)
        self._delays_s: list[float] = np.arange(low, high + _SEARCH_s, _SEARCH_s).tolist()
        steps_of_each = [*[1e-4] * j, *[1e-5] * j, *[1e-5] * j, *[1e-4] * j, *[1e-4] * j]
        others = [*[1e-4] * 3, *[1e-5] * 2, *[1e-4] * 2, *[1e-5] * 3, 1e-4]
        # of the differences, of all unknowns, then of a window's state
        self._steps = np.array([1e-4, 1e-5, 1e-5, 1e-4, *steps_of_each, *others, *[1e-5] * STATE])

    def with_thrusters(self, thrusters: Thrusters) -> "BodyModel":
        """The same with others."""
        return BodyModel(self._drawn, thrusters, self.tracker, self._stated)

    def body(self, x: FloatArray) -> tuple[float, FloatArray, float]:
        """Mass, kg, centre of mass, (2,) m, and moment of inertia about it, kg m^2."""
        mass_kg, centre_m, inertia = self._drawn
        return mass_kg * float(np.exp(x[0])), centre_m + x[1:3], inertia * float(np.exp(x[3]))

    def begun(self, poses: TrackedPoses) -> Begun:
        """How :meth:`fit` begins, which has the arguments and the errors."""
        windows = windows_of(poses, self.tracker.noise, self._stated.delay_s[1])
        return Begun(windows, self._descend(windows, 0.0, self._begun(windows))[0])

    def fit(self, poses: TrackedPoses, first: Begun | None = None) -> BodyFit:
        """The unknowns that explain the poses best.

        Args:
            poses: of the recording.
            first: :meth:`begun` of the same, where it is known.

        Raises:
            EstimationError: too few poses, or no minimum.
        """
        (windows, begun), least_s = first or self.begun(poses), 0.0
        for tried_s in self._leasts():
            other, _ = self._descend(windows, tried_s, begun.x)
            if other.residual_sum > MISFIT_REFUSED * begun.residual_sum:
                break  # longer pulses opened the valves
            if other.residual_sum < begun.residual_sum - _BETTER * (least_s == 0.0):
                begun, least_s = other, tried_s
        found, settled = self._descend(windows, least_s, begun.x, whole=True)
        white = self._whiteners(found.x, windows, least_s)
        rows, spread = sum(noise.size for noise in windows.noise), sum(one.log_determinant for one in white)
        other, _ = self._descend(windows, least_s, found.x, white)
        likelier = rows * float(np.log(found.residual_sum / other.residual_sum)) > spread  # the noise's scale unknown
        scattered = likelier and other.residual_sum < MISFIT_REFUSED * rows
        if scattered:
            found, settled = self._descend(windows, least_s, other.x, white, whole=True)
        white = white if scattered else ()
        parts = self._parts(found.x, windows, least_s, white)
        late_s = float(np.concatenate([valve.edges(_AS_WRITTEN).late_s for valve in self.thrusters.valves]).mean())
        told = judged(found, parts, len(self.names), _SENSORS)
        return BodyFit(told, windows.start_s, settled, lateness(late_s, scattered, poses.late_s))

    def _leasts(self) -> list[float]:
        """Lengths just above those pulses that may not open a valve."""
        pulses = np.concatenate([valve.pulses_s for valve in self.thrusters.valves])
        lengths = np.unique(np.round(pulses, 4))
        lengths = lengths[: round(MOSTLY * len(lengths))]  # by most of them the body moves
        if len(lengths) > _LEAST_TRIED:
            lengths = np.quantile(lengths, np.linspace(0.0, 1.0, _LEAST_TRIED))
        return [float(length) + 1e-4 for length in lengths]

    def products(self, poses: TrackedPoses) -> Products:
        """What the commands move, with the poses, of each delay that may be. Arguments and errors as of :meth:`fit`."""
        return self._products(windows_of(poses, self.tracker.noise, self._stated.delay_s[1]))

    @property
    def full(self) -> FloatArray:
        """Force of each thruster at level one and its moment about the base's origin, base axes, (j, 3)."""
        of = self.thrusters
        ux, uy = np.cos(of.direction), np.sin(of.direction)
        arm = of.place_m[:, 0] * uy - of.place_m[:, 1] * ux
        return np.asarray(of.force_N[:, None] * np.stack([ux, uy, arm], axis=1), np.float64)

    def _products(self, windows: PoseWindows) -> Products:
        searched = np.array([self._levels(windows, delay_s, _SEARCHED) for delay_s in self._delays_s])
        series = zip(windows.time_s, windows.measured, windows.grid_s, searched.swapaxes(0, 1), strict=False)
        return products([PoseWindow(*of) for of in series], self.tracker.noise)

    def _levels(self, windows: PoseWindows, delay_s: float, most: int | None = None) -> FloatArray:
        """Levels of the valves, means of each step of so many windows, (k, steps, j)."""
        grid_s, how = windows.grid_s[:most], Opening(delay_s, 0.0, 0.0)
        levels = [np.diff(valve.integrals(grid_s, how)[0], axis=1) / STEP_s for valve in self.thrusters.valves]
        return np.stack(levels, axis=2)

    def _begun(self, windows: PoseWindows) -> FloatArray:
        """Where a fit begins: a body by :func:`guess`, states by the poses of each window."""
        p, tracker = len(self.names), self.tracker
        first = guess(self._products(windows), self.full, tracker.place_m, self.axes)
        delay_s = self._delays_s[first.which]
        x = np.zeros(p + STATE * len(windows.start_s))
        x[:BODY] = np.log(first.mass_kg / self._drawn[0]), *first.centre_m, np.log(first.inertia_kg_m2)
        x[1:BODY] -= *self._drawn[1], np.log(self._drawn[2])
        x[self.names.index("delay")] = delay_s
        series = zip(windows.time_s, windows.measured, windows.grid_s, self._levels(windows, delay_s), strict=True)
        for own, (time_s, measured, grid_s, level) in zip(x[p:].reshape(-1, STATE), series, strict=True):
            window = PoseWindow(time_s, measured, grid_s, level[None])
            own[:6] = state(window, level @ self.full, first, tracker.place_m, tracker.yaw_rad)
        return x

    def _descend(
        self, windows: PoseWindows, least_s: float, x: FloatArray, white: Sequence[Whitener] = (), whole: bool = False
    ) -> tuple[Fit, bool]:
        """The best point after a few predictions, or ``whole``: after many; whether it is the minimum."""
        tolerance, most = (MINIMUM, ITERATIONS) if whole else (NEAR_MINIMUM, _LOOKS)
        prior = np.diag(np.concatenate([self.sigma**-2, np.zeros(x.size - len(self.names))]))
        descent = Descent(x, np.zeros_like(x), prior, most + 1, tolerance)
        for _ in range(most):
            try:
                with np.errstate(over="ignore", invalid="ignore"):
                    descent.take(total(self._parts(descent.at, windows, least_s, white), len(self.names), x.size))
            except ConvergenceError:
                if not descent.iteration:
                    raise
                break
            if descent.found is not None:
                return descent.found, True
        return descent.short_of_the_minimum(), False

    def _parts(
        self, x: FloatArray, windows: PoseWindows, least_s: float, white: Sequence[Whitener] = ()
    ) -> Iterator[Part]:
        """Of each window: positions, yaw, and what is steady in it against the stated sigma: sensors 0, 1, 2."""
        p, steps = len(self.names), self._steps
        kept, b = self._layout.kept, 1 + len(self._layout.kept) + STATE
        moving = np.tile(self._layout.whole(x[:p]), (b, 1))
        moving[1 + np.arange(p), kept] += steps[kept]
        begin = np.tile(x[p:].reshape(-1, STATE), (b, 1, 1))
        begin[1 + p :] += np.diag(steps[-STATE:])[:, None]
        body = self._moved(moving, begin, windows, least_s)
        states = predict_floating(body, begin.transpose(2, 0, 1)[:6], STEP_s)[:, :3]
        states = np.ascontiguousarray(states.transpose(3, 0, 1, 2))  # (k, n, 3, b): samples are gathered from it
        every = np.append(steps[kept], steps[-STATE:])
        sigma = self.steady_sigma
        for k, (time_s, measured, noise) in enumerate(
            zip(windows.time_s, windows.measured, windows.noise, strict=True)
        ):
            at = (time_s - windows.start_s[k]) / STEP_s
            first = np.minimum(at.astype(np.int64), STEPS - 1)
            part = (at - first)[:, None, None]
            shown = self._shown((1.0 - part) * states[k, first] + part * states[k, first + 1], moving)
            r = shown[:, :, 0] - measured  # (u, 3)
            r[:, 2] = np.remainder(r[:, 2] + np.pi, 2.0 * np.pi) - np.pi
            J = (shown[:, :, 1:] - shown[:, :, :1]) / every / noise[:, :, None]  # (u, 3, p + state)
            lines = np.concatenate([(r / noise)[:, :, None], J], axis=2).reshape(-1, 1 + p + STATE)
            if white:
                lines = white[k].of(lines)
            steady = np.zeros((3, p + STATE))
            steady[:, -3:] = np.diag(1.0 / sigma)
            sensor = np.concatenate([np.tile([0, 0, 1], len(time_s)), [2] * 3])
            residuals = np.concatenate([lines[:, 0], begin[0, k, 6:] / sigma])
            yield Part(residuals, np.concatenate([lines[:, 1:], steady]), sensor)

    def _whiteners(self, x: FloatArray, windows: PoseWindows, least_s: float) -> tuple[Whitener, ...]:
        """Of each window, if commands came at any time since the sample before."""
        moving = self._layout.whole(x[: len(self.names)])[None]
        begin = x[len(self.names) :].reshape(1, -1, STATE)
        body = self._moved(moving, begin, windows, least_s)
        yaw = predict_floating(body, begin.transpose(2, 0, 1)[:6], STEP_s)[:, 2, 0]  # (n + 1, k)
        scale = np.append(np.exp(-moving[0, [0, 0]]) / self._drawn[0], np.exp(-moving[0, 3]) / self._drawn[2])
        each = np.array([self._full(j, moving)[0] for j in range(len(self.thrusters.names))]) * scale
        hows = [self._opening(j, moving)[0].tolist() for j in range(len(each))]
        valves = zip(self.thrusters.valves, hows, strict=True)
        steps = [valve.edges(Opening(delay_s, loss_s, least_s)) for valve, (delay_s, loss_s) in valves]
        lever, found = self._lever(moving)[0], list[Whitener]()
        for k, (time_s, noise) in enumerate(zip(windows.time_s, windows.noise, strict=True)):
            window = DrivenWindow(windows.grid_s[k], yaw[:, k], body.force[:, :, 0, k], lever)
            found.append(whitener(by_steps(window, steps, each, time_s) / noise[:, :, None]))
        return tuple(found)

    def _lever(self, moving: FloatArray) -> FloatArray:
        """Of the tracked frame from the centre of mass, body axes, (b, 2)."""
        place = self.tracker.place_m + moving[:, self._layout["tracker"]][:, 1:3]
        return np.asarray(place - self._drawn[1] - moving[:, 1:3], np.float64)

    def _full(self, j: int, moving: FloatArray) -> FloatArray:
        """Force of a thruster at level one, body axes, and its moment about the centre of mass, (b, 3)."""
        of, thrusters, centre = self._layout, self.thrusters, self._drawn[1] + moving[:, 1:3]
        scale, turn, lever = (moving[:, of[name]][:, j] for name in ("scale", "turn", "lever"))
        toward = thrusters.direction[j] + turn
        ux, uy = np.cos(toward), np.sin(toward)
        arm = (thrusters.place_m[j, 0] - centre[:, 0]) * uy - (thrusters.place_m[j, 1] - centre[:, 1]) * ux
        force = thrusters.force_N[j] * (1.0 + scale + moving[:, of["common"]][:, 0])
        return np.stack([force * ux, force * uy, force * (arm + lever)], axis=1)

    def _opening(self, j: int, moving: FloatArray) -> FloatArray:
        """Delay and loss of a valve, (b, 2)."""
        delay_s, loss_s = moving[:, self._layout["valves"]].T
        return np.stack([moving[:, self._layout["each"]][:, j] + delay_s, loss_s], axis=1)

    def _shown(self, state: FloatArray, moving: FloatArray) -> FloatArray:
        """Poses of the tracked frame, (u, 3, b), by those of the centre of mass."""
        own = moving[:, self._layout["tracker"]]
        lever = self._lever(moving)
        c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
        x = state[:, 0] + c * lever[:, 0] - s * lever[:, 1]
        y = state[:, 1] + s * lever[:, 0] + c * lever[:, 1]
        return np.stack(
            [(1.0 + own[:, 3]) * x, (1.0 + own[:, 3]) * y, state[:, 2] + self.tracker.yaw_rad + own[:, 0]], 1
        )

    def _moved(self, moving: FloatArray, begin: FloatArray, windows: PoseWindows, least_s: float) -> Floating:
        """What moves the body.

        Args:
            moving: all unknowns of b variants, (b, size).
            begin: of each window, (b, k, state).
            windows: k of them.
            least_s: pulses shorter than this do nothing.
        """
        of, h = self._layout, STEP_s
        forces, ahead = np.zeros((2, 3, STEPS, len(moving), len(windows.start_s)))
        for j, valve in enumerate(self.thrusters.valves):
            leak = moving[:, of["leak"]][:, j, None]
            different, which = np.unique(  # most variants differ elsewhere
                np.hstack([self._opening(j, moving), leak, self._full(j, moving)]), axis=0, return_inverse=True
            )
            hows = [(delay_s, loss_s) for delay_s, loss_s, *_ in different.tolist()]
            integrals = {how: valve.integrals(windows.grid_s, Opening(*how, least_s)) for how in set(hows)}
            once, twice = np.array([integrals[how] for how in hows]).transpose(1, 3, 0, 2)  # (steps + 1, u, k)
            level = np.diff(once, axis=0) / h
            leak, full = different[:, 2, None], different[:, 3:].T[:, None, :, None]
            of_this = full * (level + leak * (1.0 - level))
            after = full * (1.0 - leak) * (np.diff(twice, axis=0) - 0.5 * h * (once[1:] + once[:-1]))
            forces += of_this.take(which.ravel(), axis=2)
            ahead += after.take(which.ravel(), axis=2)
        m, inertia = self._drawn[0] * np.exp(moving[:, :1]), self._drawn[2] * np.exp(moving[:, 3:4])
        over = np.stack([m, m, inertia])[:, None]
        state = begin.transpose(2, 0, 1)
        tilt, drag = (moving[:, of[name]].T[:, :, None] for name in ("table", "drag"))
        steady = np.concatenate([state[6:8] + tilt, state[8:]])
        (fx, fy, turning), ahead = forces / over, (ahead / over).swapaxes(0, 1)
        return Floating(np.stack([fx, fy], 1), turning, ahead, steady, drag)
