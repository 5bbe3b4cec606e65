"""Of cells that contradict each other, who is left out; releases that did not happen, and those that did."""

import numpy as np
import pytest

from onboard.config import packaged
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.estimation.gates import GateReason
from onboard.identification.quantities import Findings, mass_quantities
from onboard.identification.rows.hypotheses import Hypotheses, has_happened
from onboard.identification.rows.identifier import Identifier
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.prior import prior_root
from onboard.regressor.rows import RowModel, load_cell_row, standing
from onboard.regressor.signals import Signals

NOISE_N, TIP_KG = 0.002, 0.06627  # table 4.6


CELLS = ("cell_1", "cell_2")


def model():
    text = packaged("rocksat").with_name("rocksat.urdf").read_text()
    vehicle = VehicleModel(text, VehicleSpec(BaseKind.PRESCRIBED, "plate", "tip_mass"))
    return RowModel(vehicle, [load_cell_row(n, "joint_1", (0, 0, 1), "moment", 0.04) for n in ("cell_1", "cell_2")])


def identifier():
    rows = model()
    base = base_parameters(rows, np.random.default_rng(0))
    links = {"plate": 1.0, "arm": 1.0, "tip_mass": 1.0}
    sigma = prior_root(rows, links, {"bias_cell_1": 1.0, "bias_cell_2": 1.0})
    return Identifier(rows, base, sigma, 0.5, mass_quantities(rows, base, "joint_1", "arm"))


def fly(found, rng, told_s=8.0, gone_s=8.0, scale=lambda _: (1.0, 1.0), again_s=99.0, back_s=99.0):
    """A swinging arm; the release is told at ``told_s`` and again, if not believed, at ``again_s``."""
    rows, news = model(), []
    for start in np.arange(0.0, 16.0):
        t = start + 0.01 * np.arange(100)
        q = (0.2 * np.sin(4.0 * t))[:, None]
        dq, ddq = (0.8 * np.cos(4.0 * t))[:, None], -16.0 * q
        motion = standing(rows.vehicle, t.size)
        y = rows.regressor(q, dq, ddq, motion, (t < gone_s) | (t > back_s)) @ rows.chi * np.array(scale(start))
        y = y + NOISE_N * rng.normal(size=y.shape)
        believed_s, later_s = (again_s, 99.0) if news else (told_s, again_s)
        signals = Signals(t, q, dq, ddq, motion, y, np.full_like(y, NOISE_N))
        found.update(signals, t < believed_s, np.zeros(t.size, np.int64), t < later_s)
        news += [change for change in found.news() if change.kind == "release_contradicted"]
    return news


def payload_kg(found):
    return next(q for q in found.estimate().quantities if q.name == "m_tip_mass")


@pytest.mark.parametrize("lies", ["cell_1", pytest.param("cell_2", marks=pytest.mark.campaign)])  # it lies below
def test_the_cell_whose_scale_jumps_is_left_out_and_the_other_answers(rng, lies):
    found = Hypotheses(identifier, ("cell_1", "cell_2"))
    fly(found, rng, scale=lambda t: [1.3 if t > 5.0 and name == lies else 1.0 for name in ("cell_1", "cell_2")])
    assert not found.findings().against
    assert any(lies in doubt for doubt in found.findings().doubts)
    assert found.refused[GateReason.LEFT_OUT] == 1600
    assert payload_kg(found).value == pytest.approx(TIP_KG, rel=0.02)


def test_two_healthy_cells_both_answer(rng):
    found = Hypotheses(identifier, ("cell_1", "cell_2"))
    assert fly(found, rng) == []
    assert found.findings() == Findings()
    assert found.refused[GateReason.LEFT_OUT] == 0
    assert found.rows_used == 2 * 1600


def test_at_the_end_all_rows_are_judged(rng):
    found = Hypotheses(identifier, ("cell_1", "cell_2"))
    fly(found, rng)
    assert sum(fit.rows for fit in found.chosen.fits()) < found.rows_used
    found.finish()
    assert sum(fit.rows for fit in found.chosen.fits()) == pytest.approx(found.rows_used)


def test_of_two_cells_of_different_scales_the_answer_holds_what_either_says(rng):
    """The drawn arm makes the one likelier; the 99.9 % interval holds the other, too."""
    found = Hypotheses(identifier, ("cell_1", "cell_2"))
    fly(found, rng, scale=lambda _: (1.0, 1.1))
    assert found.findings().against == ()
    assert found.findings().doubts[0].startswith("cell_1 and cell_2 contradict each other: ")
    assert "; probability of being wrong: cell_2 0.9" in found.findings().doubts[0]
    held = payload_kg(found)
    assert held.low < TIP_KG < held.high < 1.1 * TIP_KG < held.outer[1]
    assert found.refused[GateReason.LEFT_OUT] == 0


def test_the_answer_of_both_cells_holds_what_an_error_of_either_gain_does(rng):
    """Before two answers without one cell each can contradict each other."""
    found = Hypotheses(identifier)
    fly(found, rng, scale=lambda _: (1.0, 1.1))
    held = payload_kg(found)
    assert held.low < TIP_KG
    assert held.high > 1.1 * TIP_KG


def test_where_the_drawing_says_nothing_both_are_as_likely(rng, monkeypatch):
    monkeypatch.setattr(Identifier, "drawn", 0.0)
    found = Hypotheses(identifier, ("cell_1", "cell_2"))
    fly(found, rng, scale=lambda _: (1.0, 1.1))
    held = payload_kg(found)
    assert "cell_1 0.5, cell_2 0.5" in found.findings().doubts[0]
    assert held.low < TIP_KG
    assert held.high > 1.1 * TIP_KG
    assert held.high - held.low < 0.3 * TIP_KG  # what is off the drawing widens that of the wrong one


@pytest.mark.parametrize("lies", [pytest.param("cell_1", marks=pytest.mark.campaign), "cell_2"])  # it lies above
def test_a_cell_that_contradicted_the_other_makes_no_good_answer_again(rng, lies):
    """It reads 2 % too much for four seconds: these rows stay in, also when the later ones have scattered them."""
    found, contradicted = Hypotheses(identifier, ("cell_1", "cell_2")), list[bool]()

    def scale(t):
        said = found.findings()
        contradicted.append(any("contradict" in one for one in (*said.against, *said.doubts)))
        return [1.02 if t < 4.0 and name == lies else 1.0 for name in ("cell_1", "cell_2")]

    fly(found, rng, told_s=99.0, gone_s=99.0, scale=scale)
    assert True in contradicted
    assert all(contradicted[contradicted.index(True) :])


@pytest.mark.parametrize(("sigmas", "doubted"), [(3.1, False), (3.2, True), (4.7, True)])
def test_answers_that_are_3_1_sigmas_apart_are_doubted(rng, monkeypatch, sigmas, doubted):
    found = Hypotheses(identifier, ("cell_1", "cell_2"))
    fly(found, rng)
    monkeypatch.setattr(found, "_apart", lambda _: (sigmas, "the cells are apart"))
    found._judge()
    assert ("the cells are apart" in found.findings().doubts) == doubted
    assert found.findings().against == ()


def test_two_cells_that_differ_by_a_little_are_doubted_before_either_is_taken_for_wrong(rng):
    found, said = Hypotheses(identifier, ("cell_1", "cell_2")), list[Findings]()

    def scale(_):
        said.append(found.findings())
        return 1.0, 1.003

    fly(found, rng, told_s=99.0, gone_s=99.0, scale=scale)
    first = next(one for one in said if one != Findings())
    assert not first.against
    assert first.doubts[0].startswith("cell_1 and cell_2 contradict each other")
    assert "probability" not in first.doubts[0]
    assert said[-1].against == ()
    assert "probability of being wrong" in said[-1].doubts[0]


@pytest.mark.parametrize(
    ("lies", "scale"), [("cell_1", 1.2), pytest.param("cell_2", 1.2, marks=pytest.mark.campaign), ("cell_2", 0.75)]
)
def test_of_two_cells_of_different_scales_the_drawn_arm_tells_which_is_wrong(rng, lies, scale):
    """The mean of both is half as far off the drawing as the wrong one alone: that is no reason to refuse it."""
    found = Hypotheses(identifier, ("cell_1", "cell_2"))
    fly(found, rng, scale=lambda _: [scale if name == lies else 1.0 for name in ("cell_1", "cell_2")])
    assert not found.findings().against
    assert any(lies in doubt for doubt in found.findings().doubts)
    assert payload_kg(found).value == pytest.approx(TIP_KG, rel=0.02)


@pytest.mark.parametrize("again_s", [8.0, 99.0])
def test_a_release_that_does_not_happen_is_not_believed_and_the_true_one_is(rng, again_s):
    found = Hypotheses(identifier)
    news = fly(found, rng, told_s=5.0, gone_s=again_s, again_s=again_s)
    assert len(news) == 1
    assert not found.findings().against
    told = payload_kg(found)
    assert told.supported is (again_s < 99.0)
    if told.supported:
        assert told.value == pytest.approx(TIP_KG, rel=0.02)


@pytest.mark.parametrize(
    ("nats", "accepted"), [(2.4, True), (2.2, None), (0.0, None), (-11.4, None), (-11.6, False), (50.0, True)]
)
def test_a_release_is_believed_until_the_rows_leave_a_thousandth_to_it_and_one_report_in_a_hundred_is_false(
    nats, accepted
):
    assert has_happened([(nats, True)]) is accepted


@pytest.mark.parametrize(
    ("all_of_them", "without_1", "without_2", "accepted"),
    [
        (20.0, 20.0, 20.0, True),
        (-20.0, -20.0, 20.0, True),  # cell_2 lies: cell_1 knows that the payload has gone
        (20.0, 20.0, -20.0, False),  # by cell_1 the arm moves as before
        (20.0, 20.0, 0.0, None),  # cell_1 does not know yet
    ],
)
def test_a_release_is_judged_without_the_cell_that_lies(all_of_them, without_1, without_2, accepted):
    assert has_happened([(all_of_them, False), (without_1, False), (without_2, True)]) is accepted


def test_of_two_cells_that_are_both_fine_and_do_not_agree_about_a_release_neither_decides():
    assert has_happened([(20.0, True), (20.0, True), (-20.0, True)]) is None


@pytest.mark.parametrize("lies", ["cell_1", pytest.param("cell_2", marks=pytest.mark.campaign)])  # it lies above
def test_of_a_false_release_and_a_cell_that_jumps_both_are_told(rng, lies):
    found = Hypotheses(identifier, CELLS)
    assert (
        len(fly(found, rng, gone_s=99.0, scale=lambda t: [1.6 if t >= 8.5 and n == lies else 1.0 for n in CELLS])) == 1
    )
    assert f"without {lies}, which contradicts the others" in found.findings().doubts


def test_a_release_that_happens_is_believed(rng):
    found = Hypotheses(identifier)
    assert fly(found, rng) == []
    assert payload_kg(found).value == pytest.approx(TIP_KG, rel=0.02)


def test_an_accepted_release_is_not_judged_again(rng):
    """Readings that change later on as if the payload were held again do not bring it back; they are refused."""
    found = Hypotheses(identifier)
    assert fly(found, rng, back_s=11.5) == []
    assert found.findings().against
