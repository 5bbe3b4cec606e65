"""Stated sigmas that the rows contradict are taken wider, each by its kind; what rows do not contradict stays."""

import numpy as np
import pytest

from onboard.estimation.recursive.rls import SquareRootRls
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.considered import Considered
from onboard.identification.rows.stated_errors.stated import Stated, StatedSigmas, Taken, others
from onboard.regressor.base_parameters import BaseParameters

NOISE, SIGMA = 1e-3, 0.01  # of the rows; of both parameters, drawn as one
COLUMNS = tuple(
    Stated(f"prior.link.{one}", "prior.link") for one in ("upper", "lower", "hand", "palm", "thumb", "nail")
)
CELLS = ("cell_1", "cell_2")
ALL = Considered("scale of all torques", "", "scale", 0.01, "scale_sigma of all torques")
SCALES = tuple(Considered(f"scale of {cell}", cell, "scale", 0.01, f"{cell} scale_sigma") for cell in CELLS)


def taken(
    rng,
    truth,
    gains=(1.0, 1.0),
    noise=None,
    told=1.0,
    considered=(),
    sigma=SIGMA,
    held_s=0.0,
    estimates=False,
    since_s=-np.inf,
    warmed=1.0,
) -> tuple[Taken, Taken]:
    """What is taken for granted before and after 40 s of rows of two cells; ``told``: share of the last parameter.

    From ``held_s`` on the payload is held, whose only parameter is the last one; the last cell then reads 2 % more, and
    the first parameter is ``warmed`` times as large.
    """
    n = len(truth)
    base = BaseParameters(tuple("abcdef"[:n]), np.arange(n), np.eye(n), tuple("abcdef"[:n]))
    blocks, rls, drawn = RowBlocks(n, 1.0, CELLS), SquareRootRls(n, len(considered)), np.ones(n)
    stated = Taken.of(rls, considered, base, sigma * np.eye(n), drawn)
    rls.prior(drawn, stated.covariance)
    times = np.sort(rng.uniform(0.0, 40.0, 1000))
    for number, gain in enumerate(gains):
        Y = rng.normal(size=(1000, n)) * [*np.ones(n - 1), told]
        held = times >= held_s
        Y[~held, -1] = 0.0
        more = np.where(held & (number == len(gains) - 1) & (held_s > 0.0), 1.02, 1.0)
        y = gain * more * (Y @ truth + held * (warmed - 1.0) * Y[:, 0] * truth[0]) + (
            NOISE * rng.normal(size=1000) if noise is None else noise(times, Y)
        )
        each = np.full(1000, NOISE)
        C = np.zeros((1000, len(considered)))
        if considered:
            mine = [one.row in ("", CELLS[number]) for one in considered]
            always = [one.effect == "scale" for one in considered]
            C = np.where(mine, np.where(held[:, None] | always, y[:, None], 0.0), 0.0)
        rls.update(Y, y, each, C if considered else None)
        blocks.add(times, held, np.full(1000, number), Y, y, each, each, None)
    sigmas = StatedSigmas(COLUMNS[:n], considered, CELLS, base, stated, estimates=estimates)
    return stated, sigmas.taken(stated, blocks, rls.solve().mean, 1.0, (since_s, since_s))


@pytest.mark.parametrize("seed", range(5))
def test_errors_of_the_stated_size_leave_all_as_stated(seed):
    rng = np.random.default_rng(seed)
    stated, found = taken(rng, 1.0 + SIGMA * rng.normal(size=2), 1.0 + 0.01 * rng.normal(size=2), considered=SCALES)
    assert found is stated


def test_one_of_two_links_that_is_ten_sigmas_off_widens_both_by_students_t(rng):
    """With four degrees of freedom ``w = 5 / (4 + 100 / s^2)``, ``6 s^2 = 4 + 100 w``; the other one ``w = 5 / 4``."""
    stated, found = taken(rng, np.array([1.0 + 10.0 * SIGMA, 1.0]))
    assert np.diag(found.prior_root) / np.diag(stated.prior_root) == pytest.approx([4.71, 1.47], rel=0.05)
    (said,) = found.said
    assert said.startswith("the rows contradict prior.link.upper: taken 4.")
    assert said.endswith("and 1 like it 1.4 times or more")
    assert found.rls.solve().mean == pytest.approx([1.1, 1.0], abs=5 * NOISE / 40)
    assert np.array_equal(found.covariance, found.prior_root @ found.prior_root.T)


def test_what_is_hardly_wider_is_not_said_to_be():
    assert others(np.array([1.004, 1.6, 2.0])) == ", and 2 like it 1.6 times or more"
    assert others(np.array([1.004])) == others(np.empty(0)) == ""


def test_gains_that_contradict_each_other_are_considered_as_wide_as_they_differ(rng):
    """Two that differ by 10 %, of a body that may weigh anything: what they have in common is not determined.

    ``w = 4.5 s^2 / (4 s^2 + 25)``, ``5 s^2 = 4 + 50 w``.
    """
    _, found = taken(rng, np.ones(2), (1.05, 0.95), considered=SCALES, sigma=1.0)
    assert found.considered == pytest.approx(np.full(2, 0.0337), rel=0.03)
    assert found.said[0].startswith("the rows contradict cell_")
    assert "scale_sigma: taken" in found.said[0]


def test_what_noise_leaves_contradicts_nothing(rng):
    """Ten times as much as stated, and such as is alike for a second, which adds up in the scores of a block."""
    stated, loud = taken(rng, np.ones(2), noise=lambda times, Y: 10.0 * NOISE * rng.normal(size=len(times)), sigma=1e-4)
    assert loud is stated

    def slow(times, Y):
        return NOISE * np.einsum("ij,ij->i", Y, rng.normal(size=(41, 2))[times.astype(int)])

    for _ in range(5):
        stated, slowly = taken(rng, np.ones(2), noise=slow, sigma=5e-5)
        assert slowly is stated


def test_a_key_of_which_no_row_tells_is_widened_with_its_kind_alone(rng):
    stated, found = taken(rng, np.array([1.3, 1.0]), told=0.0)
    wide = np.diag(found.prior_root) / np.diag(stated.prior_root)
    assert wide[1] > 2.0  # who is wrong about the one was so about the other
    assert taken(rng, np.array([1.0, 9.0]), told=0.0)[1].said == ()


@pytest.mark.parametrize(("sigma", "error"), [(0.002, 0.08), (0.02, 0.12)])
def test_a_body_too_heavy_or_gains_too_large_are_both_covered_unless_one_is_the_likelier(rng, sigma, error):
    """All reads 8 or 12 % too much: 8 or 12 sigmas of one factor on the gains; 40, or 6, of each of two links."""
    _, found = taken(rng, np.ones(2), (1.0 + error, 1.0 + error), considered=(*SCALES, ALL), sigma=sigma)
    assert 0.75 * error / 1.96 < found.considered[2] < 0.15  # of two links drawn to 2 %, which take the rest
    assert found.said[-1].startswith("all gains may be off by a common factor, by ")


@pytest.mark.parametrize("truth", [[8.0, -4.0, 6.0, -5.0, 7.0, -6.0], [20.0, -10.0, 15.0, 10.0, -12.0, -15.0]])
@pytest.mark.parametrize("sigma", [0.3, 1.0])
def test_one_factor_does_not_stand_for_an_estimate_that_is_no_multiple_of_the_drawing(rng, truth, sigma):
    considered = tuple(one._replace(sigma=0.035) for one in (*SCALES, ALL))
    stated, found = taken(rng, np.array(truth), considered=considered, sigma=sigma)
    (said,) = found.said
    assert said.startswith("the rows contradict prior.link.")
    assert found.considered == pytest.approx(stated.considered, rel=0.01)


def of_an_encoder(rng, since_s):
    """What two gains are taken for where an angle is off by one stated sigma, which looks like 5 % of each reading."""
    turned = Considered("zero of joint_1", "joint_1", "joint_zero", 0.01, "joint_1 zero_sigma_rad")
    base = BaseParameters(("a", "b"), np.arange(2), np.eye(2), ("a", "b"))
    blocks, rls, considered = RowBlocks(2, 1.0, CELLS, 3), SquareRootRls(2, 3), (*SCALES, turned)
    stated = Taken.of(rls, considered, base, 0.05 * np.eye(2), np.ones(2))
    rls.prior(np.ones(2), stated.covariance)
    times = np.sort(rng.uniform(0.0, 40.0, 1000))
    for number, sign in enumerate((1.0, -1.0)):
        Y = rng.normal(size=(1000, 2))
        effect = sign * 5.0 * Y @ np.ones(2)  # per rad
        each = np.full(1000, NOISE)
        y = Y @ np.ones(2) + 0.01 * effect + NOISE * rng.normal(size=1000)
        C = np.column_stack([np.zeros((1000, 2)), effect])
        rls.update(Y, y, each, C)
        blocks.add(times, np.ones(1000, np.bool_), np.full(1000, number), Y, y, each, each, None, C)
    sigmas = StatedSigmas(COLUMNS[:2], considered, CELLS, base, stated)
    return stated, sigmas.taken(stated, blocks, rls.solve().mean, 1.0, (since_s, since_s))


def test_what_an_angle_does_is_not_given_to_gains(rng):
    """But where most rows are of before what it does to them was known: there gains are all that is looked at."""
    stated, found = of_an_encoder(rng, -np.inf)
    assert found is stated
    stated, found = of_an_encoder(rng, 25.0)
    assert "scale_sigma: taken" in found.said[0]
    assert (found.considered[:2] > 2.0 * stated.considered[:2]).all()


LIGHT = np.array([1e-3, 1.0])  # sigmas of an arm as drawn, and of what it holds
CHANGED = Considered(
    "scale of cell_1 with the payload", "cell_1", "held_scale", 0.02, "cell_1 between_recordings_sigma"
)


def test_where_nothing_is_contradicted_gains_are_estimated_beside_the_parameters(rng):
    """By an arm that is known two gains are, and with them what is held; considered, each gain is 5 % of it."""
    considered, z = tuple(one._replace(sigma=0.05) for one in SCALES), []
    for _ in range(30):
        truth, gains = np.array([1.0 + 1e-3 * rng.normal(), 1.4]), 1.0 + 0.05 * rng.normal(size=2)
        stated, found = taken(rng, truth, gains, considered=considered, sigma=LIGHT, held_s=1e-9, estimates=True)
        assert found.answer is not None
        assert all(one is other for one, other in zip(found[:-1], stated[:-1], strict=True))  # what is stated stays
        mean, P = found.answer.known.known
        assert 1e-3 < P[1, 1] ** 0.5 < 2e-3
        z.append((mean[1] - truth[1]) / P[1, 1] ** 0.5)
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.3


@pytest.mark.parametrize("row", [CHANGED.row, ""])
def test_a_gain_that_changes_between_recordings_is_one_of_the_rows_with_the_payload(rng, row):
    """Its cell, or each of all, reads 2 % more of these, of which rows without the payload tell nothing."""
    z = []
    for considered in (SCALES[:1], (SCALES[0], CHANGED._replace(row=row))):
        _, made = taken(rng, [1.0, 1.4], (1.0,), considered=considered, sigma=LIGHT, held_s=20.0, estimates=True)
        assert made.answer is not None, made.said
        mean, P = made.answer.known.known
        z.append(abs(mean[1] - 1.4) / P[1, 1] ** 0.5)
    assert z[1] < 2.0 < 4.0 < z[0]
    effects = dict(zip(made.answer.causes.names, made.answer.causes.effects(made.answer.along)[1], strict=True))
    assert effects[CHANGED.key] < 0.1 * effects["prior.link.upper"]  # the arm, which is known, tells it


def test_friction_that_changes_between_recordings_is_of_the_rows_with_the_payload(rng):
    """What it multiplies is 1.4 times as large there: 1.68 stated sigmas of its logarithm."""
    warmed = Considered("Fv with the payload", "", "held_friction", 0.2, "Fv between recordings", 0)
    known = {"considered": (warmed, *SCALES), "sigma": LIGHT, "held_s": 20.0, "estimates": True, "warmed": 1.4}
    _, made = taken(rng, np.array([1.0, 1.4]), **known)
    assert made.answer is not None, made.said
    mean, P = made.answer.known.known
    assert abs(mean[1] - 1.4) < 2.0 * P[1, 1] ** 0.5 < 0.1
    _, found = taken(rng, np.array([1.0, 1.4]), **{**known, "warmed": 2.5})
    assert any(said.startswith("the rows contradict Fv between recordings: taken ") for said in found.said)


def test_the_answer_is_as_wide_as_blocks_of_time_scatter(rng):
    """What each second leaves is alike, and forty times what the noise of its rows makes of their mean."""
    z = []
    for _ in range(20):
        alike = 4e-2 * rng.normal(size=(41, 2))

        def slow(times, Y, alike=alike):
            return np.einsum("ij,ij->i", Y, alike[times.astype(int)])

        truth = np.array([1.0, 1.4])
        _, found = taken(rng, truth, considered=SCALES, sigma=LIGHT, noise=slow, held_s=1e-9, estimates=True)
        assert found.answer is not None, found.said
        mean, P = found.answer.known.known
        z.append((mean[1] - truth[1]) / P[1, 1] ** 0.5)
    assert np.sqrt(np.mean(np.square(z))) < 1.4


def test_without_rows_of_the_empty_arm_nothing_is_estimated(rng):
    """They are left out, as what errors do to them was made at another estimate: they told the arm from its load."""
    known = {"considered": SCALES, "sigma": LIGHT, "held_s": 1e-9, "estimates": True}
    assert taken(rng, np.array([1.0, 1.4]), **known)[1].answer is not None
    known["held_s"] = 15.0
    assert taken(rng, np.array([1.0, 1.4]), **known, since_s=15.0)[1].answer is None


def test_what_is_contradicted_is_not_estimated_but_considered_wider(rng):
    assert taken(rng, np.ones(2), (1.05, 0.95), considered=SCALES, sigma=1.0, estimates=True)[1].answer is None


@pytest.mark.parametrize("warmed", [1.0, 1.4])
def test_friction_is_considered_as_large_as_its_change_where_something_else_is_contradicted(rng, warmed):
    """20 % of it, of which the rows tell one, took more of an answer than the gains that are contradicted."""
    change = Considered("Fv with the payload", "", "held_friction", 0.2, "Fv between recordings", 0)
    known = {"considered": (change, *SCALES), "sigma": 1.0, "held_s": 20.0, "warmed": warmed}
    _, found = taken(rng, np.ones(2), (1.05, 0.95), **known)
    assert "scale_sigma: taken" in found.said[0]
    assert found.considered[0] == pytest.approx(np.log(warmed), abs=0.05)
