"""The identifier on a RockSat-like flight: masses with intervals that cover them, weights, memory, and refusals."""

import re

import numpy as np
import pytest

from onboard.config import packaged
from onboard.dynamics.model.errors import SignalError, UnknownFrameError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.errors import RowError
from onboard.estimation.gates import GateReason
from onboard.estimation.policy import AGAIN
from onboard.identification.quantities import inertia_about_joint, mass_quantities
from onboard.identification.rows import identifier as module
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.stated_errors.considered import Considered
from onboard.regressor.rows import RowModel
from tests.identification.rows import rocksat_flight


def test_masses_over_many_flights(rng):
    """Bars, with room: p95 errors, coverage of masses and of every base parameter."""
    _, model, base, _ = rocksat_flight.setup()
    chi = model.chi.copy()
    chi[-1] = 0.03
    truth = base.value(chi)
    errors, covered, parameters = [], [], []
    for _ in range(40):
        signals, held, _ = rocksat_flight.flight(rng)
        who = rocksat_flight.identifier()
        rocksat_flight.feed(who, signals, held, step=64)
        estimate = who.estimate()
        masses = rocksat_flight.by_name(estimate)
        errors.append([masses[name].value / kg - 1 for name, kg in rocksat_flight.TRUTH_KG.items()])
        covered.append([masses[name].low <= kg <= masses[name].high for name, kg in rocksat_flight.TRUTH_KG.items()])
        parameters.append((estimate.low <= truth) & (truth <= estimate.high))
    p95 = np.percentile(np.abs(errors), 95, axis=0)
    assert (p95 < [0.015, 0.010, 0.015]).all(), p95
    assert np.abs(np.mean(errors, axis=0)).max() < 0.002
    assert (np.mean(covered, axis=0) >= 0.9).all()
    assert (np.mean(parameters, axis=0) >= 0.85).all()


def test_before_the_ejection_only_the_inertia_of_both_is_told(rng):
    signals, held, _ = rocksat_flight.flight(rng)
    who = rocksat_flight.identifier()
    rocksat_flight.feed(who, rocksat_flight.part(signals, held), held[held])
    masses = rocksat_flight.by_name(who.estimate())
    for name in rocksat_flight.TRUTH_KG:
        assert not masses[name].supported
        assert np.isnan([masses[name].value, masses[name].sigma, masses[name].low, masses[name].high]).all()
        assert "not determined" in masses[name].note
    assert masses["ZZ_joint_1_R_held"].value == pytest.approx(3.0794e-3, rel=0.015)
    assert not masses["ZZ_joint_1_R_released"].supported


def test_before_any_row_nothing_is_told():
    estimate = rocksat_flight.identifier().estimate()
    assert not estimate.supported.any()
    assert estimate.supported.size > 0
    assert len(estimate.quantities) > 0
    assert not any(quantity.supported for quantity in estimate.quantities)
    assert estimate.rows_used == 0


def test_a_row_weighs_what_its_motion_is_known_to(rng):
    """A reading without any error of its own: the row's sigma is what the motion's noise makes of the masses."""
    signals, held, _ = rocksat_flight.flight(rng)
    exact = signals._replace(sigma=np.zeros_like(signals.sigma))
    who = rocksat_flight.identifier(considered=())
    found = rocksat_flight.feed(who, exact, held)
    assert np.count_nonzero(found == 0) > 0.9 * held.size
    assert rocksat_flight.by_name(who.estimate())["ZZ_joint_1_R_held"].value == pytest.approx(3.0794e-3, rel=0.015)
    # with a perfect accelerometer, what is left is angular acceleration: 3.08e-3 kg m^2 over 40 mm, held
    noise = signals.noise._replace(specific_force=np.zeros_like(signals.noise.specific_force))
    exact = exact._replace(noise=noise)
    expected = 3.08e-3 / 0.04 * np.hypot(noise.ddq[100, 0], noise.acceleration[100, 0]) * noise.inflation
    one = rocksat_flight.identifier(considered=())
    one.rls.prior(one.base.value(one.model.chi), np.full(len(one.base.names), 1e-9))  # sure of the drawing
    one.update(rocksat_flight.part(exact, slice(100, 101)), held[100:101], np.zeros(1, np.int64))
    row = one.recursion.blocks.normal[0]
    index = one.base.names.index("ZZ_arm")
    regressor = (signals.ddq[100, 0] + signals.motion.acceleration_rad_s2[100, 2]) / 0.04
    doubt = np.hypot(noise.ddq[100, 0], noise.acceleration[100, 0]) / 0.04
    assert row[index, index] == pytest.approx((regressor**2 - doubt**2) / expected**2, rel=0.3)  # and lever arms
    with pytest.raises(RowError, match="sigma"):
        rocksat_flight.feed(rocksat_flight.identifier(considered=()), exact._replace(noise=None), held)


def test_a_row_s_innovation_is_what_it_is_off_what_the_rows_before_it_let_expect(rng):
    signals, held, _ = rocksat_flight.flight(rng)
    before, at = 1000, slice(1000, 1001)

    def innovation(off_sigma, reason=0):
        who = rocksat_flight.identifier()
        rocksat_flight.feed(who, rocksat_flight.part(signals, slice(before)), held[:before], step=50)
        assert np.isfinite(who.innovation).all()
        moved = signals._replace(measured=signals.measured + off_sigma * signals.sigma)
        found = who.update(rocksat_flight.part(moved, at), held[at], np.full(1, reason, np.int64))
        assert who.innovation.shape == (1, 1)
        return float(who.innovation[0, 0]), int(found[0, 0])

    (own, as_measured), (near, _), (far, refused) = innovation(0.0), innovation(1.0), innovation(100.0)
    assert far - own == pytest.approx(100.0 * (near - own))
    assert 0.3 < near - own <= 1.0  # its sigma holds what the motion's noise and the estimate's do, besides the cell's
    assert abs(own) < 3.0
    assert (as_measured, refused) == (0, GateReason.RESIDUAL)
    assert np.isnan(innovation(0.0, GateReason.DRAG)[0])


def test_batches_of_any_size_agree(rng):
    signals, held, _ = rocksat_flight.flight(rng)
    one, two = rocksat_flight.identifier(), rocksat_flight.identifier()
    rocksat_flight.feed(one, signals, held, step=5)
    rocksat_flight.feed(two, signals, held, step=17)
    assert len(one.estimate().quantities) > 0
    for a, b in zip(one.estimate().quantities, two.estimate().quantities, strict=True):
        assert a.value == pytest.approx(b.value, rel=1e-3)


def test_an_answer_takes_two_jackknifes_one_for_its_findings(rng, monkeypatch):
    signals, held, _ = rocksat_flight.flight(rng)
    who, taken, real = rocksat_flight.identifier(), [], Identifier.block_jackknife
    rocksat_flight.feed(who, signals, held)
    monkeypatch.setattr(Identifier, "block_jackknife", lambda self, *how: taken.append(how) or real(self, *how))
    who.findings()
    who.estimate()
    assert len(taken) == 2


def test_what_is_costly_is_judged_again_of_a_fifth_more_rows_and_at_the_end_of_all(rng, monkeypatch):
    signals, held, _ = rocksat_flight.flight(rng)
    who, at_once, judged = rocksat_flight.identifier(), rocksat_flight.identifier(), list[float]()
    real = module.instrument_fits

    def counted(blocks, *rest):
        judged.append(blocks.total()[-1, -1])  # whitened, that of sigma is one: rows
        return real(blocks, *rest)

    monkeypatch.setattr(module, "instrument_fits", counted)
    for k in range(0, held.size, 20):
        rocksat_flight.feed(who, rocksat_flight.part(signals, slice(k, k + 20)), held[k : k + 20])
        who.findings()
    growth = np.diff(np.log(judged))
    assert (growth > np.log(AGAIN) - 1e-9).all()
    assert len(judged) < 30 < held.size / 20
    rocksat_flight.feed(at_once, signals, held, step=20)
    for one in (who, at_once):
        one.finish()
    assert [fit.rows for fit in who.fits()] == [fit.rows for fit in at_once.fits()]
    assert who.findings() == at_once.findings()
    assert who.estimate().quantities == at_once.estimate().quantities


def test_outliers_that_the_gate_lets_pass_weigh_less_with_huber(rng):
    signals, held, _ = rocksat_flight.flight(rng)
    hit = rng.random(held.size) < 0.05
    spoilt = signals._replace(measured=signals.measured + 15.0 * np.where(hit, 1.0, 0.0)[:, None] * signals.sigma)
    clean, errors = rocksat_flight.identifier(), []
    rocksat_flight.feed(clean, signals, held)
    for huber in (None, 1.5):
        one = rocksat_flight.identifier(huber_sigma=huber)
        rocksat_flight.feed(one, spoilt, held)
        bias = one.base.names.index("bias_load_cell")
        errors.append(abs(one.estimate().mean[bias] - clean.estimate().mean[bias]))
    assert errors[1] < 0.6 * errors[0]


def test_reasons_and_counts(rng):
    signals, held, _ = rocksat_flight.flight(rng)
    excluded = np.zeros(held.size, np.int64)
    excluded[:100] = GateReason.PHASE
    excluded[50:60] |= GateReason.DRAG
    measured, q, noise = signals.measured.copy(), signals.q.copy(), signals.noise.rate.copy()
    measured[300], measured[400] = np.nan, measured[400] + 20.0
    q[310], noise[320] = np.nan, np.nan
    spoiled = signals._replace(measured=measured, q=q, noise=signals.noise._replace(rate=noise))
    who = rocksat_flight.identifier()
    found = rocksat_flight.feed(who, spoiled, held, excluded)
    assert found.shape == (held.size, 1)
    assert found[0, 0] == GateReason.PHASE
    assert found[55, 0] == GateReason.PHASE | GateReason.DRAG
    assert (found[[300, 310, 320], 0] == GateReason.GAP).all()
    assert found[400, 0] == GateReason.RESIDUAL
    estimate = who.estimate()
    assert estimate.refused[GateReason.PHASE] == 100
    assert estimate.refused[GateReason.DRAG] == 10
    assert estimate.refused[GateReason.GAP] == 3
    assert estimate.refused[GateReason.RESIDUAL] >= 1
    assert estimate.rows_used == np.count_nonzero(found == 0)
    assert rocksat_flight.by_name(estimate)["m_arm"].value == pytest.approx(0.23313, rel=0.03)


def test_functionals_are_the_inertia_about_the_joint():
    vehicle, _, _, _ = rocksat_flight.setup()
    plate, arm, tip = inertia_about_joint(vehicle, "joint_1") @ vehicle.chi
    assert plate == 0.0
    # table 4.6, g mm^2: ZZ about the centre of mass and Steiner
    assert arm == pytest.approx(1e-9 * (7.33e5 + 233.13 * (39.75**2 + 1.41**2)), rel=1e-9)
    assert tip == pytest.approx(1e-9 * (5978.90 + 66.27 * (172.1**2 + 13.91**2)), rel=1e-9)


def test_impossible_set_ups_are_named():
    vehicle, model, base, _ = rocksat_flight.setup()
    with pytest.raises(UnknownFrameError, match="names row 'cell'"):
        rocksat_flight.identifier(considered=(Considered("scale", "cell", "scale", 0.1),))
    with pytest.raises(UnknownFrameError, match="forearm"):
        mass_quantities(model, base, "joint_1", "forearm")
    drawn = packaged("rocksat").with_name("rocksat.urdf").read_text()
    nothing = '<mass value="0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'
    bare = re.sub(r'<mass value="0.06627"/>\s*<inertia [^>]*/>', nothing, drawn)
    assert nothing in bare
    light = VehicleModel(bare, vehicle.spec)
    with pytest.raises(SignalError, match="no mass"):
        mass_quantities(RowModel(light, model.rows), base, "joint_1", "arm")


def test_signals_of_a_wrong_shape_are_named(rng):
    signals, held, _ = rocksat_flight.flight(rng)
    who = rocksat_flight.identifier()
    none = np.zeros(held.size, np.int64)
    with pytest.raises(SignalError, match="give as many"):
        who.update(signals._replace(measured=np.repeat(signals.measured, 2, axis=1)), held, none)
    with pytest.raises(SignalError, match="give as many"):
        who.update(signals, held, none[:-1])


@pytest.mark.parametrize(("every", "against"), [(15, True), (25, False)])
def test_more_than_one_row_in_twenty_that_contradicts_the_others_refuses_all(rng, every, against):
    signals, held, _ = rocksat_flight.flight(rng)
    measured = signals.measured.copy()
    measured[100::every] += 20.0
    who = rocksat_flight.identifier()
    rocksat_flight.feed(who, signals._replace(measured=measured), held)
    assert any("of the rows contradict the others" in said for said in who.findings().against) == against
