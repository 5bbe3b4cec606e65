"""A tracker's pose of a frame M on the base, predicted from the base's rate and the vehicle's centre of mass.

With B the base, L the tracker's axes, q the attitude of B in L as a quaternion, c the centre of mass of the whole
vehicle in base axes, p and v its place and velocity in L, in the lengths that the tracker shows:

    attitude = q (q_BM (1 + turn / 2))        dq/dt = q (0, w) / 2
    position = p + (1 + scale) S(q) (p_BM + place - c)        dp/dt = v,  dv/dt = acceleration

S(q) is the rotation by q, times its length squared: q is estimated as four free numbers, which the readings hold at
length one, so that the attitude is linear in it and nothing is singular. Where L lies and how it is turned is unknown.
The scale multiplies what is turned alone and not p, which is metres away: p and v are unknown anyway, and a product of
unknowns that far from linear let the recursive fit take a part of the scale for the base's mass.
``acceleration`` is that of L against free fall: residual drag, or a laboratory that is not quite inertial. A reading
shows what was a delay ago. Each unit of noise of a quaternion is half of the attitude's.

Centre of mass of a whole vehicle in base axes about the base's origin, and its derivatives.

It stands in the composite inertia, whose linear momentum of a turn is ``-m hat(r)``.
"""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.free_flight import BasePrediction
from onboard.dynamics.joint_errors import JointErrors
from onboard.dynamics.kinematics import Frames
from onboard.dynamics.spatial import Columns
from onboard.estimation.arrays import FloatArray, eigen, hat

LINES = 7  # attitude w, x, y, z, position x, y, z
MOTION = slice(0, 10)  # of its unknowns: attitude, place and velocity of the centre of mass
_Q, _P, _V, _A, _TURN, _PLACE = slice(0, 4), slice(4, 7), slice(7, 10), slice(10, 13), slice(13, 16), slice(16, 19)
_SCALE, _DELAY = 19, 20
SIZE = 21


def centre_of(composite: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mass, (n, 1), and centre of mass, (n, 3), of spatial inertias about the base's origin, (n, 6, 6)."""
    mass_kg = composite[:, 0, 0, None]
    moment = -np.stack([composite[:, 2, 4], composite[:, 0, 5], composite[:, 1, 3]], axis=1)  # -m hat(r) in it
    with np.errstate(divide="ignore", invalid="ignore"):  # nothing has no centre: not finite
        return mass_kg, np.asarray(moment / mass_kg, np.float64)


def centre_by_chi(free: Columns, frames: Frames, mass_kg: FloatArray, centre_m: FloatArray) -> FloatArray:
    """Derivative of the centre of mass by standard parameters, (n, 3, c): ``dr = (d(m r) - r dm) / m``.

    Args:
        free: the links.
        frames: of all links.
        mass_kg: (n, 1).
        centre_m: (n, 3).
    """
    which, n = list(free.links), len(frames.p)
    arm = frames.p[:, which] - centre_m[:, None]  # (n, k, 3)
    moved = frames.R[:, which] @ free.bases[:, 1:4] + arm[..., None] * free.bases[:, :1]  # (n, k, 3, 10)
    return np.asarray(moved.swapaxes(1, 2).reshape(n, 3, -1) / mass_kg[..., None], np.float64)


class PoseReading(NamedTuple):
    """What it shows at the inner ticks, and its motion at the last of them."""

    values: FloatArray  # (n, 7), of all ticks
    by_motion: FloatArray  # (n, 7, 3 + c): by what the base's motion depends on
    d_own: FloatArray  # (n, 7, SIZE)
    carried: FloatArray  # (10,)
    carried_by_motion: FloatArray  # (10, 3 + c)
    carried_by_own: FloatArray  # (10, SIZE)


def predict_pose(
    base: BasePrediction,
    period_s: float,
    mount: tuple[FloatArray, FloatArray],
    x: FloatArray,
    free: Columns,
    errors: JointErrors | None,
) -> PoseReading:
    """The equations at the head of this module.

    Args:
        base: motion of the base at n ticks.
        period_s: between ticks.
        mount: quaternion of M in B, (4,), and its origin, (3,), m.
        x: unknowns, (SIZE,), those of :data:`MOTION` at the first tick.
        free: links whose columns the base's motion has.
        errors: of the joints, whose columns come after them; None: none.
    """
    assert base.bodies is not None
    n, t = len(base.rate), period_s * np.arange(len(base.rate), dtype=np.float64)
    r, by_rate = _turned(base.rate, period_s)  # (n, 4), (n, 3, 3): of a change of the rate at each tick, base axes at 0
    psi = _summed(by_rate @ base.d_rate, period_s)  # (n, 3, 3 + c)
    q0, tail = x[_Q], product(mount[0], np.concatenate([[1.0], 0.5 * x[_TURN]]))
    by_q0 = right(r)  # (n, 4, 4)
    q = by_q0 @ q0
    by_psi = by_q0 @ (0.5 * left(q0)[:, 1:])  # (n, 4, 3)
    mass_kg, centre_m = centre_of(base.bodies.composite)
    arm = mount[1] + x[_PLACE] - centre_m  # (n, 3)
    S, by_q = rotation(q), _by_quaternion(q, arm)
    at = x[_P] + t[:, None] * x[_V] + 0.5 * (t * t)[:, None] * x[_A]
    seen = (S @ arm[..., None])[..., 0]
    gain = 1.0 + x[_SCALE]
    values = np.hstack([(right(tail) @ q[..., None])[..., 0], at + gain * seen])
    by_motion, d_own = np.empty((n, LINES, psi.shape[2])), np.zeros((n, LINES, SIZE))
    by_motion[:, :4] = right(tail) @ by_psi @ psi
    by_motion[:, 4:] = gain * (by_q @ by_psi @ psi)
    c = 3 + 10 * len(free.links)
    by_motion[:, 4:, 3:c] -= gain * (S @ centre_by_chi(free, base.bodies.frames, mass_kg, centre_m))
    if errors is not None and base.displaced is not None:
        moved = errors.of_moment(base.displaced, base.bodies) / mass_kg[..., None]
        by_motion[:, 4:, c : c + moved.shape[2]] -= gain * (S @ moved)
    d_own[:, :4, _Q], d_own[:, 4:, _Q] = right(tail) @ by_q0, gain * (by_q @ by_q0)
    d_own[:, :4, _TURN] = left((right(mount[0]) @ q[..., None])[..., 0])[..., 1:] * 0.5
    for own, power in ((_P, np.ones(n)), (_V, t), (_A, 0.5 * t * t)):
        d_own[:, 4:, own] = power[:, None, None] * np.eye(3)
    d_own[:, 4:, _PLACE], d_own[:, 4:, _SCALE] = gain * S, seen
    change = np.gradient(values, period_s, axis=0)
    by_motion -= x[_DELAY] * np.gradient(by_motion, period_s, axis=0)
    d_own -= x[_DELAY] * np.gradient(d_own, period_s, axis=0)
    d_own[:, :, _DELAY] = -change
    last, span = n - 2, t[-2]
    carried = np.concatenate([q[last], at[last], x[_V] + span * x[_A]])
    by_own = np.zeros((10, SIZE))
    by_own[_Q, _Q], by_own[_P, _P], by_own[_V, _V] = by_q0[last], np.eye(3), np.eye(3)
    by_own[_P, _V], by_own[_P, _A], by_own[_V, _A] = span * np.eye(3), 0.5 * span**2 * np.eye(3), span * np.eye(3)
    of_motion = np.zeros((10, psi.shape[2]))
    of_motion[_Q] = by_psi[last] @ psi[last]
    return PoseReading(values - x[_DELAY] * change, by_motion, d_own, carried, of_motion, by_own)


def _turned(rate: FloatArray, period_s: float) -> tuple[FloatArray, FloatArray]:
    """Attitude of the base at every tick in that of the first, (n, 4), and as a rotation, (n, 3, 3)."""
    u = 0.5 * period_s * (rate[1:] + rate[:-1])
    angle = np.linalg.norm(u, axis=1, keepdims=True)
    steps = np.hstack([np.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / np.pi) * u])
    r = np.empty((len(rate), 4))
    r[0] = 1.0, 0.0, 0.0, 0.0
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    for k, (a, b, c, d) in enumerate(steps.tolist(), 1):  # Python floats are faster than arrays of four
        w, x, y, z = (
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        )
        r[k] = w, x, y, z
    return r, rotation(r)


def _summed(slope: FloatArray, period_s: float) -> FloatArray:
    """Integral from the first tick on, by trapezoids, (n, ...)."""
    out = np.zeros_like(slope)
    np.cumsum(0.5 * period_s * (slope[1:] + slope[:-1]), axis=0, out=out[1:])
    return out


def rotation(q: FloatArray) -> FloatArray:
    """S(q), (n, 3, 3)."""
    w, v = q[:, 0, None, None], q[:, 1:]
    outer = v[:, :, None] * v[:, None]
    size = (q[:, 0] ** 2 - (v * v).sum(axis=1))[:, None, None]
    return np.asarray(size * np.eye(3) + 2.0 * outer + 2.0 * w * hat(v), np.float64)


def _by_quaternion(q: FloatArray, a: FloatArray) -> FloatArray:
    """Derivative of ``S(q) a`` by q, (n, 3, 4)."""
    w, v = q[:, :1], q[:, 1:]
    out = np.empty((len(q), 3, 4))
    out[..., 0] = 2.0 * (w * a + np.cross(v, a))
    along = (v * a).sum(axis=1)[:, None, None]
    out[..., 1:] = 2.0 * (v[:, :, None] * a[:, None] - a[:, :, None] * v[:, None] + along * np.eye(3))
    out[..., 1:] -= 2.0 * w[..., None] * hat(a)
    return out


def left(q: FloatArray) -> FloatArray:
    """``left(p) q = p q``, (..., 4, 4)."""
    return _matrix(q, 1.0)


def right(q: FloatArray) -> FloatArray:
    """``right(q) p = p q``, (..., 4, 4)."""
    return _matrix(q, -1.0)


def _matrix(q: FloatArray, sign: float) -> FloatArray:
    out = np.empty((*q.shape, 4))
    out[..., 0, 0], out[..., 0, 1:], out[..., 1:, 0] = q[..., 0], -q[..., 1:], q[..., 1:]
    out[..., 1:, 1:] = q[..., 0, None, None] * np.eye(3) + sign * hat(q[..., 1:])
    return out


def product(p: FloatArray, q: FloatArray) -> FloatArray:
    """Hamilton's product, (4,)."""
    return np.asarray(left(p) @ q, np.float64)


def quaternion_of(R: FloatArray) -> FloatArray:
    """Unit quaternion of a rotation, (3, 3) to (4,)."""
    K = np.empty((4, 4))  # its largest eigenvector (Bar-Itzhack 2000)
    K[0, 0], K[1:, 1:] = np.trace(R), R + R.T - np.trace(R) * np.eye(3)
    K[0, 1:] = K[1:, 0] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    return np.asarray(eigen(K)[1][:, -1], np.float64)
