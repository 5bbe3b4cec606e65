"""Predicts the motion of a body that turns about a fixed point, by gravity and by its own wheels.

With J the inertia about the pivot, wheels locked, c the first moment about it, u the unit vector up, and h what the
wheels store by their speeds W against the body, ``h = sum I W a``, all in the body's axes:

    L = J w + h,    dL/dt = g u x c - w x L - b w + t u,    du/dt = -w x u

b is the drag of the air, t the torque of the bearing's jets about the vertical (Euler's equations; h is measured, so no
wheel's acceleration is needed). An IMU at p shows w and ``g u + dw/dt x p + w x (w x p)``.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray


class PivotBody(NamedTuple):
    """What turns, in each of k parts of each of b variants."""

    inertia: FloatArray  # (b, k, 3, 3) about the pivot, kg m^2
    moment: FloatArray  # (3, b, k) first moment about it, kg m
    drag: FloatArray  # (b,) N m s
    jets: FloatArray  # (b,) N m


class PivotMotion(NamedTuple):
    """At n ticks of k parts, for each of b variants, (n, 3, b, k) each; body axes."""

    rate: FloatArray  # rad/s
    acceleration: FloatArray  # rad/s^2
    up: FloatArray  # unit vector


def predict_pivot(
    body: PivotBody, stored: FloatArray, change: FloatArray, rate: FloatArray, up: FloatArray, g: float, period_s: float
) -> PivotMotion:
    """Integrates the equations at the head of this module, by fourth-order Runge-Kutta.

    Args:
        body: b variants.
        stored: h at the ticks, (n, 3, b, k) N m s.
        change: its derivative, which interpolates it half-way between ticks.
        rate: at the first tick, (3, b, k) rad/s.
        up: unit vectors there, (3, b, k).
        g: gravity, m/s^2.
        period_s: between ticks.
    """
    c, b, t = body.moment * g, body.drag[:, None], body.jets[:, None]
    J, inverse = (np.ascontiguousarray(of.transpose(2, 3, 0, 1)) for of in (body.inertia, np.linalg.inv(body.inertia)))

    def slopes(L: FloatArray, u: FloatArray, h: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        w = _of(inverse, L - h)
        return w, _cross(u, c) - _cross(w, L) - b * w + t * u, _cross(u, w)

    n, T = len(stored), period_s
    middle = 0.5 * (stored[1:] + stored[:-1]) + T / 8.0 * (change[:-1] - change[1:])
    L, u = _of(J, rate) + stored[0], up
    rates, torques, ups = (np.empty_like(stored) for _ in range(3))
    for k in range(n):
        rates[k], torques[k], du = slopes(L, u, stored[k])
        ups[k] = u
        if k + 1 == n:
            break
        first = torques[k], du
        second = slopes(L + 0.5 * T * first[0], u + 0.5 * T * first[1], middle[k])[1:]
        third = slopes(L + 0.5 * T * second[0], u + 0.5 * T * second[1], middle[k])[1:]
        fourth = slopes(L + T * third[0], u + T * third[1], stored[k + 1])[1:]
        dL, du = (a + 2.0 * (s + d) + e for a, s, d, e in zip(first, second, third, fourth, strict=True))
        L, u = L + T / 6.0 * dL, u + T / 6.0 * du
    return PivotMotion(rates, np.einsum("ijbk,njbk->nibk", inverse, torques - change), ups)


def specific_force(motion: PivotMotion, place_m: FloatArray, g: float) -> FloatArray:
    """At places fixed in the body, (3, b) m: (n, 3, b, k) m/s^2, body axes."""
    p, (w, dw, u) = place_m[..., None], motion
    turning = _cross(w.swapaxes(0, 1), _cross(w.swapaxes(0, 1), p[:, None]))
    found: FloatArray = g * u + (_cross(dw.swapaxes(0, 1), p[:, None]) + turning).swapaxes(0, 1)
    return found


def _of(M: FloatArray, v: FloatArray) -> FloatArray:
    """Matrices (3, 3, ...) by vectors (3, ...)."""
    out: FloatArray = (M * v).sum(axis=1)
    return out


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Of vectors (3, ...), which broadcast."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
