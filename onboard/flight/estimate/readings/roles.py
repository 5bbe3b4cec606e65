"""Roles of a vehicle's channels: which device measures which quantity.

Of several IMUs the first in the file measures the base; the others are recorded.
"""

from onboard import config
from onboard.devices.roles import Roles


def roles_of(vehicle: config.Vehicle) -> Roles:
    """Who measures what in a vehicle."""
    found = Roles.none()
    for name, device in vehicle.file.device.items():
        found.add(device.roles(name, 1.0 / vehicle.rate_hz(name)))
    return found
