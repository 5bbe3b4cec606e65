"""The arm over time: the URDF's frames at the measured joint positions, as a drawing and as data for a slider."""

import json

import numpy as np
from matplotlib.figure import Figure

from onboard.dynamics.model.skeleton import Skeleton, skeleton
from onboard.estimation.arrays import FloatArray
from onboard.ground.drawing.gallery import Gallery
from onboard.ground.drawing.theme import COLOUR, CYCLE, subplots
from onboard.ground.report.flight.flight_data import FlightData

_POSES = 400  # of the slider
_DRAWN = 5
_VIEWS = ((0, 1), (0, 2))  # columns of the two drawings


class PointMotion:
    """The vehicle's points over time.

    Attributes:
        time_s: (t,) since the log's start.
        points: (t, n) points in base axes.
    """

    def __init__(self, time_s: FloatArray, points: Skeleton) -> None:
        self.time_s, self.points = time_s, points

    def as_json(self) -> str:
        """Data of the page's player, safe inside a ``script`` element; places in mm."""
        data = {
            "time": np.round(self.time_s, 3).tolist(),
            "names": self.points.names,
            "lines": self.points.lines,
            "moving": self.points.moving,
            "mm": np.round(1e3 * self.points.p_m.reshape(len(self.time_s), -1), 1).tolist(),
        }
        text = json.dumps(data, separators=(",", ":"), allow_nan=False)
        return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def motion(flight: FlightData) -> PointMotion | None:
    """From the measured joint positions; None without a model, or where no position of a joint is measured."""
    if flight.model is None or flight.roles is None:
        return None
    measured = {
        joint.joint: flight.traces[joint.channel]
        for joint in flight.roles.joints
        if not joint.is_rate and joint.channel in flight.traces
    }
    names = [joint.name for joint in flight.model.joints]
    whole = {name: trace for name, trace in measured.items() if np.isfinite(trace.mean[:, 0]).sum() > 1}
    if not set(whole) & set(names):
        return None
    start = max(float(trace.time_s[0]) for trace in whole.values())
    stop = min(float(trace.time_s[-1]) for trace in whole.values())
    if not stop > start:
        return None
    time_s = np.linspace(start, stop, _POSES)
    q = np.zeros((_POSES, len(names)))
    for column, name in enumerate(names):
        if name in whole:
            known = np.isfinite(whole[name].mean[:, 0])
            q[:, column] = np.interp(time_s, whole[name].time_s[known], whole[name].mean[known, 0])
    return PointMotion(time_s, skeleton(flight.model, q))


def draw(found: PointMotion) -> Figure:
    """Two views of the vehicle at times over the flight, the latest in the strongest colour."""
    figure, every = subplots(1, 2, height_in=2.6)
    p_mm = 1e3 * found.points.p_m
    at = np.linspace(0, len(p_mm) - 1, _DRAWN).round().astype(int)
    for axes, (across, up) in zip(every, _VIEWS, strict=True):
        for number, tick in enumerate(at):
            for one, two in found.points.lines:
                ends = p_mm[tick][[one, two]]
                moving = found.points.moving[two]
                if not moving and number:
                    continue
                colour = CYCLE[number % len(CYCLE)] if moving else COLOUR["idle"]
                first = moving and two == found.points.moving.index(True)
                label = f"{found.time_s[tick]:.0f} s" if first else "_"
                axes.plot(ends[:, across], ends[:, up], "o-", color=colour, markersize=3, label=label)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel(f"{'xyz'[across]} of the base, mm")
        axes.set_ylabel(f"{'xyz'[up]} of the base, mm")
    every[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=_DRAWN, borderaxespad=0.0)
    return figure


def section(flight: FlightData, gallery: Gallery) -> str:
    """Of the page: the drawing, and data for its player; empty where no joint position is known."""
    found = motion(flight)
    if found is None:
        return ""
    drawing = gallery(
        draw(found),
        "The URDF's frames at the measured joint positions, the base at rest; joints that nothing measures at zero. "
        "Grey: fixed in the base. With scripts allowed, the arm below turns by dragging and moves by the slider.",
    )
    return f'{drawing}<div class="arm"><script type="application/json">{found.as_json()}</script></div>\n'
