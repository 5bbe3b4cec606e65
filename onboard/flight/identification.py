"""From vehicle.toml to an :class:`Identifier`: which rows, which prior, what is considered, what is reported."""

import numpy as np

from onboard import config
from onboard.estimation.errors import EstimationError
from onboard.estimation.memory import Memory
from onboard.flight.roles import Cell, Roles, roles_of
from onboard.model.base_parameters import base_parameters, named_relative_sigma
from onboard.model.errors import ModelError, UrdfError
from onboard.model.free_body import free_body_quantities
from onboard.model.identify import Considered, Identifier, Quantity, mass_quantities
from onboard.model.rows import RowModel, WrenchRow, base_force_rows, base_moment_rows, load_cell_row
from onboard.model.vehicle import BaseKind, Vehicle, VehicleSpec

NAMING_SEED = 20190812  # base parameters are found on random motion; their names must not depend on luck
KERNELS_PER_BLOCK = 5


def build_model(vehicle: config.Vehicle) -> Vehicle:
    """The Pinocchio model of a vehicle file.

    Raises:
        ModelError: the URDF cannot be used, or lacks a name that the vehicle file has.
    """
    section = vehicle.file.vehicle
    spec = VehicleSpec(BaseKind(section.base), section.base_link, section.payload_link)
    return Vehicle(vehicle.urdf_path.read_text(encoding="utf-8"), spec)


def build_identifier(vehicle: config.Vehicle) -> tuple[Identifier, Vehicle]:
    """The identifier of a vehicle file, and the model under it.

    Raises:
        ConfigError: the estimation section does not fit the URDF.
    """
    settings, roles = vehicle.file.estimation, roles_of(vehicle)
    try:
        model = build_model(vehicle)
        _check_joints(roles, model)
        rows: list[WrenchRow] = []
        considered: list[Considered] = []
        for cell in roles.cells:
            keys = cell.keys
            rows.append(load_cell_row(cell.name, keys.frame, keys.axis, keys.measures, keys.lever_m))
            considered += _considered(cell)
        if "force" in settings.base_rows:
            rows += base_force_rows(model)
        if "moment" in settings.base_rows:
            rows += base_moment_rows(model)
        zero_force = settings.zero_force_sigma_m_s2
        row_model = RowModel(model, rows, zero_force=zero_force is not None)
        offsets = {f"zero_force_{axis}": zero_force for axis in "xyz"} if zero_force else {}
        prior = named_relative_sigma(row_model, settings.prior.relative, {**settings.prior.absolute, **offsets})
        base = base_parameters(row_model, np.random.default_rng(NAMING_SEED), known=prior == 0.0)
        quantities: tuple[Quantity, ...] = ()
        if settings.masses:
            quantities += mass_quantities(row_model, base, settings.masses.joint, settings.masses.arm_link)
        if vehicle.file.free_body:
            quantities += free_body_quantities(row_model, base, prior)
        identifier = Identifier(
            row_model,
            base,
            prior,
            (settings.block_ms or KERNELS_PER_BLOCK * settings.smoothing_ms) * 1e-3,
            quantities,
            considered,
            settings.gates.residual_sigma,
            Memory(settings.memory.forgetting_s, settings.memory.window_s),
            settings.gates.huber_sigma,
            imu_frame=roles.imu.frame,
        )
    except (ModelError, EstimationError) as error:
        raise config.ConfigError(f"{vehicle.path}: {error}") from error
    return identifier, model


def _check_joints(roles: Roles, model: Vehicle) -> None:
    """Every joint that moves is measured by one device, and every such device names a joint."""
    measured = [joint.joint for joint in roles.joints]
    moving = [joint.name for joint in model.joints]
    if sorted(measured) != sorted(moving):
        listed, named = ", ".join(moving) or "none", ", ".join(measured) or "none"
        raise UrdfError(f"the URDF's moving joints are {listed}, the devices measure {named}; name each joint once")


def _considered(cell: Cell) -> list[Considered]:
    """A cell's calibration and its lever scale every reading alike; no flight can tell them from mass."""
    name, keys = cell.name, cell.keys
    lever = keys.lever_sigma_m / keys.lever_m if keys.measures == "moment" else 0.0
    return [
        Considered(f"scale of {name}", name, "scale", float(np.hypot(keys.scale_sigma, lever))),
        Considered(f"delay of {name}", name, "delay", keys.delay_sigma_ms * 1e-3),
    ]
