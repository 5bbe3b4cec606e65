"""Base parameters: counts that theory gives, a map that keeps the rows, names as people write them."""

import re

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from onboard.dynamics.mechanics.base_parameter_count import first_cluster, fixed_base_count
from onboard.dynamics.mechanics.chain import chain_of
from onboard.dynamics.mechanics.floating_arm import FloatingArm
from onboard.dynamics.model.bases import BASES, BaseKind
from onboard.dynamics.model.errors import SignalError, UnknownFrameError, UrdfError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.ground.before.mechanics.analysis import counted
from onboard.regressor.base_parameters import (
    BaseParameters,
    SampledMotion,
    base_parameters,
    named_relative_sigma,
    sampled_rows,
)
from onboard.regressor.groupings import groupings
from onboard.regressor.rows import RowModel, base_force_rows, base_moment_rows, joint_torque_row, load_cell_row
from tests.dynamics.mujoco_twin import random_link, random_vehicle, to_urdf


def chain_urdf(rng, axes, spacing=(0.3, 0.0, 0.2)):
    """A chain of revolute joints whose axes are those given, in parallel frames."""
    links = random_vehicle(rng, ["revolute"] * len(axes))
    for link, axis in zip(links[1:], axes, strict=True):
        link.axis, link.rpy, link.xyz = np.array(axis, float), np.zeros(3), np.array(spacing)
    return to_urdf(links)


def chain(rng, axes, kind=BaseKind.FIXED, spacing=(0.3, 0.0, 0.2)):
    return VehicleModel(chain_urdf(rng, axes, spacing), VehicleSpec(kind, "base"))


def torque_rows(vehicle, friction=False):
    return RowModel(vehicle, [joint_torque_row(vehicle, joint.name, friction) for joint in vehicle.joints])


X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)


@pytest.mark.parametrize(
    ("axes", "count"),
    [
        # Mayeda et al. 1990: 7 N - 4 B parameters, B the first joints that are parallel to each other;
        # 2 fewer with the first of them along gravity. (Limparis 2.1.4)
        ([Z], 7 - 4 - 2),
        ([Y], 7 - 4),
        ([Z, Y], 14 - 4 - 2),
        ([Y, Z], 14 - 4),
        ([Z, Y, Y], 21 - 4 - 2),
        ([Y, Y], 14 - 8),
        ([Y, Y, X], 21 - 8),
        ([Z, Y, Y, X], 28 - 4 - 2),
        ([Z, Y, Y, X, Y, X], 42 - 4 - 2),
    ],
)
def test_counts_of_fixed_base_chains(rng, axes, count):
    vehicle = chain(rng, axes)
    assert len(base_parameters(torque_rows(vehicle), rng).names) == count


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize("joints", range(1, 7))
def test_counts_of_arms_at_random(rng, joints, upright):
    """The same law for axes that are parallel or perpendicular to the one before, as drawn by lot.

    Of the parallel joints only those at the base count; a cluster further out changes nothing.
    """
    for _ in range(3):
        axes = [Z if upright else Y]
        while len(axes) < joints:
            axes.append((X, Y, Z)[rng.integers(3)])
        first = next((k for k, axis in enumerate(axes) if axis != axes[0]), joints)
        vehicle = chain(rng, axes, spacing=rng.uniform(0.1, 0.4, 3))
        found = len(base_parameters(torque_rows(vehicle), rng, released=False).names)
        assert found == 7 * joints - 4 * first - 2 * upright
        serial = chain_of(FloatingArm(vehicle, vehicle.links[-1]))
        assert first_cluster(serial) == first
        assert fixed_base_count(serial, np.array([0.0, 0.0, -9.81])).parameters == found


@pytest.mark.parametrize("joints", range(1, 6))
def test_counts_on_a_level_bed_and_in_free_flight(rng, joints):
    """Parallel, perpendicular and odd first axes: forces and vertical moment on a bed, the whole wrench in flight."""
    odd = (0.48, 0.6, 0.64)
    for first in (X, Z, odd):
        axes = [first]
        while len(axes) < joints:
            axes.append((X, Y, Z)[rng.integers(3)] if first is not Z or rng.uniform() < 0.5 else axes[-1])
        urdf = chain_urdf(rng, axes, rng.uniform(0.1, 0.4, 3))
        found = {one.base: one for one in counted(urdf, VehicleModel(urdf, VehicleSpec(BaseKind.FREE, "base")))}
        for base in (BaseKind.PLANAR, BaseKind.FREE):
            assert found[base].closed_form.parameters == found[base].numerical, (axes, base)


@pytest.mark.parametrize("joints", range(1, 7))
def test_an_arm_of_odd_angles_shows_seven_a_joint_but_three_of_the_first(rng, joints):
    """No two axes parallel or perpendicular to each other or to gravity: 7 N - 4."""
    vehicle = VehicleModel(to_urdf(random_vehicle(rng, ["revolute"] * joints)), VehicleSpec(BaseKind.FIXED, "base"))
    assert len(base_parameters(torque_rows(vehicle), rng).names) == 7 * joints - 4


def test_rotors_add_one_each_but_for_those_that_a_link_turns_with(rng):
    """A six-axis industrial arm: Ia1 is in ZZ1, and Ia2, square to it, in ZZ2. Friction adds two a joint."""
    vehicle = chain(rng, [Z, Y, Y, Z, Y, Z])
    found = base_parameters(torque_rows(vehicle, friction=True), rng)
    assert len(found.names) == 36 + 4 + 12
    assert {"Ia_joint_link_1", "Ia_joint_link_2"}.isdisjoint(found.names)


@pytest.mark.parametrize("joints", [1, 2, 3, 5])
def test_a_free_base_shows_ten_and_seven_a_joint(rng, joints):
    vehicle = VehicleModel(to_urdf(random_vehicle(rng, ["revolute"] * joints)), VehicleSpec(BaseKind.FREE, "base"))
    rows = RowModel(vehicle, [*base_force_rows(vehicle), *base_moment_rows(vehicle)])
    assert len(base_parameters(rows, rng).names) == 10 + 7 * joints


def rocksat(base=BaseKind.PRESCRIBED, payload="tip_mass"):
    from onboard.config import packaged  # noqa: PLC0415

    vehicle = VehicleModel(
        packaged("rocksat").with_name("rocksat.urdf").read_text(), VehicleSpec(base, "plate", payload)
    )
    return RowModel(vehicle, [load_cell_row("load_cell", "joint_1", (0, 0, 1), "moment", 0.04)])


def test_rocksat(rng):
    """A moment about one axis of a rigid body: ZZ, XX - YY, XY, XZ, YZ, MX, MY; arm and tip; the cell's zero."""
    found = base_parameters(rocksat(), rng)
    assert len(found.names) == 15
    written = groupings(rocksat(), found)
    assert {"ZZ1", "bias_load_cell", "XX1R = XX1 - YY1"} <= set(written.lines)
    assert "MX_tip_mass_R = MX_tip_mass + M_tip_mass L_tip_mass" in written.lines
    assert [length[:2] for length in written.lengths] == [("L_tip_mass", pytest.approx(0.1721))]
    assert written.links == {"0": "plate", "1": "arm", "tip_mass": "tip_mass"}
    assert not any("plate" in name for name in found.names)


def test_rocksat_on_a_still_base_has_the_three_of_the_dissertation(rng):
    """Equation 4.6: only the inertia about the joint is left; with and without the tip mass, and the cell's zero."""
    still = SampledMotion(0.0, 0.0, 0.0)
    held_only = base_parameters(rocksat(), rng, still, released=False)
    assert held_only.names == ("ZZ_arm_R", "bias_load_cell")
    line = groupings(rocksat(), held_only, still, released=False).lines[0]
    assert line == "ZZ1R = ZZ1 + ZZ_tip_mass + 2 L_tip_mass MX_tip_mass + M_tip_mass L_tip_mass^2"
    both = base_parameters(rocksat(), rng, still)
    assert both.names == ("ZZ_arm", "ZZ_tip_mass_R", "bias_load_cell")


@pytest.mark.parametrize("kind", list(BASES.values()), ids=str)
def test_the_map_keeps_every_row(rng, kind):
    links = random_vehicle(rng, ["revolute", "revolute", "fixed"])
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(kind, "base", "link_3"))
    model = RowModel(
        vehicle,
        [
            *base_force_rows(vehicle),
            *base_moment_rows(vehicle),
            joint_torque_row(vehicle, "joint_link_2"),
            load_cell_row("cell", "joint_link_1", (1, 2, 3), "force"),
        ],
    )
    found = base_parameters(model, rng)
    Y = sampled_rows(model, np.random.default_rng(5), 50, SampledMotion.of(kind), True)
    chi = rng.normal(size=len(model.names))
    np.testing.assert_allclose(Y[:, found.independent] @ found.value(chi), Y @ chi, atol=1e-8 * np.abs(Y).max() * 10)
    W = Y[:, found.independent]
    assert np.linalg.matrix_rank(W / np.linalg.norm(W, axis=0)) == len(found.names)


def massless_urdf(rng, kinds, massless):
    """A chain of links, base first; of those that are ``massless`` the URDF has no ``<inertial>``."""
    text = to_urdf(random_vehicle(rng, kinds))
    for name, none in zip(("base", *(f"link_{n + 1}" for n in range(len(kinds)))), massless, strict=True):
        if none:
            text = re.sub(rf'(<link name="{name}">)<inertial>.*?</inertial>', r"\1", text)
    return text


@settings(max_examples=12)
@example((BaseKind.FIXED, ["fixed"], [True, False], True, 6))  # a tool on a wrist: mass in the payload alone
@example((BaseKind.PRESCRIBED, [], [False], False, 6))  # one body
@example((BaseKind.PRESCRIBED, ["fixed"], [True, True], False, 6))  # no body
@given(
    st.lists(st.sampled_from(["revolute", "prismatic", "fixed"]), max_size=3).flatmap(
        lambda kinds: st.tuples(
            st.sampled_from([BaseKind.FIXED, BaseKind.PRESCRIBED]),
            st.just(kinds),
            st.lists(st.booleans(), min_size=len(kinds) + 1, max_size=len(kinds) + 1),
            st.booleans(),
            st.sampled_from([1, 3, 6]),
        )
    )
)
def test_trees_with_massless_links_one_body_or_none(tree):
    """A six-axis cell, or some axes of one, at the last link: the map keeps every row, or nothing moves the rows."""
    kind, kinds, massless, payload, axes = tree
    rng = np.random.default_rng(11)
    last = f"link_{len(kinds)}" if kinds else "base"
    spec = VehicleSpec(kind, "base", last if payload else None)
    vehicle = VehicleModel(massless_urdf(rng, kinds, massless), spec)
    cells = [(axis, measures) for measures in ("force", "moment") for axis in (Z, X, Y)]  # Z: gravity
    rows = [load_cell_row(f"c_{n}", last, *one, bias=False) for n, one in enumerate(cells[:axes])]
    if massless[-1] and not payload:
        with pytest.raises(UrdfError, match="nothing with mass hangs beyond"):
            RowModel(vehicle, rows)
        return
    model = RowModel(vehicle, rows)
    found = base_parameters(model, rng)
    W = sampled_rows(model, np.random.default_rng(5), 20, SampledMotion.of(kind), False)
    chi = rng.normal(size=len(model.names))
    np.testing.assert_allclose(W[:, found.independent] @ found.value(chi), W @ chi, atol=1e-7 * np.abs(W).max() * 10)
    written = groupings(model, found)
    assert len(written.lines) == len(found.names) > 0


def test_names_do_not_depend_on_the_samples():
    model = rocksat()
    one, two = (base_parameters(model, np.random.default_rng(seed)) for seed in (1, 2))
    assert one.names == two.names
    np.testing.assert_allclose(one.grouping, two.grouping, atol=1e-7)


def test_prior_covariance_maps_exactly(rng):
    model = rocksat()
    found = base_parameters(model, rng)
    sigma = rng.uniform(0.1, 1.0, len(model.names))
    draws = model.chi + sigma * rng.normal(size=(20000, len(model.names)))
    sampled = np.cov((draws @ found.grouping.T).T)
    np.testing.assert_allclose(found.covariance(np.diag(sigma)), sampled, atol=0.05 * np.abs(sampled).max())


def test_functionals_of_base_parameters_and_those_that_are_not(rng):
    found = base_parameters(rocksat(), rng)
    names = list(found.standard_names)
    sum_of_two = np.zeros(len(names))
    sum_of_two[names.index("XX_arm")], sum_of_two[names.index("YY_arm")] = 1.0, -1.0
    weights = found.weights(sum_of_two)
    chi = rng.normal(size=len(names))
    assert weights @ found.value(chi) == pytest.approx(sum_of_two @ chi)
    mass = np.zeros(len(names))
    mass[names.index("M_arm")] = 1.0
    with pytest.raises(SignalError, match="cannot determine"):
        found.weights(mass)


def test_the_map_is_sealed(rng):
    found = base_parameters(rocksat(), rng)
    assert isinstance(found, BaseParameters)
    with pytest.raises(ValueError, match="read-only"):
        found.grouping[0, 0] = 2.0


def test_rows_that_nothing_moves_are_an_error(rng):
    links = random_vehicle(rng, ["revolute"])
    links[1] = random_link(rng, "link_1", 0, "revolute")
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(BaseKind.FIXED, "base"))
    rows = RowModel(vehicle, base_force_rows(vehicle)[:1])
    still = SampledMotion(0.0, 0.0, 0.0)
    with pytest.raises(SignalError, match="no parameter"):
        base_parameters(RowModel(vehicle, [load_cell_row("c", "base", X, "force", bias=False)]), Still(), still)
    assert rows.names[0] == "M_base"


class Still:
    """A generator of no motion at all."""

    def uniform(self, low, high, shape):
        return np.zeros(shape)

    def standard_normal(self, shape):
        return np.zeros(shape)


def test_prior_sigmas_by_link_and_by_name():
    model = rocksat()
    links = {"plate": 1.0, "arm": 0.5, "tip_mass": 1.0}
    sigma = named_relative_sigma(model, links, {"bias_load_cell": 2.0, "M_arm": 1e-3})
    assert sigma[model.names.index("bias_load_cell")] == 2.0
    assert sigma[model.names.index("M_arm")] == 1e-3
    assert sigma[model.names.index("M_tip_mass")] == pytest.approx(0.06627)
    with pytest.raises(UnknownFrameError, match="bias_load_cell"):
        named_relative_sigma(model, links, {})
    with pytest.raises(UnknownFrameError):
        named_relative_sigma(model, links, {"bias_load_cell": 2.0, "Fv_elbow": 1.0})
