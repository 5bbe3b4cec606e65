"""Calibrations that an estimate leans on, and the drawn arm as a witness of them."""

import numpy as np
import pytest

from onboard.identification.quantities import Findings
from onboard.identification.rows.stated_errors.considered import Considered
from tests.identification.rows.rocksat_flight import feed, flight, identifier, part, setup

CAUSES = (
    Considered("scale", "load_cell", "scale", 0.0025, "load_cell scale_sigma"),
    Considered("scale of joint_1", "joint_1", "joint_scale", 0.0005, "joint_1 scale_sigma"),
    Considered("zero of joint_1", "joint_1", "joint_zero", 0.001, "joint_1 zero_sigma_rad"),
)


@pytest.mark.parametrize(
    ("scale", "level"),
    [(1.0, ""), (0.85, "doubts"), pytest.param(1.35, "against", marks=pytest.mark.campaign), (0.5, "against")],
)  # less
def test_an_arm_that_does_not_weigh_what_was_drawn_tells_of_a_wrong_scale(rng, scale, level):
    signals, held, _ = flight(rng)
    who = identifier(CAUSES)
    feed(who, signals._replace(measured=scale * signals.measured), held)
    found = who.findings()
    assert bool(found.against) is (level == "against")
    assert bool(found.doubts) is (level == "doubts")
    for said in (*found.against, *found.doubts):
        assert said.startswith("m_arm is 0.")
        assert said.endswith("check load_cell scale_sigma, joint_1 scale_sigma")


@pytest.mark.parametrize(
    ("scale", "after"),
    [(1.0, "always"), pytest.param(0.85, "always", marks=pytest.mark.campaign), (0.87, "the release")],
)  # of part of it
def test_intervals_contain_a_scale_that_the_drawn_arm_shows(rng, scale, after):
    """By the rows each inertia is known to a few per mille, and no row shows a scale that is wrong for all of them."""
    signals, held, _ = flight(rng)
    who = identifier(CAUSES)
    rows_scale = np.where(held & (after == "the release"), 1.0, scale)[:, None]
    feed(who, signals._replace(measured=rows_scale * signals.measured), held)
    assert bool(who.findings().doubts) is (scale != 1.0)
    _, model, base, quantities = setup()
    drawn = {one.name: float(one.weights @ base.value(model.chi)) for one in quantities}
    wide = {}
    for one in who.estimate().quantities:
        assert one.high - one.value == pytest.approx(one.value - one.low)
        assert abs(one.value - drawn[one.name]) < 1.68 * (one.high - one.value), one.name
        wide[one.name] = (one.high - one.value) / one.value
    assert len(wide) == 5
    assert wide["ZZ_joint_1_R_released"] < 0.02 or scale != 1.0
    assert wide["ZZ_joint_1_R_released"] < 0.5


def test_before_the_release_nothing_is_known_of_the_arm_and_nothing_is_said(rng):
    signals, held, _ = flight(rng)
    who = identifier(CAUSES)
    before = part(signals._replace(measured=0.5 * signals.measured), held)
    feed(who, before, held[held])
    assert who.rows_used > 500
    assert who.findings() == Findings()


def test_an_answer_names_the_calibrations_it_stands_and_falls_with(rng):
    signals, held, _ = flight(rng)
    who = identifier(CAUSES)
    feed(who, signals, held)
    found = {one.name: one for one in who.estimate().quantities}
    assert found["m_tip_mass"].leans == (
        "leans on load_cell scale_sigma 0.25 %, joint_1 scale_sigma 0.05 %, the centre of mass of tip_mass"
    )
    assert found["ZZ_joint_1_R_held"].leans == "leans on load_cell scale_sigma 0.25 %, joint_1 scale_sigma 0.05 %"


def test_a_zero_moves_the_estimate_by_what_the_interval_allows(rng):
    """An encoder whose zero is 1 mrad off: the estimate moves by one sigma of a zero known to 1 mrad."""
    signals, held, _ = flight(rng)
    who, other = identifier(CAUSES[2:]), identifier(())
    feed(who, signals, held)
    feed(other, signals._replace(q=signals.q + 1e-3), held)
    moved = other.block_jackknife().mean - who.block_jackknife().mean
    sensitivity = 1e-3 * who.rls.solve().sensitivity[:, 0]
    assert np.abs(moved).max() > 1e-9
    assert np.abs(moved - sensitivity).max() < 0.3 * np.abs(moved).max()  # its column is of the estimate at the time


def test_a_link_of_another_shape_matters_by_its_own_inertia_only():
    _, _, _, quantities = setup()
    tip = next(one for one in quantities if one.name == "m_tip_mass")
    causes = {one.cause: one.weights for one in tip.leanings}
    radius, centre, place = (
        np.linalg.norm(causes[f"the {what} of tip_mass"]) for what in ("radius of gyration", "centre of mass", "place")
    )
    assert place == pytest.approx(0.25 * centre)
    assert 0.001 < radius / centre < 0.01  # 0.3 % of its inertia about the joint is its own
    arm = next(one for one in quantities if one.name == "m_arm")
    assert not next(one for one in arm.leanings if one.cause == "the place of arm").weights.any()
