"""Wheels hold the free-flyer's attitude and thrusters push it while it identifies what it caught: from bus bytes on."""

import numpy as np
import pytest

from onboard import config
from onboard.flight.estimate.problem.identification import build_free_flyer, build_online
from onboard.ground.identify.replay.replay import replay
from tests.flight.missions import CATCH, Result, fly

JETS = {"jet_1": ([0.0, 0.3, 0.0], [0.2, 0.0, 0.05]), "jet_2": ([-0.25, 0.0, 0.0], [0.0, -0.15, 0.0])}
WHEN_s = {"jet_1": (2.0, 0.7), "jet_2": (8.0, 1.0)}
WHEELS = ("wheel_x", "wheel_y", "wheel_z")
RISE_s = 0.02  # half of it before a burn, half after
BURNS = [
    {"frame": name, "at_s": WHEN_s[name][0], "duration_s": WHEN_s[name][1], "force_N": float(np.linalg.norm(force))}
    for name, (force, _) in JETS.items()
]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Result:
    path = tmp_path_factory.mktemp("actuators") / "flight.mcap"
    rest, swing, end = CATCH["sequence"]
    shorter = [rest, swing | {"duration_s": 9.5}, end]
    return fly(path, 21011, vehicle="dymaflex_wheels", burn=BURNS, sequence=shorter, capture=CATCH["capture"])


def test_every_sample_is_accounted_for_and_the_wheels_turn(flown: Result) -> None:
    assert flown.table["accounted"], flown.table["channels"]
    assert set(flown.table["channels"]) == set(config.load(config.packaged("dymaflex_wheels")).channels)
    for name in WHEELS:
        rows = flown.log.read(name)
        assert len(rows) == pytest.approx(500 * flown.flown.truth["duration_s"], rel=0.02)
        speed = rows["value_raw"] * rows["scale"]
        assert np.ptp(speed) > 5.0
        assert set(rows["unit"]) == {b"rad/s"}


def test_the_jets_push_for_as_long_as_told(flown: Result) -> None:
    for name, (force, _) in JETS.items():
        rows = flown.log.read(name)
        on_s = 0.002 * np.count_nonzero(rows["value_raw"])
        assert WHEN_s[name][1] < on_s < WHEN_s[name][1] + RISE_s + 0.005
        read = rows["value_raw"].max() * rows["scale"][0]
        assert read == pytest.approx(flown.flown.truth[name]["gain"] * np.linalg.norm(force), abs=0.001)


def test_the_answer_holds_the_truth_and_nothing_else_was_noticed(flown: Result) -> None:
    assert len(flown.table["capture"]["said_s"]) == 1
    assert flown.table["capture"]["said_s"][0] == pytest.approx(flown.table["capture"]["true_s"], abs=2.0)
    answers = [*flown.table["masses"], *flown.table["centres"], *flown.table["inertias"]]
    supported = [row for row in answers if row["supported"]]
    assert len(supported) >= 7
    assert sum(row["covered"] for row in supported) >= len(supported) - 1


@pytest.mark.campaign  # with torques: test_joint_torques
def test_replay_gives_the_onboard_estimates_to_the_bit(flown: Result) -> None:
    found = replay(flown.path)
    assert found.identical, found.summary


def test_a_wheel_is_a_rotor_with_scale_and_delay_of_its_device() -> None:
    predictor = build_free_flyer(config.load(config.packaged("dymaflex_wheels")))[0].ekf.predictor
    own = {name: sigma for name, sigma in zip(predictor.names, predictor.sigma, strict=True) if "wheel" in name}
    expected = {f"{kind}_{wheel}": sigma for wheel in WHEELS for kind, sigma in (("scale", 5e-3), ("delay", 2e-4))}
    assert own == pytest.approx(expected)


def test_a_thruster_has_the_scale_of_its_device_and_the_wrench_of_its_frame() -> None:
    predictor = build_free_flyer(config.load(config.packaged("dymaflex_wheels")))[0].ekf.predictor
    own = {name: sigma for name, sigma in zip(predictor.names, predictor.sigma, strict=True) if "jet" in name}
    assert own == {"scale_jet_1": 0.05, "scale_jet_2": 0.05}
    for thruster, (force, place) in zip(predictor.thrusters, JETS.values(), strict=True):
        along = np.array(force) / np.linalg.norm(force)
        expected = np.concatenate([along, np.cross(place, along)])
        np.testing.assert_allclose(thruster.wrench, expected, atol=1e-12)


def test_derivatives_with_thrust_are_finite_differences() -> None:
    """Of all instruments: two IMUs and the cell at the wrist."""
    predictor = build_free_flyer(config.load(config.packaged("dymaflex_wheels")))[0].ekf.predictor
    rng, n = np.random.default_rng(5), 24
    t = 0.01 * np.arange(n)[:, None] + 3.0 * np.arange(8)
    q, dq, ddq = 0.3 * np.sin(2.0 * t), 0.6 * np.cos(2.0 * t), -1.2 * np.sin(2.0 * t)
    thrust = np.zeros((n, 2))
    thrust[8:15, 0], thrust[11:, 1] = 0.3, 0.25
    x = np.nan_to_num(predictor.sigma) * rng.normal(size=len(predictor.names)) * 0.1
    x[:13] = [0.1, -0.2, 0.3, 5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    x[[name.startswith("delay_s") for name in predictor.names]] = 0.0  # what it does to other derivatives is left out
    cyclic = rng.normal(size=(n, 3, sum("cyclic" in name for name in predictor.names)))
    found = predictor.predict(q, dq, ddq, x, cyclic, thrust)
    plain = predictor.predict(q, dq, ddq, x, cyclic)
    assert np.abs(found.values - plain.values).max() > 1e-3
    chosen = [*range(13), *(k for k, name in enumerate(predictor.names) if "jet" in name or "scale_load_cell" in name)]
    transition = np.eye(len(x))
    transition[predictor.changing] = found.transition
    for k in chosen:
        size = 1e-4 if k < 13 else 1e-2
        step = size * np.eye(len(x))[k]
        up, down = (predictor.predict(q, dq, ddq, x + by, cyclic, thrust) for by in (step, -step))
        slope = (up.values - down.values) / (2.0 * size)
        assert np.abs(found.jacobian[:, :, k] - slope).max() <= 2e-3 * np.abs(slope).max() + 1e-9, predictor.names[k]
        carried = (up.state - down.state) / (2.0 * size)
        assert np.abs(transition[:, k] - carried).max() <= 2e-3 * np.abs(carried).max(), predictor.names[k]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"device": {"jet_1": {"frame": "link_3"}}}, "link_3"),
        ({"device": {"jet_1": {"axis": [0.0, 0.0, 0.0]}}}, "needs a direction"),
        ({"estimation": {"method": "rows", "base_rows": ["force", "moment"]}}, 'known to the method "exiddm"'),
    ],
)
def test_what_cannot_be_is_refused(changes: dict[str, dict[str, object]], said: str) -> None:
    vehicle = config.load(config.packaged("dymaflex_wheels"))
    tree = config.laid_over(vehicle.tree, changes)
    with pytest.raises(config.ConfigError, match=said):
        build_online(config.parse_tree(tree, vehicle.path, config.Origin("test")))
