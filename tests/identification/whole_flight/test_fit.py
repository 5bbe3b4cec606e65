"""A flight fitted as a whole, free and held segments together, with MuJoCo's truth; agreement of its parts."""

import dataclasses
import re

import numpy as np
import pytest

from bench.true_flights import free_flyer
from onboard.dynamics.model.payload import standard_of
from onboard.estimation.errors import ConvergenceError, SingularError
from onboard.estimation.maximum_likelihood import inverse_of
from onboard.identification.corrections import doubtful, refused_from
from onboard.identification.evidence.bank import Suspect
from onboard.identification.free_flyer.prediction.joint_noise import NOISE_KEY, NoiseAdded
from onboard.identification.free_flyer.steps import JumpedJoint
from onboard.identification.whole_flight import witnesses
from onboard.identification.whole_flight.blocks import INSTRUMENTS, BlockNoise, apart, sum_of, total_of
from onboard.identification.whole_flight.fit import WholeFlight
from onboard.identification.whole_flight.pooled import differences, halves
from onboard.identification.whole_flight.segments import Segment, in_windows
from onboard.identification.whole_flight.witnesses import bodies_of, bound_of, leans_on
from onboard.identification.windows import WINDOW_s
from onboard.regressor.signals import EncoderJump
from tests.dynamics.free_flyer_twin import BOX
from tests.dynamics.free_flyer_twin import PAYLOAD as TRUTH
from tests.identification.free_flyer.recorded_flights import BIASED, WIDE, jumped, recorded, ticks_of
from tests.identification.whole_flight.flights import (
    CAPTURE_s,
    fitted_freely,
    predictor_of,
    scaled,
    segments,
    started,
)

LATER = "the later half of the motion"


def test_the_payload_is_the_truth_within_its_sigmas(fitted):
    _, found = fitted
    off = found.chi - standard_of(TRUTH)
    nees = off @ np.linalg.solve(found.chi_covariance, off)
    assert nees < 25.2  # 99.5 % of chi-squared with 10
    assert found.misfit == pytest.approx(1.0, abs=0.1)
    assert set(found.by_instrument) == set(INSTRUMENTS)
    assert max(found.by_instrument.values()) < 1.15
    assert found.glitches == 0


def test_normal_equations_of_a_fit_are_those_at_its_estimate(fitted):
    """Its last step is not predicted, and would leave a gradient of half a sigma where they are not moved with it."""
    flight, found = fitted
    told, anew = (total_of(blocks, len(found.names)) for blocks in (found.blocks, flight.blocks(found.fit.x)))
    sigma = np.sqrt(np.diag(found.fit.covariance))
    assert np.abs((told.gradient - anew.gradient) * sigma).max() < 0.02
    assert told.squares == pytest.approx(anew.squares, abs=0.1)
    at_the_minimum = anew.gradient + flight.prior_information @ found.fit.x
    assert np.abs(at_the_minimum * sigma).max() < 0.02


def wider_by(flight, begins, factor):
    """Parameters whose names begin so, in sigmas so many times as large."""
    at = np.array([k for k, name in enumerate(flight.names) if name.startswith(begins)])
    return Suspect(begins, at, np.sqrt(factor**2 - 1.0) * np.diag(flight.stated[at]), 1.0)


def test_what_may_be_wrong_is_added_to_the_prior_and_taken_out_again(predictor, ticks):
    flight = WholeFlight(predictor, WIDE, segments(ticks))
    stated = flight.prior_information.copy()
    both = [wider_by(flight, "base_inertial", 2.0), wider_by(flight, "base_inertial_2", 3.0)]
    flight.free(both)
    C = np.diag(np.where([name.startswith("base_inertial") for name in flight.names], flight.stated**2, 0.0))
    for one in both:
        C[np.ix_(one.at, one.at)] += one.along @ one.along.T
    np.testing.assert_allclose(
        np.linalg.inv(flight.prior_information[np.ix_(both[0].at, both[0].at)]), C[np.ix_(both[0].at, both[0].at)]
    )
    np.testing.assert_allclose(flight.sigma[both[0].at], np.sqrt(np.diag(C))[both[0].at])
    flight.free(())
    np.testing.assert_array_equal(flight.prior_information, stated)
    np.testing.assert_array_equal(flight.sigma, flight.stated)


def test_normal_equations_are_without_what_noise_of_the_joints_adds(noisy, predictor, fitted):
    flight = WholeFlight(predictor, WIDE, segments(noisy))
    found = flight.fit(fitted[1].fit.x)
    sigma = np.sqrt(np.diag(found.fit.covariance))
    added = np.zeros(len(found.names))
    for block in found.blocks:
        assert block.noise.any()
        added[block.columns] += block.noise
    assert found.correction.shift[0] > 0.5 * sigma[0]  # the payload was light by so much
    np.testing.assert_allclose(found.correction.shift / sigma, found.fit.covariance @ added / sigma, atol=0.02)
    left = total_of(found.blocks, len(added)).gradient + flight.prior_information @ found.fit.x
    assert np.abs(left * sigma).max() < 0.02


def test_noise_of_a_flight_is_that_of_its_blocks_and_ticks_count_once_for_all_instruments(rng):
    by_x, parts = rng.normal(size=(3, 5)), [NoiseAdded(g, np.outer(g, g), 6.0, 10) for g in rng.normal(size=(4, 3))]
    found = sum_of([BlockNoise(one, by_x) for one in parts], 5, 2)
    np.testing.assert_allclose(found.gradient, by_x.T @ sum(one.gradient for one in parts))
    np.testing.assert_allclose(found.information, by_x.T @ sum(one.information for one in parts) @ by_x)
    assert (found.scatter, found.ticks) == (24.0, 20)  # two times ten ticks of two instruments each


def test_noise_of_the_joints_may_be_known_of_a_part_of_the_flight(noisy, predictor, fitted):
    free, held = segments(noisy)
    exact = free._replace(ticks=free.ticks._replace(sample_sigma=0.0 * free.ticks.sample_sigma))
    found = WholeFlight(predictor, WIDE, [exact, held]).fit(fitted[1].fit.x)
    assert {block.held for block in found.blocks if block.noise.any()} == {True}


def test_parts_agree_where_noise_of_the_joints_makes_the_payload_light(noisy, predictor, fitted):
    """Without the correction the accelerometer, whose rows hold the noise, contradicts the gyro."""
    agreed = []
    for some in (noisy, noisy._replace(sample_sigma=0.0 * noisy.sample_sigma)):
        found = WholeFlight(predictor, WIDE, segments(some)).fit(fitted[1].fit.x)
        agreed.append(differences(found, lambda _: 0)["the accelerometer"].chance)
    corrected, as_fitted = agreed
    assert corrected > 0.01
    assert as_fitted < 1e-4


def test_what_was_flown_free_narrows_the_interval(ticks, predictor, fitted):
    _, whole = fitted
    flight = WholeFlight(predictor, WIDE, segments(ticks)[1:])
    held = flight.fit(started(flight, predictor, whole.chi))
    ratio = np.sqrt(np.diag(whole.payload.covariance) / np.diag(held.payload.covariance))
    assert (ratio < 1.0).all()
    assert ratio[0] < 0.95


def test_slopes_are_differences(ticks, predictor):
    """Also those of what an encoder that has jumped may have done to its joint."""
    parts = [Segment(one.ticks.part(slice(0, 600)), one.held) for one in segments(ticks)]
    other = JumpedJoint(predictor, "joint_2", EncoderJump(0, 0.004, 0.3, 0.2))
    flight = WholeFlight(predictor, WIDE, parts, (), [(CAPTURE_s, other.changed)])
    assert flight.names[-2:] == ("scale_joint_2_from_0", "delay_joint_2_from_0")
    x = started(flight, predictor, standard_of(TRUTH))
    rng = np.random.default_rng(1)
    x[10:] += 0.3 * np.nan_to_num(flight.sigma[10:]) * rng.standard_normal(len(x) - 10)
    p = len(x)
    gradient = total_of(flight.blocks(x), p).gradient
    assert (gradient[["kink" in name or "_from_" in name for name in flight.names]] != 0.0).all()
    for _ in range(4):
        step = 1e-3 * np.where(np.isfinite(flight.sigma), flight.sigma, 1e-2) * rng.standard_normal(p)
        step[:10] *= 1e-2
        up, down = (total_of(flight.blocks(x + sign * step), p).squares for sign in (1.0, -1.0))
        assert up - down == pytest.approx(4.0 * gradient @ step, rel=2e-3)


@pytest.mark.parametrize(("scale", "zero"), [(0.05, 0.0), (0.0, 0.02)])
def test_a_flight_is_fitted_as_a_whole_where_an_encoder_jumps(ticks, predictor, scale, zero):
    """A scale that is another one is estimated, and one that may be but is not costs little."""
    at_s = 10.0
    spoilt, jump = jumped(ticks, at_s, scale, zero)
    free, held = segments(spoilt)
    k = int(np.searchsorted(held.ticks.time_s, at_s))
    parts = [free, *(Segment(held.ticks.part(part), True) for part in (slice(0, k), slice(k, None)))]
    joint = JumpedJoint(predictor, "joint_2", jump)
    flight = WholeFlight(predictor, WIDE, parts, (), [(at_s, joint.changed)])
    found = flight.fit(started(flight, predictor, 1.1 * standard_of(TRUTH)))
    sigma = np.sqrt(np.diag(found.payload.covariance))
    off = found.payload.body.mass_kg - TRUTH.mass_kg
    assert abs(off) < 3.0 * sigma[0] < 0.06 * TRUTH.mass_kg
    assert found.misfit < 1.1
    which = flight.names.index("scale_joint_2_from_0")
    size = found.fit.x[which] * joint.others[0].along[0]
    assert size == pytest.approx(1.0 / (1.0 + scale) - 1.0, abs=0.004)
    if scale:
        unknowing = WholeFlight(predictor, WIDE, parts)
        assert unknowing.fit(started(unknowing, predictor, 1.1 * standard_of(TRUTH))).misfit > 1.5


def test_cyclic_errors_are_noise_after_a_jump_that_may_have_changed_a_scale(ticks):
    predictor = predictor_of(((1.0, 1e-3),))
    functions = np.random.default_rng(2).normal(size=(len(ticks.time_s), 3, 10)) * [[1.0], [10.0], [100.0]]
    joint = JumpedJoint(predictor, "joint_2", EncoderJump(0, 0.004, 0.3, 0.2))
    squares = []
    for jumps in ((), ((CAPTURE_s, joint.changed),)):
        flight = WholeFlight(predictor, WIDE, segments(ticks._replace(cyclic=functions)), (), jumps)
        x = started(flight, predictor, standard_of(TRUTH))
        flight.weigh(x)
        squares.append([total_of([b for b in flight.blocks(x) if b.held == held], len(x)).squares for held in (0, 1)])
    (free, held), (free_too, after) = squares
    assert free_too == free
    assert after < 0.9 * held


def test_outliers_are_left_out_and_counted(ticks, predictor, fitted):
    _, whole = fitted
    spoilt = segments(ticks)
    measured = spoilt[1].ticks.measured.copy()
    measured[[100, 300], 1] += 0.1
    spoilt[1] = spoilt[1]._replace(ticks=spoilt[1].ticks._replace(measured=measured))
    again = WholeFlight(predictor, WIDE, spoilt)
    found = again.fit(whole.fit.x)
    assert found.glitches == 12  # two ticks of six lines
    assert np.abs(found.chi - whole.chi).max() < 0.2 * np.sqrt(np.diag(whole.chi_covariance)).max()


@pytest.mark.parametrize(("misfit", "doubts", "against"), [(1.2, 0, 0), (1.5, 1, 0), (2.5, 0, 1)])
def test_noise_louder_than_stated_is_doubted_and_refused(fitted, misfit, doubts, against):
    flight, whole = fitted
    found = witnesses.tested(flight, whole._replace(by_instrument={"IMU": misfit}), lambda time_s: 0).findings
    assert (len(found.doubts), len(found.against)) == (doubts, against)


def test_a_joint_whose_scale_is_not_as_stated_is_told_by_what_little_the_flight_tells_of_it(ticks, predictor, fitted):
    flight, whole = fitted
    said = witnesses.tested(flight, whole, lambda time_s: 0).findings.against
    assert said == ()
    name = predictor.vehicle.joints[1].name
    scaled = np.where([joint.name == name for joint in predictor.vehicle.joints], 1.02, 1.0)
    spoilt = [
        one._replace(
            ticks=one.ticks._replace(q=one.ticks.q * scaled, dq=one.ticks.dq * scaled, ddq=one.ticks.ddq * scaled)
        )
        for one in segments(ticks)
    ]
    wrong = WholeFlight(predictor, WIDE, spoilt)
    found = witnesses.tested(wrong, wrong.fit(whole.fit.x), lambda time_s: 0)
    at = found.found.names.index(f"scale_{name}")
    assert abs(found.found.fit.x[at] / wrong.sigma[at]) < refused_from(100)  # hardly moved: it is bound to 0.02 %
    assert abs(found.of_bodies[f"scale_{name}"]) > refused_from(100)
    assert f"scale_{name}" not in found.corrections  # counted once
    assert any(
        one.startswith(f"the motion contradicts what is stated of scale_{name} by 1") for one in found.findings.against
    )


@pytest.mark.parametrize(("misfit", "doubted"), [(1.25, False), (1.35, True)])
def test_an_instrument_is_doubted_from_residuals_of_1_3_times_its_variance(fitted, misfit, doubted):
    flight, whole = fitted
    said = witnesses.tested(flight, whole._replace(by_instrument={"imu_base": misfit}), lambda time_s: 0).findings
    assert any("residuals of the imu_base" in one for one in said.doubts) == doubted
    assert said.against == ()


def test_a_fit_that_gets_nowhere_is_given_up(ticks, predictor, fitted, monkeypatch):
    """The gyro's axes are swapped. A fit makes up to 25 predictions of the flight otherwise."""
    _, whole = fitted
    spoilt = [
        one._replace(ticks=one.ticks._replace(measured=one.ticks.measured[:, [1, 0, 2, 3, 4, 5]]))
        for one in segments(ticks)
    ]
    predictions, blocks = [], WholeFlight.blocks
    monkeypatch.setattr(WholeFlight, "blocks", lambda *given: predictions.append(1) or blocks(*given))
    with pytest.raises(ConvergenceError, match=r"residuals stay at .* times the noise"):
        WholeFlight(predictor, WIDE, spoilt).fit(whole.fit.x)
    assert 6 < len(predictions) < 10


def test_a_tumbling_base_is_fitted_in_windows_where_the_whole_flight_cannot_be_predicted(predictor):
    """Joints that move twice as far as usual, a base that turns at 1 rad/s: a guess 10 % off is lost in chaos."""
    rng = np.random.default_rng(7)
    motion = free_flyer.JointMotion.draw(rng)
    motion = dataclasses.replace(motion, amplitude_rad=2.0 * motion.amplitude_rad)
    ticks = ticks_of(recorded(free_flyer.fly(free_flyer.world(BOX), motion, (0.3, 1.0, 0.3), 20.0), rng, BIASED))
    whole = [Segment(ticks, held=True)]
    flight = WholeFlight(predictor, WIDE, whole)
    with pytest.raises(ConvergenceError, match=r"residuals stay at .* times the noise"):
        flight.fit(started(flight, predictor, 1.1 * standard_of(TRUTH)))
    windows = in_windows(whole, 0.01)
    assert [len(one.ticks.time_s) <= round(WINDOW_s / 0.01) for one in windows] == [True] * 4
    np.testing.assert_array_equal(np.concatenate([one.ticks.time_s for one in windows]), ticks.time_s)
    flight = WholeFlight(predictor, WIDE, windows)
    found = flight.fit(started(flight, predictor, 1.1 * standard_of(TRUTH)))
    off = found.chi - standard_of(TRUTH)
    assert off @ np.linalg.solve(found.chi_covariance, off) < 25.2  # 99.5 % of chi-squared with 10
    assert found.misfit == pytest.approx(1.0, abs=0.1)
    assert (
        halves(flight, found).worst.relative_error < 0.3
    )  # rates at the start of windows of the other half are unknown


def test_parts_of_a_sound_flight_agree(fitted):
    flight, found = fitted
    asked = differences(found, lambda time_s: int(time_s > 10.0))
    assert list(asked) == [LATER, "the accelerometer", "phase 1"]
    assert all(one.freedom >= 6 and one.chance > 1e-3 for one in asked.values())
    held_out = halves(flight, found)
    assert held_out.worst.relative_error < 0.3
    assert held_out.fit.relative_error <= held_out.worst.relative_error


@pytest.mark.parametrize(
    ("columns", "factor", "part"), [((0, 1, 2), 1.04, LATER), ((3, 4, 5), 1.1, "the accelerometer")]
)
def test_a_part_that_tells_another_payload_is_noticed(ticks, predictor, fitted, columns, factor, part):
    """The gyro reads 4 % more from the middle of the held time on; the accelerometer 10 % all the time."""
    _, whole = fitted
    spoilt = segments(ticks)
    measured = spoilt[1].ticks.measured.copy()
    first = len(measured) // 2 if part == LATER else 0
    measured[first:, list(columns)] *= factor
    spoilt[1] = spoilt[1]._replace(ticks=spoilt[1].ticks._replace(measured=measured))
    flight = WholeFlight(predictor, WIDE, spoilt)
    found = flight.fit(whole.fit.x)
    assert differences(found, lambda _: 0)[part].chance < 1e-6


def test_a_flight_too_short_to_halve(ticks, predictor, fitted):
    _, whole = fitted
    held = segments(ticks)[1]
    flight = WholeFlight(predictor, WIDE, [held._replace(ticks=held.ticks.part(slice(0, 300)))])
    found = flight.fit(started(flight, predictor, whole.chi))
    with pytest.raises(SingularError, match="halves"):
        halves(flight, found)
    assert differences(found, lambda _: 0)[LATER].freedom == 0


def test_of_a_flight_as_stated_nothing_is_free(ticks, predictor, fitted):
    _, whole = fitted
    flight = WholeFlight(predictor, WIDE, segments(ticks))
    made = fitted_freely(flight, whole)
    assert not made.names
    assert made.passes
    np.testing.assert_array_equal(flight.sigma, flight.stated)
    sigma = np.sqrt(np.diag(whole.chi_covariance))
    assert np.abs((made.found.chi - whole.chi) / sigma).max() < 0.3
    assert (np.sqrt(np.diag(made.found.chi_covariance)) >= 0.99 * sigma).all()  # what may be wrong is in it


def test_links_and_joints_are_tested_together_in_what_the_flight_tells_of_them(ticks, predictor, fitted):
    """Spoilt: 1.4 sigmas in each direction that is determined; no error of a link or joint is far out by itself."""
    flight, found = fitted
    sound, at = bodies_of(flight, found), flight.of_bodies
    assert 3 < sound.freedom < at.size
    assert sound.chance > 0.01
    assert witnesses.tested(flight, found, lambda time_s: 0).passes
    sigma = flight.sigma[at]
    values, directions = np.linalg.eigh(np.eye(at.size) - found.fit.covariance[np.ix_(at, at)] / np.outer(sigma, sigma))
    x = found.fit.x.copy()
    x[at] = 1.4 * sigma * (directions @ np.sqrt(np.maximum(values, 0.0)))
    off = found._replace(fit=found.fit._replace(x=x))
    spoilt = bodies_of(flight, off)
    assert spoilt.squares == pytest.approx(1.4**2 * spoilt.freedom)
    assert sound.freedom < spoilt.freedom < at.size
    said = witnesses.tested(flight, off, lambda time_s: 0)
    assert not doubtful(said.of_bodies)
    assert [one for one in (*said.findings.doubts, *said.findings.against) if "all corrections together" in one]


@pytest.mark.parametrize(("columns", "factor"), [([3, 4, 5], 0.88), ([0, 1, 2], 1.05)])
def test_a_scale_of_all_axes_is_named_and_free(ticks, predictor, fitted, columns, factor):
    _, whole = fitted
    flight = WholeFlight(predictor, WIDE, scaled(ticks, columns, factor))
    stated = flight.fit(whole.fit.x)
    free = fitted_freely(flight, whole)
    assert free.names[0] == "imu"
    off, wrong = (np.abs(one.chi - standard_of(TRUTH))[0] for one in (free.found, stated))
    assert off < 2.0 * np.sqrt(free.found.chi_covariance[0, 0])
    assert off < 0.5 * wrong


def test_the_bound_is_that_of_what_is_stated_and_the_truth_gives_the_same(ticks, predictor, fitted):
    """Where something was fitted freely too, which widens the interval of the mass."""
    flight, whole = fitted
    bound = bound_of(flight, whole)
    np.testing.assert_allclose(bound, np.sqrt(np.diag(whole.payload.covariance)), rtol=1e-6)
    at = whole.fit.x.copy()
    at[:10] = standard_of(TRUTH)
    true = WholeFlight(predictor, WIDE, segments(ticks))
    true.weigh(at)
    there = whole._replace(chi=at[:10], blocks=tuple(true.blocks(at)))
    np.testing.assert_allclose(bound, bound_of(true, there), rtol=0.02)
    flight = WholeFlight(predictor, WIDE, scaled(ticks, [3, 4, 5], 0.93))
    stated = flight.fit(whole.fit.x)
    free = fitted_freely(flight, whole).found
    wider = np.sqrt(np.diag(free.payload.covariance)) / bound_of(flight, free)
    assert (wider >= 1.0).all()
    assert wider[0] > 1.1
    np.testing.assert_allclose(bound_of(flight, free), bound_of(flight, stated), rtol=0.05)


def test_an_answer_leans_on_a_sigma_as_its_variance_grows_with_it(ticks, predictor, fitted):
    """``dP / d(ln s) = 2 (P / s)^2``: the variance of the mass with the base's sigmas a hundredth larger."""
    _, found = fitted
    flight = WholeFlight(predictor, WIDE, segments(ticks))
    said = leans_on(flight, found)
    assert len(said) == 10
    [told] = re.findall(r"base \(([0-9.]+) %\)", said[0])
    rows = total_of(found.blocks, len(found.names)).information
    stated = inverse_of(rows + flight.prior_information)[0, 0]
    flight.free([wider_by(flight, "base_inertial", 1.01)])
    wider = inverse_of(rows + flight.prior_information)[0, 0]
    effect = np.sqrt((wider - stated) / 0.02) / found.chi[0]
    assert float(told) / 100.0 == pytest.approx(effect, rel=0.05)
    assert not found.correction.sigma.any()  # exact joints
    noisy = found.correction._replace(sigma=0.1 * found.fit.x * (np.arange(found.fit.x.size) < 10))
    assert leans_on(flight, found._replace(correction=noisy))[0].startswith(f"leans on {NOISE_KEY} (10 %)")


def test_rows_with_a_common_error_in_each_stretch_are_whitened(rng):
    """Against the inverse square root of their covariance; a stretch without rows lies between."""
    stretch, effect = np.array([0, 0, 0, 2, 2]), rng.standard_normal(5)
    common = np.where(stretch[:, None] == stretch, np.outer(effect, effect), 0.0)
    values, vectors = np.linalg.eigh(np.eye(5) + common)
    assert values.max() > 1.5
    rows = rng.standard_normal((5, 3))
    np.testing.assert_allclose(apart(effect, stretch)(rows), (vectors / np.sqrt(values)) @ vectors.T @ rows, atol=1e-12)
