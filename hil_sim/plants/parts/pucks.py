"""Air pucks under a base on an air-bearing table: where they are and how they drag; and a spherical bearing."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.urdf_model import UrdfModel, matrix_of
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import BearingTable, Scenario

_ROUNDING_m_s = 2e-3  # of Coulomb drag


class AirPuck(NamedTuple):
    """An air puck under the base."""

    place_m: FloatArray  # (3,), base axes
    viscous_N_s_m: float  # noqa: N815
    coulomb_N: float  # noqa: N815


def pucks(scenario: Scenario, model: UrdfModel, rng: np.random.Generator) -> list[AirPuck]:
    """Every puck of the table, its drag drawn."""
    found = []
    for frame in scenario.table.pucks:
        link = model.model.body(model.body(frame))
        if int(link.parentid[0]) != model.body(scenario.vehicle.base_link):
            raise ScenarioError(f"table.pucks: {frame!r} is not fixed to {scenario.vehicle.base_link!r}; make it so")
        share = rng.uniform(0.0, 1.0, 2)
        drag = share * [scenario.table.viscous_N_s_m, scenario.table.coulomb_N]
        found.append(AirPuck(np.array(link.pos), *drag.tolist()))
    return found


Drag = Sequence[AirPuck] | BearingTable


def dragged(by: Drag, pose: FloatArray, velocity: FloatArray) -> FloatArray:
    """Generalised force on the base of its pucks or of its bearing, (3,); ``pose`` and ``velocity`` are MuJoCo's."""
    if isinstance(by, BearingTable):
        up = matrix_of(pose)[2]  # the vertical in the base's axes
        return np.asarray(by.turning_N_m * up - by.viscous_N_m_s * velocity, np.float64)
    return drag_wrench(by, float(pose[2]), velocity)


def drag_wrench(pucks: Sequence[AirPuck], yaw: float, velocity: FloatArray) -> FloatArray:
    """Generalised force of all pucks on x, y and yaw of the table, (3,); ``velocity`` of these, (3,)."""
    vx, vy, w = velocity.tolist()
    c, s = math.cos(yaw), math.sin(yaw)
    force_x = force_y = moment = 0.0
    for puck in pucks:
        px, py = float(puck.place_m[0]), float(puck.place_m[1])
        x, y = c * px - s * py, s * px + c * py
        slip_x, slip_y = vx - w * y, vy + w * x
        share = puck.viscous_N_s_m + puck.coulomb_N / math.hypot(slip_x, slip_y, _ROUNDING_m_s)
        force_x -= share * slip_x
        force_y -= share * slip_y
        moment -= share * (x * slip_y - y * slip_x)
    return np.array([force_x, force_y, moment])
