"""First guess of a body on a table, linear in what is unknown once the valves' delay and the measured yaw are taken.

With all forces F_j at level one along u_j at p_j, and D f the double integral of f from a window's start,

    yaw    = 1, t, and  (1 / I) D sum F_j (p_j x u_j)  -  (c_x / I) D F_y  +  (c_y / I) D F_x
    r - R p = 1, t, t^2, and  (1 / m) D R F  -  R c,

p the place of the tracked frame. The delay is that which leaves least, of a list.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError

_LONGEST_s = 2.5  # of a window's part that is fitted by itself: unknown accelerations do not add up in it


class PoseWindow(NamedTuple):
    """One window of poses with its commands."""

    time_s: FloatArray  # (u,) of the poses
    measured: FloatArray  # (u, 3) x, y, yaw of the tracked frame
    grid_s: FloatArray  # (n + 1,)
    force: FloatArray  # (d, n, 3) for each of d delays: force, N, and moment about the base's origin, means of a step


class Guess(NamedTuple):
    """A first guess."""

    which: int  # delay
    mass_kg: float
    centre_m: FloatArray  # (2,)
    inertia_kg_m2: float
    left: float = 0.0  # sum of squares


def guess(windows: list[PoseWindow], place_m: FloatArray, yaw_rad: float, noise: FloatArray) -> Guess:
    """The guess that leaves least of the poses.

    Args:
        windows: of one recording, and of the same delays.
        place_m: of the tracked frame, (2,).
        yaw_rad: of its axes in the base's.
        noise: sigma of x, y, yaw, (3,).

    Raises:
        ConvergenceError: under none of them the body moves as its thrusters push it.
    """
    found = list[Guess]()
    against = set[str]()
    for d in range(len(windows[0].force)):
        yaw, place = _Normal(3), _Normal(3)
        for window in windows:
            for part in np.array_split(
                np.arange(len(window.time_s)), max(1, round(np.ptp(window.time_s) / _LONGEST_s))
            ):
                _add(yaw, place, window, part, d, place_m, yaw_rad, noise)
        by_yaw, by_place = yaw.solve(), place.solve()
        if by_yaw is None or by_place is None:
            continue
        left = yaw.left(by_yaw) + place.left(by_place)
        if by_yaw[0] <= 0.0 or by_place[0] <= 0.0:
            against.add("turns against its thrusters" if by_yaw[0] <= 0.0 else "goes against its thrusters")
            continue
        inertia = 1.0 / by_yaw[0]
        found.append(Guess(d, 1.0 / by_place[0], inertia * by_yaw[1:], inertia, left))
    if not found:
        why = f"the body {' or '.join(sorted(against))}" if against else "the commands move nothing"
        raise ConvergenceError(f"{why}: check the axes of thrusters and tracker, and the sign of the yaw")
    return min(found, key=lambda one: one.left)


class _Normal:
    """Normal equations of p unknowns."""

    def __init__(self, p: int) -> None:
        self.H, self.g, self.squares = np.zeros((p, p)), np.zeros(p), 0.0

    def add(self, nuisance: FloatArray, columns: FloatArray, values: FloatArray) -> None:
        """Rows, less what nuisance columns explain of them."""
        Q = np.linalg.qr(nuisance)[0]
        A, b = (of - Q @ (Q.T @ of) for of in (columns, values))
        self.H += A.T @ A
        self.g += A.T @ b
        self.squares += float(b @ b)

    def solve(self) -> FloatArray | None:
        """The unknowns; None where the rows leave one open."""
        scale = np.sqrt(np.diag(self.H))
        if not (scale > 0.0).all() or np.linalg.cond(self.H / np.outer(scale, scale)) > 1e10:
            return None
        return np.asarray(np.linalg.solve(self.H, self.g), np.float64)

    def left(self, x: FloatArray) -> float:
        """Sum of squares there."""
        return self.squares - float(self.g @ x)


def _add(
    yaw: _Normal,
    place: _Normal,
    window: PoseWindow,
    part: np.ndarray,
    d: int,
    place_m: FloatArray,
    yaw_rad: float,
    noise: FloatArray,
) -> None:
    time_s, measured = window.time_s[part], window.measured[part]
    t, twice = time_s - time_s[0], partial(_twice, window.grid_s, time_s)
    fx, fy, moment = window.force[d].T
    one = np.ones_like(t)
    turning = np.stack([twice(moment), -twice(fy), twice(fx)], axis=1)
    yaw.add(np.stack([one, t], axis=1) / noise[2], turning / noise[2], (measured[:, 2] - yaw_rad) / noise[2])
    pushed = [twice(one) for one in _pushes(window, window.force[d], yaw_rad)]
    c, s = np.cos(measured[:, 2] - yaw_rad), np.sin(measured[:, 2] - yaw_rad)
    nuisance = np.stack([one, t, t * t], axis=1)
    for k, (push, of_x, of_y) in enumerate(((pushed[0], c, -s), (pushed[1], s, c))):
        values = measured[:, k] - of_x * place_m[0] - of_y * place_m[1]
        place.add(nuisance / noise[k], np.stack([push, -of_x, -of_y], axis=1) / noise[k], values / noise[k])


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
    pushed = [twice(one) / first.mass_kg for one in _pushes(window, force, yaw_rad)]
    ways = (
        window.measured[:, 0] - c * lever[0] + s * lever[1] - pushed[0],
        window.measured[:, 1] - s * lever[0] - c * lever[1] - pushed[1],
        yaw - twice(about) / first.inertia_kg_m2,
    )
    rate, begun = np.polyfit(t, np.stack(ways, axis=1), 1)
    return np.concatenate([begun, rate])


def _pushes(window: PoseWindow, force: FloatArray, yaw_rad: float) -> tuple[FloatArray, FloatArray]:
    """Forces along the table's x and y, by the yaw that was tracked."""
    fx, fy, _ = force.T
    middle = 0.5 * (window.grid_s[1:] + window.grid_s[:-1])
    theta = np.interp(middle, window.time_s, window.measured[:, 2]) - yaw_rad
    c, s = np.cos(theta), np.sin(theta)
    return c * fx - s * fy, s * fx + c * fy


def _twice(grid_s: FloatArray, time_s: FloatArray, values: FloatArray) -> FloatArray:
    """Double integral of means of steps, at the poses; a line in time more or less."""
    h = np.diff(grid_s)
    rate = np.append(0.0, np.cumsum(values * h))
    twice_s = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * h))
    return np.asarray(np.interp(time_s, grid_s, twice_s), np.float64)
