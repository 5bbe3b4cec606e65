"""A payload on an air-bearing table: its fit with intervals, drags, encoder zeros, joint places, refusals.

The fit of a run on a table where growing parts lead nowhere: searches for minima, their end and their bounds.
"""

from contextlib import suppress
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from bench.true_flights import planar_bed
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError, UnknownFrameError
from onboard.dynamics.model.payload import standard_covariance
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.estimation.errors import ConvergenceError
from onboard.identification.free_flyer.batch import MotionFit
from onboard.identification.free_flyer.guesses import GUESSES
from onboard.identification.free_flyer.prediction.parameters import GeometryPrior, JointPrior
from onboard.identification.table import air_bearing
from onboard.identification.table.air_bearing import Searched, TableFit, Work, drag_of
from onboard.identification.table.floating_base import DragPrior
from onboard.identification.table.rivals import bound, joint_step
from tests.identification.table.bed_run import (
    BOX,
    DRAGS,
    PAYLOAD,
    PRIOR,
    PUCKS,
    TILT,
    URDF,
    WIDE,
    exact,
    fly,
    noisy,
    vehicle,
)


def test_where_the_fit_of_growing_parts_fails_minima_are_searched_for(rng, monkeypatch):
    drags = (planar_bed.Drag(0.3, 0.03), planar_bed.Drag(), planar_bed.Drag())
    signals = noisy(fly(0.6, 5.0, drags), rng)
    prior = PRIOR._replace(pucks={"puck_1": DragPrior(5.0, 0.5)})

    def fails(_):
        raise ConvergenceError("not converged")

    monkeypatch.setattr(MotionFit, "fit", fails)
    found = TableFit(vehicle(), "imu_base", signals, WIDE, {}, prior).fit()
    drag = drag_of(found, prior.pucks)
    assert (np.abs(drag.drag - [0.3, 0.03]) < 3.5 * drag.sigma).all()
    assert abs(found.payload.body.mass_kg - BOX.mass_kg) < 3.5 * np.sqrt(found.payload.covariance[0, 0])
    assert found.misfit == pytest.approx(1.0, abs=0.1)
    monkeypatch.setattr(TableFit, "searched", lambda _: [])
    with pytest.raises(ConvergenceError, match="not converged"):
        TableFit(vehicle(), "imu_base", signals, WIDE, {}, prior).fit()


@pytest.fixture
def contradicted(run, rng):
    """One joint reads half of what it turns by, and no other minimum is found by growing parts."""
    signals = noisy(run, rng)
    wrong = signals._replace(
        **{name: getattr(signals, name) * [1.0, 0.5, 1.0, 1.0, 1.0] for name in ("q", "dq", "ddq")}
    )
    return TableFit(run.vehicle, "imu_base", wrong, WIDE, {}, PRIOR)


def test_results_of_a_search_that_are_far_from_an_answer_are_not_finished(contradicted, monkeypatch):
    def fails(_):
        raise ConvergenceError("not converged")

    monkeypatch.setattr(MotionFit, "fit", fails)
    far = Searched(contradicted.start(PAYLOAD), 1e6)
    monkeypatch.setattr(TableFit, "grown", lambda *_: far)
    with pytest.raises(ConvergenceError, match=r"contradict each other: .* times the noise"):
        contradicted.fit()


@pytest.mark.parametrize(
    ("by_one_drag", "by_the_other", "searches"),
    [
        ([1.0], [1.0], 2),
        ([1.1, 1.0], [1.0, 1.0], 4),
        ([1.0, 1.1, 1.1], [1.1, 1.1, 1.1], 6),
        ([1.4, 1.4, 1.4], [1.4, 1.4, 1.4], 6),
    ],
)
def test_searches_end_where_the_likeliest_minimum_explains_the_run_and_was_reached_twice(
    run, rng, monkeypatch, by_one_drag, by_the_other, searches
):
    motion_fit = TableFit(run.vehicle, "imu_base", noisy(run, rng), WIDE, {}, PRIOR)
    left = {drags: iter(own) for drags, own in zip(air_bearing.DRAGS, (by_one_drag, by_the_other), strict=True)}
    done = []

    def grown(coarse, guess, drags, _work):
        done.append(6 * int(coarse.valid.sum()) * next(left[drags]))
        return Searched(coarse.start(guess), done[-1])

    monkeypatch.setattr(TableFit, "grown", grown)
    assert len(motion_fit.searched()) == 2
    assert len(done) == searches


def test_searches_lead_to_one_minimum_from_several_payloads_and_drags_and_keep_these_positive(run, rng):
    motion_fit = TableFit(run.vehicle, "imu_base", noisy(run, rng), WIDE, {}, PRIOR)
    positive, found = [motion_fit.layout.estimated("payload")[0], *motion_fit.layout.estimated("drag")], []
    for guess, drags in product(GUESSES, air_bearing.DRAGS):
        with suppress(ConvergenceError):
            found.append(motion_fit.grown(guess, drags, Work(1_000_000)))
    assert all((one.x[positive] > 0.0).all() for one in found)
    assert np.median([one.x[positive[0]] for one in found]) == pytest.approx(BOX.mass_kg, rel=0.02)


def test_searches_of_a_run_are_bounded(contradicted, monkeypatch):
    def fails(_):
        raise ConvergenceError("not converged")

    predicted, residuals = [], TableFit.residuals

    def counted(motion_fit, x, ticks=None):
        predicted.append(ticks)
        return residuals(motion_fit, x, ticks)

    monkeypatch.setattr(MotionFit, "fit", fails)
    monkeypatch.setattr(air_bearing, "_MOST_TICKS", 5000)
    monkeypatch.setattr(TableFit, "residuals", counted)
    with pytest.raises(ConvergenceError):
        contradicted.fit()
    assert 5000 <= sum(predicted) < 5000 + max(predicted)


def test_a_fit_whose_pucks_push_is_searched_again(run):
    """Coulomb drag of one puck below zero by more than its sigma: a run of the bed (seed 91003) was 12 sigmas off."""
    motion_fit = TableFit(run.vehicle, "imu_base", exact(run), WIDE, {}, PRIOR)
    x, covariance = motion_fit.start(PAYLOAD), np.eye(len(motion_fit.start(PAYLOAD)))
    drag = motion_fit.layout.estimated("drag")
    covariance[drag, drag] = 0.2**2

    def pushes() -> bool:
        return motion_fit.pushes(SimpleNamespace(x=x, covariance=covariance))

    assert not pushes()
    x[drag] = [-0.1, 0.0, 0.3, 0.0, 0.0, 0.0]  # one puck of three
    assert not pushes()
    x[drag[1]] = -0.001
    assert pushes()
    x[drag[1]] = 0.0
    covariance[drag[0], drag[0]] = 0.09**2
    assert pushes()


def test_payload_and_drag_of_a_noisy_run(run, rng):
    motion_fit = TableFit(run.vehicle, "imu_base", noisy(run, rng), WIDE, {}, PRIOR)
    found = motion_fit.fit()
    sigma = np.sqrt(np.diag(found.payload.covariance))
    drag = drag_of(found, PUCKS)
    assert drag.reason == ""
    assert abs(found.payload.body.mass_kg / BOX.mass_kg - 1) < 0.02
    assert abs(found.payload.body.inertia_kg_m2[2, 2] / BOX.inertia_kg_m2[2, 2] - 1) < 0.06
    assert abs(found.payload.body.mass_kg - BOX.mass_kg) < 3.5 * sigma[0]
    truth = [value for drag in DRAGS for value in (drag.viscous_N_s_m, drag.coulomb_N)]
    assert (np.abs(drag.drag - truth) < 3.5 * drag.sigma).all()
    assert (drag.sigma[2:4] < [0.4, 0.04]).all()
    assert found.misfit == pytest.approx(1.0, abs=0.1)
    pushing = found.fit.x.copy()
    pushing[motion_fit.names.index("Fv_puck_3")] = -5.0 * drag.sigma[4]
    assert "Fv_puck_3 came out negative" in drag_of(found._replace(fit=found.fit._replace(x=pushing)), PUCKS).reason


def test_an_imu_too_bad_for_the_motion_does_not_determine_the_payload(run, rng):
    signals = noisy(run, rng)
    worse = signals._replace(
        rate=signals.rate + 2.0 * rng.standard_normal(signals.rate.shape),
        specific_force=signals.specific_force + 20.0 * rng.standard_normal(signals.rate.shape),
        rate_sigma=np.full(3, 2.0),
        specific_force_sigma=np.full(3, 20.0),
    )
    found = TableFit(run.vehicle, "imu_base", worse, WIDE, {}, PRIOR).fit()
    assert "does not determine the payload" in drag_of(found, PUCKS).reason


def test_an_arm_that_stands_still_fits_nothing(rng):
    motion_fit = TableFit(vehicle(), "imu_base", noisy(fly(0.0, 3.0), rng), WIDE, {}, PRIOR)
    with pytest.raises(ConvergenceError, match="no joint moves"):
        motion_fit.fit()


def test_a_gyro_that_reads_too_much_contradicts_the_joints(run, rng):
    signals = noisy(run, rng).coarser(4)
    found = TableFit(run.vehicle, "imu_base", signals._replace(rate=1.05 * signals.rate), WIDE, {}, PRIOR).fit()
    assert "contradict" in drag_of(found, PUCKS).reason


def test_what_cannot_be_used_is_named(run):
    signals = exact(run)
    own = standard_covariance(run.vehicle.chi[:10], 0.01, 1e-3, 0.01)
    with pytest.raises(SignalError, match="the base is free"):
        TableFit(vehicle(BaseKind.FREE), "imu_base", signals, WIDE, {}, PRIOR)
    with pytest.raises(UnknownFrameError, match="no payload link"):
        TableFit(vehicle(payload=None), "imu_base", signals, WIDE, {}, PRIOR)
    with pytest.raises(UnknownFrameError, match="hand is none"):
        TableFit(run.vehicle, "imu_base", signals, WIDE, {"hand": own}, PRIOR)
    with pytest.raises(UnknownFrameError, match="'puck_4'"):
        TableFit(run.vehicle, "imu_base", signals, WIDE, {}, PRIOR._replace(pucks={"puck_4": DragPrior(1.0, 1.0)}))
    with pytest.raises(UnknownFrameError, match="moves with a joint"):
        TableFit(run.vehicle, "imu_base", signals, WIDE, {}, PRIOR._replace(pucks={"link_3": DragPrior(1.0, 1.0)}))
    with pytest.raises(SignalError, match="joints must be known"):
        TableFit(run.vehicle, "imu_base", signals._replace(q=signals.q * np.nan), WIDE, {}, PRIOR)
    with pytest.raises(SignalError, match="rates and specific forces"):
        TableFit(run.vehicle, "imu_base", signals._replace(rate=signals.rate[:-1]), WIDE, {}, PRIOR)
    gone = signals.rate.copy()
    gone[: len(gone) // 2 + 1] = np.nan
    with pytest.raises(SignalError, match="no IMU"):
        TableFit(run.vehicle, "imu_base", signals._replace(rate=gone), WIDE, {}, PRIOR)


def test_what_is_held_in_a_stage_stays_and_the_rest_is_fitted(run):
    motion_fit = TableFit(run.vehicle, "imu_base", exact(run), WIDE, {}, PRIOR)
    x = motion_fit.start(PAYLOAD)
    drag = motion_fit.layout.estimated("drag")
    held = np.setdiff1d(np.arange(x.size), motion_fit.layout.estimated("tilt"))
    for puck, value in zip(range(len(PUCKS)), DRAGS, strict=True):
        x[drag[2 * puck : 2 * puck + 2]] = value.viscous_N_s_m, value.coulomb_N
    x[:3] = [0.02, -0.01, 0.05]
    done = motion_fit.held(x, held, 1e-3, len(exact(run).q), Work(10**6))
    np.testing.assert_array_equal(done.x[held], x[held])
    np.testing.assert_allclose(done.x[motion_fit.layout.estimated("tilt")], TILT, atol=2e-4)


def test_an_encoder_zero_that_is_off_is_fitted_too_and_the_payload_with_it(run, rng):
    signals = noisy(run, rng).coarser(4)
    off = 0.01 * np.eye(5)[2]  # of joint_3, read too large
    joints = {joint.name: JointPrior(zero=0.005) for joint in run.vehicle.joints}
    prior = PRIOR._replace(geometry=GeometryPrior(0.0, joints))
    motion_fit = TableFit(run.vehicle, "imu_base", signals._replace(q=signals.q + off), WIDE, {}, prior)
    plain = motion_fit.fit()
    stepped = joint_step(motion_fit, plain.fit)
    found, zeros = motion_fit.found(stepped.fit), stepped.joints
    assert zeros.names == tuple(f"zero_{name}" for name in joints)
    assert (np.abs(zeros.values + off) < 3.5 * zeros.sigma).all()
    assert zeros.sigma[2] < 0.002
    assert zeros.in_told_sigmas["zero_joint_3"] == pytest.approx(-0.01 / np.hypot(0.005, zeros.sigma[2]), rel=0.2)
    assert found.fit.residual_sum < plain.fit.residual_sum - 10.0
    away = [
        np.abs(one.payload.body.centre_of_mass_m - BOX.centre_of_mass_m)[:2]
        / np.sqrt(np.diag(one.payload.covariance)[1:3])
        for one in (plain, found)
    ]
    assert away[0].max() > 5.0
    assert away[1].max() < 3.5
    known = bound(motion_fit, plain.fit.x)
    assert known == pytest.approx(found.fit.covariance, rel=1e-6, abs=1e-12)


def test_a_joint_out_of_place_predicts_what_a_drawing_of_it_there_does(run):
    head, seat, rest = URDF.partition('<child link="link_5"/>\n    <origin xyz="')
    assert rest.startswith("0 0 0.14")
    moved = head + seat + "0.004 -0.003 0.142" + rest.removeprefix("0 0 0.14")
    elsewhere = VehicleModel(moved, VehicleSpec(BaseKind.PLANAR, "base", "payload"))
    drawn = TableFit(elsewhere, "imu_base", exact(run), WIDE, {}, PRIOR)
    motion_fit = TableFit(run.vehicle, "imu_base", exact(run), WIDE, {}, PRIOR)
    errors = np.zeros((5, 6))
    errors[4, :3] = 0.004, -0.003, 0.002
    x = motion_fit.start(PAYLOAD)
    told, there = (one.residuals(x)[0] for one in (motion_fit.with_errors(errors), drawn))
    assert told == pytest.approx(there, abs=1e-9)
    assert np.abs(told - motion_fit.residuals(x)[0]).max() > 1.0


def test_an_open_place_along_the_vertical_leaves_the_payloads_height_open(run, rng):
    prior = PRIOR._replace(geometry=GeometryPrior(0.0, {"joint_5": JointPrior(place_m=0.01)}))
    motion_fit = TableFit(run.vehicle, "imu_base", noisy(run, rng), WIDE, {}, prior)
    plain = motion_fit.fit()
    stepped = joint_step(motion_fit, plain.fit)
    found, places = motion_fit.found(stepped.fit), stepped.joints
    before, after = (np.sqrt(one.payload.covariance[3, 3]) for one in (plain, found))
    assert before < 1e-3
    assert after == pytest.approx(np.hypot(before, places.sigma[2]), rel=0.2)
    assert (np.abs(places.values) < 3.5 * places.sigma).all()
