"""Plant of any vehicle: its URDF as it was built, its base released, held or moved, its joints as told, its payload.

The whole mission is computed when the plant is created, at steps of a few ms; where the flight computer asks for some
of the motion, it is computed as time advances. The sensors' finer grid is interpolated by splines, separately between
captures and releases; a jolt is in one row of that grid, as its mean. Rows are released in chunks as time advances, so
no sensor reads future rows.
"""

import copy
from collections import deque
from collections.abc import Callable, Collection, Iterator
from typing import Any

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from hil_sim.arrays import FloatArray
from hil_sim.plants import urdf_drawing, world
from hil_sim.plants.base_sway import sway
from hil_sim.plants.body import Body, built
from hil_sim.plants.cabin import Cabin, Release
from hil_sim.plants.driven_vehicle import Drivable, drawn_drives
from hil_sim.plants.jets import Jets
from hil_sim.plants.joint_swings import JointSwings, wheels
from hil_sim.plants.soft_parts import springs
from hil_sim.plants.urdf_model import Places, UrdfModel, rotation
from hil_sim.plants.vehicle_flight import Jolt, Puck, Released, Rows, VehicleFlight
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import LetGo, PayloadTable, Tolerance, VehicleScenario

_ELEMENTS = {"xx": (0, 0), "xy": (0, 1), "yy": (1, 1), "xz": (0, 2), "yz": (1, 2), "zz": (2, 2)}
_DRAWS = 1000  # of a part until it is one that can exist
_SLOW = 2e-3  # rad/s, m/s: of the rounding of Coulomb friction
_AROUND = 8  # rows to either side with which a part of a spline is as the whole one, to 3e-5 of its bend


class VehiclePlant(world.Plant):
    """A vehicle's whole mission.

    Args:
        scenario: the mission.
        rng: draws bodies, payload, release, motion, drives, table and capture, in this order.

    Attributes:
        bodies: every link that has a mass, as built.
        payload: what is held, or caught; None where nothing is.
        events_s: capture and ejection, by name.
        cabin: in which the vehicle is let go and caught; None where there is none.
        rows_true: true signals of the whole flight; rows from ``count`` on are not yet released.

    Raises:
        ScenarioError: a drawing, a link or a number that cannot be simulated.
    """

    def __init__(self, scenario: VehicleScenario, rng: np.random.Generator) -> None:
        physics, said = scenario.physics, scenario.vehicle
        self._scenario = scenario
        self.drawing = urdf_drawing.read(said.urdf, said.label)
        if said.base_link != self.drawing.root:
            raise ScenarioError(f"{said.label} hangs on {self.drawing.root!r}, and base_link is {said.base_link!r}")
        self._places = _places(scenario, self.drawing)
        gravity = physics.gravity_m_s2
        tilt = scenario.table.tilt_sigma_m_s2 * rng.standard_normal(2) if said.base == "planar" else np.zeros(2)
        self._gravity = np.array(gravity) + np.array([*tilt, 0.0])
        self._model = UrdfModel(self.drawing, said.base, self._gravity.tolist(), self._places)
        self.joints = tuple(self.drawing.joints[name] for name in self._model.joints)
        self._rotors = {self.drawing.joints[name].child for name in wheels(scenario) if name in self.drawing.joints}
        drawn = None
        if scenario.payload is not None and said.payload_link is not None:
            if said.payload_link not in self.drawing.links:
                raise ScenarioError(f"{said.label} has no link {said.payload_link!r}, which is the payload_link")
            drawn = self._model.empty(said.payload_link)
        self.bodies = _as_built(scenario, self._model.drawn, self._rotors, rng)
        self._model.build(self.bodies)
        self.payload = None if scenario.payload is None else _payload(scenario.payload, drawn, rng)
        self._velocity = _let_go(scenario.release, said.base, rng)
        self.program: JointSwings = JointSwings(scenario, self.joints, rng)
        self.drives = drawn_drives(scenario.friction, self.efforts_n_m, self.bodies, rng)
        self._pucks = _pucks(scenario, self._model, rng)
        self.step_s, self.chunk, self.count = 1e-6 * physics.step_us, physics.chunk_steps, 0
        self.rows = self.chunk * (int(self.program.duration_s / (self.chunk * self.step_s)) + 2)
        self.events_s: dict[str, float] = {}
        self._live: list[tuple[FloatArray, Callable[[slice], FloatArray]]] = []
        self._start(rng)
        if not self.program.waits:
            self._compute(self.rows)

    def _start(self, rng: np.random.Generator) -> None:
        """The flight at its first row, and what will happen in it."""
        scenario, every = self._scenario, self._scenario.physics.integration_steps
        self._coarse_s, self._steps = every * self.step_s, -(-self.rows // every) + 1
        prescribed = scenario.vehicle.base == "prescribed"
        half_s = np.asarray(0.5 * self._coarse_s * np.arange(2 * self._steps + 1), np.float64)
        path = sway(scenario.base_motion, half_s, rng) if prescribed else None
        link = scenario.vehicle.payload_link
        if self.payload is not None and scenario.capture is None and link is not None:
            self._model.hold(link, self.payload)
        self.cabin: Cabin | None = None
        if scenario.parabolas is not None:
            self.cabin = Cabin(scenario.parabolas, 0.5 * self._coarse_s, len(half_s), rng)
        self.soft, lightened = springs(scenario, self.bodies, self._model.joints, rng)
        self._model.build(lightened)
        given = self._model, self.program, self._places, link, self._coarse_s, self._velocity, path, self._pucks
        self.jets = Jets(scenario, self._model, self.bodies)
        self._flight = VehicleFlight(*given, self.cabin, self.soft, self.jets)
        self._coming = deque(self._events(rng, self._coarse_s, self._steps))
        self._caught = next((moves for name, _, moves in self._coming if name == "capture"), None)
        joints = len(self.joints)
        self.rows_true = Rows(*(np.zeros((self.rows, n)) for n in (self._model.model.nsensordata, *[joints] * 3)))
        self._window: Rows | None = (
            None  # coarse rows from ``_window_at`` on, of which those before ``_done`` are refined
        )
        self._window_at = self._done = 0
        self._jolt: Jolt | None = None

    def _compute(self, rows: int) -> None:
        """True signals on the sensors' grid, so many rows at least."""
        every, flight = self._scenario.physics.integration_steps, self._flight
        while self._done < self._steps and self._done * every < rows:
            end = self._coming[0][1] if self._coming else self._steps
            wanted = min(end, -(-rows // every) + _AROUND)
            flown = flight.advance(wanted - flight.count)
            self._window = flown if self._window is None else _joined(self._window, flown)
            if wanted < end:
                self._refine(self._window, wanted - _AROUND)
                kept = max(self._window_at, self._done - _AROUND)
                self._window = Rows(*(values[kept - self._window_at :] for values in self._window))
                self._window_at = kept
                continue
            self._refine(_joined(self._window, flight.show()), end)
            self._window, self._window_at = None, end
            if self._coming:
                name, first, moves = self._coming.popleft()
                self._jolt = flight.exchange(moves, None) if name == "capture" else flight.exchange(None, moves)
                self.events_s[name] = first * self._coarse_s

    def _refine(self, window: Rows, until: int) -> None:
        """Fine rows up to a coarse one; what jumped before the first is in that."""
        every, first = self._scenario.physics.integration_steps, self._done * self._scenario.physics.integration_steps
        count = min(every * until, self.rows) - first
        at = (self._done - self._window_at) + np.arange(max(count, 0)) / every
        for out, values in zip(self.rows_true, window, strict=True):
            out[first : first + len(at)] = CubicSpline(np.arange(len(values)), values)(at)
        if self._jolt is not None:
            self.rows_true.sensors[first] += self._jolt.sensors / self.step_s
            self.rows_true.torques[first] += self._jolt.torques / self.step_s
            self._jolt = None
        self._done = until
        for out, made in self._live:
            out[first : first + len(at)] = made(slice(first, first + len(at)))

    def ask(self, name: str) -> bool:
        """Play a segment of ``motion.segments`` as soon as what is computed allows; False where it cannot be."""
        return self.program.ask(name, (self._flight.count + 1) * self._coarse_s)

    def _events(self, rng: np.random.Generator, coarse_s: float, steps: int) -> Iterator[tuple[str, int, Released]]:
        """Capture and ejection: name, coarse row, and what comes or goes."""
        scenario, payload = self._scenario, self.payload
        capture, ejection = scenario.capture, scenario.ejection
        first = 0
        if capture is not None and payload is not None:
            window = rng.uniform(capture.earliest_s, max(capture.latest_s, capture.earliest_s))
            at_s = window if capture.phase is None else scenario.start_of(capture.phase)
            first = min(max(round(at_s / coarse_s), 2), steps - 2)
            velocity = capture.velocity_sigma_m_s * rng.standard_normal(3)
            yield "capture", first, Released(payload, velocity, capture.rate_sigma_rad_s * rng.standard_normal(3))
        if ejection is not None and payload is not None:
            told = scenario.start_of(ejection.phase) if ejection.phase is not None else ejection.at_s
            row = min(max(round((told or 0.0) / coarse_s), first + 2), steps - 2)
            yield "ejection", row, Released(payload, np.asarray(ejection.velocity_m_s), np.zeros(3))

    def inertial(self, at: str) -> world.Inertial:
        """See ``world.Plant``; ``at`` is a link or joint of the URDF."""
        link = self.drawing.link_at(at)
        sensors = self.rows_true.sensors
        force, rate = (sensors[:, self._model.sensor(kind, link)] for kind in ("accelerometer", "gyro"))
        return world.Inertial(force, rate, 0.0)

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

        def made(rows: slice) -> FloatArray:
            rate = self.rows_true.rates[rows, column]
            own = drive.coulomb_n_m * np.tanh(rate / _SLOW) + drive.viscous_n_m_s * rate
            if len(rate) > 1:
                own = own + drive.rotor_kg_m2 * np.gradient(rate, self.step_s)
            return np.asarray(self.rows_true.torques[rows, column] + own)

        return self._made(made)

    def _made(self, of: Callable[[slice], FloatArray]) -> FloatArray:
        """A signal (n,) made of others: of those rows that there are, and of each that comes."""
        done = slice(0, min(self._done * self._scenario.physics.integration_steps, self.rows))
        out = np.zeros(self.rows)
        if done.stop:
            out[done] = of(done)
        self._live.append((out, of))
        return out

    def wheel_rate_rad_s(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        return self.rows_true.rates[:, self._joint(at)]

    def thrust_n(self, at: str) -> FloatArray:
        """See ``world.Plant``; ``at`` is the thruster's frame."""
        if at not in self.jets.frames:
            return super().thrust_n(at)
        return self.jets.force_n(at, self.step_s * np.arange(self.rows, dtype=np.float64))

    @property
    def efforts_n_m(self) -> dict[str, float]:
        """Largest torque of each joint, N m or N; ``effort_N_m`` of ``[friction]`` where the URDF gives none."""
        own = self._scenario.friction.effort_N_m
        return {joint.name: joint.effort if np.isfinite(joint.effort) else own for joint in self.joints}

    def driven(self) -> Drivable:
        """What was drawn, to be moved by its drives.

        Raises:
            ScenarioError: a base that is moved as told.
        """
        scenario = self._scenario
        if scenario.vehicle.base == "prescribed":
            raise ScenarioError('a base = "prescribed" moves as it is told, whatever its arm does: nothing to control')
        models: list[mujoco.MjModel] = []
        for held in (None, self.payload):
            if scenario.vehicle.payload_link is not None:
                self._model.hold(scenario.vehicle.payload_link, held)
            models.append(copy.copy(self._model.model))
        made = self._model.joints, self.drives, self.efforts_n_m, self.program.posture, self._velocity, self._pucks
        return Drivable(models[0], models[1], *made)

    def truth(self) -> dict[str, Any]:
        """See ``world.Plant``: of the payload in its link's frame, and of every link in its own."""
        quantities: dict[str, float] = {}
        if self.payload is not None:
            name, c = str(self._scenario.vehicle.payload_link), self.payload.centre_of_mass_m
            quantities = {
                f"m_{name}": self.payload.mass_kg,
                **{f"c_{axis}_{name}": value for axis, value in zip("xyz", c.tolist(), strict=True)},
                **{f"I_{of}_{name}": float(self.payload.inertia_kg_m2[at]) for of, at in _ELEMENTS.items()},
            }
        return {
            "quantities": quantities,
            "payload_link": self._scenario.vehicle.payload_link,
            "links": {link: _told(body) for link, body in self.bodies.items()},
            "drives": {name: drive._asdict() for name, drive in self.drives.items()},
            "pucks": {name: puck._asdict() for name, puck in zip(self._scenario.table.pucks, self._pucks, strict=True)},
            "gravity_m_s2": self._gravity,
            "posture": dict(zip(self._model.joints, self.program.posture.tolist(), strict=True)),
            "capture_s": self.events_s.get("capture", 0.0),
            "capture_velocity_m_s": self._caught.velocity_m_s if self._caught else None,
            "capture_rate_rad_s": self._caught.rate_rad_s if self._caught else None,
            "ejection_s": self.events_s.get("ejection"),
            "joint_stiffness_N_m_rad": None if self.soft is None else self.soft.stiffness_N_m_rad,
            "parabolas": [] if self.cabin is None else [_flown(run) for run in self.cabin.runs],
            "asked": [{"start_s": start_s, "segment": name} for start_s, name in self.program.asked],
        }

    def _joint(self, name: str) -> int:
        if name not in self._model.joints:
            raise ScenarioError(f"the URDF has no moving joint {name!r}; it has {', '.join(self._model.joints)}")
        return self._model.joints.index(name)

    def _run_chunk(self) -> None:
        self.count += self.chunk
        self._compute(min(self.count, self.rows))


def _flown(run: Release) -> dict[str, Any]:
    return {
        "parabola": run.parabola,
        "flown": run.flown.label,
        "release_s": run.release_s,
        "catch_s": run.catch_s,
        "bumps_s": [bump.at_s for bump in run.bumps],
        "bumps_N_s": [float(np.linalg.norm(bump.impulse_N_s)) for bump in run.bumps],
    }


def _joined(before: Rows, after: Rows) -> Rows:
    return Rows(*(np.concatenate(of) for of in zip(before, after, strict=True)))


def _told(body: Body) -> dict[str, Any]:
    return {
        "mass_kg": body.mass_kg,
        "centre_of_mass_m": body.centre_of_mass_m,
        "inertia_kg_m2": body.inertia_kg_m2,
    }


def _places(scenario: VehicleScenario, drawing: urdf_drawing.Drawing) -> Places:
    """Links at which the devices measure motion or loads."""
    imus: dict[str, None] = {}
    cells: dict[str, None] = {}
    for device in scenario.device.values():
        table = device.model_dump()
        for part in (table, *table.get("channel", ())):
            sensor = scenario.sensor.get(str(part.get("measures")))
            if sensor is not None and sensor.quantity == "inertial":
                imus[drawing.link_at(str(part.get("at")))] = None
            elif sensor is not None and sensor.quantity in ("joint_moment", "force"):
                cells[drawing.link_at(str(part.get("at")))] = None
    return Places(tuple(imus), tuple(cells))


def _as_built(
    scenario: VehicleScenario, drawn: dict[str, Body], rotors: Collection[str], rng: np.random.Generator
) -> dict[str, Body]:
    """Every link within its tolerance of the drawing; drawn again until it is a body that can exist.

    Rotors of wheels are balanced bodies of revolution: all of their inertia has one factor.
    """
    unknown = sorted(scenario.as_built.keys() - drawn.keys() - {"default"})
    if unknown:
        raise ScenarioError(f"as_built names {', '.join(unknown)}; links with a mass are {', '.join(drawn)}")
    usual = scenario.as_built.get("default", Tolerance())
    found: dict[str, Body] = {}
    for link, body in drawn.items():
        sigma = scenario.as_built.get(link, usual)
        if link in rotors:
            mass, inertia = 1.0 + np.array([sigma.mass_relative, sigma.inertia_relative]) * rng.standard_normal(2)
            found[link] = Body(mass * body.mass_kg, body.centre_of_mass_m, inertia * body.inertia_kg_m2)
            continue
        for _ in range(_DRAWS):
            one = built(body, sigma.mass_relative, 1e-3 * sigma.centre_mm, sigma.inertia_relative, rng)
            if one.is_possible:
                break
        else:
            raise ScenarioError(f"as_built.{link}: hardly any body lies within it; make it smaller")
        found[link] = one
    return found


def _payload(table: PayloadTable, drawn: Body | None, rng: np.random.Generator) -> Body:
    """A solid box in the frame of its link; whatever is not told is drawn.

    Where its link has an inertia in the URDF and the table gives no shape, it has that shape at another density.
    """
    low, high = np.log(table.mass_kg)
    mass = float(np.exp(rng.uniform(low, high)))
    shape = rng.uniform(0.7, 1.4, 3)
    size = (mass / table.density_kg_m3) ** (1.0 / 3.0) * shape / np.cbrt(shape.prod())
    aside, turn = rng.uniform(-0.3, 0.3, 3), rng.uniform(-np.pi, np.pi, 3)
    if drawn is not None and drawn.mass_kg > 0.0 and table.size_mm is None and table.centre_of_mass_mm is None:
        return Body(mass, drawn.centre_of_mass_m, drawn.inertia_kg_m2 * mass / drawn.mass_kg)
    if table.size_mm is not None:
        size = 1e-3 * np.asarray(table.size_mm)
    centre = aside * size + [0.0, 0.0, 0.5 * size[2]]
    if table.centre_of_mass_mm is not None:
        centre = 1e-3 * np.asarray(table.centre_of_mass_mm)
    if table.roll_pitch_yaw_deg is not None:
        turn = np.deg2rad(table.roll_pitch_yaw_deg)
    return Body.box(mass, size.tolist(), centre.tolist()).turned(rotation(turn))


def _let_go(table: LetGo, base: str, rng: np.random.Generator) -> FloatArray:
    """Velocity of the base at the start, MuJoCo's numbers."""
    rate = table.rate_rad_s * rng.uniform(-1.0, 1.0, 3) + np.asarray(table.spin_rad_s)
    velocity = table.velocity_m_s * rng.uniform(-1.0, 1.0, 3)
    return {"free": np.concatenate([velocity, rate]), "planar": np.array([*velocity[:2], rate[2]])}.get(
        base, np.zeros(0)
    )


def _pucks(scenario: VehicleScenario, model: UrdfModel, rng: np.random.Generator) -> list[Puck]:
    """Every puck of the table, its drag drawn."""
    found = []
    for frame in scenario.table.pucks:
        link = model.model.body(model.body(frame))
        if int(link.parentid[0]) != model.body(scenario.vehicle.base_link):
            raise ScenarioError(f"table.pucks: {frame!r} is not fixed to {scenario.vehicle.base_link!r}; make it so")
        share = rng.uniform(0.0, 1.0, 2)
        drag = share * [scenario.table.viscous_N_s_m, scenario.table.coulomb_N]
        found.append(Puck(np.array(link.pos), *drag.tolist()))
    return found
