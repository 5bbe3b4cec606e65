"""An arm on a bench that is not as its file says: what is named, whether answers hold the truth; world by MuJoCo."""

import re

import numpy as np
import pytest

from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import RigidBody, elements
from onboard.dynamics.model.payload import body_of
from onboard.dynamics.model.urdf import with_bodies
from onboard.estimation.policy import LEAST_WEIGHT, ODDS, sigmas, wider
from onboard.identification.quantities import Findings
from onboard.identification.rows.checks import remade, suspects
from onboard.identification.rows.checks.prediction import prediction
from onboard.identification.rows.checks.remade import KeptTicks, SmoothedTicks
from onboard.identification.rows.checks.tick_rows import Left, TickRows
from onboard.identification.rows.held_out import held_out
from onboard.identification.rows.stated_errors.considered import Considered, ConsideredErrors
from onboard.identification.standing import Level
from tests.identification.rows import test_grasped as bench
from tests.identification.rows.checks.arm_on_bench import (
    AXES,
    HEAVY,
    TOOL,
    fed,
    geared,
    identifier,
    late,
    level,
    mass,
    mounted,
    part,
    read,
    run,
    stuck,
    tilted,
    zero,
)

WRONG = {
    "a zero": (zero(0, 0, 0.03, 0, 0), "zero_joint_3"),
    "a large zero": (zero(0, 0, 0, 0.15, 0), "zero_joint_4"),
    "zeros": (zero(0.003, -0.004, 0.003, 0.002, -0.004), "zeros of all joints"),
    "an encoder's scale": (geared(2, 0.98), "scale_joint_2"),
    "a late joint": (late(4, 0.006), "delay_joint_4"),
    "an axis": (read("wrist_force_y", 1.05), "wrist_force_y"),
    "a moment's axis": (read("wrist_moment_x", 0.93), "wrist_moment_x"),
    "an axis that steps": (read("wrist_force_z", 1.02, 8.4), "a step of wrist_force_z"),
    "the mount": (mounted([0.0, 0.03, 0.0]), "cells at wrist"),
    "the level": (tilted([0.02, 0.0, 0.0]), "level of bench"),
}
AS_OTHERS = (
    "a moment's axis",
    "an encoder's scale",
    "the level",
)  # an axis, a zero stay; test_errors_of_angles


@pytest.mark.parametrize("heavy", [False, pytest.param(True, marks=pytest.mark.campaign)])  # another tool
def test_an_arm_that_is_as_stated_is_believed(heavy):
    who = fed(heavy=heavy)
    off, sigma = mass(who, HEAVY.mass_kg if heavy else TOOL.mass_kg)
    assert who.findings() == ((), (), ())
    assert level(who) is Level.GOOD
    assert abs(off) < 3.0
    assert sigma < 2e-3


@pytest.mark.parametrize(("row", "factor"), [("wrist_force_y", 1.1), ("wrist_moment_x", 0.9)])
def test_an_axis_that_explains_rows_that_contradict_is_taken_out(row, factor):
    who = identifier()
    bench.feed(who, read(row, factor)(run()))
    assert "% of the rows contradict the others" in who.contradicted
    assert who.findings().against == ()
    assert who.findings().doubts[0] == f"not as stated: {row}"
    assert abs(mass(who)[0]) < 3.0
    assert mass(who)[1] < 5e-3
    at_recursion = prediction(who.seen, who.model, who.base, who.block_jackknife(exact=True).mean)
    assert held_out(who).fit.relative_error == pytest.approx(at_recursion.relative_error)


@pytest.mark.parametrize("share", [0.4, 0.55])
def test_what_is_wrong_is_named_however_many_rows_are_of_before_the_estimate_settled(monkeypatch, share):
    since_s = float(np.quantile(run().time_s, share))
    monkeypatch.setattr(ConsideredErrors, "settled_s", lambda *_, **__: (since_s, since_s))
    who = identifier()
    bench.feed(who, read("wrist_force_y", 1.1)(run()))
    assert who.findings().doubts[0] == "not as stated: wrist_force_y"
    assert abs(mass(who)[0]) < 3.0


@pytest.mark.parametrize("what", ["a late joint", "an axis that steps"])
def test_what_no_sum_over_all_rows_has_competes(what):
    """A joint late by 6 ms was good, and not named."""
    wrong, name = WRONG[what]
    who = identifier()
    bench.feed(who, wrong(run()))
    assert any(name in said for said in who.findings().doubts)
    assert abs(mass(who)[0]) < 3.0


def test_what_comes_nearest_to_rows_that_contradict_is_named():
    who = identifier()
    bench.feed(who, read("wrist_force_y", 1.4)(run()))
    named = "wrist_force_y is farther from what is stated than"
    assert re.search(rf"% of the rows contradict the others; {named}\b", who.findings().against[0])
    assert not who.estimate().quantities[0].supported


@pytest.mark.parametrize(
    "what", [pytest.param(one, marks=pytest.mark.campaign if one in AS_OTHERS else ()) for one in WRONG]
)
def test_what_is_wrong_is_named_and_the_mass_is_as_well_known_as_without_it(what):
    wrong, name = WRONG[what]
    who = fed(wrong)
    off, sigma = mass(who)
    found = who.findings()
    assert found.against == ()
    assert found.doubts[0].startswith(f"not as stated: {name}")
    assert level(who) is Level.WEAK
    assert abs(off) < 3.0
    assert sigma < 2e-3


def test_where_all_as_stated_leaves_no_more_than_noise_no_kept_tick_is_asked(monkeypatch):
    """Errors of coarse encoders are alike from tick to tick: healthy arms had a cell that steps."""
    asked, weigh = list[bool](), suspects.RowSuspects._weigh
    monkeypatch.setattr(suspects.RowSuspects, "_weigh", lambda *of: asked.append(True) or weigh(*of))
    for factor in (1.0, 8.0):
        who, given = identifier(), run()
        bench.feed(who, given._replace(sigma=factor * given.sigma))
        assert who.findings() == Findings()
        asked.clear()
        who._bank._weighed_at[:] = 0.0
        who._bank.go_on(who, contradicted=False)
        assert bool(asked) is (factor == 1.0)


def test_with_an_imu_on_the_bench_what_is_wrong_is_named_too():
    """Errors of the IMU are among those that the sums over rows have; the estimator ended with an IndexError."""
    effects = ["accelerometer_bias", "accelerometer_scale", "accelerometer_misalignment"]
    of_imu = [Considered(f"{effect} {k}", "bench", effect, 1e-4, axis=k % 3) for effect in effects for k in range(30)]
    who = identifier(more=of_imu)
    bench.feed(who, geared(5, 0.98)(run()))
    assert who.findings().doubts[0].startswith("not as stated: scale_joint_5")
    assert abs(mass(who)[0]) < 3.0
    bank, ticks = who._bank, who._bank._kept.ticks
    bank._weigh_all(who, who.rls.solve().mean, ticks)
    assert bank.explanation.startswith("not as stated: scale_joint_5")


def test_scales_of_all_cells_are_not_told_from_a_gripper_that_is_heavier():
    def wrong(given):
        return given._replace(measured=1.08 * given.measured)

    who = fed(wrong)
    off, sigma = mass(who)
    assert {"all cells", "gripper"} <= set(who.suspects.weighed.names)
    assert abs(off) < 3.0
    assert 0.01 < sigma < 0.1


def test_a_gripper_that_was_exchanged_is_not_taken_for_scales_of_all_cells():
    """The file says 10 % less than it weighs, 3 mm beside its centre."""
    vehicle = identifier().model.vehicle
    at = 10 * vehicle.links.index("gripper")
    mass_kg, centre_m, inertia = body_of(vehicle.chi[at : at + 10])
    drawn = RigidBody(mass_kg / 1.1, centre_m + np.array([0.003, 0.0, 0.0]), inertia / 1.1)
    who = identifier(with_bodies(bench.URDF, {"gripper": drawn}))
    bench.feed(who, run())
    likeliest = who.suspects.weighed.likeliest
    assert likeliest.suspect.name == "gripper"
    assert len(likeliest.numbers) == 1
    assert abs(mass(who)[0]) < 3.0


def test_a_turned_sign_is_no_error_of_a_scale():
    who = fed(read("wrist_force_x", -1.0))
    against = who.findings().against
    named = "wrist_force_x is farther from what is stated than any error that is estimated"
    assert re.fullmatch(rf"\d+% of the rows contradict the others; {named}", against[0])
    assert not who.estimate().quantities[0].supported


def test_readings_that_nothing_explains_are_refused():
    noise = np.repeat(np.random.default_rng(1).standard_normal(60), 12)

    def wrong(given):
        measured = given.measured.copy()
        measured[:, 4] += 0.3 * np.ptp(measured[:, 4]) * noise[: len(measured)]
        return given._replace(measured=measured)

    assert any("wrist_moment_y reads is left over" in text for text in fed(wrong).findings().against)


@pytest.mark.parametrize(("share", "against"), [(0.08, True), (0.02, False)])
def test_more_than_one_row_in_twenty_that_is_far_off_refuses_all(rng, share, against):
    def wrong(given):
        measured = given.measured.copy()
        measured[rng.random(len(measured)) < share] += 0.1 * np.ptp(measured, axis=0)
        return given._replace(measured=measured)

    said = fed(wrong).findings().against
    assert any("of the rows contradict the others" in one for one in said) == against


def test_a_large_error_is_linearised_anew(monkeypatch):
    """A zero of 150 mrad is one where rows are made about it; about none it is "farther than any" or several things."""
    wrong, name = WRONG["a large zero"]
    monkeypatch.setattr(suspects, "ROUNDS", 1)
    once = fed(wrong)
    assert name not in once.suspects.weighed.names or abs(mass(once)[0]) > 3.0 or mass(once)[1] > 2e-3


def test_weighed_again_after_a_fifth_more_rows_with_the_payload_or_without(monkeypatch):
    who, given, made = identifier(), run(), []
    weigh = TickRows.equations
    monkeypatch.setattr(TickRows, "equations", lambda *of: made.append(len(of[0].ticks.time_s)) or weigh(*of))
    for first in range(0, 400, 4):
        bench.feed(who, part(given, slice(first, first + 4)))
    apart = np.diff(sorted(set(made)))
    assert made[0] >= 20
    assert (apart >= 3).all()
    assert apart[-1] > 10


def test_an_answer_covers_the_one_before_where_what_is_likeliest_wrong_has_changed():
    """An encoder is stuck for a while: of the first rows of that a step of cells is made, which the next ones deny."""
    truth = np.array([TOOL.mass_kg, *TOOL.centre_of_mass_m, *elements(TOOL.inertia_kg_m2)])
    who, given = identifier(), stuck(2, 7.0, 1.0)(run())
    likeliest, farthest = set(), 0.0
    for first in range(0, len(given.time_s), 8):
        bench.feed(who, part(given, slice(first, first + 8)))
        for one, true in zip(who.estimate().quantities, truth, strict=True):
            if one.supported:
                likeliest.add(who._bank.weighed.names)
                farthest = max(farthest, abs(one.value - true) / one.sigma)
    assert len(likeliest) > 1
    assert farthest < sigmas(LEAST_WEIGHT)


def test_answers_do_not_depend_on_when_they_are_asked_for():
    asked, quiet = identifier(), identifier()
    for who in (asked, quiet):
        bench.feed(who, WRONG["a zero"][0](run()))
        if who is asked:
            who.estimate()
            who.findings()
            who.block_jackknife()
    np.testing.assert_array_equal(asked.estimate().mean, quiet.estimate().mean)
    np.testing.assert_array_equal(asked.estimate().sigma, quiet.estimate().sigma)


def test_every_nth_tick_is_kept_however_they_come(monkeypatch):
    monkeypatch.setattr(remade, "MOST_TICKS", 10)
    for parts in ([97], [1] * 97, [13, 40, 44]):
        kept, first = KeptTicks(), 0
        for count in parts:
            t = np.arange(first, first + count, dtype=float)
            kept.add(SmoothedTicks(t, *(t[:, None] for _ in range(7)), t > 0, *(t[:, None] for _ in range(4))))
            first += count
        assert kept.every == 16
        np.testing.assert_array_equal(kept.ticks.time_s, np.arange(0.0, 97.0, 16.0))
        np.testing.assert_array_equal(kept.ticks.q[:, 0], kept.ticks.time_s)


def test_what_is_left_over_and_alike_for_long_counts_as_more_noise(rng):
    left, again = np.zeros((400, 2)), rng.standard_normal((400, 2))
    for k in range(1, 400):
        left[k] = [0.7, 0.0] * left[k - 1] + np.sqrt([0.51, 1.0]) * again[k]
    own = np.zeros((400, 1))
    ticks = SmoothedTicks(own[:, 0], *(own for _ in range(7)), own[:, 0] > 0, left, own, np.ones((400, 2)), own)
    alike, white = Left(np.zeros((400, 2, 1)), left, ticks, 1).noise(np.zeros(1), np.ones(2))
    assert 3.0 < alike < 8.0  # (1 + r) / (1 - r) is 5.7
    assert white < 1.4


def test_a_cell_that_nothing_explains_is_named_and_the_others_answer():
    """Twelve sigmas that come and go in four seconds: neither a scale nor a step nor a delay of it."""
    given, who, sound = run(), identifier(), identifier()
    measured = given.measured.copy()
    measured[:, AXES.index("wrist_moment_y")] += 12.0 * bench.NOISE[3] * np.sin(0.5 * np.pi * given.time_s)
    bench.feed(who, given._replace(measured=measured))
    bench.feed(sound, given)
    found = who.findings()
    assert found.against == ()
    assert found.doubts == ("wrist_moment_y contradicts the others by more than its noise, and hardly counts",)
    assert level(who) is Level.WEAK
    truth = [TOOL.mass_kg, *TOOL.centre_of_mass_m]
    for one, other, true in zip(who.estimate().quantities, sound.estimate().quantities, truth, strict=False):
        assert abs(one.value - true) < 3.3 * one.sigma
        assert one.sigma < 3.0 * other.sigma  # five axes in place of six


def test_what_nothing_on_board_shows_is_in_the_99_9_percent_interval_and_hardly_in_that_of_95():
    """As where a single cell weighs: with a probability of 0.01 its scale is 10 % off, and nothing would tell."""
    who = fed()
    bank, weighed = who._bank, who._bank.weighed
    assert not who.suspects
    assert not weighed.names
    assert [one for one, _, _ in bank.unseen] == [one.weight for one in weighed.counting if one.suspect]
    heavier = 0.1 * TOOL.mass_kg * np.eye(len(who.base.names))[:, [who.base.names.index("M_tool")]]
    halves = []
    for unseen in ((), ((ODDS, np.zeros(len(heavier)), heavier),)):
        bank.unseen, who._estimated = unseen, None
        one = who.estimate().quantities[0]
        halves.append((one.high - one.value, one.outer[1] - one.value))
    (alone, far), (half, farther) = halves
    assert far == pytest.approx(wider() * alone)
    assert alone < half < 1.1 * alone
    assert farther == pytest.approx(0.1645 * TOOL.mass_kg, rel=0.15)  # of what is beyond, a twentieth on each side


def test_of_all_as_stated_contradicted_nothing_is_unseen():
    who = fed(WRONG["a zero"][0])
    assert who.suspects
    assert who._bank.unseen == ()


@pytest.mark.parametrize("error", [np.linalg.LinAlgError, SignalError])
def test_where_gauss_and_newton_have_gone_where_no_motion_is_the_last_answer_counts(monkeypatch, error):
    """No estimator ends in flight."""
    who, made, weigh = fed(WRONG["a zero"][0]), [], TickRows.equations

    def once(*of):
        made.append(True)
        if len(made) > 1:
            raise error
        return weigh(*of)

    monkeypatch.setattr(TickRows, "equations", once)
    who._bank._weigh(who._bank._kept.ticks, who.rls.solve().mean, who.correlation)
    assert len(made) == 2
    assert who._bank.weighed.names
    assert np.isfinite(who._bank.answer.known[0]).all()
