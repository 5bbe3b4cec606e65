"""The planned values of a rehearsal, in the form of the flight app's model; none of the truth that is drawn per seed.

The joints' motion is the program's. What is drawn about a nominal value has that value here: the payload its middle
mass (geometric) and, unless given, the shape of a cube; the release its rms; the capture the middle of its window. The
sway of a prescribed base is not known before: several motions are drawn, each as likely as the flight's. MuJoCo is not
needed, so that a flight computer without it can plan too.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil_sim.arrays import BoolArray, FloatArray, IndexArray
from hil_sim.plants import urdf_drawing
from hil_sim.plants.body import Solid
from hil_sim.plants.motions.carrier import carried
from hil_sim.plants.motions.joint_swings import JointSwings
from hil_sim.plants.urdf_model import rotation
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import PayloadTable, Scenario

_RMS = 3.0**-0.5  # of a number drawn between -1 and 1
_SWAYS = 8  # motions of a prescribed base
_MOST_ROWS = 100_000  # of all of them


class BaseReadings(NamedTuple):
    """Motion of a prescribed base in its own axes, (n, 3) each."""

    rate_rad_s: FloatArray
    acceleration_rad_s2: FloatArray
    specific_force_m_s2: FloatArray  # at its origin


class Planned(NamedTuple):
    """A rehearsal before it is flown, on a grid of mission time."""

    time_s: FloatArray  # (n,)
    joints: tuple[str, ...]  # of the columns
    q: FloatArray  # (n, joints) rad or m
    dq: FloatArray
    ddq: FloatArray
    phase: IndexArray  # (n,)
    held: BoolArray  # (n,) the payload is
    bases: tuple[BaseReadings, ...]  # of a prescribed base: motions that it may make
    rate_rad_s: FloatArray  # (3,) of a floating base at the start
    velocity_m_s: FloatArray  # (3,)
    payload: Solid | None  # in its link's frame; None: nothing is held
    drawn_shape: bool  # the payload has the shape of its link in the URDF, where that has one
    drag: tuple[float, float]  # of each puck: N s/m, N


def default_plan(scenario: Scenario, period_s: float) -> Planned:
    """The rehearsal of a vehicle where no world is made: its motion is drawn as a world draws one.

    Args:
        scenario: of a vehicle of one's own.
        period_s: of the grid.

    Raises:
        ScenarioError: a drawing that cannot be moved.
    """
    joints = tuple(urdf_drawing.read(scenario.vehicle.urdf, scenario.vehicle.label).joints.values())
    program = JointSwings(scenario, joints, np.random.default_rng(1))
    return planned(scenario, program, tuple(joint.name for joint in joints), period_s)


class SwingRoom(NamedTuple):
    """Where in a rehearsal another motion of the joints fits: its longest swing with the payload held at its start."""

    scenario: Scenario  # with the swing as long as was asked for
    start_s: float
    end_s: float


def room_for_motion(scenario: Scenario, duration_s: float | None) -> SwingRoom:
    """Find the swing that another motion is to replace, and make it ``duration_s`` long where that is given.

    Args:
        scenario: of a vehicle of one's own.
        duration_s: of the new motion; the swing's where None.

    Raises:
        ScenarioError: a scenario with a motion of its own, or without such a swing.
    """
    if scenario.motion.csv is not None:
        raise ScenarioError("the scenario has a motion (motion.csv); take it out to plan another")
    starts = np.cumsum([0.0, *(step.duration_s for step in scenario.sequence)])
    held = _held(scenario, starts) if scenario.payload is not None else np.ones(len(starts), bool)
    swings = [k for k, step in enumerate(scenario.sequence) if step.action == "swing" and held[k]]
    if not swings:
        raise ScenarioError('no [[sequence]] with action = "swing" begins with the payload held; add it')
    at = max(swings, key=lambda k: scenario.sequence[k].duration_s)
    length = scenario.sequence[at].duration_s if duration_s is None else duration_s
    step = scenario.sequence[at].model_copy(
        update={"duration_s": length, "ramp_s": min(scenario.sequence[at].ramp_s, 0.5 * length)}
    )
    sequence = (*scenario.sequence[:at], step, *scenario.sequence[at + 1 :])
    start_s = float(starts[at])
    return SwingRoom(scenario.model_copy(update={"sequence": sequence}), start_s, start_s + length)


def with_segments(scenario: Scenario, segments: Path, duration_s: float) -> Scenario:
    """A rehearsal in which the flight computer asks for motions in place of the swing of :func:`room_for_motion`.

    What would follow that swing is left out, but for a release by time.

    Args:
        scenario: of a vehicle of one's own.
        segments: the file of motions.
        duration_s: longest time that it may ask.

    Raises:
        ScenarioError: see :func:`room_for_motion`.
    """
    room = room_for_motion(scenario, duration_s)
    sequence, at_s = [], 0.0
    for step in room.scenario.sequence:
        sequence.append(step.model_copy(update={"action": "asked"}) if at_s == room.start_s else step)
        if at_s == room.start_s:
            break
        at_s += step.duration_s
    motion = room.scenario.motion.model_copy(update={"segments": str(segments)})
    return room.scenario.model_copy(update={"sequence": tuple(sequence), "motion": motion})


def planned(scenario: Scenario, program: JointSwings, joints: Sequence[str], period_s: float) -> Planned:
    """A rehearsal as planned.

    Args:
        scenario: of a vehicle of one's own.
        program: its motion.
        joints: names of the program's columns.
        period_s: of the grid.
    """
    time_s: FloatArray = period_s * np.arange(int(program.duration_s / period_s), dtype=np.float64)
    ends = np.array([span.end_s for span in program.spans])
    codes = np.array([span.code for span in program.spans])
    phase = codes[np.minimum(np.searchsorted(ends, time_s, side="right"), len(codes) - 1)]
    release = scenario.release
    prescribed = scenario.vehicle.base == "prescribed"
    pucks = 0.5 * scenario.table.viscous_N_s_m, 0.5 * scenario.table.coulomb_N
    body, drawn_shape = _payload(scenario.payload)
    return Planned(
        *(time_s, tuple(joints), *program.at(time_s), phase, _held(scenario, time_s)),
        _sways(scenario, time_s) if prescribed else (),
        _RMS * release.rate_rad_s * np.ones(3) + np.asarray(release.spin_rad_s),
        _RMS * release.velocity_m_s * np.ones(3),
        *(body, drawn_shape, pucks),
    )


def _held(scenario: Scenario, time_s: FloatArray) -> BoolArray:
    if scenario.payload is None:
        return np.zeros(len(time_s), bool)
    from_s, until_s, caught, gone = -np.inf, np.inf, scenario.capture, scenario.ejection
    if caught is not None:
        from_s = (
            0.5 * (caught.earliest_s + caught.latest_s) if caught.phase is None else scenario.start_of(caught.phase)
        )
    if gone is not None:
        until_s = scenario.start_of(gone.phase) if gone.phase is not None else float(gone.at_s or 0.0)
    return np.asarray((time_s >= from_s) & (time_s < until_s))


def _payload(table: PayloadTable | None) -> tuple[Solid | None, bool]:
    if table is None:
        return None, False
    mass = float(np.sqrt(np.prod(table.mass_kg)))
    size = np.full(3, (mass / table.density_kg_m3) ** (1.0 / 3.0))
    if table.size_mm is not None:
        size = 1e-3 * np.asarray(table.size_mm)
    centre = np.array([0.0, 0.0, 0.5 * size[2]])
    if table.centre_of_mass_mm is not None:
        centre = 1e-3 * np.asarray(table.centre_of_mass_mm)
    turn = rotation(np.radians(table.roll_pitch_yaw_deg or (0.0, 0.0, 0.0)))
    body = Solid.box(mass, size.tolist(), centre.tolist()).turned(turn)
    return body, table.size_mm is None and table.centre_of_mass_mm is None


def _sways(scenario: Scenario, time_s: FloatArray) -> tuple[BaseReadings, ...]:
    """Several, or one where all are alike: a base that is prescribed."""
    count = max(2, min(_SWAYS, _MOST_ROWS // len(time_s)))  # of a long motion each is as telling as the next
    found = [_readings(scenario, time_s, seed) for seed in range(1, count + 1)]
    alike = all(np.array_equal(one, other) for one, other in zip(found[0], found[1], strict=True))
    return tuple(found[:1] if alike else found)


def _readings(scenario: Scenario, time_s: FloatArray, seed: int) -> BaseReadings:
    rigid = scenario.model_copy(update={"vibration": None})  # too fast for the grid, and nothing that is planned
    path = carried(rigid, float(time_s[1] - time_s[0]), len(time_s), np.random.default_rng(seed))
    felt = path.acceleration[:, :3] - np.asarray(scenario.physics.gravity_m_s2)
    real, vector = path.pose[:, 3:4], path.pose[:, 4:]  # unit quaternion of the base's axes
    across = np.cross(felt, vector)
    turned = felt + 2.0 * (real * across + np.cross(across, vector))
    return BaseReadings(path.velocity[:, 3:], path.acceleration[:, 3:], np.asarray(turned, np.float64))
