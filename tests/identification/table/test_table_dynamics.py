"""Dynamics of a base on an air bearing against MuJoCo: rows, drag, motion, and what the IMU on it reads."""

import mujoco
import numpy as np
import pytest

from bench.true_flights import planar_bed
from onboard.dynamics.air_bearing import PlanarDrag, PlanarRun, predict_run
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.ticks import FlightSignals
from onboard.identification.free_flyer.prediction.imu_errors import ImuPrior
from onboard.identification.table.air_bearing import TableFit
from onboard.regressor.rows import BaseMotion, RowModel, base_force_rows, base_moment_rows
from tests.identification.table.bed_run import BOX, DRAGS, PAYLOAD, PRIOR, PUCKS, TILT, WIDE, exact, vehicle

IMU = ImuPrior(0.01, 1e-4, 0.003, 0.003, 0.1, 1e-3, 0.003, 0.003, 1e-4)


def test_three_rows_are_mujocos_generalised_forces(rng):
    model, truth = vehicle(), planar_bed.world(BOX).model
    chi = model.chi.copy()
    chi[model.payload_columns()] = standard_of(PAYLOAD)
    rows = RowModel(model, [*base_force_rows(model), *base_moment_rows(model)])
    q, dq, ddq = rng.normal(size=(3, 4, 5))
    velocity, acceleration = rng.normal(size=(2, 4, 3))  # x, y, yaw
    w, dw, f = np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((4, 3))
    w[:, 2], dw[:, 2] = velocity[:, 2], acceleration[:, 2]
    f[:, :2], f[:, 2] = acceleration[:, :2], 9.80665
    found = rows.regressor(q, dq, ddq, BaseMotion(w, dw, f)) @ chi
    still = FlightSignals(0.01, q, dq, ddq, w, f, np.ones(3), np.ones(3), 1)
    moved, payload = PlanarRun(model, still), model.links.index("payload")
    G, T = moved.wrench(chi, (payload,))[::2], moved.columns(tuple(range(len(model.links))))[::2]
    basis = np.column_stack([acceleration, np.ones(4), w[:, 2], w[:, 2] ** 2])
    data = mujoco.MjData(truth)
    for k in range(4):  # yaw zero: table axes are base axes
        data.qpos[:], data.qvel[:] = np.r_[0.3, -0.2, 0.0, q[k]], np.r_[velocity[k], dq[k]]
        data.qacc[:] = np.r_[acceleration[k], ddq[k]]
        mujoco.mj_inverse(truth, data)
        np.testing.assert_allclose(found[k], data.qfrc_inverse[:3], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(T[k] @ chi @ basis[k], data.qfrc_inverse[:3], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(G[k] @ basis[k], data.qfrc_inverse[:3], rtol=1e-9, atol=1e-9)


def pulls(drags):
    viscous, coulomb = np.array([[d.viscous_N_s_m, d.coulomb_N] for d in drags]).T
    return PlanarDrag(np.array(planar_bed.PUCKS_m), viscous, coulomb)


def test_motion_is_mujocos_drag_and_tilt_included(run):
    joints, truth = PlanarRun(run.vehicle, exact(run)), run.flight.velocity
    for drags, tilt, low, high in (
        (DRAGS, TILT, 0.0, 5e-5),
        ([planar_bed.Drag()] * 3, TILT, 0.02, np.inf),
        (DRAGS, (0.0, 0.0), 1e-4, np.inf),
    ):
        found = predict_run(joints, truth[0], run.chi, pulls(drags), np.array(tilt), ())
        assert low <= np.abs(found.velocity[:, :3] - truth[::3]).max() < high


def test_the_imu_is_predicted_and_its_slopes_are_differences(run):
    motion_fit = TableFit(
        run.vehicle, "imu_base", exact(run), WIDE, {"base": np.eye(10)}, PRIOR._replace(imu=IMU, sag=1.0)
    )
    x = motion_fit.start(PAYLOAD)
    names = list(motion_fit.names)
    x[:3] = run.flight.velocity[0]
    for puck, drag in zip(PUCKS, DRAGS, strict=True):
        x[names.index(f"Fv_{puck}")], x[names.index(f"Fc_{puck}")] = drag.viscous_N_s_m, drag.coulomb_N
    x[[names.index("tilt_x"), names.index("tilt_y")]] = TILT
    assert np.abs(motion_fit.residuals(x)[0].reshape(-1, 6)[:, 2:5] * 1e-3).max() < 2e-3  # one tick in a turn of a puck
    assert np.abs(motion_fit.residuals(x)[0]).mean() * 1e-3 < 2e-5
    ticks = 120
    for degree, sag in enumerate((0.3, -0.2, 0.1), 1):
        x[names.index(f"sag_{degree}")] = sag
    jacobian = motion_fit.residuals(x, ticks)[1]
    for k, name in enumerate(names):
        step = np.zeros(x.size)
        step[k] = 1e-6
        slope = (motion_fit.residuals(x + step, ticks)[0] - motion_fit.residuals(x - step, ticks)[0]) / 2e-6
        np.testing.assert_allclose(jacobian[:, k], slope, atol=1e-4 * np.abs(slope).max() + 1e-5, err_msg=name)


def test_of_masses_that_have_no_motion_nothing_is_predicted(run):
    """A step of a fit may go there: it was the end of ``heft identify``."""
    found = predict_run(PlanarRun(run.vehicle, exact(run)), np.zeros(3), 0.0 * run.chi, pulls(DRAGS), np.zeros(2), ())
    assert np.isnan(found.base.specific_force[:, :2]).all()


def test_the_supply_sags_and_all_drags_grow_from_half_to_twice(run):
    joints, still, drag = PlanarRun(run.vehicle, exact(run)), np.zeros(2), pulls(DRAGS)
    start = np.array([0.2, -0.1, 0.3])
    sagging = predict_run(joints, start, run.chi, drag._replace(sag=(np.log(2.0), 0.0, 0.0)), still, ())
    for tick, times in ((0, 0.5), (joints.ticks - 1, 2.0)):
        here = exact(run)
        here = here._replace(**{name: getattr(here, name)[tick : tick + 1].repeat(3, 0) for name in ("q", "dq", "ddq")})
        constant = drag._replace(viscous=times * drag.viscous, coulomb=times * drag.coulomb)
        velocity = sagging.velocity[tick, :3]
        found = predict_run(PlanarRun(run.vehicle, here), velocity, run.chi, constant, still, ())
        force = found.base.specific_force[0, :2]
        np.testing.assert_allclose(sagging.base.specific_force[tick, :2], force, atol=1e-9)
        bare = predict_run(PlanarRun(run.vehicle, here), velocity, run.chi, drag, still, ())
        assert np.abs(bare.base.specific_force[0, :2] - force).max() > 1e-3


def test_a_tick_is_the_mean_of_its_samples(run):
    f, samples = run.flight, 25
    n = len(f.time_s) // samples
    time_s, rate, force = (
        x[: n * samples].reshape(n, samples, -1) for x in (f.time_s, f.rate_rad_s, f.specific_force_m_s2)
    )
    middle = samples // 2
    sigma, period_s = np.full(3, 1e-3), samples * float(f.time_s[1] - f.time_s[0])
    means = rate.mean(axis=1), force.mean(axis=1)
    signals = FlightSignals(period_s, *run.motion.at(time_s[:, middle, 0]), *means, sigma, sigma, samples)
    left = []
    for told in (samples, 1):
        motion_fit = TableFit(run.vehicle, "imu_base", signals._replace(samples=told), WIDE, {}, PRIOR)
        x = motion_fit.start(PAYLOAD)
        names = list(motion_fit.names)
        x[:3] = f.velocity[middle]
        for puck, drag in zip(PUCKS, DRAGS, strict=True):
            x[names.index(f"Fv_{puck}")], x[names.index(f"Fc_{puck}")] = drag.viscous_N_s_m, drag.coulomb_N
        x[[names.index("tilt_x"), names.index("tilt_y")]] = TILT
        left.append(np.abs(motion_fit.residuals(x)[0].reshape(-1, 6)[5:-5, 2]).mean())  # gyro, about the vertical
    assert left[0] < 0.2 * left[1]


def test_coarser_ticks_are_means(run):
    signals = exact(run)
    coarse = signals.coarser(3)
    assert len(coarse.q) == len(signals.q) // 3
    assert coarse.period_s == pytest.approx(3 * signals.period_s)
    np.testing.assert_array_equal(coarse.q[5], signals.q[16])
    np.testing.assert_allclose(coarse.rate[5], signals.rate[15:18].mean(axis=0))
    np.testing.assert_allclose(coarse.specific_force_sigma * np.sqrt(3.0), signals.specific_force_sigma)
    assert coarse.samples == 3 * signals.samples
    np.testing.assert_allclose(signals.coarser(2).dq[5], signals.dq[10:12].mean(axis=0))
