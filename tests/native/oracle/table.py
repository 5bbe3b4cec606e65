"""Motion of a base on an air bearing, and its derivatives: :mod:`onboard.dynamics.air_bearing` in plain NumPy."""

from math import cos, sin, sqrt

import numpy as np
from numpy.polynomial.legendre import legvander

from onboard.dynamics.air_bearing import SAGS, PlanarDrag, ROUNDING_m_s

_FASTEST = 1e3


def predict(run, start, chi, drag, tilt, free):
    """States (n, 4), accelerations (n, 3), derivatives of rate, specific force and angular acceleration (n, 9, p)."""
    over = legvander(np.linspace(-1.0, 1.0, 2 * run.ticks - 1), SAGS)[:, 1:]
    growth = np.exp(over @ drag.sag)
    G, T = run.wrench(chi, free), run.columns(free)
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
    along = np.zeros((n, 9, D.shape[2]))  # of rate, specific force and angular acceleration
    along[:, 2], along[:, 8], along[:, 3:5] = S[:, 2], D[:, 2], D[:, :2]
    return states, a[::2], along


def _accelerations(state: np.ndarray, inverse: np.ndarray, k: np.ndarray, drag: PlanarDrag, growth: np.ndarray):
    """``a`` (m, 3), its slope in the state (m, 3, 4), drag per Fv and Fc of each puck (m, 3, 2k)."""
    v, w = state[:, :2], state[:, 2]
    m, pucks = len(state), len(drag.viscous)
    force, slope, pull = np.zeros((m, 3)), np.zeros((m, 3, 4)), np.zeros((m, 3, 2 * pucks))
    for index, ((px, py), viscous, coulomb) in enumerate(zip(*drag[:3], strict=True)):
        J = np.array([[1.0, 0.0, -py], [0.0, 1.0, px]])
        u = v + w[:, None] * J[:, 2]
        size = np.sqrt((u * u).sum(axis=1) + ROUNDING_m_s**2)[:, None]
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


def _slopes(state: np.ndarray, A: np.ndarray, D: np.ndarray, yaw: np.ndarray, tilt: np.ndarray):
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


def _with_midpoints(states: np.ndarray, rates: np.ndarray, h: float) -> np.ndarray:
    """States at ticks and, by cubic interpolation, half-way between, (2n - 1, 4)."""
    out = np.repeat(states, 2, axis=0)[:-1]
    out[1::2] = 0.5 * (states[1:] + states[:-1]) + h / 8.0 * (rates[:-1] - rates[1:])
    return out


def _integrate(
    inverse: np.ndarray,
    k: np.ndarray,
    start: np.ndarray,
    drag: PlanarDrag,
    tilt: np.ndarray,
    growth: np.ndarray,
    h: float,
) -> np.ndarray:
    """State at every tick, (n, 4), NaN once it diverges; fourth-order Runge-Kutta.

    Python floats, which are faster than arrays of four.
    """
    driven = inverse * growth[:, None, None]  # by drag
    grid = np.concatenate([driven.reshape(-1, 9), k.reshape(-1, 9)], axis=1).tolist()
    pucks = [(*place, fv, fc) for place, fv, fc in zip(*(part.tolist() for part in drag[:3]), strict=True)]
    (tilt_x, tilt_y), rounding = tilt.tolist(), ROUNDING_m_s**2

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


def _sensitivities(F: np.ndarray, B: np.ndarray, h: float) -> np.ndarray:
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


def _rates(state: np.ndarray, a: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """``d state / dt``, (..., 4)."""
    vx, vy, w, yaw = np.moveaxis(state, -1, 0)
    c, s = np.cos(yaw), np.sin(yaw)
    x = a[..., 0] + w * vy + c * tilt[0] + s * tilt[1]
    y = a[..., 1] - w * vx - s * tilt[0] + c * tilt[1]
    return np.stack([x, y, a[..., 2], w], axis=-1)
