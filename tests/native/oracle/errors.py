"""Errors of joints, and of bodies in the drawing, in NumPy."""

import numpy as np

from onboard.dynamics.joint_errors import PER_JOINT
from onboard.dynamics.spatial import crm
from tests.native.oracle.bodies import coad


def _change(values, period_s):
    """Rate of change by differences, at all ticks, (n, ...)."""
    out = np.empty_like(values)
    out[1:-1] = (values[2:] - values[:-2]) / (2.0 * period_s)
    out[0], out[-1] = (values[1] - values[0]) / period_s, (values[-1] - values[-2]) / period_s
    return out


def corrected(read, errors, cyclic, of):
    """As :meth:`onboard.dynamics.joint_errors.EncoderReadings.corrected`."""
    functions = np.concatenate([read.cyclic, _change(read.cyclic[:, 2:], read.period_s)], axis=1)
    every, taken = functions.copy(), len(cyclic)
    turns = np.eye(len(errors))[of]
    own, (zero, scale, delay) = turns[:taken], errors[:, 3:].T
    ripple = ((functions[..., :taken] * cyclic) @ own).swapaxes(0, 1)
    every[..., :taken] *= 1.0 + own @ scale
    every[:, :3, :taken] += functions[:, 1:, :taken] * (own @ delay)
    plain = read.q, read.dq, read.ddq, _change(read.ddq, read.period_s)
    q, dq, ddq, jerk = (part + more for part, more in zip(plain, ripple, strict=True))
    rates = np.stack([q, dq, ddq, jerk], axis=1)
    f = np.concatenate([rates[:, :3], rates[:, 1:], every[:, :3]], axis=2)
    motion = q * (1.0 + scale) + zero + delay * dq, dq * (1.0 + scale) + delay * ddq, ddq * (1.0 + scale) + delay * jerk
    return *motion, f


def spread(functions, of, joints):
    """Functions, (n, 3, f), each in the rows of its joint, (n, 3 x joints, f)."""
    out = np.zeros((len(functions), 3, joints, functions.shape[2]))
    out[:, :, of, np.arange(functions.shape[2])] = functions
    return out.reshape(len(functions), -1, functions.shape[2])


def displaced(chain, bodies):
    """Screws, (n, joints, 6, 12)."""
    seats, n = chain.seats, len(bodies.twist)
    U = np.zeros((n, seats.p.shape[1], 6, 12))
    U[..., :3, :3] = seats.R
    U[..., 3] = chain.screws
    X = crm(seats.V + bodies.twist[:, None])
    change = seats.A + bodies.rate[:, None] + seats.V @ crm(bodies.twist).swapaxes(1, 2)
    np.matmul(X, U[..., :4], out=U[..., 4:8])
    U[..., 8:] = X @ U[..., 4:8] + crm(change) @ U[..., :4]
    return U


def into(compiled, U, functions, bodies, H, Y):
    """Derivatives of momentum and wrench of the links by the errors of joints, (n, 6, columns) each."""
    beyond, stays, of = compiled.kept
    joints, f = U.shape[1], spread(functions, of, U.shape[1])
    sums = bodies.sums(beyond)
    I = sums.inertia @ U[..., 3:]  # noqa: E741
    K = coad(sums.momentum) @ U[..., :8]
    D = sums.change @ U[..., 3:8]
    wrenches = K[..., 4:] + D[..., 1:] + I[..., 5:] + coad(sums.wrench * stays[:, None]) @ U[..., :4]
    turn, slide = I[..., 0], K[..., 3] + 2.0 * I[..., 4] + D[..., 0]
    _put(Y, wrenches, np.concatenate([wrenches[..., 3], slide, turn], axis=1).swapaxes(1, 2) @ f)
    if H is None:
        return
    momenta = K[..., :4] + I[..., 1:5]
    _put(H, momenta, np.concatenate([momenta[..., 3], turn], axis=1).swapaxes(1, 2) @ f[:, : 2 * joints])


def _put(out, still, moving):
    """Columns of places and zeros, (n, joints, r, 4), and of the functions, (n, r, f), in the order of the errors."""
    n, joints, rows = still.shape[:3]
    own, two = out[:, :, : PER_JOINT * joints].reshape(n, rows, joints, PER_JOINT), 2 * joints
    own[..., :4] = still.transpose(0, 2, 1, 3)
    own[..., 4:] = moving[:, :, :two].reshape(n, rows, 2, joints).swapaxes(2, 3)
    out[:, :, PER_JOINT * joints :] = moving[:, :, two:]


def linear(at, drawn, state):
    """As :meth:`onboard.identification.free_flyer.prediction.scaled.Scaled.linear`."""
    out = state.copy()
    t, r, _ = _parts(at, drawn, state)
    out[at] = (np.exp(t) * (drawn + r) - drawn).ravel()
    return out


def derived(at, drawn, by, state):
    """Derivatives by s, (..., p), as those by z."""
    t, r, factor = _parts(at, drawn, state)
    of_body = np.repeat(np.eye(len(drawn)), 10, axis=0)
    own, out = by[..., at], by.copy()
    more = (own @ (r.ravel()[:, None] * of_body)) @ (factor.ravel()[:, None] * of_body).T
    out[..., at] = (own + more) * np.repeat(np.exp(t), 10)
    return out


def _parts(at, drawn, state):
    squares = np.sum(drawn**2, axis=1)[:, None]
    factor = np.divide(drawn, squares, out=np.zeros_like(drawn), where=squares > 0.0)
    z = state[at].reshape(drawn.shape)
    t = np.sum(factor * z, axis=1, keepdims=True)
    return t, z - t * drawn, factor
