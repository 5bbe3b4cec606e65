"""What may be wrong of a free-flyer: by how much, and which of it no motion tells apart."""

import numpy as np
import pytest

from onboard import config
from onboard.dynamics.model.payload import body_of
from onboard.flight.estimate.problem.identification import build_free_flyer
from onboard.identification.evidence.bank import Changed
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, ImuPredictor
from onboard.identification.free_flyer.suspects import ALL_MASSES, Rivals, suspects_of

_FEW = 1e-5


@pytest.fixture(scope="module")
def predictor() -> ImuPredictor:
    return build_free_flyer(config.load(config.packaged("dymaflex")))[0].ekf.predictor


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
        if one.name != "load_cell" and not one.name.startswith(("place_", "zero_", "scale_", "delay_", "imu_")):
            found.setdefault(one.name, []).append((changed(predictor, one.at, one.along[:, 0]), one.odds))
    assert set(found) == {"base", *(f"link_{k}" for k in range(1, 6)), "the arm", ALL_MASSES}
    np.testing.assert_allclose(found[ALL_MASSES][0][0], 0.1, rtol=1e-4)
    assert found[ALL_MASSES][0][1] == 3e-3
    np.testing.assert_allclose(found["the arm"][0][0], [[0.0, 0.0], *[[0.1, 0.1]] * 5], rtol=1e-4, atol=1e-9)
    for name, one in found.items():
        assert sum(odds for _, odds in one) == {"base": 1e-2, ALL_MASSES: 3e-3}.get(name, 2e-3)
        if name.startswith("link"):  # by one factor, or in every way
            (factor, _), (every, _) = one
            np.testing.assert_allclose(factor, np.outer(np.arange(6) == int(name[-1]), [0.1, 0.1]), atol=1e-6)
            np.testing.assert_array_equal(every, factor)
    both, mass, inertia, centre, each = (one[0][0] for one in found["base"])
    assert centre[0] == pytest.approx(0.0, abs=1e-12)  # its mass is as drawn
    np.testing.assert_allclose(both, [0.1, 0.1], rtol=1e-4)
    np.testing.assert_allclose(each, both)
    assert mass[0] == pytest.approx(0.1, rel=1e-3)
    assert 0.0 < mass[1] < 1e-3  # its centre of mass is near its origin
    np.testing.assert_allclose(mass + inertia, both, rtol=1e-3)
    cell, late = (one for one in suspects_of(predictor) if one.name == "load_cell")
    assert (cell.along.item(), cell.odds) == (0.1, 1e-2)
    assert (predictor.names[late.at.item()], late.along.item(), late.odds) == ("delay_s_load_cell", 0.01, 2e-3)


def test_a_joint_is_wrong_in_place_and_its_encoder_in_zero_scale_or_delay(predictor: ImuPredictor) -> None:
    every = {one.name: one for one in suspects_of(predictor)}
    kinds = {"zero": 0.1, "scale": 0.1, "delay": 0.01}
    names = {f"{kind}_joint_{k}": size for k in range(1, 6) for kind, size in kinds.items()}
    for name, size in names.items():
        assert every[name].along.item() == pytest.approx(size)
        assert predictor.names[every[name].at[0]] == name
        assert every[name].odds == pytest.approx(2e-3 / 4.0)
    for k in range(1, 6):
        place = every[f"place_joint_{k}"]
        assert [predictor.names[at] for at in place.at] == [f"place_{axis}_joint_{k}" for axis in "xyz"]
        np.testing.assert_array_equal(place.along, 0.01 * np.eye(3))
        assert place.odds == pytest.approx(2e-3 / 4.0)


def test_an_imu_is_wrong_in_scales_housing_every_element_or_place(predictor: ImuPredictor) -> None:
    for imu, end in (("imu_base", ""), ("imu_2", "_imu_2")):
        own = [one for one in suspects_of(predictor) if one.name == imu]
        moved = [{predictor.names[at]: along for at, along in zip(one.at, one.along, strict=True)} for one in own]
        gyro, accelerometer = ({f"{of}_scale_{axis}{end}" for axis in "xyz"} for of in ("gyro", "accelerometer"))
        assert [set(one) for one in moved[:3]] == [gyro, accelerometer, gyro | accelerometer]
        assert all(along.tolist() == [0.1] for one in moved[:3] for along in one.values())
        assert list(moved[3]) == [f"mounting_rad_{axis}{end}" for axis in "xyz"]
        np.testing.assert_array_equal(own[3].along, 0.1 * np.eye(3))
        assert [len(one) for one in moved[4:7]] == [3, 3, 18]
        assert moved[7].keys() == {f"place_{axis}{end or '_imu'}" for axis in "xyz"}
        assert [set(one) for one in moved[8:]] == ([] if end else [{"delay_s"}])  # the other's wanders
        for one in own[4:7]:
            np.testing.assert_array_equal(one.along, np.diag(10.0 * predictor.sigma[one.at]))
        assert all("cross_axis" in name for one in moved[4:6] for name in one)
        assert sum(one.odds for one in own) == pytest.approx(2e-3)


@pytest.fixture(scope="module")
def without_mounting() -> ImuPredictor:
    """The same IMUs, of whose sensors the file states the axes one by one."""
    vehicle = config.load(config.packaged("dymaflex"))
    estimation = vehicle.tree["estimation"]
    prior = {key: value for key, value in estimation["imu_prior"].items() if key != "mounting_rad"}
    prior |= dict.fromkeys(["gyro_misalignment_rad", "accelerometer_misalignment_rad"], 8.7e-3)
    tree = vehicle.tree | {"estimation": estimation | {"imu_prior": prior}}
    return build_free_flyer(config.parse_tree(tree, vehicle.path, config.Origin("no mounting")))[0].ekf.predictor


def test_a_housing_without_a_mounting_is_turned_with_both_sensors(without_mounting: ImuPredictor) -> None:
    turned = [one for one in suspects_of(without_mounting) if one.name == "imu_2"][3]
    names = [f"{of}_misalignment_rad_{axis}_imu_2" for of in ("gyro", "accelerometer") for axis in "xyz"]
    assert [without_mounting.names[at] for at in turned.at] == names
    np.testing.assert_array_equal(turned.along, 0.1 * np.vstack([np.eye(3), np.eye(3)]))


def turned_about_the_first_axis(predictor: ImuPredictor, turned_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance where each sensor shows that it is so far turned about the axis of joint 1, the base's z.

    A zero of that joint shows in all of them alike.
    """
    sigma = np.nan_to_num(predictor.sigma, nan=1.0)
    x, P, rows = np.zeros(len(sigma)), np.diag(sigma**2), list[np.ndarray]()
    for frame, end in (("imu_base", ""), ("imu_2", "_imu_2")):
        upwards = predictor.vehicle.pose_in_base(frame)[0][2, 2]
        for sensor in ("gyro", "accelerometer"):
            parts = f"{sensor}_misalignment_rad_z{end}", f"mounting_rad_z{end}"
            rows.append(upwards * np.isin(predictor.names, parts) + (np.array(predictor.names) == "zero_joint_1"))
    H = np.array(rows)
    gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + 1e-6 * np.eye(len(H)))  # to a milliradian
    return x + gain @ np.full(len(H), turned_rad), P - gain @ H @ P


def test_two_housings_off_alike_do_not_name_a_joint(predictor: ImuPredictor, without_mounting: ImuPredictor) -> None:
    """By 2.5 sigmas each; twice as far the joint is likelier."""
    for turned_rad, one, names in (
        (2.5 * 8.7e-3, predictor, ()),
        (2.5 * 8.7e-3, without_mounting, ("zero_joint_1",)),
        (5.0 * 8.7e-3, predictor, ("zero_joint_1",)),
    ):
        known = turned_about_the_first_axis(one, turned_rad)
        assert Rivals(one).weighed(*known).names[:1] == names


@pytest.mark.parametrize(
    ("sigmas", "named"),
    [((1.2, 1.2, 1.2), True), ((-1.2, -1.2, -1.2), True), ((1.2, -1.2, 1.2), True), ((0.4, 0.4, 0.4), False)],
)
def test_a_scale_of_all_axes_is_noticed_long_before_it_is_many_stated_sigmas(
    predictor: ImuPredictor, sigmas: tuple[float, ...], *, named: bool
) -> None:
    """The data tell a tenth of the variance, so of three axes together a sigma of 0.55 stated ones."""
    at = [predictor.names.index(f"gyro_scale_{axis}_imu_2") for axis in "xyz"]
    x, P = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma, nan=1.0) ** 2)
    x[at], P[at, at] = sigmas * predictor.sigma[at], 0.9 * P[at, at]
    assert Rivals(predictor).weighed(x, P).names[:1] == (("imu_2",) if named else ())


def test_what_is_farther_off_than_any_error_is_not_freed_but_told(predictor: ImuPredictor) -> None:
    at = [predictor.names.index(f"gyro_scale_{axis}_imu_2") for axis in "xyz"]
    x, P = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma, nan=1.0) ** 2)
    P[at, at] = 1e-6 * P[at, at]
    for size, told in ((0.2, ""), (0.4, "imu_2")):
        rivals, x[at] = Rivals(predictor), size  # the prior hardly counts
        assert rivals.weighed(x.copy(), P).too_far == told
        assert (rivals.freeing(x.copy(), P) is None) == bool(told)


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
    assert rivals.freed_at.size == 0


def test_what_counts_is_freed_once_and_taken_back_where_it_is_weighed(predictor: ImuPredictor) -> None:
    """Also where something that was not free turns out to be the likeliest."""
    rivals = Rivals(predictor)
    x, P = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma, nan=1.0) ** 2)
    at, _ = predictor.drawn["base"]
    x[at], P[at, at] = 20.0, 0.01  # far from the drawing
    free = rivals.freeing(x, P)
    assert free is not None
    assert rivals.freed_at.tolist() == at.tolist()
    freed = free((x, P))
    assert rivals.freeing(*freed) is None
    np.testing.assert_allclose(rivals.weighed(*freed).stated[1], P, atol=1e-9)
    assert rivals.weighed(*freed).names == ("base",)
    zero = predictor.names.index("zero_joint_1")
    (mean, covariance) = (part.copy() for part in freed)
    mean[zero], covariance[zero, zero] = 20.0 * predictor.sigma[zero], 0.01 * covariance[zero, zero]
    free = rivals.freeing(mean, covariance)
    assert free is not None
    assert set(rivals.freed_at) == {*at, zero}
    assert rivals.weighed(*free((mean, covariance))).names[0] in ("base and zero_joint_1", "zero_joint_1 and base")
    np.testing.assert_allclose(rivals.weighed(*free((mean, covariance))).stated[1][at, at], P[at, at], atol=1e-9)


@pytest.mark.parametrize(("name", "free"), [("scale_joint_2", True), ("place_joint_4", False)])
def test_of_an_empty_arm_only_an_encoder_is_freed(predictor: ImuPredictor, name: str, *, free: bool) -> None:
    """One that seems to be heavier than drawn may hold something."""
    rivals = Rivals(predictor)
    one = next(one for one in suspects_of(predictor) if one.name == name)
    x, P = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma, nan=1.0) ** 2)
    along = one.along[:, 0] / np.linalg.norm(one.along[:, 0] / predictor.sigma[one.at]) ** 2
    x[one.at] = 8.0 * along * np.linalg.norm(one.along[:, 0] / predictor.sigma[one.at])
    P[np.ix_(one.at, one.at)] *= 0.5
    assert name in rivals.weighed(x, P).names[0]
    assert (rivals.freeing(x, P, held=False) is not None) == free
    assert free or rivals.freeing(x, P) is not None


def test_cyclic_errors_are_noise_where_the_scale_of_their_encoder_may_be_wrong(predictor: ImuPredictor) -> None:
    """With amplitudes that are normal, a cosine and a sine each, as they are stated."""
    rng, n = np.random.default_rng(5), 400
    cyclic = [name for name in predictor.names if name.startswith("cyclic_")]
    ticks = predictor.no_ticks._replace(
        joint_sigma=np.full((n, 2, 5), 1e-4), cyclic=rng.normal(size=(n, 3, len(cyclic)))
    )
    at = np.array([predictor.names.index("scale_joint_2"), predictor.names.index("place_x_joint_1")])
    noise = predictor.rippled(ticks, at)
    np.testing.assert_array_equal(np.delete(noise, 1, axis=2), 1e-4)
    own = [k for k, name in enumerate(cyclic) if name.endswith("_joint_2")]
    sigma = predictor.sigma[[predictor.names.index(cyclic[k]) for k in own]]
    drawn = np.einsum("nok,sk->nos", ticks.cyclic[:, 1:, own], sigma * rng.normal(size=(4000, len(own)))).std(axis=2)
    np.testing.assert_allclose(noise[:, :, 1], np.hypot(1e-4, drawn), rtol=0.06)
    np.testing.assert_array_equal(predictor.rippled(ticks, at[1:]), ticks.joint_sigma)


def test_what_has_stepped_is_a_wrong_constant_of_a_window_after_the_step(predictor: ImuPredictor) -> None:
    """By 2 %, estimated to 0.1 %; the filter, which does not follow it, still has what is stated."""
    rivals, scale = Rivals(predictor), predictor.names.index("scale_load_cell")
    x, P = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma, nan=1.0) ** 2)
    assert rivals.adds(x, P) is None
    of = rivals.steps.suspects
    (k,) = (k for k, one in enumerate(of) if one.at.tolist() == [scale])
    m = sum(one.along.shape[1] for one in of)  # the payload's after all others
    D, d, J = np.zeros((len(x), m)), np.zeros(m), np.zeros((m, m))
    D[scale, k], d[k], J[k, k] = 0.1, 2e3, 1e4 - 1.0
    rivals.steps.changed = Changed(D, d, J, D.copy())
    step = rivals.adds(x, P)
    assert step is not None
    assert [at.tolist() for at in step.at] == [[scale]]
    assert (step.shift[scale], step.root[scale, 0]) == (pytest.approx(0.02), pytest.approx(1e-3))
    initial = x.copy(), P
    (mean, covariance), before = rivals.adopting((x, P), step, initial)
    rivals.steps.forget()
    assert rivals.freed_at.tolist() == [scale]
    assert before[1][scale, scale] == pytest.approx(P[scale, scale] + 0.1**2)  # as of a scale that is wrong
    weighed = rivals.weighed(mean, covariance)
    assert "load_cell" in weighed.names
    (alone,) = (one for one in weighed.every if one.numbers == rivals.freed)
    found = weighed.known(alone)
    np.testing.assert_allclose(found[0], x + step.shift, atol=1e-9)
    assert found[1][scale, scale] == pytest.approx(P[scale, scale] + 1e-6, rel=1e-6)
    assert rivals.adopting((mean, covariance), None, before) == ((mean, covariance), before)


def steps_of(rivals: Rivals, **told: float) -> Changed:
    """Of the first time: by its suspect, what a step of one sigma of it is in the sigmas of what tells of it."""
    m = sum(one.along.shape[1] for one in rivals.steps.suspects)
    d, J = np.zeros(m), np.eye(m) * 1e4
    for which in range(m):
        if (name := rivals.steps.what(which).name.split()[-1]) in told:
            d[which] = told.pop(name) * 1e2
    return rivals.steps.changed._replace(D=np.zeros((len(rivals.steps.changed.D), m)), d=d, J=J)


def test_after_a_change_what_is_wrong_all_flight_is_no_reason_for_it(predictor: ImuPredictor) -> None:
    rivals, scale = Rivals(predictor), predictor.names.index("scale_load_cell")
    x, P = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma, nan=1.0) ** 2)
    x[scale], P[scale, scale] = 20.0 * P[scale, scale] ** 0.5, 1e-8
    inside = steps_of(rivals, load_cell=15.0)
    freed, stepped, _ = rivals.wrong((x, P), inside, changed=False)
    assert freed
    assert stepped == ()
    freed, stepped, _ = rivals.wrong((x, P), inside, changed=True)
    assert freed == ()
    assert [rivals.steps.what(k).name for k in stepped] == ["a step of load_cell"]


def test_the_payload_has_changed_where_nothing_else_is_likely(predictor: ImuPredictor) -> None:
    rivals = Rivals(predictor)
    known = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma, nan=1.0) ** 2)
    for told, since in (({}, False), ({"payload": 16.3}, True), ({"payload": 16.3, "load_cell": 15.0}, False)):
        rivals.steps.changed = steps_of(rivals, **told)
        assert (rivals.altered(*known) is not None) is since
    assert {"a change of the payload", "a step of load_cell"} <= set(rivals.weighed(*known).names)


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


def test_evidence_of_what_is_free_is_that_of_windows_and_is_kept_when_their_ticks_are_not(
    predictor: ImuPredictor,
) -> None:
    x, P = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma, nan=1.0) ** 2)
    at, _ = predictor.drawn["base"]
    x[at], P[at, at] = 3.0, 0.01  # the linear model has more than a thousand nats
    rivals = Rivals(predictor)
    *_, whole = (k for k, one in enumerate(suspects_of(predictor)) if one.name == "base")  # each of its parameters
    known = rivals.taken([whole], [])((x, P))
    assert rivals.freed == (whole,)

    def against_as_stated() -> float:
        none, *every = rivals.weighed(*(part.copy() for part in known)).every
        (one,) = (one for one in every if one.numbers == (whole,))
        assert one.suspect is not None
        return float(np.log(one.weight / none.weight / one.suspect.odds))

    rivals.solved(known, 5.0, at_least=False)
    assert against_as_stated() == pytest.approx(5.0)
    for carried in (None, known):
        rivals.begin(carried)
        rivals.solved(known, 3.0, at_least=False)
    assert against_as_stated() == pytest.approx(5.0 + 2 * 3.0)
    rivals.begin(None)
    rivals.solved(known, -11.0, at_least=False)
    assert against_as_stated() == pytest.approx(0.0, abs=1e-9)
    rivals.solved(known, 9.0, at_least=True)
    assert against_as_stated() > 15.0
