"""URDF reading: links kept apart, joints by name, what hangs beyond a frame, errors with names and remedies."""

from typing import get_args

import numpy as np
import pytest

from onboard.config.vehicle import VehicleSection
from onboard.dynamics.model.bases import BASES, BaseKind
from onboard.dynamics.model.errors import ModelError, UnknownFrameError, UrdfError
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from tests.dynamics.mujoco_twin import random_vehicle, to_urdf

INERTIAL = '<inertial><mass value="2"/><inertia ixx="1" iyy="2" izz="2.5" ixy="0.1" ixz="0.2" iyz="0.3"/></inertial>'


def urdf(arm_joint="revolute", base=INERTIAL, tip=""):
    return (
        f'<robot name="r"><link name="base">{base}</link><link name="arm">{INERTIAL}</link>'
        f'<link name="tip">{tip}</link>'
        f'<joint name="j" type="{arm_joint}"><parent link="base"/><child link="arm"/><axis xyz="0 0 2"/>'
        '<limit lower="-1" upper="0.5" effort="1" velocity="1"/></joint>'
        '<joint name="mount" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0.1 0 0"/></joint>'
        "</robot>"
    )


def test_standard_parameters_are_about_the_link_frame():
    """Parallel axes and rotation by hand: 2 kg at (0, 0, 0.5), inertial axes turned 90 degrees about z."""
    inertial = INERTIAL.replace("<inertial>", '<inertial><origin xyz="0 0 0.5" rpy="0 0 1.5707963267948966"/>')
    vehicle = VehicleModel(urdf(base=inertial), VehicleSpec(BaseKind.FREE, "base"))
    # turned: x' = y, y' = -x, so xx = 2, yy = 1, xy = -0.1, xz = -0.3, yz = 0.2; then 2 kg 0.25 m^2 on xx and yy
    np.testing.assert_allclose(vehicle.chi[:10], [2, 0, 0, 1, 2.5, -0.1, 1.5, -0.3, 0.2, 2.5], atol=1e-12)
    with pytest.raises(ValueError, match="read-only"):
        vehicle.chi[0] = 1.0


def test_links_joints_and_what_hangs_beyond():
    vehicle = VehicleModel(urdf(tip=INERTIAL), VehicleSpec(BaseKind.FREE, "base", "tip"))
    assert vehicle.links == ("base", "arm", "tip")
    assert [joint.name for joint in vehicle.joints] == ["j"]
    joint = vehicle.joint("j")
    assert joint.axis == (0.0, 0.0, 1.0)
    assert (joint.low, joint.high) == (-1.0, 0.5)
    assert joint.revolute
    assert vehicle.distal_links("base") == (0, 1, 2)
    assert vehicle.distal_links("j") == vehicle.distal_links("arm") == (1, 2)
    assert vehicle.distal_links("mount") == vehicle.distal_links("tip") == (2,)
    assert vehicle.payload_columns() == slice(20, 30)
    assert not vehicle.centre_of_mass_is_fixed()


def test_a_payload_of_which_nothing_is_known_still_has_columns():
    vehicle = VehicleModel(urdf(), VehicleSpec(BaseKind.FREE, "base", "tip"))
    assert vehicle.links == ("base", "arm", "tip")
    assert not vehicle.chi[20:].any()
    without = VehicleModel(urdf(), VehicleSpec(BaseKind.FREE, "base"))
    assert without.links == ("base", "arm")
    assert without.payload_columns() == slice(0, 0)


def test_a_link_of_a_millionth_of_the_mass_is_a_frame_and_an_inertia_needs_a_mass():
    light = INERTIAL.replace('value="2"', 'value="3e-6"').replace(
        'ixx="1" iyy="2" izz="2.5"', 'ixx="0" iyy="0" izz="0"'
    )
    light = light.replace('ixy="0.1" ixz="0.2" iyz="0.3"', 'ixy="0" ixz="0" iyz="0"')
    assert VehicleModel(urdf(tip=light), VehicleSpec(BaseKind.FREE, "base")).links == ("base", "arm")
    heavier = light.replace("3e-6", "1e-5")
    assert VehicleModel(urdf(tip=heavier), VehicleSpec(BaseKind.FREE, "base")).links == ("base", "arm", "tip")
    with pytest.raises(UrdfError, match="'tip' has an inertia and no mass"):
        VehicleModel(urdf(tip=INERTIAL.replace('value="2"', 'value="0"')), VehicleSpec(BaseKind.FREE, "base"))


def test_a_base_that_floats_needs_a_mass_and_others_do_not():
    assert VehicleModel(urdf(base=""), VehicleSpec(BaseKind.FIXED, "base")).links == ("arm",)
    for kind in (BaseKind.FREE, BaseKind.PLANAR):
        with pytest.raises(UrdfError, match="the base, link 'base' with what is fixed to it, weighs nothing"):
            VehicleModel(urdf(base=""), VehicleSpec(kind, "base"))


def test_a_joint_and_a_link_may_share_a_name():
    text = (
        urdf(tip=INERTIAL)
        .replace('joint name="mount"', 'joint name="tip"')
        .replace('joint name="j"', 'joint name="arm"')
    )
    vehicle = VehicleModel(text, VehicleSpec(BaseKind.FREE, "base"))
    assert vehicle.distal_links("arm") == (1, 2)
    assert vehicle.distal_links("tip") == (2,)


def test_continuous_joints_have_no_limits():
    joint = VehicleModel(urdf("continuous"), VehicleSpec(BaseKind.FREE, "base")).joint("j")
    assert (joint.q_size, joint.low, joint.high) == (2, -np.inf, np.inf)


def test_parameter_sigma_has_a_size_even_where_the_drawing_says_zero():
    vehicle = VehicleModel(urdf(), VehicleSpec(BaseKind.FREE, "base", "tip"))
    sigma = vehicle.parameter_sigma({"base": 0.1, "arm": 1.0, "tip": 0.5})
    k = np.sqrt(2.75 / 2.0)  # half the trace over the mass
    np.testing.assert_allclose(sigma[:10], 0.1 * np.array([2, *[2 * k] * 3, *[2.75] * 6]))
    np.testing.assert_allclose(sigma[10:20], 10 * sigma[:10])
    assert not sigma[20:].any()
    with pytest.raises(UnknownFrameError, match="none is given of arm, tip: give each"):
        vehicle.parameter_sigma({"base": 1.0})
    with pytest.raises(UnknownFrameError, match="hand is none of base, arm, tip"):
        vehicle.parameter_sigma({"base": 1.0, "arm": 1.0, "tip": 1.0, "hand": 1.0})


def test_rocksat_is_what_the_tables_say():
    """Tables 4.5 and 4.6 of the dissertation, typed here: mm, g, g mm^2."""
    from onboard.config import packaged  # noqa: PLC0415

    text = packaged("rocksat").with_name("rocksat.urdf").read_text()
    vehicle = VehicleModel(text, VehicleSpec(BaseKind.PRESCRIBED, "plate", "tip_mass"))
    assert vehicle.links == ("plate", "arm", "tip_mass")
    mass, com = (
        np.array([10115.47, 233.13, 66.27]),
        np.array([[-0.07, -7.17, 24.39], [39.75, 1.41, 5.0], [0, -13.91, 0]]),
    )
    tensors = np.array(
        [
            [6.33e7, 7.56e6, 6.48e7, 80846.12, -2.52e5, 1.09e8],  # XX XY YY XZ YZ ZZ
            [52080.30, 7130.97, 6.99e5, -38230.98, 1744.05, 7.33e5],
            [5978.90, 0, 4389.61, 0, 0, 5978.90],
        ]
    )
    for link in range(3):
        chi = vehicle.chi[10 * link : 10 * link + 10] * [1e3, *[1e6] * 3, *[1e9] * 6]
        x, y, z = com[link]
        steiner = mass[link] * np.array([y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y])
        np.testing.assert_allclose(chi[0], mass[link], rtol=1e-12)
        np.testing.assert_allclose(chi[1:4], mass[link] * com[link], atol=1e-6)
        np.testing.assert_allclose(chi[4:], tensors[link] + steiner, rtol=1e-9, atol=1e-3)
    # the joint: -55.4 deg, 116.1 mm, 101 mm; the tip: 155.7 + 16.4 mm further; the IMU's y is the plate's z
    data = vehicle.model.createData()
    import pinocchio as pin  # noqa: PLC0415

    pin.framesForwardKinematics(vehicle.model, data, pin.neutral(vehicle.model))
    angle = np.radians(-55.4)
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    joint, tip = (data.oMf[vehicle.frame_id(name)] for name in ("joint_1", "tip_mass"))
    np.testing.assert_allclose(joint.translation, 0.1161 * along + [0, 0, 0.101], atol=1e-12)
    np.testing.assert_allclose(tip.translation, (0.1161 + 0.1721) * along + [0, 0, 0.101], atol=1e-12)
    np.testing.assert_allclose(joint.rotation[:, 2], [0, 0, 1], atol=1e-12)
    R, p = vehicle.pose_in_base("imu_base")
    np.testing.assert_allclose(R, [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(p, [0.080, -0.040, 0.020], atol=1e-12)
    assert vehicle.joint("joint_1").high == pytest.approx(np.radians(15))


@pytest.mark.parametrize(
    ("text", "spec", "error", "says"),
    [
        ("<robot", ("base",), UrdfError, "no XML"),
        (
            "<robot name='r'><link name='a'/><link name='b'/></robot>",
            ("a",),
            UrdfError,
            "it hangs on a, b; a vehicle has a single root",
        ),
        (urdf(), ("arm",), UrdfError, "the root is base"),
        (urdf(), ("nothing",), UrdfError, "the root is base"),
        (urdf(), ("base", "hand"), UnknownFrameError, "payload_link 'hand'"),
        (urdf("planar"), ("base",), UrdfError, "is 'planar'; fixed, revolute"),
        (urdf(base='<inertial><mass value="2"/></inertial>'), ("base",), UrdfError, "needs"),
        (
            urdf(base=INERTIAL.replace('mass value="2"', 'mass value="-2"')),
            ("base",),
            UrdfError,
            "a mass is zero or more",
        ),
        (urdf(base=INERTIAL.replace('iyy="2"', 'iyy="-2"')), ("base",), UrdfError, "'base' has the principal moments"),
    ],
)
def test_unusable_urdfs_are_named(text, spec, error, says):
    with pytest.raises(error, match=says) as raised:
        VehicleModel(text, VehicleSpec(BaseKind.FREE, *spec))
    assert isinstance(raised.value, ModelError)


def test_unknown_names(rng):
    vehicle = VehicleModel(to_urdf(random_vehicle(rng, ["revolute"])), VehicleSpec(BaseKind.FREE, "base"))
    with pytest.raises(UnknownFrameError, match="joint_link_1"):
        vehicle.joint("elbow")
    with pytest.raises(UnknownFrameError, match="link_1"):
        vehicle.frame_id("hand")


def test_a_kind_of_base_is_a_record_in_one_place():
    """The names of vehicle.toml are those of the kinds; what floats follows from the arm, by its masses."""
    section = VehicleSection.model_fields["base"].annotation
    assert set(get_args(section)) == set(BASES)
    assert all(kind.follows or not kind.floats for kind in BASES.values())
    assert [kind for kind in BASES.values() if kind.floats and len(kind.moves) == 6] == [BaseKind.FREE]
