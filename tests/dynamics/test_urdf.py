"""Identified bodies in a URDF: Pinocchio and MuJoCo read back what was written, and nothing else has changed."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from onboard import config
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import UnknownFrameError
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import standard_of
from onboard.dynamics.model.urdf import with_bodies
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from tests.dynamics.free_flyer_twin import PAYLOAD, URDF

TILTED = np.array([[0.031, 0.002, -0.003], [0.002, 0.027, 0.004], [-0.003, 0.004, 0.019]])
BODIES = {"payload": PAYLOAD, "link_3": RigidBody(0.6180339887498949, np.array([0.01, -0.02, 1 / 3]), TILTED)}


def test_pinocchio_reads_back_the_same_numbers():
    again = VehicleModel(with_bodies(URDF.read_text(), BODIES), VehicleSpec(BaseKind.FREE, "base", "payload"))
    before = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", "payload"))
    for index, link in enumerate(again.links):
        own = slice(10 * index, 10 * index + 10)
        wanted = standard_of(BODIES[link]) if link in BODIES else before.chi[own]
        np.testing.assert_allclose(again.chi[own], wanted, rtol=1e-12, atol=1e-15)


def test_mujoco_reads_back_the_same_numbers():
    spec = mujoco.MjSpec.from_string(with_bodies(URDF.read_text(), BODIES))
    spec.compiler.fusestatic = False
    model = spec.compile()
    for link, body in BODIES.items():
        read = model.body(link)
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, read.iquat)
        R = R.reshape(3, 3)
        assert read.mass[0] == pytest.approx(body.mass_kg, rel=1e-12)
        np.testing.assert_allclose(read.ipos, body.centre_of_mass_m, atol=1e-12)
        np.testing.assert_allclose(R @ np.diag(read.inertia) @ R.T, body.inertia_kg_m2, atol=1e-9)


def test_a_link_written_again_and_nothing_else_touched():
    text = URDF.read_text()
    once = with_bodies(text, BODIES)
    assert with_bodies(once, BODIES) == once
    kept = [line for line in text.splitlines() if line in once.splitlines()]
    assert len(kept) >= len(text.splitlines()) - 6  # the payload's one line and link_3's inertial
    assert "<!-- The unknown payload. -->" in once


@pytest.mark.parametrize("name", ["rocksat", "tudelft", "dymaflex_parabolic"])
def test_packaged_vehicles_stay_models(name):
    vehicle = config.load(config.packaged(name))
    section = vehicle.file.vehicle
    made = with_bodies(vehicle.urdf_path.read_text(), {section.payload_link or section.base_link: PAYLOAD})
    assert pin.buildModelFromXML(made, pin.JointModelFreeFlyer()).nq > 7


def test_odd_but_legal_xml():
    odd = '<robot name="r"><link name="a>b"\n>\n<visual/></link><link name=\'c\' /><!-- <link name="d"/> --></robot>'
    made = with_bodies(odd, {"a>b": PAYLOAD, "c": PAYLOAD})
    assert made.count("<inertial>") == 2
    assert made.count("</link>") == 2
    assert with_bodies(made, {"a>b": PAYLOAD}) == made
    twice = odd.replace("<visual/>", "<inertial/><inertial><mass value='1'/></inertial>")
    assert with_bodies(twice, {"a>b": PAYLOAD}).count("<inertial") == 1
    with pytest.raises(UnknownFrameError, match="no link d; it has a>b, c"):
        with_bodies(odd, {"d": PAYLOAD})
