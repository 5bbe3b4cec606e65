"""Wrench through a cut of a floating vehicle's arm, predicted from the base's motion; what a load cell feels.

The near side exerts on all that lies beyond the cut the wrench that its motion asks for (Newton-Euler; Limparis
2.132), linear in the standard parameters. With the base's motion of :mod:`onboard.dynamics.free_flight`, specific force
f, rate w and its derivative dw, its derivative by any unknown is ``C [df; ddw] + slope dw + W + Y``: C composite
inertia of what lies beyond, slope its derivative by the rate at fixed f and dw, W the columns of the standard
parameters and Y those of the joints' errors (:mod:`onboard.dynamics.joint_errors`).
Computed in ``onboard/native/src/cut.c``.
"""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.free_flight import BasePrediction
from onboard.dynamics.joint_errors import JointErrors
from onboard.dynamics.kinematics import Bodies
from onboard.dynamics.model.errors import UnknownFrameError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.native import library, structures


class CutReading(NamedTuple):
    """A component of a wrench at n ticks and its derivatives."""

    values: FloatArray  # (n,)
    d_values: FloatArray  # (n, 3 + c): by what the base's motion depends on


class CutWrench:
    """One component of the wrench through a cut, in the axes of the cut's frame and about its origin.

    Args:
        vehicle: the model.
        frame: the cut; what the near side exerts on the far side is positive.
        projection: weights of force and moment, (6,).
        free: links whose columns the base's prediction has.
        cyclic: the joint of each cyclic error's function, as in :class:`onboard.dynamics.joint_errors.JointErrors`.

    Raises:
        UnknownFrameError: no such frame, or no link beyond it.
    """

    def __init__(
        self,
        vehicle: VehicleModel,
        frame: str,
        projection: FloatArray,
        free: tuple[int, ...],
        cyclic: Sequence[int] = (),
    ) -> None:
        self._beyond = list(vehicle.distal_links(frame))
        if not self._beyond:
            raise UnknownFrameError(f"no link with inertia lies beyond frame {frame!r}, so no wrench goes through it")
        self._group = np.zeros((1, len(vehicle.links)))
        self._group[0, self._beyond] = 1.0
        self._is_beyond = np.repeat([float(link in self._beyond) for link in free], 10)
        cut, carrier = (vehicle.model.frames[vehicle.frame_id(name)] for name in (frame, self._carrier(vehicle, frame)))
        place = carrier.placement.actInv(cut.placement)
        self._R, self._p = (np.array(part, np.float64, order="C") for part in (place.rotation, place.translation))
        self.errors = JointErrors(vehicle, cyclic, frame)
        weights = self._group, self._is_beyond, self._R, self._p, library.given(projection, 6)
        self.compiled = structures.Cut(self._carried_by, self._is_beyond.size, *weights)

    def _carrier(self, vehicle: VehicleModel, frame: str) -> str:
        """A link that moves with the frame."""
        joint = vehicle.model.frames[vehicle.frame_id(frame)].parentJoint
        for link in self._beyond:
            if vehicle.model.frames[vehicle.frame_id(vehicle.links[link])].parentJoint == joint:
                self._carried_by = link
                return str(vehicle.links[link])
        raise UnknownFrameError(f"no link with inertia is fixed to frame {frame!r}; name a link's")

    def predict(self, base: BasePrediction) -> CutReading:
        """The component and its derivatives, where the vehicle's base moves as predicted from its links."""
        n, total = len(base.rate), base.along.shape[2]
        moving, errors = self.moving(base), None if base.displaced is None else self.errors.compiled
        work, out = np.empty(6 * self.errors.columns), np.empty(n * (1 + total))
        given = ctypes.byref(moving), ctypes.byref(self.compiled), None if errors is None else ctypes.byref(errors)
        library.call("heft_cut_wrench", *given, library.address(work), out=out)
        return CutReading(out[:n], out[n:].reshape(n, total))

    def moving(self, base: BasePrediction) -> structures.MovingStruct:
        """The motion for the compiled core.

        Raises:
            ArrayError: it is that of another vehicle, or has columns that are not those of these errors.
        """
        n, links, columns = len(base.rate), self._group.shape[1], 3 + self._is_beyond.size
        if base.displaced is not None:
            columns += self.errors.columns
            joints, functions = self.errors.compiled.joints, self.errors.compiled.functions
            library.given(base.displaced.screws, n, joints, 6, 12)
            library.given(base.displaced.functions, n, 3, functions)
        shapes = (n, links, 3), (n, 9, max(columns, base.along.shape[2])), (n, 6, 3), (n, 6, 6)
        for part, shape in zip((_moving(base).frames.p, base.along, base.by_rate, base.by_wrench), shapes, strict=True):
            library.given(part, *shape)
        bodies, frames = _moving(base), _moving(base).frames
        own = bodies.parts, bodies.twist, base.along, base.by_rate, base.by_wrench
        R, p = library.given(frames.R, *frames.R.shape), library.given(frames.p, *frames.p.shape)
        return structures.MovingStruct(n, links, base.along.shape[2], R, p, *own, *(base.displaced or (None, None)))


def _moving(base: BasePrediction) -> Bodies:
    """The links of a predicted motion; the motion on a table, which is not predicted from them, has none."""
    assert base.bodies is not None
    return base.bodies
