"""The fit of a run on a table where growing parts lead nowhere: searches for minima, their end and their bounds."""

from types import SimpleNamespace

import numpy as np
import pytest

from hil_sim.plants import planar_bed
from onboard.estimation.errors import ConvergenceError
from onboard.identification.exiddm.batch import Exiddm
from onboard.identification.table import air_bearing
from onboard.identification.table.air_bearing import (
    DragPrior,
    Searched,
    TableExiddm,
    air_bearing_exiddm,
    drag_of,
)
from tests.identification.table.bed_run import BOX, PAYLOAD, PRIOR, WIDE, exact, fly, noisy, vehicle


def test_where_the_fit_of_growing_parts_fails_minima_are_searched_for(rng, monkeypatch):
    drags = (planar_bed.Drag(0.3, 0.03), planar_bed.Drag(), planar_bed.Drag())
    signals = noisy(fly(0.6, 5.0, drags), rng)
    prior = PRIOR._replace(pucks={"puck_1": DragPrior(5.0, 0.5)})

    def fails(_):
        raise ConvergenceError("not converged")

    monkeypatch.setattr(Exiddm, "fit", fails)
    found = air_bearing_exiddm(vehicle(), "imu_base", signals, WIDE, {}, prior).fit()
    drag = drag_of(found, prior.pucks)
    assert (np.abs(drag.drag - [0.3, 0.03]) < 3.5 * drag.sigma).all()
    assert abs(found.payload.body.mass_kg - BOX.mass_kg) < 3.5 * np.sqrt(found.payload.covariance[0, 0])
    assert found.misfit == pytest.approx(1.0, abs=0.1)
    monkeypatch.setattr(TableExiddm, "_searched", lambda _: [])
    with pytest.raises(ConvergenceError, match="not converged"):
        air_bearing_exiddm(vehicle(), "imu_base", signals, WIDE, {}, prior).fit()


@pytest.fixture
def contradicted(run, rng):
    """One joint reads half of what it turns by, and no other minimum is found by growing parts."""
    signals = noisy(run, rng)
    wrong = signals._replace(
        **{name: getattr(signals, name) * [1.0, 0.5, 1.0, 1.0, 1.0] for name in ("q", "dq", "ddq")}
    )
    return air_bearing_exiddm(run.vehicle, "imu_base", wrong, WIDE, {}, PRIOR)


def test_results_of_a_search_that_are_far_from_an_answer_are_not_finished(contradicted, monkeypatch):
    def fails(_):
        raise ConvergenceError("not converged")

    monkeypatch.setattr(Exiddm, "fit", fails)
    far = Searched(contradicted.start(PAYLOAD), 1e6)
    monkeypatch.setattr(TableExiddm, "_continued", lambda *_: far)
    with pytest.raises(ConvergenceError, match=r"contradict each other: .* times the noise"):
        contradicted.fit()


@pytest.mark.parametrize(
    ("by_one_drag", "by_the_other", "searches"),
    [
        ([1.0], [1.0], 2),
        ([1.1, 1.0], [1.0, 1.0], 3),
        ([1.0, 1.0, 1.0], [1.1, 1.1, 1.1], 6),
        ([1.4, 1.4, 1.4], [1.4, 1.4, 1.4], 6),
    ],
)
def test_searches_end_where_both_drags_led_to_one_minimum_that_explains_the_run(
    run, rng, monkeypatch, by_one_drag, by_the_other, searches
):
    exiddm = air_bearing_exiddm(run.vehicle, "imu_base", noisy(run, rng), WIDE, {}, PRIOR)
    left = {drags: iter(own) for drags, own in zip(air_bearing._DRAGS, (by_one_drag, by_the_other), strict=True)}
    done = []

    def continued(coarse, guess, _roundings, drags, _work):
        done.append(6 * int(coarse._valid.sum()) * next(left[drags]))
        return Searched(coarse.start(guess), done[-1])

    monkeypatch.setattr(TableExiddm, "_continued", continued)
    assert len(exiddm._searched()) == 2
    assert len(done) == searches


def test_searches_of_a_run_are_bounded(contradicted, monkeypatch):
    def fails(_):
        raise ConvergenceError("not converged")

    predicted, residuals = [], TableExiddm.residuals

    def counted(exiddm, x, ticks=None):
        predicted.append(ticks)
        return residuals(exiddm, x, ticks)

    monkeypatch.setattr(Exiddm, "fit", fails)
    monkeypatch.setattr(air_bearing, "_MOST_TICKS", 5000)
    monkeypatch.setattr(TableExiddm, "residuals", counted)
    with pytest.raises(ConvergenceError):
        contradicted.fit()
    assert 5000 <= sum(predicted) < 5000 + max(predicted)


def test_a_fit_whose_pucks_push_is_searched_again(run):
    """Coulomb drag of one puck below zero by more than its sigma: a run of the bed (seed 91003) was 12 sigmas off."""
    exiddm = air_bearing_exiddm(run.vehicle, "imu_base", exact(run), WIDE, {}, PRIOR)
    x, covariance = exiddm.start(PAYLOAD), np.eye(len(exiddm.start(PAYLOAD)))
    drag = exiddm.layout.estimated("drag")
    covariance[drag, drag] = 0.2**2

    def pushes() -> bool:
        return exiddm._pushes(SimpleNamespace(x=x, covariance=covariance))

    assert not pushes()
    x[drag] = [-0.1, 0.0, 0.3, 0.0, 0.0, 0.0]  # one puck of three
    assert not pushes()
    x[drag[1]] = -0.001
    assert pushes()
    x[drag[1]] = 0.0
    covariance[drag[0], drag[0]] = 0.09**2
    assert pushes()
