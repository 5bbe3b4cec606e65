"""Predicts the motion of a base on an air bearing from parameters, joints, drag and the velocity at the start.

Three of the base's six accelerations are free, ``a = (f_x, f_y, dw)`` in base axes, f the specific force along the
table:

    M(q) a + h(q, dq, ddq, w) = d(v, w)

M and h are linear in the standard parameters, h is quadratic in the yaw rate w; d is the pucks' drag. Velocity is not
measured: it is a state whose initial value is a parameter. Along the table ``dv/dt = f + g_t - w x v``, g_t the
component of gravity along a tilted table. A puck at p slips with ``u = v + w x p`` and exerts ``-(Fv + Fc / |u|) u``,
|u| rounded near zero.
As the supply of air sags all drags grow, by the exponential of a polynomial in time. (Base wrench rows 3.5 of Limparis
for the three free directions; drag model derived here.)
"""

from math import cos, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legvander

from onboard.dynamics.free_flight import BasePrediction
from onboard.dynamics.kinematics import chain_motion
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.spatial import MOMENTUM, crf, crm, force_transforms, times
from onboard.dynamics.ticks import FlightSignals
from onboard.estimation.arrays import FloatArray

ROUNDING_m_s = 2e-3  # slip below which Coulomb drag is rounded to zero
_FASTEST = 1e3  # m/s, rad/s, rad; beyond it the integration is stopped
SAGS = 3  # polynomials of the supply's sag, of degree 1 on
PLANAR = [0, 1, 5]  # of force and moment, and of twist


class PlanarDrag(NamedTuple):
    """Drag of each puck."""

    place: FloatArray  # (k, 2) base axes, m
    viscous: FloatArray  # (k,) Fv, N s/m
    coulomb: FloatArray  # (k,) Fc, N
    rounding_m_s: float = ROUNDING_m_s
    sag: tuple[float, ...] = (0.0,) * SAGS  # of each Legendre polynomial, of degree 1 on


class PlanarPrediction(NamedTuple):
    """Motion at every tick and its derivative: start, chi wanted, Fv and Fc of each puck, sag, tilt."""

    base: BasePrediction
    velocity: FloatArray  # (n, 4) x, y, m/s, yaw rate, rad/s, yaw since the start, rad


class PlanarRun:
    """The wrench that a run's joint motion asks for, at ticks and half-way between: the joints by a spline.

    Times f_x, f_y, dw, 1, w, w^2: M and h of the equation at the head of this module. With v and a the twist of a link
    and its rate of change relative to the base, z that of a unit of yaw, all in the link's own axes, and B its momentum
    per twist, the link's wrench is ``B (a + f + dw z + w z x v) + (v + w z) x* B (v + w z)`` (Featherstone, Rigid Body
    Dynamics Algorithms, 2008, chapter 2); its columns (Limparis 2.132) have those of B.

    Args:
        vehicle: the model.
        signals: of its joints.
        offsets: of each joint from its place in the drawing, (joints, 3), m, in the axes of its frame at zero.

    Attributes:
        ticks: n; there are m = 2n - 1 of them and what is half-way between.
        period_s: between ticks.
        gravity_m_s2: onto the table.

    Raises:
        SignalError: joint signals of another vehicle.
    """

    def __init__(self, vehicle: VehicleModel, signals: FlightSignals, offsets: FloatArray | None = None) -> None:
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 - 0.1 s, of all that fit a flight and have no table

        n = self.ticks = len(signals.q)
        joints = CubicSpline(np.arange(n), np.stack([signals.q, signals.dq, signals.ddq], axis=1))
        q, dq, ddq = joints(0.5 * np.arange(2 * n - 1)).swapaxes(0, 1)
        frames = chain_motion(vehicle, q, dq, ddq, offsets).links
        X = force_transforms(frames.R, frames.p)
        own, z = X.swapaxes(2, 3), X[:, :, 5]
        v, a = times(own, frames.V), times(own, frames.A)
        self._twists = np.stack([X[:, :, 0], X[:, :, 1], z, a, times(crm(z), v), v], axis=2)  # (m, links, 6, 6)
        self._to_base = X[:, :, PLANAR]
        self.period_s, self.gravity_m_s2 = signals.period_s, -vehicle.spec.gravity_m_s2[2]
        self._columns: dict[tuple[int, ...], FloatArray] = {}
        self._rest: tuple[FloatArray, FloatArray] | None = None  # parameters without those of some links, their wrench

    def columns(self, links: tuple[int, ...]) -> FloatArray:
        """Of the parameters of some links, (m, 3, 6, 10 x links)."""
        if links not in self._columns:
            each = self._wrenches(list(links), np.repeat(MOMENTUM[None], len(links), axis=0))  # (m, links, 3, 6, 10)
            self._columns[links] = np.moveaxis(each, 1, 3).reshape(len(each), 3, 6, 10 * len(links))
        return self._columns[links]

    def wrench(self, chi: FloatArray, links: tuple[int, ...], part: slice = slice(None)) -> FloatArray:
        """Of all links, (m, 3, 6).

        Args:
            chi: standard parameters of all links, (P,).
            links: those whose parameters change from one call to the next.
            part: of the m.
        """
        own, rest = np.array(links, np.intp), chi.reshape(-1, 10).copy()
        rest[own] = 0.0
        if self._rest is None or not np.array_equal(rest, self._rest[0]):
            B = np.einsum("aij,kj->kai", MOMENTUM, rest)[..., None]
            self._rest = rest, self._wrenches(list(range(len(B))), B)[..., 0].sum(axis=1)
        found: FloatArray = self._rest[1][part]
        return found + self.columns(links)[part] @ chi.reshape(-1, 10)[own].ravel() if links else found

    def _wrenches(self, links: list[int], B: FloatArray) -> FloatArray:
        """Of each of some links, (m, links, 3, 6, c), by its momentum per twist, (links, 6, 6, c)."""
        U, (k, _, _, c), m = self._twists[:, links], B.shape, len(self._twists)
        H = (U @ B.reshape(k, 6, 6 * c)).reshape(m, k, 6, 6, c)
        out = np.empty((m, k, 6, 6, c))  # rows of the wrench, then what it is multiplied by
        out[:] = H.swapaxes(2, 3)
        both = np.concatenate([H[:, :, 5], H[:, :, 2]], axis=3)  # of v, of z
        by_v, by_z = crf(U[:, :, 5]) @ both, crf(U[:, :, 2]) @ both
        out[..., 3, :] += by_v[..., :c]
        out[..., 4, :] += by_z[..., :c] + by_v[..., c:]
        out[..., 5, :] = by_z[..., c:]
        found: FloatArray = (self._to_base[:, links] @ out.reshape(m, k, 6, 6 * c)).reshape(m, k, 3, 6, c)
        return found


def predict_planar(
    run: PlanarRun,
    start: FloatArray,
    chi: FloatArray,
    drag: PlanarDrag,
    tilt: FloatArray,
    free: tuple[int, ...],
    ticks: int | None = None,
) -> PlanarPrediction:
    """Predicts the base's motion by the equations at the head of this module.

    Args:
        run: its joints.
        start: velocity at the first tick: x, y, m/s, and yaw rate, rad/s; base axes, (3,).
        chi: standard parameters of all links, (P,).
        drag: of the pucks.
        tilt: gravity along the table, m/s^2, along the base's axes at the first tick, (2,).
        free: links whose ten columns are wanted in the derivatives, as in
            :func:`onboard.dynamics.free_flight.predict_base`.
        ticks: only the first so many; all, where not given.
    """
    first = slice(2 * (run.ticks if ticks is None else ticks) - 1)
    over = legvander(np.linspace(-1.0, 1.0, 2 * run.ticks - 1)[first], SAGS)[:, 1:]  # (m, SAGS), of the run
    growth = np.exp(over @ drag.sag)
    G, T = run.wrench(chi, free, first), run.columns(free)[first]  # (m, 3, 6), (m, 3, 6, P)
    inverse = np.asarray(np.linalg.inv(G[:, :, :3]), np.float64)
    k = -(inverse @ G[:, :, 3:])  # (m, 3, 3) what a is without drag, of 1, w, w^2
    states = _integrate(inverse, k, start, drag, tilt, growth, run.period_s)
    at_ticks = _accelerations(states, inverse[::2], k[::2], drag, growth[::2])[0]
    state = _with_midpoints(states, _rates(states, at_ticks, tilt), run.period_s)  # (m, 4)
    a, A, pull = _accelerations(state, inverse, k, drag, growth)
    m, P, pucks = len(state), T.shape[3], len(drag.viscous)
    w, yaw = state[:, 2], state[:, 3]
    basis = np.column_stack([a, np.ones(m), w, w * w])
    D = np.zeros((m, 3, 3 + P + 2 * pucks + SAGS + 2))
    by_columns = (-inverse[:, :, :, None] * basis[:, None, None, :]).reshape(m, 3, 18)
    np.matmul(by_columns, T.reshape(m, 18, P), out=D[:, :, 3 : 3 + P])
    np.matmul(inverse, pull, out=D[:, :, 3 + P : -2 - SAGS])
    by_drag = D[:, :, 3 + P : -2 - SAGS] @ np.stack(drag[1:3], axis=1).ravel()
    np.multiply(by_drag[:, :, None], over[:, None, :], out=D[:, :, -2 - SAGS : -2])
    S = _sensitivities(*_slopes(state, A, D, yaw, tilt), run.period_s)
    D = D[::2] + A[::2] @ S
    n = len(states)
    zero, own = np.zeros((n, 3)), np.zeros((n, 3, D.shape[2]))
    rate, spin, force = zero.copy(), zero.copy(), zero.copy()
    force[:, 2] = run.gravity_m_s2
    along = np.zeros((n, 9, D.shape[2]))  # of rate, specific force and angular acceleration
    rate[:, 2], spin[:, 2], force[:, :2] = states[:, 2], a[::2, 2], a[::2, :2]
    along[:, 2], along[:, 8], along[:, 3:5] = S[:, 2], D[:, 2], D[:, :2]
    by_rate, by_wrench = np.zeros((n, 6, 3)), np.broadcast_to(np.eye(6), (n, 6, 6))
    base = BasePrediction(rate, spin, force, along, by_rate, by_wrench, zero, own)
    return PlanarPrediction(base, states)


def _accelerations(
    state: FloatArray, inverse: FloatArray, k: FloatArray, drag: PlanarDrag, growth: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """``a`` (m, 3), its slope in the state (m, 3, 4), drag per Fv and Fc of each puck (m, 3, 2k)."""
    v, w = state[:, :2], state[:, 2]
    m, pucks = len(state), len(drag.viscous)
    force, slope, pull = np.zeros((m, 3)), np.zeros((m, 3, 4)), np.zeros((m, 3, 2 * pucks))
    for index, ((px, py), viscous, coulomb) in enumerate(zip(*drag[:3], strict=True)):
        J = np.array([[1.0, 0.0, -py], [0.0, 1.0, px]])
        u = v + w[:, None] * J[:, 2]
        size = np.sqrt((u * u).sum(axis=1) + drag.rounding_m_s**2)[:, None]
        pull[:, :, 2 * index], pull[:, :, 2 * index + 1] = -u @ J, -(u / size) @ J
        force += pull[:, :, 2 * index] * viscous + pull[:, :, 2 * index + 1] * coulomb
        stiff = -(viscous + coulomb / size)[:, :, None] * np.eye(2)
        stiff += (coulomb / size**3)[:, :, None] * u[:, :, None] * u[:, None, :]
        slope[:, :, :3] += J.T @ stiff @ J
    force, slope, pull = force * growth[:, None], slope * growth[:, None, None], pull * growth[:, None, None]
    powers = np.column_stack([np.ones(m), w, w * w])
    a = np.einsum("mij,mj->mi", inverse, force) + np.einsum("mij,mj->mi", k, powers)
    slope = inverse @ slope
    slope[:, :, 2] += k[:, :, 1] + 2.0 * k[:, :, 2] * w[:, None]
    return a, slope, pull


def _slopes(
    state: FloatArray, A: FloatArray, D: FloatArray, yaw: FloatArray, tilt: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of ``d state / dt`` by the state, (m, 4, 4), and by the parameters, (m, 4, p)."""
    m, (vx, vy, w) = len(state), state[:, :3].T
    c, s = np.cos(yaw), np.sin(yaw)
    F = np.zeros((m, 4, 4))
    F[:, :3] = A
    F[:, 0, 1] += w
    F[:, 0, 2] += vy
    F[:, 1, 0] -= w
    F[:, 1, 2] -= vx
    F[:, 0, 3] = -s * tilt[0] + c * tilt[1]
    F[:, 1, 3] = -c * tilt[0] - s * tilt[1]
    F[:, 3, 2] = 1.0
    B = D.copy()
    B[:, 0, -2], B[:, 0, -1], B[:, 1, -2], B[:, 1, -1] = c, s, -s, c
    return F, B


def _with_midpoints(states: FloatArray, rates: FloatArray, h: float) -> FloatArray:
    """States at ticks and, by cubic interpolation, half-way between, (2n - 1, 4)."""
    out = np.repeat(states, 2, axis=0)[:-1]
    out[1::2] = 0.5 * (states[1:] + states[:-1]) + h / 8.0 * (rates[:-1] - rates[1:])
    return out


def _integrate(
    inverse: FloatArray,
    k: FloatArray,
    start: FloatArray,
    drag: PlanarDrag,
    tilt: FloatArray,
    growth: FloatArray,
    h: float,
) -> FloatArray:
    """State at every tick, (n, 4), NaN once it diverges; fourth-order Runge-Kutta.

    Python floats, which are faster than arrays of four.
    """
    driven = inverse * growth[:, None, None]  # by drag
    grid = np.concatenate([driven.reshape(-1, 9), k.reshape(-1, 9)], axis=1).tolist()
    pucks = [(*place, fv, fc) for place, fv, fc in zip(*(part.tolist() for part in drag[:3]), strict=True)]
    (tilt_x, tilt_y), rounding = tilt.tolist(), drag.rounding_m_s**2

    def rate(at: tuple[float, ...], vx: float, vy: float, w: float, yaw: float) -> tuple[float, float, float, float]:
        pull_x = pull_y = turn = 0.0
        for px, py, viscous, coulomb in pucks:
            ux, uy = vx - w * py, vy + w * px
            share = viscous + coulomb / sqrt(ux * ux + uy * uy + rounding)
            pull_x -= share * ux
            pull_y -= share * uy
            turn -= share * (px * uy - py * ux)
        a, b, c, d, e, f, g, i, j, k0, k1, k2, k3, k4, k5, k6, k7, k8 = at
        ax = a * pull_x + b * pull_y + c * turn + k0 + w * (k1 + w * k2)
        ay = d * pull_x + e * pull_y + f * turn + k3 + w * (k4 + w * k5)
        dw = g * pull_x + i * pull_y + j * turn + k6 + w * (k7 + w * k8)
        cosine, sine = cos(yaw), sin(yaw)
        down_x, down_y = cosine * tilt_x + sine * tilt_y, cosine * tilt_y - sine * tilt_x
        return ax + w * vy + down_x, ay - w * vx + down_y, dw, w

    states = np.empty((len(grid) // 2 + 1, 4))
    x = states[0] = (*start.tolist(), 0.0)
    half, sixth = 0.5 * h, h / 6.0
    for index in range(len(states) - 1):
        before, middle, after = grid[2 * index : 2 * index + 3]
        vx, vy, w, yaw = x
        a1, b1, c1, d1 = rate(before, vx, vy, w, yaw)
        a2, b2, c2, d2 = rate(middle, vx + half * a1, vy + half * b1, w + half * c1, yaw + half * d1)
        a3, b3, c3, d3 = rate(middle, vx + half * a2, vy + half * b2, w + half * c2, yaw + half * d2)
        a4, b4, c4, d4 = rate(after, vx + h * a3, vy + h * b3, w + h * c3, yaw + h * d3)
        vx += sixth * (a1 + 2.0 * (a2 + a3) + a4)
        vy += sixth * (b1 + 2.0 * (b2 + b3) + b4)
        w += sixth * (c1 + 2.0 * (c2 + c3) + c4)
        yaw += sixth * (d1 + 2.0 * (d2 + d3) + d4)
        if not (abs(vx) < _FASTEST and abs(vy) < _FASTEST and abs(w) < _FASTEST and abs(yaw) < _FASTEST):
            states[index + 1 :] = np.nan
            break
        x = vx, vy, w, yaw
        states[index + 1] = x
    return states


def _sensitivities(F: FloatArray, B: FloatArray, h: float) -> FloatArray:
    """Integrates ``dS/dt = F S + B`` by fourth-order Runge-Kutta; (n, 4, p).

    A step of a linear equation is linear: ``S' = M S + L B_before + N B_middle + h/6 B_after``, of all steps at once.
    """
    one, half, sixth = np.eye(4), 0.5 * h, h / 6.0
    before, middle, after = F[:-2:2], F[1::2], h * F[2::2]
    half_way = one + half * middle
    second = middle @ (one + half * before)
    third = middle @ (one + half * second)
    M = one + sixth * (before + 2.0 * (second + third) + F[2::2] @ (one + h * third))
    bent = half * half * middle @ middle
    L = sixth * (one + h * middle + 2.0 * bent + after @ bent)
    N = sixth * (2.0 * (one + half_way) + after @ half_way)
    C = L[:, :, :3] @ B[:-2:2] + N[:, :, :3] @ B[1::2]
    C[:, :3] += sixth * B[2::2]
    S = np.zeros((len(F) // 2 + 1, 4, B.shape[2]))
    S[0, :3, :3] = np.eye(3)
    for i, (turn, own) in enumerate(zip(M, C, strict=True)):
        np.matmul(turn, S[i], out=S[i + 1])
        S[i + 1] += own
    return S


def _rates(state: FloatArray, a: FloatArray, tilt: FloatArray) -> FloatArray:
    """``d state / dt``, (..., 4)."""
    vx, vy, w, yaw = np.moveaxis(state, -1, 0)
    c, s = np.cos(yaw), np.sin(yaw)
    x = a[..., 0] + w * vy + c * tilt[0] + s * tilt[1]
    y = a[..., 1] - w * vx - s * tilt[0] + c * tilt[1]
    return np.stack([x, y, a[..., 2], w], axis=-1)
