"""Derivatives of a floating vehicle's momentum and wrench by errors of its joints.

Place, encoder zero, scale, delay, and cyclic errors: multiples of given functions of time, such as the sine of a
motor's angle.

A joint's error displaces all that lies beyond it by a small screw S, fixed in the link that carries the joint: a
translation, or a rotation about the joint's axis. With W the twist of that link, ``X = crm(W)``, and I, L, F composite
inertia, momentum and wrench of what lies beyond, all spatial and about the base's origin (Featherstone, Rigid Body
Dynamics Algorithms, 2008, chapter 2), a screw of size e(t) changes twists beyond by ``e S x (V - W) + de S`` and
inertias by ``e (crf(S) I - I crm(S))``, hence (derived here)

    dL = e (K(L) + I X) S + de I S
    dF = d(dL)/dt = e (K(L) X + K(F) + dI X + I (X X + dX)) S + de (K(L) + 2 I X + dI) S + dde I S

with ``K(L) S = crf(S) L``, ``dI = crf(V) I - I crm(V)`` summed over the links beyond, and ``dX = crm(dW/dt)``. In the
axes of a frame that the joint displaces too, and about its origin, dF is without K(F): the frame moves by the same S.
Computed in ``onboard/native/src/errors.c``.
"""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.kinematics import Bodies, Chain, Sums
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.native import library, structures
from onboard.native.errors import ArrayError

JOINT_ERRORS = ("place_x", "place_y", "place_z", "zero", "scale", "delay")
PER_JOINT = len(JOINT_ERRORS)


class Corrected(NamedTuple):
    """Readings with errors taken out."""

    q: FloatArray  # (n, joints), as are the others
    dq: FloatArray
    ddq: FloatArray
    functions: FloatArray  # (n, 3, 2 x joints + m) of time that scale, delay and cyclic errors multiply; derivatives


class EncoderReadings(NamedTuple):
    """What the encoders say."""

    q: FloatArray  # (n, joints) position, rate, acceleration
    dq: FloatArray
    ddq: FloatArray
    period_s: float  # between ticks, for third derivatives by differences of the second; zero: these are zero
    cyclic: FloatArray  # (n, 3, m) functions that cyclic errors are multiples of, and two derivatives

    def corrected(self, errors: FloatArray, multiples: FloatArray, of: IndexArray) -> Corrected:
        """With errors taken out, ``q + zero + scale q + delay dq``, those of cyclic functions first.

        What a late encoder says is a former angle with the error at that angle. Of ripples that are no motion a delay
        tells nothing: beside them in the rates that it multiplies it would be found too small.

        Args:
            errors: in the order of :data:`JOINT_ERRORS`, (joints, 6).
            multiples: of the first k functions, (k,); the others stay.
            of: the joint of each function, (m,).

        Raises:
            ArrayError: shapes that do not fit.
        """
        (n, joints), m = self.q.shape, self.cyclic.shape[2]
        each = [library.given(part, n, joints) for part in self[:3]]
        given = library.given(self.cyclic, n, 3, m), library.indices(of, joints), library.given(errors, joints, 6)
        if len(of) != m or len(multiples) > m:
            raise ArrayError(f"{m} functions have {len(of)} joints and {len(multiples)} multiples")
        read = structures.Read(n, joints, m, len(multiples), *each, *given, library.given(multiples, len(multiples)))
        f, work = 2 * joints + m, np.empty(4 * joints)
        out = np.empty(3 * n * (joints + f))
        library.call("heft_corrected", ctypes.byref(read), self.period_s, library.address(work), out=out)
        return Corrected(*library.carved(out, [*[(n, joints)] * 3, (n, 3, f)]))


class Displaced(NamedTuple):
    """Screws of a joint's translations along its axes and of its own motion, and what they become with its seat."""

    screws: FloatArray  # (n, joints, 6, 12): S, X S, (X X + dX) S, four columns each
    functions: FloatArray  # (n, 3, f) of time that scale, delay and cyclic errors multiply, and derivatives


class JointErrors:
    """Errors of the joints of a vehicle.

    Args:
        vehicle: whose joints they are.
        cyclic: the joint of each function that a cyclic error is a multiple of, (m,).
        frame: momentum and wrench are those of what lies beyond this frame, displaced with it; None: of all links.

    Attributes:
        of_cyclic: the joints of the functions, (m,).
        beyond_links: one where the column's link lies beyond the row's joint, and the frame, (joints, links).
        columns: number of the errors, 6 x joints + m.
        compiled: the same for the compiled core.

    Raises:
        ArrayError: a function of a joint that the vehicle does not have.
    """

    def __init__(self, vehicle: VehicleModel, cyclic: Sequence[int] = (), frame: str | None = None) -> None:
        joints = len(vehicle.joints)
        self.of_cyclic = library.indices(np.array(cyclic, np.intp), joints)
        links = range(len(vehicle.links)) if frame is None else vehicle.distal_links(frame)
        self.beyond_links = np.zeros((joints, len(vehicle.links)))
        for row, joint in zip(self.beyond_links, vehicle.joints, strict=True):
            row[[link for link in vehicle.distal_links(joint.name) if link in links]] = 1.0
        displaces = self.beyond_links.sum(axis=1) == len(links) if frame is not None else np.zeros(joints, np.bool_)
        self.columns = PER_JOINT * joints + len(cyclic)
        each = np.arange(joints)
        self._of = np.concatenate([each, each, self.of_cyclic])  # joint of each error that is a function
        stays = np.where(displaces, 0.0, 1.0)
        self.compiled = structures.ErrorsStruct(joints, len(self._of), self.beyond_links, stays, self._of)

    def along(self, chain: Chain, functions: FloatArray, local: int = 0) -> "ErrorsAlong":
        """The errors along one motion of the vehicle's chain; see :class:`ErrorsAlong`."""
        return ErrorsAlong(self, chain, functions, local)

    def beyond(self, bodies: Bodies) -> Sums:
        """Sums over the links beyond each joint, those beyond the frame alone."""
        return bodies.sums(self.beyond_links)

    def of_moment(self, displaced: Displaced, bodies: Bodies) -> FloatArray:
        """Derivative of the sum of mass times place of the links, base axes, (n, 3, columns): ``I S`` of those beyond.

        Args:
            displaced: by the errors.
            bodies: all links.
        """
        moved = self.beyond(bodies).inertia[..., :3, :] @ displaced.screws[..., :4]  # (n, joints, 3, 4)
        moving = (moved[..., 3][:, self._of] * displaced.functions[:, 0, :, None]).swapaxes(1, 2)
        (n, joints), out = moved.shape[:2], np.empty((len(moved), 3, self.columns))
        own, two = out[:, :, : PER_JOINT * joints].reshape(n, 3, joints, PER_JOINT), 2 * joints
        own[..., :4] = moved.transpose(0, 2, 1, 3)
        own[..., 4:] = moving[:, :, :two].reshape(n, 3, 2, joints).swapaxes(2, 3)
        out[:, :, PER_JOINT * joints :] = moving[:, :, two:]
        return out


class ErrorsAlong(NamedTuple):
    """Errors of the joints along one motion."""

    errors: JointErrors
    chain: Chain
    functions: FloatArray  # (n, 3, f), see :class:`Corrected`
    local: int = 0  # so many of the last columns are errors at each tick by itself, not along the motion
