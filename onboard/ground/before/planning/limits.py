"""What a planned motion must keep: range, speed and effort of the joints, the base's motion, and clearances.

The URDF gives range, speed and effort of each joint; a file of limits says more. Each limit becomes an excess at each
tick: 0 where it is reached, positive where it is broken, 1 where it is broken by as much again.
"""

from itertools import combinations
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import pinocchio as pin
from pydantic import Field
from scipy.spatial.transform import Rotation

from onboard import config
from onboard.config import text
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.errors import UnknownFrameError
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.vehicle import FREE_FLYER_NV, VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.regressor.rows import BaseMotion
from onboard.section import Positive, Real, Section, Vector3

_REACH = 1.0, 0.2  # rad, m: way to either side of a joint that turns freely, or far
_RATE = 1.0, 0.1  # rad/s, m/s: of a joint whose URDF gives no speed
_TIME_TO_SPEED_s = 0.5  # the acceleration that is allowed where no other is given


class JointLimit(Section):
    """``[joint.NAME]``: in place of what the URDF says. rad or m; ``effort`` N m or N."""

    low: Real | None = None
    high: Real | None = None
    rate: Positive | None = None
    acceleration: Positive | None = None
    effort: Positive | None = None


class Sphere(Section):
    """``[[sphere]]`` about a point fixed in a frame: spheres on different bodies do not touch, but neighbours' may."""

    frame: str
    at_m: Vector3 = (0.0, 0.0, 0.0)
    radius_m: Positive


class LimitsFile(Section):
    """A file of limits. ``share``: of each of the URDF's limits that is used; those stated here are used whole."""

    share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.9
    base_rate_rad_s: Positive | None = None
    base_turn_rad: Positive | None = None
    joint: dict[str, JointLimit] = Field(default_factory=dict)
    sphere: list[Sphere] = Field(default_factory=list)


def read(path: Path) -> LimitsFile:
    """Read a file of limits.

    Raises:
        ConfigError: it cannot be read or used.
    """
    said = text.read(path, "a file of limits")
    return config.validated(LimitsFile, text.tree_of(said, str(path)), config.Origin(str(path), said))


class _Place(NamedTuple):
    body: int  # of Pinocchio: the joint that moves it
    at: FloatArray  # (3,) in the axes of that
    radius_m: float


class MotionLimits:
    """Limits of a vehicle's motion with a payload.

    Args:
        model: of the vehicle.
        said: by the file of limits.
        payload: that is held.

    Attributes:
        low, high: of the joints' angles, (joints,).
        joints: their names.
        names: of the limits, in the order of :meth:`excess`.

    Raises:
        ConfigError: a joint or frame that the vehicle does not have, or limits that leave no room.
    """

    def __init__(self, model: VehicleModel, said: LimitsFile, payload: RigidBody | None) -> None:
        names = [joint.name for joint in model.joints]
        unknown = sorted(said.joint.keys() - set(names))
        if unknown:
            raise config.ConfigError(f"limits of joint {', '.join(unknown)}; the joints are {', '.join(names)}")
        told = [said.joint.get(name, JointLimit()) for name in names]
        slides = np.array([not joint.revolute for joint in model.joints], np.intp)
        at = [joint.v_index for joint in model.joints]
        speed, effort = model.model.velocityLimit[at], model.model.effortLimit[at]
        speed = np.where((speed > 0.0) & (speed < 1e6), said.share * speed, np.array(_RATE)[slides])
        effort = np.where(effort > 0.0, said.share * effort, np.inf)
        self._slides, self.joints = slides, tuple(names)
        self.low, self.high = _ranges(model, told, said.share)
        self.rate = np.array([t.rate or float(v) for t, v in zip(told, speed, strict=True)])
        self.acceleration = np.array(
            [t.acceleration or float(v) / _TIME_TO_SPEED_s for t, v in zip(told, self.rate, strict=True)]
        )
        self.effort = np.array([t.effort or float(v) for t, v in zip(told, effort, strict=True)])
        self._base = said.base_rate_rad_s, said.base_turn_rad
        chi = model.chi.copy()
        if payload is not None:
            chi[model.payload_columns()] = standard_of(payload)
        self._arm = FloatingArm(model, model.spec.payload_link or model.links[-1], chi)
        self._velocities = at
        self._pairs = self._clearances(model, said.sphere)
        self.names = (
            *(f"{name} {what}" for what in ("rate", "acceleration", "effort") for name in names),
            *(what for what, limit in zip(("base's rate", "base's turn"), self._base, strict=True) if limit),
            *(f"clearance {k + 1}" for k in range(len(self._pairs))),
        )

    def room(self, posture: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far each joint may go to either side of a posture: (low, high), rad or m.

        Raises:
            ConfigError: a joint is beyond its limits there.
        """
        low, high = self.low - posture, self.high - posture
        if (low >= high).any():
            k = int(np.flatnonzero(low >= high)[0])
            raise config.ConfigError(
                f"limits of {self.joints[k]}: low {self.low[k]:.3g} is not below {self.high[k]:.3g}"
            )
        if (low >= 0.0).any() or (high <= 0.0).any():
            k = int(np.flatnonzero((low >= 0.0) | (high <= 0.0))[0])
            raise config.ConfigError(
                f"{self.joints[k]} starts at {posture[k]:.3g}, its limits are {self.low[k]:.3g} to {self.high[k]:.3g}"
                "; widen them, or give another [motion.posture] in the scenario"
            )
        reach = np.array(_REACH)[self._slides]
        return np.maximum(low, -reach), np.minimum(high, reach)

    def excess(self, moved: FloatArray, base: BaseMotion, period_s: float) -> FloatArray:
        """Of each limit at each tick, (n, limits).

        Args:
            moved: angle, rate and acceleration, (3, n, joints).
            base: its motion at these ticks.
            period_s: between ticks.
        """
        q, dq, ddq = moved
        with np.errstate(invalid="ignore"):
            columns = [np.abs(dq) / self.rate - 1.0, np.abs(ddq) / self.acceleration - 1.0]
            columns.append(np.abs(self._torque(q, dq, ddq, base)) / self.effort - 1.0)
        rate, turn = self._base
        if rate is not None:
            columns.append(np.linalg.norm(base.rate_rad_s, axis=1, keepdims=True) / rate - 1.0)
        if turn is not None:
            columns.append(_turned(base.rate_rad_s, period_s)[:, None] / turn - 1.0)
        if self._pairs:
            columns.append(self._closeness(q))
        return np.concatenate(columns, axis=1)

    def _torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray, base: BaseMotion) -> FloatArray:
        """Of the joints' actuators without friction, (n, joints): the base at rest for the instant (Galileo)."""
        out = np.zeros_like(q)
        if not np.isfinite(self.effort).any():
            return out
        nu, acceleration = np.zeros(self._arm.model.nv), np.zeros(self._arm.model.nv)
        for k in range(len(q)):
            nu[3:FREE_FLYER_NV], nu[FREE_FLYER_NV:] = base.rate_rad_s[k], dq[k]
            acceleration[:3], acceleration[3:FREE_FLYER_NV] = base.specific_force_m_s2[k], base.acceleration_rad_s2[k]
            acceleration[FREE_FLYER_NV:] = ddq[k]
            out[k] = self._arm.inverse_dynamics(self._arm.configuration(q[k]), nu, acceleration)[self._velocities]
        return out

    def _clearances(self, model: VehicleModel, spheres: list[Sphere]) -> list[tuple[_Place, _Place]]:
        """Pairs of spheres on bodies that are not joined by one joint."""
        places = []
        for sphere in spheres:
            try:
                frame = model.model.frames[model.frame_id(sphere.frame)]
            except UnknownFrameError as error:
                raise config.ConfigError(f"sphere: {error}") from error
            at = np.asarray(frame.placement.act(np.array(sphere.at_m)), np.float64)
            places.append(_Place(int(frame.parentJoint), at, sphere.radius_m))
        parents = model.model.parents
        return [
            (a, b)
            for a, b in combinations(places, 2)
            if a.body != b.body and parents[a.body] != b.body and parents[b.body] != a.body
        ]

    def _closeness(self, q: FloatArray) -> FloatArray:
        """Of each pair, (n, pairs): 0 where the spheres touch, 1 where their centres meet."""
        model, data, out = self._arm.model, self._arm.model.createData(), np.zeros((len(q), len(self._pairs)))
        for tick, own in enumerate(q):
            pin.forwardKinematics(model, data, self._arm.configuration(own))
            for k, (a, b) in enumerate(self._pairs):
                gap = data.oMi[a.body].act(a.at) - data.oMi[b.body].act(b.at)
                out[tick, k] = 1.0 - np.linalg.norm(gap) / (a.radius_m + b.radius_m)
        return out


def _ranges(model: VehicleModel, told: list[JointLimit], share: float) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest angle of each joint: the URDF's, as much nearer to its middle, or as stated."""
    low, high = [], []
    for joint, own in zip(model.joints, told, strict=True):
        bounded = np.isfinite(joint.low) and np.isfinite(joint.high)
        middle, half = (
            (0.5 * (joint.low + joint.high), 0.5 * share * (joint.high - joint.low)) if bounded else (0, np.inf)
        )
        low.append(middle - half if own.low is None else own.low)
        high.append(middle + half if own.high is None else own.high)
    return np.array(low, np.float64), np.array(high, np.float64)


def _turned(rate: FloatArray, period_s: float) -> FloatArray:
    """Angle by which the base has turned since the first tick, (n,), rad; rate in its axes, (n, 3)."""
    steps = Rotation.from_rotvec(0.5 * period_s * (rate[:-1] + rate[1:]))
    out, at = np.zeros(len(rate)), Rotation.identity()
    for k in range(len(rate) - 1):
        at = at * steps[k]
        out[k + 1] = at.magnitude()
    return out
