"""Momentum rows: conservation of the unknown initial momentum of a free vehicle (Limparis 2.84-2.90, 3.6-3.8).

``0 = H chi - P0``: momentum of all links about an inertial origin, in inertial axes, less the momentum at the start as
six more parameters. The rows need no acceleration; they need the base's attitude, position and velocity, which an IMU
gives by integration from any start, or a tracking system by itself. External impulses add columns.
"""

from typing import NamedTuple

import numpy as np

from onboard.dynamics.kinematics import cross, link_motions, momentum_columns
from onboard.dynamics.vehicle import STANDARD, VehicleModel
from onboard.estimation.arrays import FloatArray

START = ("P0_x", "P0_y", "P0_z", "L0_x", "L0_y", "L0_z")  # N s, N m s


class BaseState(NamedTuple):
    """Where the base is and how it moves."""

    R_WB: FloatArray  # (n, 3, 3) base axes in inertial ones
    position: FloatArray  # (n, 3) base origin, m, inertial axes
    velocity: FloatArray  # (n, 3) of the base origin, m/s, base axes
    rate: FloatArray  # (n, 3) rad/s, base axes


def momentum_names(vehicle: VehicleModel) -> tuple[str, ...]:
    """Names of the columns: ``M_<link> .. ZZ_<link>`` by link, then ``P0_x, _y, _z, L0_x, _y, _z``."""
    return (*(f"{parameter}_{link}" for link in vehicle.links for parameter in STANDARD), *START)


def momentum_rows(vehicle: VehicleModel, q: FloatArray, dq: FloatArray, base: BaseState) -> FloatArray:
    """Rows ``0 = Y [chi, P0]``, (n, 6, P + 6): linear momentum, then angular about the inertial origin.

    Args:
        vehicle: the model.
        q: joint positions, (n, joints).
        dq: joint rates, (n, joints).
        base: its state.

    Raises:
        SignalError: joint signals of another shape.
    """
    links = link_motions(vehicle, q, dq, np.zeros_like(q))
    Y = np.zeros((len(q), 6, 10 * len(links) + 6))
    for index, link in enumerate(links):
        H = momentum_columns(link, base.velocity, base.rate)  # (n, 6, 10) about the base's origin, its axes
        own = Y[:, :, 10 * index : 10 * index + 10]
        own[:, :3], own[:, 3:] = base.R_WB @ H[:, :3], base.R_WB @ H[:, 3:]
        own[:, 3:] += cross(base.position[:, None], own[:, :3].swapaxes(1, 2)).swapaxes(1, 2)
    Y[:, :, -6:] = -np.eye(6)
    return Y
