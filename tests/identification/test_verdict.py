"""The verdict's rules, one by one, and what they are made of: motion held out, the directions a motion shows."""

import numpy as np
import pytest

from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.estimation.policy import sigmas
from onboard.estimation.recursive.rls import SquareRootRls
from onboard.identification.corrections import DOUBTFUL, doubtful, doubtful_from, refused_from
from onboard.identification.observability import observed_directions
from onboard.identification.quantities import Findings, QuantityEstimate, Useful, sizes
from onboard.identification.rows.checks.prediction import HeldOutFit
from onboard.identification.rows.held_out import HeldOut, held_out
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.standard import identified_links, link_estimate, standard_posterior
from onboard.identification.standing import Level, Standing, standing
from onboard.identification.verdict import Evidence, standings_of, verdict
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.rows import RowModel, base_force_rows, base_moment_rows
from tests.dynamics.mujoco_twin import random_vehicle, to_urdf

NOISE_ALONE = 1.0  # residual sum a row
FINE = HeldOutFit(0.05, NOISE_ALONE)


def evidence(**changed):
    known = {
        "rows_used": 1000,
        "refused": {"gap": 10},
        "asked": {"mass": True, "I_zz": True},
        "held_out": HeldOut(FINE, FINE, FINE),
    }
    return Evidence(**{**known, **changed})


def test_good_data_are_good():
    found = verdict(evidence())
    assert found == (Level.GOOD, (), ())
    assert found.text == "good"


@pytest.mark.parametrize(
    ("changed", "level"),
    [
        ({"findings": Findings(("6% of the rows contradict the others",))}, Level.DO_NOT_USE),
        ({"misfit": 100.0}, Level.DO_NOT_USE),
        ({"findings": Findings(doubts=("not as stated: a step of scale_j2",))}, Level.WEAK),
        ({"corrections": {"zero_j2": 4.0}}, Level.WEAK),
        ({"held_out": None}, Level.WEAK),
        ({"findings": Findings(widened=("zero_j2 is taken as 3 mrad",))}, Level.GOOD),
    ],
)
def test_what_is_said_of_all_is_said_of_each(changed, level):
    each = {"mass": Standing(Level.GOOD), "I_zz": Standing(Level.WEAK, "its interval contains zero")}
    judged = evidence(standings=each, **changed)
    stand, reasons = standings_of(judged), verdict(judged).reasons
    assert stand["mass"].level is level
    assert stand["mass"].why in reasons
    assert stand["I_zz"].level is (Level.DO_NOT_USE if level is Level.DO_NOT_USE else Level.WEAK)
    if level is Level.WEAK:
        assert stand["I_zz"].why == f"its interval contains zero; {stand['mass'].why}"


@pytest.mark.parametrize(("stuck", "told"), [(50, False), (60, True)])
def test_readings_that_repeat_are_told_of_good_data_too(stuck, told):
    """A count that is written twice looks stuck: of 1000 rows and these, one in twenty is 52."""
    found = verdict(evidence(refused={"stuck": stuck}))
    assert found.level is Level.GOOD
    assert (found.text != "good") == told
    if told:
        assert found.text.startswith("good: 6% of the rows were refused, as a reading repeats")
        assert "repeats = true" in found.text


def test_answers_of_before_a_jump_are_weak():
    found = verdict(evidence(refused={"jumped": 1}))
    assert found.level is Level.WEAK
    assert (
        found.text
        == "weak: the angle of a joint jumps between two samples; nothing is used from there until it jumps back"
    )


def test_a_payload_that_is_not_determined_is_told_with_what_took_its_rows():
    """A coupling that slips before the payload is taken: no row with the payload is used, moving more is no remedy."""
    jumps = "a3: its angle jumps between two samples"
    undetermined = "the data do not determine a mass apart from zero"
    found = verdict(evidence(refused={"jumped": 1}, failure=undetermined, findings=Findings((), ("scale is off",))))
    assert found.level is Level.DO_NOT_USE
    assert found.reasons[:2] == (undetermined, "scale is off")
    assert found.reasons[2].startswith("the angle of a joint jumps")
    mass = QuantityEstimate("m_payload", "kg", np.nan, np.nan, np.nan, np.nan, False, note=undetermined)
    assert standing(mass, Findings((), (jumps,))) == (Level.WEAK, f"{undetermined}; {jumps}")


def test_what_is_not_determined_is_named():
    found = verdict(evidence(asked={"mass": True, "I_xx": False, "I_zz": False}))
    assert found.level is Level.WEAK
    assert found.text == "weak in these directions: I_xx, I_zz"


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"rows_used": 0, "refused": {"gap": 264, "phase": 4}}, "no row could be used (264 gap, 4 phase)"),
        ({"rows_used": 0, "refused": {}}, "no row could be used (there was none)"),
        ({"asked": {"mass": False, "I_zz": False}}, "the motion determines nothing that was asked"),
        ({"findings": Findings(("6% of the rows contradict the others",))}, "6% of the rows contradict the others"),
        ({"held_out": HeldOut(FINE, FINE, HeldOutFit(0.4, 20.0))}, "40% of it is left over"),
        ({"held_out": HeldOut(HeldOutFit(1.2, 9.0), FINE, FINE)}, "from the other is off by 120%"),
        ({"held_out": HeldOut(HeldOutFit(1.2, 9.0), HeldOutFit(1.5, 1.0), FINE)}, "from the other is off by 120%"),
        ({"failure": "the fit gave up: not converged"}, "the fit gave up"),
        ({"misfit": 2.5}, "2.5 times the noise is left over"),
        ({"away": {"payload": 6.0}}, "the estimate of payload cannot exist: 6 sigmas from any body"),
        ({"away": {"payload": np.inf}}, "no body is near it"),
        (
            {"findings": Findings(("load_cell reads 2% of what was drawn",))},
            "load_cell reads 2%",
        ),
        ({"standings": {"mass": Standing(Level.DO_NOT_USE, "it cannot be negative")}}, "mass: it cannot be negative"),
        ({"corrections": {"gyro_scale_x": 17.0, "delay": 0.3}}, "gyro_scale_x had to be corrected by 17"),
        ({"corrections": {f"scale_{k}": 2.9 for k in range(20)}}, "20 of them sum to 168"),
    ],
)
def test_reasons_not_to_use_it(changed, said):
    found = verdict(evidence(**changed))
    assert found.level is Level.DO_NOT_USE
    assert said in found.text


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"held_out": None}, "too short to be checked"),
        ({"findings": Findings((), ("load_cell reads +2% from one time on",))}, "load_cell reads +2%"),
        (
            {"standings": {"mass": Standing(Level.WEAK, "its interval contains zero")}},
            "mass: its interval contains zero",
        ),
        ({"held_out": HeldOut(FINE, HeldOutFit(0.6, 5.0), FINE)}, "off by 60%"),
        ({"held_out": HeldOut(FINE, HeldOutFit(0.6, 2.5), FINE), "correlation": 2.0}, "off by 60%"),
    ],
)
def test_reasons_to_take_it_with_care(changed, said):
    found = verdict(evidence(**changed))
    assert found.level is Level.WEAK
    assert said in found.text


def test_what_noise_explains_is_no_reason():
    noisy = HeldOutFit(1.5, 1.2)
    assert verdict(evidence(held_out=HeldOut(noisy, noisy, noisy))).level is Level.GOOD
    assert verdict(evidence(refused={"residual": 40}, away={"payload": 2.0}, misfit=1.5)).level is Level.GOOD


def test_a_correction_of_three_sigmas_is_a_reason_for_care():
    found = verdict(evidence(corrections={"gyro_scale_x": -3.4, "gyro_scale_y": 1.0}))
    assert found.level is Level.WEAK
    assert found.reasons == ("gyro_scale_x had to be corrected by 3.4 of its stated sigmas",)


def test_the_largest_of_many_corrections_is_beyond_three_sigmas_by_chance(rng):
    """Of a hundred that are as stated it is doubted in one flight of 600, and one of five sigmas in every one."""
    drawn = np.abs(rng.standard_normal((4000, 100)))
    beyond_three = (drawn.max(axis=1) > 3.0).mean()
    assert beyond_three == pytest.approx(1.0 - 0.9973**100, abs=0.03)  # 24 %
    named = [{str(k): float(one) for k, one in enumerate(row)} for row in drawn]
    assert 1 <= sum(bool(doubtful(one)) for one in named) < 16  # 6.7 expected
    assert doubtful(named[0] | {"gyro_scale_x": 4.9})
    assert [doubtful_from(count) for count in (0, 1)] == [DOUBTFUL] * 2
    assert doubtful_from(100) == pytest.approx(4.30, abs=0.01)  # 1 - 0.99^(1/600) on both sides
    found = verdict(evidence(corrections={"link_5_inertial_2": 3.1, **{str(k): 0.5 for k in range(228)}}))
    assert found.level is Level.GOOD


def test_what_is_not_known_well_enough_is_weak_and_no_refusal():
    wide, good = Standing(Level.WEAK, "its interval contains zero"), Standing(Level.GOOD)
    for moment in (good, wide):
        assert verdict(evidence(standings={"mass": wide, "I_zz": moment})).level is Level.WEAK


def test_corrections_within_their_sigmas_are_no_reason():
    assert verdict(evidence(corrections={f"bias_{k}": 1.2 for k in range(30)})).level is Level.GOOD


def quantity(mean, half, name="m_payload", unit="kg", supported=True):
    return QuantityEstimate(name, unit, mean, half / 2, mean - half, mean + half, supported, note="a note")


@pytest.mark.parametrize(
    ("found", "level", "said"),
    [
        (quantity(2.0, 0.1), Level.GOOD, ""),
        (quantity(-1e-4, 1e-6), Level.DO_NOT_USE, "cannot be negative"),
        (quantity(0.1, 0.2), Level.WEAK, "contains zero"),
        (quantity(-0.1, 0.2, "I_xx_payload", "kg m^2"), Level.WEAK, "contains zero"),  # a small load: as noise has it
        (quantity(2.0, 1.2), Level.WEAK, "as wide as 60% of it"),
        (quantity(2.0, 0.5), Level.WEAK, "as wide as 25% of it"),
        (quantity(2.0, 0.3), Level.GOOD, ""),
        (quantity(-0.3, 0.1, "I_xy_payload", "kg m^2"), Level.GOOD, ""),
        (quantity(-0.3, 0.1, "I_xx_payload", "kg m^2"), Level.DO_NOT_USE, "cannot be negative"),
        (quantity(-0.3, 0.1, "c_x_payload", "m"), Level.GOOD, ""),
        (quantity(2.0, 0.1, supported=False), Level.WEAK, "a note"),
    ],
)
def test_a_quantity_stands_by_what_is_possible_and_by_its_interval(found, level, said):
    standing_of = standing(found, Findings(), sizes([found], Useful()).get(found.name))
    assert standing_of.level is level
    assert said in standing_of.why


def test_what_speaks_against_all_answers_speaks_against_each():
    assert standing(quantity(2.0, 0.1), Findings(("the cells contradict each other",))).level is Level.DO_NOT_USE
    assert standing(quantity(2.0, 0.1), Findings((), ("a doubt",))) == (Level.WEAK, "a doubt")


# --- what the evidence is made of -----------------------------------------------------------------------------------


@pytest.fixture
def identifier(rng):
    vehicle = VehicleModel(
        to_urdf(random_vehicle(rng, ["revolute", "fixed"])), VehicleSpec(BaseKind.FREE, "base", "link_2")
    )
    model = RowModel(vehicle, [*base_force_rows(vehicle), *base_moment_rows(vehicle)])
    base = base_parameters(model, np.random.default_rng(1))
    return Identifier(model, base, 2.0 * np.eye(len(model.names)), 0.5)


def rows(rng, identifier, n, truth, noise):
    Y = rng.normal(size=(n, truth.size))
    return 0.01 * np.arange(n), rng.random(n) < 0.5, Y, Y @ truth + noise * rng.normal(size=n), np.full(n, 0.1)


def test_the_halves_are_predicted_as_brute_force_predicts_them(rng, identifier):
    truth = rng.normal(size=len(identifier.base.names))
    t, held, Y, y, sigma = rows(rng, identifier, 20_000, truth, 0.3)  # 400 blocks, so that they have been merged
    seen = identifier.seen = RowBlocks(truth.size, 0.5, ("cell",))
    for part in np.array_split(np.arange(t.size), 37):
        seen.add(t[part], held[part], np.zeros(part.size, np.intp), Y[part], y[part], sigma[part], sigma[part], None)
        identifier.rls.update(Y[part], y[part], sigma[part])
        identifier.recursion.blocks.add(t[part], Y[part], y[part], sigma[part])
    found = held_out(identifier)
    first = t < t[t.size // 2]
    information, right = identifier.rls.prior_equations()
    for prediction, train in ((found.later, first), (found.earlier, ~first)):
        weighted = Y[train].T / sigma[train] ** 2
        chi = np.linalg.solve(weighted @ Y[train] + information, weighted @ y[train] + right)
        left = y[~train] - Y[~train] @ chi
        few_blocks = 0.05  # the halves are cut between blocks, not between rows
        relative = np.linalg.norm(left) / np.linalg.norm(y[~train])
        assert prediction.relative_error == pytest.approx(relative, rel=few_blocks)
        assert prediction.misfit == pytest.approx(np.mean(left**2) / 0.01, rel=few_blocks)
    assert found.fit.misfit == pytest.approx(np.mean((y - Y @ identifier.block_jackknife().mean) ** 2) / 0.01, rel=1e-9)
    assert found.worst == max(found.later, found.earlier)


def test_another_body_in_the_second_half_is_seen_there_and_only_there(rng, identifier):
    truth = rng.normal(size=len(identifier.base.names))
    t, held, Y, y, sigma = rows(rng, identifier, 2000, truth, 0.01)
    y[1000:] += Y[1000:] @ rng.normal(size=truth.size)
    seen = identifier.seen = RowBlocks(truth.size, 0.5, ("cell",))
    seen.add(t, held, np.zeros(t.size, np.intp), Y, y, sigma, sigma, None)
    identifier.rls.update(Y, y, sigma)
    assert held_out(identifier).worst.relative_error > 0.5
    assert held_out(identifier).worst.misfit > 100.0


def test_what_a_half_does_not_tell_of_a_body_is_no_misfit_of_the_other(rng, identifier):
    """Thrown bodies whose wheel is at its speed in the later half were refused: the whole throw was healthy."""
    truth = rng.normal(size=len(identifier.base.names))
    t, held, Y, _, sigma = rows(rng, identifier, 2000, truth, 0.0)
    Y[900:, 0] *= 1e-3  # before a block that both halves could share
    y = Y @ truth + 0.1 * rng.normal(size=2000)
    seen = identifier.seen = RowBlocks(truth.size, 0.5, ("cell",))
    seen.add(t, held, np.zeros(t.size, np.intp), Y, y, sigma, sigma, None)
    identifier.rls.update(Y, y, sigma)
    found = held_out(identifier)
    noise = pytest.approx(1.0, abs=0.2)
    assert (found.later.misfit, found.earlier.misfit) == (noise, noise)
    assert found.earlier.relative_error > 2.0 * found.fit.relative_error


def test_noise_of_the_regressor_is_taken_out_of_each_half(rng, identifier):
    """Half of the information along each column is noise: without the correction each half predicts half of it."""
    truth = np.ones(len(identifier.base.names))
    t, held, Y, y, sigma = rows(rng, identifier, 8000, truth, 0.0)
    noisy = Y + rng.normal(size=Y.shape)
    doubt = np.repeat(np.eye(truth.size)[None], t.size, axis=0)
    told = {}
    for name, noise in (("corrected", doubt), ("plain", None)):
        seen = identifier.seen = RowBlocks(truth.size, 10.0, ("cell",))
        seen.add(t, held, np.zeros(t.size, np.intp), noisy, y, sigma, sigma, noise)
        told[name] = held_out(identifier).later.misfit
    expected = truth.size / 0.01  # all of the noise, where the parameters are the true ones
    assert told["corrected"] == pytest.approx(expected, rel=0.1)
    assert told["plain"] == pytest.approx(0.5 * expected, rel=0.1)


def test_one_block_cannot_be_halved(rng, identifier):
    truth = rng.normal(size=len(identifier.base.names))
    seen = identifier.seen = RowBlocks(truth.size, 50.0, ("cell",))
    assert held_out(identifier) is None
    t, held, *rest = rows(rng, identifier, 100, truth, 0.1)
    seen.add(t, held, np.zeros(t.size, np.intp), *rest, rest[-1], None)
    assert held_out(identifier) is None


def test_directions_that_no_row_shows_are_named(rng):
    rls = SquareRootRls(3)
    rls.prior(np.zeros(3), np.array([1.0, 10.0, 0.1]))
    Y = np.outer(rng.normal(size=200), [0.0, 0.1, 10.0])  # one combination of b and c, each in its prior's units
    rls.update(Y, np.zeros(200), np.full(200, 0.01))
    found = observed_directions(rls.observability(), ("a", "b", "c"))
    assert (found.determined, found.of) == (1, 3)
    assert found.condition == pytest.approx(1.0)
    assert set(found.undetermined) == {"a", "0.71 b - 0.71 c"} or set(found.undetermined) == {"a", "0.71 c - 0.71 b"}


def test_standard_parameters_are_the_posterior_of_the_prior_and_what_is_told(rng, identifier):
    """With everything told, to the last digit: what base parameters are blind to stays as drawn, with its sigma."""
    model, base = identifier.model, identifier.base
    Y = rng.normal(size=(4000, len(base.names)))
    chi = model.chi + 0.01 * rng.normal(size=model.chi.size)
    identifier.rls.update(Y, Y @ base.value(chi), np.full(4000, 1e-6))
    identifier.recursion.blocks.add(0.01 * np.arange(4000), Y, Y @ base.value(chi), np.full(4000, 1e-6))
    links = identified_links(identifier, standard_posterior(identifier))
    assert len(links) > 0
    assert {one.link for one in links} <= set(model.vehicle.links)
    G, variance = base.grouping, 4.0
    K = variance * G.T @ np.linalg.inv(variance * G @ G.T)
    posterior = model.chi + K @ (base.value(chi) - base.value(model.chi))
    left = variance * (np.eye(model.chi.size) - K @ G)
    for one in links:
        own = slice(10 * model.vehicle.links.index(one.link), 10 * model.vehicle.links.index(one.link) + 10)
        np.testing.assert_allclose(one.mean, posterior[own], atol=1e-6)
        np.testing.assert_allclose(one.covariance, left[own, own], atol=1e-6)


def test_what_is_no_body_is_told_with_its_distance():
    thin = RigidBody(2.0, np.zeros(3), np.diag([0.1, 0.1, -0.02]))
    narrow, wide = (np.diag(np.r_[1e-4, [1e-4] * 3, [sigma] * 6] ** 2) for sigma in (1e-3, 1e-1))
    assert link_estimate("payload", standard_of(thin), narrow).away > 10.0
    assert link_estimate("payload", standard_of(thin), wide).away < 1.0
    below = -standard_of(thin)  # 2 kg below zero
    for sigma, freedom, sigmas_away in ((1.0, np.inf, 2.0), (1.0, 4.0, 1.57), (40.0, np.inf, 0.05)):  # 4: p = 0.1161
        covariance = np.diag(np.r_[sigma, [1e-4] * 3, [1e-3] * 6] ** 2)
        found = link_estimate("payload", below, covariance, lambda along, n=freedom: n if along[0] else 0.0)
        assert (found.body, found.away) == (None, pytest.approx(sigmas_away, abs=0.01))
    whole = RigidBody(2.0, np.zeros(3), np.diag([0.1, 0.1, 0.02]))
    assert link_estimate("payload", standard_of(whole), narrow).away == 0.0


def test_a_point_is_as_far_from_any_body_as_chance_makes_it(rng):
    """Of a point all moments may come out negative, each by chance, and the scatter of few blocks tells their sigmas
    badly: 1 % of the estimates are as rare as 1 %, or fewer; a normal's two sides take a tenth for impossible."""
    point, root = standard_of(RigidBody(2.0, np.zeros(3), np.zeros((3, 3)))), 1e-2 * rng.normal(size=(10, 10))
    root[:4] *= 0.01
    rare, by_normal, runs, freedom = 0, 0, 100, 24
    for _ in range(runs):
        scatter = root @ rng.normal(size=(10, freedom))
        mean, covariance = point + root @ rng.normal(size=10), scatter @ scatter.T / freedom
        found = link_estimate("payload", mean, covariance, lambda along: float(freedom))
        assert found.body is not None
        gap = standard_of(found.body) - mean
        rare += found.away > sigmas(0.01)
        by_normal += found.away > 0.0 and gap @ np.linalg.solve(covariance, gap) > sigmas(0.01) ** 2
    assert rare <= 0.02 * runs
    assert by_normal > 0.1 * runs


def test_few_blocks_cannot_tell_that_a_body_is_impossible():
    thin = standard_of(RigidBody(2.0, np.zeros(3), np.diag([0.1, 0.1, -0.02])))
    covariance = np.diag(np.r_[1e-4, [1e-4] * 3, [1e-3] * 6] ** 2)
    away = [link_estimate("payload", thin, covariance, lambda along, n=n: n).away for n in (5.0, 8.0, 50.0, np.inf)]
    assert away[0] == 0.0
    assert away == sorted(away)
    assert away[1] < refused_from(1) < away[2]
