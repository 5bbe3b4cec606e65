"""What is stated of a body without joints: its thrusters, 1 sigma of what moves it, and its tracker.

Commands open and close each thruster later by a delay; short pulses do nothing.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray


class Opening(NamedTuple):
    """How a valve follows its commands."""

    delay_s: float
    loss_s: float  # by which it opens later than it closes
    least_s: float  # shorter pulses do not open it


class Edges(NamedTuple):
    """Steps of the level that a valve has, in the order of their times, (m,)."""

    time_s: FloatArray
    change: FloatArray
    late_s: FloatArray  # by how much earlier it may have been commanded


class Valve:
    """Commands of one thruster: levels, each held until the next.

    Args:
        time_s: of the commands, rising, (n,).
        level: its share of the force, (n,).
        exact: changes came at these times; otherwise each came since the sample before.

    Attributes:
        pulses_s: lengths of the times that it is on, in their order.
    """

    def __init__(self, time_s: FloatArray, level: FloatArray, exact: bool = False) -> None:
        change = np.diff(level, prepend=0.0)
        at = np.flatnonzero(change)
        self._time_s, self._change = time_s[at], change[at]
        self._late_s = np.zeros(len(at)) if exact else np.diff(time_s, prepend=time_s[:1])[at]
        self._begins: BoolArray = np.asarray((level[at] != 0.0) & (level[at] == change[at]), np.bool_)
        begins = np.flatnonzero(self._begins)
        ends = np.flatnonzero(level[at] == 0.0)
        last = float(time_s[-1]) if len(time_s) else 0.0
        until = np.append(self._time_s[ends], last)[: len(begins)]
        self.pulses_s: FloatArray = until - self._time_s[begins]
        pulse = np.cumsum(self._begins) - 1
        self._length_s = self.pulses_s[pulse] if len(begins) else np.zeros(len(at))

    def edges(self, how: Opening) -> Edges:
        """Steps of the level that the valve has."""
        kept = self._length_s >= how.least_s
        late = np.where(self._begins, np.minimum(how.loss_s, self._length_s), 0.0)
        edges = (self._time_s + how.delay_s + late)[kept]
        order = np.argsort(edges, kind="stable")
        return Edges(edges[order], self._change[kept][order], self._late_s[kept][order])

    def integrals(self, time_s: FloatArray, how: Opening) -> FloatArray:
        """Of the level that it has from the start until some times, in any shape, s, and of that, s^2: (2, ...)."""
        edges, change, _ = self.edges(how)
        level, moment, second = (
            np.append(0.0, np.cumsum(of)) for of in (change, change * edges, 0.5 * change * edges * edges)
        )
        before = np.searchsorted(edges, time_s)
        once = level[before] * time_s - moment[before]
        return np.stack([once, 0.5 * time_s * (once - moment[before]) + second[before]])


def valve_of_on_times(time_s: FloatArray, on_s: FloatArray) -> Valve:
    """Commands that say for how long the valve is to be open from their time on."""
    on = on_s > 0.0
    edges = np.concatenate([time_s[on], time_s[on] + on_s[on]])
    change = np.repeat([1.0, -1.0], int(on.sum()))
    order = np.lexsort((-change, edges))
    level = np.clip(np.cumsum(change[order]), 0.0, 1.0)
    start, end = time_s[:1], time_s[-1:]
    edges = np.concatenate([start, edges[order], np.maximum(end, edges.max(initial=-np.inf))])
    return Valve(edges, np.concatenate([[0.0], level, [0.0]]), exact=True)


class Thrusters(NamedTuple):
    """j thrusters, in the base's axes and on the table."""

    names: tuple[str, ...]
    force_N: FloatArray  # (j,) at level 1  # noqa: N815
    place_m: FloatArray  # (j, 2)
    direction: FloatArray  # (j,) angle of the force from x, rad
    scale_sigma: FloatArray  # (j,)
    common_sigma: float  # relative, of the force of all alike
    valves: tuple[Valve, ...]


class BodySigmas(NamedTuple):
    """1 sigma of what moves the body besides its thrusters' scales, and of what is known of these; as the keys say."""

    mass_sigma: float | None  # relative; None: nothing is known of it
    tilt_sigma_m_s2: float
    uneven_sigma_m_s2: float  # steady in a window
    turning_sigma_rad_s2: float
    drag_sigma_1_s: float
    spin_drag_sigma_1_s: float
    place_sigma_m: float  # of each thruster's lever
    turn_sigma_rad: float
    leak_sigma: float  # share of the force while it is off
    delay_ms: tuple[float, float]  # least and largest
    each_delay_sigma_ms: float
    loss_sigma_ms: float

    @property
    def delay_s(self) -> tuple[float, float]:
        """Least and largest delay."""
        low, high = self.delay_ms
        return 1e-3 * low, 1e-3 * high


class Tracker(NamedTuple):
    """Where the tracked frame is in the base, and 1 sigma of what is known of it."""

    place_m: FloatArray  # (2,)
    yaw_rad: float
    turn_sigma_rad: float
    place_sigma_m: float
    scale_sigma: float
    noise: FloatArray  # (3,) of one pose: m, m, rad
