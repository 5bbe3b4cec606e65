"""From the vehicle file of a body on a spherical air bearing to its estimator."""

from onboard import config
from onboard.config.bases.pivot import Pivot
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.flight.estimate.problem.priors import geometry_prior, imu_prior_of
from onboard.flight.estimate.readings.roles import roles_of
from onboard.identification.pivot.fit import BODY, PivotModel
from onboard.identification.pivot.online import PivotRun

_OWN = {"proof": "pivot.proof_sigma", "drag": "pivot.drag_sigma_N_m_s", "jets": "pivot.jets_sigma_N_m"}
_WHEELS = {"scale": "scale_sigma", "delay": "delay_sigma_ms"}


def pivot_run(vehicle: config.Vehicle, model: VehicleModel, samples: int) -> PivotRun:
    """The estimator.

    Args:
        vehicle: its file.
        model: under it.
        samples: of the IMU in a tick.

    Raises:
        ModelError: a joint that moves the centre of mass, or a name that the URDF does not have.
    """
    if not model.centre_of_mass_is_fixed():
        raise SignalError("a joint moves this vehicle's centre of mass; on a pivot it may have balanced wheels only")
    settings, roles, asked = vehicle.file.estimation, roles_of(vehicle), vehicle.file.pivot or Pivot()
    priors = imu_prior_of(vehicle), geometry_prior(vehicle, model), (asked.drag_sigma_N_m_s, asked.jets_sigma_N_m)
    sigmas = asked.gyro_per_g_sigma_rad_s, asked.proof_sigma
    predictor = PivotModel(model, roles.imu.frame, 1.0 / settings.row_rate_hz, samples, *priors, *sigmas)
    balance = {one.name: (one.mass_kg, one.axis) for one in asked.balance}
    channels = {joint.joint: joint.channel for joint in roles.joints}
    keys = [""] * BODY + [_key_of(name, channels) for name in predictor.names[BODY:]]
    return PivotRun(predictor, vehicle.file.vehicle.base_link, balance, keys)


def _key_of(unknown: str, channels: dict[str, str]) -> str:
    """The key of the vehicle file that states an unknown's sigma."""
    kind, _, rest = unknown.partition("_")
    if rest in channels and kind in _WHEELS:
        return f"{channels[rest]} {_WHEELS[kind]}"
    if unknown in _OWN:
        return _OWN[unknown]
    if unknown.startswith("gyro_per_g"):
        return "pivot.gyro_per_g_sigma_rad_s"
    own = unknown[:-2] if unknown.endswith(("_x", "_y", "_z")) else unknown
    return f"imu_prior.{'position_m' if own == 'place' else own}"
