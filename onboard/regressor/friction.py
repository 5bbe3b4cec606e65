"""Coulomb friction that needs a little way to turn round."""

import numpy as np

from onboard.estimation.arrays import FloatArray


def presliding(position: FloatArray, length: float) -> FloatArray:
    """Dahl's friction over its Coulomb level, (n,), between -1 and 1: ``dz = dx / length (1 - z sign(dx))``.

    After a reversal it takes a few ``length`` of motion to come round, where ``sign(dq)`` jumps. A column of it in
    place of the sign's keeps the rows linear in the Coulomb level.

    Args:
        position: of the joint at every tick, (n,), rad or m; ticks so close that it moves less than ``length`` between.
        length: rad or m.
    """
    steps = np.diff(position) / length
    decay = np.exp(-np.abs(steps))  # the equation's own solution over a step of one direction
    target = np.sign(steps)
    z = np.zeros(len(position))
    for k, (keep, end) in enumerate(zip(decay.tolist(), target.tolist(), strict=True)):
        z[k + 1] = end + (z[k] - end) * keep
    return z
