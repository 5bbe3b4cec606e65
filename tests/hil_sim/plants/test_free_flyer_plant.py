"""The free-flyer of a mission against mechanics by hand: kinematics and masses typed from the drawing, Newton, Euler.

The hand side works in base axes: links turn about z, y, z, y, z; accelerations come from differences of positions.
"""

import re

import numpy as np
import pytest

from hil_sim.mission import Mission
from hil_sim.plants import free_flyer
from hil_sim.plants.arm_swings import ArmSwings
from hil_sim.plants.free_flyer_plant import FreeFlyerPlant
from hil_sim.plants.world import NotYetComputedError
from hil_sim.scenario.load import ScenarioError, load

MOUNTS_m = [0.205, 0.100, 0.260, 0.090, 0.140]  # of each joint along z of the link before
AXES = "zyzyz"
GRASP_m = np.array([0.0, 0.0, 0.090])
IMU_m, R_BS = np.array([0.120, -0.080, 0.050]), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
STEP_S = 5e-4
SHORT = {
    "sequence": [
        {"phase": 0, "action": "hold", "duration_s": 0.3},
        {
            "phase": 1,
            "action": "swing",
            "duration_s": 3.5,
            "ramp_s": 1.2,
            "swing_deg": 20.0,
            "tones": 3,
            "band_Hz": [0.1, 0.6],
        },
        {"phase": 9, "action": "hold", "duration_s": 0.2},
    ],
    "capture": {"earliest_s": 1.6, "latest_s": 2.4, "velocity_sigma_m_s": 0.03, "rate_sigma_rad_s": 0.05},
}


def flown(scenario, seed: int) -> FreeFlyerPlant:
    """A plant that is computed to its end."""
    made = FreeFlyerPlant(scenario, np.random.default_rng(seed))
    made.advance(made.program.duration_s + 1.0)
    return made


@pytest.fixture(scope="module")
def plant() -> FreeFlyerPlant:
    return flown(load("dymaflex", SHORT), 5)


def turn(axis: str, angle):
    """(n, 3, 3)"""
    c, s, o, i = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    rows = [[c, -s, o], [s, c, o], [o, o, i]] if axis == "z" else [[c, o, s], [o, i, o], [-s, o, c]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def links(q, offsets_m):
    """Axes and origins of the five links in the base, (5, n, 3, 3) and (5, n, 3)."""
    R, p = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    found = []
    for joint, (axis, along) in enumerate(zip(AXES, MOUNTS_m, strict=True)):
        p = p + R @ (np.array([0.0, 0.0, along]) + offsets_m[joint])
        R = R @ turn(axis, q[:, joint])
        found.append((R, p))
    return [np.array(parts) for parts in zip(*found, strict=True)]


def base_motion(plant):
    """Rate, angular acceleration, specific force of the base's origin, base axes, each (n, 3)."""
    w = plant.flight.rate_rad_s @ R_BS.T
    dw = np.gradient(w, STEP_S, axis=0)
    f = plant.flight.specific_force_m_s2 @ R_BS.T
    return w, dw, f - np.cross(dw, IMU_m) - np.cross(w, np.cross(w, IMU_m))


def felt(plant, r):
    """Acceleration less gravity, base axes, of a point at r (n, 3) in the base."""
    w, dw, f = base_motion(plant)
    dr = np.gradient(r, STEP_S, axis=0)
    ddr = np.gradient(dr, STEP_S, axis=0)
    return f + np.cross(dw, r) + np.cross(w, np.cross(w, r)) + 2.0 * np.cross(w, dr) + ddr


def away_from_the_shock(plant):
    k = round(plant.capture_s / STEP_S)
    n = round(plant.program.duration_s / STEP_S)
    rows = np.arange(100, n - 100)
    return rows[np.abs(rows - k) > 30], k


def test_the_wrist_carries_what_it_takes_to_move_all_beyond_it(plant) -> None:
    R, p = links(plant.flight.q_rad, plant.joint_offsets_m)
    rows, k = away_from_the_shock(plant)
    force, moment = np.zeros_like(p[4]), np.zeros_like(p[4])
    w_B, _, _ = base_motion(plant)
    spin = np.gradient(R[4], STEP_S, axis=0) @ R[4].swapaxes(1, 2)
    w = w_B + np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
    dw = np.gradient(w, STEP_S, axis=0) + np.cross(w_B, w)
    for body, place, since in ((plant.arm[4], np.zeros(3), 0), (plant.payload, GRASP_m, k)):
        c = p[4] + R[4] @ (place + body.centre_of_mass_m)
        held = (np.arange(len(c)) >= since)[:, None]
        needed = body.mass_kg * felt(plant, c)
        I = R[4] @ body.inertia_kg_m2 @ R[4].swapaxes(1, 2)  # noqa: E741
        turning = (I @ dw[..., None])[..., 0] + np.cross(w, (I @ w[..., None])[..., 0])
        force += held * needed
        moment += held * (turning + np.cross(c - p[4], needed))
    to_link = R[4].swapaxes(1, 2)
    expected = (to_link @ force[..., None])[..., 0], (to_link @ moment[..., None])[..., 0]
    given = plant.force_n("wrist"), plant.flight.wrist_moment_n_m
    for ours, theirs, two_of_a_thousand in zip(given, expected, (2e-3, 2e-3), strict=True):
        size = np.abs(theirs[rows]).max()
        assert size > 0.1
        np.testing.assert_allclose(ours[rows], theirs[rows], rtol=0, atol=two_of_a_thousand * size)
    np.testing.assert_array_equal(plant.moment_n_m("wrist"), plant.flight.wrist_moment_n_m[:, 2])


def test_the_shock_at_the_wrist_is_what_base_and_arm_lose(plant) -> None:
    """Everything proximal to the flange changes its momentum by minus the impulse through it; joint rates go on."""
    _, k = away_from_the_shock(plant)
    R, p = links(plant.flight.q_rad[k : k + 1], plant.joint_offsets_m)
    flight = plant.flight
    dw = R_BS @ flight.acceleration_rad_s2[k] * STEP_S
    dv = R_BS @ flight.specific_force_m_s2[k] * STEP_S - np.cross(dw, IMU_m)
    lost = plant.base.mass_kg * (dv + np.cross(dw, plant.base.centre_of_mass_m))
    for link, body in enumerate(plant.arm[:4]):
        lost += body.mass_kg * (dv + np.cross(dw, p[link, 0] + R[link, 0] @ body.centre_of_mass_m))
    impulse = flight.wrist_force_n[k] * STEP_S
    assert np.linalg.norm(impulse) > 0.02
    smooth_part_of_one_row = 2e-3 * np.linalg.norm(impulse) + 1e-3
    np.testing.assert_allclose(R[4, 0] @ impulse, -lost, rtol=0, atol=smooth_part_of_one_row)


def test_rate_and_its_jump_are_the_integral_of_the_acceleration(plant) -> None:
    _, k = away_from_the_shock(plant)
    rate, acceleration = plant.flight.rate_rad_s, plant.flight.acceleration_rad_s2
    jump = rate[k] - rate[k - 1]
    assert np.linalg.norm(jump) > 1e-3
    one_smooth_step = 2e-4
    np.testing.assert_allclose(acceleration[k] * STEP_S, jump, rtol=0, atol=one_smooth_step)
    np.testing.assert_allclose(
        rate[k - 1] - rate[0], STEP_S * acceleration[: k - 1].sum(axis=0), rtol=0, atol=one_smooth_step
    )


def test_an_imu_feels_its_place_and_its_axes(plant) -> None:
    rows, _ = away_from_the_shock(plant)
    base, other = plant.inertial("imu_base"), plant.inertial("imu_2")
    assert np.abs(plant.imu_offsets_m["imu_base"]).max() > 1e-4
    own = felt(plant, np.tile(IMU_m + plant.imu_offsets_m["imu_base"], (len(base.rate_rad_s), 1)))
    np.testing.assert_allclose((base.specific_force_m_s2 @ R_BS.T)[rows], own[rows], rtol=0, atol=2e-5)
    flipped = np.diag([1.0, -1.0, -1.0])
    np.testing.assert_allclose(other.rate_rad_s @ flipped, base.rate_rad_s @ R_BS.T, rtol=0, atol=1e-12)
    there = np.tile(np.array([-0.150, 0.100, -0.060]) + plant.imu_offsets_m["imu_2"], (len(base.rate_rad_s), 1))
    expected = felt(plant, there)
    assert np.abs(expected - base.specific_force_m_s2 @ R_BS.T)[rows].max() > 1e-2
    np.testing.assert_allclose((other.specific_force_m_s2 @ flipped)[rows], expected[rows], rtol=0, atol=2e-5)


def test_joints_do_as_told(plant) -> None:
    times = STEP_S * np.arange(plant.rows)
    q, dq, ddq = plant.program.at(times)
    for joint in range(5):
        np.testing.assert_allclose(plant.angle_rad(f"joint_{joint + 1}"), q[:, joint], rtol=0, atol=1e-7)
    np.testing.assert_allclose(np.gradient(q, STEP_S, axis=0)[1:-1], dq[1:-1], rtol=0, atol=1e-5)
    np.testing.assert_allclose(np.gradient(dq, STEP_S, axis=0)[1:-1], ddq[1:-1], rtol=0, atol=2e-3)
    assert np.abs(dq).max(axis=0).min() > 0.05
    assert (dq[times < 0.3] == 0.0).all()
    assert (dq[times >= 3.8] == 0.0).all()
    assert plant.program.phase_changes == ((0.0, 0), (0.3, 1), (3.8, 9))


def test_a_grid_step_of_the_integration_does_not_matter(plant) -> None:
    fine = flown(load("dymaflex", SHORT | {"physics": {"integration_steps": 4}}), 5)
    rows, _ = away_from_the_shock(plant)
    rows = rows[rows < round(1.6 / STEP_S)]  # the capture falls on a step
    a_sixth_of_a_count = {"rate_rad_s": 2e-5, "specific_force_m_s2": 1e-4, "wrist_force_n": 4e-4, "q_rad": 2e-6}
    for field, atol in a_sixth_of_a_count.items():
        np.testing.assert_allclose(
            getattr(fine.flight, field)[rows], getattr(plant.flight, field)[rows], rtol=0, atol=atol
        )


def test_every_flight_is_another_one_within_its_limits() -> None:
    scenario = load("dymaflex", SHORT)
    plants = [FreeFlyerPlant(scenario, np.random.default_rng(seed)) for seed in (1, 2, 3)]
    captures = [plant.capture_s for plant in plants]
    assert len(set(captures)) == 3
    assert all(1.6 <= capture_s <= 2.4 for capture_s in captures)
    for value in (lambda p: p.base.mass_kg, lambda p: p.release_rate_rad_s[0], lambda p: p.program.posture_rad[2]):
        assert len({float(value(plant)) for plant in plants}) == 3
    assert abs(plants[0].base.mass_kg / free_flyer.BASE.mass_kg - 1.0) < 0.015


def test_what_is_held_from_the_start_is_not_captured(plant) -> None:
    scenario = load("dymaflex", SHORT).model_copy(update={"capture": None})
    held = flown(scenario, 1)
    assert held.capture_s == 0.0
    jumps = [np.abs(np.diff(one.flight.rate_rad_s, 2, axis=0)).max() for one in (held, plant)]
    assert jumps[0] < 1e-5 < 1e-3 < jumps[1]
    forces = [np.abs(one.flight.wrist_force_n[:1000]).max() for one in (held, plant)]  # before any capture
    assert forces[0] > 3.0 * forces[1]  # 5.4 kg beyond the flange, and 0.4 kg


def test_truth_names_what_was_caught(plant) -> None:
    truth = plant.truth()
    quantities = truth["quantities"]
    assert quantities["m_payload"] == 5.0
    assert [quantities[f"c_{axis}_payload"] for axis in "xyz"] == [0.03, -0.02, 0.08]
    tensor = np.array([[quantities[f"I_{min(a, b)}{max(a, b)}_payload"] for b in "xyz"] for a in "xyz"])
    box = 5.0 / 12.0 * np.array([0.16**2 + 0.14**2, 0.2**2 + 0.14**2, 0.2**2 + 0.16**2])
    np.testing.assert_allclose(np.linalg.eigvalsh(tensor), np.sort(box), rtol=1e-12)
    assert np.abs(tensor[0, 1]) > 1e-5
    assert truth["capture_s"] == plant.capture_s


def test_no_sensor_sees_what_is_to_come() -> None:
    mission = Mission(load("dymaflex", SHORT), 1)
    mission.plant.advance(1.0)
    assert mission.sensors["joint_3"].value(1.0) != 0.0
    for name in ("joint_3", "load_cell"):
        with pytest.raises(NotYetComputedError):
            mission.sensors[name].value(1.5)


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        ({"capture": {"latest_s": 60.0}}, "latest_s"),
        ({"capture": {"earliest_s": 2.0, "latest_s": 1.0}}, "earliest_s"),
        ({"sequence": [SHORT["sequence"][1] | {"ramp_s": 2.0}]}, "ramp_s"),
        ({"servo": {}}, "servo"),
        ({"scenario": {"plant": "balloon"}}, "scenario.plant"),
    ],
)
def test_what_cannot_be_flown_is_refused_by_name(overrides, named) -> None:
    with pytest.raises(ScenarioError, match=re.escape(named)):
        load("dymaflex", overrides)


@pytest.mark.parametrize(
    ("device", "at"), [("imu_base", "imu_3"), ("joint_1", "joint_6"), ("load_cell", "elbow"), ("joint_1", "")]
)
def test_a_place_that_is_not_there_is_named(device, at) -> None:
    with pytest.raises(ScenarioError, match=f"no '{at}'"):
        Mission(load("dymaflex", SHORT | {"device": {device: {"at": at}}}), 1)


def test_the_rockets_arm_has_one_place_of_a_kind() -> None:
    with pytest.raises(ScenarioError, match="no 'joint_2'"):
        Mission(load("rocksat", {"device": {"joint_1": {"at": "joint_2"}}}), 1)


def test_one_seed_one_flight(plant: FreeFlyerPlant) -> None:
    again, other = (flown(load("dymaflex", SHORT), seed) for seed in (5, 6))
    for signal in ("rate_rad_s", "specific_force_m_s2", "wrist_force_n"):
        assert np.array_equal(getattr(again.flight, signal), getattr(plant.flight, signal))
        assert not np.array_equal(getattr(other.flight, signal), getattr(plant.flight, signal))


def test_swings_are_the_same_whoever_asks_when() -> None:
    program = ArmSwings(load("dymaflex", SHORT), np.random.default_rng(3))
    times = np.linspace(0.0, 4.0, 61)
    whole = program.at(times)
    for k in (0, 7, 30, 60):
        for one, all_of_them in zip(program.at(times[k : k + 1]), whole, strict=True):
            np.testing.assert_allclose(one[0], all_of_them[k], rtol=0, atol=1e-12)
