"""Measurement rows ``y = Y chi`` for a batch of ticks.

Every row is the projection on an axis of the wrench through a cut of the vehicle, at a frame, that produces the motion
of everything beyond the cut (Limparis 2.115, 2.132; extended by base and payload as in 3.5).

- Load cell: the cut is the cell, the axis is the cell's; a cell on a lever reads moment / lever.
- Joint torque: the cut is the joint, the axis is the joint's; with columns of its motors if asked.
- Base wrench: the cut is around the whole vehicle; components known to be zero (free flight) give rows ``0 = Y chi``.

The base's motion comes from an IMU: angular rate, angular acceleration and specific force (a - g, not acceleration).
With gravity zero in the model and the specific force as the base's acceleration, gravity, attitude and the base's
velocity all cancel (Galilean invariance) and need not be known.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from onboard.dynamics.kinematics import chain_motion
from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.vehicle import STANDARD, VehicleModel
from onboard.estimation.arrays import BoolArray, FloatArray, hat
from onboard.regressor.columns import Fold, WrenchColumns
from onboard.regressor.friction import COLUMNS, Motor, ratios_of

BASE_ROWS = tuple(f"base_{what}_{axis}" for what in ("force", "moment") for axis in "xyz")
"""Names of the rows of the wrench on a base that floats."""


class BaseMotion(NamedTuple):
    """Motion of the base frame, in base axes; each (n, 3)."""

    rate_rad_s: FloatArray
    acceleration_rad_s2: FloatArray
    specific_force_m_s2: FloatArray  # at the base frame's origin


@dataclass(frozen=True, slots=True)
class WrenchRow:
    """A row: ``projection @ wrench``, the wrench (force, moment) at ``frame``, in its axes, on all beyond."""

    name: str
    frame: str
    projection: tuple[float, float, float, float, float, float]
    bias: bool = False
    friction_joint: str | None = None
    coasting: bool = False  # the frame's origin is a falling vehicle's centre of mass: no specific force there


def load_cell_row(
    name: str,
    frame: str,
    axis: Sequence[float],
    measures: str,
    lever_m: float = 1.0,
    bias: bool = True,
) -> WrenchRow:
    """Row of a single-axis load cell (2.132) in its unit: N for a force or a moment on a lever, N m with lever 1.

    Args:
        name: of the row; its bias column is ``bias_<name>``.
        frame: the cut; what the near side exerts on the far side is positive.
        axis: sensing axis in that frame, normalised here.
        measures: ``"moment"`` or ``"force"``.
        lever_m: the reading is moment / lever.
        bias: whether the reading at no load is a parameter.

    Raises:
        SignalError: a zero axis, a lever that is not positive, or another word for ``measures``.
    """
    direction = np.asarray(axis, np.float64)
    length = float(np.linalg.norm(direction))
    if direction.shape != (3,) or not length > 0.0 or not lever_m > 0.0:
        raise SignalError(f"load cell {name!r}: give an axis of three numbers, not all zero, and a positive lever")
    x, y, z = (float(v) for v in direction / length)
    if measures == "moment":
        return WrenchRow(name, frame, (0.0, 0.0, 0.0, x / lever_m, y / lever_m, z / lever_m), bias)
    if measures == "force":
        return WrenchRow(name, frame, (x, y, z, 0.0, 0.0, 0.0), bias)
    raise SignalError(f"load cell {name!r} measures {measures!r}; say 'moment' or 'force'")


def joint_torque_row(vehicle: VehicleModel, joint: str, friction: bool = True) -> WrenchRow:
    """Row of the torque (or force) of a joint's actuator (2.115), with ``Ia``, ``Fv``, ``Fc`` if ``friction`` (2.112).

    Raises:
        UnknownFrameError: no such joint.
    """
    found = vehicle.joint(joint)
    x, y, z = found.axis
    projection = (0.0, 0.0, 0.0, x, y, z) if found.revolute else (x, y, z, 0.0, 0.0, 0.0)
    return WrenchRow(f"torque_{joint}", joint, projection, friction_joint=joint if friction else None)


def base_force_rows(vehicle: VehicleModel) -> tuple[WrenchRow, ...]:
    """The rows of the force on the whole vehicle (Limparis 3.5), in base axes: those along which it moves."""
    frame = vehicle.spec.base_link
    unit = np.eye(6)
    moves = vehicle.spec.base.moves or range(6)
    return tuple(WrenchRow(f"base_force_{n}", frame, tuple(unit[i])) for i, n in enumerate("xyz") if i in moves)


def base_moment_rows(vehicle: VehicleModel) -> tuple[WrenchRow, ...]:
    """The rows of the moment on the whole vehicle (Limparis 3.5), in base axes: those about which it turns.

    They are about the base frame's origin, unless the base is free and its joints turn balanced rotors only. Such a
    vehicle's centre of mass is fixed in the base and feels no specific force, so the rows are taken about it: exact,
    and without the accelerometer's errors. The base link's ``XX .. ZZ`` are then what the whole vehicle has about its
    centre of mass, less the rotors' own, while ``MX, MY, MZ``, which only the force rows show, stay about the frame's
    origin.
    """
    frame = vehicle.spec.base_link
    coasting = vehicle.spec.base.falls and vehicle.centre_of_mass_is_fixed()
    unit = np.eye(6)
    turns = [(i, n) for i, n in enumerate("xyz", 3) if i in (vehicle.spec.base.moves or range(6))]
    return tuple(WrenchRow(f"base_moment_{n}", frame, tuple(unit[i]), coasting=coasting) for i, n in turns)


def standing(vehicle: VehicleModel, ticks: int) -> BaseMotion:
    """Motion of a fixed base: at rest, ``f = -g``."""
    still = np.zeros((ticks, 3))
    return BaseMotion(still, still, still - vehicle.spec.gravity_m_s2)


def base_motion(
    vehicle: VehicleModel, imu_frame: str, rate: ArrayLike, acceleration: ArrayLike, specific_force: ArrayLike
) -> BaseMotion:
    """Motion of the base frame from an IMU fixed in the base: ``f_Bo = f_So - dw x p - w x (w x p)``.

    Args:
        vehicle: gives the IMU's pose.
        imu_frame: name of the IMU's frame.
        rate: angular rate, (n, 3), rad/s.
        acceleration: angular acceleration, (n, 3), rad/s^2.
        specific_force: at the IMU, (n, 3), m/s^2.

    Raises:
        UnknownFrameError: no such frame, or one that is not fixed in the base.
        SignalError: shapes that are not (n, 3).
    """
    R_BS, p_BS = vehicle.pose_in_base(imu_frame)
    parts = [np.asarray(v, np.float64) for v in (rate, acceleration, specific_force)]
    if any(part.ndim != 2 or part.shape != (parts[0].shape[0], 3) for part in parts):
        raise SignalError("rate, angular acceleration and specific force must be (n, 3) each")
    w, dw, f = (part @ R_BS.T for part in parts)
    # f_S = f_B + dw x p + w x (w x p), and w x (w x p) = w (w.p) - p (w.w)
    centripetal = w * (w @ p_BS)[:, None] - p_BS * np.einsum("ni,ni->n", w, w)[:, None]
    return BaseMotion(w, dw, f - dw @ hat(p_BS) - centripetal)


class RowFold(NamedTuple):
    """Prepared combination ``Y @ mix`` of a row model's columns; see :meth:`RowModel.fold`."""

    links: Fold
    extras: FloatArray  # (P - 10 x links, c)


class RowModel:
    """The rows of a vehicle as a function of its motion.

    Args:
        vehicle: the model.
        rows: what is measured, or known to be zero.
        zero_force: adds three columns ``zero_force_x, _y, _z``, m/s^2 in base axes: a constant that the specific force
            is too large by (accelerometer zero, lever arms times a gyro's zero). It acts on the first moments as
            gravity would, and turns with the joints: unaccounted for, it passes for inertia. The columns are made with
            the URDF's first moments; the product of an error in those and of a zero is not worth a column.
        motors: those that turn with several joints, or whose friction is Dahl's; every other row with friction has one
            of its own, named as its joint. A motor has columns in the rows with friction of the joints it turns with.

    Attributes:
        names: of the columns: ``M_<link> .. ZZ_<link>`` by link, then ``bias_<row>``, then ``Ia_, Fv_, Fc_<motor>``,
            then ``zero_force_x, _y, _z``.
        chi: prior values of the columns: the URDF's, zero for the extra ones.
        zero_force: the last three names, or none.
        motors: in the order of their columns.

    Raises:
        UnknownFrameError: a row at a frame the URDF does not have.
        UrdfError: a row with nothing beyond its cut.
    """

    def __init__(
        self, vehicle: VehicleModel, rows: Sequence[WrenchRow], zero_force: bool = False, motors: Sequence[Motor] = ()
    ) -> None:
        self.vehicle = vehicle
        self.rows = tuple(rows)
        names = [f"{parameter}_{link}" for link in vehicle.links for parameter in STANDARD]
        self._biases: list[tuple[int, int]] = []  # row, column
        for index, row in enumerate(self.rows):
            if row.bias:
                self._biases.append((index, len(names)))
                names.append(f"bias_{row.name}")
        joints = [row.friction_joint for row in self.rows]
        own = {joint: Motor(joint, ((joint, 1.0),)) for joint in joints if joint is not None}
        self.motors = tuple({**own, **{motor.name: motor for motor in motors}}.values())
        self._ratios = np.array([ratios_of(motor, [j.name for j in vehicle.joints]) for motor in self.motors])
        self._frictions: list[tuple[int, int, float, int]] = []  # row, motor, its ratio, first column
        for k, motor in enumerate(self.motors):
            for joint, ratio in motor.ratios:
                self._frictions += [(row, k, ratio, len(names)) for row, of in enumerate(joints) if of == joint]
            names += [f"{column}_{motor.name}" for column in COLUMNS]
        self._zero_force = len(names) if zero_force else None
        self.zero_force = tuple(f"zero_force_{axis}" for axis in "xyz" if zero_force)
        names += self.zero_force
        self.names = tuple(names)
        self.chi = np.concatenate([vehicle.chi, np.zeros(len(names) - vehicle.chi.size)])
        self.chi.setflags(write=False)
        self._columns = WrenchColumns(vehicle, self.rows)

    def fold(self, mix: FloatArray) -> RowFold:
        """Prepare a combination of the columns for repeated use in :meth:`regressor`.

        Args:
            mix: (P, c).
        """
        links = self.vehicle.chi.size
        return RowFold(self._columns.fold(mix[:links]), mix[links:])

    def regressor(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        motion: BaseMotion,
        attached: ArrayLike | None = None,
        fill_zero_force: bool = True,
        fold: RowFold | None = None,
        friction: FloatArray | None = None,
    ) -> FloatArray:
        """The regressor Y, (n, rows, columns), or the combinations of its columns that ``fold`` stands for.

        Args:
            q: joint positions, (n, joints), in the order of ``vehicle.joints``.
            dq: joint rates, (n, joints).
            ddq: joint accelerations, (n, joints).
            motion: of the base.
            attached: (n,) bool, whether the payload link is held; always, where not given.
            fill_zero_force: whether the ``zero_force`` columns are made, if the model has them; else they stay zero.
            fold: which combinations of columns; every column by itself, where not given.
            friction: (n, motors) Coulomb friction of each motor over its level; the sign of its rate where not given.

        Raises:
            SignalError: shapes that do not fit, or motion that is not finite.
        """
        nj = len(self.vehicle.joints)
        position, velocity, acceleration = (np.asarray(v, np.float64) for v in (q, dq, ddq))
        n = motion.rate_rad_s.shape[0]
        parts = (position, velocity, acceleration, *motion)
        if any(part.shape != (n, nj if k < 3 else 3) for k, part in enumerate(parts)):
            raise SignalError(
                f"joint signals must be (n, {nj}) and base motion (n, 3), the same number of ticks; "
                f"they are {[part.shape for part in parts]}"
            )
        held = np.ones(n, bool) if attached is None else np.asarray(attached, bool)
        if held.shape != (n,):
            raise SignalError(f"{held.size} flags for {n} ticks; say for each tick whether the payload is held")
        if not all(math.isfinite(np.vdot(part, part)) for part in parts):
            raise SignalError("motion must be finite; leave invalid ticks out before building rows")
        made = self._columns.make(self._columns.whole if fold is None else fold.links, held, *parts[:3], motion)
        own = made.shape[2] if fold is None else self.vehicle.chi.size
        if own == len(self.names):
            return made
        extras = np.zeros((n, len(self.rows), len(self.names) - own))
        if self._zero_force is not None and fill_zero_force:
            first = self._zero_force - own
            still = np.zeros_like(position)
            chain = chain_motion(self.vehicle, position, still, still)
            extras[:, :, first : first + 3] = -self._columns.unit_force(held, chain)
        for row, column in self._biases:
            extras[:, row, column - own] = 1.0
        if self._frictions:
            of_motors = self._of_motors(velocity, acceleration, friction)
            for row, motor, ratio, column in self._frictions:
                extras[:, row, column - own : column - own + 3] = ratio * of_motors[:, motor]
        return np.concatenate([made, extras], axis=2) if fold is None else made + extras @ fold.extras

    def _of_motors(self, dq: FloatArray, ddq: FloatArray, friction: FloatArray | None) -> FloatArray:
        """What the three parameters of each motor are multiplied by, (n, motors, 3)."""
        rate, up = dq @ self._ratios.T, ddq @ self._ratios.T
        return np.stack([up, rate, np.sign(rate) if friction is None else friction], axis=2)

    def readings(
        self,
        chi: FloatArray,
        q: FloatArray,
        dq: FloatArray,
        ddq: FloatArray,
        force: FloatArray,
        held: BoolArray,
        friction: FloatArray | None = None,
    ) -> FloatArray:
        """What parameters make the rows read on a base that stands, (n, rows); biases aside.

        Many times as fast as :meth:`regressor`, where no derivatives by the parameters are wanted.

        Args:
            chi: (P,) of links and motors; it may be of no possible body.
            q: joint positions, (n, joints).
            dq: joint rates, (n, joints).
            ddq: joint accelerations, (n, joints).
            force: specific force of the base, (n, 3).
            held: (n,) whether the payload is.
            friction: as of :meth:`regressor`.
        """
        read = self._columns.readings(chi[: self.vehicle.chi.size], held, chain_motion(self.vehicle, q, dq, ddq), force)
        if self._frictions:
            of_motors = self._of_motors(dq, ddq, friction)
            for row, motor, ratio, column in self._frictions:
                read[:, row] += ratio * (of_motors[:, motor] @ chi[column : column + 3])
        return read
