"""Plant of the free-flyer mission: vehicle as built, release, arm motion, capture of the payload.

MuJoCo (``hil_sim.plants.free_flyer``) integrates the whole flight when the plant is created, at steps of a few ms (the
flight computer does not act on it). The sensors' finer grid is interpolated by splines as time advances, separately
before and after the capture; the shock of the capture is in one row of that grid, as its mean. Rows are released in
chunks, so no sensor reads future rows.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from hil_sim.arrays import FloatArray, Track
from hil_sim.plants import free_flyer, world
from hil_sim.plants.actuators import Actuators, Hold, Pulse, Wheel
from hil_sim.plants.arm_swings import ArmSwings
from hil_sim.plants.body import Body, built
from hil_sim.plants.driven_vehicle import Drivable, drawn_drives
from hil_sim.plants.servo_axis import STEP_S
from hil_sim.scenario.free_flyer_tables import JOINTS, Built, FreeFlyerScenario, Payload
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import JointFriction

JOINT_NAMES = tuple(f"joint_{number}" for number in range(1, JOINTS + 1))
EFFORT_N_M = 20.0  # of a joint's drive: our choice, as in the vehicle's URDF
WRIST = "wrist"  # the flange of the last joint
_BLOCK = 100  # chunks interpolated at a time


class TrueSignals(NamedTuple):
    """True signals on the sensors' grid, (n, ...) each; IMU axes are those of ``free_flyer``'s IMU."""

    q_rad: FloatArray  # (n, 5)
    rate_rad_s: FloatArray  # (n, 3) of the base, IMU axes
    acceleration_rad_s2: FloatArray  # (n, 3) of the base, IMU axes
    specific_force_m_s2: FloatArray  # (n, 3) at the IMU, its axes
    wrist_force_n: FloatArray  # (n, 3) on everything beyond the last joint's flange, the last link's axes
    wrist_moment_n_m: FloatArray  # (n, 3)
    wheel_rad_s: FloatArray  # (n, w) of the reaction wheels


class _Part(NamedTuple):
    """What flies unchanged, before or after the capture."""

    first: int  # row
    rows: int
    start_s: float
    splines: tuple[CubicSpline, ...]  # joints, rate, specific force, wrist force and moment, wheels
    shock: free_flyer.Jump | None  # in its first row


class FreeFlyerPlant(world.Plant):
    """The free-flyer's whole mission.

    Args:
        scenario: the mission.
        rng: draws the as-built errors, the release, the motion and the capture, in this order; a stream of its own the
            places of joints and IMUs.

    Attributes:
        base: as built.
        arm: its links, as built.
        joint_offsets_m: of the joints from the drawing, (5, 3).
        imu_offsets_m: of each site from the drawing, (3,).
        payload: what is captured.
        capture_s: mission time of the capture.
        flight: true signals of the whole flight, filled as time advances; rows from ``count`` on are not yet released.
    """

    def __init__(self, scenario: FreeFlyerScenario, rng: np.random.Generator) -> None:
        physics = scenario.physics
        self._scenario = scenario
        self.base, self.arm = as_built(scenario, rng)
        self.payload = _box(scenario.payload)
        places, self._drawn_last, of_wheels = rng.spawn(3)
        self.actuators = _actuators(scenario, of_wheels)
        self.joint_offsets_m = 1e-3 * scenario.as_built.joint_place_mm * places.standard_normal((JOINTS, 3))
        off_m = 1e-3 * scenario.as_built.imu_place_mm
        self.imu_offsets_m = {name: off_m * places.standard_normal(3) for name in scenario.site}
        self.release_rate_rad_s = scenario.release.rate_rad_s * rng.uniform(-1.0, 1.0, 3)
        self.program: ArmSwings = ArmSwings(scenario, rng)
        self.step_s, self.chunk, self.count = 1e-6 * physics.step_us, physics.chunk_steps, 0
        self.rows = self.chunk * (int(self.program.duration_s / (self.chunk * self.step_s)) + 2)
        self._tracks = [Track(self.rows, width) for width in (JOINTS, 3, 3, 3, 3, 3, len(scenario.wheel))]
        self.flight = TrueSignals(*(track.values for track in self._tracks))
        self._made = 0  # rows interpolated
        self._derived: list[tuple[FloatArray, Callable[[TrueSignals], FloatArray]]] = []
        self.capture_s, self._parts = self._fly(rng)

    def _fly(self, rng: np.random.Generator) -> tuple[float, list[_Part]]:
        """Capture time, and the flight before and after it."""
        every, capture = self._scenario.physics.integration_steps, self._scenario.capture
        coarse_s, steps = every * self.step_s, -(-self.rows // every) + 1
        held = self.payload if capture is None else None
        sloshes = self._scenario.slosh
        slosh = None if sloshes is None else free_flyer.Slosh(sloshes.mass_kg, sloshes.frequency_Hz)
        built = self.base, self.arm, coarse_s, self.joint_offsets_m, slosh, self.actuators
        flight = free_flyer.FreeFlight(self.program, self.release_rate_rad_s, held, *built)
        if capture is None:
            return 0.0, [self._part(flight.advance(steps), 0, self.rows)]
        first = round(rng.uniform(capture.earliest_s, capture.latest_s) / coarse_s)
        before = self._part(flight.advance(first), 0, first * every)
        velocity_m_s = capture.velocity_sigma_m_s * rng.standard_normal(3)
        rate_rad_s = capture.rate_sigma_rad_s * rng.standard_normal(3)
        jump = flight.capture(self.payload, velocity_m_s, rate_rad_s)
        held_flight = flight.advance(steps - first)
        held_flight.specific_force_m_s2[0] -= jump.velocity_m_s / coarse_s
        after = self._part(held_flight, first * every, self.rows - first * every)
        return first * coarse_s, [before, after._replace(shock=jump)]

    def inertial(self, at: str) -> world.Inertial:
        """See ``world.Plant``: f = f_0 + dw x r + w x (w x r), r from the IMU that MuJoCo has."""
        self._check(at, self._scenario.site)
        site = self._scenario.site[at]
        R_BS = mounting(self._scenario, at)
        R_B0 = _rotation(np.asarray(free_flyer.IMU_QUATERNION))
        place_m = 1e-3 * np.asarray(site.position_mm) + self.imu_offsets_m[at]
        r = R_B0.T @ (place_m - free_flyer.IMU_POSITION_m)
        turn = R_B0.T @ R_BS

        def force(flight: TrueSignals) -> FloatArray:
            w, dw, f = flight.rate_rad_s, flight.acceleration_rad_s2, flight.specific_force_m_s2
            return np.asarray((f + np.cross(dw, r) + np.cross(w, np.cross(w, r))) @ turn)

        return world.Inertial(self._derive(3, force), self._derive(3, lambda flight: flight.rate_rad_s @ turn), 0.0)

    def angle_rad(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        self._check(at, JOINT_NAMES)
        return self.flight.q_rad[:, JOINT_NAMES.index(at)]

    def moment_n_m(self, at: str, axis: world.Axis = world.Z) -> FloatArray:
        """See ``world.Plant``."""
        self._check(at, (WRIST,))
        unit = np.asarray(axis) / np.linalg.norm(axis)
        return self._derive(1, lambda flight: np.asarray(flight.wrist_moment_n_m @ unit)[:, None])[:, 0]

    def force_n(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        self._check(at, (WRIST,))
        return self.flight.wrist_force_n

    def servo_torque_n_m(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        raise ScenarioError(f"no torque is known at {at!r}: the joints are moved as told; leave motor torques out")

    def wheel_rate_rad_s(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        names = list(self._scenario.wheel)
        if at not in names:
            return super().wheel_rate_rad_s(at)
        return self.flight.wheel_rad_s[:, names.index(at)]

    def thrust_n(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        if at not in {pulse.thruster for pulse in self._scenario.pulse}:
            return super().thrust_n(at)
        return self.actuators.thrust_n(at, np.arange(self.rows, dtype=np.float64) * self.step_s)

    def driven(self) -> Drivable:
        """What was drawn, to be moved by its drives, whose friction the mission does not have: the default, drawn.

        Raises:
            ScenarioError: it has wheels or thrusters.
        """
        if self._scenario.wheel or self._scenario.pulse:
            raise ScenarioError("drives move no vehicle with [wheel] or [[pulse]]: take them out, or fly the mission")
        own = self.base, self.arm, STEP_S, self.joint_offsets_m
        velocity = np.concatenate([np.zeros(3), self.release_rate_rad_s])
        efforts = dict.fromkeys(JOINT_NAMES, EFFORT_N_M)
        bodies = dict(zip(JOINT_NAMES, self.arm, strict=True)) | {"base": self.base}
        drives = drawn_drives(JointFriction(), efforts, bodies, self._drawn_last)
        models = free_flyer.world(None, *own), free_flyer.world(self.payload, *own)
        return Drivable(*models, JOINT_NAMES, drives, efforts, self.program.posture_rad, velocity)

    def truth(self) -> dict[str, Any]:
        """See ``world.Plant``; the payload in its own frame, which is the grasp."""
        c, inertia = self.payload.centre_of_mass_m, self.payload.inertia_kg_m2
        elements = {f"I_{name}_payload": float(inertia[place]) for name, place in _ELEMENTS.items()}
        return {
            "quantities": {
                "m_payload": self.payload.mass_kg,
                **{f"c_{axis}_payload": value for axis, value in zip("xyz", c.tolist(), strict=True)},
                **elements,
            },
            "capture_s": self.capture_s,
            "release_rate_rad_s": self.release_rate_rad_s,
            "base_mass_kg": self.base.mass_kg,
            "arm_mass_kg": [link.mass_kg for link in self.arm],
            "joint_offsets_m": self.joint_offsets_m,
            "imu_offsets_m": self.imu_offsets_m,
            **{f"axial_kg_m2_{one.name}": one.axial_kg_m2 for one in self.actuators.wheels},
        }

    def _part(self, flight: free_flyer.FreeFlightSignals, first: int, rows: int) -> _Part:
        """A flight as rows ``first ..`` of the finer grid; joints as on their motors' side."""
        q_rad = flight.q_rad + self._scenario.as_built.compliance_rad_N_m * flight.torque_n_m
        wrist = flight.wrist_force_n, flight.wrist_moment_n_m
        parts = q_rad, flight.rate_rad_s, flight.specific_force_m_s2, *wrist, flight.wheel_rad_s
        splines = tuple(CubicSpline(flight.time_s, values) for values in parts)
        return _Part(first, rows, float(flight.time_s[0]), splines, None)

    def _make(self, until: int) -> None:
        """Interpolate rows up to ``until``, and what is derived from them."""
        begun = self._made
        for part in self._parts:
            first, last = max(begun, part.first), min(until, part.first + part.rows)
            if first < last:
                self._refine(part, first, last)
        self._made = until
        new = TrueSignals(*(values[begun:until] for values in self.flight))
        for out, of in self._derived:
            out[begun:until] = of(new)

    def _refine(self, part: _Part, first: int, last: int) -> None:
        every = self._scenario.physics.integration_steps
        times_s = part.splines[0].x
        at_s = part.start_s + (times_s[1] - times_s[0]) / every * np.arange(first - part.first, last - part.first)
        q, rate, *others = part.splines
        refined = q(at_s), rate(at_s), rate(at_s, 1), *(other(at_s) for other in others)
        for rows, values in zip(self.flight, refined, strict=True):
            rows[first:last] = values
        if part.shock is not None and first == part.first:
            shock, flight = part.shock, self.flight
            flight.specific_force_m_s2[first] += shock.velocity_m_s / self.step_s
            flight.acceleration_rad_s2[first] += shock.rate_rad_s / self.step_s
            flight.wrist_force_n[first] += shock.wrist_impulse_n_s / self.step_s
            flight.wrist_moment_n_m[first] += shock.wrist_moment_n_m_s / self.step_s

    def _derive(self, columns: int, of: Callable[[TrueSignals], FloatArray]) -> FloatArray:
        """A signal (rows, columns) made of others, of those rows that there are and of each that comes."""
        track = Track(self.rows, columns)
        track.values[: self._made] = of(TrueSignals(*(values[: self._made] for values in self.flight)))
        self._tracks.append(track)
        self._derived.append((track.values, of))
        return track.values

    def forget(self, before: int) -> None:
        """See ``world.Plant``."""
        self.forgotten = max(self.forgotten, before)
        for track in self._tracks:
            track.forget(before)

    def _check(self, at: str, known: Iterable[str]) -> None:
        if at not in known:
            raise ScenarioError(f"there is no {at!r} to measure at; `at` is one of {', '.join(known)}")

    def _run_chunk(self) -> None:
        self.count += self.chunk
        if self._made < min(self.count, self.rows):
            self._make(min(self._made + _BLOCK * self.chunk, self.rows))


_ELEMENTS = {"xx": (0, 0), "xy": (0, 1), "yy": (1, 1), "xz": (0, 2), "yz": (1, 2), "zz": (2, 2)}


def as_built(scenario: FreeFlyerScenario, rng: np.random.Generator) -> tuple[Body, tuple[Body, ...]]:
    """The base and the links of the arm of a seed: the first that the plant draws."""
    base = _built(free_flyer.BASE, scenario.as_built.base, rng)
    return base, tuple(_built(link, scenario.as_built.link, rng) for link in free_flyer.ARM)


def _actuators(scenario: FreeFlyerScenario, rng: np.random.Generator) -> Actuators:
    """Wheels as built, their control, thrusters."""
    wheels = []
    for name, said in scenario.wheel.items():
        axial = said.axial_kg_m2 * (1.0 + said.inertia_relative * rng.standard_normal())
        place = [1e-3 * at for at in said.position_mm]
        wheels.append(Wheel.of(name, said.axis, place, said.mass_kg, (axial, said.across_kg_m2), said.start_rad_s))
    control = scenario.attitude
    hold = None if control is None else Hold(control.spring_N_m_rad, control.damper_N_m_s, control.torque_N_m)
    pulses = []
    for one in scenario.pulse:
        force_n, place_m = np.array(one.force_N), 1e-3 * np.array(one.position_mm)
        pulses.append(Pulse(one.at_s, one.at_s + one.duration_s, force_n, place_m, one.thruster))
    return Actuators(tuple(wheels), hold, tuple(pulses))


def mounting(scenario: FreeFlyerScenario, at: str) -> FloatArray:
    """Rotation from an IMU's axes to the base's, ``R_BS`` (3, 3).

    Raises:
        ScenarioError: no such place.
    """
    if at not in scenario.site:
        raise ScenarioError(f"there is no {at!r} to measure at; `at` is one of {', '.join(scenario.site)}")
    return _rotation(_quaternion(np.deg2rad(scenario.site[at].roll_pitch_yaw_deg)))


def _box(payload: Payload) -> Body:
    """The payload in the axes of the grasp."""
    size_m, centre_m = (1e-3 * np.asarray(v) for v in (payload.size_mm, payload.centre_of_mass_mm))
    box = Body.box(payload.mass_kg, size_m.tolist(), centre_m.tolist())
    return box.turned(_rotation(_quaternion(np.deg2rad(payload.roll_pitch_yaw_deg))))


def _built(drawn: Body, sigma: Built, rng: np.random.Generator) -> Body:
    """A part with its as-built errors."""
    return built(drawn, sigma.mass_relative, 1e-3 * sigma.centre_mm, sigma.inertia_relative, rng)


def _quaternion(roll_pitch_yaw: FloatArray) -> FloatArray:
    """(4,) w x y z of Rz(yaw) Ry(pitch) Rx(roll)."""
    quaternion = np.zeros(4)
    mujoco.mju_euler2Quat(quaternion, roll_pitch_yaw, "XYZ")
    return quaternion


def _rotation(quaternion: FloatArray) -> FloatArray:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quaternion)
    return out.reshape(3, 3)
