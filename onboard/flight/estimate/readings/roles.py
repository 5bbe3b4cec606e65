"""Roles of a vehicle's channels: which device measures which quantity.

Of several IMUs the first in the file measures the base; the others are recorded.
"""

from math import hypot

from onboard import config
from onboard.devices.roles import LoadCellKeys, LoadCellRole, Roles
from onboard.timebase.delays import Delay


def roles_of(vehicle: config.Vehicle) -> Roles:
    """Who measures what in a vehicle, and how well the delays of joints and load cells are known against the joints'.

    That is what a device states of the delays that are taken off its samples' times: of filters, and of the wait until
    they arrive where no pulse marks them. What arrives together is late together: where the joints do, their delay is
    what all others are late against. A motor's torque is sampled with its joint.
    """
    found, delays = Roles.none(), list[Delay]()
    for name, device in vehicle.file.device.items():
        found.add(device.roles(name, 1.0 / vehicle.rate_hz(name)))
        delays += device.delays(name, vehicle)
    clocks = {one.channel: one.clock for one in delays if one.clock}
    shared = {one.clock: one.sigma_s for one in delays if one.clock}
    of_joints = {clocks.get(one.channel, "") for one in found.joints}
    joints = of_joints.pop() if len(of_joints) == 1 else ""
    known = {one.channel: 0.0 for one in delays}
    for one in delays:
        known[one.channel] = hypot(known[one.channel], 0.0 if one.clock else one.sigma_s)
    for channel, own in known.items():
        if (clock := clocks.get(channel, "")) != joints:
            known[channel] = hypot(own, shared.get(clock, 0.0), shared.get(joints, 0.0))
    for k, joint in enumerate(found.joints):
        found.joints[k] = joint._replace(delay_sigma_s=max(known.get(joint.channel, 0.0), joint.delay_sigma_s))
    found.cells[:] = [_late(one, known) for one in found.cells]
    return found


def _late(cell: LoadCellRole, known: dict[str, float]) -> LoadCellRole:
    stated = 1e-3 * cell.keys.delay_sigma_ms
    against_joints = known.get(cell.channel, stated) if isinstance(cell.keys, LoadCellKeys) else stated
    return cell._replace(delay_sigma_s=against_joints)
