"""From the vehicle file of a body on a spherical air bearing to its estimator."""

from onboard import config
from onboard.config.bases.pivot import Pivot
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.flight.estimate.problem.model import build_model, naming_the_file, samples_per_tick
from onboard.flight.estimate.problem.priors import check_joints, check_thrusters, geometry_prior, imu_prior_of
from onboard.flight.estimate.problem.sigma_keys import key_in
from onboard.flight.estimate.readings.roles import roles_of
from onboard.identification.pivot.fit import BODY, PivotModel
from onboard.identification.pivot.online import PivotRun

_WHEELS = {"scale": "scale_sigma", "delay": "delay_sigma_ms"}


def build_pivot(vehicle: config.Vehicle) -> tuple[PivotRun, VehicleModel]:
    """The estimator of a vehicle on a spherical air bearing, and its model.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices, or a joint moves the centre of mass.
    """
    settings, roles, asked = vehicle.file.estimation, roles_of(vehicle), vehicle.file.pivot or Pivot()
    with naming_the_file(vehicle):
        model = build_model(vehicle)
        check_joints(roles, model)
        check_thrusters(roles)
        if not model.centre_of_mass_is_fixed():
            text = "a joint moves this vehicle's centre of mass; on a pivot it may have balanced wheels only"
            raise SignalError(text)
        priors = imu_prior_of(vehicle), geometry_prior(vehicle, model), (asked.drag_sigma_N_m_s, asked.jets_sigma_N_m)
        sigmas = asked.gyro_per_g_sigma_rad_s, asked.proof_sigma
        period_s, samples = 1.0 / settings.row_rate_hz, samples_per_tick(vehicle)
        predictor = PivotModel(model, roles.imu.frame, period_s, samples, *priors, *sigmas)
    balance = {one.name: (one.mass_kg, one.axis) for one in asked.balance}
    channels = {joint.joint: joint.channel for joint in roles.joints}
    keys = [""] * BODY + [_key_of(name, channels) for name in predictor.names[BODY:]]
    return PivotRun(predictor, vehicle.file.vehicle.base_link, balance, keys), model


def _key_of(unknown: str, channels: dict[str, str]) -> str:
    """The key of the vehicle file that states an unknown's sigma."""
    kind, _, rest = unknown.partition("_")
    if rest in channels and kind in _WHEELS:
        return f"{channels[rest]} {_WHEELS[kind]}"
    if key := key_in("pivot", Pivot, "gyro_per_g" if unknown.startswith("gyro_per_g") else unknown):
        return key
    own = unknown[:-2] if unknown.endswith(("_x", "_y", "_z")) else unknown
    return f"imu_prior.{'position_m' if own == 'place' else own}"
