"""Groupings: what is printed, read as an equation, is the base parameter; and it looks like what people write.

Wrist cells, motor currents, other bases than free ones: MuJoCo's answers.
"""

import re

import numpy as np
import pytest

from onboard.dynamics.model.bases import BASES, BaseKind
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.groupings import groupings
from onboard.regressor.prior import prior_root
from onboard.regressor.rows import (
    RowModel,
    base_force_rows,
    base_moment_rows,
    joint_torque_row,
    load_cell_row,
    standing,
)
from tests.dynamics.free_flyer_twin import URDF
from tests.dynamics.mujoco_twin import inverse_dynamics, random_vehicle, to_mujoco, to_urdf

KINDS = ["revolute", "prismatic", "revolute", "fixed"]
TICKS = 5
GRAVITY = (3.0, -4.0, -8.0)  # the bench stands askew


@pytest.fixture
def links(rng):
    return random_vehicle(rng, KINDS)


def arm_with_cell(links, base=BaseKind.FIXED):
    return VehicleModel(to_urdf(links), VehicleSpec(base, "base", "link_4", GRAVITY))


def on_a_bench(rng, links):
    """Random motion of an arm bolted down in gravity: joint signals, MuJoCo's joint forces, its wrist sensor."""
    model = to_mujoco(links)
    model.opt.gravity[:] = GRAVITY
    q, dq, ddq = rng.normal(size=(3, TICKS, 3))
    still = np.zeros(3)
    answers = [inverse_dynamics(model, *tick, still, still, still, still) for tick in zip(q, dq, ddq, strict=True)]
    return (q, dq, ddq), np.array([a[2] for a in answers]), np.array([a[3][-6:] for a in answers])


def six_axes(bias=True):
    return [
        load_cell_row(f"wrist_{kind}_{axis}", "joint_link_4", unit, kind, bias=bias)
        for kind in ("force", "moment")
        for axis, unit in zip("xyz", np.eye(3), strict=True)
    ]


def test_a_wrist_cell_in_gravity_reads_mujocos_force_and_torque(rng, links):
    vehicle = arm_with_cell(links)
    joints, torques, wrist = on_a_bench(rng, links)
    cells = six_axes(bias=False)
    rows = RowModel(vehicle, [*cells, *(joint_torque_row(vehicle, j.name, friction=False) for j in vehicle.joints)])
    found = rows.regressor(*joints, standing(vehicle, TICKS)) @ rows.chi
    np.testing.assert_allclose(found[:, :6], wrist, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[:, 6:], torques, rtol=1e-9, atol=1e-9)


def test_a_planar_base_has_three_rows(links):
    vehicle = arm_with_cell(links, BaseKind.PLANAR)
    names = [row.name for row in (*base_force_rows(vehicle), *base_moment_rows(vehicle))]
    assert names == ["base_force_x", "base_force_y", "base_moment_z"]


def test_gravity_makes_masses_visible_on_a_fixed_base_and_not_along_the_wall(rng):
    """A joint whose axis lies along gravity shows one parameter, across it three."""
    (base, link) = random_vehicle(rng, ["revolute"])
    link.axis, link.rpy = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    counts = []
    for gravity in ((0.0, 0.0, -9.8), (0.0, -9.8, 0.0)):
        vehicle = VehicleModel(to_urdf([base, link]), VehicleSpec(BaseKind.FIXED, "base", gravity_m_s2=gravity))
        model = RowModel(vehicle, [joint_torque_row(vehicle, "joint_link_1", friction=False)])
        counts.append(len(base_parameters(model, rng).names))
    assert counts == [1, 3]


def test_priors_with_negative_sigmas_are_refused(links):
    vehicle = arm_with_cell(links)
    model = RowModel(vehicle, [load_cell_row("cell", "joint_link_1", (0, 0, 1), "moment")])
    for wrong in (-0.1, np.nan, np.inf):
        sigmas = dict.fromkeys(vehicle.links, 1.0) | {"link_2": wrong}
        with pytest.raises(SignalError, match="link_2 is negative or not finite"):
            prior_root(model, sigmas, {"bias_cell": 1.0})
        with pytest.raises(SignalError, match="bias_cell is negative or not finite"):
            prior_root(model, dict.fromkeys(vehicle.links, 1.0), {"bias_cell": wrong})


X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)


def arm(rng, axes, spacing, kind=BaseKind.FIXED, payload=None):
    links = random_vehicle(rng, ["revolute"] * len(axes) + ["fixed"] * (payload is not None))
    for link, axis, xyz in zip(links[1:], axes, spacing, strict=False):
        link.axis, link.rpy, link.xyz = np.array(axis, float), np.zeros(3), np.array(xyz, float)
    return VehicleModel(to_urdf(links), VehicleSpec(kind, "base", payload))


def value(line, numbers):
    """Reads ``(M4 + M5) L3^2`` as people do."""
    text = re.sub(r"\^2", "**2", line)
    text = re.sub(r" (/?)m(\*\*2)?(?= |$)", "", text)
    text = re.sub(r"(?<=[\w)])\s+(?=[\w(])", " * ", text)
    return eval(text, {"__builtins__": {}}, numbers)


@pytest.mark.parametrize("kind", list(BASES.values()), ids=str)
@pytest.mark.parametrize("odd", [False, True])
def test_what_is_printed_is_the_base_parameter(rng, kind, odd):
    vehicle = arm(rng, [Z, Y, Y, X], [(0, 0, 0.3), (0.2, 0.1, 0), (0.4, 0, 0), (0, 0, 0.1)], kind)
    if odd:  # every frame turned by angles that nobody can name
        vehicle = VehicleModel(to_urdf(random_vehicle(rng, ["revolute", "prismatic"])), VehicleSpec(kind, "base"))
    rows = [joint_torque_row(vehicle, joint.name) for joint in vehicle.joints]
    rows += [load_cell_row("cell", vehicle.joints[-1].name, (1, 2, 3), "force")]
    if kind is BaseKind.FREE:
        rows += [*base_force_rows(vehicle), *base_moment_rows(vehicle)]
    model = RowModel(vehicle, rows)
    base = base_parameters(model, np.random.default_rng(1))
    found = groupings(model, base)
    chi = rng.normal(size=len(model.names))
    tags = {link: tag if tag.isdigit() else f"_{tag}" for tag, link in found.links.items()}
    tags |= {joint.name: str(k) for k, joint in enumerate(vehicle.joints, 1)}
    numbers = {length.symbol: length.value_m for length in found.lengths}
    for name, one in zip(model.names, chi, strict=True):
        what, _, owner = name.partition("_")
        numbers[what + tags[owner] if owner in tags else name] = one
    told = [value(text, numbers) for text in found.sums]
    four_digits = 1e-3 * np.abs(base.grouping).max() * np.abs(chi).max() if odd else 1e-6
    np.testing.assert_allclose(told, base.value(chi), atol=four_digits)
    assert (len(found.lengths) > 0) == (not odd or any("L" in text for text in found.sums))


def test_a_puma_like_arm(rng):
    """The first joint stands along gravity: what turns with it and only then is all in ZZ1."""
    spacing = [(0, 0, 0.3), (0, 0, 0), (0.4, 0, 0), (0, 0, 0.35), (0, 0, 0), (0, 0, 0)]
    vehicle = arm(rng, [Z, Y, Y, Z, Y, Z], spacing)
    model = RowModel(vehicle, [joint_torque_row(vehicle, joint.name) for joint in vehicle.joints])
    found = groupings(model, base_parameters(model, np.random.default_rng(1)))
    lines = dict(line.split(" = ") for line in found.lines if " = " in line)
    assert lines["MX2R"] == "MX2 + (M3 + M4 + M5 + M6) L3"
    assert lines["ZZ1R"] == "ZZ1 + XX2 + XX3 + YY4 + Ia1 + 2 L4 MZ4 + (M4 + M5 + M6) L4^2"
    assert "ZZ6" in found.lines
    assert {length.symbol: length.value_m for length in found.lengths} == {"L3": 0.4, "L4": 0.35}


def test_the_free_flyer():
    vehicle = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", "payload"))
    model = RowModel(vehicle, [*base_force_rows(vehicle), *base_moment_rows(vehicle)])
    lines = groupings(model, base_parameters(model, np.random.default_rng(1))).lines
    assert lines[0] == "M0R = M0 + M1 + M2 + M3 + M4 + M5"
    assert "XX0R = XX0 + YY1 + 2 L1 MZ1 + M1 L1^2 + (M2 + M3 + M4 + M5) (L1 + L2)^2" in lines
    assert "ZZ4R = ZZ4 - XX4 - YY5 - 2 L5 MZ5 - M5 L5^2" in lines
    assert "M_payload" in lines


def test_lengths_that_happen_to_be_equal_are_told_apart(datasets):
    """Three of the LWR's are 0.2 m."""
    vehicle = VehicleModel((datasets / "kuka_lwr4" / "kuka_lwr4.urdf").read_text(), VehicleSpec(BaseKind.FIXED, "box"))
    model = RowModel(vehicle, [joint_torque_row(vehicle, joint.name) for joint in vehicle.joints])
    found = groupings(model, base_parameters(model, np.random.default_rng(1), released=False), released=False)
    assert "ZZ1R = ZZ1 + XX2 + YY3 + Ia1 + 2 L3 MZ3 + M3 L3^2 + (M4 + M5 + M6 + M7) (L3 + L4)^2" in found.lines
    assert "YZ5R = YZ5 - MY6 L6" in found.lines
    assert [length.value_m for length in found.lengths] == pytest.approx([0.2, 0.2, 0.2, 0.19, 0.078])


def test_the_tx40_table_is_written_alike(datasets):
    """Its published names; the ``L4`` of the URDF points backwards and stands for their -0.225."""
    urdf = datasets / "staubli_tx40" / "tx40_mdh_modified.urdf"
    vehicle = VehicleModel(urdf.read_text(), VehicleSpec(BaseKind.FIXED, "base_link"))
    model = RowModel(vehicle, [joint_torque_row(vehicle, joint.name) for joint in vehicle.joints])
    found = groupings(model, base_parameters(model, np.random.default_rng(1), released=False), released=False)
    assert "ZZ1R = ZZ1 + YY2 + YY3 + Ia1 + 2 L3z MZ3 + (M3 + M4 + M5 + M6) (L3x^2 + L3z^2)" in found.lines
    assert "XZ2R = XZ2 - L3x MZ3 - (M3 + M4 + M5 + M6) L3x L3z" in [
        line.replace("MZ3 L3x", "L3x MZ3") for line in found.lines
    ]
    published = (datasets / "staubli_tx40" / "TX40_bp_5.csv").read_text().splitlines()
    assert sum(" " in line.split(",")[0] for line in published) == sum("=" in line for line in found.lines)
