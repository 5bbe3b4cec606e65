"""The tumbling body with a flywheel: its momentum, its answers on board and on the ground, against how it was built."""

from pathlib import Path

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants.vehicle_plant import VehiclePlant
from onboard import config
from onboard.ground.identify.identify import identify
from onboard.ground.identify.replay.replay import replay
from onboard.identification.rows.free_body import FREE_BODY
from tests.flight.missions import Result, fly


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Result:
    return fly(tmp_path_factory.mktemp("tumble") / "flight.mcap", 2, scenario_of("tumble"), "tumble")


def test_angular_momentum_is_kept_while_the_wheel_runs() -> None:
    """``|I w + I_a W a|`` is constant: the whole about its centre of mass, rate w, and the wheel's speed W about -z."""
    plant = VehiclePlant(scenario_of("tumble"), np.random.default_rng(7))
    plant.advance(1e9)
    rate, speed = plant.inertial("body").rate_rad_s, plant.wheel_rate_rad_s("wheel_spin")
    body, wheel = plant.bodies["body"], plant.bodies["wheel"]
    mass = body.mass_kg + wheel.mass_kg
    r = body.centre_of_mass_m  # from the wheel, which is at the origin
    apart = body.mass_kg * wheel.mass_kg / mass * (r @ r * np.eye(3) - np.outer(r, r))
    momentum = rate @ (body.inertia_kg_m2 + wheel.inertia_kg_m2 + apart)
    momentum[:, 2] -= wheel.inertia_kg_m2[2, 2] * speed
    size = np.linalg.norm(momentum[: plant.count], axis=1)
    assert np.ptp(speed) == pytest.approx(2500.0, rel=1e-3)
    assert np.ptp(wheel.inertia_kg_m2[2, 2] * speed) > 0.2 * size[0]
    np.testing.assert_allclose(size, size[0], rtol=1e-5)


def test_the_body_is_told_on_board_as_it_was_built(flown: Result) -> None:
    assert flown.table["accounted"], flown.table["channels"]
    rows = [*flown.table["centres"], *flown.table["inertias"]]
    assert [row["quantity"] for row in rows] == list(FREE_BODY)
    assert all(row["supported"] for row in rows)
    assert sum(row["covered"] for row in rows) >= 8
    assert all(row["standing"] == "good" for row in rows)


def test_the_estimator_starts_from_nothing_that_is_true(flown: Result) -> None:
    drawn = flown.flown.truth["links"]["body"]
    assert np.abs(drawn["centre_of_mass_m"]).min() > 1e-4
    assert np.abs(np.diag(drawn["inertia_kg_m2"]) - 1e-3).min() > 1e-5


def test_a_gyro_beyond_its_stated_axes_is_named_on_board(tmp_path: Path) -> None:
    """Seed 115 and axes 1.3 times as loose as stated: 4.4 stated sigmas off, more than chance makes of so many."""
    loose = {"sensor": {"imu_base": {"mounting_sigma_deg": 1.3 * 0.49847}}}
    far = fly(tmp_path / "flight.mcap", 115, scenario_of("tumble", loose), "tumble")
    rows = [*far.table["centres"], *far.table["inertias"]]
    assert all(row["supported"] and row["covered"] for row in rows)
    assert all(row["standing"].startswith("weak: misalignment of imu_base's gyro about y") for row in rows)


def test_the_ground_tells_the_same_and_the_flight_replays(flown: Result) -> None:
    [found] = identify(config.load(config.packaged("tumble")), [flown.path]).logs
    true = {row["quantity"]: row["truth"] for row in (*flown.table["centres"], *flown.table["inertias"])}
    assert sum(one.low <= true[one.name] <= one.high for one in found.answers if one.name in true) >= 8
    assert found.throw is not None
    assert found.throw.principal is not None
    xx, xy, yy, xz, yz, zz = (true[name] for name in FREE_BODY[3:])
    moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    assert np.all((found.throw.principal.low <= moments) & (moments <= found.throw.principal.high))
    again = replay(flown.path)
    assert again.identical, again.summary
