"""The free-flyer on an air-bearing table: x, y and yaw are free; table tilt and drag of three pucks."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bench.true_flights import free_flyer
from hil_sim.arrays import FloatArray
from hil_sim.plants.motions.motion import STANDARD_GRAVITY
from hil_sim.plants.parts.pucks import AirPuck
from hil_sim.plants.urdf_model import UrdfModel
from hil_sim.plants.vehicle_flight import FlownJoints, VehicleFlight

PUCKS_m = ((0.200, 0.0), (-0.100, 0.173), (-0.100, -0.173))  # of the carriage, base axes


class Drag(NamedTuple):
    """Drag coefficients of one puck."""

    viscous_N_s_m: float = 0.0  # noqa: N815
    coulomb_N: float = 0.0  # noqa: N815


class PlanarFlight(NamedTuple):
    """True signals on the grid of the samples."""

    time_s: FloatArray  # (n,)
    q_rad: FloatArray  # (n, 5)
    dq_rad_s: FloatArray  # (n, 5)
    rate_rad_s: FloatArray  # (n, 3) of the base, IMU axes
    specific_force_m_s2: FloatArray  # (n, 3) at the IMU, its axes: a - g
    velocity: FloatArray  # (n, 3) of the base's origin, base axes: x, y, m/s, and yaw rate, rad/s


def world(
    payload: free_flyer.Body,
    base: free_flyer.Body = free_flyer.BASE,
    arm: Sequence[free_flyer.Body] = free_flyer.ARM,
    tilt_m_s2: Sequence[float] | FloatArray = (0.0, 0.0),
) -> UrdfModel:
    """The vehicle on its table; ``tilt_m_s2``: gravity along the table, table axes."""
    gravity = (float(tilt_m_s2[0]), float(tilt_m_s2[1]), -STANDARD_GRAVITY)
    return free_flyer.world(payload, base, arm, kind="planar", gravity_m_s2=gravity)


def fly(
    model: UrdfModel,
    motion: FlownJoints,
    velocity: Sequence[float] | FloatArray,
    drags: Sequence[Drag],
    duration_s: float,
) -> PlanarFlight:
    """One run: released with an initial velocity, then the arm moves.

    Args:
        model: from :func:`world`.
        motion: of the joints.
        velocity: of the base at the start: x, y, m/s, and yaw, rad/s, (3,).
        drags: of the three pucks.
        duration_s: of the run.
    """
    pucks = [AirPuck(np.array([*place, 0.0]), *drag) for place, drag in zip(PUCKS_m, drags, strict=True)]
    start = np.asarray(velocity, np.float64)
    flight = VehicleFlight(model, motion, free_flyer.PLACES, "payload", free_flyer.STEP_s, start, pucks=pucks)
    rows, moves = [], []
    for _ in range(round(duration_s / free_flyer.STEP_s)):
        flight.show()
        (vx, vy, w), yaw = flight.data.qvel[:3], flight.data.qpos[2]
        moves.append((np.cos(yaw) * vx + np.sin(yaw) * vy, np.cos(yaw) * vy - np.sin(yaw) * vx, w))
        rows.append(flight.advance(1))
    flown = free_flyer.signals(model, type(rows[0])(*(np.concatenate(part) for part in zip(*rows, strict=True))))
    return PlanarFlight(*flown[:5], np.array(moves))
