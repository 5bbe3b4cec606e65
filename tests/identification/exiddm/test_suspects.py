"""What may be wrong of a free-flyer: by how much, and which of it no motion tells apart."""

import numpy as np
import pytest

from onboard import config
from onboard.dynamics.payload import body_of
from onboard.flight.estimate.identification import build_exiddm
from onboard.identification.exiddm.prediction.imu_prediction import PAYLOAD, ImuPredictor
from onboard.identification.exiddm.suspects import ALL_MASSES, Rivals, suspects_of

_FEW = 1e-5


@pytest.fixture(scope="module")
def predictor() -> ImuPredictor:
    return build_exiddm(config.load(config.packaged("dymaflex")))[0].exiddm.predictor


def changed(predictor: ImuPredictor, at: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Relative change of mass and moments of every link to first order, (links, 2)."""
    state = np.zeros(len(predictor.names))
    state[PAYLOAD] = predictor.vehicle.chi[predictor.vehicle.payload_columns()]
    before = predictor.chi(state).reshape(-1, 10)
    state[at] = _FEW * along
    after = predictor.chi(state).reshape(-1, 10)
    drawn = np.flatnonzero([name != predictor.vehicle.spec.payload_link for name in predictor.vehicle.links])
    return np.stack([(after[drawn, k] / before[drawn, k] - 1.0) / _FEW for k in (0, 4)], axis=1)


def test_a_body_is_wrong_by_a_tenth_in_each_way(predictor: ImuPredictor) -> None:
    """The numbers are those of the page on the levels: they change with the policy's, and with nothing else."""
    found = {}
    for one in suspects_of(predictor):
        if one.name != "load_cell" and not one.name.startswith(("zero_", "scale_", "delay_")):
            found.setdefault(one.name, []).append((changed(predictor, one.at, one.along[:, 0]), one.odds))
    assert set(found) == {"base", *(f"link_{k}" for k in range(1, 6)), "the arm", ALL_MASSES}
    np.testing.assert_allclose(found[ALL_MASSES][0][0], 0.1, rtol=1e-4)
    assert found[ALL_MASSES][0][1] == 3e-3
    np.testing.assert_allclose(found["the arm"][0][0], [[0.0, 0.0], *[[0.1, 0.1]] * 5], rtol=1e-4, atol=1e-9)
    assert {one[0][1] for name, one in found.items() if name not in ("base", ALL_MASSES)} == {2e-3}
    both, mass, inertia, centre, each = (one[0][0] for one in found["base"])
    assert centre[0] == pytest.approx(0.0, abs=1e-12)  # its mass is as drawn
    np.testing.assert_allclose(both, [0.1, 0.1], rtol=1e-4)
    np.testing.assert_allclose(each, both)
    assert mass[0] == pytest.approx(0.1, rel=1e-3)
    assert 0.0 < mass[1] < 1e-3  # its centre of mass is near its origin
    np.testing.assert_allclose(mass + inertia, both, rtol=1e-3)
    assert sum(odds for _, odds in found["base"]) == pytest.approx(1e-2)
    (cell,) = (one for one in suspects_of(predictor) if one.name == "load_cell")
    assert (cell.along.item(), cell.odds) == (0.1, 1e-2)


def test_an_encoder_is_wrong_in_zero_scale_or_delay(predictor: ImuPredictor) -> None:
    every = {one.name: one for one in suspects_of(predictor)}
    kinds = {"zero": 0.1, "scale": 0.1, "delay": 0.01}
    names = {f"{kind}_joint_{k}": size for k in range(1, 6) for kind, size in kinds.items()}
    for name, size in names.items():
        assert every[name].along.item() == pytest.approx(size)
        assert predictor.names[every[name].at[0]] == name
        assert every[name].odds == pytest.approx(2e-3 / 3.0)


def test_one_cell_and_all_masses_are_alike(predictor: ImuPredictor) -> None:
    assert {one.name for one in suspects_of(predictor) if one.alike} == {"load_cell", ALL_MASSES}


def test_weights_are_made_once_for_each_state(predictor: ImuPredictor) -> None:
    rivals = Rivals(predictor)
    known = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma, nan=1.0) ** 2)
    first = rivals.weighed(*known)
    assert rivals.weighed(*known) is first
    assert first.names == ()
    assert rivals.weighed(known[0].copy(), known[1]) is not first
    assert rivals.freeing(*known) is None
    assert rivals.at.size == 0


def test_a_filter_is_freed_once_and_taken_back_where_it_is_weighed(predictor: ImuPredictor) -> None:
    rivals = Rivals(predictor)
    x, P = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma, nan=1.0) ** 2)
    at, _ = predictor.drawn["base"]
    x[at], P[at, at] = 20.0, 0.01  # far from the drawing
    free = rivals.freeing(x, P)
    assert free is not None
    assert rivals.at.size == 76
    assert rivals.freeing(*free((x, P))) is None
    np.testing.assert_allclose(rivals.weighed(*free((x, P))).stated[1], P, atol=1e-9)
    assert rivals.weighed(*free((x, P))).names == ("base",)


def test_a_base_s_centre_of_mass_is_off_by_a_tenth_of_the_rms_distance_of_its_mass(predictor: ImuPredictor) -> None:
    base = [one for one in suspects_of(predictor) if one.name == "base"][3]
    first = 10 * predictor.vehicle.links.index("base")
    drawn = body_of(predictor.vehicle.chi[first : first + 10])
    off = 0.1 * np.sqrt(0.5 * np.trace(drawn.inertia_kg_m2) / drawn.mass_kg)
    for axis in range(3):
        state = np.zeros(len(predictor.names))
        state[base.at] = _FEW * base.along[:, axis]
        body = body_of(predictor.chi(state)[first : first + 10])
        moved = (body.centre_of_mass_m - drawn.centre_of_mass_m) / _FEW
        np.testing.assert_allclose(moved, off * np.eye(3)[axis], atol=1e-3 * off)
        np.testing.assert_allclose(body.inertia_kg_m2, drawn.inertia_kg_m2, atol=1e-9)
