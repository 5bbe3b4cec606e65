"""Errors of instruments that rows consider (:mod:`onboard.identification.rows.stated_errors.considered`)."""

from collections.abc import Iterator, Sequence
from itertools import count

from onboard import config
from onboard.devices.roles import ImuRole, LoadCellKeys, LoadCellRole, Roles, TorqueKeys
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.identification.rows.stated_errors.considered import Considered, Effect
from onboard.identification.rows.stated_errors.stated import Stated
from onboard.regressor.base_parameters import BaseParameters
from onboard.regressor.rows import RowModel

_OF_SENSORS: tuple[tuple[str, str, Effect, Effect, Effect], ...] = (
    ("gyro", "gyro", "gyro_scale", "gyro_misalignment", "gyro_delay"),
    ("accel", "accelerometer", "accelerometer_scale", "accelerometer_misalignment", "accelerometer_delay"),
)
_WARMER = 0.005  # of all torques with the payload: magnets lose 0.1 % a kelvin (NdFeB), of five between two recordings
_WARMED = 0.2  # of a joint's friction: Fv of a UR3 falls by it on average as it warms (Raviola et al., Robotics 10, 83)
COMMON_SHARE = 0.5  # of the variance of each gain, of which no data sheet gives it: see :func:`of_gains`


def of_motion(roles: Roles, model: VehicleModel) -> list[Considered]:
    """Errors of the sensors of motion, where the file states how well they are known.

    Args:
        roles: of the devices.
        model: whose joints these measure; functions of cyclic errors are in its order.
    """
    found, sensors, functions = list[Considered](), {joint.joint: joint for joint in roles.joints}, count()
    for joint in (sensors[one.name] for one in model.joints):
        name, at = joint.channel, joint.joint
        found.append(Considered(f"scale of {name}", at, "joint_scale", joint.scale_sigma, f"{name} scale_sigma"))
        found.append(Considered(f"zero of {name}", at, "joint_zero", joint.zero_sigma_rad, f"{name} zero_sigma_rad"))
        found.append(Considered(f"delay of {name}", at, "joint_delay", joint.delay_sigma_s, f"{name} delay_sigma_ms"))
        cyclic = f"cyclic error of {name}"
        for periods, rms in roles.signals[name].ripple:
            for _ in ("cosine", "sine"):
                found.append(Considered(cyclic, at, "joint_cyclic", rms, axis=next(functions), periods=periods))
    for imu in roles.imus[:1]:
        found += _of_imu(imu)
    found = [cause for cause in found if cause.sigma > 0.0]
    for imu in roles.imus[: model.spec.base.falls]:  # without a sigma: no error, but part of another order of the axes
        what = f"angle of two axes of {imu.channels[0]}'s accelerometer"
        found += [Considered(what, imu.frame, "accelerometer_cross_axis", 0.0, axis=axis) for axis in range(3)]
    return found


def _of_imu(imu: ImuRole) -> Iterator[Considered]:
    channel, turn = imu.channels[0], imu.misalignment_sigma_rad
    sigmas = imu.gyro_scale_sigma, imu.accel_scale_sigma
    for (short, name, scale, misalignment, delay), sigma in zip(_OF_SENSORS, sigmas, strict=True):
        what, key = f"of {channel}'s {name}", f"{channel} {short}_scale_sigma"
        yield Considered(f"scale {what}", imu.frame, scale, sigma, key)
        yield Considered(f"delay {what}", imu.frame, delay, imu.delay_sigma_s, f"{channel} delay_sigma_ms")
        for axis, letter in enumerate("xyz"):
            turned = f"{channel} misalignment_sigma_rad"
            yield Considered(f"scale {what} along {letter}", imu.frame, scale, sigma, key, axis)
            yield Considered(f"misalignment {what} about {letter}", imu.frame, misalignment, turn, turned, axis)


def of_bias(imu: ImuRole, left: config.ImuPriorKeys, *, accelerometer: bool) -> Iterator[Considered]:
    """What calibration leaves of a gyro's and an accelerometer's bias: the rows take both readings as they are.

    Args:
        imu: of the base.
        left: 1 sigma by axis; an error of which none is stated is not considered.
        accelerometer: its bias too, which is not estimated.
    """
    kinds: tuple[tuple[str, Effect, float, str], ...] = (
        ("gyro", "gyro_bias", left.gyro_bias_rad_s, "gyro_bias_rad_s"),
        ("accelerometer", "accelerometer_bias", left.accelerometer_bias_m_s2, "accelerometer_bias_m_s2"),
    )
    for name, effect, sigma, key in kinds[: 1 + accelerometer]:
        for axis, letter in enumerate("xyz" if sigma else ""):
            what = f"bias of {imu.channels[0]}'s {name} along {letter}"
            yield Considered(what, imu.frame, effect, sigma, f"imu_prior.{key}", axis)


def of_cell(cell: LoadCellRole) -> list[Considered]:
    """Errors of one cell that its rows do not estimate; ``cell``: a load cell or a motor's torque."""
    name, keys = cell.name, cell.keys
    lever = " and lever_sigma_m" if isinstance(keys, LoadCellKeys) and keys.lever_sigma_m else ""
    scale = Considered(f"scale of {name}", name, "scale", keys.relative_sigma, f"{name} scale_sigma{lever}")
    delay = Considered(f"delay of {name}", name, "delay", cell.delay_sigma_s, f"{name} delay_sigma_ms")
    drift_N_s = keys.drift_N_s if isinstance(keys, LoadCellKeys) else 0.0
    drift = Considered(f"drift of {name}'s zero", name, "drift", drift_N_s, f"{name} zero_drift_N_s")
    found = [scale, delay, *([drift] if drift_N_s else [])]
    if isinstance(keys, TorqueKeys) and keys.changed_sigma:  # recorded with the payload, and without
        what, key = f"scale of {name} with the payload", f"{name} between_recordings_sigma"
        found.append(Considered(what, name, "held_scale", keys.changed_sigma, key))
    return found


def of_gains(found: Sequence[Considered], roles: Roles, *, recorded: bool) -> list[Considered]:
    """The same with half of the variance of the torques' gains in one factor on all of them.

    Torque constants of an arm come from one source (a data sheet, a gear's efficiency, the magnets' temperature), so
    their errors are partly common: as no data sheet gives the share, half of the variance is taken as common. Of
    different gains the smallest is the one that all can share.

    Args:
        found: errors of all cells.
        roles: of the devices.
        recorded: with the payload at another time than without.
    """
    scales = [cause for cause in found if cause.effect == "scale" and cause.sigma > 0.0]
    by_torque = all(isinstance(cell.keys, TorqueKeys) for cell in roles.cells)
    if len(scales) < max(2, len(roles.cells)) or not by_torque:
        return list(found)
    common = min(cause.sigma for cause in scales) * COMMON_SHARE**0.5
    own = [cause._replace(sigma=(cause.sigma**2 - common**2) ** 0.5) if cause in scales else cause for cause in found]
    own.append(Considered("scale of all torques", "", "scale", common, "scale_sigma of all torques"))
    what, key = "scale of all torques with the payload", "between_recordings_sigma of all torques"
    return [*own, Considered(what, "", "held_scale", _WARMER, key)] if recorded else own


def of_friction(base: BaseParameters) -> Iterator[Considered]:
    """What each joint's friction is in the recording with the payload beside that without, by temperature and load."""
    for number, name in enumerate(base.names):
        if name.startswith(("Fv_", "Fc_")):
            key = f"{name} between recordings"
            yield Considered(f"{name} with the payload", "", "held_friction", _WARMED, key, number)


def stated_by(prior: config.Prior, model: RowModel) -> list[Stated]:
    """Which key states the sigma of each standard parameter; all links but the payload's are drawn alike."""
    payload, found = str(model.vehicle.spec.payload_link), list[Stated]()
    for column, name in enumerate(model.names):
        link = model.vehicle.links[column // 10] if column < 10 * len(model.vehicle.links) else ""
        if name in model.zero_force:
            found.append(Stated("level_sigma_rad", "level"))
        elif name in prior.absolute or not link:
            found.append(Stated(f"prior.absolute.{name}", payload if link == payload else name.split("_")[0]))
        else:
            table = "link" if link in prior.link else "relative"
            found.append(Stated(f"prior.{table}.{link}", payload if link == payload else f"prior.{table}"))
    return found


def weighs_suspects(vehicle: config.Vehicle, model: RowModel) -> bool:
    """Whether the rows are of an arm on a fixed base, and begin anew.

    Gains and friction of motors change between recordings, which no hypothesis of the bank says: there errors are
    estimated as stated, or what is stated is widened.
    """
    apart = bool(model.motors) and vehicle.is_recorded
    return not (model.vehicle.spec.base.moves or vehicle.file.estimation.carried or apart)
