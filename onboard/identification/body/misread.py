"""What columns of a recording may be taken for: thrusters exchanged or pushing the other way, axes of the tracker.

Each way to read it competes with the file as stated by the sum of squares that a first guess leaves
(:mod:`onboard.identification.body.start`), which is linear and leaves several times as much of poses that are read
wrongly. With x, y and yaw turned alike nothing changes: of the tracker's axes, sixteen ways are left.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from onboard.estimation.policy import MISFIT_REFUSED
from onboard.identification.body.fit import BodyModel
from onboard.identification.body.windows import TrackedPoses

_OTHER = "the other way"
_MIRRORED = (  # by quarter turns of the yaw
    f"y counts {_OTHER}",
    f"x and y are exchanged and count {_OTHER}",
    f"x counts {_OTHER}",
    "x and y are exchanged",
)


class Reading(NamedTuple):
    """A way to read a recording."""

    said: tuple[str, ...]  # what is otherwise than stated
    model: BodyModel
    poses: TrackedPoses


def likelier(now: Reading, known_s: tuple[float, float], unknown: Sequence[tuple[float, float]] = ()) -> Reading | None:
    """Of all that differ from ``now`` by one mistake, that which leaves least; None: it leaves hardly less.

    Args:
        now: a way to read it.
        known_s: as of :meth:`onboard.identification.body.fit.BodyModel.fit`.
        unknown: the same.
    """
    left = now.model.left(now.poses, known_s, unknown)
    every = [(other.model.left(other.poses, known_s, unknown), other) for other in _others(now)]
    least, found = min(every, key=lambda one: one[0])
    return found if least < left / MISFIT_REFUSED else None


def _others(now: Reading) -> Iterator[Reading]:
    thrusters = now.model.thrusters
    for i, j in combinations(range(len(thrusters.names)), 2):
        order = [*range(len(thrusters.names))]
        order[i], order[j] = j, i
        valves = tuple(thrusters.valves[k] for k in order)
        said = f"{thrusters.names[i]} and {thrusters.names[j]} are exchanged"
        yield Reading((*now.said, said), now.model.with_thrusters(thrusters._replace(valves=valves)), now.poses)
    for j, name in enumerate(thrusters.names):
        turned = thrusters.direction + np.pi * (np.arange(len(thrusters.names)) == j)
        model = now.model.with_thrusters(thrusters._replace(direction=turned))
        yield Reading((*now.said, f"{name} pushes {_OTHER}"), model, now.poses)
    for mirrored, sign, quarters in product((False, True), (1.0, -1.0), range(4)):
        if said := _of_axes(mirrored, sign < 0.0, quarters):
            x, y, yaw = now.poses.measured.T
            measured = np.stack([x, -y if mirrored else y, sign * yaw + 0.5 * np.pi * quarters], axis=1)
            yield Reading((*now.said, said), now.model, now.poses._replace(measured=measured))


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
