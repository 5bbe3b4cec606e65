"""What is expected of a prescribed base, whose sway nobody knows beforehand: over motions that are all as likely."""

from pathlib import Path

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants import planned
from hil_sim.plants.planned import default_plan
from hil_sim.scenario.vehicle_tables import Scenario
from onboard import config
from onboard.ground.before.foresee import rows
from onboard.ground.before.foresee.foresee import foresee
from onboard.ground.before.foresee.plan import MotionPlan, plan_of
from onboard.ground.before.foresee.rows import StatedNoise
from onboard.ground.before.init.vehicle import NewVehicle, make

HZ = 20.0
STILL = "[base_motion]\nrate_rad_s = 0.0\nacceleration_m_s2 = 0.0\n"


def plan(directory: Path, base: str, over: str = "") -> tuple[config.Vehicle, MotionPlan]:
    directory.mkdir(exist_ok=True)
    make(NewVehicle("it", base, ("shoulder", "elbow"), load_cell="cia404"), directory / "it")  # type: ignore[arg-type]
    (directory / "over.toml").write_text(over)
    scenario: Scenario = scenario_of(str(directory / "it" / "vehicle.toml"), directory / "over.toml")
    vehicle = config.load(directory / "it" / "vehicle.toml").with_row_rate(HZ)
    return vehicle, plan_of(vehicle, default_plan(scenario, 1.0 / HZ))


def test_a_sigma_is_the_rms_over_the_sways(tmp_path: Path) -> None:
    vehicle, whole = plan(tmp_path, "prescribed")
    assert len(whole.bases) == 8
    each = np.array([[one.sigma for one in foresee(vehicle, part).parameters] for part in whole.by_base()])
    found = foresee(vehicle, whole).parameters
    np.testing.assert_allclose([one.sigma for one in found], np.sqrt(np.mean(each**2, axis=0)), rtol=1e-9)
    told = [name for name in (one.name for one in found) if name.startswith("MX_payload")]
    spread = each[:, [one.name for one in found].index(told[0])]
    assert spread.max() > 1.5 * spread.min()  # so it matters which one is taken


@pytest.mark.parametrize(("base", "over", "count"), [("prescribed", STILL, 1), ("fixed", "", 0)])
def test_a_base_that_does_not_sway_is_computed_once(base: str, over: str, count: int, tmp_path: Path) -> None:
    _, whole = plan(tmp_path, base, over)
    assert len(whole.bases) == count
    assert len(whole.by_base()) == 1


def test_a_long_motion_is_taken_in_parts_and_by_fewer_sways(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle, whole = plan(tmp_path, "prescribed")
    n, one = len(whole.time_s), whole.by_base()[0]
    [found] = rows.foresee_rows(vehicle, [one])
    at_once = [parameter.sigma for parameter in found.parameters]
    monkeypatch.setattr(rows, "_MOST_TICKS", n // 3)
    taken = []
    made = StatedNoise.signals
    monkeypatch.setattr(StatedNoise, "signals", lambda *given: taken.append(len(given[1].q)) or made(*given))
    [found] = rows.foresee_rows(vehicle, [one])
    parts = [parameter.sigma for parameter in found.parameters]
    assert sum(taken) == n
    assert max(taken) <= n // 3
    np.testing.assert_allclose(parts, at_once, rtol=1e-3)  # rates of readings at the edges of parts are one-sided
    monkeypatch.setattr(planned, "_MOST_ROWS", n)
    assert len(plan(tmp_path / "again", "prescribed")[1].bases) == 2
