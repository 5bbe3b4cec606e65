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

import ctypes
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legvander

from onboard.dynamics.free_flight import BasePrediction
from onboard.dynamics.kinematics import chain_motion
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.spatial import MOMENTUM, crm, force_cross, force_transforms, times
from onboard.dynamics.ticks import FlightSignals
from onboard.estimation.arrays import FloatArray
from onboard.native.library import call, carved, given
from onboard.native.structures import AirBearingRun

ROUNDING_m_s = 2e-3  # slip below which Coulomb drag is rounded to zero
SAGS = 3  # polynomials of the supply's sag, of degree 1 on
PLANAR = [0, 1, 5]  # of force and moment, and of twist


class PlanarDrag(NamedTuple):
    """Drag of each puck."""

    place: FloatArray  # (k, 2) base axes, m
    viscous: FloatArray  # (k,) Fv, N s/m
    coulomb: FloatArray  # (k,) Fc, N
    sag: tuple[float, ...] = (0.0,) * SAGS  # of each Legendre polynomial, of degree 1 on


class PlanarPrediction(NamedTuple):
    """Motion at every tick and its derivative: start, chi wanted, Fv and Fc of each puck, sag, tilt."""

    base: BasePrediction
    velocity: FloatArray  # (n, 4) x, y, m/s, yaw rate, rad/s, yaw since the start, rad


class PlanarRun:
    """The wrench that a run's joint motion asks for, at ticks and half-way between: the joints by a spline.

    Times f_x, f_y, dw, 1, w, w^2: M and h of the equation at the head of this module. With v and a the twist of a link
    and its rate of change relative to the base, z that of a unit of yaw, all in the link's axes, and B its momentum
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
        twists = np.stack([X[:, :, 0], X[:, :, 1], z, a, times(crm(z), v), v], axis=2)  # (m, links, 6, 6)
        self._twists = np.ascontiguousarray(twists.swapaxes(0, 1))
        self._to_base = X[:, :, PLANAR].swapaxes(1, 2).copy()  # (m, 3, links, 6)
        self.period_s, self.gravity_m_s2 = signals.period_s, -vehicle.spec.gravity_m_s2[2]
        self._columns: dict[tuple[int, ...], FloatArray] = {}
        self._rest: tuple[FloatArray, FloatArray] | None = None  # parameters without those of some links, their wrench

    def columns(self, links: tuple[int, ...]) -> FloatArray:
        """Of the parameters of some links, (m, 3, 6, 10 x links)."""
        if links not in self._columns:
            m, k = len(self._to_base), len(links)
            own = self._wrenches(list(links), np.repeat(MOMENTUM[None], k, axis=0)).reshape(m, k, 6, 60)
            each = self._to_base[:, :, list(links)].swapaxes(1, 2) @ own  # (m, links, 3, 60)
            columns = each.reshape(m, k, 3, 6, 10).transpose(0, 2, 3, 1, 4)
            self._columns[links] = columns.reshape(m, 3, 6, 10 * k)
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
            k, m = len(rest), len(self._to_base)
            B = np.einsum("aij,kj->kai", MOMENTUM, rest)[..., None]
            every = self._wrenches(list(range(k)), B).reshape(m, 6 * k, 6)
            self._rest = rest, self._to_base.reshape(m, 3, 6 * k) @ every
        found: FloatArray = self._rest[1][part]
        return found + self.columns(links)[part] @ chi.reshape(-1, 10)[own].ravel() if links else found

    def _wrenches(self, links: list[int], B: FloatArray) -> FloatArray:
        """Of each of some links in its axes, (m, links, 6, 6, c), by its momentum per twist, (links, 6, 6, c)."""
        U, (k, _, _, c), m = self._twists[links], B.shape, self._twists.shape[1]
        H = (U.reshape(k, 6 * m, 6) @ B.reshape(k, 6, 6 * c)).reshape(k, m, 6, 6, c)
        out = np.empty((m, k, 6, 6, c))  # rows of the wrench, then what it is multiplied by
        out[:] = H.transpose(1, 0, 3, 2, 4)
        both = H[:, :, [5, 2]].swapaxes(3, 4)  # (links, m, 2, c, 6), of v, of z
        by_v, by_z = (np.moveaxis(force_cross(U[:, :, one, None, None], both), (1, 4), (0, 3)) for one in (5, 2))
        out[..., 3, :] += by_v[:, :, 0]
        out[..., 4, :] += by_z[:, :, 0] + by_v[:, :, 1]
        out[..., 5, :] = by_z[:, :, 1]
        return out


def predict_run(
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

    Returns:
        NaN where masses have no motion.
    """
    first = slice(2 * (run.ticks if ticks is None else ticks) - 1)
    over = legvander(np.linspace(-1.0, 1.0, 2 * run.ticks - 1)[first], SAGS)[:, 1:]  # (m, SAGS), of the run
    growth = np.exp(over @ drag.sag)
    G, T = run.wrench(chi, free, first), run.columns(free)[first]  # (m, 3, 6), (m, 3, 6, P)
    try:
        inverse = np.linalg.inv(G[:, :, :3])
    except np.linalg.LinAlgError:  # bodies of this mass have no motion, as a negative payload that cancels the base
        inverse = np.full((len(G), 3, 3), np.nan)
    known = -(inverse @ G[:, :, 3:])  # (m, 3, 3) what a is without drag, of 1, w, w^2
    pucks = np.column_stack(drag[:3]).reshape(-1, 4)
    n, width = len(G) // 2 + 1, 3 + T.shape[3] + 2 * len(pucks) + SAGS + 2
    others = np.array([*given(start, 3), *given(tilt, 2), ROUNDING_m_s**2, run.period_s])
    arrays = [np.ascontiguousarray(one, np.float64) for one in (inverse, known, growth, over, T, pucks, others)]
    of_run = AirBearingRun(n, T.shape[3], len(pucks), *arrays)
    out = call("heft_predict_table", ctypes.byref(of_run), out=np.empty(n * (7 + 9 * width)))
    states, a, along = carved(out, [(n, 4), (n, 3), (n, 9, width)])
    zero, own = np.zeros((n, 3)), np.zeros((n, 3, width))
    rate, spin, force = zero.copy(), zero.copy(), zero.copy()
    rate[:, 2], spin[:, 2], force[:, :2], force[:, 2] = states[:, 2], a[:, 2], a[:, :2], run.gravity_m_s2
    by_rate, by_wrench = np.zeros((n, 6, 3)), np.broadcast_to(np.eye(6), (n, 6, 6))
    base = BasePrediction(rate, spin, force, along, by_rate, by_wrench, zero, own)
    return PlanarPrediction(base, states)
