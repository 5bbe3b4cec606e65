"""What a considered error of the base's IMU is said to do to an estimate is what it does."""

import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.plants.planned import default_plan
from onboard import config
from onboard.dynamics.model.payload import standard_of
from onboard.estimation.gates import GateReason, reasons
from onboard.flight.estimate.problem.identification import build_identifier
from onboard.ground.before.foresee.plan import MotionPlan, plan_of
from onboard.ground.before.foresee.rows import StatedNoise
from onboard.ground.before.init.vehicle import NewVehicle, make
from onboard.identification.rows.identifier import Identifier

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


@pytest.mark.parametrize("axis", [0, 1])
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
