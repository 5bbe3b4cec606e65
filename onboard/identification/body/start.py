"""First guess of a body on a table, linear in what is unknown once the valves' delay and the measured yaw are taken.

With all forces F_j at level one along u_j at p_j, and D f the double integral of f from a window's start,

    yaw    = 1, t, and  (1 / I) D sum F_j (p_j x u_j)  -  (c_x / I) D F_y  +  (c_y / I) D F_x
    r - R p = 1, t, t^2, and  (1 / m) D R F  -  R c,

p the place of the tracked frame. The delay is that which leaves least, of a list. Of a delay all of it comes from the
products (normal equations) of what each valve alone would move, with the poses: what may be read otherwise, the
thruster that a command is of, a sign, axes of the poses, are other sums of the same products.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.identification.windows import WINDOW_s

_OPEN = 1e-10  # determinant of normal equations with ones on their diagonal: they leave something open


class PoseWindow(NamedTuple):
    """One window of poses with its commands."""

    time_s: FloatArray  # (u,) of the poses
    measured: FloatArray  # (u, 3) x, y, yaw of the tracked frame
    grid_s: FloatArray  # (n + 1,)
    level: FloatArray  # (d, n, j) of each valve, for each of d delays, means of a step

    @property
    def yaw(self) -> FloatArray:
        """As tracked, in the middle of each step, (n,)."""
        middle_s = 0.5 * (self.grid_s[1:] + self.grid_s[:-1])
        return np.interp(middle_s, self.time_s, self.measured[:, 2])


class Guess(NamedTuple):
    """A first guess."""

    which: int  # delay
    mass_kg: float
    centre_m: FloatArray  # (2,)
    inertia_kg_m2: float


class Products(NamedTuple):
    """Of what valves move and of poses, for each of d delays, in sigmas of a pose, without what moves by itself."""

    yaw: FloatArray  # (d, j + 1, j + 1): D of each level; yaw
    x: FloatArray  # (d, 2 j + 3, 2 j + 3): D cos(yaw) level, D sin(yaw) level; cos(yaw), sin(yaw), x
    y: FloatArray  # the same of y


class PoseAxes(NamedTuple):
    """How the poses are read: y and yaw times a sign, and an angle added to the yaw."""

    y: float = 1.0
    yaw: float = 1.0
    turn_rad: float = 0.0


class Guesses(NamedTuple):
    """The unknowns of some ways to read, (d, t, 3), NaN where they stay open, and the sums of squares left, (d, t)."""

    by_yaw: FloatArray
    by_place: FloatArray
    left: FloatArray

    @property
    def least(self) -> FloatArray:
        """Least sums of squares with which the body goes and turns as it is pushed, (t,); infinite: none."""
        possible = (self.by_yaw[..., 0] > 0.0) & (self.by_place[..., 0] > 0.0)
        return np.asarray(np.where(possible, self.left, np.inf).min(axis=0), np.float64)


def guess(found: Products, full: FloatArray, place_m: FloatArray, axes: PoseAxes) -> Guess:
    """The guess that leaves least of the poses.

    Args:
        found: of one recording.
        full: force and moment about the base's origin, base axes, of each valve that is open, (j, 3).
        place_m: of the tracked frame, (2,).
        axes: of the poses.

    Raises:
        ConvergenceError: under none of the delays the body moves as its thrusters push it.
    """
    by_yaw, by_place, left = (of[:, 0] for of in solved(found, full[None], place_m, axes))
    turns, goes = by_yaw[:, 0] > 0.0, by_place[:, 0] > 0.0
    if not (turns & goes).any():
        against = ["turns against its thrusters"] * bool((by_yaw[:, 0] <= 0.0).any())
        against += ["goes against its thrusters"] * bool((by_place[:, 0] <= 0.0).any())
        why = f"the body {' or '.join(sorted(against))}" if against else "the commands move nothing"
        raise ConvergenceError(f"{why}: check the axes of thrusters and tracker, and the sign of the yaw")
    d = int(np.where(turns & goes, left, np.inf).argmin())
    inertia = 1.0 / float(by_yaw[d, 0])
    return Guess(d, 1.0 / float(by_place[d, 0]), inertia * by_yaw[d, 1:], inertia)


def products(windows: list[PoseWindow], noise: FloatArray) -> Products:
    """Products of all windows, which are of one recording and of the same delays; noise: sigma of x, y, yaw, (3,).

    Halves of windows are fitted by themselves: unknown accelerations do not add up in them.
    """
    d, _, j = windows[0].level.shape
    found = Products(*(np.zeros((d, size, size)) for size in (j + 1, 2 * j + 3, 2 * j + 3)))
    for window in windows:
        for part in np.array_split(
            np.arange(len(window.time_s)), max(1, round(2.0 * np.ptp(window.time_s) / WINDOW_s))
        ):
            _add(found, window, part, noise)
    return found


def _add(found: Products, window: PoseWindow, part: np.ndarray, noise: FloatArray) -> None:
    time_s, (x, y, yaw) = window.time_s[part], window.measured[part].T
    d, n, j = window.level.shape
    t, twice = time_s - time_s[0], partial(_twice, window.grid_s, time_s)
    levels = np.moveaxis(window.level, 1, 0).reshape(n, -1)  # (n, d j)
    theta = window.yaw
    alone, along, across = (
        np.moveaxis(twice(one).reshape(len(t), d, j), 1, 0)
        for one in (levels, np.cos(theta)[:, None] * levels, np.sin(theta)[:, None] * levels)
    )
    line, parabola = (np.linalg.qr(t[:, None] ** np.arange(p))[0] for p in (2, 3))
    turned = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    for into, Q, sigma, pushed, own in (
        (found.yaw, line, noise[2], (alone,), [yaw[:, None]]),
        (found.x, parabola, noise[0], (along, across), [turned, x[:, None]]),
        (found.y, parabola, noise[1], (along, across), [turned, y[:, None]]),
    ):
        A = np.concatenate([*pushed, *(np.broadcast_to(one, (d, *one.shape)) for one in own)], axis=2) / sigma
        A = A - Q @ (Q.T @ A)
        into[...] += A.swapaxes(1, 2) @ A


def solved(found: Products, full: FloatArray, place_m: FloatArray, axes: PoseAxes) -> Guesses:
    """The unknowns of t ways to read commands, by the forces of the valves, (t, j, 3), as of :func:`guess`."""
    fx, fy, moment = np.moveaxis(full, 2, 0)  # (t, j)
    c, s, sign = np.cos(axes.turn_rad), np.sin(axes.turn_rad), axes.yaw
    px, py = place_m
    cosine, sine = np.array([c, -sign * s]), np.array([s, sign * c])  # of the yaw as read, by those as written
    yaw, x, y = (np.zeros((*fx.shape[:1], size, 4)) for size in (fx.shape[1] + 1, *[2 * fx.shape[1] + 3] * 2))
    yaw[:, :-1] = np.stack([moment, -fy, fx, 0.0 * fx], axis=2)
    yaw[:, -1, 3] = sign
    for into, by_x, by_y, value in ((x, cosine, -sine, 1.0), (y, sine, cosine, axes.y)):
        into[:, :-3, 0] = np.concatenate([fx * by_x[k] + fy * by_y[k] for k in (0, 1)], axis=1)
        into[:, -3:-1, 1:] = np.stack([-by_x, -by_y, -px * by_x - py * by_y], axis=1)
        into[:, -1, 3] = value
    turned = [_least(_of(G, yaw)) for G in found.yaw]
    placed = [_least(_of(Gx, x) + _of(Gy, y)) for Gx, Gy in zip(found.x, found.y, strict=True)]
    by_yaw, by_place = (np.array([one for one, _ in of]) for of in (turned, placed))
    left = np.array([one + other for (_, one), (_, other) in zip(turned, placed, strict=True)])
    return Guesses(by_yaw, by_place, left)


def _of(G: FloatArray, A: FloatArray) -> FloatArray:
    return np.asarray(A.swapaxes(1, 2) @ (G @ A), np.float64)


def _least(H: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unknowns (t, 3) and what they leave, (t,), by products (t, 4, 4), the values last; NaN where they stay open."""
    size = np.sqrt(np.maximum(np.diagonal(H[:, :3, :3], axis1=1, axis2=2), 0.0))
    good = np.asarray((size > 0.0).all(axis=1), np.bool_)
    size = np.where(good[:, None], size, 1.0)
    of_one = H[:, :3, :3] / (size[:, :, None] * size[:, None])
    good &= np.linalg.det(of_one) > _OPEN
    g = H[:, :3, 3] / size
    found = np.linalg.solve(np.where(good[:, None, None], of_one, np.eye(3)), g[..., None])[..., 0]
    left = H[:, 3, 3] - (g * found).sum(axis=1)
    return np.where(good[:, None], found / size, np.nan), np.where(good, left, np.inf)


def state(window: PoseWindow, force: FloatArray, first: Guess, place_m: FloatArray, yaw_rad: float) -> FloatArray:
    """Place and yaw of the centre of mass and their rates, (6,), at the first pose, by all poses of the window.

    A line through the first poses would do for a body that its thrusters hardly turn meanwhile.

    Args:
        window: its poses.
        force: (steps, 3), by the delay of the guess.
        first: the guess.
        place_m: of the tracked frame, (2,).
        yaw_rad: of its axes in the base's.
    """
    t, twice = window.time_s - window.time_s[0], partial(_twice, window.grid_s, window.time_s)
    fx, fy, moment = force.T
    about = moment - first.centre_m[0] * fy + first.centre_m[1] * fx
    yaw = window.measured[:, 2] - yaw_rad
    c, s = np.cos(yaw), np.sin(yaw)
    lever = place_m - first.centre_m
    along, across = np.cos(window.yaw - yaw_rad), np.sin(window.yaw - yaw_rad)
    pushed = [twice(one) / first.mass_kg for one in (along * fx - across * fy, across * fx + along * fy)]
    ways = (
        window.measured[:, 0] - c * lever[0] + s * lever[1] - pushed[0],
        window.measured[:, 1] - s * lever[0] - c * lever[1] - pushed[1],
        yaw - twice(about) / first.inertia_kg_m2,
    )
    rate, begun = np.polyfit(t, np.stack(ways, axis=1), 1)
    return np.concatenate([begun, rate])


def _twice(grid_s: FloatArray, time_s: FloatArray, values: FloatArray) -> FloatArray:
    """Double integrals of means of steps, (n, ...), at the poses; a line in time more or less."""
    h = np.diff(grid_s).reshape(-1, *[1] * (values.ndim - 1))
    rate = np.concatenate([0.0 * values[:1], np.cumsum(values * h, axis=0)])
    twice_s = np.concatenate([0.0 * values[:1], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * h, axis=0)])
    k = np.clip(np.searchsorted(grid_s, time_s, "right") - 1, 0, len(grid_s) - 2)
    share = ((time_s - grid_s[k]) / (grid_s[k + 1] - grid_s[k])).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1.0 - share) * twice_s[k] + share * twice_s[k + 1], np.float64)
