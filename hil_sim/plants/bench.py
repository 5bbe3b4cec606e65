"""Calibration benches: a turntable, known masses on a load cell, the stops of a joint, a bifilar pendulum, a balance.

Each is a short prescribed history of true signals with the imperfections that such a bench has: positions that are held
within a fraction of a milliradian, a table that is not quite level, masses within their class, the Earth's rotation,
hanging weights that sway, bodies that hang a little askew, drag. The instruments add their own errors as in flight.

Gravity is that of the place (:data:`LATITUDE_deg`), by the WGS 84 formula, typed here from its definition.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import mujoco
import numpy as np

from hil_sim.arrays import FloatArray
from hil_sim.plants import world
from hil_sim.plants.body import Solid
from hil_sim.plants.motions.motion import PhaseSpan, Program
from hil_sim.scenario.tables import ScenarioError

STEP_s = 5e-4
CHUNK = 40
LATITUDE_deg = 38.99  # College Park
EARTH_RATE_rad_s = 7.292115e-5
HELD_rad = 3e-4  # 1 sigma by axis, of a position on the table
TURNED_rad = 2e-4  # of a whole turn
LEVEL_rad = 5e-4  # of the table
STOP_rad = 3e-4  # of a joint that is pushed against its stop
ASKEW_rad = 4e-3  # of a body that hangs by two strings
HANGS = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]], np.float64)


def gravity_m_s2() -> float:
    """Normal gravity on the WGS 84 ellipsoid (Somigliana) at the bench."""
    s = np.sin(np.deg2rad(LATITUDE_deg)) ** 2
    return float(9.7803253359 * (1.0 + 0.00193185265241 * s) / np.sqrt(1.0 - 0.00669437999013 * s))


class _Bench(Program):
    def __init__(self, duration_s: float) -> None:
        self.spans = (PhaseSpan(0, "bench", 0.0, duration_s),)


@dataclass
class BenchTruth:
    """True signals on the grid, rows (n, ...); what a bench does not move is at rest."""

    specific_force_m_s2: FloatArray | None = None  # (n, 3)
    rate_rad_s: FloatArray | None = None  # (n, 3)
    angle_rad: FloatArray | None = None  # (n,) of the joint
    force_n: FloatArray | None = None  # (n,) along the cell's axis
    moment_n_m: FloatArray | None = None  # (n,)
    truth: dict[str, Any] = field(default_factory=dict)


class BenchPlant(world.Plant):
    """A bench: its signals, held at their last row beyond the end.

    Args:
        signals: of the whole run.
        axis: of the load cell, flange axes, (3,).
        turn: rotation from the axes of the signals to those of an IMU, by its place.
    """

    def __init__(
        self, signals: BenchTruth, axis: FloatArray, turn: Callable[[str], FloatArray] = lambda at: np.eye(3)
    ) -> None:
        arrays = [one for one in vars(signals).values() if isinstance(one, np.ndarray)]
        given = len(arrays[0])
        self.step_s, self.chunk, self.count = STEP_s, CHUNK, 0
        self.rows = CHUNK * (given // CHUNK + 2)
        self.program = _Bench(given * STEP_s)
        self._signals, self._axis, self._turn = signals, axis / np.linalg.norm(axis), turn

    def _rows(self, values: FloatArray | None, width: int, rest: Sequence[float]) -> FloatArray:
        if values is None:
            return np.tile(np.asarray(rest, np.float64), (self.rows, 1))
        columns = values.reshape(len(values), width)
        return np.concatenate([columns, np.repeat(columns[-1:], self.rows - len(columns), axis=0)])

    def inertial(self, at: str) -> world.Inertial:
        """See ``world.Plant``."""
        turn, s = self._turn(at), self._signals
        force = self._rows(s.specific_force_m_s2, 3, (0.0, 0.0, gravity_m_s2()))
        return world.Inertial(force @ turn, self._rows(s.rate_rad_s, 3, (0.0, 0.0, 0.0)) @ turn, 0.0)

    def angle_rad(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        return self._rows(self._signals.angle_rad, 1, (0.0,))[:, 0]

    def moment_n_m(self, at: str, axis: world.Axis = world.Z) -> FloatArray:
        """See ``world.Plant``."""
        return self._rows(self._signals.moment_n_m, 1, (0.0,))[:, 0]

    def force_n(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        return self._rows(self._signals.force_n, 1, (0.0,)) * self._axis

    def servo_torque_n_m(self, at: str) -> FloatArray:
        """See ``world.Plant``."""
        return np.zeros(self.rows)

    def truth(self) -> dict[str, Any]:
        """See ``world.Plant``."""
        return {"quantities": {}, **self._signals.truth}

    def _run_chunk(self) -> None:
        self.count += self.chunk


# Turntable


class _Move(NamedTuple):
    """A rotation about an axis fixed in the sensor, from rest to rest; about none: rest."""

    duration_s: float
    axis: FloatArray
    angle_rad: float


def turntable(
    rng: np.random.Generator, rest_s: float = 10.0, turn_s: float = 8.0, long_rest_s: float = 0.0, faces: str = "xyz"
) -> BenchTruth:
    """Each face up in turn, and on it a whole turn each way; at the end a long rest for the Allan deviation.

    Args:
        rng: draws how well each position is held, the table's tilt, how far each turn goes.
        rest_s: on each face before its turns.
        turn_s: of a turn.
        long_rest_s: at the end.
        faces: axes whose positive and negative side are up in turn.
    """
    level = _small(LEVEL_rad * rng.standard_normal(3))
    up = level @ np.array([0.0, 0.0, 1.0])  # of the table, in the room's axes
    held = [level @ _upright(face) @ _small(HELD_rad * rng.standard_normal(3)) for face in _sides(faces)]
    none = np.zeros(3)
    moves: list[_Move] = []
    R = held[0]
    for number, position in enumerate(held):
        if number:
            moves.append(_Move(3.0, *_between(R, position)))
        R = position
        moves.append(_Move(rest_s, none, 0.0))
        for sign in (1.0, -1.0):
            moves.append(_Move(turn_s, R.T @ up, sign * (2.0 * np.pi + TURNED_rad * rng.standard_normal())))
            moves.append(_Move(3.0, none, 0.0))
    if long_rest_s:
        moves.append(_Move(long_rest_s, none, 0.0))
    force, rate = _attitude(moves, held[0])
    return BenchTruth(specific_force_m_s2=force, rate_rad_s=rate, truth={"latitude_deg": LATITUDE_deg})


def _sides(axes: str) -> Iterator[FloatArray]:
    for axis in axes:
        for sign in (1.0, -1.0):
            yield sign * np.eye(3)["xyz".index(axis)]


def _upright(face: FloatArray) -> FloatArray:
    """Room from sensor (3, 3), with ``face`` of the sensor up."""
    other = np.roll(face, 1)
    return np.stack([other, np.cross(face, other), face])


def _small(rotation: FloatArray) -> FloatArray:
    angle = float(np.linalg.norm(rotation))
    return _turned(np.eye(3), rotation / angle if angle else rotation, np.full(3, angle)).T


def _between(R: FloatArray, S: FloatArray) -> tuple[FloatArray, float]:
    """Axis, in the axes of R, and angle of the rotation from R to S."""
    quaternion, rotation = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quaternion, (R.T @ S).ravel())
    mujoco.mju_quat2Vel(rotation, quaternion, 1.0)
    angle = float(np.linalg.norm(rotation))
    return rotation / max(angle, 1e-12), angle


def _turned(rows: FloatArray, axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Row vectors (n, 3) turned by ``angle`` (n,) about ``axis`` (Rodrigues)."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    turned: FloatArray = rows * c + np.cross(axis, rows) * s + np.outer(rows @ axis, axis) * (1.0 - c)
    return turned


def _attitude(moves: Sequence[_Move], start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Specific force and rate in the sensor's axes, (n, 3) each; moves go by a raised cosine of the rate."""
    latitude = np.deg2rad(LATITUDE_deg)
    earth = EARTH_RATE_rad_s * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    gravity = np.array([0.0, 0.0, gravity_m_s2()])
    forces, rates, R = [], [], start
    lever = np.array([0.03, -0.02, 0.01])  # of the sensor from the table's axis
    for duration_s, axis, angle_rad in moves:
        n = round(duration_s / STEP_s)
        s = (np.arange(n) + 1.0) / n
        theta = angle_rad * (s - np.sin(2.0 * np.pi * s) / (2.0 * np.pi))
        w = angle_rad / duration_s * (1.0 - np.cos(2.0 * np.pi * s))
        dw = angle_rad / duration_s**2 * 2.0 * np.pi * np.sin(2.0 * np.pi * s)
        turning = np.outer(w, axis)
        swing = np.cross(np.outer(dw, axis), lever) + np.cross(turning, np.cross(turning, lever))
        forces.append(_turned(np.tile(R.T @ gravity, (n, 1)), -axis, theta) + swing)
        rates.append(turning + _turned(np.tile(R.T @ earth, (n, 1)), -axis, theta))
        if angle_rad:
            R = R @ _small(angle_rad * axis)
    return np.concatenate(forces), np.concatenate(rates)


# Masses and stops


def _levels(levels: Sequence[float], rest_s: float, between_s: float = 2.0) -> FloatArray:
    """Each level for ``rest_s``, changes smooth between."""
    parts = []
    s = (np.arange(round(between_s / STEP_s)) + 0.5) * STEP_s / between_s
    smooth = s - np.sin(2.0 * np.pi * s) / (2.0 * np.pi)
    for number, level in enumerate(levels):
        if number:
            parts.append(levels[number - 1] + (level - levels[number - 1]) * smooth)
        parts.append(np.full(round(rest_s / STEP_s), level))
    return np.concatenate(parts)


def masses(
    rng: np.random.Generator, masses_kg: Sequence[float], sigma_kg: float, arm_m: float | None, rest_s: float = 12.0
) -> BenchTruth:
    """Masses hung on a cell one after the other; each sways until it hangs still.

    Args:
        rng: draws what each mass truly is, and how it sways.
        masses_kg: as they are marked.
        sigma_kg: of each but none.
        arm_m: from the joint's axis, horizontal, where the cell measures a moment; None: a force.
        rest_s: for each.
    """
    true_kg = [kg + (sigma_kg * float(rng.standard_normal()) if kg else 0.0) for kg in masses_kg]
    force = _levels([kg * gravity_m_s2() for kg in true_kg], rest_s)
    period = round((rest_s + 2.0) / STEP_s)
    t = STEP_s * np.arange(period)
    for number in range(len(true_kg)):
        rows = slice(number * period, min((number + 1) * period, len(force)))
        sway = 0.03 * np.exp(-t / 1.2) * np.cos(2.0 * np.pi * 1.3 * t + rng.uniform(0.0, 2.0 * np.pi))
        force[rows] *= 1.0 + sway[: rows.stop - rows.start]
    told = {"masses_kg": true_kg}
    return BenchTruth(force_n=force, truth=told) if arm_m is None else BenchTruth(moment_n_m=force * arm_m, truth=told)


def stops(rng: np.random.Generator, angles_rad: Sequence[float], rest_s: float = 5.0) -> BenchTruth:
    """A joint pushed against its stops, one after the other."""
    held = [float(angle + STOP_rad * rng.standard_normal()) for angle in angles_rad]
    return BenchTruth(angle_rad=_levels(held, rest_s), truth={"angles_rad": held})


# Bifilar pendulum


class Strings(NamedTuple):
    """Two parallel strings, as they truly are."""

    spacing_m: float
    length_m: float


def bifilar(
    rng: np.random.Generator,
    body: Solid,
    strings: Strings,
    axes: FloatArray = HANGS,
    amplitude_rad: float = np.deg2rad(25.0),
    swing_s: float = 30.0,
    drag: tuple[float, float] = (5.0, 15.0),
    scale_sigma_kg: float = 0.005,
) -> BenchTruth:
    """The body hung by each of its axes in turn, still, then let go to swing about the vertical.

    Energy: ``T = (I w^2 + m z'^2) / 2``, ``V = m g z``, the string's end ``h^2 = (h - z)^2 + D^2 (1 - cos th) / 2``
    exactly; drag in proportion to rate and to its square, ``drag`` per mille of ``I`` per second and per radian.

    Args:
        rng: draws how askew each hang is, the amplitude within a tenth, and how it sways.
        body: in its own axes.
        strings: as they are.
        axes: of the body that are vertical in turn, (k, 3).
        amplitude_rad: of the first swing.
        swing_s: of each.
        drag: see above.
        scale_sigma_kg: of the scale that the body was weighed on.
    """
    rates, forces, told = [], [], []
    weighed_kg = body.mass_kg + scale_sigma_kg * float(rng.standard_normal())
    g = gravity_m_s2()
    for drawn in axes / np.linalg.norm(axes, axis=1, keepdims=True):
        up = drawn + ASKEW_rad * rng.standard_normal(3)
        up /= np.linalg.norm(up)
        inertia = float(up @ body.inertia_kg_m2 @ up)
        told.append(inertia)
        start = amplitude_rad * rng.uniform(0.9, 1.1)
        w = _swing(inertia, body.mass_kg, g, strings, start, swing_s, drag)
        rest = round(4.0 / STEP_s)
        pull = np.linspace(0.0, 1.0, round(2.0 / STEP_s))
        pulled = start / 2.0 * (1.0 - np.cos(2.0 * np.pi * pull))  # rate of the pull, integrates to the amplitude
        w = np.concatenate([np.zeros(rest), pulled, w, np.zeros(round(1.0 / STEP_s))])
        side = np.cross(up, np.roll(drawn, 1))
        side /= np.linalg.norm(side)
        sway_w = np.sqrt(g / strings.length_m)
        clock = STEP_s * np.arange(len(w))
        sway = 1e-3 * np.sin(sway_w * clock + rng.uniform(0.0, 6.28)) * (clock > 6.0)  # rad
        sway_rate = np.gradient(sway, STEP_s)
        rates.append(np.outer(w, up) + np.outer(sway_rate, side))
        forces.append(np.tile(g * up, (len(w), 1)) + np.outer(g * sway, np.cross(up, side)))
    return BenchTruth(
        rate_rad_s=np.concatenate(rates),
        specific_force_m_s2=np.concatenate(forces),
        truth={
            "inertia_about_hangs_kg_m2": told,
            "inertia_kg_m2": body.inertia_kg_m2,
            "mass_kg": body.mass_kg,
            "weighed_kg": weighed_kg,
        },
    )


def _swing(
    inertia: float, m: float, g: float, strings: Strings, start: float, swing_s: float, drag: tuple[float, float]
) -> FloatArray:
    """Rate of a swing that begins at rest at ``start`` rad, (n,)."""
    from scipy.integrate import solve_ivp  # noqa: PLC0415 - 0.1 s of every start

    D, h = strings
    c, k = 1e-3 * inertia * drag[0], 1e-3 * inertia * drag[1]

    def slope(_: float, state: FloatArray) -> tuple[float, float]:
        th, w = float(state[0]), float(state[1])
        left = np.sqrt(h * h - 0.5 * D * D * (1.0 - np.cos(th)))
        dz = 0.25 * D * D * np.sin(th) / left
        ddz = 0.25 * D * D * np.cos(th) / left + dz * dz / left
        return w, float((-m * dz * (g + ddz * w * w) - c * w - k * w * abs(w)) / (inertia + m * dz * dz))

    t = STEP_s * np.arange(round(swing_s / STEP_s))
    solved = solve_ivp(slope, (0.0, swing_s), (start, 0.0), "DOP853", t, rtol=1e-9, atol=1e-10)
    return np.asarray(solved.y[1], np.float64)


# Balance


def balance(rng: np.random.Generator, body: Solid, rig: Sequence[Mapping[str, Any]], rest_s: float = 6.0) -> BenchTruth:
    """A body on a hinge, held by a cell, in several orientations: the force that MuJoCo's inverse dynamics asks for.

    Args:
        rng: draws how well each place is met, 0.05 mm and 0.2 mrad.
        body: in its own axes.
        rig: by orientation, in the body's axes: ``up``, ``pivot_m``, ``hinge``, ``support_m``, ``push``.
        rest_s: of each.
    """
    g = gravity_m_s2()
    held, ups = [], []
    for one in rig:
        up = np.asarray(one["up"], np.float64)
        up = up / np.linalg.norm(up) @ _small(2e-4 * rng.standard_normal(3))
        pivot = np.asarray(one["pivot_m"]) + 5e-5 * rng.standard_normal(3)
        support = np.asarray(one["support_m"]) + 5e-5 * rng.standard_normal(3)
        hinge = np.asarray(one["hinge"], np.float64) / np.linalg.norm(one["hinge"])
        push = np.asarray(one["push"], np.float64) / np.linalg.norm(one["push"])
        held.append(float(_hinge_torque(body, -g * up, pivot, hinge) / (hinge @ np.cross(support - pivot, push))))
        ups.append(up)
    levels = [level for force in held for level in (force, 0.0)]
    force = _levels(levels, rest_s)
    period = 2 * round((rest_s + 2.0) / STEP_s)
    up_rows = np.repeat(np.array(ups), period, axis=0)[: len(force)]
    return BenchTruth(force_n=force, specific_force_m_s2=g * up_rows, truth={"forces_N": held, "mass_kg": body.mass_kg})


def part(rng: np.random.Generator, body: Solid, rig: Mapping[str, Any]) -> dict[str, Any]:
    """A part on knife edges and on scales: the rig with what was read.

    Args:
        rng: draws how well places are met, 0.05 mm, how level it is, 0.2 mrad, and what the scales add.
        body: in its own axes.
        rig: ``edge`` (``up``, ``edge``), ``scales`` (``up``, ``supports_m``), ``read_sigma_kg``, ``scale_relative``.

    Raises:
        ScenarioError: a part that would tip off its supports.
    """
    c, gain = np.asarray(body.centre_of_mass_m), 1.0 + rig["scale_relative"] * float(rng.standard_normal())
    edges, scales = [], []
    for one in rig["edge"]:
        up = _askew(rng, one["up"])
        along = np.asarray(one["edge"], np.float64)
        below = np.asarray(one["point_m"], np.float64)
        across = np.cross(up, along)
        across /= np.linalg.norm(across)
        found = below + across * (across @ (c - below)) + 5e-5 * rng.standard_normal(3)
        edges.append({**one, "point_m": found.tolist()})
    for one in rig["scales"]:
        up, places = _askew(rng, one["up"]), np.asarray(one["supports_m"], np.float64)
        places = places + 5e-5 * rng.standard_normal(places.shape)
        level = np.eye(3) - np.outer(up, up)
        # forces that add up to the weight, and whose moments about the centre of mass add up to none
        ways = np.linalg.svd((places - places.mean(axis=0)) @ level)[2][: len(places) - 1]  # two bars leave one free
        share = np.linalg.solve(np.vstack([np.ones(len(places)), ways @ (places - c).T]), np.eye(len(places))[0])
        if share.min() < 0.0:
            raise ScenarioError(f"the part would tip off supports_m {one['supports_m']}; put them farther apart")
        read = gain * body.mass_kg * share + rig["read_sigma_kg"] * rng.standard_normal(len(places))
        scales.append({**one, "read_kg": read.tolist()})
    return {"edge": edges, "scales": scales}


def _askew(rng: np.random.Generator, up: Sequence[float]) -> FloatArray:
    return np.asarray(np.array(up) / np.linalg.norm(up) @ _small(2e-4 * rng.standard_normal(3)), np.float64)


def _hinge_torque(body: Solid, gravity: FloatArray, pivot: FloatArray, hinge: FloatArray) -> float:
    """Torque about the hinge that holds the body."""
    I = body.inertia_kg_m2  # noqa: E741
    full = (I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])

    def text(values: Sequence[float] | FloatArray) -> str:
        return " ".join(repr(float(value)) for value in values)

    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="{text(gravity)}"/><worldbody><body>'
        f'<joint type="hinge" pos="{text(pivot)}" axis="{text(hinge)}"/>'
        f'<inertial pos="{text(body.centre_of_mass_m)}" mass="{body.mass_kg!r}" fullinertia="{text(full)}"/>'
        "</body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_inverse(model, data)
    return float(data.qfrc_inverse[0])
