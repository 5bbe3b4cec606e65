"""Payload as mass, centre of mass and inertia about it, with covariance; physically possible bodies.

The ten standard parameters of physical bodies form a cone (positive definite pseudo-inertia). In the log-Cholesky
parameters of Rucker and Wensing (2022) every vector of ten numbers is such a body, so an estimator that uses them
cannot leave the cone.
"""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import RigidBody, elements, parallel_axis, pseudo_inertia, symmetric
from onboard.estimation.arrays import FloatArray, eigen
from onboard.estimation.errors import ConvergenceError

_CERTAIN = 1e-9  # of the largest
_BARRIER = 0.1
_NEWTON_STEPS = 100
_WORTH_A_STEP = 1e-6
_BY_MOMENT = np.array(  # (6, 3, 3): times h, the derivative of h.h 1 - h h' by h
    [[elements(2.0 * (a @ b) * np.eye(3) - np.outer(a, b) - np.outer(b, a)) for b in np.eye(3)] for a in np.eye(3)]
).transpose(2, 0, 1)


class BodyEstimate(NamedTuple):
    """A body and its covariance: m, c (3), and I about the centre of mass (XX XY YY XZ YZ ZZ)."""

    body: RigidBody
    covariance: FloatArray  # (10, 10) of mass, centre of mass, inertia, in this order


def standard_of(body: RigidBody) -> FloatArray:
    """Standard parameters about the frame's origin, (10,): ``h = m c``, ``I_O = I_C + m (c.c 1 - c c')``."""
    inertia = body.inertia_kg_m2 + parallel_axis(body.mass_kg, body.centre_of_mass_m)
    return np.concatenate([[body.mass_kg], body.mass_kg * body.centre_of_mass_m, elements(inertia)])


def body_of(chi: FloatArray) -> RigidBody:
    """The body of ten standard parameters: ``c = h / m``, ``I_C = I_O - (h.h 1 - h h') / m``.

    Raises:
        SignalError: a mass that is not positive.
    """
    if not chi[0] > 0.0:
        raise SignalError(f"a body of {chi[0]:.4g} kg has no centre of mass; the data do not determine this payload")
    c = chi[1:4] / chi[0]
    return RigidBody(float(chi[0]), c, symmetric(chi[4:]) - parallel_axis(float(chi[0]), c))


def numbers_of(body: RigidBody) -> FloatArray:
    """Mass, centre of mass, inertia about it, (10,)."""
    return np.array([body.mass_kg, *body.centre_of_mass_m, *elements(body.inertia_kg_m2)])


def body_jacobian(chi: FloatArray) -> FloatArray:
    """Derivative of (m, c, I_C) by the standard parameters, (10, 10): that of the equations of :func:`body_of`."""
    m, h = chi[0], chi[1:4]
    D = np.eye(10)
    D[1:4, 0] = -h / m**2
    D[1:4, 1:4] = np.eye(3) / m
    # I_C = I_O - (h.h 1 - h h') / m
    D[4:, 0] = elements(parallel_axis(1.0, h)) / m**2
    D[4:, 1:4] = -(_BY_MOMENT @ h) / m
    return D


def body_estimate(chi: FloatArray, covariance: FloatArray) -> BodyEstimate:
    """Mass, centre of mass and inertia of standard parameters, covariances by :func:`body_jacobian`."""
    D = body_jacobian(chi)
    return BodyEstimate(body_of(chi), D @ covariance @ D.T)


def standard_covariance(chi: FloatArray, mass_relative: float, centre_m: float, inertia_relative: float) -> FloatArray:
    """Covariance of standard parameters, (10, 10), of a part: :func:`standard_root`."""
    half = standard_root(chi, mass_relative, centre_m, inertia_relative)
    return np.asarray(half @ half.T, np.float64)


def standard_root(chi: FloatArray, mass_relative: float, centre_m: float, inertia_relative: float) -> FloatArray:
    """Root ``J S`` of the covariance ``J S^2 J'`` of a part's standard parameters, (10, 10).

    J is the inverse of :func:`body_jacobian`, S has the sigmas of what is weighed, balanced and swung.

    Args:
        chi: its standard parameters, (10,).
        mass_relative: standard deviation of its mass.
        centre_m: of each coordinate of its centre of mass.
        inertia_relative: of each element of its inertia about the centre of mass, of half that tensor's trace; of a
            point's, that of its mass at ``centre_m``.
    """
    half_trace = 0.5 * float(np.trace(body_of(chi).inertia_kg_m2))
    half_trace = max(half_trace, float(chi[0]) * centre_m**2)
    sigma = np.array([mass_relative * chi[0], *[centre_m] * 3, *[inertia_relative * half_trace] * 6])
    return np.asarray(np.linalg.solve(body_jacobian(chi), np.diag(sigma)), np.float64)


def possible_body(chi: FloatArray, covariance: FloatArray) -> RigidBody:
    """The most likely physically possible body.

    A possible estimate is returned unchanged. Else the result lies just inside the cone: it minimises half the squared
        distance in the metric of the covariance minus a tenth of the log-determinant of the pseudo-inertia, a convex
        problem, as the pseudo-inertia is linear in the standard parameters (cone: Wensing, Kim and Slotine 2018;
        barrier derived here). The barrier costs about a tenth of a sigma.

    Args:
        chi: estimate of the standard parameters, (10,).
        covariance: its covariance, (10, 10).

    Raises:
        SignalError: a mass that is not positive.
        ConvergenceError: no minimum was found: the covariance spans more than numbers can, or is none.
    """
    body = body_of(chi)
    try:
        if np.linalg.eigvalsh(pseudo_inertia(chi))[0] > 0.0:
            return body
        return _likeliest(chi, covariance, standard_of(_nearby(body)))
    except np.linalg.LinAlgError as error:
        raise ConvergenceError(f"the search for the likeliest possible body did not converge ({error})") from error


def _likeliest(chi: FloatArray, covariance: FloatArray, start: FloatArray) -> RigidBody:
    """The minimum, by Newton's method with a barrier, from a possible body's parameters ``start``, (10,)."""
    sigma = np.sqrt(np.diag(covariance))
    sigma = np.maximum(sigma, _CERTAIN * np.abs(start).max())  # exact parameters get a very small sigma
    values, vectors = eigen(covariance / np.outer(sigma, sigma))
    L = sigma[:, None] * vectors * np.sqrt(np.maximum(values, _CERTAIN))
    P0, basis = pseudo_inertia(chi), np.array([pseudo_inertia(column) for column in L.T])  # (10, 4, 4)

    def cost(z: FloatArray, barrier: float) -> float:
        P = P0 + np.tensordot(z, basis, 1)
        inside = np.linalg.eigvalsh(P)[0] > 0.0
        return float(0.5 * z @ z - barrier * np.linalg.slogdet(P)[1]) if inside else np.inf

    z = np.linalg.solve(L, start - chi)
    barrier = max(_BARRIER, float(z @ z))  # first towards the middle, then towards the border
    for _ in range(_NEWTON_STEPS):
        turned = np.linalg.inv(P0 + np.tensordot(z, basis, 1)) @ basis  # (10, 4, 4)
        gradient = z - barrier * np.trace(turned, axis1=1, axis2=2)
        hessian = np.eye(10) + barrier * np.einsum("iab,jba->ij", turned, turned)
        scale = np.sqrt(np.diag(hessian))
        step = -np.linalg.solve(hessian / np.outer(scale, scale), gradient / scale) / scale
        promised, now, length = float(-gradient @ step), cost(z, barrier), 1.0
        if barrier > _BARRIER and promised < 0.1 * barrier:
            barrier = max(_BARRIER, 0.1 * barrier)
            continue
        if promised < _WORTH_A_STEP * max(1.0, now):
            return body_of(chi + L @ z)
        while cost(z + length * step, barrier) > now - 0.1 * length * promised and length > _WORTH_A_STEP:
            length *= 0.5
        z = z + length * step
    raise ConvergenceError("the search for the likeliest possible body did not converge")


def _nearby(body: RigidBody) -> RigidBody:
    """A physically possible start: at least a centimetre thick in every direction."""
    second = 0.5 * np.trace(body.inertia_kg_m2) * np.eye(3) - body.inertia_kg_m2  # of mass about its centre
    values, vectors = eigen(second)
    second = vectors * np.maximum(values, 1e-4 * body.mass_kg) @ vectors.T
    return body._replace(inertia_kg_m2=np.trace(second) * np.eye(3) - second)
