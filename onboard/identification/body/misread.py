"""What columns of a recording may be taken for: thrusters exchanged or pushing the other way, axes of the tracker.

Each way to read it competes with the file as stated by the sum of squares that a first guess leaves
(:mod:`onboard.identification.body.start`), which is linear and leaves several times as much of poses that are read
wrongly. Of a delay all that is linear comes from the products of what each valve alone would move, with the poses:
another way to read them is another sum of these, so that pairs of mistakes compete, too. With x, y and yaw turned alike
nothing changes: of the tracker's axes, sixteen ways are left.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from onboard.identification.body.fit import BodyModel, TrackedPoses
from onboard.identification.body.start import PoseAxes, solved
from onboard.identification.misread import exchanged, score, turned

_OTHER = "the other way"
_MIRRORED = (  # by quarter turns of the yaw
    f"y counts {_OTHER}",
    f"x and y are exchanged and count {_OTHER}",
    f"x counts {_OTHER}",
    "x and y are exchanged",
)
_AXES = tuple(product((1.0, -1.0), (1.0, -1.0), range(4)))  # signs of y and of the yaw, quarter turns of the yaw


class Interpretation(NamedTuple):
    """A way to read a recording."""

    said: tuple[str, ...]  # what is otherwise than stated
    model: BodyModel
    poses: TrackedPoses


class _Commands(NamedTuple):
    """A way to read the commands."""

    said: tuple[str, ...]
    valves: tuple[int, ...]  # of each thruster, the valve that its commands are of
    signs: tuple[float, ...]


class _Way(NamedTuple):
    """A way to read all of it, and what a first guess leaves of it."""

    left: float
    axes: int  # of _AXES
    commands: _Commands

    @property
    def mistakes(self) -> int:
        """How many."""
        return (self.axes > 0) + len(self.commands.said)

    @property
    def score(self) -> float:
        """The smaller, the likelier."""
        return score(self.left, self.mistakes)


def others(model: BodyModel, poses: TrackedPoses) -> Iterator[Interpretation]:
    """Ways to read a recording otherwise that leave much less of it, the likeliest of one, two and three mistakes.

    Axes of the tracker are one mistake. Two mistakes compete in all pairs, the third one is added to the best pair.

    Args:
        model: of the body.
        poses: of the recording.

    Raises:
        ConvergenceError: there are no windows of poses.
    """
    found, full, names = model.products(poses), model.full, model.thrusters.names

    def weighed(axes: int, some: Sequence[_Commands]) -> Iterator[_Way]:
        forces = np.zeros((len(some), *full.shape))
        for k, one in enumerate(some):
            forces[k, list(one.valves)] = np.array(one.signs)[:, None] * full
        y, yaw, quarters = _AXES[axes]
        read = PoseAxes(y, yaw, model.axes.turn_rad + 0.5 * np.pi * quarters)
        least = solved(found, forces, model.tracker.place_m, read).least
        return (_Way(left, axes, one) for left, one in zip(least.tolist(), some, strict=True))

    stated = _Commands((), tuple(range(len(names))), (1.0,) * len(names))
    once = [*_changed(stated, names)]
    twice = [two for one in once for two in _changed(one, names)]
    ways = [way for axes in range(len(_AXES)) for way in weighed(axes, [stated, *once, *(twice if not axes else ())])]
    pair = min((way for way in ways if way.mistakes == 2), key=lambda way: way.left)
    ways += weighed(pair.axes, [*_changed(pair.commands, names)])
    ways += [way for axes in range(1, len(_AXES)) if not pair.axes for way in weighed(axes, [pair.commands])]
    best = [min((way for way in ways if way.mistakes == n), key=lambda way: way.left) for n in range(4)]
    for way in sorted(best[1:], key=lambda way: way.score):
        if way.score < best[0].score:
            yield _reading(way, model, poses)


def _changed(now: _Commands, names: Sequence[str]) -> Iterator[_Commands]:
    """Commands with one mistake more: two columns exchanged, a thruster the other way."""
    for pair, valves in exchanged(now.valves, names):
        yield _Commands((*now.said, f"{pair} are exchanged"), valves, now.signs)
    for name, factor in zip(names, turned(len(names)), strict=True):
        yield _Commands((*now.said, f"{name} pushes {_OTHER}"), now.valves, tuple(factor * now.signs))


def _reading(way: _Way, model: BodyModel, poses: TrackedPoses) -> Interpretation:
    of, (sign_y, sign_yaw, quarters) = model.thrusters, _AXES[way.axes]
    valves = tuple(of.valves[k] for k in way.commands.valves)
    turned = of.direction + np.pi * (np.array(way.commands.signs) < 0)
    x, y, yaw = poses.measured.T
    measured = np.stack([x, sign_y * y, sign_yaw * yaw + 0.5 * np.pi * quarters], axis=1)
    axes = _of_axes(sign_y < 0.0, sign_yaw < 0.0, quarters)
    said = (*way.commands.said, *([axes] if axes else ()))
    return Interpretation(
        said, model.with_thrusters(of._replace(valves=valves, direction=turned)), poses._replace(measured=measured)
    )


def _of_axes(mirrored: bool, backwards: bool, quarters: int) -> str:
    """What the tracker's axes are, if y and the yaw are to be so changed, the yaw last by quarter turns."""
    said = []
    if mirrored:
        said.append(_MIRRORED[quarters])
    elif quarters:
        said.append(f"yaw is {360 - 90 * quarters} deg ahead")
    if backwards:
        said.append(f"yaw counts {_OTHER}")
    return f"the tracker's {' and its '.join(said)}" if said else ""
