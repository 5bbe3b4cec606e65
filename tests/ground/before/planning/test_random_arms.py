"""Planned segments of random arms, judged by the simulator's dynamics (MuJoCo), which share nothing with the planner's.

The planner looks at limits every 40 ms with Pinocchio; here a segment is flown as it is written, at 100 Hz, by a
vehicle that floats at rest, holding each payload that the library says it is safe with.
"""

import re
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants import urdf_drawing
from hil_sim.plants.body import Solid
from hil_sim.plants.motions.spline import CubicSpline
from hil_sim.plants.planned import default_plan
from hil_sim.plants.urdf_model import Places, UrdfModel
from hil_sim.plants.vehicle_flight import VehicleFlight
from onboard import config
from onboard.cli import BAD_INPUT, main
from onboard.config.driving import Range, require_within, resampled
from onboard.config.segments import Library
from onboard.dynamics.model.inertia import RigidBody
from onboard.flight.estimate.problem.model import build_model
from onboard.ground.before.foresee.plan import plan_of
from onboard.ground.before.planning import segments
from onboard.ground.before.planning.limits import JointLimit, LimitsFile, MotionLimits
from onboard.ground.before.planning.planning import PlanningProblem, Search, SearchResult, Wanted, search
from onboard.ground.before.planning.segments import plan_segments, scaled
from tests.ground.before.planning.test_planning import SCENARIO

HZ = 100.0
BETWEEN = 1.02  # what a spline does between the ticks at which it is looked at
SHARE = 0.9  # of the URDF's limits that is used
MASSES_kg = (0.5, 6.0)


class Arm(NamedTuple):
    """Limits of a random free-flyer's motion, one of them near."""

    seed: int
    joints: int
    half: float = 2.5  # rad, of the range
    velocity: float = 3.0  # rad/s
    acceleration: float = 30.0  # rad/s^2
    effort: float = 200.0  # N m
    base_rate: float = 8.0  # rad/s


NEAR = {"half": 0.1, "velocity": 0.05, "acceleration": 0.05, "effort": 0.02, "base_rate": 0.01}


def urdf(arm: Arm) -> str:
    """Boxes of random size and density, random axes and places."""
    rng = np.random.default_rng(arm.seed)

    def link(name: str, mass: float) -> str:
        size, at = rng.uniform(0.05, 0.3, 3), rng.uniform(-0.1, 0.1, 3)
        x, y, z = mass / 12.0 * (size @ size - size**2)
        return (
            f'<link name="{name}"><inertial><origin xyz="{at[0]} {at[1]} {at[2]}"/><mass value="{mass}"/>'
            f'<inertia ixx="{x}" iyy="{y}" izz="{z}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )

    text, names = link("base", rng.uniform(10.0, 40.0)), ["base", *(f"link_{k}" for k in range(1, arm.joints + 1))]
    for k, (parent, child) in enumerate(pairwise(names), 1):
        axis, xyz, rpy = rng.standard_normal(3), rng.uniform(-0.3, 0.3, 3), rng.uniform(-3.0, 3.0, 3)
        axis /= np.linalg.norm(axis)
        numbers = {name: " ".join(map(str, value)) for name, value in (("xyz", xyz), ("rpy", rpy), ("axis", axis))}
        text += link(child, rng.uniform(0.5, 4.0))
        text += (
            f'<joint name="joint_{k}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{numbers["xyz"]}" rpy="{numbers["rpy"]}"/><axis xyz="{numbers["axis"]}"/><limit '
            f'lower="{-arm.half}" upper="{arm.half}" effort="{arm.effort}" velocity="{arm.velocity}"/></joint>'
        )
    return f'<robot name="random">{text}</robot>'


class Planned(NamedTuple):
    """A vehicle with its URDF read by the simulator, what it holds, and segments planned for it."""

    vehicle: config.Vehicle
    drawing: urdf_drawing.PlantDrawing
    body: RigidBody
    library: Library


def planned(arm: Arm) -> Planned:
    """Segments of a random arm."""
    with tempfile.TemporaryDirectory() as place:
        directory = Path(place)
        (directory / "drawn.urdf").write_text(urdf(arm))
        (directory / "over.toml").write_text(SCENARIO)
        assert main(["init", str(directory / "it"), "--base", "free", "--urdf", str(directory / "drawn.urdf")]) == 0
        path = directory / "it" / "vehicle.toml"
        vehicle, scenario = config.load(path), scenario_of(str(path), directory / "over.toml")
        own = JointLimit(acceleration=arm.acceleration)
        names = [joint.name for joint in build_model(vehicle).joints]
        said = LimitsFile(base_rate_rad_s=arm.base_rate, joint=dict.fromkeys(names, own))
        wanted = Wanted(2.0, 5.0, limits=said, starts=1, iterations=1, masses=MASSES_kg)
        library = plan_segments(vehicle, lambda period_s: default_plan(scenario, period_s), wanted, lambda _: None)
        body = plan_of(vehicle.with_row_rate(5.0), default_plan(scenario, 0.2)).payload
        drawing = urdf_drawing.read(vehicle.urdf_text, "drawn.urdf")
    assert body is not None
    return Planned(vehicle, drawing, body, library)


class Told:
    """A segment as the joints' motion."""

    def __init__(self, time_s: np.ndarray, q: np.ndarray) -> None:
        self._spline, self._end_s = CubicSpline(time_s, q, clamped=True), time_s[-1]

    def at(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        t = np.minimum(time_s, self._end_s)
        return self._spline(t), self._spline(t, 1), self._spline(t, 2)


@settings(
    max_examples=2,
    deadline=None,
    derandomize=True,
    database=None,
    phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)
@given(seed=st.integers(0, 10_000), joints=st.integers(1, 4), by=st.floats(0.5, 2.0))
@pytest.mark.parametrize("near", NEAR)
def test_no_segment_leaves_a_limit_with_a_payload_that_it_is_safe_with(
    near: str, seed: int, joints: int, by: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = Arm(seed, joints)._replace(**{near: by * NEAR[near]})
    monkeypatch.setattr(segments, "KINDS", ("all",))
    looked_at: list[Search] = []
    monkeypatch.setattr(segments, "search", lambda over, *how: (looked_at.append(over), search(over, *how))[1])
    vehicle, drawing, body, library = planned(arm)
    assert len(looked_at) == len(MASSES_kg)
    for over in looked_at:
        problem, basis = PlanningProblem(over), over.splines.basis(np.arange(0.0, over.splines.duration_s, 0.01))
        for corner in (problem.low, problem.high):  # a spline lies in the hull of its coefficients
            q = over.splines.move(basis, problem.coefficients(corner))[0]
            assert np.abs(q).max() <= SHARE * arm.half + 1e-9
            if near == "half":
                assert np.abs(q).max() > 0.98 * SHARE * arm.half  # all of the range may be used
    heaviest = [k for k, name in enumerate(library.names) if name.endswith(f"_{MASSES_kg[1]:g}kg")]
    assert (library.excess[heaviest] <= 0.0).all()
    flown = 0
    for k, q in enumerate(library.q):
        _, dq, ddq = Told(library.time_s, q).at(np.arange(0.0, library.time_s[-1], 0.01))
        assert np.abs(q).max() <= SHARE * arm.half + 1e-9
        assert np.abs(dq).max() <= BETWEEN * SHARE * arm.velocity
        assert np.abs(ddq).max() <= BETWEEN * arm.acceleration
        for m, mass in enumerate(MASSES_kg):
            model = UrdfModel(drawing, "free", (0.0, 0.0, 0.0), Places((drawing.root,), ()))
            held = scaled(body, mass)
            model.hold(vehicle.file.vehicle.payload_link, Solid(mass, held.centre_of_mass_m, held.inertia_kg_m2))
            flight = VehicleFlight(
                model, Told(library.time_s, q), Places((drawing.root,), ()), None, 1.0 / HZ, np.zeros(6)
            )
            rows = flight.advance(len(library.time_s) - 1)
            rate = np.linalg.norm(rows.sensors[:, model.sensor("gyro", drawing.root)], axis=1).max()
            assert rate <= BETWEEN * library.base_rate[k, m] + 1e-6  # to which asking adds the base's own
            if library.excess[k, m] <= 0.0:
                flown += 1
                assert np.abs(rows.torques).max() <= BETWEEN * SHARE * arm.effort
            if k in heaviest:
                assert rate <= arm.base_rate
    assert flown >= len(heaviest) * len(MASSES_kg)


@pytest.mark.parametrize("near", ["velocity", "effort"])
def test_a_motion_of_the_heaviest_that_breaks_a_limit_is_shrunk_until_it_keeps_all(
    near: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before anything is known these are flown: also where the search went on to motions that are too large."""

    def too_far(over: Search, *how: Any) -> SearchResult:
        found = search(over, *how)
        return found._replace(coefficients=4.0 * found.coefficients)

    monkeypatch.setattr(segments, "KINDS", ("all",))
    monkeypatch.setattr(segments, "search", too_far)
    library = planned(Arm(3, 2)._replace(**{near: NEAR[near]})).library
    [heaviest] = [k for k, name in enumerate(library.names) if name.endswith(f"_{MASSES_kg[1]:g}kg")]
    assert (library.excess[heaviest] <= 0.0).all()
    assert (library.excess[[k for k in range(len(library.names)) if k != heaviest]] > 0.0).any()


@pytest.fixture(scope="module")
def arm_of_three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its directory: vehicle.toml, over.toml."""
    directory = tmp_path_factory.mktemp("arm_of_three")
    (directory / "drawn.urdf").write_text(urdf(Arm(5, 3)))
    (directory / "over.toml").write_text(SCENARIO)
    assert main(["init", str(directory / "it"), "--base", "free", "--urdf", str(directory / "drawn.urdf")]) == 0
    return directory


_STANDS = st.tuples(st.floats(-2.5, 2.0), st.floats(0.1, 2.0), st.sampled_from([-0.2, 0.0, 0.1, 0.5, 0.9, 1.0, 1.2]))


@given(st.lists(_STANDS, min_size=3, max_size=3))
def test_an_arm_that_stands_outside_its_limits_has_no_room_and_inside_none_beyond_them(
    arm_of_three: Path, joints: list[tuple[float, float, float]]
) -> None:
    low, width, share = np.array(joints).T
    high, stands = low + width, low + share * width
    model = build_model(config.load(arm_of_three / "it" / "vehicle.toml"))
    names = [joint.name for joint in model.joints]
    said = {name: JointLimit(low=float(a), high=float(b)) for name, a, b in zip(names, low, high, strict=True)}
    outside = [name for name, q, a, b in zip(names, stands, low, high, strict=True) if not a < q < b]
    its = MotionLimits(model, LimitsFile(joint=said), None)
    if outside:
        with pytest.raises(config.ConfigError, match=f"^({'|'.join(outside)}) starts at "):
            its.room(stands)
        return
    down, up = its.room(stands)
    assert (down < 0.0).all()
    assert (up > 0.0).all()
    assert (stands + down >= low - 1e-12).all()
    assert (stands + up <= high + 1e-12).all()


@pytest.mark.parametrize("also", [[], ["--segments"]])
def test_no_motion_is_planned_from_outside_the_limits(
    arm_of_three: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], also: list[str]
) -> None:
    (tmp_path / "limits.toml").write_text("joint.joint_2 = { low = 2.3, high = 2.4 }\n")
    vehicle, over = str(arm_of_three / "it" / "vehicle.toml"), str(arm_of_three / "over.toml")
    asked = ["plan", vehicle, "--scenario", over, "--limits", str(tmp_path / "limits.toml"), *also]
    assert main([*asked, "--starts", "1", "--iterations", "1", "-o", str(tmp_path / "plan")]) == BAD_INPUT
    said = " ".join(capsys.readouterr().err.split())
    assert re.search(r"joint_2 starts at \S+, its limits are 2.3 to 2.4; widen them", said)
    assert not (tmp_path / "plan").exists()


@given(
    st.floats(0.2, 3.0),
    st.floats(0.2, 3.0),
    st.floats(0.5, 6.0),
    st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=6),
    st.floats(0.3, 2.0),
)
def test_a_motion_is_armed_if_and_only_if_it_keeps_range_rate_and_acceleration(
    half: float, rate: float, acceleration: float, points: list[float], apart_s: float
) -> None:
    time_s = apart_s * np.arange(len(points) + 2.0)
    at_s, q = resampled(time_s, np.array([0.0, *points, points[-1]])[:, None], 0.005)
    spline = CubicSpline(time_s, np.array([0.0, *points, points[-1]])[:, None], clamped=True)
    dense = np.linspace(0.0, time_s[-1], 4001)
    worst = [np.abs(spline(dense, order)).max() for order in range(3)] / np.array([half, rate, acceleration])
    try:
        require_within("it", "joint", at_s, q[:, 0], Range(-half, half, rate), acceleration)
    except config.ConfigError:
        assert worst.max() > 0.97
    else:
        assert worst.max() < 1.03
