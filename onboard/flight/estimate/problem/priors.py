"""What the vehicle file states before a flight: links, instruments, joints, payload; for predictions and for rows.

And checks of it against the URDF, which every estimator makes.
"""

from collections.abc import Mapping
from math import hypot

import numpy as np

from onboard import config
from onboard.config.methods import OF_A_FREE_BASE
from onboard.devices.roles import Roles, TorqueKeys
from onboard.dynamics.model.errors import ModelError, UrdfError
from onboard.dynamics.model.payload import standard_covariance
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.readings.roles import roles_of
from onboard.identification.free_flyer.prediction.further import DisturbancePrior, Further, FurtherPose, PosePrior
from onboard.identification.free_flyer.prediction.imu_errors import ImuPrior
from onboard.identification.free_flyer.prediction.parameters import GeometryPrior, JointPrior, SpringPrior
from onboard.identification.rows.checks.gravity import LOCAL_GRAVITY
from onboard.regressor.prior import LinkSigmas, prior_root
from onboard.regressor.rows import RowModel

# Of a silent file: air, umbilicals and valves of bench flights, 0.01 N on the 26 kg of DYMAFLEX.
UNTOLD_m_s2 = 4e-4
# Of a free body's IMU: as heft init writes them for a free base. A consumer's chip over its temperatures, once zeroed:
# the data sheet of the BMI088 has 0.2 mg/K and 0.015 deg/s/K, 50 and 33 K of which these are.
UNTOLD_BIAS_m_s2, UNTOLD_BIAS_rad_s = 0.1, 8.7e-3
# Of an arm's base: a degree, the general tolerance of angles of short sides (ISO 2768-1, class m).
UNTOLD_LEVEL_rad = 0.0175


def free_flyer_prior(
    vehicle: config.Vehicle, model: VehicleModel
) -> tuple[dict[str, FloatArray], ImuPrior, FloatArray]:
    """What is known before a flight: covariances of links, prior on instrument errors, sigmas of a payload (10,).

    Raises:
        UrdfError: a link that the URDF does not have, or has no inertia.
    """
    settings = vehicle.file.estimation
    covariance = {}
    for link, sigma in settings.prior.link.items():
        if link not in model.links:
            raise UrdfError(f"prior.link names {link!r}; links with inertia are {', '.join(model.links)}")
        own = 10 * model.links.index(link)
        known = sigma.mass_relative, sigma.centre_m, sigma.inertia_relative
        covariance[link] = standard_covariance(model.chi[own : own + 10], *known)
    asked = settings.exiddm
    first_moment, inertia = asked.payload_first_moment_sigma_kg_m, asked.payload_inertia_sigma_kg_m2
    payload_sigma = np.array([asked.payload_mass_sigma_kg, *[first_moment] * 3, *[inertia] * 6])
    return covariance, imu_prior_of(vehicle), payload_sigma


def row_prior(
    stated: config.Prior, model: RowModel, further: Mapping[str, float], level: FloatArray | None = None
) -> FloatArray:
    """Root of the prior covariance of the standard parameters of rows, (P, P).

    Args:
        stated: the section of the file.
        model: of the rows.
        further: sigmas by column, besides those of the section.
        level: root of the covariance of the last three, (3, 3), where their sigmas are not those (:func:`level_root`).

    Raises:
        ModelError: a sigma that is missing, stated twice, or of no link or column.
    """
    made = {name: LinkSigmas(*own.model_dump().values()) for name, own in stated.link.items()}
    try:
        root = prior_root(model, stated.relative, {**stated.absolute, **further}, made)
    except ModelError as error:
        raise ModelError(f"[estimation.prior]: {error}") from error
    if level is not None:
        root[-3:, -3:] = level
    return root


def imu_prior_of(vehicle: config.Vehicle) -> ImuPrior:
    """The prior on errors of an IMU, as the vehicle file states it."""
    keys = vehicle.file.estimation.imu_prior
    prior = ImuPrior(**keys.model_dump(exclude={"position_m", "gyro_cross_axis", "accelerometer_cross_axis"}))
    return prior.with_cross_axis(*keys.cross_axis)


def biases(vehicle: config.Vehicle) -> tuple[float | None, float]:
    """What rows take for the IMU's biases, 1 sigma by axis: of the accelerometer's, where it is estimated; the gyro's.

    Of a free body, silent keys are what a calibration leaves: nobody's IMU is without a bias, and the rows tell a
    turning accelerometer's. That is estimated there, whichever key states it; 0 states that it is exact.
    """
    settings, keys = vehicle.file.estimation, vehicle.file.estimation.imu_prior
    estimated, gyro = settings.zero_force_sigma_m_s2, keys.gyro_bias_rad_s
    if vehicle.file.free_body is None:
        return estimated, gyro
    if "gyro_bias_rad_s" not in keys.model_fields_set:
        gyro = UNTOLD_BIAS_rad_s
    if estimated is None:
        silent = "accelerometer_bias_m_s2" not in keys.model_fields_set
        estimated = UNTOLD_BIAS_m_s2 if silent else keys.accelerometer_bias_m_s2 or None
    return estimated, gyro


def level_root(vehicle: config.Vehicle, roles: Roles) -> FloatArray | None:
    """Root of the covariance of a specific force that nothing measures, (3, 3) m/s^2, of an arm by its joints' torques.

    A base that leans turns gravity, of the payload too; its magnitude is that of the place. None where a cell or an
    IMU takes part, and where the base is stated to be level.
    """
    keys, stated = vehicle.file.vehicle, vehicle.file.estimation.level_sigma_rad
    sigma_rad = UNTOLD_LEVEL_rad if stated is None else stated
    by_torque = bool(roles.cells) and all(isinstance(cell.keys, TorqueKeys) for cell in roles.cells)
    if not (by_torque and sigma_rad) or roles.imus or keys.base_kind.moves:
        return None
    g = np.array(keys.gravity_m_s2)
    along = np.outer(g, g) / (g @ g) if g.any() else np.zeros((3, 3))
    return np.asarray(np.linalg.norm(g) * (sigma_rad * (np.eye(3) - along) + LOCAL_GRAVITY * along), np.float64)


def disturbance_prior(vehicle: config.Vehicle, model: VehicleModel, *, tracked: bool = False) -> DisturbancePrior:
    """Prior on what pushes the base unknown; none between hands and with a tracker, which does not predict it.

    A silent key: a force in proportion to the vehicle's mass without payload, a torque of it at the radius of
    gyration of its heaviest link.
    """
    keys = vehicle.file.estimation.disturbance
    if tracked or vehicle.file.parabola is not None:
        return DisturbancePrior()
    masses = model.chi[::10]
    heaviest = model.chi[10 * int(masses.argmax()) :]
    radius_m = float(np.sqrt((heaviest[4] + heaviest[6] + heaviest[9]) / 2.0 / heaviest[0]))
    force = UNTOLD_m_s2 * float(masses.sum()) if keys.force_N is None else keys.force_N
    return DisturbancePrior(force, force * radius_m if keys.torque_N_m is None else keys.torque_N_m, keys.time_s)


def geometry_prior(vehicle: config.Vehicle, model: VehicleModel) -> GeometryPrior:
    """Prior on places of IMU and joints, and on the encoders' errors; silent joints have the defaults of the keys.

    A silent joint of which the rate is measured is a rotor with the scale and the delay of its device.

    Cyclic errors are those that the encoders' devices state; what a device states of its delay adds to the joint's.

    Raises:
        UnknownFrameError: a joint that the URDF does not have.
        UrdfError: a stiffness of a joint that does not turn, or carries nothing.
    """
    stated, roles = vehicle.file.estimation.prior.joint, roles_of(vehicle)
    ripple = {joint.joint: roles.signals[joint.channel].ripple for joint in roles.joints}
    rotors = {joint.joint: joint for joint in roles.joints if joint.is_rate}
    late_s = {joint.joint: joint.delay_sigma_s for joint in roles.joints}
    joints = {}
    for name in dict.fromkeys([*(joint.name for joint in model.joints), *stated]):
        if name in rotors and name not in stated:  # a body of revolution: place and angle have no effect
            rotor = rotors[name]
            joints[name] = JointPrior(0.0, 0.0, rotor.scale_sigma, rotor.delay_sigma_s, ())
            continue
        own = stated.get(name, config.JointKeys())
        cyclic = ripple.get(name, ())
        delay_s = hypot(own.delay_s, late_s.get(name, 0.0))
        joints[name] = JointPrior(own.position_m, own.zero_rad, own.scale, delay_s, cyclic, _spring(model, name, own))
    return GeometryPrior(vehicle.file.estimation.imu_prior.position_m, joints)


def _spring(model: VehicleModel, name: str, keys: config.JointKeys) -> SpringPrior | None:
    if keys.stiffness_N_m_rad is None:
        return None
    if not model.joint(name).revolute:
        raise UrdfError(f"prior.joint.{name}.stiffness_N_m_rad: the joint slides; only a joint that turns has a spring")
    if not model.distal_links(name):
        raise UrdfError(f"prior.joint.{name}.stiffness_N_m_rad: no link with inertia lies beyond the joint")
    known = keys.stiffness_relative, keys.damping_N_m_s_rad, keys.damping_relative
    return SpringPrior(keys.stiffness_N_m_rad, *known)


def tracker_of(roles: Roles) -> list[Further]:
    """The pose tracker, if there is one; thrusters push the centre of mass, which it does not predict."""
    if roles.thrusters:
        return []
    return [
        FurtherPose(
            one.channel,
            one.frame,
            PosePrior(one.acceleration_m_s2, one.misalignment_rad, one.place_m, one.scale, one.delay_s),
        )
        for one in roles.trackers[:1]
    ]


def check_springs(vehicle: config.Vehicle, why: str) -> None:
    """Check that no joint has a stiffness, for estimators without flexible joints.

    Raises:
        UrdfError: one is.
    """
    flexible = [name for name, own in vehicle.file.estimation.prior.joint.items() if own.stiffness_N_m_rad is not None]
    if flexible:
        text = f"prior.joint.{flexible[0]}.stiffness_N_m_rad: flexible joints are known to {OF_A_FREE_BASE} alone"
        raise UrdfError(f"{text}, {why}; take it out")


def check_joints(roles: Roles, model: VehicleModel) -> None:
    """Check that every joint that moves is measured by one device, and that every such device names a joint.

    Raises:
        UrdfError: it is not so.
    """
    measured = [joint.joint for joint in roles.joints]
    moving = [joint.name for joint in model.joints]
    if sorted(measured) != sorted(moving):
        listed, named = ", ".join(moving) or "none", ", ".join(measured) or "none"
        raise UrdfError(f"the URDF's moving joints are {listed}, the devices measure {named}; name each joint once")


def check_thrusters(roles: Roles) -> None:
    """Check that there are no thrusters, of an estimator that does not know their forces.

    Raises:
        UrdfError: there are some.
    """
    if roles.thrusters:
        named = ", ".join(thruster.name for thruster in roles.thrusters)
        text = f"the forces of {named} are known to {OF_A_FREE_BASE} alone"
        raise UrdfError(f"{text}; use it, or record them by the kind canopen_object")
