"""Checks of the devices against the URDF that every estimator makes."""

from onboard.config.methods import OF_A_FREE_BASE
from onboard.devices.roles import Roles
from onboard.dynamics.model.errors import UrdfError
from onboard.dynamics.model.vehicle import VehicleModel


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
