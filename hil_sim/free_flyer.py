"""A free-flyer with a five-joint arm and a payload in free fall, moved by MuJoCo; truth for identification.

Geometry: the ExoSPHERES base (23.1 kg, 0.45 x 0.45 x 0.41 m) with the DYMAFLEX arm (yaw-pitch-roll-pitch-roll,
3.399 kg) of Limparis section 4.3. The dissertation gives neither the lengths of the links nor how the arm's mass is
shared out: those are ours, for a reach of 0.68 m.

The joints follow a prescribed motion. MuJoCo integrates the whole vehicle (RK4); its control callback gives the joint
torques that make the prescribed accelerations at every stage, so there is no zero-order hold and no servo error worth
the name. The base is free: what it does is MuJoCo's answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

JOINTS = 5
_STIFFNESS, _DAMPING = 400.0, 40.0  # 1/s^2, 1/s: pulls back what integration error there is


@dataclass(frozen=True)
class Body:
    """Inertial parameters in the body's own frame."""

    mass_kg: float
    centre_of_mass_m: Floats  # (3,)
    inertia_kg_m2: Floats  # (3, 3) about the centre of mass

    @staticmethod
    def box(mass_kg: float, size_m: Sequence[float], centre_of_mass_m: Sequence[float]) -> "Body":
        """A solid box along the frame's axes."""
        squares = np.square(np.asarray(size_m, np.float64))
        inertia = np.diag(mass_kg / 12.0 * (squares.sum() - squares))
        return Body(mass_kg, np.asarray(centre_of_mass_m, np.float64), inertia)

    def grown(self, mass_kg: float) -> "Body":
        """The same body of the same density, larger or smaller about its frame's origin."""
        factor = (mass_kg / self.mass_kg) ** (1.0 / 3.0)
        return Body(mass_kg, self.centre_of_mass_m * factor, self.inertia_kg_m2 * factor**5)


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
GRASP_m = (0.0, 0.0, 0.090)  # the payload's frame in the last link, axes alike
IMU_POSITION_m, IMU_QUATERNION = (0.120, -0.080, 0.050), (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # x of it along base y


@dataclass(frozen=True)
class JointMotion:
    """``q(t) = q_0 + sum_k a_k (sin(w_k t + p_k) - sin p_k)`` by joint; each array (joints, harmonics)."""

    start_rad: Floats  # (joints,)
    amplitude_rad: Floats
    rate_rad_s: Floats
    phase_rad: Floats

    @staticmethod
    def draw(rng: np.random.Generator, swing_rad: float = 0.35, harmonics: int = 3) -> "JointMotion":
        """An exciting motion: every joint swings with some 0.1 to 0.6 Hz, all at once, no two alike."""
        shape = (JOINTS, harmonics)
        amplitude = swing_rad / np.sqrt(harmonics) * rng.uniform(0.6, 1.2, shape)
        rate = 2.0 * np.pi * rng.uniform(0.1, 0.6, shape)
        start = np.array([0.0, 0.6, 0.0, 0.8, 0.0]) + rng.uniform(-0.3, 0.3, JOINTS)
        return JointMotion(start, amplitude, rate, rng.uniform(0.0, 2.0 * np.pi, shape))

    def at(self, time_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Angle, rate and acceleration at times (n,); (n, joints) each."""
        a, w, p = self.amplitude_rad, self.rate_rad_s, self.phase_rad
        turn = w * time_s[:, None, None] + p
        sine, cosine = np.sin(turn), np.cos(turn)
        q = self.start_rad + (a * (sine - np.sin(p))).sum(axis=2)
        return q, (a * w * cosine).sum(axis=2), -(a * w * w * sine).sum(axis=2)


class Flight(NamedTuple):
    """Truth on the grid of the samples."""

    time_s: Floats  # (n,)
    q_rad: Floats  # (n, 5)
    dq_rad_s: Floats  # (n, 5)
    rate_rad_s: Floats  # (n, 3) of the base, IMU axes
    specific_force_m_s2: Floats  # (n, 3) at the IMU, its axes: a - g, in free fall the acceleration itself


def _numbers(values: Sequence[float] | Floats) -> str:
    return " ".join(repr(float(v)) for v in values)


def _inertial(body: Body) -> str:
    i = body.inertia_kg_m2
    tensor = _numbers([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]])
    place = _numbers(body.centre_of_mass_m)
    return f'<inertial pos="{place}" mass="{body.mass_kg!r}" fullinertia="{tensor}"/>'


def world(payload: Body | None, base: Body = BASE, arm: Sequence[Body] = ARM, step_s: float = 2e-3) -> mujoco.MjModel:
    """The vehicle as MuJoCo has it: a free base, five hinges, the payload welded to the last link."""
    inner = ""
    if payload is not None:
        inner = f'<body name="payload" pos="{_numbers(GRASP_m)}">{_inertial(payload)}</body>'
    for index in reversed(range(JOINTS)):
        mount, number = _ARM[index], index + 1
        inner = (
            f'<body name="link_{number}" pos="{_numbers(mount.position_m)}">'
            f'<joint name="joint_{number}" type="hinge" axis="{_numbers(mount.axis)}"/>'
            f"{_inertial(arm[index])}{inner}</body>"
        )
    site = f'<site name="imu" pos="{_numbers(IMU_POSITION_m)}" quat="{_numbers(IMU_QUATERNION)}"/>'
    return mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian" boundmass="0" boundinertia="0"/>'
        f'<option gravity="0 0 0" integrator="RK4" timestep="{step_s!r}"><flag contact="disable"/></option>'
        f'<worldbody><body name="base"><freejoint/>{_inertial(base)}{site}{inner}</body></worldbody>'
        '<sensor><gyro site="imu"/><accelerometer site="imu"/></sensor></mujoco>'
    )


def fly(model: mujoco.MjModel, motion: JointMotion, rate_rad_s: Sequence[float], duration_s: float) -> Flight:
    """One flight: released with a rate of the base that nobody chose, then the arm moves.

    Args:
        model: from :func:`world`.
        motion: of the joints.
        rate_rad_s: of the base at the start, base axes, (3,).
        duration_s: of the flight; samples at the model's own step.
    """
    data = mujoco.MjData(model)
    samples, half_s = round(duration_s / model.opt.timestep), 0.5 * model.opt.timestep
    q, dq, ddq = motion.at(half_s * np.arange(2 * samples + 1))  # the stages of RK4 lie on half steps
    data.qpos[7:], data.qvel[6:] = q[0], dq[0]
    data.qvel[3:6] = rate_rad_s
    mass_matrix, columns = np.zeros((model.nv, model.nv)), np.eye(model.nv)

    def torque(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        stage = round(data.time / half_s)
        pull = _STIFFNESS * (q[stage] - data.qpos[7:]) + _DAMPING * (dq[stage] - data.qvel[6:])
        acceleration = ddq[stage] + pull
        for row, unit in zip(mass_matrix, columns, strict=True):
            mujoco.mj_mulM(model, data, row, unit)
        base = np.linalg.solve(mass_matrix[:6, :6], -data.qfrc_bias[:6] - mass_matrix[:6, 6:] @ acceleration)
        data.qfrc_applied[6:] = data.qfrc_bias[6:] + mass_matrix[6:, :6] @ base + mass_matrix[6:, 6:] @ acceleration

    flight = Flight(*(np.empty((samples, width)) for width in (1, JOINTS, JOINTS, 3, 3)))
    mujoco.set_mjcb_control(torque)
    try:
        for k in range(samples):
            flight.time_s[k], flight.q_rad[k], flight.dq_rad_s[k] = data.time, data.qpos[7:], data.qvel[6:]
            mujoco.mj_step(model, data)  # its sensors are those of the state before the step
            flight.rate_rad_s[k], flight.specific_force_m_s2[k] = data.sensordata[:3], data.sensordata[3:]
    finally:
        mujoco.set_mjcb_control(None)
    return flight._replace(time_s=flight.time_s[:, 0])
