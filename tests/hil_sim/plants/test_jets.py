"""Thrusters of a vehicle of one's own: impulse and direction of their burns, and what cannot be."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import onboard
from hil_sim.devices.vehicle_file import rehearsal
from hil_sim.plants.parts.jets import RISE_s
from hil_sim.plants.vehicle_plant import VehiclePlant
from hil_sim.scenario.tables import ScenarioError

VEHICLE = Path(onboard.__file__).parent / "vehicles" / "dymaflex_wheels" / "vehicle.toml"
SHORT = """
payload = false
capture = false
release = { rate_rad_s = 0.0, velocity_m_s = 0.0 }
sequence = [{ phase = 0, action = "hold", duration_s = 1.5 }]
"""


def plant(tmp_path: Path, burns: str) -> VehiclePlant:
    over = tmp_path / "over.toml"
    over.write_text(SHORT + burns)
    made = VehiclePlant(rehearsal(VEHICLE, over), np.random.default_rng(4))
    made.advance(1.4)
    return made


def momentum(made: VehiclePlant) -> tuple[np.ndarray, np.ndarray]:
    """Of everything, world axes: linear, and angular about where the base was at the start."""
    flight = made.flight
    flight.show()
    mujoco.mj_subtreeVel(flight.model, flight.data)
    base = 1  # the world is 0
    p = float(flight.model.body_subtreemass[base]) * flight.data.subtree_linvel[base]
    return p, flight.data.subtree_angmom[base] + np.cross(flight.data.subtree_com[base], p)


def test_a_burn_gives_its_impulse_along_the_axis_of_its_frame(tmp_path: Path) -> None:
    burns = 'burn = [{ frame = "jet_1", at_s = 0.3, duration_s = 0.4, force_N = 0.5 }]\n'
    pushed, free = plant(tmp_path, burns), plant(tmp_path, "burn = []\n")
    told_n = pushed.thrust_n("jet_1")
    assert told_n.max() == pytest.approx(0.5)
    assert told_n.sum() * pushed.step_s == pytest.approx(0.5 * 0.4, rel=1e-3)
    assert (told_n[: int((0.3 - RISE_s) / pushed.step_s)] == 0.0).all()
    assert not pushed.thrust_n("jet_2").any()
    gained = [after - before for after, before in zip(momentum(pushed), momentum(free), strict=True)]
    np.testing.assert_allclose(gained[0], [0.0, 0.2, 0.0], atol=0.004)  # the base turns by a degree meanwhile
    np.testing.assert_allclose(gained[1], np.cross([0.2, 0.0, 0.05], [0.0, 0.2, 0.0]), atol=0.002)


WRENCH = 'wrench = [{ axes = "%s", force_N = [0.0, 0.4, 0.0], torque_N_m = [0.02, 0.0, 0.0], at_s = 0.3%s }]\n'


def test_an_unknown_wrench_gives_its_impulse_and_no_thruster_tells_of_it(tmp_path: Path) -> None:
    pushed = plant(tmp_path, "burn = []\n" + WRENCH % ("space", ", duration_s = 0.5"))
    free = plant(tmp_path, "burn = []\n")
    assert not pushed.thrust_n("jet_1").any()
    gained = [after - before for after, before in zip(momentum(pushed), momentum(free), strict=True)]
    np.testing.assert_allclose(gained[0], [0.0, 0.2, 0.0], atol=1e-4)
    np.testing.assert_allclose(gained[1], [0.01, 0.0, 0.0], atol=5e-4)


@pytest.mark.parametrize(
    ("axes", "force_n", "torque_n_m"), [("space", [0, 0.4], [0, -0.02]), ("base", [-0.4, 0], [0.02, 0])]
)
def test_an_unknown_wrench_turns_with_the_base_or_not(
    tmp_path: Path, axes: str, force_n: list[float], torque_n_m: list[float]
) -> None:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # base to world
    jets = plant(tmp_path, "burn = []\n" + WRENCH % (axes, "")).jets
    np.testing.assert_allclose(jets.push(1e4, quarter), [*force_n, 0.0, *torque_n_m, 0.0], atol=1e-12)
    assert not jets.push(0.3 - RISE_s, quarter).any()


def test_without_a_force_the_vehicle_gains_a_hundredth_of_a_metre_a_second_squared(tmp_path: Path) -> None:
    made = plant(tmp_path, 'burn = [{ frame = "jet_2", at_s = 0.3, duration_s = 0.4 }]\n')
    assert made.thrust_n("jet_2").max() == pytest.approx(0.01 * sum(body.mass_kg for body in made.bodies.values()))


@pytest.mark.parametrize(
    ("frame", "said"), [("jet_3", "no thruster is at 'jet_3'; there are jet_1, jet_2"), ("link_2", "no thruster is at")]
)
def test_a_burn_of_no_thruster_is_refused(tmp_path: Path, frame: str, said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        plant(tmp_path, f'burn = [{{ frame = "{frame}", at_s = 0.3, duration_s = 0.4 }}]\n')
