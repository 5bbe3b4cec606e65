"""A free-flyer with an arm that moves what it holds: momentum is kept, by Pinocchio's own map."""

import numpy as np
import pinocchio as pin

MASS_kg, CENTRE_m = 3.0, np.array([0.08, 0.02, -0.03])
_S = 2e-3  # of a step
JOINTS = ("joint_1", "joint_2", "joint_3")


def flown(urdf, seconds):
    """Angles (n, 3), rate and specific force of the base at its origin (n, 3), each 2 ms."""
    model = pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer())
    hand = model.frames[model.getFrameId("payload")]
    held = pin.Inertia(MASS_kg, CENTRE_m, np.diag([0.012, 0.02, 0.018]))
    model.appendBodyToJoint(hand.parentJoint, held, hand.placement)
    data, q, momentum = model.createData(), pin.neutral(model), np.array([0.03, -0.02, 0.04, 0.02, -0.03, 0.01])
    t = _S * np.arange(round(seconds / _S))
    turns = 2.0 * np.pi * np.array([0.13, 0.17, 0.11]) * t[:, None] + [0.0, 1.0, 2.0]
    angles = 0.5 * np.sin(turns) + 0.2 * np.sin(1.7 * turns)
    rates, velocity = np.gradient(angles, _S, axis=0), np.zeros((len(t), 6))
    for k in range(len(t)):
        q[7:] = angles[k]
        A = pin.computeCentroidalMap(model, data, q)
        velocity[k] = np.linalg.solve(A[:, :6], momentum - A[:, 6:] @ rates[k])
        q = pin.integrate(model, q, np.concatenate([velocity[k], rates[k]]) * _S)
    accelerated = np.gradient(velocity, _S, axis=0)
    return t, angles, velocity[:, 3:], accelerated[:, :3] + np.cross(velocity[:, 3:], velocity[:, :3])
