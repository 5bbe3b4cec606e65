"""Predicts the motion of a free-floating base from parameters, joints and the initial angular momentum.

No external wrench acts, so the linear momentum can be set to zero (a common velocity has no effect in free fall), and
the angular momentum is constant in inertial axes. In base axes ``d eta / dt = eta x w``, with the base's twist from

    C(q) [v; w] + mu(q, dq) = [0; eta]

(C: spatial inertia of the whole vehicle, mu: momentum of the moving joints; Limparis 2.84-2.93 with the initial
momentum P_0 of 3.6-3.8). The specific force and angular acceleration follow from the zero wrench. The attitude is not
needed. Unlike regression rows, the prediction contains no measured base motion, so its noise causes no bias.

A known wrench (F; T) on the base, about its origin, as of thrusters, adds ``C^-1 [F; T]`` to specific force and angular
acceleration, and ``T - r x F`` to ``d eta / dt``, r the centre of mass of the whole vehicle.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.bodies import Bodies
from onboard.dynamics.centre import centre_by_chi, centre_of
from onboard.dynamics.joint_errors import Displaced, ErrorsAlong
from onboard.dynamics.kinematics import Frames, LinkMotion, frames_of, turned
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.spatial import Columns, hat, times
from onboard.estimation.arrays import FloatArray


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
        start, J = np.zeros((3, 3 + forcing.shape[2])), -self.by_wrench[:, 3:, 3:]
        return _integrate_sensitivity(self.rate, self.momentum, J, forcing, start, period_s)[:, :, 3:]

    @property
    def d_rate(self) -> FloatArray:
        """Derivative of the rate, (n, 3, 3 + c)."""
        return self.along[:, :3]


def predict_base(
    links: Frames | Sequence[LinkMotion],
    period_s: float,
    chi: FloatArray,
    momentum: FloatArray,
    free: tuple[int, ...],
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
    return _move(links, period_s, chi, rate, push, by_rate=True).bodies


class _Motion(NamedTuple):
    """Of base and links, without derivatives."""

    bodies: Bodies
    inverse: FloatArray  # (n, 6, 6) of the composite inertia
    momentum: FloatArray  # (n, 3)
    slope: FloatArray  # (n, 6, 3) derivative of the wrench on all links by the rate of the base
    thrust: FloatArray  # (n, 6) specific force and angular acceleration
    pushed: "_Pushed | None"


def _inverse(composite: FloatArray) -> FloatArray:
    """Of inertias (n, 6, 6); NaN of a body that no twist tells from none: a solver's step there is refused."""
    try:
        return np.asarray(np.linalg.inv(composite), np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(composite, np.nan)


def _move(
    links: Frames | Sequence[LinkMotion],
    period_s: float,
    chi: FloatArray,
    start: FloatArray,
    push: Push | None,
    *,
    by_rate: bool,
) -> _Motion:
    frames = links if isinstance(links, Frames) else frames_of(links)
    n = len(frames.p)
    if n < 4:
        raise SignalError(f"{n} ticks; predict four or more")
    bodies = Bodies(frames, chi)
    inverse = _inverse(bodies.composite)
    mu = bodies.relative_momentum
    from_eta = inverse[:, :, 3:]  # (n, 6, 3) base twist per momentum
    still = times(inverse[:, 3:], mu)  # less the rate without a momentum
    momentum = np.linalg.solve(from_eta[0, 3:], start + still[0]) if by_rate else start
    pushed = None if push is None else _Pushed(push, bodies.composite)
    torque = pushed.torque if pushed is not None and pushed.acts else None
    eta = _integrate_momentum(from_eta[:, 3:], still, momentum, period_s, torque)
    bias, slope = bodies.moved(times(from_eta, eta) - times(inverse, mu))  # (n, 6), (n, 6, 3)
    if pushed is not None and pushed.acts:
        bias = bias - pushed.wrench
    thrust = -times(inverse, bias)  # (n, 6) specific force and angular acceleration that cancel it
    bodies.pushed(thrust)
    return _Motion(bodies, inverse, eta, slope, thrust, pushed)


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
    n = len(links.p if isinstance(links, Frames) else links[0].p)
    bodies, inverse, eta, slope, thrust, pushed = _move(links, period_s, chi, start, push, by_rate=by_rate)
    from_eta, w = inverse[:, :, 3:], bodies.twist[:, 3:]
    c = 10 * len(free.links)
    own = c + (0 if errors is None else errors.columns)
    along = np.zeros((n, 9, 3 + own + (0 if push is None else len(push.gain))))
    H = np.zeros((n, 6, along.shape[2] - 3))
    free.into(H[:, :, :c], bodies.X, bodies.V)
    free.into(along[:, 3:, 3 : 3 + c], bodies.X, bodies.V, bodies.A)
    displaced = None
    if errors is not None:
        displaced = errors.displaced(bodies)
        errors.into(displaced, bodies, H[:, :, c:own], along[:, 3:, 3 + c : 3 + own])
    at_fixed_eta = -(inverse[:, 3:] @ H)  # (n, 3, c)
    d_start: FloatArray = np.eye(3, along.shape[2])
    if by_rate:
        d_start[:, 3:] = -at_fixed_eta[0]
        d_start = np.asarray(np.linalg.solve(from_eta[0, 3:], d_start), np.float64)
    forcing = hat(eta) @ at_fixed_eta
    if pushed is not None:
        along[:, 3:, 3 + own :] = -pushed.of_each
        forcing[:, :, own:] += pushed.torque_of_each
        if pushed.acts:
            forcing[:, :, :c] += pushed.by_centre(free, bodies.X)
    local = slice(3 + own - (0 if errors is None else errors.local), 3 + own)
    forcing[:, :, local.start - 3 : local.stop - 3] = 0.0
    d_eta = _integrate_sensitivity(w, eta, from_eta[:, 3:], forcing, d_start, period_s)
    np.matmul(from_eta[:, 3:], d_eta, out=along[:, :3])
    if local.start < local.stop:
        more = np.zeros((n, 9, local.stop - local.start + 3))
        more[:, :3, :-3], more[:, :3, -3:] = along[:, :3, local], from_eta[:, 3:]
        along[:, :3, local] = 0.0
        along = np.concatenate([along, more], axis=2)
    along[:, :3, 3 : 3 + at_fixed_eta.shape[2]] += at_fixed_eta
    force, spin = thrust[:, :3], thrust[:, 3:]
    by_rate_of_base = -(inverse @ slope)
    return BasePrediction(w, spin, force, along, by_rate_of_base, -inverse, eta, d_eta, bodies, displaced, local)


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
    eta = _integrate_momentum(inverse, still, momentum, period_s)
    rate = turned(inverse, eta) - still
    nothing = np.zeros((len(still), 3, 0))
    return rate, inverse @ _integrate_sensitivity(rate, eta, inverse, nothing, np.eye(3), period_s)


class _Pushed:
    """A wrench on the base, and its moment about the centre of mass of the whole vehicle.

    Args:
        push: the wrench.
        composite: spatial inertia of the vehicle, (n, 6, 6).

    Attributes:
        acts: it is not zero: only what it would do is asked for then.
    """

    def __init__(self, push: Push, composite: FloatArray) -> None:
        self.of_each, self.acts = push.of_each, bool(push.gain.any())
        self.wrench: FloatArray = push.of_each @ push.gain  # (n, 6)
        self._mass_kg, self._centre_m = centre_of(composite)
        self.torque_of_each = self.of_each[:, 3:] - hat(self._centre_m) @ self.of_each[:, :3]  # (n, 3, k)
        self.torque: FloatArray = self.torque_of_each @ push.gain  # (n, 3)

    def by_centre(self, free: Columns, X: FloatArray) -> FloatArray:
        """Derivative of the torque by chi, (n, 3, c): ``F x dr``."""
        d_centre = centre_by_chi(free, X, self._mass_kg, self._centre_m)
        return np.asarray(hat(self.wrench[:, :3]) @ d_centre, np.float64)


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
    w = base.rate
    W, P = hat(w), hat(p_BoSo_B)
    by_place = hat(base.acceleration) + W @ W
    values = np.empty((len(w), 6))
    values[:, :3] = w @ R_BS
    values[:, 3:] = (base.specific_force + by_place @ p_BoSo_B) @ R_BS
    gain = np.zeros((len(w), 6, 9))
    gain[:, :3, :3] = R_BS.T
    at_place = np.concatenate([R_BS.T, -R_BS.T @ P], axis=1)  # (3, 6)
    # d(w x (w x p)) = (w x (dw x p)) + dw x (w x p) = -(hat(w) hat(p) + hat(w x p)) dw
    gain[:, 3:, :3] = at_place @ base.by_rate - R_BS.T @ (W @ P + hat(W @ p_BoSo_B))
    gain[:, 3:, 3:] = at_place @ base.by_wrench
    d_place = np.zeros((len(w), 6, 3))
    d_place[:, 3:] = R_BS.T @ by_place
    return SensorPrediction(values, gain, d_place)


def at_sensor(base: BasePrediction, R_BS: FloatArray, p_BoSo_B: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values, (n, 6), and derivatives, (n, 6, 3 + c), of :func:`sensor_in_base`."""
    found = sensor_in_base(base, R_BS, p_BoSo_B)
    return found.values, np.asarray(found.gain @ base.along, np.float64)


def _midpoints(x: FloatArray) -> FloatArray:
    """Values half-way between ticks, by cubics through four points, (n - 1, ...)."""
    ends = np.concatenate(
        [x[:1] * 4 - x[1:2] * 6 + x[2:3] * 4 - x[3:4], x, x[-1:] * 4 - x[-2:-1] * 6 + x[-3:-2] * 4 - x[-4:-3]]
    )
    middle: FloatArray = (9.0 * (ends[1:-2] + ends[2:-1]) - ends[:-3] - ends[3:]) / 16.0
    return middle


def _integrate_momentum(
    J: FloatArray, k: FloatArray, start: FloatArray, h: float, torque: FloatArray | None = None
) -> FloatArray:
    """Integrates ``d eta / dt = eta x (J eta - k)`` over the grid by fourth-order Runge-Kutta, (n, 3).

    A torque, (n, 3), adds half a step's impulse before each step and half of the next after it: it may jump.
    """
    halves = None if torque is None else (0.5 * h * torque).tolist()
    half, whole, sixth = 0.5 * float(h), float(h), float(h) / 6.0
    # Python floats are faster than arrays of three, and than NumPy's.
    stages = np.concatenate([J.reshape(-1, 9), k], axis=1).tolist()
    middles = np.concatenate([_midpoints(J).reshape(-1, 9), _midpoints(k)], axis=1).tolist()
    x, y, z = start.tolist()
    eta = [(x, y, z)]
    for i, middle in enumerate(middles):
        if halves is not None:
            x, y, z = (at + by for at, by in zip((x, y, z), halves[i], strict=True))
        a1, b1, c1 = _momentum_rate(x, y, z, stages[i])
        a2, b2, c2 = _momentum_rate(x + half * a1, y + half * b1, z + half * c1, middle)
        a3, b3, c3 = _momentum_rate(x + half * a2, y + half * b2, z + half * c2, middle)
        a4, b4, c4 = _momentum_rate(x + whole * a3, y + whole * b3, z + whole * c3, stages[i + 1])
        x += sixth * (a1 + 2.0 * (a2 + a3) + a4)
        y += sixth * (b1 + 2.0 * (b2 + b3) + b4)
        z += sixth * (c1 + 2.0 * (c2 + c3) + c4)
        if halves is not None:
            x, y, z = (at + by for at, by in zip((x, y, z), halves[i + 1], strict=True))
        eta.append((x, y, z))
    return np.array(eta)


def _momentum_rate(x: float, y: float, z: float, stage: list[float]) -> tuple[float, float, float]:
    """``eta x (J eta - k)``; the stage is J, row by row, and k."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz, k_x, k_y, k_z = stage
    u = xx * x + xy * y + xz * z - k_x
    v = yx * x + yy * y + yz * z - k_y
    w = zx * x + zy * y + zz * z - k_z
    return y * w - z * v, z * u - x * w, x * v - y * u


def _integrate_sensitivity(
    w: FloatArray, eta: FloatArray, J: FloatArray, forcing: FloatArray, start: FloatArray, h: float
) -> FloatArray:
    """Integrates ``dS/dt = A S + [0 forcing]``, A = eta x J - w x, from ``start``; (n, 3, 3 + c)."""
    A = hat(eta) @ J - hat(w)
    middle, one = _midpoints(A), np.eye(3)
    k1 = A[:-1]
    k2 = middle @ (one + 0.5 * h * k1)
    k3 = middle @ (one + 0.5 * h * k2)
    k4 = A[1:] @ (one + h * k3)
    steps = one + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)  # (n - 1, 3, 3)
    push = 0.5 * h * (steps @ forcing[:-1] + forcing[1:])  # trapezoid
    S = np.zeros((len(w), 3, 3 + forcing.shape[2]))
    S[0] = start
    for step, before, after, pushed in zip(steps, S[:-1], S[1:], push, strict=True):
        np.matmul(step, before, out=after)
        after[:, 3:] += pushed
    return S
