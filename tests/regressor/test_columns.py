"""Rows, and their response to a specific force from sums of first moments, are Pinocchio's regressor."""

import numpy as np
import pinocchio as pin
import pytest

from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.inertia import moved_to
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.regressor.rows import RowModel, base_force_rows, base_moment_rows, joint_torque_row, load_cell_row
from tests.dynamics.mujoco_twin import random_vehicle, to_urdf
from tests.regressor.test_rows import VEHICLES, random_motion

TEN_DIGITS = 1e-10  # of the largest element


def configuration(vehicle, q):
    """Pinocchio's, (n, nq): cosine and sine of a joint without limits, the base at the origin."""
    out = np.zeros((len(q), vehicle.model.nq))
    out[:, 6] = 1.0
    for column, joint in enumerate(vehicle.joints):
        value = q[:, column]
        out[:, joint.q_index : joint.q_index + joint.q_size] = np.column_stack(
            [np.cos(value), np.sin(value)] if joint.q_size == 2 else [value]
        )
    return out


def body_parameters(vehicle):
    """Map from link parameters to those of the joints' bodies, ``T P T'`` per link, (10 x bodies, 10 x links)."""
    model = vehicle.model
    out = np.zeros((10 * (model.njoints - 1), 10 * len(vehicle.links)))
    for link, name in enumerate(vehicle.links):
        frame = model.frames[vehicle.frame_id(name)]
        first = 10 * (int(frame.parentJoint) - 1)
        out[first : first + 10, 10 * link : 10 * link + 10] = moved_to(frame.placement.homogeneous)
    return out


@pytest.mark.parametrize(("kinds", "parents"), VEHICLES)
def test_they_are_pinocchios(rng, kinds, parents):
    links = random_vehicle(rng, kinds, parents)
    vehicle = VehicleModel(to_urdf(links), VehicleSpec(BaseKind.PRESCRIBED, "base", links[-1].name))
    frame, axis = links[-1].name, rng.normal(size=3)
    torques = [joint_torque_row(vehicle, joint.name, friction=False) for joint in vehicle.joints]
    cell = load_cell_row("cell", frame, axis, "force", bias=False)
    rows = [*base_force_rows(vehicle), *base_moment_rows(vehicle), *torques, cell]
    model = RowModel(vehicle, rows, zero_force=True)
    q, dq, ddq, motion = random_motion(rng, vehicle)
    Y = model.regressor(q, dq, ddq, motion)
    rate, acceleration, force = motion
    state, data, bodies = configuration(vehicle, q), vehicle.model.createData(), body_parameters(vehicle)
    beyond = np.zeros(bodies.shape[1])
    for link in vehicle.distal_links(frame):
        beyond[10 * link : 10 * link + 10] = 1.0
    moved = np.concatenate([np.zeros_like(force), rate, dq], axis=1), np.concatenate([force, acceleration, ddq], axis=1)
    for tick in range(len(q)):
        for pushed, found in ((moved, Y[tick, :, :-3]), *((unit(moved, k), Y[tick, :, k - 3]) for k in range(3))):
            whole = pin.computeJointTorqueRegressor(vehicle.model, data, state[tick], *(v[tick] for v in pushed))
            pin.forwardKinematics(vehicle.model, data, state[tick])
            placed = pin.updateFramePlacement(vehicle.model, data, vehicle.frame_id(frame))
            at_cell = np.append(axis / np.linalg.norm(axis), np.zeros(3)) @ placed.toActionMatrix().T @ whole[:6]
            wanted = np.vstack([whole @ bodies, at_cell @ bodies * beyond])
            order = [*range(6), *(joint.v_index for joint in vehicle.joints), len(wanted) - 1]
            wanted = wanted[order] if pushed is moved else -wanted[order] @ vehicle.chi
            np.testing.assert_allclose(found, wanted, rtol=0.0, atol=TEN_DIGITS * np.abs(wanted).max())


def unit(moved, axis):
    """At rest, the base accelerating along one of its axes."""
    v, a = (np.zeros_like(part) for part in moved)
    a[:, axis] = 1.0
    return v, a
