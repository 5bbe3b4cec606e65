"""Motion of a free-floating base and what instruments feel of it, in NumPy, with LAPACK's solutions."""

import numpy as np

from onboard.dynamics.free_flight import BasePrediction, SensorPrediction
from onboard.dynamics.joint_errors import Displaced
from onboard.dynamics.kinematics import turned
from onboard.dynamics.spatial import times
from onboard.dynamics.tracked_pose import centre_of
from onboard.estimation.arrays import hat
from tests.native.oracle import errors as of_errors
from tests.native.oracle.bodies import Bodies, Columns


def predict(frames, period_s, chi, start, links, bases=None, errors=None, push=None, by_rate=True):
    """As ``_predict`` of :mod:`onboard.dynamics.free_flight`."""
    n, free = len(frames.p), Columns(links, bases)
    bodies, inverse, eta, slope, thrust, pushed = _move(frames, period_s, chi, start, push, by_rate)
    from_eta, w = inverse[:, :, 3:], bodies.twist[:, 3:]
    c = 10 * len(free.links)
    own = c + (0 if errors is None else errors.errors.columns)
    along = np.zeros((n, 9, 3 + own + (0 if push is None else len(push.gain))))
    H = np.zeros((n, 6, along.shape[2] - 3))
    free.into(H[:, :, :c], bodies.X, bodies.V)
    free.into(along[:, 3:, 3 : 3 + c], bodies.X, bodies.V, bodies.A)
    displaced = None
    if errors is not None:
        displaced = Displaced(of_errors.displaced(errors.chain, bodies), errors.functions)
        of_errors.into(errors.errors.compiled, *displaced, bodies, H[:, :, c:own], along[:, 3:, 3 + c : 3 + own])
    at_fixed_eta = -(inverse[:, 3:] @ H)  # (n, 3, c)
    d_start = np.eye(3, along.shape[2])
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
    d_eta = integrate_sensitivity(w, eta, from_eta[:, 3:], forcing, d_start, period_s)
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


def _move(frames, period_s, chi, start, push, by_rate):
    bodies = Bodies(frames, chi)
    inverse = np.linalg.inv(bodies.composite)
    mu = bodies.relative_momentum
    from_eta = inverse[:, :, 3:]  # (n, 6, 3) base twist per momentum
    still = times(inverse[:, 3:], mu)  # less the rate without a momentum
    momentum = np.linalg.solve(from_eta[0, 3:], start + still[0]) if by_rate else start
    pushed = None if push is None else _Pushed(push, bodies.composite)
    torque = pushed.torque if pushed is not None and pushed.acts else None
    eta = integrate_momentum(from_eta[:, 3:], still, momentum, period_s, torque)
    bias, slope = bodies.moved(times(from_eta, eta) - times(inverse, mu))  # (n, 6), (n, 6, 3)
    if pushed is not None and pushed.acts:
        bias = bias - pushed.wrench
    thrust = -times(inverse, bias)  # (n, 6) specific force and angular acceleration that cancel it
    bodies.pushed(thrust)
    return bodies, inverse, eta, slope, thrust, pushed


class _Pushed:
    """A wrench on the base, and its moment about the centre of mass of the whole vehicle.

    Args:
        push: the wrench.
        composite: spatial inertia of the vehicle, (n, 6, 6).

    Attributes:
        acts: it is not zero: only what it would do is asked for then.
    """

    def __init__(self, push, composite):
        self.of_each, self.acts = push.of_each, bool(push.gain.any())
        self.wrench = push.of_each @ push.gain  # (n, 6)
        self._mass_kg, self._centre_m = centre_of(composite)
        self.torque_of_each = self.of_each[:, 3:] - hat(self._centre_m) @ self.of_each[:, :3]  # (n, 3, k)
        self.torque = self.torque_of_each @ push.gain  # (n, 3)

    def by_centre(self, free, X):
        """Derivative of the torque by chi, (n, 3, c): ``F x dr``."""
        d_centre = centre_by_chi(free, X, self._mass_kg, self._centre_m)
        return np.asarray(hat(self.wrench[:, :3]) @ d_centre, np.float64)


def centre_by_chi(free, X, mass_kg, centre_m):
    """Derivative of the centre of mass by standard parameters, (n, 3, c): ``dr = (d(m r) - r dm) / m``.

    Args:
        free: the links.
        X: :func:`onboard.dynamics.spatial.force_transforms` of all links, (n, links, 6, 6).
        mass_kg: (n, 1).
        centre_m: (n, 3).
    """
    n, c = len(X), 10 * len(free.links)
    along_x, along_y = np.empty((n, 6, c)), np.empty((n, 6, c))
    for out, unit in ((along_x, 0), (along_y, 1)):  # momentum of unit translations: m, and m r across
        free.into(out, X, np.broadcast_to(np.eye(6)[unit], X.shape[:-1]))
    d_mass = along_x[:, :1]
    d_moment = np.stack([along_y[:, 5], -along_x[:, 5], along_x[:, 4]], axis=1)
    return np.asarray((d_moment - centre_m[..., None] * d_mass) / mass_kg[..., None], np.float64)


def sensor_in_base(base, R_BS, p_BoSo_B):
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


def _midpoints(x):
    """Values half-way between ticks, by cubics through four points, (n - 1, ...)."""
    ends = np.concatenate(
        [x[:1] * 4 - x[1:2] * 6 + x[2:3] * 4 - x[3:4], x, x[-1:] * 4 - x[-2:-1] * 6 + x[-3:-2] * 4 - x[-4:-3]]
    )
    middle = (9.0 * (ends[1:-2] + ends[2:-1]) - ends[:-3] - ends[3:]) / 16.0
    return middle


def integrate_momentum(J, k, start, h, torque=None):
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


def _momentum_rate(x, y, z, stage: list[float]):
    """``eta x (J eta - k)``; the stage is J, row by row, and k."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz, k_x, k_y, k_z = stage
    u = xx * x + xy * y + xz * z - k_x
    v = yx * x + yy * y + yz * z - k_y
    w = zx * x + zy * y + zz * z - k_z
    return y * w - z * v, z * u - x * w, x * v - y * u


def integrate_sensitivity(w, eta, J, forcing, start, h: float):
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


def cut_wrench(cut, base, bodies):
    """As :meth:`onboard.dynamics.cut_wrench.CutWrench.predict`; the cut by its structure, bodies of :mod:`.bodies`."""
    group, is_beyond, R_cut, p_cut, projection = cut.compiled.kept
    R = bodies.frames.R[:, cut.compiled.carried_by]
    p = bodies.frames.p[:, cut.compiled.carried_by] + R @ p_cut
    force, moment = (turned(R @ R_cut, part) for part in projection.reshape(2, 3))
    u = np.concatenate([force - turned(hat(moment), p), moment], axis=1)[:, None]
    own = bodies.sums(group)
    pull = u @ own.inertia[:, 0]
    gain = np.concatenate([u @ own.slope(bodies.twist)[:, 0] + pull @ base.by_rate, pull @ base.by_wrench], axis=2)
    d_values = (gain @ base.along)[:, 0]
    c = 3 + is_beyond.size
    d_values[:, 3:c] += (u @ base.along[:, 3:, 3:c])[:, 0] * is_beyond
    if base.displaced is not None:
        Y = np.empty((len(u), 6, cut.errors.columns))
        of_errors.into(cut.errors.compiled, *base.displaced, bodies, None, Y)
        d_values[:, c : c + cut.errors.columns] += (u @ Y)[:, 0]
    return ((u @ own.wrench[:, 0, :, None])[:, 0, 0], d_values)
