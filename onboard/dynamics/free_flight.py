"""Predicts the motion of a free-floating base from parameters, joints and the initial angular momentum.

No external wrench acts, so the linear momentum can be set to zero (a common velocity has no effect in free fall), and
the angular momentum is constant in inertial axes. In base axes ``d eta / dt = eta x w``, with the base's twist from

    C(q) [v; w] + mu(q, dq) = [0; eta]

(C: spatial inertia of the whole vehicle, mu: momentum of the moving joints; Limparis 2.84-2.93 with the initial
momentum P_0 of 3.6-3.8). The specific force and angular acceleration follow from the zero wrench. The attitude is not
needed. Unlike regression rows, the prediction contains no measured base motion, so its noise causes no bias.

A known wrench (F; T) on the base, about its origin, as of thrusters, adds ``C^-1 [F; T]`` to specific force and angular
acceleration, and ``T - r x F`` to ``d eta / dt``, r the centre of mass of the whole vehicle.

Derivatives of momentum (by fourth-order Runge-Kutta, with values half-way between ticks by cubics) and its
sensitivity (``dS/dt = A S + forcing``, A = eta x J - w x) are computed in ``onboard/native/src``: ``base.c``,
``momentum.c``.
"""

import ctypes
from collections.abc import Sequence
from operator import is_
from typing import Any, NamedTuple

import numpy as np

from onboard.dynamics.joint_errors import Displaced, ErrorsAlong
from onboard.dynamics.kinematics import Bodies, Frames, LinkMotion, frames_of, motion_size, moving_frames, turned
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.spatial import Columns
from onboard.estimation.arrays import FloatArray, hat
from onboard.native import library, structures


class Push(NamedTuple):
    """Known wrench on the base at every tick, the sum of k sources: force and moment about its origin, base axes."""

    of_each: FloatArray  # (n, 6, k) as it is stated
    gain: FloatArray  # (k,) by which it is multiplied

    def and_too(self, more: "Push") -> "Push":
        """These sources and more."""
        both = np.concatenate([self.of_each, more.of_each], axis=2)
        return Push(both, np.concatenate([self.gain, more.gain]))


class BasePrediction(NamedTuple):
    """Motion of the base at every tick, in base axes, and its derivatives with respect to (eta_0, chi)."""

    rate: FloatArray  # (n, 3) rad/s
    acceleration: FloatArray  # (n, 3) rad/s^2
    specific_force: FloatArray  # (n, 3) m/s^2, at the base frame's origin
    along: FloatArray  # (n, 9, 3 + c) derivative of the rate, then columns of a wrench; c columns of chi
    by_rate: FloatArray  # (n, 6, 3) derivative of specific force and acceleration by the rate
    by_wrench: FloatArray  # (n, 6, 6) and by that wrench
    momentum: FloatArray  # (n, 3) N m s, angular, about the centre of mass
    d_momentum: FloatArray  # (n, 3, 3 + c)
    bodies: Bodies | None = None  # the links as they move
    displaced: Displaced | None = None  # what errors of the joints do to them
    local: slice = slice(0)  # columns of errors at each tick by itself; if there are any, further ones are the last
    made: structures.BaseStruct | None = None  # of this motion, where it is the core's own

    @property
    def at_first(self) -> slice:
        """Columns of the local errors at the first tick, by the momentum that they make of the rate there."""
        end = self.along.shape[2] - 3
        return slice(end - (self.local.stop - self.local.start), end)

    @property
    def of_momentum(self) -> slice:
        """Columns of a momentum at each tick by itself."""
        return slice(self.along.shape[2] - 3, self.along.shape[2])

    def turned_momentum(self, by_local: FloatArray, period_s: float) -> FloatArray:
        """Derivative of the momentum by what local errors do to its direction, (n, 3, p).

        Args:
            by_local: derivative of the local errors at each tick, (n, local, p).
            period_s: between ticks.
        """
        forcing = hat(self.momentum) @ (self.along[:, :3, self.local] @ by_local)
        start, twist = np.zeros((3, 3 + forcing.shape[2])), np.zeros((len(self.rate), 6))
        twist[:, 3:] = self.rate
        return _sensitivity(-self.by_wrench, self.momentum, twist, forcing, start, period_s)[:, :, 3:]

    def compiled(self) -> structures.BaseStruct:
        """The motion for the compiled core.

        Raises:
            ArrayError: shapes that do not fit.
        """
        n, total = len(self.rate), self.along.shape[2]
        fields = self.rate, self.acceleration, self.specific_force, self.by_rate, self.by_wrench, self.along
        if self.made is not None and all(map(is_, fields, self.made.kept)):
            return self.made
        shapes = (n, 3), (n, 3), (n, 3), (n, 6, 3), (n, 6, 6), (n, 9, total)
        given = (library.given(part, *shape) for part, shape in zip(fields, shapes, strict=True))
        return structures.BaseStruct(n, total, *given)

    @property
    def d_rate(self) -> FloatArray:
        """Derivative of the rate, (n, 3, 3 + c)."""
        return self.along[:, :3]


def predict_base(
    links: Frames | Sequence[LinkMotion], period_s: float, chi: FloatArray, momentum: FloatArray, free: tuple[int, ...]
) -> BasePrediction:
    """Predicts the base's motion on an even grid of ticks (Limparis 2.84-2.93, 3.6-3.8).

    Args:
        links: motion of the links relative to the base.
        period_s: between ticks; at most a twentieth of the shortest period in the motion.
        chi: standard parameters of all links, (10 x links,).
        momentum: angular momentum about the centre of mass at the first tick, base axes, (3,), N m s.
        free: links whose ten columns are wanted in the derivatives.

    Raises:
        SignalError: fewer than four ticks.
    """
    return _predict(links, period_s, chi, momentum, Columns(free), by_rate=False)


def predict_base_from_rate(
    links: Frames | Sequence[LinkMotion],
    period_s: float,
    chi: FloatArray,
    rate: FloatArray,
    free: tuple[int, ...] | Columns,
    errors: ErrorsAlong | None = None,
    push: Push | None = None,
) -> BasePrediction:
    """As :func:`predict_base` from the base's rate w_0 at the first tick, (3,), rad/s; derivatives by (w_0, chi).

    With ``errors`` their columns (:mod:`onboard.dynamics.joint_errors`) come after those of chi, with ``push`` those of
    its gains after these. Local ones among them tell what an error at a tick does there; more columns at the end
    what those at the first tick do later, as with them the rate w_0 belongs to another momentum, and what a momentum
    at a tick does there.

    ``eta_0 = J^-1 (w_0 + k)``, with the equation above solved for the rate: ``w = J eta - k``. For the state of a
    filter: the gyro's bias adds to the rate itself, but to the momentum multiplied by every inertia, so that a filter
    with the momentum as its state gains information in unobservable directions as its linearisation point moves.
    """
    columns = free if isinstance(free, Columns) else Columns(free)
    return _predict(links, period_s, chi, rate, columns, errors, push, by_rate=True)


def bodies_from_rate(
    links: Frames | Sequence[LinkMotion], period_s: float, chi: FloatArray, rate: FloatArray, push: Push | None = None
) -> Bodies:
    """The links as they move in :func:`predict_base_from_rate`, which has the arguments, without derivatives."""
    frames = _checked(links)
    n, count = frames.p.shape[:2]
    moving, pushed, start = moving_frames(frames, chi), _pushed(push, n), library.given(rate, 3)
    arguments = ctypes.byref(moving), _by(pushed), period_s, library.address(start), 1
    return Bodies(frames, library.call("heft_move", *arguments, out=np.empty(motion_size(n, count))))


def _checked(links: Frames | Sequence[LinkMotion]) -> Frames:
    frames = links if isinstance(links, Frames) else frames_of(links)
    if len(frames.p) < 4:
        raise SignalError(f"{len(frames.p)} ticks; predict four or more")
    return frames


def _pushed(push: Push | None, ticks: int) -> structures.Pushed | None:
    if push is None:
        return None
    count = len(push.gain)
    return structures.Pushed(count, library.given(push.of_each, ticks, 6, count), library.given(push.gain, count))


def _by(structure: ctypes.Structure | None) -> Any:
    return None if structure is None else ctypes.byref(structure)


def _predict(
    links: Frames | Sequence[LinkMotion],
    period_s: float,
    chi: FloatArray,
    start: FloatArray,
    free: Columns,
    errors: ErrorsAlong | None = None,
    push: Push | None = None,
    *,
    by_rate: bool,
) -> BasePrediction:
    frames = _checked(links)
    n, count = frames.p.shape[:2]
    moving, pushed, start = moving_frames(frames, chi), _pushed(push, n), library.given(start, 3)
    own, joints, local, seats, functions = 10 * len(free.links), 0, 0, None, None
    if errors is not None:
        seats, joints, local = _seats(errors, n, count), errors.errors.compiled.joints, errors.local
        functions = library.given(errors.functions, n, 3, errors.errors.compiled.functions)
        own += errors.errors.columns
    width = 3 + own + (0 if push is None else len(push.gain))
    total = width + (local + 3 if local else 0)
    out = np.empty(motion_size(n, count) + n * (9 * total + 54 + 3 * width + 72 * joints))
    pointers = None if seats is None else (ctypes.c_void_p * 4)(*(library.address(part) for part in seats))
    compiled = ctypes.byref(moving), ctypes.byref(free.compiled(count)), _by(errors and errors.errors.compiled)
    arguments = pointers, library.address(functions), local, _by(pushed), period_s, library.address(start), by_rate
    library.call("heft_predict_base", *compiled, *arguments, out=out)
    return base_of(frames, functions, out, joints, width, slice(3 + own - local, 3 + own))


def base_of(
    frames: Frames, functions: FloatArray | None, out: FloatArray, joints: int, width: int, local: slice
) -> BasePrediction:
    """Motion of the base as the compiled core has put it.

    Args:
        frames: of the links, n ticks.
        functions: that errors of the joints multiply, (n, 3, f); None: the joints have none.
        out: what the core has put.
        joints: whose errors are among the columns; 0: none.
        width: number of columns but those of what is local.
        local: columns of local errors.
    """
    n, count = frames.p.shape[:2]
    size, own = motion_size(n, count), local.stop - local.start
    total = width + (own + 3 if own else 0)
    bodies = Bodies(frames, out[:size])
    shapes = (n, 9, total), (n, 6, 3), (n, 6, 6), (n, 3, width), (n, joints, 6, 12)
    along, by_base, by_wrench, d_momentum, screws = library.carved(out[size:], shapes)
    displaced = None if functions is None else Displaced(screws, functions)
    w, force, spin = (
        np.ascontiguousarray(x) for x in (bodies.twist[:, 3:], bodies.thrust[:, :3], bodies.thrust[:, 3:])
    )
    made = structures.BaseStruct(n, total, w, spin, force, by_base, by_wrench, along)
    moved = bodies.momentum, d_momentum, bodies, displaced, local, made
    return BasePrediction(w, spin, force, along, by_base, by_wrench, *moved)


def _seats(errors: ErrorsAlong, ticks: int, links: int) -> list[FloatArray]:
    """Axes, twists and their change of the joints' seats, and screws; of a vehicle with so many links."""
    chain, joints = errors.chain, errors.errors.compiled.joints
    library.given(errors.errors.beyond_links, joints, links)
    parts = (chain.seats.R, (3, 3)), (chain.seats.V, (6,)), (chain.seats.A, (6,)), (chain.screws, (6,))
    return [library.given(part, ticks, joints, *shape) for part, shape in parts]


def rate_of_momentum(
    inverse: FloatArray, still: FloatArray, momentum: FloatArray, period_s: float
) -> tuple[FloatArray, FloatArray]:
    """Base rate ``w = J eta - k`` on an even grid, with eta constant in inertial axes (Limparis 2.90, 3.6).

    Args:
        inverse: J, (n, 3, 3), base axes, 1 / (kg m^2).
        still: k, (n, 3) rad/s, less the rate without a momentum.
        momentum: eta at the first tick, about the centre of mass, (3,) N m s.
        period_s: between ticks.

    Returns:
        The rate (n, 3), rad/s, and its derivative by the momentum (n, 3, 3).
    """
    n = len(still)
    whole, still, momentum = np.zeros((n, 6, 6)), library.given(still, n, 3), library.given(momentum, 3)
    whole[:, 3:, 3:] = inverse
    pointers = (library.address(part) for part in (whole, still, momentum))
    eta = library.call("heft_momentum", n, *pointers, period_s, out=np.empty(3 * n)).reshape(n, 3)
    rate = turned(inverse, eta) - still
    turning = np.concatenate([np.zeros((n, 3)), rate], axis=1)
    return rate, inverse @ _sensitivity(whole, eta, turning, np.zeros((n, 3, 0)), np.eye(3), period_s)


def _sensitivity(
    inverse: FloatArray, momentum: FloatArray, twist: FloatArray, forcing: FloatArray, start: FloatArray, h: float
) -> FloatArray:
    """Integrates ``dS/dt = A S + [0 forcing]``, A = eta x J - w x, from ``start``, (3, 3 + c); (n, 3, 3 + c)."""
    n, _, width = len(momentum), 3, 3 + forcing.shape[2]
    shapes = (
        (inverse, (n, 6, 6)),
        (momentum, (n, 3)),
        (twist, (n, 6)),
        (forcing, (n, 3, width - 3)),
        (start, (3, width)),
    )
    parts = [library.given(part, *shape) for part, shape in shapes]
    pointers = (library.address(part) for part in parts)
    found = library.call("heft_sensitivity", n, width, *pointers, h, out=np.empty(3 * n * width))
    return found.reshape(n, 3, width)


class SensorPrediction(NamedTuple):
    """Rate and specific force of a sensor fixed in the base, in its own axes."""

    values: FloatArray  # (n, 6)
    gain: FloatArray  # (n, 6, 9) their derivative by what ``BasePrediction.along`` is the derivative of
    by_place: FloatArray  # (n, 6, 3) and by the sensor's place


def sensor_in_base(base: BasePrediction, R_BS: FloatArray, p_BoSo_B: FloatArray) -> SensorPrediction:
    """``f_So = f_Bo + dw x p + w x (w x p)``: the acceleration of a point of a rigid body.

    Args:
        base: its motion.
        R_BS: axes of the sensor's frame S in the base's B, (3, 3).
        p_BoSo_B: its origin, (3,), m.
    """
    n, compiled = len(base.rate), base.compiled()
    R, p, out = library.given(R_BS, 3, 3), library.given(p_BoSo_B, 3), np.empty(78 * n)
    library.call("heft_sensor", ctypes.byref(compiled), library.address(R), library.address(p), out=out)
    return SensorPrediction(*library.carved(out, [(n, 6), (n, 6, 9), (n, 6, 3)]))
