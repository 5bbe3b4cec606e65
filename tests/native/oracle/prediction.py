"""What a free-flyer's instruments show from a state, in NumPy, of a vehicle with stiff joints and without trackers."""

import numpy as np

from onboard.dynamics.free_flight import Push
from onboard.dynamics.joint_errors import PER_JOINT, EncoderReadings
from onboard.identification.free_flyer.prediction.imu_errors import tick_mean
from tests.native.oracle import base as of_base
from tests.native.oracle import errors as of_errors
from tests.native.oracle import imu as of_imu
from tests.native.oracle.chain import chain_motion


def predict(predictor, q, dq, ddq, state, cyclic=None, thrust=None):
    """As :meth:`onboard.identification.free_flyer.prediction.imu_prediction.ImuPredictor.predict`."""
    n, layout, h, m = len(q), predictor.layout, predictor.period_s, predictor.lines[-1].stop
    at, drawn = predictor.in_links, predictor.links.whole
    linear, push = of_errors.linear(at, drawn, state), np.zeros_like(state)
    pushed = np.array(predictor.pushes, np.intp).ravel()
    push[pushed] = state[pushed]
    x = layout.whole(linear - push)
    base = _base(predictor, x, n, (q, dq, ddq), cyclic, thrust)
    by_motion = np.zeros((n, m, base.along.shape[2]))
    values, jacobian = np.zeros((n - 2, m)), np.zeros((n - 2, m, len(state)))
    for imu, own, kept in zip(predictor.imus, predictor.lines, predictor.own, strict=False):
        sensor = of_base.sensor_in_base(base, imu.R_BS, imu.p_BoSo_B + x[imu.place])
        read = of_imu.imu_along(sensor, base.along, x[imu.errors], imu.samples, h)
        values[:, own], d_errors, d_place, by_motion[:, own] = read
        jacobian[:, own, kept.errors] = d_errors[:, :, kept.of_errors]
        jacobian[:, own, kept.place] = d_place[:, :, kept.of_place]
    first = len(predictor.imus)
    for (cell, cut), own, kept in zip(predictor.cells, predictor.lines[first:], predictor.own[first:], strict=True):
        errors = x[layout[cell.name]]
        true, d_true = of_base.cut_wrench(cut, base, base.bodies)
        values[:, own.start], d_errors = shown(cell, true, h, errors, dq, ddq)
        by_motion[:, own.start] = (1.0 + errors[2]) * d_true
        jacobian[:, own.start, kept.errors] = d_errors[:, kept.of_errors]
    carried, transition = linear - push, np.eye(len(state))[predictor.changing]
    carried[:3] = base.rate[-2]
    for at_state, of_motion in predictor.of_motion:
        here, there = np.arange(len(state))[at_state], np.arange(base.along.shape[2])[of_motion]
        for line, one in enumerate(predictor.weight):
            before, now, after = (by_motion[part, line][:, there] for part in (slice(-2), slice(1, -1), slice(2, None)))
            jacobian[:, line, here] += now + one * (after - 2.0 * now + before)
        transition[:3, here] = base.along[-2, :3][:, there]
    drifts, of = predictor.drifting
    carried[drifts] += h * (n - 2) * (linear - push)[of]
    transition[np.arange(3, 3 + len(of)), of] = h * (n - 2)
    jacobian, transition = (of_errors.derived(at, drawn, by, state) for by in (jacobian, transition))
    moved = carried + state - linear
    end = moved + push
    end[predictor.changing] = moved[predictor.changing] + transition @ push
    return values + jacobian @ push, jacobian, end, transition


def _base(predictor, x, n, joints, cyclic, thrust):
    layout, h, vehicle = predictor.layout, predictor.period_s, predictor.vehicle
    units = np.concatenate([np.tile(np.eye(6), (n, 1, 1)), h * np.arange(n)[:, None, None] * np.eye(6)], axis=2)
    wrenches = np.array([one.wrench for one in predictor.thrusters]).reshape(-1, 6).T
    forces = np.zeros((n, wrenches.shape[1])) if thrust is None else thrust
    of_each, gain = forces[:, None] * wrenches, 1.0 + x[layout["thrusters"]]
    if predictor.pushes:
        of_each, gain = np.concatenate([of_each, units], axis=2), np.append(gain, x[layout["disturbance"]])
    chi = predictor.links.chi(x[layout["payload"]], predictor.links.basis @ x[layout["links"]])
    errors, offsets = None, None
    if predictor.in_joints.size:
        own, model = x[layout["joints"]].reshape(-1, PER_JOINT), predictor.joint_errors
        functions = np.zeros((n, 3, len(model.of_cyclic))) if cyclic is None else cyclic
        readings = EncoderReadings(*joints, h, functions)
        *joints, functions = of_errors.corrected(readings, own, x[layout["cyclic"]], model.of_cyclic)
        offsets = own[:, :3]
    chain = chain_motion(vehicle, *joints, offsets)
    if predictor.in_joints.size:
        errors = predictor.joint_errors.along(chain, functions)
    free = predictor.columns
    push = Push(of_each, gain) if gain.size else None
    return of_base.predict(chain.links, h, chi, x[:3], free.links, list(free.bases), errors, push)


def shown(cell, true, period_s, errors, dq, ddq):
    """Readings of a cell or a torque at the inner ticks, (b,), and their derivatives by its errors, (b, k)."""
    bias, drift, scale, delay_s = errors[:4]
    parts = true[:, None]
    if cell.friction is not None:
        rate = dq[:, cell.friction.joint]
        felt = np.stack([np.sign(rate), rate, ddq[:, cell.friction.joint]], axis=1)
        parts = np.column_stack([true + felt @ errors[4:], felt])
    change = (parts[2:] - parts[:-2]) / (2.0 * period_s)
    late = tick_mean(parts, cell.samples)[1:-1] - delay_s * change
    gain, along = 1.0 + scale, np.ones((len(late), 3 + parts.shape[1]))
    along[:, 1] = time_s = period_s * np.arange(1, len(true) - 1)
    along[:, 2], along[:, 3], along[:, 4:] = late[:, 0], -gain * change[:, 0], gain * late[:, 1:]
    return gain * late[:, 0] + bias + drift * time_s, along
