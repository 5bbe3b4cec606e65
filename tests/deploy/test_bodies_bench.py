"""The benches of bodies without joints and of a balanced tip mass: what misses a bar is named, and by how much."""

import pytest

from bench import balanced, bodies
from bench.bodies import COVERED, INERTIA_1, OFFSET, Run, ScoredAnswer, judged


def run(seed: int, error: float, inside: bool, centre: float = 1e-6) -> Run:
    inertias = [ScoredAnswer(name, error if name == "I_xx" else 0.0, 0.01, inside, 2.0) for name in INERTIA_1.names]
    return Run(seed, "good", (*inertias, *(ScoredAnswer(name, centre, 1e-6, True, 1.0) for name in OFFSET.names)))


def test_what_misses_a_bar_is_told() -> None:
    fine = [run(1, 0.019, True), run(2, 0.0, True), run(3, 0.0, True), run(4, 0.0, True)]
    spoilt = run(5, 0.021, False, 21e-6)
    met = [one for _, one in judged([*fine, run(5, 0.0, True)._replace(told=spoilt.told[6:])], (OFFSET,), None)]
    assert met == [True, False, True]  # of errors; a coverage without a bar is printed only
    lines = dict(judged([*fine, spoilt], (INERTIA_1, OFFSET), COVERED))
    assert list(lines.values()) == [True, False, False, False]  # six of 45 outside
    assert "largest error 1.05 % (I_xx, seed 5; bar 1), 24 of 30 inside" in "\n".join(lines)
    assert "largest error 21 um (com_x, seed 5; bar 20)" in "\n".join(lines)
    without = spoilt._replace(told=spoilt.told[1:])
    said, fine_too = list(judged([without], (INERTIA_1,), None))[1]
    assert said.endswith("1 not told")
    assert not fine_too


@pytest.mark.campaign  # how a run is judged: above and below; the flight: test_tumble, test_spherical_bearing
def test_a_run_on_the_table(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bodies, "EDITS", {"mass weighed": bodies.WEIGHED})
    monkeypatch.setattr("sys.argv", ["bodies", "planar", "--seeds", "1", "--first", "900", "--seconds", "30"])
    assert bodies.main() == 0
    said = capsys.readouterr().out
    assert "planar body, mass weighed, seeds 900 to 900\n  1 runs: 1 " in said
    assert "1 of 1 inside" in said


def test_an_error_is_taken_apart_by_the_truth() -> None:
    """A cell that reads 1 % less, a seat 1 mm out on 2 m, rows 2.1 %, and a drawing that makes 3 % too much of it."""
    truth = {"quantities": {"ZZ_joint_1_R_held": 3.0, "ZZ_joint_1_R_released": 1.0, "m_tip_mass": 0.5}}
    truth |= {"load_cell": {"moment_Nm_per_N": 0.04 / 0.99}, "places_m": {"tip_mass": [0.001, 0.0, 0.0]}}
    tip = 2.0 * (1.0 - 0.01 - 0.02)
    mass = {"name": "m_tip_mass", "value": tip / 2.0 * 0.5 * 1.03, "low": 0.49, "high": 0.51}
    inertias = [{"name": "ZZ_joint_1_R_held", "value": 1.0 + tip}, {"name": "ZZ_joint_1_R_released", "value": 1.0}]
    parts = (("load_cell scale_sigma and lever_sigma_m", 9.0), ("scatter", 0.003), ("noise_rad", 0.004))
    budget = {"m_tip_mass": [{"cause": cause, "sigma": sigma} for cause, sigma in parts]}
    found = {"quantities": [mass, *inertias], "budget": budget}
    one = balanced.taken_apart(found, truth, 0.04)
    assert one == pytest.approx((-0.09, 2.0, 3.0, -1.0, 0.1, -2.1, 1.0), abs=0.01)
    assert one.inside
    lines = balanced.table([(one, one._replace(error=-2.5))], [7])
    assert lines[1].split()[-6:] == ["2.00!", "+3.00", "-1.00", "+0.10", "-2.10", "1.00"]
    assert lines[-1] == "the rows' part of the error is 2.10 of its sigma (rms)"
