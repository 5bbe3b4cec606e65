"""The geometry and masses of a serial arm, body by body, free of any solver: what sections 2.1.2 and 2.1.3 start from.

Body 0 is the base, body i what joint i moves. All vectors of a body are in that body's joint frame.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.errors import SignalError
from onboard.estimation.arrays import FloatArray


class SerialChain(NamedTuple):
    """Bodies 0..n of a serial arm."""

    mass: FloatArray  # (n + 1,) kg
    centre: FloatArray  # (n + 1, 3) m, centre of mass in the body's frame
    inertia: FloatArray  # (n + 1, 3, 3) kg m^2 about the centre of mass
    next_origin: FloatArray  # (n + 1, 3) m, origin of the next joint at zero, of the tip for the last body
    next_axes: FloatArray  # (n + 1, 3, 3) axes of the next joint's frame at zero; of the tip for the last body
    axis: FloatArray  # (n, 3) of joint i + 1, in its frame
    revolute: tuple[bool, ...]  # (n,)


def chain_of(arm: FloatingArm) -> SerialChain:
    """The serial chain from the base to the arm's tip (notation of Limparis 2.1.2, 2.1.3).

    Raises:
        SignalError: a joint that is not on the way to the tip; these methods are for serial arms.
    """
    model = arm.model
    order, at = [], int(model.frames[arm.tip].parentJoint)
    while at > 1:
        order.append(at)
        at = int(model.parents[at])
    order.reverse()
    aside = sorted({model.names[k] for k in range(2, model.njoints)} - {model.names[k] for k in order})
    if aside:
        raise SignalError(f"joint {', '.join(aside)} is not between base and tip; this method is for serial arms")
    indices = [1, *order]
    inertias = [model.inertias[k] for k in indices]
    places = [model.jointPlacements[k] for k in order] + [model.frames[arm.tip].placement]
    joints = {joint.name: joint for joint in arm.vehicle.joints}
    moving = [joints[model.names[k]] for k in order]
    return SerialChain(
        np.array([body.mass for body in inertias]),
        np.array([body.lever for body in inertias]),
        np.array([body.inertia for body in inertias]),
        np.array([place.translation for place in places]),
        np.array([place.rotation for place in places]),
        np.array([joint.axis for joint in moving]),
        tuple(joint.revolute for joint in moving),
    )


def rotations(chain: SerialChain, q: FloatArray) -> FloatArray:
    """Axes of every body in the base's, (n + 1, 3, 3), by Rodrigues' formula."""
    R = np.empty((len(chain.mass), 3, 3))
    R[0] = np.eye(3)
    for i, (axis, revolute) in enumerate(zip(chain.axis, chain.revolute, strict=True)):
        turned = pin.exp3(q[i] * axis) if revolute else np.eye(3)
        R[i + 1] = R[i] @ chain.next_axes[i] @ turned
    return R


def offsets(chain: SerialChain, q: FloatArray) -> FloatArray:
    """From each body's origin to the next one's (to the tip for the last), (n + 1, 3), in the body's axes.

    A prismatic joint adds its travel to the body before it.
    """
    out = chain.next_origin.copy()
    for i, (axis, revolute) in enumerate(zip(chain.axis, chain.revolute, strict=True)):
        if not revolute:
            out[i] += q[i] * chain.next_axes[i] @ axis
    return out
