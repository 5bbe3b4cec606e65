"""What a vehicle file says of a wrist sensor that is read live: its six cells, and what tells how it is turned.

Six load cells of one frame are a wrist sensor, whatever their axes. Its attitude comes from the encoders of all
joints that move its frame, where the base stands still, or by an IMU on the same body: at rest its accelerometer shows
where up is, which is all that a weighing asks of an orientation.
"""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from onboard import config
from onboard.devices.roles import LoadCellKeys, LoadCellRole, SmoothedChannel
from onboard.dynamics.model.urdf_reading import plain, read
from onboard.dynamics.model.vehicle import NAMED
from onboard.estimation.arrays import FloatArray
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.calibrate.weigh.arm import SensorArm, moved, orientation
from onboard.ground.calibrate.weigh.conventions import of_up
from onboard.ground.calibrate.weigh.errors import PosesError

_REGULAR = 1e-3  # least singular value of the cells' axes, of the largest


class WristSensor(NamedTuple):
    """Channels of a wrist sensor and of what turns it.

    Attributes:
        frame: that the cells measure in.
        cells: six.
        to_wrench: (6, 6): wrench in the frame's axes from the cells' forces and moments, N and N m.
        joints: channel of each joint that moves the frame, from the base outwards; empty with an IMU.
        arm: these joints; None with an IMU.
        imu: channel of the IMU; empty with joints.
        R_SI: (3, 3) IMU axes in the axes of the frame.
        signals: of all channels.
    """

    frame: str
    cells: tuple[LoadCellRole, ...]
    to_wrench: FloatArray
    joints: tuple[str, ...]
    arm: SensorArm | None
    imu: str
    R_SI: FloatArray
    signals: dict[str, SmoothedChannel]

    @property
    def channels(self) -> tuple[str, ...]:
        """All that are read."""
        return (*(cell.channel for cell in self.cells), *self.joints, *filter(None, [self.imu]))

    def devices(self, vehicle: config.Vehicle) -> list[str]:
        """Names of those that send these channels."""
        own = set(self.channels)
        return [name for name, one in vehicle.file.device.items() if own & set(one.channels(name))]

    @property
    def scale_sigma(self) -> float:
        """1 sigma of a cell as the file states it; 0 where it states none."""
        return float(np.sqrt(np.mean([cell.keys.relative_sigma**2 for cell in self.cells])))

    @property
    def told_by(self) -> str:
        """What tells the orientation, in words."""
        return f"the accelerometer of {self.imu}" if self.imu else f"the encoders {', '.join(self.joints)}"

    def wrench(self, means: dict[str, float]) -> FloatArray:
        """Force and moment (6,) on all beyond the frame, from mean readings in N without their present zeros."""
        read = [means[one.channel] / _keys(one).gain * _lever(_keys(one)) for one in self.cells]
        return np.asarray(self.to_wrench @ np.array(read), np.float64)

    def rotation(self, angles: FloatArray) -> FloatArray:
        """Axes of the frame in those of the base (3, 3): angles of the joints, or specific force of the IMU (3,)."""
        if self.arm is not None:
            return orientation(self.arm, angles)
        up = self.R_SI @ angles
        return np.asarray(of_up(up[None])[0], np.float64)


def wrist_sensor(vehicle: config.Vehicle, frame: str = "") -> WristSensor:
    """The wrist sensor of a vehicle.

    Args:
        vehicle: its file.
        frame: of the sensor; the only one with six cells where not given.

    Raises:
        PosesError: it has none, or nothing tells how it is turned.
    """
    roles = roles_of(vehicle)
    by_frame: dict[str, list[LoadCellRole]] = {}
    for cell in roles.cells:
        if isinstance(cell.keys, LoadCellKeys):
            by_frame.setdefault(cell.keys.frame, []).append(cell)
    six = [name for name, cells in by_frame.items() if len(cells) == 6]
    if (frame and frame not in six) or (len(six) != 1 and not frame):
        held = ", ".join(f"{len(cells)} at {name}" for name, cells in by_frame.items()) or "none"
        raise PosesError(
            f"{vehicle.label}: a wrist sensor is six load cells of a frame, three forces and three moments; it has "
            f"{held}{'; give --link' if len(six) > 1 else ''}"
        )
    name = frame or six[0]
    cells = tuple(by_frame[name])
    rows = np.array([_row(_keys(cell)) for cell in cells])
    values = np.linalg.svd(rows, compute_uv=False)
    if values[-1] < _REGULAR * values[0]:
        raise PosesError(
            f"{vehicle.label}: the six load cells of {name} do not tell force and moment apart in all three "
            "directions; correct `axis` and `measures`"
        )
    model = pin.buildModelFromXML(plain(read(vehicle.urdf_text, vehicle.label)))
    own = moved(model, _frame_id(model, name, vehicle))
    held = model.frames[own.frame]
    angles = {one.joint: one.channel for one in roles.joints if not one.is_rate}
    found = WristSensor(name, cells, np.linalg.inv(rows), (), None, "", np.eye(3), dict(roles.signals))
    stands = not vehicle.file.vehicle.base_kind.moves
    if stands and own.joints and all(joint in angles for joint in own.joints):
        return found._replace(arm=own, joints=tuple(angles[joint] for joint in own.joints))
    for imu in roles.imus:
        seat = model.frames[_frame_id(model, imu.frame, vehicle)]
        if seat.parentJoint == held.parentJoint and len(imu.channels) == 1:
            R_SI = held.placement.rotation.T @ seat.placement.rotation
            return found._replace(imu=imu.channels[0], R_SI=np.asarray(R_SI, np.float64))
    missing = next((f" ({joint} has none)" for joint in own.joints if stands and joint not in angles), "")
    raise PosesError(
        f"{vehicle.label}: nothing tells how {name} is turned: it takes a fixed base and an encoder on each of "
        f"{', '.join(own.joints) or 'its joints'}{missing}, or an IMU "
        "on its body; else write the poses into a table: heft weigh POSES.csv"
    )


def _keys(cell: LoadCellRole) -> LoadCellKeys:
    assert isinstance(cell.keys, LoadCellKeys)  # chosen so
    return cell.keys


def _lever(keys: LoadCellKeys) -> float:
    return keys.lever_m if keys.measures == "moment" else 1.0


def _row(keys: LoadCellKeys) -> FloatArray:
    """What a cell reads of a wrench in its frame, (6,)."""
    axis = np.array(keys.axis) / np.linalg.norm(keys.axis)
    none = np.zeros(3)
    return np.concatenate([none, axis] if keys.measures == "moment" else [axis, none])


def _frame_id(model: pin.Model, name: str, vehicle: config.Vehicle) -> int:
    for kind in NAMED:
        if model.existFrame(name, kind):
            return int(model.getFrameId(name, kind))
    raise PosesError(f"{vehicle.label}: the URDF has no link or joint {name!r}; correct the frame of its devices")
