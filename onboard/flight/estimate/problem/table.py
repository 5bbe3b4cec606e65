"""From the vehicle file of an arm on an air-bearing table to what flies there."""

from onboard import config
from onboard.dynamics.model.errors import ModelError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.flight.estimate.problem.model import build_model, naming_the_file, samples_per_tick
from onboard.flight.estimate.problem.priors import check_joints, check_springs, check_thrusters, free_flyer_prior
from onboard.flight.estimate.readings.roles import roles_of
from onboard.identification.table.run import TableRun


def build_table(vehicle: config.Vehicle) -> tuple[TableRun, VehicleModel]:
    """What flies on a vehicle on an air-bearing table, which is estimated when its run is over; and its model.

    Raises:
        ConfigError: a name that the URDF does not have.
    """
    roles = roles_of(vehicle)
    samples_per_tick(vehicle)
    with naming_the_file(vehicle):
        model = build_model(vehicle)
        check_joints(roles, model)
        check_thrusters(roles)
        check_springs(vehicle, "not on a table")
        model.pose_in_base(roles.imu.frame)
        free_flyer_prior(vehicle, model)
    for index, puck in enumerate(vehicle.file.planar.puck if vehicle.file.planar else ()):
        try:
            model.pose_in_base(puck.frame)
        except ModelError as error:
            place = vehicle.origin.place(["planar", "puck", str(index), "frame"])
            raise config.ConfigError(f"{place}: {error}") from error
    return TableRun(str(model.spec.payload_link)), model
