"""From vehicle.toml to an :class:`Identifier`: which rows, which prior, what is considered, what is reported."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pkgutil import resolve_name

import numpy as np

from onboard import config
from onboard.devices.roles import LoadCellRole, Roles, TorqueKeys
from onboard.dynamics.model.errors import UrdfError
from onboard.dynamics.model.vehicle import STANDARD, VehicleModel
from onboard.estimation.smoothing import Response
from onboard.flight.estimate.problem.considered import (
    of_bias,
    of_cell,
    of_friction,
    of_gains,
    of_motion,
    stated_by,
    weighs_suspects,
)
from onboard.flight.estimate.problem.model import build_model, naming_the_file, samples_in_tick, samples_per_tick
from onboard.flight.estimate.problem.priors import (
    biases,
    check_joints,
    check_springs,
    check_thrusters,
    disturbance_prior,
    free_flyer_prior,
    geometry_prior,
    level_root,
    row_prior,
    tracker_of,
)
from onboard.flight.estimate.problem.sigma_keys import SigmaKeys
from onboard.flight.estimate.readings.roles import roles_of
from onboard.flight.estimate.readings.signals import kernel_of
from onboard.flight.estimate.readings.torques import torque_cell
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.free_flyer.prediction.further import (
    CellPrior,
    Further,
    FurtherCell,
    FurtherImu,
    FurtherPose,
    Thruster,
)
from onboard.identification.free_flyer.prediction.imu_errors import ImuPrior
from onboard.identification.free_flyer.prediction.imu_prediction import ImuPredictor
from onboard.identification.free_flyer.prediction.parameters import require_stiff
from onboard.identification.free_flyer.recursion.recursive import MotionFilter
from onboard.identification.online import OnlineIdentifier
from onboard.identification.quantities import DrawingTolerance, Quantity, mass_quantities
from onboard.identification.rows.checks.suspected import of_no_key
from onboard.identification.rows.checks.suspects import RowSuspects
from onboard.identification.rows.free_body import free_body_quantities
from onboard.identification.rows.hypotheses import Hypotheses
from onboard.identification.rows.identifier import Identifier
from onboard.identification.rows.stated_errors.considered import Considered, Start
from onboard.identification.rows.stated_errors.whitening import Whitening
from onboard.identification.table.run import TableRun
from onboard.regressor.base_parameters import base_parameters
from onboard.regressor.friction import Motor
from onboard.regressor.rows import (
    RowModel,
    WrenchRow,
    base_force_rows,
    base_moment_rows,
    joint_torque_row,
    load_cell_row,
)

Builder = Callable[[config.Vehicle], tuple[OnlineIdentifier, VehicleModel]]
_ROOM = "onboard.flight.estimate.problem"
BUILDERS: Mapping[config.Prediction, str] = {  # by name: a vehicle has one
    config.Prediction.ROWS: f"{_ROOM}.identification:build_identifier",
    config.Prediction.FREE: f"{_ROOM}.identification:build_free_flyer",
    config.Prediction.PARABOLAS: f"{_ROOM}.identification:build_parabolas",
    config.Prediction.PLANAR: f"{_ROOM}.table:build_table",
    config.Prediction.PIVOT: f"{_ROOM}.pivot:build_pivot",
}
NAMING_SEED = 20190812  # base parameters are found on random motion; their names must not depend on luck
KERNELS_PER_BLOCK = 5
UNMARKED_CLOCK_s, UNMARKED_MEMORY_s = 1e-3, 1.0  # further IMUs may have no sync marks: wander of their time


def build_online(vehicle: config.Vehicle) -> tuple[OnlineIdentifier, VehicleModel]:
    """The onboard estimator of the method that the vehicle file names, and its model.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
    """
    by_name = vehicle.file.estimation.how.builder or BUILDERS.get(vehicle.prediction)
    if by_name is None:
        text = "a body without joints is identified when its run is over: heft identify"
        raise config.ConfigError(f"{vehicle.label}: {text}")
    build: Builder = resolve_name(by_name)
    return build(vehicle)


def build_parabolas(vehicle: config.Vehicle) -> tuple[TableRun, VehicleModel]:
    """What flies between hands, where the momentum changes with every release; and the vehicle's model."""
    online, model = build_free_flyer(vehicle)
    return TableRun(str(model.spec.payload_link), online.further), model


def with_hypotheses(vehicle: config.Vehicle, online: OnlineIdentifier) -> OnlineIdentifier:
    """The identifier, or parallel ones where a redundant cell or a release may be wrong.

    Args:
        vehicle: its file.
        online: a fresh one.
    """
    phases = vehicle.file.estimation.phases
    cells = [(cell.name, cell.keys) for cell in roles_of(vehicle).cells]
    if not isinstance(online, Identifier):
        return online
    place = [
        keys.joint if isinstance(keys, TorqueKeys) else (keys.frame, keys.axis, keys.measures) for _, keys in cells
    ]
    redundant = [name for (name, _), own in zip(cells, place, strict=True) if place.count(own) > 1]
    if not redundant and (phases is None or phases.payload_gone is None):
        return online
    return Hypotheses(lambda: build_identifier(vehicle)[0], redundant)


def build_free_flyer(vehicle: config.Vehicle, *, tracked: bool = True) -> tuple[MotionIdentifier, VehicleModel]:
    """The filter of a free base by its vehicle file, and the model under it.

    Args:
        vehicle: its file.
        tracked: a pose tracker takes part, if there is one.

    Raises:
        ConfigError: the estimation section does not fit the URDF or the devices.
    """
    settings, roles = vehicle.file.estimation, roles_of(vehicle)
    asked, samples = settings.exiddm, samples_per_tick(vehicle)
    with naming_the_file(vehicle):
        model = build_model(vehicle)
        check_joints(roles, model)
        covariance, imu_prior, payload_sigma = free_flyer_prior(vehicle, model)
        period_s, geometry = 1.0 / settings.row_rate_hz, geometry_prior(vehicle, model)
        require_stiff(model, geometry)
        further = further_instruments(vehicle, model, imu_prior)
        trackers = tracker_of(roles) if tracked else []
        if trackers or vehicle.file.parabola is not None:
            check_springs(vehicle, "without a pose tracker and not between hands")
        further += trackers
        priors = covariance, imu_prior, geometry, further
        thrusters = [Thruster.of(model, t.name, t.frame, t.axis, t.scale_sigma) for t in roles.thrusters]
        others = roles.imu.channels[0], thrusters, disturbance_prior(vehicle, model, tracked=bool(trackers))
        keys = SigmaKeys(further, thrusters, [joint.name for joint in model.joints])
        predictor = ImuPredictor(model, roles.imu.frame, period_s, samples, *priors, *others, keys.of)
        names = tuple(f"{kind}_{model.spec.payload_link}" for kind in STANDARD)
        known = _start(vehicle, names)[:2] if settings.carried else None
        step_ticks = max(1, round(1e-3 * settings.step_ms * settings.row_rate_hz))
        told = asked.held_at_start, asked.false_alarms_per_hour, known
        ekf = MotionFilter(predictor, payload_sigma, *told, step_ticks)
    return MotionIdentifier(ekf), model


def further_instruments(vehicle: config.Vehicle, model: VehicleModel, imu_prior: ImuPrior) -> list[Further]:
    """What the filter uses besides the first IMU, but what is too slow for its ticks: other IMUs, cells, torques."""
    found, roles = list[Further](), roles_of(vehicle)
    for imu in roles.imus[1:]:
        if (samples := samples_in_tick(vehicle, imu.channels[0])) >= 2:
            prior = imu_prior._replace(delay_s=float(np.hypot(imu_prior.delay_s, UNMARKED_CLOCK_s)))
            place_m = vehicle.file.estimation.imu_prior.position_m
            found.append(FurtherImu(imu.channels[0], imu.frame, samples, prior, place_m, UNMARKED_MEMORY_s))
    for cell in roles.cells:
        keys = cell.keys
        if (samples := samples_in_tick(vehicle, cell.channel)) < 2:
            continue
        if isinstance(keys, TorqueKeys):
            found.append(torque_cell(vehicle, model, cell, keys, samples))
            continue
        bias = 0.01 * keys.capacity_N if keys.zero_sigma_N is None else keys.zero_sigma_N
        prior_of_cell = CellPrior(bias, keys.drift_N_s, keys.relative_sigma, cell.delay_sigma_s)
        projection = load_cell_row(cell.name, keys.frame, keys.axis, keys.measures, keys.lever_m).projection
        found.append(FurtherCell(cell.name, keys.frame, projection, samples, prior_of_cell))
    return found


def channels_of(roles: Roles, further: Sequence[Further]) -> list[tuple[str, ...]]:
    """The channels of each further instrument but trackers, by its name."""
    names = {imu.channels[0]: imu.channels for imu in roles.imus} | {cell.name: (cell.channel,) for cell in roles.cells}
    return [names[one.name] for one in further if not isinstance(one, FurtherPose)]


def build_identifier(vehicle: config.Vehicle) -> tuple[Identifier, VehicleModel]:
    """The identifier of a vehicle file, and the model under it.

    Raises:
        ConfigError: the estimation section does not fit the URDF.
    """
    settings, roles = vehicle.file.estimation, roles_of(vehicle)
    with naming_the_file(vehicle):
        model = build_model(vehicle)
        check_joints(roles, model)
        check_thrusters(roles)
        check_springs(vehicle, "not to rows")
        rows: list[WrenchRow] = []
        considered: list[Considered] = []
        for cell in roles.cells:
            rows.append(_cell_row(cell, model))
            considered += of_cell(cell)
        considered = [*of_gains(considered, roles, recorded=vehicle.is_recorded), *of_motion(roles, model)]
        zero_force, gyro_bias = biases(vehicle)
        if roles.imus:
            left = settings.imu_prior.model_copy(update={"gyro_bias_rad_s": gyro_bias})
            considered += of_bias(roles.imu, left, accelerometer=zero_force is None)
        if "force" in settings.base_rows:
            rows += base_force_rows(model)
        if "moment" in settings.base_rows:
            rows += base_moment_rows(model)
        level = level_root(vehicle, roles) if zero_force is None else None
        row_model = RowModel(model, rows, zero_force is not None or level is not None, _motors(vehicle, roles))
        weighed = weighs_suspects(vehicle, row_model)
        considered += of_no_key(considered, row_model) if weighed else []
        offsets = dict.fromkeys(row_model.zero_force, zero_force or 0.0)
        prior = row_prior(settings.prior, row_model, offsets, level)
        known = np.asarray(~prior.any(axis=1), np.bool_)
        base = base_parameters(row_model, np.random.default_rng(NAMING_SEED), known=known)
        considered += of_friction(base) if vehicle.is_recorded else ()
        quantities: tuple[Quantity, ...] = ()
        if settings.masses:
            stated = settings.masses.drawing.items()
            drawing = {link: DrawingTolerance(*own.model_dump().values()) for link, own in stated}
            for link in drawing:
                if link not in model.links:
                    raise UrdfError(f"masses.drawing names {link!r}; links with inertia are {', '.join(model.links)}")
            quantities += mass_quantities(row_model, base, settings.masses.joint, settings.masses.arm_link, drawing)
        if vehicle.file.free_body:
            quantities += free_body_quantities(row_model, base, prior)
        gravity_m_s2 = float(np.linalg.norm(vehicle.file.vehicle.gravity_m_s2)) if roles.imus else 0.0
        identifier = Identifier(
            row_model,
            base,
            prior,
            (settings.block_ms or KERNELS_PER_BLOCK * settings.smoothing_ms) * 1e-3,
            quantities,
            considered,
            settings.gates.residual_sigma,
            settings.gates.huber_sigma,
            imu_frame=roles.imu.frame if roles.imus else None,
            start=_start(vehicle, base.names) if settings.carried else None,
            whitening=_whitening(vehicle, model, len(rows), (len(base.names) + 1) * (1 + len(considered))),
            stated=stated_by(vehicle.file.estimation.prior, row_model),
            suspects=RowSuspects(row_model, base, prior, considered, gravity_m_s2) if weighed else None,
            recorded_apart=vehicle.is_recorded,
        )
    return identifier, model


def _whitening(vehicle: config.Vehicle, model: VehicleModel, rows: int, columns: int) -> Whitening | None:
    """Of the rows of a base that is not free, where it is asked for."""
    settings = vehicle.file.estimation
    if model.spec.base.falls or settings.row_noise == "white":
        return None
    width_s = settings.smoothing_ms * 1e-3
    return Whitening(rows, columns, 1.0 / settings.row_rate_hz, width_s, Response(width_s, kernel_of(vehicle)))


def _start(vehicle: config.Vehicle, names: tuple[str, ...]) -> Start:
    carried = vehicle.file.estimation.carried
    assert carried is not None
    if tuple(carried.names) != names:
        text = f"what {carried.log} had learned is of {', '.join(carried.names)}; here there are {', '.join(names)}"
        raise config.ConfigError(f"{vehicle.label}: {text}. Go on with the vehicle that flew then")
    sensitivity = np.array(carried.sensitivity, np.float64).reshape(len(names), -1)
    return Start(np.array(carried.mean), np.array(carried.covariance), sensitivity)


def _cell_row(cell: LoadCellRole, model: VehicleModel) -> WrenchRow:
    """The row of a load cell or of a joint's torque."""
    keys = cell.keys
    if isinstance(keys, TorqueKeys):
        row = joint_torque_row(model, keys.joint, keys.friction)
        return replace(row, name=cell.name, bias=True)
    return load_cell_row(cell.name, keys.frame, keys.axis, keys.measures, keys.lever_m)


def _motors(vehicle: config.Vehicle, roles: Roles) -> list[Motor]:
    """Motors whose friction is Dahl's, and those of several joints."""
    torques = [cell.keys for cell in roles.cells if isinstance(cell.keys, TorqueKeys)]
    own = [Motor(t.joint, ((t.joint, 1.0),), t.presliding_rad) for t in torques if t.friction]
    given = vehicle.file.estimation.motor.items()
    return own + [Motor(name, tuple(motor.ratios.items()), motor.presliding_rad) for name, motor in given]
