"""Flight of a vehicle whose joints are driven by servos, on a base that is prescribed or stands: MuJoCo integrates it.

A prescribed base is a free body of a million times the arm's mass (its inertia isotropic, so without a gyroscopic
moment of its own), driven at every step by the force of the prescribed acceleration. The arm's reaction disturbs it by
a millionth; at every chunk it is put back to the path. Joints, links and sensors feel its motion through MuJoCo's
equations.

Integration is MuJoCo's semi-implicit Euler with implicit damping off, so that the reported acceleration is that of the
joint: ``(q[k+1] - 2 q[k] + q[k-1]) / h^2 = qacc[k]``. Velocities then belong to half steps, ``t_k - h/2``: what gyros
show is half a step late.

Friction, ripple, rotor and servo act on a joint, before a load cell in it; stops, drag and the spring of an ejection
act on the link beyond. Left out: the compliance of gears and cells, and the rotors' reaction on the base. Known limit:
forces that depend on where the joints are (drag, ripple, feed-forward) extrapolate it within a chunk.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco import rollout

from hil_sim.arrays import FloatArray, cross
from hil_sim.plants.body import Solid
from hil_sim.plants.drives.servos import Servo, install, of_all, stiffen
from hil_sim.plants.motions.carrier import CarrierMaker, turned
from hil_sim.plants.parts.exchange import Jolt, Momenta, Released
from hil_sim.plants.urdf_model import Places, UrdfModel
from hil_sim.plants.vehicle_flight import FlownJoints, Rows
from hil_sim.scenario.part_tables import DragTable, StopTable

_HEAVIER = 1e6  # times the arm's mass, and at least so many kg, is a prescribed base
_CONTROL = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED | mujoco.mjtState.mjSTATE_XFRC_APPLIED
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_NEAR_rad = 1e-4  # before a stop, from where contacts are looked for
_SLOW_rad_s = 0.01  # of the friction's feed-forward


class Spring(NamedTuple):
    """What pushes a link while a payload leaves it."""

    first: int  # row
    force: FloatArray  # (n, 3) of the payload's link, in its axes and at its origin


class ServoFlight:
    """A flight computed in chunks; see ``VehicleFlight``.

    Args:
        vehicle: the model, with what ``servos.fit`` adds.
        motion: that is commanded, in the order of the vehicle's joints.
        places: where it is measured.
        link: that holds the payload.
        step_s: between rows.
        chunk: rows after which positions and feed-forward are taken anew.
        far: chunks beyond the next for which the commanded motion is known.
        make: servos by the inertia that each joint turns at the start.
        path: of a prescribed base.
        drag: of the air of the path on links.
        stops: of the joints.

    Attributes:
        spring: of an ejection; None without.
        caught: see ``VehicleFlight``.
    """

    def __init__(
        self,
        vehicle: UrdfModel,
        motion: FlownJoints,
        places: Places,
        link: str | None,
        step_s: float,
        chunk: int,
        far: int,
        make: Callable[[FloatArray], list[Servo]],
        path: CarrierMaker | None = None,
        drag: Sequence[DragTable] = (),
        stops: Sequence[StopTable] = (),
    ) -> None:
        self.vehicle, self._motion, self._link = vehicle, motion, link
        self._h, self._chunk, self._far, self._path, self._stops = step_s, chunk, far, path, tuple(stops)
        self._drag = [
            (vehicle.body(table.link), table.area_m2, 1e-3 * np.asarray(table.centre_of_pressure_mm)) for table in drag
        ]
        self._ahead = 0, (np.zeros((0, 0)), np.zeros((0, 0)))  # row, and what is commanded from it
        self.model, self.data = vehicle.model, mujoco.MjData(vehicle.model)
        self._nb, self._np, self._nj = vehicle.freedom, vehicle.pose, len(vehicle.joints)
        self.count = 0
        self.caught: Solid | None = None
        self.spring: Spring | None = None
        self.momenta = Momenta(vehicle, self.data, places)
        self._inertia = np.zeros((self.model.nv, self.model.nv))
        self._heavy_kg = 0.0  # of a prescribed base
        model = self.model
        model.opt.timestep, model.opt.tolerance = step_s, 1e-15
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        bits = mujoco.mjtDisableBit
        for flag in (bits.mjDSBL_EULERDAMP, bits.mjDSBL_LIMIT):
            model.opt.disableflags |= int(flag)
        for flag in (bits.mjDSBL_ISLAND, bits.mjDSBL_WARMSTART):  # one vehicle is one island; Newton's method is quick
            model.opt.disableflags |= int(flag)
        model.jnt_actfrclimited[:] = 0
        if path is not None:
            root = vehicle.body(vehicle.root)
            self._heavy_kg = _HEAVIER * max(1.0, float(model.body_mass.sum() - model.body_mass[root]))
            vehicle.build({vehicle.root: Solid(self._heavy_kg, np.zeros(3), self._heavy_kg * np.eye(3))})
        q, dq, _ = motion.at(np.zeros(1))
        self._q, self._dq = q[0].copy(), dq[0].copy()
        self._stand()
        self.servos = make(np.diag(self._inertia)[self._nb :])
        self._of_servos = of_all(self.servos)
        install(self.model, self._nb, self.servos)
        stiffen(self.model, self._stops)
        self._layout()
        self._rollout = rollout.Rollout(nthread=0)

    def _layout(self) -> None:
        """Arrays of the size of a chunk, and where what stands in them."""
        model, n = self.model, self._chunk
        self._state = np.zeros((1, mujoco.mj_stateSize(model, _STATE)))
        self._control = np.zeros((1, n, mujoco.mj_stateSize(model, _CONTROL)))
        self._sensors = np.zeros((1, n, model.nsensordata))
        self._states = np.zeros((1, n, self._state.shape[1]))
        self._q_at = slice(1 + self._np, 1 + model.nq)
        self._v_at = slice(1 + model.nq + self._nb, 1 + model.nq + model.nv)
        self._torques_at = [int(model.sensor(f"torque of {name}").adr[0]) for name in self.vehicle.joints]
        later: FloatArray = self._h * np.arange(n, dtype=np.float64)
        self._later = later[:, None]
        self._powers = np.column_stack([np.ones(n), later, 0.5 * later**2])
        self._lever_of = np.zeros((3, 3))  # a place about a centre of mass, and its derivatives
        found = [(np.deg2rad(stop.at_deg), 1.0 if stop.end == "upper" else -1.0) for stop in self._stops]
        self._ends = np.array(found).reshape(-1, 2).T  # angle, and 1 of an upper one, -1 of a lower one
        self._stopped = [self.vehicle.joints.index(stop.joint) for stop in self._stops]
        self._falls = bool(model.opt.gravity.any())

    def _stand(self) -> None:
        """Pose and velocity of the row at which the vehicle stands, and its inertia matrix."""
        data, nb = self.data, self._nb
        if self._path is not None:
            now = self._path.rows(self.count, self.count + 1)
            data.qpos[: self._np], data.qvel[:nb] = now.pose[0], now.before[0]
        data.qpos[self._np :], data.qvel[nb:] = self._q, self._dq
        mujoco.mj_fwdPosition(self.model, data)
        mujoco.mj_fwdVelocity(self.model, data)
        mujoco.mj_fullM(self.model, data, self._inertia)

    def advance(self, out: Rows) -> None:
        """Fill the next rows; the vehicle then stands at the row after them."""
        rows, done = len(out.sensors), 0
        while done < rows:
            n = min(self._chunk - self.count % self._chunk, rows - done)
            self._run(out, slice(done, done + n))
            done += n

    def _run(self, out: Rows, at: slice) -> None:
        n = at.stop - at.start
        self._stand()
        mujoco.mj_getState(self.model, self.data, self._state[0], _STATE)
        control, sensors, states = self._control[:, :n], self._sensors[:, :n], self._states[:, :n]
        self._command(control[0])
        touches = self._touches(self._q)
        self._roll(control, sensors, states, touches)
        if not touches and self._touches(states[0, :, self._q_at]):
            self._roll(control, sensors, states, True)
        after, joints, rates = states[0], out.joints[at], out.rates[at]
        out.sensors[at], out.torques[at] = sensors[0], sensors[0, :, self._torques_at].T
        joints[0], joints[1:] = self._q, after[:-1, self._q_at]
        rates[0], rates[1:] = self._dq, after[:-1, self._v_at]
        rates += after[:, self._v_at]
        rates *= 0.5
        self._q, self._dq = after[-1, self._q_at].copy(), after[-1, self._v_at].copy()
        self.count += n

    def _touches(self, q: FloatArray) -> bool:
        """Whether a joint reaches a stop at angles (..., j)."""
        return bool((self._ends[1] * (q[..., self._stopped] - self._ends[0]) > -_NEAR_rad).any())

    def _roll(self, control: FloatArray, sensors: FloatArray, states: FloatArray, touches: bool) -> None:
        """Integrate a chunk from the state; contacts are looked for where a stop is reached."""
        no_contact = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self.model.opt.disableflags &= ~no_contact
        if not touches:
            self.model.opt.disableflags |= no_contact
        told = {"control_spec": int(_CONTROL), "skip_checks": True, "nstep": control.shape[1]}
        at = [self.model], [self.data], self._state, control
        self._rollout.rollout(*at, **told, state=states, sensordata=sensors)

    def _command(self, control: FloatArray) -> None:
        """Set-points, forces on base and joints, loads on links, for a chunk (n, ...)."""
        n, nu, nv, nb = len(control), self._nj, self.model.nv, self._nb
        target, ddq = self._wanted(n)
        of = self._of_servos
        control[:, :nu] = target + ddq @ (self._inertia[nb:, nb:] / of.stiffness)  # rotors included
        if self._falls:
            control[:, :nu] += self._against_gravity() / of.stiffness
        ahead = self._q + self._dq * self._later[:n]
        control[:, nu + nb : nu + nv] = of.ripple * np.sin(of.cycles * ahead)
        loads = control[:, nu + nv :].reshape(n, -1, 6)
        loads[:] = 0.0
        if self._path is not None:
            now = self._path.rows(self.count, self.count + n)
            push = self._heavy_kg * now.acceleration
            push[:, :3] -= self._heavy_kg * self.model.opt.gravity
            control[:, nu : nu + 6] = push
            if self._drag:
                self._drags(loads, turned(now.pose[:, 3:], now.wind) * now.pressure_pa[:, None])
        spring = self.spring
        if spring is not None and spring.first < self.count + n and self.count < spring.first + len(spring.force):
            self._springs(loads, spring)

    def _wanted(self, n: int) -> tuple[FloatArray, FloatArray]:
        """Set-points against friction and the loop's damping, accelerations, (n, j) each."""
        first, known = self._ahead
        if not first <= self.count <= self.count + n <= first + len(known[0]):
            rows = self._far * self._chunk + n  # what is asked for later is not known yet
            q, dq, ddq = self._motion.at(self._h * np.arange(self.count, self.count + rows, dtype=np.float64))
            of = self._of_servos
            against = of.viscous * dq + of.dry * np.tanh(dq / _SLOW_rad_s)
            first, known = self.count, (q + against / of.stiffness, ddq)
            self._ahead = first, known
        mine = slice(self.count - first, self.count - first + n)
        return known[0][mine], known[1][mine]

    def _against_gravity(self) -> FloatArray:
        """Torques that hold the joints where they stand, of a controller that knows the vehicle."""
        data, velocity = self.data, self.data.qvel.copy()
        data.qvel[:] = 0.0
        mujoco.mj_fwdVelocity(self.model, data)
        found = data.qfrc_bias[self._nb :].copy()
        data.qvel[:] = velocity
        mujoco.mj_fwdVelocity(self.model, data)
        return np.asarray(found, np.float64)

    def _lever(self, body: int, place_m: FloatArray, n: int) -> FloatArray:
        """From a link's centre of mass to a place of its frame, world axes, as the link turns on, (n, 3)."""
        rate, _ = self.momenta.twist(body)
        place, first, second = self._lever_of
        place[:] = self.data.xmat[body].reshape(3, 3) @ (place_m - self.model.body_ipos[body])
        mujoco.mju_cross(first, rate, place)
        mujoco.mju_cross(second, rate, first)
        return np.asarray(self._powers[:n] @ self._lever_of, np.float64)

    def _drags(self, loads: FloatArray, blown_pa: FloatArray) -> None:
        for body, area_m2, place_m in self._drag:
            force = area_m2 * blown_pa
            lever = self._lever(body, place_m, len(force))
            loads[:, body, :3] += force
            loads[:, body, 3:] += cross(lever, force)

    def _springs(self, loads: FloatArray, spring: Spring) -> None:
        assert self._link is not None
        body, n = self.vehicle.body(self._link), len(loads)
        last = min(self.count + n, spring.first + len(spring.force))
        own = slice(max(self.count, spring.first) - self.count, last - self.count)
        pushed = spring.force[self.count + own.start - spring.first : last - spring.first]
        rate, _ = self.momenta.twist(body)
        t = self._h * np.arange(own.start, own.stop)[:, None]
        force = pushed @ self.data.xmat[body].reshape(3, 3).T
        force = force + cross(np.broadcast_to(rate, force.shape), force) * t  # as the link turns
        loads[own, body, :3] += force
        loads[own, body, 3:] += cross(self._lever(body, np.zeros(3), n)[own], force)

    def happen(self, comes: bool, moves: Released | None, lasts_s: float = 0.0) -> Jolt:
        """Weld a payload to its link, or let one go, between two rows; the joints give way.

        Args:
            comes: it is caught.
            moves: the payload, and its motion against its link.
            lasts_s: for which a spring pushes what goes; 0: it has its velocity at once.
        """
        assert moves is not None
        assert self._link is not None
        if lasts_s > 0.0:
            self.spring = self._half_sine(moves, lasts_s)
            moves = moves._replace(velocity_m_s=np.zeros(3))
        self._stand()
        found, body, sign, nb = self.momenta, self.vehicle.body(self._link), 1.0 if comes else -1.0, self._nb
        self.caught = moves.payload if comes else None
        seen, parts, own = found.of_imus(), found.beyond_cells(), found.outside(body, moves)
        momentum = found.whole() + sign * found.generalised(body, *own)
        self.vehicle.hold(self._link, self.caught)
        stiffen(self.model, self._stops)
        self._stand()
        left = momentum[nb:] - self._inertia[nb:, :nb] @ self.data.qvel[:nb]
        self._dq = np.linalg.solve(self._inertia[nb:, nb:], left)
        self._stand()
        return Jolt(found.felt(seen, parts, body, own, sign), np.zeros(self._nj))

    def approach(self, comes: Released) -> FloatArray:
        """See ``VehicleFlight``."""
        self._stand()
        assert self._link is not None
        body, c = self.vehicle.body(self._link), comes.payload.centre_of_mass_m
        rate, _ = self.momenta.twist(body)
        velocity = comes.velocity_m_s + np.cross(comes.rate_rad_s, c)
        return np.concatenate([velocity, self.data.xmat[body].reshape(3, 3).T @ rate + comes.rate_rad_s])

    def _half_sine(self, goes: Released, lasts_s: float) -> Spring:
        n = max(1, round(lasts_s / self._h))
        shape = np.sin(np.pi * (np.arange(n) + 0.5) / n)
        impulse = -goes.payload.mass_kg * goes.velocity_m_s
        return Spring(self.count, shape[:, None] * impulse / (shape.sum() * self._h))
