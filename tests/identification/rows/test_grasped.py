"""A tool in the gripper of a fixed arm, weighed by its wrist in MuJoCo; and data that do not determine it.

What a considered error of the base's IMU is said to do to an estimate is what it does.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import onboard
from bench.identification.workshop import payload
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants.body import Solid
from hil_sim.plants.planned import default_plan
from hil_sim.plants.vehicle_plant import VehiclePlant
from onboard import config
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.inertia import RigidBody, pseudo_inertia, symmetric
from onboard.dynamics.model.payload import body_of, numbers_of, standard_of
from onboard.dynamics.model.vehicle import STANDARD, VehicleModel, VehicleSpec
from onboard.estimation.gates import GateReason, reasons
from onboard.estimation.policy import HALF
from onboard.estimation.smoothing import SmoothingWindow, correlation_inflation
from onboard.flight.estimate.problem.identification import build_identifier
from onboard.ground.before.foresee.plan import MotionPlan, plan_of
from onboard.ground.before.foresee.rows import StatedNoise
from onboard.ground.before.init.vehicle import NewVehicle, make
from onboard.identification.quantities import BODY
from onboard.identification.rows.checks.suspected import of_no_key
from onboard.identification.rows.checks.suspects import RowSuspects
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.stated_errors.considered import Considered
from onboard.identification.rows.stated_errors.drawing import Unstated
from onboard.identification.rows.stated_errors.stated import Stated
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.prior import prior_root
from onboard.regressor.rows import RowModel, load_cell_row, standing
from onboard.regressor.signals import SignalNoise, Signals

BIAS_m_s2 = 0.03
HZ = 50.0


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[config.Vehicle, MotionPlan]:
    directory = tmp_path_factory.mktemp("it")
    make(NewVehicle("it", "prescribed", ("shoulder", "elbow"), load_cell="cia404"), directory / "it")
    vehicle = config.load(directory / "it" / "vehicle.toml").with_row_rate(HZ)
    return vehicle, plan_of(vehicle, default_plan(scenario_of(str(directory / "it" / "vehicle.toml")), 1.0 / HZ))


def fed(vehicle: config.Vehicle, plan: MotionPlan, bias: np.ndarray) -> Identifier:
    """An identifier after a flight without noise, its accelerometer off by a bias."""
    identifier, model = build_identifier(vehicle)
    chi = identifier.model.chi.copy()
    assert plan.payload is not None
    chi[model.payload_columns()] = standard_of(plan.payload)
    signals = StatedNoise(vehicle, identifier, 1.0 / HZ, coarse=False).signals(plan, plan.bases[0], chi)
    f = signals.motion.specific_force_m_s2
    signals = signals._replace(motion=signals.motion._replace(specific_force_m_s2=f + bias))
    identifier.update(signals, plan.held, reasons(~plan.used(vehicle), GateReason.PHASE))
    identifier.recursion.expect_noise()
    return identifier


@pytest.mark.parametrize("axis", [0, pytest.param(1, marks=pytest.mark.campaign)])  # alike
def test_a_bias_does_what_its_column_says(axis: int, flown: tuple[config.Vehicle, MotionPlan]) -> None:
    whole = fed(*flown, np.zeros(3))
    off = fed(*flown, BIAS_m_s2 * np.eye(3)[axis])
    told = whole.estimate().supported & ["payload" in name for name in whole.base.names]
    assert told.sum() == 7
    cause = next(k for k, one in enumerate(whole.considered) if one.effect == "accelerometer_bias" and one.axis == axis)
    jackknife = whole.block_jackknife()
    said = jackknife.causes(np.eye(len(whole.base.names)))[told, cause] * BIAS_m_s2 / whole.considered[cause].sigma
    done = (off.block_jackknife().mean - jackknife.mean)[told]
    sigma = np.sqrt(jackknife.formal_variance(np.eye(len(told))))[told]
    assert (np.abs(done) > 0.1 * sigma).any()
    np.testing.assert_allclose(said / sigma, done / sigma, rtol=0.05, atol=0.1)


URDF = (Path(onboard.__file__).parent / "vehicles" / "workshop" / "workshop.urdf").read_text()
TOOL = Solid.box(0.30, (0.22, 0.05, 0.03), (0.02, 0.06, 0.01))
GRASP_S, END_S, WIDTH_S, ROW_S = 3.0, 12.0, 0.2, 0.02
NOISE, COUNT_rad = np.repeat([0.0104, 3.1e-4], 3), 2.0 * np.pi / 500_000
EXACT = {"mass_relative": 0.0, "centre_mm": 0.0, "inertia_relative": 0.0}
TRUTH = np.array([0.30, *TOOL.centre_of_mass_m, *TOOL.inertia_kg_m2[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


def six_axes(name):
    """Force, then moment, along the axes of the cell's frame."""
    return [
        load_cell_row(f"{name}_{kind}_{axis}", "wrist", unit, kind)
        for kind in ("force", "moment")
        for axis, unit in zip("xyz", np.eye(3), strict=True)
    ]


def model_of(payload, cells):
    vehicle = VehicleModel(URDF, VehicleSpec(BaseKind.FIXED, "bench", payload))
    return RowModel(vehicle, [row for name in cells for row in six_axes(name)])


@cache
def base_of(payload, cells):
    return base_parameters(model_of(payload, cells), np.random.default_rng(0))


def scales_of(model):
    """The scale of each axis, stated to 0.25 %."""
    return tuple(Considered(f"scale of {row.name}", row.name, "scale", 0.0025) for row in model.rows)


def stated_of(model):
    """What states the sigma of each standard parameter, as a vehicle file does."""
    links, payload = model.vehicle.links, model.vehicle.spec.payload_link
    of = [links[k // 10] if k < 10 * len(links) else "" for k in range(len(model.names))]
    drawn = {link: Stated(f"prior.relative.{link}", "prior.relative") for link in links if link != payload}
    names = zip(model.names, of, strict=True)
    return [drawn.get(link) or Stated(name, link or name.split("_")[0]) for name, link in names]


def identifier(payload="tool", cells=("wrist",), widens=True):
    """As on board; where nothing ``widens`` what is stated, and nothing else is weighed, as of rows that go on."""
    model = model_of(payload, cells)
    vehicle = model.vehicle
    links = dict.fromkeys(vehicle.links, 0.01)
    extras = {f"{name}_tool": s for name, s in zip(STANDARD, (5, 1, 1, 1, *[0.2] * 6), strict=True) if payload}
    extras |= {name: 5.0 if "force" in name else 0.5 for name in model.names if name.startswith("bias")}
    base, root, errors = base_of(payload, cells), prior_root(model, links, extras), scales_of(model)
    errors += tuple(of_no_key(errors, model))
    weighs, stated = (RowSuspects(model, base, root, errors), stated_of(model)) if widens else (None, ())
    return Identifier(model, base, root, 5 * WIDTH_S, considered=errors, stated=stated, suspects=weighs)


def signals(seed, vehicle, tool=TOOL, swing=0.5):
    """Rows of the packaged mission's world, shortened: the gripper alone, then the tool."""
    step = {"action": "swing", "swing": swing, "ramp_s": 1.0} if swing else {"action": "hold"}
    parts = [step | {"phase": 1, "duration_s": GRASP_S}, step | {"phase": 2, "duration_s": END_S - GRASP_S}]
    over = {"payload": payload(tool), "sequence": parts, "as_built": {"gripper": EXACT}}
    rng = np.random.default_rng(seed)
    plant = VehiclePlant(scenario_of("workshop", over), rng)
    every = round(2e-3 / plant.step_s)
    time_s = plant.step_s * np.arange(0, round(END_S / plant.step_s), every)
    rows = slice(0, every * len(time_s), every)
    wrench = np.column_stack(
        [plant.force_n("wrist")[rows], *(plant.moment_n_m("wrist", tuple(axis))[rows] for axis in np.eye(3))]
    )
    bias, scale = np.repeat([0.5, 0.02], 3) * rng.standard_normal(6), 1.0 + 0.0025 * rng.standard_normal(6)
    wrench = scale * wrench + bias + NOISE * rng.standard_normal(wrench.shape)
    angle = np.column_stack([plant.angle_rad(f"joint_{k}")[rows] for k in range(1, 6)])
    angle = (np.floor(angle / COUNT_rad) + 0.5) * COUNT_rad
    at = np.arange(WIDTH_S, END_S - WIDTH_S, ROW_S)
    at = at[np.abs(at - GRASP_S) > WIDTH_S]
    window = SmoothingWindow(time_s, at, WIDTH_S)
    joints = [window.apply(angle, order) for order in range(3)]
    wrist, inflation = window.apply(wrench), correlation_inflation(WIDTH_S, ROW_S)
    sigma = np.outer(wrist.noise_gain, NOISE) * inflation
    count = np.full(5, COUNT_rad / np.sqrt(12.0))
    noise = SignalNoise(*(np.outer(j.noise_gain, count) for j in joints), *np.zeros((3, len(at), 3)), inflation)
    base = standing(vehicle, len(at))
    return Signals(at, *(j.values for j in joints), base, wrist.values, sigma, noise=noise)


class Told(NamedTuple):
    """The ten answers of an identifier."""

    value: np.ndarray
    sigma: np.ndarray
    low: np.ndarray
    high: np.ndarray
    supported: np.ndarray
    notes: list


def grasped(who):
    ten = who.estimate().quantities
    assert [one.name for one in ten] == [f"{name}_tool" for name in BODY]
    numbers = np.array([(one.value, one.sigma, one.low, one.high) for one in ten]).T
    return Told(*numbers, np.array([one.supported for one in ten]), [one.note for one in ten])


def feed(who, given):
    return who.update(given, given.time_s > GRASP_S, np.zeros(len(given.time_s), np.int64))


@pytest.fixture(scope="module")
def run():
    return signals(20, identifier().model.vehicle)


def test_a_tool_is_weighed(run):
    who = identifier()
    feed(who, run)
    found = grasped(who)
    assert found.supported.all()
    assert set(found.notes) == {""}
    assert abs(found.value[0] / TOOL.mass_kg - 1) < 0.005
    assert np.linalg.norm(found.value[1:4] - TOOL.centre_of_mass_m) < 5e-4
    assert np.linalg.norm(found.value[4:] - TRUTH[4:]) < 0.05 * np.linalg.norm(TOOL.inertia_kg_m2)
    assert ((found.low < TRUTH) & (found.high > TRUTH)).sum() >= 8
    assert (found.sigma[:4] < [2e-3, 5e-4, 5e-4, 5e-4]).all()


@pytest.mark.parametrize("seed", [1, pytest.param(4, marks=pytest.mark.campaign)])  # other noise
def test_a_light_tool_is_a_body_that_can_exist(seed):
    """Of 50 g in a cube of 2 cm the inertia is known to a few times its size: the raw estimate was no body's."""
    tool = Solid.box(0.05, (0.02, 0.02, 0.02), (0.0, 0.0, 0.01))
    who = identifier()
    feed(who, signals(seed, who.model.vehicle, tool))
    found = grasped(who)
    assert found.supported.all()
    weights = who.base.weights(np.eye(len(who.model.names))[who.model.vehicle.payload_columns()])
    estimated = weights @ who.block_jackknife().mean
    assert np.linalg.eigvalsh(pseudo_inertia(estimated))[0] < 0.0
    body = RigidBody(found.value[0], found.value[1:4], symmetric(found.value[4:]))
    assert np.linalg.eigvalsh(pseudo_inertia(standard_of(body)))[0] > 0.0
    assert (found.sigma >= np.abs(found.value - numbers_of(body_of(estimated)))).all()
    truth = np.array(
        [tool.mass_kg, *tool.centre_of_mass_m, *tool.inertia_kg_m2[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]]
    )
    assert ((found.low < truth) & (found.high > truth)).sum() >= 9


def test_masses_do_not_follow_the_noise():
    """Noise of the readings that were in a column, or noise counted on one side only, shifted every mass."""
    errors = []
    for seed in range(16):
        who = identifier()
        feed(who, signals(seed, who.model.vehicle))
        errors.append(grasped(who).value[0] / TOOL.mass_kg - 1)
        assert who.findings().against == ()
    assert abs(np.mean(errors)) < 3e-4


def test_a_still_arm_says_mass_but_no_inertia():
    who = identifier()
    feed(who, signals(1, who.model.vehicle, swing=0.0))
    found = grasped(who)
    assert not found.supported[4:].any()
    assert np.isnan(found.value[4:]).all()
    assert all("not determined" in note for note in found.notes[4:])


def test_nothing_held_is_no_mass(run):
    who = identifier()
    who.update(run, np.zeros(len(run.time_s), bool), np.where(run.time_s > GRASP_S, int(GateReason.PHASE), 0))
    found = grasped(who)
    assert not found.supported.any()
    assert np.isnan(found.value).all()
    assert all("do not determine a mass" in note for note in found.notes)


def test_readings_that_are_not_numbers_are_left_out_by_name(run):
    measured = run.measured.copy()
    measured[::7, 2] = np.nan
    measured[100:120] = np.inf
    who = identifier()
    reasons = feed(who, run._replace(measured=measured))
    assert (reasons[::7, 2] & GateReason.GAP).all()
    assert who.refused[GateReason.GAP] == (~np.isfinite(measured)).sum()
    assert abs(grasped(who).value[0] / TOOL.mass_kg - 1) < 0.005


def test_two_cells_that_contradict_each_other_give_no_mass(run):
    """A second cell in the same place that reads a tenth more than the first, both calibrated to 0.25 %."""
    who = identifier(cells=("wrist", "second"), widens=False)
    other = 1.1 * run.measured + 0.1
    both = run._replace(measured=np.hstack([run.measured, other]), sigma=np.hstack([run.sigma, run.sigma]))
    feed(who, both)
    found = grasped(who)
    assert np.isnan(found.value).all()
    assert all("contradict" in note for note in found.notes)


def test_a_gripper_that_is_not_what_it_was_weighed_as_is_said(run):
    """The prior says 1 % of 0.45 kg; the rows say three times that."""
    who = identifier()
    measured = run.measured.copy()
    measured[:, :3] *= 3.0
    measured[:, 3:] *= 3.0
    feed(who, run._replace(measured=measured))
    found = grasped(who)
    assert not found.supported.any()
    assert all("all cells is farther from what is stated" in note for note in found.notes)


def test_what_contradicts_the_prior_is_held_against_all_parameters(run):
    """Of the gripper's too: 3 % of its mass had been reported as good beside a tool that was refused."""
    who = identifier()
    feed(who, run._replace(measured=3.0 * run.measured))
    assert any("farther from what is stated" in said for said in who.findings().against)
    assert not who.estimate().supported.any()


@pytest.mark.parametrize("scale", [1.08, 1.015, 1.0])
def test_a_scale_that_is_far_beyond_its_sigma_is_named(run, scale):
    """Calibrated to 0.25 %."""
    who, measured = identifier(), run.measured.copy()
    measured[:, 3] *= scale
    feed(who, run._replace(measured=measured))
    said = who.findings()
    assert said.against == ()
    assert any(one.startswith("not as stated: wrist_moment_x") for one in said.doubts) is (scale > 1.0)
    found = grasped(who)
    assert abs(found.value[0] - TRUTH[0]) < 3.0 * found.sigma[0]


def test_its_intervals_contain_what_no_key_states(run, monkeypatch):
    """A suspected step that moves every parameter by 10 %: no more and no less is added to a sigma, and to half."""
    who = identifier()
    feed(who, run)
    jackknife = who.block_jackknife()
    monkeypatch.setattr(who, "unstated", lambda jackknife: Unstated.of([], np.zeros((0, len(jackknife.mean)))))
    told = grasped(who)
    step = Unstated(0.1 * jackknife.mean[None], np.zeros((0, len(jackknife.mean))))
    moved = who.payload.weights(jackknife) @ step.steps[0]
    monkeypatch.setattr(who, "_estimated", None)
    monkeypatch.setattr(who, "unstated", lambda jackknife: step)
    wider = grasped(who)
    np.testing.assert_allclose(wider.sigma, np.hypot(told.sigma, moved), rtol=1e-9)
    half = np.hypot(told.high - told.value, HALF * moved)
    np.testing.assert_allclose(wider.high - wider.value, half, rtol=1e-9)
    assert abs(moved[0]) == pytest.approx(0.1 * told.value[0])


def test_the_bound_is_not_above_the_sigma(run):
    who = identifier()
    feed(who, run)
    bounds = who.bounds()
    assert bounds.shape == (len(who.base.names) + 10,)
    assert (bounds[-10:] <= grasped(who).sigma * (1 + 1e-9)).all()


def test_rows_that_cannot_tell_all_of_a_payload_do_not_name_it(run):
    assert identifier(payload=None).quantity_names == ()
    vehicle = VehicleModel(URDF, VehicleSpec(BaseKind.FIXED, "bench", "tool"))
    model = RowModel(vehicle, [load_cell_row("cell", "wrist", (0, 0, 1), "moment")])
    base = base_parameters(model, np.random.default_rng(0))
    prior = prior_root(model, dict.fromkeys(vehicle.links, 0.01) | {"tool": 0.0}, {"bias_cell": 1.0})
    floor = 1e-6 * np.eye(len(prior))
    assert Identifier(model, base, np.maximum(prior, floor), 5 * WIDTH_S).quantity_names == ()


def test_a_cell_too_small_for_its_load_is_the_reason_where_most_readings_are_saturated(run):
    who, refused = identifier(), np.zeros((len(run.time_s), 6), np.int64)
    refused[run.time_s > GRASP_S] = int(GateReason.SATURATED)
    feed(who, run._replace(refused=refused))
    assert not grasped(who).supported.any()
    assert all("of the readings are beyond the capacity of their cells" in note for note in grasped(who).notes)
