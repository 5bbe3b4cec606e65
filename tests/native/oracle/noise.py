"""What noise of the joints does to a prediction, in NumPy."""

import numpy as np

from onboard.dynamics.kinematics import turned
from onboard.dynamics.spatial import times
from onboard.estimation.arrays import cross, hat
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS
from tests.native.oracle.bodies import Bodies
from tests.native.oracle.chain import chain_motion


def of(vehicle, errors, imus, cuts, lines, free, q, chi, sigma):
    """As :meth:`onboard.identification.free_flyer.prediction.joint_noise.JointNoise.by_joint`, of one sigma."""
    effect = _effect(vehicle, errors, imus, cuts, lines, free, q[::BATCH_TICKS], chi)[np.arange(len(q)) // BATCH_TICKS]
    return np.einsum("njkm,nkj->njkm", effect, sigma).reshape(len(q), 2 * q.shape[1], -1)


def _effect(vehicle, errors, imus, cuts, lines, free, q, chi):
    """Of an error of one in the rate and in the acceleration of each joint, (n, joints, 2, lines)."""
    chain = chain_motion(vehicle, q, *np.zeros((2, *q.shape)))
    bodies, S = Bodies(chain.links, chi), chain.screws
    momenta = times(bodies.sums(errors.beyond_links).inertia, S)  # (n, joints, 6)
    twist, along = np.zeros_like(momenta), np.ix_(range(len(q)), free, free)
    inverse = np.linalg.inv(bodies.composite[along]).swapaxes(1, 2)
    twist[..., free] = -momenta[..., free] @ inverse
    effect = np.zeros((*q.shape, 2, lines[-1].stop))
    for imu, own in zip(imus, lines, strict=False):
        force = twist[..., :3] + cross(twist[..., 3:], imu.p_BoSo_B)
        effect[:, :, 0, own.start : own.start + 3] = twist[..., 3:] @ imu.R_BS
        effect[:, :, 1, own.start + 3 : own.stop] = force @ imu.R_BS
    for cut, own in zip(cuts, lines[len(imus) :], strict=False):
        group, _, R_cut, p_cut, projection = cut.compiled.kept
        R = chain.links.R[:, cut.compiled.carried_by]
        p = chain.links.p[:, cut.compiled.carried_by] + R @ p_cut
        force, moment = (turned(R @ R_cut, part) for part in projection.reshape(2, 3))
        u = np.concatenate([force - turned(hat(moment), p), moment], axis=1)[:, None]
        felt = times(bodies.sums(cut.errors.beyond_links).inertia, S)
        felt += twist @ bodies.sums(group).inertia[:, 0].swapaxes(1, 2)
        effect[:, :, 1, own.start] = (felt * u).sum(axis=2)
    return effect
