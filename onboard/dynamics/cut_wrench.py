"""Wrench through a cut of a floating vehicle's arm, predicted from the base's motion; what a load cell feels.

The near side exerts on all that lies beyond the cut the wrench that its motion asks for (Newton-Euler; Limparis
2.132), linear in the standard parameters. With the base's motion of :mod:`onboard.dynamics.free_flight`, specific force
f, rate w and its derivative dw, its derivative by any unknown is ``C [df; ddw] + slope dw + W + Y``: C composite
inertia of what lies beyond, slope that of :func:`onboard.dynamics.kinematics.wrench_and_slope`, W the columns of the
standard parameters and Y those of the joints' errors (:mod:`onboard.dynamics.joint_errors`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.errors import UnknownFrameError
from onboard.dynamics.free_flight import BasePrediction
from onboard.dynamics.joint_errors import JointErrors, Readings
from onboard.dynamics.kinematics import (
    Chain,
    LinkMotion,
    bodies_of,
    composite_of,
    hat,
    relative_momentum,
    stacked,
    turned,
    wrench_and_slope,
    wrench_columns,
)
from onboard.dynamics.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray


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
        free: links whose columns are wanted, as in :func:`onboard.dynamics.free_flight.predict_base_from_rate`.
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
        self._projection = projection
        self._columns = [(k, self._beyond.index(link)) for k, link in enumerate(free) if link in self._beyond]
        self._free = len(free)
        cut, carrier = (vehicle.model.frames[vehicle.frame_id(name)] for name in (frame, self._carrier(vehicle, frame)))
        place = carrier.placement.actInv(cut.placement)
        self._R, self._p = np.array(place.rotation), np.array(place.translation)
        self._errors = JointErrors(vehicle, cyclic, frame)

    def _carrier(self, vehicle: VehicleModel, frame: str) -> str:
        """A link that moves with the frame."""
        joint = vehicle.model.frames[vehicle.frame_id(frame)].parentJoint
        for link in self._beyond:
            if vehicle.model.frames[vehicle.frame_id(vehicle.links[link])].parentJoint == joint:
                self._carried_by = self._beyond.index(link)
                return str(vehicle.links[link])
        raise UnknownFrameError(f"no link with inertia is fixed to frame {frame!r}; name a link's")

    def predict(
        self, chain: Chain, chi: FloatArray, base: BasePrediction, readings: Readings | None = None
    ) -> CutReading:
        """The component and its derivatives.

        Args:
            chain: motion of the vehicle.
            chi: standard parameters of all links, (10 x links,).
            base: its motion, with the derivatives by the ``free`` links.
            readings: of the encoders, where ``base`` has derivatives by the joints' errors.
        """
        links, bodies_chi = self._links(chain.links), chi.reshape(-1, 10)[self._beyond]
        bodies = bodies_of(links, bodies_chi.ravel())
        w, f, dw = (x[:, None] for x in (base.rate, base.specific_force, base.acceleration))
        W = wrench_columns(links, w, f, dw)  # (n, links, 6, 10)
        wrench = np.einsum("ndij,dj->ni", W, bodies_chi)
        slope = wrench_and_slope(bodies, w)[1]  # (n, 6, 3)
        along = np.concatenate([base.d_specific_force, base.d_acceleration], axis=1)
        d_wrench = composite_of(bodies) @ along + slope @ base.d_rate
        for column, link in self._columns:
            d_wrench[:, :, 3 + 10 * column : 13 + 10 * column] += W[:, link]
        if readings is not None:
            still = np.zeros_like(base.rate)  # no wrench depends on a common velocity
            motion = still, base.rate, base.specific_force, base.acceleration
            d_wrench[:, :, 3 + 10 * self._free :] += self._errors.columns(
                stacked(chain.seats), readings, bodies, *motion
            )[1]
        u = self._weights(links)
        return CutReading(np.einsum("ni,ni->n", u, wrench), (u[:, None] @ d_wrench)[:, 0])

    def of_joint_accelerations(self, links: tuple[LinkMotion, ...], chi: FloatArray, twist: FloatArray) -> FloatArray:
        """The component that an acceleration of joints makes, (n,), squares of rates neglected.

        Args:
            links: of the vehicle, with the accelerations as rates.
            chi: standard parameters of all links, (10 x links,).
            twist: acceleration of the base (linear, angular) that it makes, (n, 6).
        """
        beyond = self._links(links)
        bodies = bodies_of(beyond, chi.reshape(-1, 10)[self._beyond].ravel())
        wrench = turned(composite_of(bodies), twist) + relative_momentum(bodies)
        return np.asarray(np.einsum("ni,ni->n", self._weights(beyond), wrench), np.float64)

    def _links(self, links: tuple[LinkMotion, ...]) -> LinkMotion:
        return stacked([links[k] for k in self._beyond])

    def _weights(self, links: LinkMotion) -> FloatArray:
        """Of a wrench about the base's origin in base axes, (n, 6)."""
        R = links.R[:, self._carried_by]
        p = links.p[:, self._carried_by] + R @ self._p
        force, moment = (turned(R @ self._R, part) for part in self._projection.reshape(2, 3))
        # m . (M - p x F) = m . M - (m x p) . F
        return np.concatenate([force - turned(hat(moment), p), moment], axis=1)
