"""Plant of any vehicle: its URDF as it was built, its base released, held or moved, its commanded joints, its payload.

A mission of some minutes is computed when the plant is created, at steps of a few ms; a longer one, and one where the
flight computer asks for some of the motion, as time advances. The sensors' finer grid is interpolated by splines,
separately between captures and releases; a jolt is in one row of that grid, as its mean. Rows are released in chunks as
time advances, so no sensor reads future rows. Of a long mission only what is read is kept.
"""

import copy
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray, Track
from hil_sim.plants import draws, urdf_drawing, world
from hil_sim.plants.body import Solid
from hil_sim.plants.drives import servos
from hil_sim.plants.drives.driven_vehicle import Drivable, drawn_drives
from hil_sim.plants.events import events
from hil_sim.plants.motions.attitude import holding
from hil_sim.plants.motions.carrier import CarrierMaker
from hil_sim.plants.motions.joint_swings import JointSwings, wheels
from hil_sim.plants.motions.spline import CubicSpline
from hil_sim.plants.parts.cabin import Cabin
from hil_sim.plants.parts.exchange import Jolt
from hil_sim.plants.parts.jets import Jets
from hil_sim.plants.parts.pucks import pucks
from hil_sim.plants.parts.soft_parts import springs
from hil_sim.plants.servo_flight import ServoFlight
from hil_sim.plants.urdf_model import UrdfModel, places
from hil_sim.plants.vehicle_flight import Rows, VehicleFlight
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import Scenario

_ELEMENTS = {"xx": (0, 0), "xy": (0, 1), "yy": (1, 1), "xz": (0, 2), "yz": (1, 2), "zz": (2, 2)}
_APPROACH = tuple(f"{kind}_before_capture_{axis}" for kind in ("velocity", "rate") for axis in "xyz")
_SLOW = 2e-3  # rad/s, m/s: of the rounding of Coulomb friction
_WHOLE_S, PART = 240.0, 10  # missions computed when the plant is created; chunks at a time of longer ones
_AT_ONCE_S, _BLOCK = 120.0, 100  # interpolated when the plant is created; chunks at a time afterwards
_FAR = 50  # chunks beyond the next for which a servo's commanded motion is made at once
_AROUND = 8  # rows to either side with which a part of a spline is as the whole one, to 3e-5 of its bend


class _Part(NamedTuple):
    """What flies unchanged, between captures and releases."""

    first: int  # row
    rows: int
    offset: int  # of the first in the splines, coarse rows
    splines: tuple[CubicSpline, ...]  # of each of ``Rows``, by coarse row
    jolt: Jolt | None  # in its first row


class VehiclePlant(world.Plant):
    """A vehicle's whole mission.

    Args:
        scenario: the mission.
        rng: draws bodies, payload, release, motion, drives, table and capture, in this order; a stream of its own the
            places of frames.

    Attributes:
        bodies: every link that has a mass, as built.
        off_m: how far frames are from where they are drawn, in the axes of the link before.
        payload: what is held, or caught, and how it is held once it is; None where nothing is.
        events_s: capture, closing of the grip after a contact, and ejection, by name.
        cabin: in which the vehicle is let go and caught; None where there is none.
        flight: MuJoCo's model of what flies, and its state.
        rows_true: true signals of the whole flight; rows from ``count`` on are not yet released.

    Raises:
        ScenarioError: a drawing, a link or a number that cannot be simulated.
    """

    def __init__(self, scenario: Scenario, rng: np.random.Generator) -> None:
        physics, said = scenario.physics, scenario.vehicle
        self._scenario = scenario
        self.drawing = urdf_drawing.read(said.urdf, said.label)
        if said.base_link != self.drawing.root:
            raise ScenarioError(f"{said.label} hangs on {self.drawing.root!r}, and base_link is {said.base_link!r}")
        self._places = places(scenario, self.drawing)
        gravity = physics.gravity_m_s2
        tilt = scenario.table.tilt_sigma_m_s2 * rng.standard_normal(2) if said.base == "planar" else np.zeros(2)
        self._gravity = np.array(gravity) + np.array([*tilt, 0.0])
        parts = servos.fit(scenario, self.drawing) if scenario.servo else None
        self._model = UrdfModel(self.drawing, said.base, self._gravity.tolist(), self._places, parts)
        self.joints = tuple(self.drawing.joints[name] for name in self._model.joints)
        self._rotors = {self.drawing.joints[name].child for name in wheels(scenario) if name in self.drawing.joints}
        drawn = None
        if scenario.payload is not None and said.payload_link is not None:
            if said.payload_link not in self.drawing.links:
                raise ScenarioError(f"{said.label} has no link {said.payload_link!r}, which is the payload_link")
            drawn = self._model.empty(said.payload_link)
        self.bodies = draws.as_built(scenario, self._model.drawn, self._rotors, rng)
        self._model.build(self.bodies)
        self.off_m = draws.off_the_drawing(scenario, self.drawing.links, rng.spawn(1)[0])
        self._model.move(self.off_m)
        self.payload = None
        if scenario.payload is not None:
            sigma = scenario.as_built.get(said.payload_link or "")
            self.payload = draws.payload(scenario.payload, drawn, sigma, rng)
        self._velocity = draws.let_go(scenario.release, said.base, rng)
        self.program: JointSwings = JointSwings(scenario, self.joints, rng)
        self.drives = drawn_drives(scenario.friction, self.efforts_n_m, self.bodies, rng)
        self._pucks = pucks(scenario, self._model, rng)
        self.step_s, self.chunk, self.count = 1e-6 * physics.step_us, physics.chunk_steps, 0
        self.rows = self.chunk * (int(self.program.duration_s / (self.chunk * self.step_s)) + 2)
        self.events_s: dict[str, float] = {}
        self._live: list[tuple[FloatArray, Callable[[slice], FloatArray]]] = []
        self.parts: list[_Part] = []  # not interpolated to their end
        self._filled = 0  # rows interpolated
        self._start(rng)
        waits = self.program.waits or isinstance(self.flight, ServoFlight)
        self._part = PART * self.chunk if not waits and self.program.duration_s > _WHOLE_S else 0
        if not (waits or self._part):
            self._compute(self.rows)
            self._make(round(_AT_ONCE_S / self.step_s))

    def _start(self, rng: np.random.Generator) -> None:
        """The flight at its first row, and what will happen in it."""
        scenario, every = self._scenario, self.every
        self._coarse_s, self._steps = every * self.step_s, -(-self.rows // every) + 1
        prescribed = scenario.vehicle.base == "prescribed"
        path = CarrierMaker(scenario, self._coarse_s, self._steps + 1, rng) if prescribed else None
        link = scenario.vehicle.payload_link
        if self.payload is not None and scenario.capture is None and link is not None:
            self._model.hold(link, self.payload)
        self.cabin: Cabin | None = None
        if scenario.parabolas is not None:
            self.cabin = Cabin(scenario.parabolas, 0.5 * self._coarse_s, 2 * self._steps + 1, rng)
        self.soft, lightened = springs(scenario, self.bodies, self._model.joints, rng)
        self._model.build(lightened)
        self.jets = Jets(scenario, self._model, self.bodies)
        common = self._model, self.program, self._places, link, self._coarse_s
        self.flight: VehicleFlight | ServoFlight
        if scenario.servo:
            far = 0 if self.program.waits else _FAR
            parts = path, scenario.drag, scenario.stop
            self.flight = ServoFlight(*common, self.chunk, far, self._servos, *parts)
            self.drives = {
                name: servo.drive for name, servo in zip(self._model.joints, self.flight.servos, strict=True)
            }
        else:
            wheeled = holding(scenario, self._model, self._model.joints)
            held = self.cabin, self.soft, self.jets, wheeled
            self.flight = VehicleFlight(*common, self._velocity, path, scenario.bearing or self._pucks, *held)
        self._coming = deque(events(scenario, self.payload, self._coarse_s, self._steps, rng))
        self._capture = next((event for event in self._coming if event.name == "capture"), None)
        joints = len(self.joints)
        self._tracks = [Track(self.rows, n) for n in (self._model.model.nsensordata, *[joints] * 3)]
        self.rows_true = Rows(*(track.values for track in self._tracks))
        self._window: Rows | None = None  # coarse rows from ``_window_at`` on, refined before ``_done``
        self._window_at = self.done = 0
        self._jolt: Jolt | None = None
        self.came: FloatArray | None = None  # see ``VehicleFlight.approach``

    @property
    def every(self) -> int:
        """Rows of the sensors' grid that the integration takes at a time."""
        return 1 if self._scenario.servo else self._scenario.physics.integration_steps

    def _servos(self, inertias_kg_m2: FloatArray) -> list[servos.Servo]:
        return servos.servos(self._scenario.servo, self._model.joints, self.drives, self.efforts_n_m, inertias_kg_m2)

    def _follow(self, flight: ServoFlight, rows: int) -> None:
        """True signals of a flight whose rows are those of the sensors' grid, so many at least."""
        while self._filled < min(rows, self.rows):
            end = min([rows, self.rows, *(event.row for event in self._coming)])
            flight.advance(Rows(*(values[self._filled : end] for values in self.rows_true)))
            if self._jolt is not None:
                self.rows_true.sensors[self._filled] += self._jolt.sensors / self.step_s
            for made_of, made in self._live:
                made_of[self._filled : end] = made(slice(self._filled, end))
            self._filled, self._jolt = end, None
            if self._coming and self._coming[0].row == end:
                self._happen()

    def _compute(self, rows: int) -> None:
        """True signals on the sensors' grid, so many rows at least."""
        every, flight = self.every, self.flight
        if isinstance(flight, ServoFlight):
            return self._follow(flight, rows)
        while self.done < self._steps and self.done * every < rows:
            end = self._coming[0].row if self._coming else self._steps
            wanted = min(end, -(-rows // every) + _AROUND)
            flown = flight.advance(wanted - flight.count)
            self._window = flown if self._window is None else _joined(self._window, flown)
            if wanted < end:
                self._refine(self._window, wanted - _AROUND)
                kept = max(self._window_at, self.done - _AROUND)
                self._window = Rows(*(values[kept - self._window_at :] for values in self._window))
                self._window_at = kept
                continue
            self._refine(_joined(self._window, flight.show()), end)
            self._window, self._window_at = None, end
            if self._coming:
                self._happen()

    def _happen(self) -> None:
        """The next event, at the row at which the flight stands."""
        event, flight = self._coming.popleft(), self.flight
        if event.name == "capture" and event.moves is not None:
            self.came = flight.approach(event.moves)
        self._jolt = event.happen(flight)
        self.events_s[event.name] = event.row * self._coarse_s
        self.payload = flight.caught or self.payload

    def _refine(self, window: Rows, until: int) -> None:
        """Splines up to a coarse row; what jumped before the first is in that."""
        every, first = self.every, self.done * self.every
        count = max(min(every * until, self.rows) - first, 0)
        splines = tuple(CubicSpline(np.arange(len(values), dtype=np.float64), values) for values in window)
        self.parts.append(_Part(first, count, self.done - self._window_at, splines, self._jolt))
        self._jolt, self.done = None, until
        if self.program.waits:
            self._make(first + count)

    def _make(self, until: int) -> None:
        """Fine rows up to ``until``, as far as there are splines, and what is derived from them."""
        every, begun = self.every, self._filled
        self._filled = min(until, every * self.done, self.rows)
        for part in self.parts:
            first, last = max(begun, part.first), min(self._filled, part.first + part.rows)
            if first >= last:
                continue
            at = part.offset + np.arange(first - part.first, last - part.first) / every
            for out, spline in zip(self.rows_true, part.splines, strict=True):
                out[first:last] = spline(at)
            if part.jolt is not None and first == part.first:
                self.rows_true.sensors[first] += part.jolt.sensors / self.step_s
                self.rows_true.torques[first] += part.jolt.torques / self.step_s
        self.parts = [part for part in self.parts if part.first + part.rows > self._filled]
        for out, made in self._live:
            out[begun : self._filled] = made(slice(begun, self._filled))

    def forget(self, before: int) -> None:
        """See ``world.Plant``."""
        self.forgotten = max(self.forgotten, before)
        for track in self._tracks:
            track.forget(before)

    def ask(self, name: str) -> bool:
        """Play a segment of ``motion.segments`` as soon as what is computed allows; False where it cannot be."""
        return self.program.ask(name, (self.flight.count + 1) * self._coarse_s)

    def inertial(self, at: str) -> world.Inertial:
        """See ``world.Plant``; ``at`` is a link or joint of the URDF."""
        link = self.drawing.link_at(at)
        sensors = self.rows_true.sensors
        force, rate = (sensors[:, self._model.sensor(kind, link)] for kind in ("accelerometer", "gyro"))
        return world.Inertial(force, rate, 0.5 if self._scenario.servo else 0.0)

    def angle_rad(self, at: str) -> FloatArray:
        """See ``world.Plant``: m of a joint that slides."""
        return self.rows_true.joints[:, self._joint(at)]

    def moment_n_m(self, at: str, axis: world.Axis = world.Z) -> FloatArray:
        """See ``world.Plant``."""
        unit, columns = np.asarray(axis) / np.linalg.norm(axis), self._model.sensor("torque", self.drawing.link_at(at))
        return self._made(lambda rows: np.asarray(self.rows_true.sensors[rows, columns] @ unit))

    def force_n(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        return self.rows_true.sensors[:, self._model.sensor("force", self.drawing.link_at(at))]

    def servo_torque_n_m(self, at: str) -> FloatArray:
        """See ``world.Plant``: with the drive's friction and rotor."""
        column, drive = self._joint(at), self.drives[at]
        if self._scenario.servo:
            return self.rows_true.torques[:, column]

        def made(rows: slice) -> FloatArray:
            rate = self.rows_true.rates[rows, column]
            own = drive.coulomb_n_m * np.tanh(rate / _SLOW) + drive.viscous_n_m_s * rate
            if len(rate) > 1:
                own = own + drive.rotor_kg_m2 * np.gradient(rate, self.step_s)
            return np.asarray(self.rows_true.torques[rows, column] + own)

        return self._made(made)

    def _made(self, of: Callable[[slice], FloatArray], columns: int | None = None) -> FloatArray:
        """A signal (n,) or (n, columns) made of others: of those rows that there are, and of each that comes."""
        track = Track(self.rows) if columns is None else Track(self.rows, columns)
        done = slice(0, self._filled)
        if done.stop:
            track.values[done] = of(done)
        self._tracks.append(track)
        self._live.append((track.values, of))
        return track.values

    def wheel_rate_rad_s(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        return self.rows_true.rates[:, self._joint(at)]

    def thrust_n(self, at: str) -> FloatArray:
        """See ``world.Plant``; ``at`` is the thruster's frame."""
        if at not in self.jets.frames:
            return super().thrust_n(at)
        return self.jets.force_n(at, self.step_s * np.arange(self.rows, dtype=np.float64))

    def pose(self, at: str) -> FloatArray:
        """See ``world.Plant``; a cabin is taken for inertial, so nothing is tracked in one."""
        if self.cabin is not None:
            return super().pose(at)
        link, sensors = self.drawing.link_at(at), self.rows_true.sensors
        where, how = (self._model.sensor(kind, link) for kind in ("position", "attitude"))
        return self._made(lambda rows: np.hstack([sensors[rows, where], sensors[rows, how]]), 7)

    @property
    def base(self) -> Solid:
        """The base's body, as built."""
        return self.bodies[self._scenario.vehicle.base_link]

    def turn(self, at: str) -> FloatArray:
        """Rotation from the axes of a link or joint to the base's, joints at zero, (3, 3)."""
        data = mujoco.MjData(self._model.model)
        mujoco.mj_kinematics(self._model.model, data)
        link, base = (self._model.body(name) for name in (self.drawing.link_at(at), self.drawing.root))
        return np.asarray(data.xmat[base].reshape(3, 3).T @ data.xmat[link].reshape(3, 3))

    @property
    def efforts_n_m(self) -> dict[str, float]:
        """Largest torque of each joint, N m or N; ``effort_N_m`` of ``[friction]`` where the URDF gives none."""
        own = self._scenario.friction.effort_N_m
        return {joint.name: joint.effort if np.isfinite(joint.effort) else own for joint in self.joints}

    def driven(self) -> Drivable:
        """What was drawn, to be moved by its drives.

        Raises:
            ScenarioError: a prescribed base.
        """
        scenario = self._scenario
        if scenario.vehicle.base == "prescribed":
            raise ScenarioError('a base = "prescribed" moves as prescribed, whatever its arm does: nothing to control')
        models: list[mujoco.MjModel] = []
        for held in (None, self.payload):
            if scenario.vehicle.payload_link is not None:
                self._model.hold(scenario.vehicle.payload_link, held)
            models.append(copy.copy(self._model.model))
        made = self._model.joints, self.drives, self.efforts_n_m, self.program.posture, self._velocity, self._pucks
        return Drivable(models[0], models[1], *made)

    def truth(self) -> dict[str, Any]:
        """See ``world.Plant``: of the payload in its link's frame, and of every link in its own."""
        quantities = {} if self.came is None else dict(zip(_APPROACH, self.came.tolist(), strict=True))
        caught, contact = (self._capture.moves, self._capture.contact) if self._capture else (None, None)
        if self.payload is not None:
            name, c = str(self._scenario.vehicle.payload_link), self.payload.centre_of_mass_m
            quantities |= {
                f"m_{name}": self.payload.mass_kg,
                **{f"c_{axis}_{name}": value for axis, value in zip("xyz", c.tolist(), strict=True)},
                **{f"I_{of}_{name}": float(self.payload.inertia_kg_m2[at]) for of, at in _ELEMENTS.items()},
            }
        return {
            "quantities": quantities,
            "payload_link": self._scenario.vehicle.payload_link,
            "links": {link: body.as_truth() for link, body in self.bodies.items()},
            "places_m": self.off_m,
            "drives": {name: drive._asdict() for name, drive in self.drives.items()},
            "pucks": {name: puck._asdict() for name, puck in zip(self._scenario.table.pucks, self._pucks, strict=True)},
            "gravity_m_s2": self._gravity,
            "posture": dict(zip(self._model.joints, self.program.posture.tolist(), strict=True)),
            "capture_s": self.events_s.get("capture", 0.0),
            "capture_velocity_m_s": caught.velocity_m_s if caught else None,
            "capture_rate_rad_s": caught.rate_rad_s if caught else None,
            "contact_Hz": contact[0] if contact else None,
            "gripped_s": self.events_s.get("grip"),
            "ejection_s": self.events_s.get("ejection"),
            "joint_stiffness_N_m_rad": None if self.soft is None else self.soft.stiffness_N_m_rad,
            "parabolas": [] if self.cabin is None else [run.as_truth() for run in self.cabin.runs],
            "asked": [{"start_s": start_s, "segment": name} for start_s, name in self.program.asked],
        }

    def _joint(self, name: str) -> int:
        if name not in self._model.joints:
            raise ScenarioError(f"the URDF has no moving joint {name!r}; it has {', '.join(self._model.joints)}")
        return self._model.joints.index(name)

    def _run_chunk(self) -> None:
        self.count += self.chunk
        if not self._part or self.done * self.every < min(self.count, self.rows):
            self._compute(min(self.count + self._part, self.rows))
        if self._filled < min(self.count, self.rows):  # not of servos
            self._make(self.count + _BLOCK * self.chunk)


def _joined(before: Rows, after: Rows) -> Rows:
    return Rows(*(np.concatenate(of) for of in zip(before, after, strict=True)))
