"""The bench of bodies without joints: a bar that is missed is told, and a short run of it is what the page says."""

import pytest

from bench import bodies
from bench.bodies import COVERED, INERTIA_1, OFFSET, Run, Told, judged


def run(seed: int, error: float, inside: bool, centre: float = 1e-6) -> Run:
    inertias = [Told(name, error if name == "I_xx" else 0.0, 0.01, inside, 2.0) for name in INERTIA_1.names]
    return Run(seed, "good", (*inertias, *(Told(name, centre, 1e-6, True, 1.0) for name in OFFSET.names)))


def test_what_misses_a_bar_is_told() -> None:
    fine = [run(1, 0.019, True), run(2, 0.0, True), run(3, 0.0, True), run(4, 0.0, True)]
    spoilt = run(5, 0.021, False, 21e-6)
    met = [one for _, one in judged([*fine, run(5, 0.0, True)._replace(told=spoilt.told[6:])], (OFFSET,), None)]
    assert met == [True, False, True]  # of errors; a coverage without a bar is told only
    lines = dict(judged([*fine, spoilt], (INERTIA_1, OFFSET), COVERED))
    assert list(lines.values()) == [True, False, False, False]  # six of 45 outside
    assert "largest error 1.05 % (I_xx, seed 5; bar 1), 24 of 30 inside" in "\n".join(lines)
    assert "largest error 21 um (com_x, seed 5; bar 20)" in "\n".join(lines)
    without = spoilt._replace(told=spoilt.told[1:])
    said, fine_too = list(judged([without], (INERTIA_1,), None))[1]
    assert said.endswith("1 not told")
    assert not fine_too


def test_a_run_on_the_table(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bodies, "EDITS", {"mass weighed": bodies.WEIGHED})
    monkeypatch.setattr("sys.argv", ["bodies", "planar", "--seeds", "1", "--first", "900", "--seconds", "30"])
    assert bodies.main() == 0
    said = capsys.readouterr().out
    assert "planar body, mass weighed, seeds 900 to 900\n  1 runs: 1 " in said
    assert "1 of 1 inside" in said
