"""Free-flyer with a five-joint arm and a payload in free fall, simulated by MuJoCo.

Geometry: the ExoSPHERES base (23.1 kg, 0.45 x 0.45 x 0.41 m) with the DYMAFLEX arm (yaw-pitch-roll-pitch-roll, 3.399
kg) of Limparis section 4.3. The dissertation gives neither the link lengths nor the distribution of the arm's mass:
chosen here for a reach of 0.68 m.

The joints follow a prescribed motion. MuJoCo integrates the whole vehicle (RK4); its control callback gives the joint
torques of the prescribed accelerations at every stage, so there is no zero-order hold and the servo error is
negligible. The motion of the free base is MuJoCo's result.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants import body as bodies
from hil_sim.plants.parts.actuators import NO_ACTUATORS, Actuators, Wheel

Body = bodies.Solid
JOINTS = 5
_STIFFNESS, _DAMPING = 400.0, 40.0  # 1/s^2, 1/s: corrects integration error


class _Mount(NamedTuple):
    body: Body
    position_m: tuple[float, float, float]  # of its joint in the body before
    axis: tuple[float, float, float]


BASE = Body.box(23.1, (0.45, 0.45, 0.41), (0.004, -0.006, 0.011))
_ARM = (
    _Mount(Body.box(0.900, (0.08, 0.08, 0.10), (0.002, 0.004, 0.050)), (0.0, 0.0, 0.205), (0.0, 0.0, 1.0)),
    _Mount(Body.box(0.950, (0.06, 0.06, 0.26), (0.003, -0.008, 0.120)), (0.0, 0.0, 0.100), (0.0, 1.0, 0.0)),
    _Mount(Body.box(0.550, (0.06, 0.06, 0.09), (-0.002, 0.003, 0.040)), (0.0, 0.0, 0.260), (0.0, 0.0, 1.0)),
    _Mount(Body.box(0.600, (0.05, 0.05, 0.22), (0.004, 0.005, 0.100)), (0.0, 0.0, 0.090), (0.0, 1.0, 0.0)),
    _Mount(Body.box(0.399, (0.05, 0.05, 0.09), (0.001, -0.003, 0.045)), (0.0, 0.0, 0.140), (0.0, 0.0, 1.0)),
)
ARM = tuple(mount.body for mount in _ARM)
AS_DRAWN = np.zeros((JOINTS, 3))  # joints where they are drawn, m
COUNTS_PER_TURN = 500_000  # 1250 lines, four edges each, behind a gear of 100
GRASP_m = (0.0, 0.0, 0.090)  # the payload's frame in the last link, axes alike
IMU_POSITION_m, IMU_QUATERNION = (0.120, -0.080, 0.050), (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # x of it along base y


@dataclass(frozen=True)
class JointMotion:
    """``q(t) = q_0 + sum_k a_k (sin(w_k t + p_k) - sin p_k)`` by joint; each array (joints, harmonics)."""

    start_rad: FloatArray  # (joints,)
    amplitude_rad: FloatArray
    rate_rad_s: FloatArray
    phase_rad: FloatArray

    @staticmethod
    def draw(rng: np.random.Generator, swing_rad: float = 0.35, harmonics: int = 3) -> "JointMotion":
        """Random exciting motion: all joints swing at once, at 0.1 to 0.6 Hz, each differently."""
        shape = (JOINTS, harmonics)
        amplitude = swing_rad / np.sqrt(harmonics) * rng.uniform(0.6, 1.2, shape)
        rate = 2.0 * np.pi * rng.uniform(0.1, 0.6, shape)
        start = np.array([0.0, 0.6, 0.0, 0.8, 0.0]) + rng.uniform(-0.3, 0.3, JOINTS)
        return JointMotion(start, amplitude, rate, rng.uniform(0.0, 2.0 * np.pi, shape))

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angle, rate and acceleration at times (n,); (n, joints) each."""
        a, w, p = self.amplitude_rad, self.rate_rad_s, self.phase_rad
        turn = w * time_s[:, None, None] + p
        sine, cosine = np.sin(turn), np.cos(turn)
        q = self.start_rad + (a * (sine - np.sin(p))).sum(axis=2)
        return q, (a * w * cosine).sum(axis=2), -(a * w * w * sine).sum(axis=2)


class JointPath(Protocol):
    """Prescribed joint motion."""

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angle, rate and acceleration at times (n,); (n, joints) each."""


class FreeFlightSignals(NamedTuple):
    """True signals on the grid of the samples."""

    time_s: FloatArray  # (n,)
    q_rad: FloatArray  # (n, 5)
    dq_rad_s: FloatArray  # (n, 5)
    rate_rad_s: FloatArray  # (n, 3) of the base, IMU axes
    specific_force_m_s2: FloatArray  # (n, 3) at the IMU, its axes: a - g, in free fall the acceleration itself
    wrist_force_n: FloatArray  # (n, 3) through the last joint's flange, on all beyond it, in the last link's axes
    wrist_moment_n_m: FloatArray  # (n, 3) about the flange's origin, the same
    torque_n_m: FloatArray  # (n, 5) of the joints' drives
    wheel_rad_s: FloatArray  # (n, w) of the reaction wheels against the base


class CaptureJump(NamedTuple):
    """Step changes at a capture, in the IMU's axes and the last link's."""

    velocity_m_s: FloatArray  # (3,) of the IMU
    rate_rad_s: FloatArray  # (3,) of the base, IMU axes
    wrist_impulse_n_s: FloatArray  # (3,) impulse through the last joint's flange, on everything beyond it
    wrist_moment_n_m_s: FloatArray  # (3,) about its origin


def _numbers(values: Sequence[float] | FloatArray) -> str:
    return " ".join(repr(float(v)) for v in values)


def _inertial(body: Body) -> str:
    i = body.inertia_kg_m2
    tensor = _numbers([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])
    place = _numbers(body.centre_of_mass_m)
    return f'<inertial pos="{place}" mass="{body.mass_kg!r}" fullinertia="{tensor}"/>'


def body_xml(name: str, body: Body, position_m: Sequence[float] | FloatArray, inside: str = "") -> str:
    """A body in MJCF, its axes those of the one it is in; ``inside`` are its joints, sites and bodies."""
    return f'<body name="{name}" pos="{_numbers(position_m)}">{_inertial(body)}{inside}</body>'


def arm_xml(held: str, arm: Sequence[Body] = ARM, offsets_m: FloatArray = AS_DRAWN) -> str:
    """The five links in MJCF, the first in the base's axes, joints so far off the drawing; ``held`` is in the last."""
    for index in reversed(range(JOINTS)):
        hinge = f'<joint name="joint_{index + 1}" type="hinge" axis="{_numbers(_ARM[index].axis)}"/>'
        held = body_xml(f"link_{index + 1}", arm[index], _ARM[index].position_m + offsets_m[index], hinge + held)
    return held


def world(
    payload: Body | None,
    base: Body = BASE,
    arm: Sequence[Body] = ARM,
    step_s: float = 2e-3,
    offsets_m: FloatArray = AS_DRAWN,
    wheels: Sequence[Wheel] = (),
) -> mujoco.MjModel:
    """MuJoCo model of the vehicle: a free base with its wheels, five hinges, the payload welded to the last link."""
    held = "" if payload is None else body_xml("payload", payload, GRASP_m)
    inner = arm_xml(f'<site name="wrist"/>{held}', arm, offsets_m)
    for wheel in wheels:  # after the arm, so that the joints' places among the degrees of freedom do not change
        hinge = f'<joint name="{wheel.name}" type="hinge" axis="{_numbers(wheel.axis)}"/>'
        inner += body_xml(wheel.name, wheel.body, wheel.position_m, hinge)
    site = f'<site name="imu" pos="{_numbers(IMU_POSITION_m)}" quat="{_numbers(IMU_QUATERNION)}"/>'
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" boundmass="0" boundinertia="0"/>'
        f'<option gravity="0 0 0" integrator="RK4" timestep="{step_s!r}"><flag contact="disable"/></option>'
        f'<worldbody><body name="base"><freejoint/>{_inertial(base)}{site}{inner}</body></worldbody>'
        '<sensor><gyro site="imu"/><accelerometer site="imu"/><force site="wrist"/><torque site="wrist"/></sensor>'
        "</mujoco>"
    )


def fly(
    model: mujoco.MjModel, motion: JointPath, rate_rad_s: Sequence[float] | FloatArray, duration_s: float
) -> FreeFlightSignals:
    """One flight: released with an initial rate of the base, then the arm moves.

    Args:
        model: from :func:`world`.
        motion: of the joints.
        rate_rad_s: of the base at the start, base axes, (3,).
        duration_s: of the flight; samples at the model's step.
    """
    return _advance(model, _released(model, motion, rate_rad_s), motion, 0, round(duration_s / model.opt.timestep))


class FreeFlight:
    """A flight computed in chunks, with capture and release of a payload.

    A capture is plastic: from one sample to the next the payload is welded to the gripper, the total linear and angular
        momentum is conserved, and the joints continue as prescribed. The velocity that the
    IMU gains in it is in the specific force of that sample, as a mean over it.

    Args:
        motion: of the joints, in the time of the flight.
        rate_rad_s: of the base at the start, base axes, (3,).
        payload: held from the start, if any.
        base: of the vehicle.
        arm: its five links.
        step_s: between samples.
        actuators: of the base.

    Attributes:
        payload: what is held now.
        step_s: between samples.
        model: MuJoCo's, of what flies now.
        data: its state at the newest sample.
        impulse_m_s: velocity that the IMU gained in a capture since then, IMU axes (3,).
    """

    def __init__(
        self,
        motion: JointPath,
        rate_rad_s: Sequence[float] | FloatArray,
        payload: Body | None = None,
        base: Body = BASE,
        arm: Sequence[Body] = ARM,
        step_s: float = 2e-3,
        actuators: Actuators = NO_ACTUATORS,
    ) -> None:
        self._motion, self._base, self._arm, self._actuators = motion, base, arm, actuators
        self.payload, self.step_s = payload, step_s
        self.model = world(payload, base, arm, step_s, wheels=actuators.wheels)
        self.data = _released(self.model, motion, rate_rad_s)
        actuators.spin_up(self.model, self.data)
        self._samples = 0
        self.impulse_m_s = np.zeros(3)
        self._flown: list[FreeFlightSignals] = []

    @property
    def time_s(self) -> float:
        """Of the next sample."""
        return self._samples * self.step_s

    @property
    def history(self) -> FreeFlightSignals:
        """All samples so far."""
        return FreeFlightSignals(*(np.concatenate(parts) for parts in zip(*self._flown, strict=True)))

    def advance(self, samples: int) -> FreeFlightSignals:
        """The next ``samples`` samples, one or more."""
        flown = _advance(self.model, self.data, self._motion, self._samples, samples, self._actuators)
        flown.specific_force_m_s2[0] += self.impulse_m_s / self.step_s
        self.impulse_m_s = np.zeros(3)
        self._samples += samples
        self._flown.append(flown)
        return flown

    def capture(
        self, payload: Body, velocity_m_s: Sequence[float] | FloatArray, rate_rad_s: Sequence[float] | FloatArray
    ) -> CaptureJump:
        """Capture a payload at the gripper.

        Args:
            payload: in the grasp frame.
            velocity_m_s: of the payload's frame, relative to the gripper just before, base axes, (3,).
            rate_rad_s: of the payload, the same.

        Returns:
            The step changes; the velocity step of the IMU is in its next sample.

        Raises:
            ValueError: a payload is held already.
        """
        if self.payload is not None:
            raise ValueError("a payload is held already; release it first")
        mujoco.mj_forward(self.model, self.data)
        momentum = _mass_matrix(self.model, self.data)[:6] @ self.data.qvel  # linear: world; angular: base, its axes
        model, data = self._swap(payload)
        R_WB, held = data.body("base").xmat.reshape(3, 3), data.body("payload")
        R_WP, origin, centre = held.xmat.reshape(3, 3), held.xpos, held.xipos
        gripper = np.zeros(6)  # rate, velocity
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, held.id, gripper, 0)
        rate = gripper[:3] + R_WB @ np.asarray(rate_rad_s, np.float64)
        velocity = gripper[3:] + R_WB @ np.asarray(velocity_m_s, np.float64)
        linear = payload.mass_kg * (velocity + np.cross(rate, centre - origin))
        spin = R_WP @ payload.inertia_kg_m2 @ R_WP.T @ rate
        wrist = data.site("wrist").xpos
        before = _momentum(model, data, "link_5", wrist)
        before += np.concatenate([linear, spin + np.cross(centre - wrist, linear)])
        momentum[:3] += linear
        momentum[3:] += R_WB.T @ (spin + np.cross(centre - data.body("base").xpos, linear))
        M = _mass_matrix(model, data)
        twist = np.linalg.solve(M[:6, :6], momentum - M[:6, 6:] @ data.qvel[6:])
        jump = twist - data.qvel[:6]
        imu = data.site("imu")
        swing = R_WB @ np.cross(jump[3:], IMU_POSITION_m)
        self.impulse_m_s = imu.xmat.reshape(3, 3).T @ (jump[:3] + swing)
        data.qvel[:6] = twist
        mujoco.mj_forward(model, data)
        through = _momentum(model, data, "link_5", wrist) + _momentum(model, data, "payload", wrist) - before
        force, moment = through.reshape(2, 3) @ data.site("wrist").xmat.reshape(3, 3)
        return CaptureJump(self.impulse_m_s, imu.xmat.reshape(3, 3).T @ R_WB @ jump[3:], force, moment)

    def release(self) -> None:
        """Release the payload without an impulse.

        Raises:
            ValueError: nothing is held.
        """
        if self.payload is None:
            raise ValueError("nothing is held; capture something first")
        self._swap(None)

    def _swap(self, payload: Body | None) -> tuple[mujoco.MjModel, mujoco.MjData]:
        before = self.data
        self.payload = payload
        self.model = world(payload, self._base, self._arm, self.step_s, wheels=self._actuators.wheels)
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:], self.data.qvel[:] = before.qpos, before.qvel
        mujoco.mj_forward(self.model, self.data)
        return self.model, self.data


class Capture(NamedTuple):
    """A payload captured in flight and its relative motion; see :meth:`FreeFlight.capture`."""

    payload: Body
    time_s: float
    velocity_m_s: FloatArray  # (3,) relative to the gripper, base axes
    rate_rad_s: FloatArray  # (3,)


def fly_with_capture(flight: FreeFlight, capture: Capture, duration_s: float) -> FreeFlightSignals:
    """Complete a flight to ``duration_s``; the payload is held from the first sample at or after the capture time."""
    flight.advance(int(np.ceil((capture.time_s - flight.time_s) / flight.step_s - 1e-9)))
    flight.capture(capture.payload, capture.velocity_m_s, capture.rate_rad_s)
    flight.advance(round((duration_s - flight.time_s) / flight.step_s))
    return flight.history


def _released(model: mujoco.MjModel, motion: JointPath, rate_rad_s: Sequence[float] | FloatArray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    q, dq, _ = motion.at(np.zeros(1))
    data.qpos[7 : 7 + JOINTS], data.qvel[6 : 6 + JOINTS] = q[0], dq[0]
    data.qvel[3:6] = rate_rad_s
    return data


def _mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    M = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    return M


def _momentum(model: mujoco.MjModel, data: mujoco.MjData, body: str, about: FloatArray) -> FloatArray:
    """Linear momentum of one body and its angular momentum about a point, (6,), world axes."""
    part, own = data.body(body), model.body(body)
    motion = np.zeros(6)  # rate, velocity of the centre of mass
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, part.id, motion, 0)
    axes = part.ximat.reshape(3, 3)
    linear = own.mass * motion[3:]
    return np.concatenate([linear, axes @ (own.inertia * (axes.T @ motion[:3])) + np.cross(part.xipos - about, linear)])


def _advance(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    motion: JointPath,
    first: int,
    samples: int,
    actuators: Actuators = NO_ACTUATORS,
) -> FreeFlightSignals:
    """Samples ``first`` to ``first + samples``; ``data`` is at the first of them, and at the next afterwards."""
    half_s = 0.5 * model.opt.timestep  # the stages of RK4 lie on half steps
    q, dq, ddq = motion.at(half_s * np.arange(2 * first, 2 * (first + samples) + 1))
    data.time = 0.0  # of this chunk
    M, each, told = np.empty((model.nv, model.nv)), np.arange(model.nv), slice(6, 6 + JOINTS)
    free = slice(0, 6) if model.nv == told.stop else np.delete(each, told)  # without a command; views are faster
    blocks = (free, free), (free, told), (told, free), (told, told)
    on_free, between, from_free, on_told = (
        block if isinstance(free, slice) else np.ix_(*(each[part] for part in block)) for block in blocks
    )
    idle = np.zeros(model.nv)[free]
    of_sample: list[FloatArray] = []  # torque of a step's first stage, which has the state of the sample
    angle, rate = data.qpos[7 : 7 + JOINTS], data.qvel[6 : 6 + JOINTS]  # views: MuJoCo writes into them
    bias, passive, applied, sensed = data.qfrc_bias, data.qfrc_passive, data.qfrc_applied, data.sensordata

    def torque(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        stage = round(data.time / half_s)
        acceleration = ddq[stage] + (_STIFFNESS * (q[stage] - angle) + _DAMPING * (dq[stage] - rate))
        mujoco.mj_fullM(model, data, M)
        acting = actuators.forces(model, data, (2 * first + stage) * half_s)[free] if actuators.any else idle
        force = bias - passive
        others = np.linalg.solve(M[on_free], acting - force[free] - M[between] @ acceleration)
        applied[free] = acting
        applied[told] = force[told] + M[from_free] @ others + M[on_told] @ acceleration
        if not of_sample:
            of_sample.append(applied[told].copy())

    widths = 1, JOINTS, JOINTS, 3, 3, 3, 3, JOINTS, len(actuators.wheels)
    flight = FreeFlightSignals(*(np.empty((samples, width)) for width in widths))
    mujoco.set_mjcb_control(torque)
    try:
        mujoco.mj_forward(model, data)  # the torque of the first sample
        for k in range(samples):
            flight.q_rad[k], flight.dq_rad_s[k] = angle, rate
            flight.wheel_rad_s[k] = actuators.rates(model, data)
            of_sample.clear()
            mujoco.mj_step(model, data)  # its sensors are those of the state before the step
            flight.torque_n_m[k] = of_sample[0]
            for sensor, rows in enumerate(flight[3:7]):
                rows[k] = sensed[3 * sensor : 3 * sensor + 3]
    finally:
        mujoco.set_mjcb_control(None)
    return flight._replace(time_s=model.opt.timestep * np.arange(first, first + samples))
