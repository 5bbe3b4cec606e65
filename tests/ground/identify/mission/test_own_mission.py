"""Answers of a run on the table, in the result table of a rehearsal."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from hil_sim.devices.vehicle_file import rehearsal
from hil_sim.mission import Mission
from onboard import config
from onboard.ground.identify import identify
from onboard.ground.identify.kinds.identified import Identified, standings
from onboard.ground.identify.mission import own_mission
from onboard.identification.quantities import QuantityEstimate, Useful
from onboard.identification.standing import Level
from onboard.identification.verdict import Verdict

VEHICLE = SimpleNamespace(prediction="planar", file=SimpleNamespace(vehicle=SimpleNamespace(payload_link="box")))
FOUND = (
    QuantityEstimate("m_box", "kg", 1.4, 0.1, 1.2, 1.6, True),
    QuantityEstimate("I_zz_box", "kg m^2", 0.002, 0.008, -0.014, 0.018, True),
    QuantityEstimate("Fc_puck_1", "N", 0.01, 0.001, 0.008, 0.012, True),
    QuantityEstimate("c_z_box", "m", 0.0, 20.0, -40.0, 40.0, False),
)


@pytest.mark.parametrize("reasons", [(), ("the fit failed: not converged",)])
def test_what_a_run_determines_and_what_stays_weak(monkeypatch, reasons):
    verdict = Verdict(Level.DO_NOT_USE if reasons else Level.WEAK, reasons, ())
    answers = () if reasons else FOUND
    each = standings(answers, Useful())
    found = Identified(Path("run.mcap"), "exiddm", answers, 100, {}, (), verdict, standings=each)
    monkeypatch.setitem(identify.BY_LIKELIHOOD, "planar", lambda *_: found)
    rows, runs = own_mission.after_the_run(VEHICLE, None)
    assert runs == []
    assert len(rows) == (10 if reasons else 11)
    if reasons:
        assert not any(row["supported"] for row in rows.values())
        assert {row["standing"] for row in rows.values()} == {f"do not use: {reasons[0]}"}
        return
    assert {name for name, row in rows.items() if row["supported"]} == {"m_box", "I_zz_box", "Fc_puck_1"}
    assert rows["m_box"]["standing"] == "good"
    assert rows["I_zz_box"]["standing"] == "weak: its interval contains zero"
    assert rows["c_z_box"]["standing"] == rows["I_xx_box"]["standing"] == "weak: not determined by the data"


def test_a_mass_by_an_inertia_is_compared_with_the_mass_that_was_built():
    """Not with its true inertia over the drawing's radius of gyration: an arm whose centre is 2 mm out has another."""
    path, exact = config.packaged("rocksat"), {"mass_relative": 0.0, "centre_mm": 0.0, "inertia_relative": 0.0}
    out = {"arm": exact | {"centre_off_mm": [2.0, 0.0, 0.0], "mass_factor": 1.1}, "tip_mass": exact}
    truth = Mission(rehearsal(path, {"as_built": out, "payload": {"mass_kg": [0.06627, 0.06627]}}), 3).truth()
    told = own_mission.with_quantities(config.load(path), truth)["quantities"]
    assert told["m_arm"] == pytest.approx(1.1 * 0.23313)
    assert told["m_arm+m_tip_mass"] == pytest.approx(1.1 * 0.23313 + 0.06627)
    centre_m = 0.03975 + 0.002
    own = 1e-9 * 7.33e5 + 0.23313 * (centre_m**2 + 0.00141**2)
    assert told["ZZ_joint_1_R_released"] == pytest.approx(1.1 * own, rel=1e-6)
