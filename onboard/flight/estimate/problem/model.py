"""The rigid-body model under an estimator, and how many samples of a channel make a tick."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from onboard import config
from onboard.config.vehicle import LinkSection
from onboard.dynamics.model.errors import ModelError, UrdfError
from onboard.dynamics.model.inertia import RigidBody, symmetric
from onboard.dynamics.model.payload import body_of
from onboard.dynamics.model.urdf import with_bodies
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.estimation.errors import EstimationError
from onboard.flight.estimate.readings.roles import roles_of


@contextmanager
def naming_the_file(vehicle: config.Vehicle) -> Iterator[None]:
    """Errors of a model or an estimator as those of the vehicle file.

    Raises:
        ConfigError: in place of a ModelError or an EstimationError.
    """
    try:
        yield
    except (ModelError, EstimationError) as error:
        raise config.ConfigError(f"{vehicle.label}: {error}") from error


def build_model(vehicle: config.Vehicle) -> VehicleModel:
    """The Pinocchio model of a vehicle file.

    Raises:
        ModelError: the URDF cannot be used, or lacks a name that the vehicle file has.
    """
    section = vehicle.file.vehicle
    spec = VehicleSpec(section.base_kind, section.base_link, section.payload_link, section.gravity_m_s2)
    urdf = vehicle.urdf_text
    model = VehicleModel(urdf, spec)
    measured = {name: _measured(model, name, own) for name, own in vehicle.file.link.items()}
    return VehicleModel(with_bodies(urdf, measured), spec) if measured else model


def _measured(model: VehicleModel, link: str, own: LinkSection) -> RigidBody:
    """A link by what was measured of it, and by the URDF."""
    if link not in model.links:
        raise UrdfError(f"[link.{link}]: links with inertia are {', '.join(model.links)}")
    mass_kg, centre_m, inertia = drawn_body(model, link)
    return RigidBody(
        mass_kg if own.mass_kg is None else own.mass_kg,
        centre_m if own.centre_of_mass_m is None else np.array(own.centre_of_mass_m),
        inertia if own.inertia_kg_m2 is None else symmetric(np.array(own.inertia_kg_m2)),
    )


def drawn_body(model: VehicleModel, link: str) -> RigidBody:
    """A link of a model, in its own axes."""
    at = 10 * model.links.index(link)
    return body_of(model.chi[at : at + 10])


def samples_per_tick(vehicle: config.Vehicle) -> int:
    """Samples of the base IMU in a tick.

    Raises:
        ConfigError: fewer than two.
    """
    channel = roles_of(vehicle).imu.channels[0]
    samples = samples_in_tick(vehicle, channel)
    if samples < 2:
        text = f"{1e3 * roles_of(vehicle).signals[channel].period_s:g} ms between samples of {channel!r}"
        raise config.ConfigError(f"{vehicle.label}: {text}: lower row_rate_hz until two and more make a tick")
    return samples


def samples_in_tick(vehicle: config.Vehicle, channel: str) -> int:
    """Samples of a channel in a tick."""
    return round(1.0 / (roles_of(vehicle).signals[channel].period_s * vehicle.file.estimation.row_rate_hz))
