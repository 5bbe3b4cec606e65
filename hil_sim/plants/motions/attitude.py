"""Reaction wheels that hold the attitude of a free base: their motors' torques and what they start with.

The attitude control knows the true attitude and rate. Its law is smooth, also at the largest torque of a wheel's motor.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_sim.arrays import FloatArray
from hil_sim.plants.motions.joint_swings import wheels
from hil_sim.plants.urdf_model import UrdfModel, matrix_of
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import AttitudeTable, Scenario


class Wheels(NamedTuple):
    """The wheels under attitude control.

    Attributes:
        places: Of the wheels among the joints, (w,).
        axes: (w, 3), base axes.
        law: Spring, damper and largest torque.
    """

    places: NDArray[np.intp]
    axes: FloatArray
    law: AttitudeTable

    @property
    def start_rad_s(self) -> FloatArray:
        """Speed of each at the start, (w,)."""
        return np.full(len(self.places), self.law.start_rad_s)

    def torque_n_m(self, pose: FloatArray, velocity: FloatArray) -> FloatArray:
        """Of each motor on its wheel, (w,); ``pose`` and ``velocity`` are MuJoCo's of the base."""
        w, *xyz = pose[3:7]
        angle = 2.0 * np.copysign(1.0, w) * np.array(xyz)
        wanted = self.axes @ (self.law.spring_N_m_rad * angle + self.law.damper_N_m_s * velocity[3:6])
        return np.asarray(self.law.torque_N_m * np.tanh(wanted / self.law.torque_N_m))


def holding(scenario: Scenario, model: UrdfModel, joints: Sequence[str]) -> Wheels | None:
    """The wheels that hold the attitude; None without ``[attitude]``.

    Raises:
        ScenarioError: no wheels, wheels that are not on the base, or that the sequence moves.
    """
    if scenario.attitude is None:
        return None
    found = [name for name in joints if name in wheels(scenario)]
    if not found:
        raise ScenarioError("attitude: no reaction wheel is in the vehicle file; add it, or take [attitude] out")
    moved = sorted({name for step in scenario.sequence for name in step.rates} & set(found))
    if moved:
        raise ScenarioError(f"sequence.rates names {', '.join(moved)}, which [attitude] turns; take either out")
    axes = []
    for name in found:
        body = model.model.body(int(model.model.joint(name).bodyid[0]))
        if int(body.parentid[0]) != model.body(scenario.vehicle.base_link):
            raise ScenarioError(f"attitude: {name} is not a joint of {scenario.vehicle.base_link!r}; attach it there")
        axes.append(matrix_of(np.array(body.quat)) @ model.model.joint(name).axis)
    return Wheels(np.array([joints.index(name) for name in found]), np.array(axes), scenario.attitude)
