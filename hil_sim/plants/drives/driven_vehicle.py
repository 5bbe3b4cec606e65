"""A vehicle whose joints are moved by the torques of their drives, integrated forward by MuJoCo (RK4, 1 ms).

Every drive is asked for a torque each millisecond, as ``servo_axis`` does it for one joint; here all joints, the
payload and the base act on each other. Rotor inertia is MuJoCo's armature, viscous friction its damping, Coulomb
friction and the brake its dry friction, which holds a joint that stands. Where a base floats or slides, nothing holds
it but the drag of its pucks. The joints' limits are not simulated: a drive that leaves its software limits faults.
"""

import copy
import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.body import Solid
from hil_sim.plants.drives.servo_axis import KEPT, STEP_S, Controller, Stepped
from hil_sim.plants.parts.pucks import AirPuck, drag_wrench
from hil_sim.scenario.vehicle_tables import JointFriction

_NOISE: Final = 1 << 14  # samples of encoder noise, one a millisecond, then again from the first
_STIFF: Final = (0.004, 1.0)  # of dry friction: time constant, s, and damping ratio
_HARD: Final = (0.99, 0.999, 0.001, 0.5, 2.0)


class Losses(NamedTuple):
    """What a joint's drive adds to the torque that its motor makes."""

    coulomb_n_m: float
    viscous_n_m_s: float
    rotor_kg_m2: float


class DrivenJoint:
    """One joint of the vehicle, as its drive has it: see ``servo_axis.Axis``."""

    def __init__(self, vehicle: "DrivenVehicle", place: int, effort_n_m: float, inertia_kg_m2: float) -> None:
        self.controller: Controller | None = None
        self.largest_n_m, self.inertia_kg_m2 = effort_n_m, inertia_kg_m2
        self.torque_n_m = self.fastest_rad_s = 0.0
        self._vehicle, self._place = vehicle, place
        self.lowest_rad = self.highest_rad = vehicle.angles_rad[place]

    @property
    def rate_rad_s(self) -> float:
        """Rate at the newest step."""
        return float(self._vehicle.rates_rad_s[self._place])

    @property
    def newest_s(self) -> float:
        """Time of the newest step."""
        return self._vehicle.newest_s

    def advance(self, time_s: float) -> None:
        """Compute the whole vehicle up to ``time_s``, and the step after it."""
        self._vehicle.advance(time_s)

    def angle_rad(self, time_s: float) -> float:
        """Angle at ``time_s``, up to half a second ago, with the encoder's noise."""
        return self._vehicle.angle_rad(self._place, time_s)

    def motor_n_m(self, time_s: float) -> float:
        """Torque of the motor at ``time_s``, up to half a second ago."""
        return self._vehicle.motor_n_m(self._place, time_s)


class Drivable(NamedTuple):
    """What a plant has drawn, to be driven.

    Attributes:
        empty: MuJoCo's model with nothing in the gripper.
        held: With the payload.
        joints: Names, in the order of MuJoCo's columns after the base's.
        drives: Friction and rotor of each.
        efforts_n_m: Largest torque of each.
        posture_rad: Where they stand, (n,).
        velocity: Of the base at the start, MuJoCo's numbers; empty where it is fixed.
        pucks: Of a base on a table.
    """

    empty: mujoco.MjModel
    held: mujoco.MjModel
    joints: tuple[str, ...]
    drives: Mapping[str, Losses]
    efforts_n_m: Mapping[str, float]
    posture_rad: FloatArray
    velocity: FloatArray
    pucks: Sequence[AirPuck] = ()


class DrivenVehicle(Stepped):
    """The vehicle.

    Args:
        built: What it is made of.
        noise_rad: White noise of every encoder, 1 sigma.
        seed: Of the noise.

    Attributes:
        built: What it is made of.
        axes: Its joints, by name.
        model: MuJoCo's, of what moves now.
        data: Its state at the newest step.
    """

    def __init__(self, built: Drivable, noise_rad: float = 0.0, seed: int = 0) -> None:
        self.built = built
        self._nb = built.empty.nv - len(built.joints)
        self.model = self._prepared(built.empty)
        self.data = mujoco.MjData(self.model)
        self.data.qpos[self.model.nq - len(built.joints) :] = built.posture_rad
        self.data.qvel[: self._nb] = built.velocity
        mujoco.mj_forward(self.model, self.data)
        self._noise = noise_rad * np.random.default_rng([seed, 0xE1]).standard_normal((_NOISE, len(built.joints)))
        super().__init__(self.angles_rad)
        self._torques = deque([[0.0] * len(built.joints)], KEPT)  # of the step before each
        self.axes = {
            name: DrivenJoint(self, place, built.efforts_n_m[name], self._inertia(place))
            for place, name in enumerate(built.joints)
        }

    def _inertia(self, place: int) -> float:
        """Of a joint's column, kg m^2: what its drive is tuned for."""
        column = self._nb + place
        unit, moved = np.zeros(self.model.nv), np.zeros(self.model.nv)
        unit[column] = 1.0
        mujoco.mj_mulM(self.model, self.data, moved, unit)
        return float(moved[column])

    def _prepared(self, source: mujoco.MjModel) -> mujoco.MjModel:
        """A copy with drives in its joints."""
        model = copy.copy(source)
        model.opt.timestep = STEP_S
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        kept_off = mujoco.mjtDisableBit.mjDSBL_CONTACT, mujoco.mjtDisableBit.mjDSBL_LIMIT
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        model.opt.disableflags |= sum(int(flag) for flag in kept_off)
        for place, name in enumerate(self.built.joints):
            drive, column = self.built.drives[name], self._nb + place
            model.dof_armature[column], model.dof_damping[column] = drive.rotor_kg_m2, drive.viscous_n_m_s
            model.dof_frictionloss[column] = drive.coulomb_n_m
            model.dof_solref[column], model.dof_solimp[column] = _STIFF, _HARD
        return model

    @property
    def angles_rad(self) -> list[float]:
        """True angles at the newest step."""
        found: list[float] = self.data.qpos[self.model.nq - len(self.built.joints) :].tolist()
        return found

    @property
    def rates_rad_s(self) -> list[float]:
        """True rates at the newest step."""
        found: list[float] = self.data.qvel[self._nb :].tolist()
        return found

    def capture(self) -> None:
        """The gripper closes about a payload that moves as the gripper does: no momentum is exchanged."""
        before = self.data
        self.model = self._prepared(self.built.held)
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:], self.data.qvel[:] = before.qpos, before.qvel
        mujoco.mj_forward(self.model, self.data)

    def angle_rad(self, place: int, time_s: float) -> float:
        """Angle of a joint at ``time_s``, up to half a second ago, with the encoder's noise."""
        return self._angle_rad(place, time_s) + float(self._noise[round(max(time_s / STEP_S, 0.0)) % _NOISE, place])

    def motor_n_m(self, place: int, time_s: float) -> float:
        """Torque of a joint's motor in the step that ``time_s`` is in, up to half a second ago."""
        self.advance(time_s)
        back = self._count - math.floor(max(time_s / STEP_S, 0.0))
        return self._torques[-min(max(back, 1), len(self._torques))][place]

    def _step(self) -> None:
        time_s, rates, data = self._count * STEP_S, self.rates_rad_s, self.data
        if self.built.pucks:
            data.qfrc_applied[:3] = drag_wrench(self.built.pucks, float(data.qpos[2]), data.qvel[:3])
        for place, (name, axis) in enumerate(self.axes.items()):
            wanted = None if axis.controller is None else axis.controller(time_s, rates[place])
            braked = 0.0 if wanted is not None else axis.largest_n_m
            axis.torque_n_m = min(max(wanted or 0.0, -axis.largest_n_m), axis.largest_n_m)
            data.qfrc_applied[self._nb + place] = axis.torque_n_m
            self.model.dof_frictionloss[self._nb + place] = self.built.drives[name].coulomb_n_m + braked
        mujoco.mj_step(self.model, data)
        self._count += 1
        angles = self.angles_rad
        self._past.append(angles)
        self._torques.append([axis.torque_n_m for axis in self.axes.values()])
        for angle, rate, axis in zip(angles, self.rates_rad_s, self.axes.values(), strict=True):
            axis.lowest_rad, axis.highest_rad = min(axis.lowest_rad, angle), max(axis.highest_rad, angle)
            axis.fastest_rad_s = max(axis.fastest_rad_s, abs(rate))


def drawn_drives(
    table: JointFriction, efforts_n_m: Mapping[str, float], bodies: Mapping[str, Solid], rng: np.random.Generator
) -> dict[str, Losses]:
    """Friction and rotor of every joint, by its largest torque; ``bodies`` are what the joints turn."""
    found = {}
    for joint, effort in efforts_n_m.items():
        factor = 2.0 ** rng.uniform(-1.0, 1.0, 3)
        turned = sum(float(body.principal_kg_m2[-1]) for body in bodies.values()) / len(efforts_n_m)
        sizes = effort * table.coulomb, effort * table.viscous_s_rad, turned * table.rotor
        found[joint] = Losses(*(float(size * by) for size, by in zip(sizes, factor, strict=True)))
    return found
