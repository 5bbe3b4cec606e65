"""Rocket arm simulated by MuJoCo: a plate with prescribed motion, an arm on one hinge, an ejected tip mass.

How the plate is prescribed: it is a free body of 1e6 kg and 1e6 kg m^2 (isotropic, so no gyroscopic moment of its own),
driven at every step by the force of the prescribed acceleration. The arm's reaction disturbs it by some 1e-6 m/s^2; at
every chunk its pose is put back to the identity and its velocity to the profile. In free fall nothing depends on pose
or on a common velocity, so this reset has no effect on the relative motion; the base motion acts on arm, accelerometer
and gyro through MuJoCo's equations.

Integration is MuJoCo's semi-implicit Euler with implicit damping off, so that the reported acceleration is that of the
joint: ``(q[k+1] - 2 q[k] + q[k-1]) / h^2 = qacc[k]``. Velocities then belong to half steps, ``t_k - h/2``, as the field
names of the history state.

The load cell is MuJoCo's torque sensor at the arm's own origin: the moment about the joint axis that the actuator's
output flange exerts on everything beyond it. Friction, ripple, rotor inertia and servo act on the joint, proximal to
it; stops, drag and ejection act on the arm, distal to it. Left out: the compliance of the gear and of the cell (a
resonance near 100 Hz would change the acceleration of a fast sweep by 3e-4), and the rotor's reaction on the rocket.
Known limit: forces that depend on the joint angle (drag's lever, ripple) use a linear extrapolation of it within a
chunk.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco import rollout

from hil_sim.arrays import FloatArray, cross
from hil_sim.plants import world
from hil_sim.plants.motion import ArmProgram, PlateMotion, base_motion
from hil_sim.scenario.rocket_tables import BodyTable, BuiltPart, Inertia, RocketScenario
from hil_sim.scenario.tables import ScenarioError

_BASE_MASS_kg = 1e6
_CONTROL = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED | mujoco.mjtState.mjSTATE_XFRC_APPLIED
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_IMPEDANCE = 0.05  # of contacts: small, so that they act as spring-dampers with little added inertia (5 %)


class ArmSignals(NamedTuple):
    """Computed signals on the grid ``t_k = k h``; rows from ``count`` on are not yet computed."""

    specific_force_imu_m_s2: FloatArray  # (n, 3), IMU axes as designed: a - g, in free fall the acceleration itself
    rate_half_imu_rad_s: FloatArray  # (n, 3), IMU axes, at t_k - h/2
    moment_n_m: FloatArray  # (n,), flange on arm about the joint axis
    angle_rad: FloatArray  # (n,)
    joint_rate_half_rad_s: FloatArray  # (n,), at t_k - h/2
    servo_torque_n_m: FloatArray  # (n,)


class MassProperties(NamedTuple):
    """Mass properties of all bodies beyond the load cell, in frame 3 (origin on the joint axis)."""

    mass_kg: float
    first_moment_kg_m: FloatArray  # (3,): m c = MX, MY, MZ
    inertia_kg_m2: FloatArray  # (3, 3) about the origin of frame 3


def mass_properties(scenario: RocketScenario, *, with_tip: bool) -> MassProperties:
    """Sum of arm and (with the tip) tip mass by the parallel-axis theorem: I_O = I_C + m (c.c 1 - c c')."""
    parts = [(scenario.body.arm, 0.0)]
    if with_tip:
        parts.append((scenario.body.tip_mass, _tip_radius_m(scenario)))
    mass, first, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    for body, offset_m in parts:
        m = _mass_kg(body)
        c = 1e-3 * np.asarray(body.com_mm) + [offset_m, 0.0, 0.0]
        e = body.inertia_g_mm2
        about_com = np.array([[e.xx, e.xy, e.xz], [e.xy, e.yy, e.yz], [e.xz, e.yz, e.zz]]) * 1e-9 * body.as_built_factor
        mass += m
        first += m * c
        inertia += about_com + m * (c @ c * np.eye(3) - np.outer(c, c))
    return MassProperties(mass, first, inertia)


def as_built(scenario: RocketScenario, rng: np.random.Generator) -> RocketScenario:
    """The scenario with its parts as built: ``[body]`` and ``[geometry]`` moved by draws of ``[as_built]``."""
    limits = scenario.as_built
    arm = _built(scenario.body.arm, limits.arm, rng)
    tip = _built(scenario.body.tip_mass, limits.tip_mass, rng)
    longer_mm = limits.length_mm * float(_deviates(rng, 1)[0])
    geometry = scenario.geometry.model_copy(update={"frame_5_a_mm": scenario.geometry.frame_5_a_mm + longer_mm})
    body = scenario.body.model_copy(update={"arm": arm, "tip_mass": tip})
    return scenario.model_copy(update={"body": body, "geometry": geometry})


def _built(body: BodyTable, sigma: BuiltPart, rng: np.random.Generator) -> BodyTable:
    mass, stretch, *moved = _deviates(rng, 5).tolist()
    com_mm = tuple(c + sigma.centre_mm * deviate for c, deviate in zip(body.com_mm, moved, strict=True))
    elements = {
        name: value * (1.0 + sigma.inertia_relative * stretch)
        for name, value in body.inertia_g_mm2.model_dump().items()
    }
    factor = body.as_built_factor * (1.0 + sigma.mass_relative * mass)
    update = {"com_mm": com_mm, "inertia_g_mm2": Inertia(**elements), "as_built_factor": factor}
    return body.model_copy(update=update)


def _deviates(rng: np.random.Generator, count: int) -> FloatArray:
    """Normal deviates, those beyond two standard deviations at these: a part beyond its limits is made again."""
    return np.clip(rng.standard_normal(count), -2.0, 2.0)


class RocketArmPlant(world.Plant):
    """The rocket's arm, computed chunk by chunk up to the requested time.

    Args:
        scenario: the mission.
        rng: draws of the rocket's motion; a generator spawned from it, those of the parts as built.

    Attributes:
        history: arrays of the whole mission, filled up to ``count`` rows.
        base: the prescribed motion of the plate.
    """

    def __init__(self, scenario: RocketScenario, rng: np.random.Generator) -> None:
        scenario = as_built(scenario, rng.spawn(1)[0])
        self.program: ArmProgram = ArmProgram(scenario)
        self.step_s = 1e-6 * scenario.physics.step_us
        self.chunk = scenario.physics.chunk_steps
        self.rows = self.chunk * (int(self.program.duration_s / (self.chunk * self.step_s)) + 2)
        self.base: PlateMotion = base_motion(scenario, self.step_s, self.rows, rng)
        self.history = ArmSignals(
            np.zeros((self.rows, 3)), np.zeros((self.rows, 3)), *(np.zeros(self.rows) for _ in range(4))
        )
        self.count = 0
        self._scenario = scenario
        self._ejection_row = self.rows
        if self.program.ejection_s is not None:
            self._ejection_row = round(self.program.ejection_s / self.step_s)
        self._servo_command = self._commands()
        self._push = _ejection_force(scenario, self._ejection_row, self.rows, self.step_s)
        self._model = build(scenario, with_tip=True)
        self._data = mujoco.MjData(self._model)
        self._free_model: mujoco.MjModel | None = None
        self._state = np.zeros((1, mujoco.mj_stateSize(self._model, _STATE)))
        mujoco.mj_getState(self._model, self._data, self._state[0], _STATE)
        self._rollout = rollout.Rollout(nthread=0)
        self._sensors = np.zeros((1, self.chunk, self._model.nsensordata))
        self._states = np.zeros((1, self.chunk, self._state.shape[1]))
        # rows at which something pushes the arm; elsewhere the sums below are zeros
        self._loaded = self._push.any(axis=1) | (self.base.dynamic_pressure_pa != 0.0)

    def inertial(self, at: str) -> world.Inertial:
        """See ``world.Plant``."""
        self._only(at)
        return world.Inertial(self.history.specific_force_imu_m_s2, self.history.rate_half_imu_rad_s, 0.5)

    def angle_rad(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        self._only(at)
        return self.history.angle_rad

    def moment_n_m(self, at: str, axis: world.Axis = world.Z) -> FloatArray:
        """See ``world.Plant``."""
        self._only(at)
        if axis != world.Z:
            raise ScenarioError("the cell is on the joint's axis; leave `axis` out")
        return self.history.moment_n_m

    def force_n(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        raise ScenarioError(f"no force is known at {at!r}: the arm's cell feels the moment; measure joint_moment")

    def servo_torque_n_m(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        self._only(at)
        return self.history.servo_torque_n_m

    def truth(self) -> dict[str, Any]:
        """See ``world.Plant``; frame 3 where one matters."""
        held, free = (mass_properties(self._scenario, with_tip=tip) for tip in (True, False))
        return {
            "m4_kg": free.mass_kg,
            "m5_kg": held.mass_kg - free.mass_kg,
            "m4_plus_m5_kg": held.mass_kg,
            "ZZ_with_tip_kg_m2": float(held.inertia_kg_m2[2, 2]),
            "ZZ_without_tip_kg_m2": float(free.inertia_kg_m2[2, 2]),
            "first_moment_with_tip_kg_m": held.first_moment_kg_m,
            "first_moment_without_tip_kg_m": free.first_moment_kg_m,
            "inertia_with_tip_kg_m2": held.inertia_kg_m2,
            "inertia_without_tip_kg_m2": free.inertia_kg_m2,
            "ejection_s": self.program.ejection_s,
        }

    def _only(self, at: str) -> None:
        if at:
            raise ScenarioError(f"there is no {at!r}: one IMU, one joint, one cell are here; leave `at` out")

    def _run_chunk(self) -> None:
        for first, last in self._legs(self.count, self.count + self.chunk):
            self._run(first, last)

    def _legs(self, first: int, last: int) -> Iterator[tuple[int, int]]:
        if first < self._ejection_row < last:
            yield first, self._ejection_row
            first = self._ejection_row
        yield first, last

    def _run(self, first: int, last: int) -> None:
        """Steps ``first..last`` with the plate put back to the identity pose at the first of them."""
        if first >= self._ejection_row and self._free_model is None:
            self._free_model = self._model = build(self._scenario, with_tip=False)
            self._data = mujoco.MjData(self._model)
        rows = slice(first, last)
        n = last - first
        state = self._state
        state[0, :12] = state[0, 0], 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, state[0, 8], 0.0, 0.0, 0.0
        state[0, 12:15] = self.base.angular_rate_half_rad_s[first]
        q, dq = state[0, 8], state[0, 15]
        q_ahead = q + dq * self.step_s * np.arange(n)  # extrapolated angle for forces that depend on it
        R = self._attitudes(rows)  # (n, 3, 3) plate to world
        control = np.zeros((n, mujoco.mj_stateSize(self._model, _CONTROL)))
        control[:, 0] = self._servo_command[rows]
        control[:, 1:4] = _BASE_MASS_kg * np.einsum("nij,nj->ni", R, self.base.origin_accel_m_s2[rows])
        control[:, 4:7] = _BASE_MASS_kg * self.base.angular_accel_rad_s2[rows]
        control[:, 7] = self._scenario.joint.ripple_Nm * np.sin(self._scenario.joint.ripple_cycles_per_rev * q_ahead)
        if self._loaded[rows].any():
            arm = 8 + 6 * 2  # xfrc_applied of bodies world, plate, then the arm
            force, moment = self._arm_load(rows, q_ahead)
            control[:, arm : arm + 3] = np.einsum("nij,nj->ni", R, force)
            control[:, arm + 3 : arm + 6] = np.einsum("nij,nj->ni", R, moment)
        sensors, states = self._sensors[:, :n], self._states[:, :n]
        options: dict[str, Any] = {"skip_checks": True, "nstep": n, "state": states, "sensordata": sensors}
        bodies = [self._model], [self._data], state, control[None]
        self._rollout.rollout(*bodies, control_spec=int(_CONTROL), **options)
        state[0] = states[0, -1]
        h = self.history
        h.specific_force_imu_m_s2[rows] = sensors[0, :, 0:3]
        h.rate_half_imu_rad_s[rows] = sensors[0, :, 3:6]
        h.moment_n_m[rows] = sensors[0, :, 8]
        h.angle_rad[rows] = sensors[0, :, 9]
        h.joint_rate_half_rad_s[rows] = sensors[0, :, 10]
        h.servo_torque_n_m[rows] = sensors[0, :, 11]
        self.count = last

    def _attitudes(self, rows: slice) -> FloatArray:
        """Rotation plate to world since the start of the chunk (n, 3, 3): a few mrad, to second order."""
        turn = self.step_s * np.cumsum(self.base.angular_rate_half_rad_s[rows], axis=0)
        turn -= turn[0]
        S = np.zeros((len(turn), 3, 3))
        S[:, 0, 1], S[:, 0, 2], S[:, 1, 2] = -turn[:, 2], turn[:, 1], -turn[:, 0]
        S -= S.transpose(0, 2, 1)
        return np.eye(3) + S + 0.5 * S @ S

    def _arm_load(self, rows: slice, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Drag and ejection reaction on the arm, as force at its centre of mass and moment, (n, 3) in plate axes."""
        air, com = self._scenario.reentry, 1e-3 * np.asarray(self._scenario.body.arm.com_mm)
        angle = q + np.deg2rad(self._scenario.geometry.frame_1_theta_deg)
        R = np.zeros((len(q), 3, 3))
        R[:, 0, 0], R[:, 1, 0] = np.cos(angle), np.sin(angle)
        R[:, 1, 1], R[:, 0, 1], R[:, 2, 2] = R[:, 0, 0], -R[:, 1, 0], 1.0
        drag = air.arm_drag_area_m2 * self.base.dynamic_pressure_pa[rows, None] * self.base.wind[rows]
        moment = cross(R @ (1e-3 * np.asarray(air.arm_centre_of_pressure_mm) - com), drag)
        if not self._push[rows].any():
            return drag, moment
        push = np.einsum("nij,nj->ni", R, self._push[rows])
        to_tip = R @ (np.array([_tip_radius_m(self._scenario), 0.0, 0.0]) - com)
        return drag + push, moment + cross(to_tip, push)

    def _commands(self) -> FloatArray:
        """Servo set-point with feed-forward, for the whole mission: u such that kp (u - q) - kd dq is the torque."""
        joint, servo = self._scenario.joint, self._scenario.servo
        reference = self.program.reference(self.step_s * np.arange(self.rows, dtype=np.float64))
        inertia = np.full(self.rows, mass_properties(self._scenario, with_tip=True).inertia_kg_m2[2, 2])
        inertia[self._ejection_row :] = mass_properties(self._scenario, with_tip=False).inertia_kg_m2[2, 2]
        torque = (
            (joint.reflected_rotor_inertia_kg_m2 + inertia) * reference.accel_rad_s2
            + (servo.damping_Nm_s_rad + joint.viscous_friction_Nm_s_rad) * reference.rate_rad_s
            + servo.friction_feedforward * joint.coulomb_friction_Nm * np.tanh(reference.rate_rad_s / 0.01)
        )
        return reference.angle_rad + torque / servo.stiffness_Nm_rad


def _ejection_force(scenario: RocketScenario, first: int, rows: int, step_s: float) -> FloatArray:
    """Reaction of the ejection spring on the arm, frame 3 axes (rows, 3): a half-sine with the tip mass's momentum."""
    force = np.zeros((rows, 3))
    spring = scenario.ejection
    n = max(1, round(1e-3 * spring.duration_ms / step_s))
    shape = np.sin(np.pi * (np.arange(n) + 0.5) / n)
    direction = np.asarray(spring.direction_frame_5) / np.linalg.norm(spring.direction_frame_5)
    impulse = _mass_kg(scenario.body.tip_mass) * spring.speed_m_s
    reaction = -impulse / (shape.sum() * step_s) * shape[:, None] * direction
    last = min(rows, first + n)
    force[first:last] = reaction[: last - first]
    return force


def _mass_kg(body: BodyTable) -> float:
    return 1e-3 * body.mass_g * body.as_built_factor


def _tip_radius_m(scenario: RocketScenario) -> float:
    return 1e-3 * (scenario.geometry.frame_4_a_mm + scenario.geometry.frame_5_a_mm)


def build(scenario: RocketScenario, *, with_tip: bool) -> mujoco.MjModel:
    """The compiled MuJoCo model with the scenario's contact stiffness and damping.

    A contact of constant impedance d gives the force (k r + b v + a) / R with R = (1 - d) / d times MuJoCo's own
    estimate of the inverse mass at the contact; a direct solref gives k = stiffness / d and b = damping / d (MuJoCo,
    Computation, "Solver parameters"). So both are scaled by d R, which is known only after compilation.
    """
    model = mujoco.MjModel.from_xml_string(mjcf(scenario, with_tip=with_tip))
    stops = scenario.stops
    inverse_mass = model.body("arm").invweight0[0] + model.body("plate").invweight0[0]
    scale = 1e3 * (1.0 - _IMPEDANCE) * inverse_mass
    springs = {
        "pad": (stops.pad_stiffness_N_mm, stops.pad_damping_N_s_mm),
        "hard_positive": (stops.hard_stiffness_N_mm, stops.hard_damping_N_s_mm),
        "hard_negative": (stops.hard_stiffness_N_mm, stops.hard_damping_N_s_mm),
    }
    for name, (stiffness, damping) in springs.items():
        pair = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_PAIR, name)
        model.pair_solref[pair] = -stiffness * scale, -damping * scale
    return model


def mjcf(scenario: RocketScenario, *, with_tip: bool) -> str:
    """The world as MJCF; the plate's body frame is frame 0, the arm's is frame 3."""
    g, joint, servo, stops = scenario.geometry, scenario.joint, scenario.servo, scenario.stops
    theta = np.deg2rad(g.frame_1_theta_deg)
    hinge = 1e-3 * np.array([g.frame_2_a_mm * np.cos(theta), g.frame_2_a_mm * np.sin(theta), g.frame_3_d_mm])
    tip = ""
    if with_tip:
        tip = f'<body name="tip_mass" pos="{_tip_radius_m(scenario)} 0 0">{_inertial(scenario.body.tip_mass)}</body>'
    pair = f'geom1="boss" condim="1" solimp="{_IMPEDANCE} {_IMPEDANCE} 0.001"'
    return f"""
<mujoco model="rocksat">
  <compiler angle="radian"/>
  <option timestep="{1e-6 * scenario.physics.step_us}" gravity="0 0 0" integrator="Euler" tolerance="1e-15">
    <flag eulerdamp="disable"/>
  </option>
  <worldbody>
    <body name="plate">
      <freejoint/>
      <inertial pos="0 0 0" mass="{_BASE_MASS_kg}" diaginertia="{_BASE_MASS_kg} {_BASE_MASS_kg} {_BASE_MASS_kg}"/>
      <site name="imu" pos="{_row(1e-3 * np.asarray(g.imu_position_mm))}"
            quat="{_row(_quaternion(np.deg2rad(g.imu_roll_pitch_yaw_deg)))}"/>
      {_stop("pad", stops.pad_deg, 1.0, stops.contact_radius_mm, hinge, theta)}
      {_stop("hard_positive", stops.hard_deg, 1.0, stops.contact_radius_mm, hinge, theta)}
      {_stop("hard_negative", -stops.hard_deg, -1.0, stops.contact_radius_mm, hinge, theta)}
      <body name="arm" pos="{_row(hinge)}" quat="{_row(_quaternion(np.array([0.0, 0.0, theta])))}">
        <joint name="joint_1" type="hinge" axis="0 0 1" armature="{joint.reflected_rotor_inertia_kg_m2}"
               damping="{joint.viscous_friction_Nm_s_rad}" frictionloss="{joint.coulomb_friction_Nm}"
               solimpfriction="0.99 0.99 0.001"/>
        {_inertial(scenario.body.arm)}
        <site name="flange"/>
        <geom name="boss" type="sphere" size="{_BOSS_m}" pos="{1e-3 * stops.contact_radius_mm} 0 0" mass="0"/>
        {tip}
      </body>
    </body>
  </worldbody>
  <contact>
    <pair name="pad" geom2="pad" {pair}/>
    <pair name="hard_positive" geom2="hard_positive" {pair}/>
    <pair name="hard_negative" geom2="hard_negative" {pair}/>
  </contact>
  <actuator>
    <general name="servo" joint="joint_1" gainprm="{servo.stiffness_Nm_rad}" biastype="affine"
             biasprm="0 {-servo.stiffness_Nm_rad} {-servo.damping_Nm_s_rad}" forcelimited="true"
             forcerange="{-servo.torque_limit_Nm} {servo.torque_limit_Nm}"/>
  </actuator>
  <sensor>
    <accelerometer site="imu"/>
    <gyro site="imu"/>
    <torque site="flange"/>
    <jointpos joint="joint_1"/>
    <jointvel joint="joint_1"/>
    <actuatorfrc actuator="servo"/>
  </sensor>
</mujoco>"""


_BOSS_m = 0.005


def _stop(name: str, angle_deg: float, side: float, radius_mm: float, hinge: FloatArray, theta: float) -> str:
    """A block on the plate whose face the boss touches when the joint stands at ``angle_deg``."""
    angle = theta + np.deg2rad(angle_deg)
    depth = 0.004
    radial = np.array([np.cos(angle), np.sin(angle), 0.0])
    onward = side * np.array([-np.sin(angle), np.cos(angle), 0.0])
    place = hinge + 1e-3 * radius_mm * radial + (_BOSS_m + depth) * onward
    turn = _quaternion(np.array([0.0, 0.0, angle]))
    return (
        f'<geom name="{name}" type="box" size="0.02 {depth} 0.02" pos="{_row(place)}" quat="{_row(turn)}" '
        'contype="0" conaffinity="0" mass="0"/>'
    )


def _inertial(body: BodyTable) -> str:
    e: Inertia = body.inertia_g_mm2
    elements = 1e-9 * body.as_built_factor * np.array([e.xx, e.yy, e.zz, e.xy, e.xz, e.yz])
    return (
        f'<inertial pos="{_row(1e-3 * np.asarray(body.com_mm))}" mass="{_mass_kg(body)}" '
        f'fullinertia="{_row(elements)}"/>'
    )


def _quaternion(roll_pitch_yaw: FloatArray) -> FloatArray:
    """(4,) w x y z of Rz(yaw) Ry(pitch) Rx(roll)."""
    quaternion = np.zeros(4)
    mujoco.mju_euler2Quat(quaternion, np.asarray(roll_pitch_yaw, dtype=np.float64), "XYZ")
    return quaternion


def _row(values: FloatArray) -> str:
    return " ".join(repr(float(v)) for v in values)
