"""Whether what an IMU reads of a base that stands is gravity.

Nothing else on board of an arm tells a scale of its accelerometer from a heavier load: rows take the specific force as
it is read, and so every mass is off by its scale. On the ground gravity is known to :data:`LOCAL_GRAVITY`.
"""

from collections.abc import Sequence

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import DOUBLINGS
from onboard.identification.corrections import doubtful_from, refused_from
from onboard.identification.rows.stated_errors.considered import Considered

LOCAL_GRAVITY = 1.5e-3
"""Sigma of its magnitude where it is not stated, relative: 9.780 to 9.832 m/s^2 on the ground (WGS 84), as a uniform
distribution."""


def judged_gravity(
    force: FloatArray, stated_m_s2: float, considered: Sequence[Considered]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Reasons to refuse all estimates, and to doubt them.

    Args:
        force: specific force of the base, (t, 3) m/s^2.
        stated_m_s2: gravity of the place.
        considered: with what is stated of the accelerometer.
    """
    read = float(np.linalg.norm(force.mean(axis=0)))
    stated = {kind: [0.0] for kind in ("scale", "bias")}
    for one in considered:
        sensor, _, kind = one.effect.partition("_")
        if sensor == "accelerometer" and kind in stated:
            stated[kind].append(one.sigma)
    scale = np.hypot(LOCAL_GRAVITY, max(stated["scale"]))
    away = abs(read - stated_m_s2) / float(np.hypot(scale * stated_m_s2, max(stated["bias"])))
    if away < doubtful_from(1):
        return (), ()
    reads = f"the IMU reads {read:.4g} m/s^2 on a base that stands where gravity is {stated_m_s2:.4g}"
    said = f"{reads} ({away:.0f} sigmas off): calibrate it, or state gravity_m_s2"
    return ((said,), ()) if away > refused_from(DOUBLINGS) else ((), (said,))
