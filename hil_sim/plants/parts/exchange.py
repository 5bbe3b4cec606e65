"""Momentum that a vehicle and a payload exchange when one catches, or lets go of, the other."""

from typing import NamedTuple

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants.body import Solid
from hil_sim.plants.urdf_model import Places, UrdfModel


class Jolt(NamedTuple):
    """What jumps between two rows: velocities gained and impulses felt, in the axes of the sensors."""

    sensors: FloatArray  # (s,) accelerometers: velocity gained; force and torque: impulse; gyros: nothing
    torques: FloatArray  # (j,) impulse


class Released(NamedTuple):
    """A payload that comes, or goes; its motion relative to its link just before, in the axes of the link."""

    payload: Solid
    velocity_m_s: FloatArray  # (3,)
    rate_rad_s: FloatArray  # (3,)


class Moving(NamedTuple):
    """A payload beside its link: where its centre of mass is, and its momentum; world axes."""

    at_m: FloatArray  # (3,)
    linear_kg_m_s: FloatArray  # (3,)
    angular_kg_m2_s: FloatArray  # (3,) about its centre of mass


class Momenta:
    """Velocities and momenta of a vehicle in the state that ``data`` shows.

    Args:
        vehicle: the model.
        data: its state.
        places: where it is measured.
    """

    def __init__(self, vehicle: UrdfModel, data: mujoco.MjData, places: Places) -> None:
        self._vehicle, self._model, self._data, self._places = vehicle, vehicle.model, data, places

    def whole(self) -> FloatArray:
        """Generalised momentum of the vehicle, (v,)."""
        out = np.zeros(self._model.nv)
        mujoco.mj_mulM(self._model, self._data, out, self._data.qvel)
        return out

    def twist(self, body: int) -> tuple[FloatArray, FloatArray]:
        """Rate of a link and velocity of its frame, world axes, (3,) each."""
        out = np.zeros(6)
        mujoco.mj_objectVelocity(self._model, self._data, mujoco.mjtObj.mjOBJ_XBODY, body, out, 0)
        return out[:3], out[3:]

    def outside(self, body: int, moves: Released) -> Moving:
        """Of a payload that stands where its link holds it, and moves against it."""
        R, origin = self._data.xmat[body].reshape(3, 3), self._data.xpos[body]
        rate, velocity = self.twist(body)
        rate, velocity = rate + R @ moves.rate_rad_s, velocity + R @ moves.velocity_m_s
        arm, payload = R @ moves.payload.centre_of_mass_m, moves.payload
        linear = payload.mass_kg * (velocity + np.cross(rate, arm))
        return Moving(origin + arm, linear, R @ payload.inertia_kg_m2 @ R.T @ rate)

    def generalised(self, body: int, at_m: FloatArray, linear: FloatArray, angular: FloatArray) -> FloatArray:
        """Generalised force of a force at a place of a link and of a torque, or momentum of momenta, (v,)."""
        return np.asarray(np.concatenate([linear, angular]) @ self.jacobian(body, at_m))

    def jacobian(self, body: int, at_m: FloatArray) -> FloatArray:
        """Velocity of a place of a link and its rate by generalised velocities, (6, v); world axes."""
        J = np.zeros((6, self._model.nv))
        mujoco.mj_jac(self._model, self._data, J[:3], J[3:], at_m, body)
        return J

    def of_imus(self) -> FloatArray:
        """Velocities of the IMUs, their axes, (imus, 3)."""
        found = np.zeros((len(self._places.imus), 3))
        twist = np.zeros(6)
        for row, link in zip(found, self._places.imus, strict=True):
            site = self._model.site(f"at {link}").id
            mujoco.mj_objectVelocity(self._model, self._data, mujoco.mjtObj.mjOBJ_SITE, site, twist, 1)
            row[:] = twist[3:]
        return found

    def beyond_cells(self) -> list[tuple[FloatArray, FloatArray]]:
        """Linear momentum beyond each cell and angular momentum about it, world axes."""
        return [self._beyond(link) for link in self._places.cells]

    def _beyond(self, link: str) -> tuple[FloatArray, FloatArray]:
        data, about, linear, angular = self._data, self._data.site(f"at {link}").xpos, np.zeros(3), np.zeros(3)
        motion = np.zeros(6)  # rate, velocity of the centre of mass
        for body in self._vehicle.beyond(link):
            mujoco.mj_objectVelocity(self._model, data, mujoco.mjtObj.mjOBJ_BODY, body, motion, 0)
            axes = data.ximat[body].reshape(3, 3)
            p = self._model.body_mass[body] * motion[3:]
            linear += p
            angular += axes @ (self._model.body_inertia[body] * (axes.T @ motion[:3]))
            angular += np.cross(data.xipos[body] - about, p)
        return linear, angular

    def felt(
        self, seen: FloatArray, parts: list[tuple[FloatArray, FloatArray]], body: int, came: Moving, sign: float
    ) -> FloatArray:
        """What jumped at the sensors, (s,).

        Args:
            seen: ``of_imus`` before.
            parts: ``beyond_cells`` before.
            body: the link that has caught the payload, or let it go.
            came: the payload before it was caught, or after it was let go.
            sign: 1 of a capture, -1 of a release.
        """
        sensors = np.zeros(self._model.nsensordata)
        for link, gained in zip(self._places.imus, self.of_imus() - seen, strict=True):
            sensors[self._vehicle.sensor("accelerometer", link)] = gained
        at, p, L = came
        for link, after, before in zip(self._places.cells, self.beyond_cells(), parts, strict=True):
            site = self._data.site(f"at {link}")
            linear, angular = after[0] - before[0], after[1] - before[1]
            if body in self._vehicle.beyond(link):
                linear, angular = linear - sign * p, angular - sign * (L + np.cross(at - site.xpos, p))
            R = site.xmat.reshape(3, 3)
            sensors[self._vehicle.sensor("force", link)] = linear @ R
            sensors[self._vehicle.sensor("torque", link)] = angular @ R
        return sensors
