"""Flight of a vehicle with commanded joints: MuJoCo's inverse dynamics gives the base's acceleration and all loads.

At a pose, MuJoCo's inverse dynamics with the joints' accelerations and none of the base gives the wrench b that would
keep the base from accelerating; with M the inertia matrix at the base and f the wrench on it from outside, the base
accelerates by ``M^-1 (f - b)``. A Runge-Kutta scheme of fourth order integrates that, its stages on half steps.

A grip that closes at once is plastic: from one row to the next the payload is welded to its link, the momentum of the
whole vehicle is that of before and the payload's together, and the joints continue as commanded. A release is the
reverse. A grip with a contact holds the payload by a spring first (``Contact``).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray, solved
from hil_sim.plants.body import Solid
from hil_sim.plants.motions.attitude import Wheels
from hil_sim.plants.motions.carrier import CarrierMaker
from hil_sim.plants.parts.cabin import Cabin
from hil_sim.plants.parts.coasting import Coasting, Told, mean, moved
from hil_sim.plants.parts.contact import Contact
from hil_sim.plants.parts.exchange import Jolt, Momenta, Released
from hil_sim.plants.parts.jets import Jets
from hil_sim.plants.parts.pucks import Drag, dragged
from hil_sim.plants.parts.soft_parts import SoftParts, bent_inertia, full_inertia
from hil_sim.plants.urdf_model import Places, UrdfModel

_POSES = 64  # of the motion in which springs are checked: its turns are slower than the springs by far
_LATER = int(mujoco.mjtStage.mjSTAGE_VEL)  # stages of inverse dynamics that are done already


class FlownJoints(Protocol):
    """The joints' motion."""

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angle, rate and acceleration at times (n,); (n, joints) each."""


class Rows(NamedTuple):
    """True signals on a grid, (n, ...)."""

    sensors: FloatArray  # (n, s) MuJoCo's, in the order of the model
    joints: FloatArray  # (n, j) rad or m
    rates: FloatArray  # (n, j)
    torques: FloatArray  # (n, j) that the joints' drives exert on what is beyond them, without their own friction


class VehicleFlight:
    """A flight computed in chunks.

    Args:
        vehicle: the model; the payload is welded to it and taken off in flight.
        motion: of the joints, in the order of the vehicle's.
        places: where it is measured.
        link: that holds the payload.
        step_s: between rows.
        velocity: of the base at the start, MuJoCo's numbers; empty where it is fixed or prescribed.
        path: of a prescribed base.
        pucks: of one on a table; or the bearing of one on a pivot.
        cabin: in which it is held, let go and pushed, at half steps.
        soft: its springs; none of a prescribed base.
        jets: thrusters of a free one.
        wheels: that hold its attitude; the others move as commanded.

    Attributes:
        momenta: velocities and momenta of the state in which the vehicle stands.
        contact: by which it holds a payload until the grip closes; None else.
        caught: the payload as the closed grip holds it, in the axes of its link; None where none was caught.
    """

    def __init__(
        self,
        vehicle: UrdfModel,
        motion: FlownJoints,
        places: Places,
        link: str | None,
        step_s: float,
        velocity: FloatArray,
        path: CarrierMaker | None = None,
        pucks: Drag = (),
        cabin: Cabin | None = None,
        soft: SoftParts | None = None,
        jets: Jets | None = None,
        wheels: Wheels | None = None,
    ) -> None:
        self.vehicle, self._motion, self._link = vehicle, motion, link
        self._step_s, self._path, self._pucks = step_s, path, pucks
        self.model, self.data = vehicle.model, mujoco.MjData(vehicle.model)
        self._nb, self._np = vehicle.freedom, vehicle.pose
        position, velocities = self.data.qpos, self.data.qvel
        self._state = position[: self._np], position[self._np :], velocities[: self._nb], velocities[self._nb :]
        self._coasting = Coasting(self.model, self.data, self._np, self._nb)
        self._free = path is None and self._nb > 0
        self._soft = SoftParts(np.zeros(0), 0.0, None) if soft is None else soft
        self._integrated = self._free or soft is not None
        self._inertia = np.zeros((self.model.nv, self.model.nv))
        self._pose = self.data.qpos[: self._np].copy()
        self._velocity = np.zeros(self._nb) if velocity.size == 0 else velocity.copy()
        self._cabin, self._jets, self._wheels = cabin, jets, wheels
        pushed = bool(pucks) or cabin is not None or wheels is not None or (jets is not None and jets.any)
        self._alone = self._free and not pushed and len(self._soft.state) == 0  # but for a contact
        self._spin = np.zeros(0) if wheels is None else wheels.start_rad_s
        if cabin is not None:
            self._pose, self._velocity = cabin.start()
        self.count = 0  # of the next row
        self._soft_rates, self._spin_rates = np.zeros_like(self._soft.state), np.zeros_like(self._spin)
        self.momenta = Momenta(vehicle, self.data, places)
        self.contact: Contact | None = None
        self.caught: Solid | None = None
        self._push = np.zeros(self.model.nv)  # generalised, of the contact's spring on the vehicle
        self._touched_rates = self._touched
        if soft is not None:
            self._start_soft(soft)

    def advance(self, rows: int) -> Rows:
        """The next ``rows`` rows; the vehicle then stands at the row after them."""
        half: FloatArray = 0.5 * self._step_s * np.arange(2 * self.count, 2 * (self.count + rows) + 1, dtype=np.float64)
        q, dq, ddq = self._motion.at(half)
        out = Rows(np.empty((rows, self.model.nsensordata)), *(np.empty((rows, q.shape[1])) for _ in range(3)))
        told = list(zip(q, dq, ddq, strict=True))
        with np.errstate(invalid="raise"):
            for k in range(rows):
                self._show(k, out, *told[2 * k])
                if self._alone and self.contact is None:
                    now = self._pose, self._velocity, told[2 * k : 2 * k + 3]
                    self._pose, self._velocity = self._coasting.step(*now, self._step_s)
                elif self._integrated:
                    self._step(told[2 * k : 2 * k + 3])
                self.count += 1
        return out

    def show(self) -> Rows:
        """The row at which the vehicle stands, without leaving it."""
        q, dq, ddq = self._motion.at(np.array([self._step_s * self.count]))
        out = Rows(np.empty((1, self.model.nsensordata)), *(np.empty((1, q.shape[1])) for _ in range(3)))
        self._show(0, out, q[0], dq[0], ddq[0])
        return out

    def exchange(self, comes: Released | None, goes: Released | None) -> Jolt:
        """Weld a payload to its link, or let one go, between two rows.

        Args:
            comes: what is caught.
            goes: what is let go.
        """
        moves = comes if comes is not None else goes
        assert moves is not None
        assert self._link is not None
        self.show()
        body, found = self._holder, self.momenta
        self.caught = None if comes is None else comes.payload
        seen, parts, own = found.of_imus(), found.beyond_cells(), found.outside(body, moves)
        moving, sign = found.generalised(body, *own), 1.0 if comes is not None else -1.0
        momentum = found.whole() + sign * moving
        self.vehicle.hold(self._link, None if comes is None else comes.payload)
        self._refresh()
        dq = self.data.qvel[self._nb :].copy()
        if self._free:
            M = self._base_inertia()
            self._velocity = np.linalg.solve(M[:, : self._nb], momentum[: self._nb] - M[:, self._nb :] @ dq)
            self._refresh()
        return Jolt(found.felt(seen, parts, body, own, sign), (found.whole() - momentum)[self._nb :])

    def alter(self, payload: Solid) -> None:
        """The payload is another body from here on, and moves as before: a part has come off, or has been added."""
        assert self._link is not None
        self.show()
        self.caught = payload
        self.vehicle.hold(self._link, payload)
        self._refresh()

    def touch(self, comes: Released, frequency_Hz: float, damping_ratio: float) -> None:
        """Take hold of a payload by a spring; ``close`` welds it to its link.

        Args:
            comes: what is caught.
            frequency_Hz: of the payload's motion against the gripper.
            damping_ratio: of that.
        """
        self.show()
        came, (R, _), (rate, _) = self.momenta.outside(self._holder, comes), self.grip(), self.grip_twist()
        J = self.momenta.jacobian(self._holder, came.at_m)
        if self._soft.joints:  # the joints give way too
            mobility = J @ np.linalg.solve(full_inertia(self.model, self.data), J.T)
        else:
            mobility = J[:, : self._nb] @ np.linalg.solve(self._base_inertia()[:, : self._nb], J[:, : self._nb].T)
        spring = comes.payload, frequency_Hz, damping_ratio, np.array(self.model.opt.gravity)
        self.contact = Contact(*spring, R, rate + R @ comes.rate_rad_s, came, mobility)

    def close(self) -> Jolt:
        """Weld the payload that the spring holds to its link, between two rows."""
        assert self.contact is not None
        self.show()
        comes, self.contact = self.contact.released(self.grip(), self.grip_twist()), None
        return self.exchange(comes, None)

    def approach(self, comes: Released) -> FloatArray:
        """Of a payload before it is caught, axes of its link: velocity of its centre of mass there, rate in space."""
        self.show()
        (R, _), (rate, _), c = self.grip(), self.grip_twist(), comes.payload.centre_of_mass_m
        velocity = comes.velocity_m_s + np.cross(comes.rate_rad_s, c)
        return np.concatenate([velocity, R.T @ rate + comes.rate_rad_s])

    @property
    def _holder(self) -> int:
        assert self._link is not None
        return self.vehicle.body(self._link)

    def grip(self) -> tuple[FloatArray, FloatArray]:
        """Rotation of the link that holds the payload, to world axes, and place of its frame."""
        return self.data.xmat[self._holder].reshape(3, 3).copy(), self.data.xpos[self._holder].copy()

    def grip_twist(self) -> tuple[FloatArray, FloatArray]:
        """Rate of that link and velocity of its frame, world axes, (3,) each."""
        return self.momenta.twist(self._holder)

    def _show(self, k: int, out: Rows, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> None:
        data, nb = self.data, self._nb
        if self._path is not None:
            told = self._path.rows(self.count, self.count + 1)
            self._pose, self._velocity = told.pose[0], told.velocity[0]
            self._place(self._pose, self._velocity, q, dq)
            data.qacc[:nb], data.qacc[nb:] = told.acceleration[0], ddq
            mujoco.mj_inverse(self.model, data)
        else:
            dq = self._turned(dq, self._spin)
            now = self._pose, self._velocity, self._soft.state, self._touched
            found = self._accelerate(*now, (q, dq, ddq), 2 * self.count)
            data.qacc[:nb], self._soft_rates, self._spin_rates, self._touched_rates = found
            mujoco.mj_inverseSkip(self.model, data, _LATER, 0)
            data.xfrc_applied[:] = 0.0
        out.sensors[k], out.joints[k], out.rates[k] = data.sensordata, q, dq
        out.torques[k] = data.qfrc_inverse[nb:] - self._push[nb:]

    def _turned(self, dq: FloatArray, spin: FloatArray) -> FloatArray:
        """Rates of the joints, those of the wheels as the attitude control has turned them, (j,)."""
        if self._wheels is None:
            return dq
        rates: FloatArray = dq.copy()
        rates[self._wheels.places] = spin
        return rates

    def _place(self, pose: FloatArray, velocity: FloatArray, q: FloatArray, dq: FloatArray) -> None:
        base, joints, velocities, rates = self._state
        base[:], joints[:], velocities[:], rates[:] = pose, q, velocity, dq

    def _refresh(self) -> None:
        """Everything that depends on pose and velocity anew, after the base's velocity or a body has changed."""
        self.data.qvel[: self._nb] = self._velocity
        mujoco.mj_forward(self.model, self.data)

    def _accelerate(
        self, pose: FloatArray, velocity: FloatArray, soft: FloatArray, touched: FloatArray, told: Told, stage: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Of the base at a half step, (b,), of springs, wheels, contact; leaves the joints' accelerations in place."""
        data, nb, cabin, (q, dq, ddq) = self.data, self._nb, self._cabin, told
        if self._alone and self.contact is None:
            self._push[:] = 0.0
            return self._coasting.accelerate(pose, velocity, told), soft, self._spin, touched
        bends = self._soft.joints > 0
        bend, bending = self._soft.bend(soft) if bends else (0.0, 0.0)
        self._place(pose, velocity, q + bend, dq + bending)
        data.qacc[:nb], data.qacc[nb:] = 0.0, ddq
        mujoco.mj_inverse(self.model, data)
        touching = self._contact_push(touched)
        wrench, pull = self._push[:nb] - data.qfrc_inverse[:nb], np.zeros(3)
        if self._pucks:
            wrench += dragged(self._pucks, pose, velocity)
        if self._soft.slosh is not None:
            pull = self._soft.pull(soft, self._anchor(pose, velocity), level=nb == 3)
            wrench += self._at_base(-pull, soft[-6:-3], pose)
        if self._jets is not None and self._jets.any:
            wrench += self._jets.push(0.5 * self._step_s * stage, self._turn(pose))
        if cabin is not None and not cabin.held(stage):
            wrench += cabin.push(stage)
        held = nb == 0 or (cabin is not None and cabin.held(stage))
        load = (
            self._soft.torque(soft, 0.5 * self._step_s * stage) + self._push[nb:] - data.qfrc_inverse[nb:]
            if bends
            else np.zeros(0)
        )
        M = full_inertia(self.model, data) if bends else np.zeros((0, 0))
        spins = np.zeros(0)
        if held:
            free = np.zeros(nb)
        elif self._wheels is not None:
            places = nb + self._wheels.places
            both = np.concatenate([np.arange(nb), places])
            motors = self._wheels.torque_n_m(pose, velocity) - data.qfrc_inverse[places]
            self._base_inertia()
            found = solved(self._inertia[np.ix_(both, both)], np.concatenate([wrench, motors]))
            free, spins = found[:nb], found[nb:]
            data.qacc[places] = spins
        elif bends:
            free = solved(M, np.concatenate([wrench, load]))[:nb]
        else:
            free = solved(self._base_inertia()[:, :nb], wrench)
        base = free if cabin is None else cabin.acceleration(stage, pose, velocity, free)
        more = solved(M[nb:, nb:], load - M[nb:, :nb] @ base) if bends else np.zeros(0)
        if bends:
            data.qacc[nb:] = ddq + more
        bent = self._soft.rates(soft, more, pull) if len(soft) else soft
        return np.asarray(base, np.float64), bent, spins, touching

    @property
    def _touched(self) -> FloatArray:
        """State of what the contact's spring holds, (13,); empty without."""
        return np.zeros(0) if self.contact is None else self.contact.state

    def _contact_push(self, state: FloatArray) -> FloatArray:
        """The contact's push on the vehicle as MuJoCo's data show it, for what is computed next; rates of its state."""
        contact = self.contact
        if contact is None:
            self._push[:] = 0.0
            return state
        body = self._holder
        force, torque = contact.wrench(state, self.grip(), self.grip_twist())
        self._push = self.momenta.generalised(body, state[:3], -force, -torque)
        about = -torque - np.cross(state[:3] - self.data.xipos[body], force)
        self.data.xfrc_applied[body] = np.concatenate([-force, about])
        return contact.rates(state, force, torque)

    def _start_soft(self, soft: SoftParts) -> None:
        """Springs at rest, in the pose of the first row; checked in the poses of the whole motion."""
        q, dq, _ = self._motion.at(np.zeros(1))
        self._place(self._pose, self._velocity, q[0], dq[0])
        M = bent_inertia(self.model, self.data, self._nb)
        anchor = self._anchor(self._pose, self._velocity) if soft.slosh is not None else (np.zeros(3), np.zeros(3))
        load = self.data.qfrc_inverse[self._nb :] if self.model.opt.gravity.any() else np.zeros(len(M))
        soft.start(np.diag(M).copy(), load, anchor)
        for pose in self._motion.at(np.linspace(0.0, soft.duration_s, _POSES))[0] if soft.joints else ():
            self._state[1][:] = pose
            soft.require(bent_inertia(self.model, self.data, self._nb), self._step_s)

    def _turn(self, pose: FloatArray) -> FloatArray:
        """Rotation from the base's axes to the world's, (3, 3)."""
        if self._np == 3:
            c, s = math.cos(pose[2]), math.sin(pose[2])
            return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        out = np.zeros(9)
        mujoco.mju_quat2Mat(out, pose[-4:])
        return out.reshape(3, 3)

    def _anchor(self, pose: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Place and velocity of the anchor of what swings, world axes."""
        assert self._soft.slosh is not None
        R = self._turn(pose)
        r = R @ self._soft.slosh.anchor_m
        if self._nb == 3:
            at, v, w = np.zeros((3, 3))
            at[:2], v[:2], w[2] = pose[:2], velocity[:2], velocity[2]
        else:
            at, v, w = pose[:3], velocity[:3], R @ velocity[3:]
        return at + r, v + np.cross(w, r)

    def _at_base(self, force_n: FloatArray, at_m: FloatArray, pose: FloatArray) -> FloatArray:
        """Generalised force on the base of a force at a place, world axes, (b,)."""
        if self._nb == 3:
            dx, dy = at_m[:2] - pose[:2]
            return np.array([force_n[0], force_n[1], dx * force_n[1] - dy * force_n[0]])
        moment = self._turn(pose).T @ np.cross(at_m - pose[:3], force_n)
        return np.concatenate([force_n, moment])

    def _base_inertia(self) -> FloatArray:
        """Rows of the inertia matrix at the base, (b, v)."""
        mujoco.mj_fullM(self.model, self.data, self._inertia)
        return self._inertia[: self._nb]

    def _step(self, told: Sequence[Told]) -> None:
        """One Runge-Kutta step; joints at its start, middle and end: angles, rates, accelerations."""
        h, v, y = self._step_s, self._velocity, self._soft.state
        rates: list[FloatArray] = [v]
        forces = [self.data.qacc[: self._nb].copy()]  # as _show left it
        soft, spin, z, touched = [self._soft_rates], [self._spin_rates], self._touched, [self._touched_rates]
        for stage, part in ((1, 0.5), (1, 0.5), (2, 1.0)):
            pose = moved(self._pose, rates[-1], part * h)
            velocity = v + part * h * forces[-1]
            q, dq, ddq = told[stage]
            rate = dq if self._wheels is None else self._turned(dq, self._spin + part * h * spin[-1])
            springs = y + part * h * soft[-1] if len(y) else y, z + part * h * touched[-1] if len(z) else z
            found = self._accelerate(pose, velocity, *springs, (q, rate, ddq), 2 * self.count + stage)
            for stages, one in zip((forces, soft, spin, touched), found, strict=True):
                stages.append(one)
            rates.append(velocity)
        self._pose = moved(self._pose, mean(rates), h)
        self._velocity = v + h * mean(forces)
        if len(y):
            self._soft.state = y + h * mean(soft)
        if len(self._spin):
            self._spin = self._spin + h * mean(spin)
        if self.contact is not None:
            self.contact.moved(z + h * mean(touched))
