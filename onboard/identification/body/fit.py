"""Maximum likelihood fit of a body without joints on a table: its tracked pose, predicted from its thrusters' commands.

Unknown are mass, moment of inertia (both as logarithms) and centre of mass; of each thruster scale, direction, lever,
leak and delay; delay and loss of all valves; tilt of the table and drag; place, direction and scale of the tracker. For
every window of :data:`WINDOW_s` there are the state at its first pose, and steady accelerations within the stated
sigmas: what drives the body besides its thrusters does not add up. The pulse below which a valve does not open is
the one of those commanded that explains the poses best.

Forces set the scale of mass and inertia; a stated mass sets that of the forces.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.floating import Floating, predict_floating
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.maximum_likelihood import Descent, Fit
from onboard.estimation.policy import ODDS_OF_PART
from onboard.identification.body.start import PoseWindow, guess, state
from onboard.identification.body.valves import Opening, Valve
from onboard.identification.exiddm.prediction.parameters import Block, UnknownLayout
from onboard.identification.windows import Part, WindowedFit, judged, total

WINDOW_s, SHORTEST = 5.0, 20  # and fewest poses in one
STATE = 9  # unknowns of a window: x, y, yaw, their rates, steady accelerations
BODY = 4  # unknowns of the body
_MOST_WINDOWS = 240
_STEP_s = 0.02  # of the prediction
_UNKNOWN = 3.0  # sigma of the logarithm of a mass or moment of inertia of which nothing is known
_SEARCHED, _SEARCH_s = 24, 0.025  # windows, and step of the delays that a fit begins from
_TOLERANCE, _MOST, _LOOKS = (
    1e-2,
    40,
    8,
)  # of the whitened sum of squares; predictions by which pulses that do nothing are judged
_LEAST_s, _LEAST_TRIED = 0.3, 12  # longest pulse that may not open a valve; how many lengths are tried
_BETTER = -2.0 * np.log(ODDS_OF_PART)  # squares by which valves that stay shut explain the poses
_WORSE = 3.0  # times the squares: longer pulses opened the valves
_SENSORS = 3


class Thrusters(NamedTuple):
    """j thrusters, in the base's axes and on the table."""

    names: tuple[str, ...]
    force_N: FloatArray  # (j,) at level 1  # noqa: N815
    place_m: FloatArray  # (j, 2)
    direction: FloatArray  # (j,) angle of the force from x, rad
    scale_sigma: FloatArray  # (j,)
    valves: tuple[Valve, ...]


class BodySigmas(NamedTuple):
    """1 sigma of what moves the body besides its thrusters' scales, and of what is known of these."""

    mass: float | None  # relative; None: nothing is known of it
    tilt_m_s2: float
    uneven_m_s2: float  # steady in a window
    turning_rad_s2: float
    drag_1_s: float
    spin_drag_1_s: float
    place_m: float  # of each thruster's lever
    turn_rad: float
    leak: float  # share of the force while it is off
    delay_s: tuple[float, float]  # least and largest
    each_delay_s: float
    loss_s: float


class Tracker(NamedTuple):
    """Where the tracked frame is in the base, and 1 sigma of what is known of it."""

    place_m: FloatArray  # (2,)
    yaw_rad: float
    turn_sigma_rad: float
    place_sigma_m: float
    scale_sigma: float
    noise: FloatArray  # (3,) of one pose: m, m, rad


class TrackedPoses(NamedTuple):
    """Poses of the tracked frame, (n,) and (n, 3): x, y, yaw, which goes on beyond half a turn."""

    time_s: FloatArray
    measured: FloatArray


class _Windows(NamedTuple):
    start_s: FloatArray  # (k,)
    steps: int
    period_s: float
    poses: list[TrackedPoses]

    @property
    def grid_s(self) -> FloatArray:
        """(k, steps + 1)."""
        return self.start_s[:, None] + self.period_s * np.arange(self.steps + 1)


class BodyFit(NamedTuple):
    """A fit."""

    found: WindowedFit
    least_s: float  # pulses shorter than this did not open a valve
    start_s: FloatArray  # of the windows
    settled: bool  # it is the minimum

    @property
    def x(self) -> FloatArray:
        """The unknowns that all windows share."""
        return self.found.fit.x[: self.found.globals]


class BodyModel:
    """Predicts the tracked pose of a body without joints.

    Args:
        drawn: mass, kg, centre of mass on the table, m, and moment of inertia about it, kg m^2, as drawn; mass 0 or
            inertia 0 are no guess.
        thrusters: of it.
        tracker: of it.
        stated: sigmas.

    Attributes:
        names: of the unknowns that all windows share.
        sigma: of these beforehand.
        steady_sigma: of the accelerations of each window, (3,).
        weighed: its mass is stated.
    """

    def __init__(
        self, drawn: tuple[float, FloatArray, float], thrusters: Thrusters, tracker: Tracker, stated: BodySigmas
    ):
        self._drawn, self._thrusters, self._tracker, self._stated = drawn, thrusters, tracker, stated
        mass_kg, centre_m, inertia = drawn
        reach = float(np.abs(thrusters.place_m - centre_m).max())
        size = max(reach, float(np.sqrt(inertia / mass_kg)))
        j, each = len(thrusters.names), thrusters.names
        low, high = stated.delay_s
        mass_sigma = stated.mass or _UNKNOWN
        blocks = {
            "body": Block(("mass", "com_x", "com_y", "I_zz"), np.array([mass_sigma, 2.0 * size, 2.0 * size, _UNKNOWN])),
            "scale": Block(tuple(f"scale_{name}" for name in each), thrusters.scale_sigma),
            "turn": Block(tuple(f"turn_{name}" for name in each), np.full(j, stated.turn_rad)),
            "lever": Block(tuple(f"lever_{name}" for name in each), np.full(j, stated.place_m)),
            "leak": Block(tuple(f"leak_{name}" for name in each), np.full(j, stated.leak)),
            "each": Block(tuple(f"delay_{name}" for name in each), np.full(j, stated.each_delay_s)),
            "valves": Block(("delay", "loss"), np.array([high - low, stated.loss_s])),
            "table": Block(("tilt_x", "tilt_y"), np.full(2, stated.tilt_m_s2)),
            "drag": Block(("drag", "spin_drag"), np.array([stated.drag_1_s, stated.spin_drag_1_s])),
            "tracker": Block(
                ("tracker_turn", "tracker_place_x", "tracker_place_y", "tracker_scale"),
                np.array([tracker.turn_sigma_rad, *[tracker.place_sigma_m] * 2, tracker.scale_sigma]),
            ),
        }
        self._layout = UnknownLayout(blocks)
        self.names, self.sigma = self._layout.names, self._layout.sigma
        self.weighed = stated.mass is not None
        self.steady_sigma = np.array([*[stated.uneven_m_s2] * 2, stated.turning_rad_s2])

    def body(self, x: FloatArray) -> tuple[float, FloatArray, float]:
        """Mass, kg, centre of mass, (2,) m, and moment of inertia about it, kg m^2."""
        mass_kg, centre_m, inertia = self._drawn
        return mass_kg * float(np.exp(x[0])), centre_m + x[1:3], inertia * float(np.exp(x[3]))

    def fit(
        self, poses: TrackedPoses, known_s: tuple[float, float], unknown: Sequence[tuple[float, float]] = ()
    ) -> BodyFit:
        """The unknowns that explain the poses best.

        Args:
            poses: in the order of their times.
            known_s: from when to when the commands are known.
            unknown: times between them in which they are not.

        Raises:
            EstimationError: too few poses, or no minimum.
        """
        windows = self._windows_of(poses, known_s, unknown)
        begun, least_s = self._descend(windows, 0.0, self._begun(windows), 1.0, _LOOKS)[0], 0.0
        for tried_s in self._leasts():
            other, _ = self._descend(windows, tried_s, begun.x, 1.0, _LOOKS)
            if other.residual_sum > _WORSE * begun.residual_sum:
                break  # longer pulses opened the valves
            if other.residual_sum < begun.residual_sum - _BETTER * (least_s == 0.0):
                begun, least_s = other, tried_s
        found, settled = self._descend(windows, least_s, begun.x, _TOLERANCE, _MOST)
        parts = self._parts(found.x, windows, least_s)
        return BodyFit(judged(found, parts, len(self.names), _SENSORS), least_s, windows.start_s, settled)

    def _leasts(self) -> list[float]:
        """Lengths just above those pulses that may not open a valve."""
        pulses = np.concatenate([valve.pulses_s for valve in self._thrusters.valves])
        lengths = np.unique(np.round(pulses[pulses < _LEAST_s], 4))
        if len(lengths) > _LEAST_TRIED:
            lengths = np.quantile(lengths, np.linspace(0.0, 1.0, _LEAST_TRIED))
        return [float(length) + 1e-4 for length in lengths]

    def _windows_of(
        self, poses: TrackedPoses, known_s: tuple[float, float], unknown: Sequence[tuple[float, float]]
    ) -> _Windows:
        """Windows of poses, at all of which the commands are known, the largest delay earlier too."""
        longest_s = self._stated.delay_s[1]
        starts, kept = [], list[TrackedPoses]()
        at_s, end_s = max(float(poses.time_s[0]), known_s[0] + longest_s), min(float(poses.time_s[-1]), known_s[1])
        while at_s < end_s and len(kept) < _MOST_WINDOWS:
            until_s = min(at_s + WINDOW_s, end_s)
            inside = slice(*np.searchsorted(poses.time_s, [at_s, until_s]).tolist())
            lost = any(a < until_s and b > at_s - longest_s for a, b in unknown)
            if inside.stop - inside.start >= SHORTEST and not lost:
                kept.append(TrackedPoses(poses.time_s[inside], poses.measured[inside]))
                starts.append(float(poses.time_s[inside][0]))
            at_s = until_s
        if not kept:
            text = f"no {WINDOW_s:g} s with {SHORTEST} poses and known commands"
            raise ConvergenceError(f"{text}: check that both are on one clock")
        return _Windows(np.array(starts), int(np.ceil(WINDOW_s / _STEP_s)) + 1, _STEP_s, kept)

    def _begun(self, windows: _Windows) -> FloatArray:
        """Where a fit begins: a body by :func:`guess`, states by the first poses of each window."""
        p, tracker, thrusters = len(self.names), self._tracker, self._thrusters
        delays_s = np.arange(self._stated.delay_s[0], self._stated.delay_s[1] + _SEARCH_s, _SEARCH_s)
        ux, uy = np.cos(thrusters.direction), np.sin(thrusters.direction)
        arm = thrusters.place_m[:, 0] * uy - thrusters.place_m[:, 1] * ux
        full = thrusters.force_N[:, None] * np.stack([ux, uy, arm], axis=1)  # (j, 3)
        grid_s = windows.grid_s

        def forces(grid_s: FloatArray, delay_s: float) -> FloatArray:
            """In base axes, (k, steps, 3)."""
            found = np.zeros((*grid_s[:, 1:].shape, 3))
            for valve, own in zip(thrusters.valves, full, strict=True):
                level = np.diff(valve.impulse_s(grid_s, Opening(delay_s, 0.0, 0.0)), axis=1) / windows.period_s
                found += level[..., None] * own
            return found

        searched = np.array([forces(grid_s[:_SEARCHED], delay_s) for delay_s in delays_s.tolist()])
        series = [PoseWindow(*poses, grid, np.zeros(0)) for poses, grid in zip(windows.poses, grid_s, strict=True)]
        some = [one._replace(force=searched[:, k]) for k, one in enumerate(series[:_SEARCHED])]
        first = guess(some, tracker.place_m, tracker.yaw_rad, tracker.noise)
        x = np.zeros(p + STATE * len(windows.poses))
        x[:BODY] = np.log(first.mass_kg / self._drawn[0]), *first.centre_m, np.log(first.inertia_kg_m2)
        x[1:BODY] -= *self._drawn[1], np.log(self._drawn[2])
        x[self.names.index("delay")] = delays_s[first.which]
        states = x[p:].reshape(-1, STATE)
        for own, window, force in zip(states, series, forces(grid_s, float(delays_s[first.which])), strict=True):
            own[:6] = state(window, force, first, tracker.place_m, tracker.yaw_rad)
        return x

    def _descend(
        self, windows: _Windows, least_s: float, x: FloatArray, tolerance: float, most: int
    ) -> tuple[Fit, bool]:
        """The minimum, or the best point after so many predictions; whether it is the minimum."""
        descent = Descent(x, np.zeros_like(x), self._prior(x.size), most + 1, tolerance)
        for _ in range(most):
            try:
                with np.errstate(over="ignore", invalid="ignore"):
                    descent.take(total(self._parts(descent.at, windows, least_s), len(self.names), x.size))
            except ConvergenceError:
                if not descent.iteration:
                    raise
                break
            if descent.found is not None:
                return descent.found, True
        return descent.short_of_the_minimum(), False

    def _prior(self, size: int) -> FloatArray:
        return np.diag(np.concatenate([self.sigma**-2, np.zeros(size - len(self.names))]))

    def _parts(self, x: FloatArray, windows: _Windows, least_s: float) -> Iterator[Part]:
        """Of each window: positions, yaw, and what is steady in it against the stated sigma: sensors 0, 1, 2."""
        p, steps = len(self.names), self._steps
        kept, b = self._layout.kept, 1 + len(self._layout.kept) + STATE
        moving = np.tile(self._layout.whole(x[:p]), (b, 1))
        moving[1 + np.arange(p), kept] += steps[kept]
        begin = np.tile(x[p:].reshape(-1, STATE), (b, 1, 1))
        begin[1 + p :] += np.diag(steps[-STATE:])[:, None]
        states = self._states(moving, begin, windows, least_s)  # (n, 3, b, k)
        every = np.append(steps[kept], steps[-STATE:])
        noise, sigma = self._tracker.noise, self.steady_sigma
        for k, (time_s, measured) in enumerate(windows.poses):
            at = (time_s - windows.start_s[k]) / windows.period_s
            first = np.minimum(at.astype(np.int64), windows.steps - 1)
            part = (at - first)[:, None, None]
            shown = self._shown((1.0 - part) * states[first, :, :, k] + part * states[first + 1, :, :, k], moving)
            r = (shown[:, :, 0] - measured) / noise  # (u, 3)
            r[:, 2] = np.remainder(r[:, 2] + np.pi / noise[2], 2.0 * np.pi / noise[2]) - np.pi / noise[2]
            J = (shown[:, :, 1:] - shown[:, :, :1]) / every / noise[:, None]  # (u, 3, p + state)
            steady = np.zeros((3, p + STATE))
            steady[:, -3:] = np.diag(1.0 / sigma)
            sensor = np.concatenate([np.tile([0, 0, 1], len(time_s)), [2] * 3])
            residuals = np.concatenate([r.ravel(), begin[0, k, 6:] / sigma])
            yield Part(residuals, np.concatenate([J.reshape(-1, p + STATE), steady]), sensor)

    def _shown(self, state: FloatArray, moving: FloatArray) -> FloatArray:
        """Poses of the tracked frame, (u, 3, b), by those of the centre of mass."""
        own = moving[:, self._layout["tracker"]]
        lever = self._tracker.place_m + own[:, 1:3] - self._drawn[1] - moving[:, 1:3]  # (b, 2)
        c, s = np.cos(state[:, 2]), np.sin(state[:, 2])
        x = state[:, 0] + c * lever[:, 0] - s * lever[:, 1]
        y = state[:, 1] + s * lever[:, 0] + c * lever[:, 1]
        return np.stack(
            [(1.0 + own[:, 3]) * x, (1.0 + own[:, 3]) * y, state[:, 2] + self._tracker.yaw_rad + own[:, 0]], 1
        )

    def _states(self, moving: FloatArray, begin: FloatArray, windows: _Windows, least_s: float) -> FloatArray:
        """Pose of the centre of mass at the grid, (n, 3, b, k).

        Args:
            moving: all unknowns of b variants, (b, size).
            begin: of each window, (b, k, state).
            windows: k of them.
            least_s: pulses shorter than this do nothing.
        """
        of, thrusters, h = self._layout, self._thrusters, windows.period_s
        mass_kg, centre_m, inertia = self._drawn
        centre = centre_m + moving[:, 1:3]
        fx, fy, turning = np.zeros((3, windows.steps, len(moving), len(windows.start_s)))
        grid = windows.grid_s
        for j, valve in enumerate(thrusters.valves):
            own = {name: moving[:, of[name]][:, j] for name in ("scale", "turn", "lever", "leak", "each")}
            how = np.stack([own["each"] + moving[:, of["valves"]][:, 0], moving[:, of["valves"]][:, 1]], axis=1)
            different, which = np.unique(how, axis=0, return_inverse=True)
            impulses = [
                valve.impulse_s(grid, Opening(delay_s, loss_s, least_s)) for delay_s, loss_s in different.tolist()
            ]
            level = np.diff(np.array(impulses), axis=2)[which.ravel()].transpose(2, 0, 1) / h  # (steps, b, k)
            force = (thrusters.force_N[j] * (1.0 + own["scale"]))[:, None]
            push = force * (level + own["leak"][:, None] * (1.0 - level))
            toward = thrusters.direction[j] + own["turn"]
            ux, uy = np.cos(toward), np.sin(toward)
            arm = (thrusters.place_m[j, 0] - centre[:, 0]) * uy - (thrusters.place_m[j, 1] - centre[:, 1]) * ux
            fx += ux[:, None] * push
            fy += uy[:, None] * push
            turning += (arm + own["lever"])[:, None] * push
        m, inertia_of = mass_kg * np.exp(moving[:, :1]), inertia * np.exp(moving[:, 3:4])
        state = begin.transpose(2, 0, 1)
        tilt = moving[:, of["table"]].T[:, :, None]
        steady = np.concatenate([state[6:8] + tilt, state[8:]])
        drag = moving[:, of["drag"]].T[:, :, None]
        body = Floating(np.stack([fx / m, fy / m], 1), turning / inertia_of, steady, drag)
        return predict_floating(body, state[:6], h)[:, :3]

    @property
    def _steps(self) -> FloatArray:
        """Of the differences, of all unknowns, then of a window's state."""
        j = len(self._thrusters.names)
        each = [*[1e-4] * j, *[1e-5] * j, *[1e-5] * j, *[1e-4] * j, *[1e-4] * j]
        others = [1e-4, 1e-4, *[1e-5] * 2, *[1e-4] * 2, *[1e-5] * 3, 1e-4]
        return np.array([1e-4, 1e-5, 1e-5, 1e-4, *each, *others, *[1e-5] * STATE])
