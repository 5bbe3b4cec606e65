"""Points of the vehicle to draw: every URDF frame where Pinocchio's own forward kinematics puts it."""

import numpy as np
import pinocchio as pin

from onboard import config
from onboard.dynamics.model.skeleton import skeleton
from onboard.flight.estimate.problem.identification import build_online


def test_points_are_where_the_frames_are(rng: np.random.Generator) -> None:
    _, model = build_online(config.load(config.packaged("dymaflex")))
    assert model is not None
    q = rng.uniform(-1.0, 1.0, (3, len(model.joints)))
    found = skeleton(model, q)
    assert found.p_m.shape == (3, len(found.names), 3)
    assert {joint.name for joint in model.joints} <= set(found.names)
    full, data = pin.neutral(model.model), model.model.createData()
    for tick in range(3):
        for joint, value in zip(model.joints, q[tick], strict=True):
            full[joint.q_index : joint.q_index + joint.q_size] = (
                value if joint.q_size == 1 else (np.cos(value), np.sin(value))
            )
        pin.framesForwardKinematics(model.model, data, full)
        for name, place in zip(found.names, found.p_m[tick], strict=True):
            if name:
                expected = data.oMf[model.frame_id(name)].translation
                assert np.allclose(place, expected, atol=1e-9), name
    ends = {end for line in found.lines for end in line}
    assert ends == set(range(len(found.names)))  # nothing hangs in the air
    assert sum(found.moving) >= len(model.joints)
