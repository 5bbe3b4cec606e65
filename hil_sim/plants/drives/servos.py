"""Servos and stops of a vehicle's joints: what a scenario says of them, in numbers and in MuJoCo's model."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.drives.driven_vehicle import Losses
from hil_sim.plants.urdf_drawing import PREFIX, PlantDrawing
from hil_sim.plants.urdf_model import matrix_of
from hil_sim.scenario.part_tables import ServoTable, StopTable
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import Scenario

_IMPEDANCE = 0.05  # of stops: small, so that they act as spring-dampers with little added inertia (5 %)
_DRY = (0.99, 0.99, 0.001)  # solver impedance of Coulomb friction
_RATIO = 0.8  # damping of a servo whose damping is not given
_BOSS_m, _DEPTH_m = 0.005, 0.004  # radius of a stop's boss, half depth of its block


class Servo(NamedTuple):
    """A joint's position loop, and what the drive adds."""

    stiffness: float  # N m/rad
    damping: float  # N m s/rad
    limit: float  # N m
    feedforward: float  # share of the Coulomb friction
    drive: Losses
    ripple: float  # N m
    cycles: float  # per revolution


class OfAll(NamedTuple):
    """Numbers of all servos, (j,) each."""

    stiffness: FloatArray
    viscous: FloatArray  # that of the loop too
    dry: FloatArray  # what is fed forward
    ripple: FloatArray
    cycles: FloatArray


def fit(scenario: Scenario, drawing: PlantDrawing) -> Callable[[mujoco.MjSpec, mujoco.MjModel], None]:
    """What puts servos and stops into a model that is being made.

    Raises:
        ScenarioError: a joint or link that is not there, or a joint that slides and is to have a stop.
    """
    named = {*scenario.servo.keys() - {"default"}, *(stop.joint for stop in scenario.stop)}
    if unknown := sorted(named - drawing.joints.keys()):
        raise ScenarioError(f"servo, stop: {', '.join(unknown)}: the joints are {', '.join(drawing.joints)}")
    if missing := sorted(drawing.joints.keys() - scenario.servo.keys()) if "default" not in scenario.servo else []:
        raise ScenarioError(f"servo: {', '.join(missing)} has none; add [servo.default], of all that are not named")
    if sliding := [stop.joint for stop in scenario.stop if drawing.joints[stop.joint].slides]:
        raise ScenarioError(f"stop: {', '.join(sliding)} slides; stops are of joints that turn")
    if unknown := sorted({table.link for table in scenario.drag} - set(drawing.links)):
        raise ScenarioError(f"drag: {', '.join(unknown)}: the links are {', '.join(drawing.links)}")

    def add(spec: mujoco.MjSpec, bare: mujoco.MjModel) -> None:
        spec.compiler.discardvisual = False
        for index, stop in enumerate(scenario.stop):
            _add_stop(spec, bare, drawing, index, stop)
        for name in (bare.joint(index).name for index in range(bare.njnt)):
            if name in drawing.joints:
                servo = spec.add_actuator(name=f"servo {name}", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
                servo.gaintype, servo.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
                kind, target = mujoco.mjtSensor.mjSENS_ACTUATORFRC, mujoco.mjtObj.mjOBJ_ACTUATOR
                spec.add_sensor(name=f"torque of {name}", type=kind, objtype=target, objname=servo.name)

    return add


def _add_stop(spec: mujoco.MjSpec, bare: mujoco.MjModel, drawing: PlantDrawing, index: int, stop: StopTable) -> None:
    """A boss on the link beyond the joint, and on the one before a block whose face it touches at the angle."""
    joint, link = bare.joint(stop.joint), bare.body(PREFIX + drawing.joints[stop.joint].child)
    axis, R = np.array(joint.axis), matrix_of(link.quat)
    aside = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    out = np.cross(aside / np.linalg.norm(aside), axis)
    side, angle = (1.0 if stop.end == "upper" else -1.0), np.deg2rad(stop.at_deg)
    radial = np.cos(angle) * out + np.sin(angle) * np.cross(axis, out)
    onward = np.cross(axis, radial)
    block, turn = 1e-3 * stop.radius_mm * radial + side * (_BOSS_m + _DEPTH_m) * onward, np.zeros(4)
    mujoco.mju_mat2Quat(turn, (R @ np.column_stack([radial, onward, axis])).ravel())
    boss, face = f"stop {index} boss", f"stop {index}"
    alone: dict[str, Any] = {"contype": 0, "conaffinity": 0, "mass": 0.0}
    spec.body(link.name).add_geom(
        name=boss, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[_BOSS_m, 0.0, 0.0], pos=1e-3 * stop.radius_mm * out, **alone
    )
    spec.body(bare.body(int(link.parentid[0])).name).add_geom(
        name=face,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[0.02, _DEPTH_m, 0.02],
        pos=np.array(link.pos) + R @ block,
        quat=turn,
        **alone,
    )
    pair = spec.add_pair(name=face, geomname1=boss, geomname2=face, condim=1)
    pair.solimp = [_IMPEDANCE, _IMPEDANCE, 0.001, 0.5, 2.0]


def servos(
    tables: Mapping[str, ServoTable],
    joints: Sequence[str],
    drives: Mapping[str, Losses],
    efforts_n_m: Mapping[str, float],
    inertias_kg_m2: FloatArray,
) -> list[Servo]:
    """The joints' servos.

    Args:
        tables: of the scenario, by joint, and ``default``.
        joints: in the order of the vehicle's.
        drives: drawn friction and rotor, of which the tables say otherwise.
        efforts_n_m: largest torques.
        inertias_kg_m2: that each joint turns at the start, without its rotor.
    """
    found = []
    for name, inertia in zip(joints, inertias_kg_m2.tolist(), strict=True):
        table = tables.get(name) or tables["default"]
        drive = as_stated(table, drives[name])
        w = 2.0 * np.pi * table.bandwidth_Hz
        stiffness = table.stiffness_N_m_rad or w * w * (inertia + drive.rotor_kg_m2)
        damping = table.damping_N_m_s_rad or 2.0 * _RATIO * np.sqrt(stiffness * (inertia + drive.rotor_kg_m2))
        loop = stiffness, damping, table.torque_limit_N_m or efforts_n_m[name], table.friction_feedforward
        found.append(Servo(*loop, drive, table.ripple_N_m, table.ripple_cycles_per_rev))
    return found


def of_all(found: Sequence[Servo]) -> OfAll:
    """Their numbers, for all joints at once."""
    rows = [
        (
            one.stiffness,
            one.damping + one.drive.viscous_n_m_s,
            one.feedforward * one.drive.coulomb_n_m,
            one.ripple,
            one.cycles,
        )
        for one in found
    ]
    return OfAll(*np.array(rows).T)


def as_stated(table: ServoTable, drawn: Losses) -> Losses:
    """A joint's drive: what the table says, and what was drawn where it says nothing."""
    own = table.coulomb_N_m, table.viscous_N_m_s_rad, table.rotor_kg_m2
    return Losses(*(mine if said is None else said for said, mine in zip(own, drawn, strict=True)))


def install(model: mujoco.MjModel, first: int, found: Sequence[Servo]) -> None:
    """The servos' numbers in the model.

    Args:
        model: with what ``fit`` adds.
        first: degree of freedom of the first joint.
        found: in the order of the joints.
    """
    for place, servo in enumerate(found):
        column = first + place
        model.actuator_gainprm[place, 0] = servo.stiffness
        model.actuator_biasprm[place, 1:3] = -servo.stiffness, -servo.damping
        model.actuator_forcelimited[place] = 1
        model.actuator_forcerange[place] = -servo.limit, servo.limit
        model.dof_armature[column], model.dof_damping[column] = servo.drive.rotor_kg_m2, servo.drive.viscous_n_m_s
        model.dof_frictionloss[column] = servo.drive.coulomb_n_m
        model.dof_solimp[column, :3] = _DRY
    mujoco.mj_setConst(model, mujoco.MjData(model))


def stiffen(model: mujoco.MjModel, stops: Sequence[StopTable]) -> None:
    """Stiffness and damping of the stops, for the bodies as they are.

    A contact of constant impedance d gives the force (k r + b v + a) / R with R = (1 - d) / d times MuJoCo's own
    estimate of the inverse mass at the contact; a direct solref gives k = stiffness / d and b = damping / d (MuJoCo,
    Computation, "Solver parameters"). So both are scaled by d R.
    """
    for index, stop in enumerate(stops):
        pair = model.pair(f"stop {index}").id
        bodies = model.geom_bodyid[model.pair_geom1[pair]], model.geom_bodyid[model.pair_geom2[pair]]
        inverse_mass = sum(float(model.body_invweight0[body, 0]) for body in bodies)
        scale = 1e3 * (1.0 - _IMPEDANCE) * inverse_mass
        model.pair_solref[pair] = -stop.stiffness_N_mm * scale, -stop.damping_N_s_mm * scale
