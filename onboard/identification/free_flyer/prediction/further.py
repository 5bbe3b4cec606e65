"""Instruments besides the first IMU that the filter predicts: further IMUs, load cells, a tracker.

A load cell shows ``(1 + scale) (u - delay du/dt) + bias + drift t``, u its component of the wrench through its cut
(:mod:`onboard.dynamics.cut_wrench`): the IMU's error model
(:mod:`onboard.identification.free_flyer.prediction.imu_errors`) for one axis. A clock without marks wanders, so a delay
may be a random walk as well.

The torque of a joint is a cell whose cut is that joint. Measured on the motor's side of its gear it has friction and
the rotor's inertia in it: ``u + Fc sign(dq) + Fv dq + Ia ddq`` in place of u (Limparis 2.112). What the joints' noise
does to these three is left out: it is a few hundredths of a torque's stated sigma at most.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.dynamics.cut_wrench import CutWrench
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.tracked_pose import LINES
from onboard.estimation.arrays import FloatArray
from onboard.identification.free_flyer.prediction.imu_errors import ImuPrior, imu_blocks
from onboard.identification.free_flyer.prediction.parameters import Unknowns

_ANYWHERE_m, _ANY_m_s = 20.0, 1.0  # 1 sigma of the centre of mass in a tracker's axes, and of its velocity
OF_FRICTION = ("Fc", "Fv", "Ia")


class FurtherImu(NamedTuple):
    """Another IMU on the base."""

    name: str
    frame: str
    samples: int  # in each tick's mean
    prior: ImuPrior
    place_m: float  # 1 sigma of each coordinate
    delay_memory_s: float = np.inf  # correlation time of its delay; infinite: constant

    @property
    def width(self) -> int:
        """Lines that it has."""
        return 6

    def blocks(self) -> dict[str, Unknowns]:
        """Its unknowns, its name after each of theirs."""
        prior = self.prior._replace(clock_rate_error=0.0)
        blocks = {
            f"{kind} {self.name}": Unknowns(tuple(f"{name}_{self.name}" for name in block.names), block.sigma)
            for kind, block in imu_blocks(prior).items()
        }
        places = tuple(f"place_{axis}_{self.name}" for axis in "xyz")
        return {**blocks, f"place {self.name}": Unknowns(places, np.full(3, self.place_m))}


class CellPrior(NamedTuple):
    """Prior on a cell's errors: standard deviations; zero: exact."""

    bias: float  # its unit
    drift: float  # its unit, per second
    scale: float
    delay_s: float


class Friction(NamedTuple):
    """Friction and rotor of a joint in its measured torque: 1 sigma about none; zero: exactly none."""

    joint: int  # its number in the model
    coulomb: float  # N m
    viscous: float  # N m s / rad
    rotor: float  # kg m^2


class FurtherCell(NamedTuple):
    """A load cell of the arm, or the torque of a joint."""

    name: str
    frame: str
    projection: tuple[float, ...]  # (6,) of the wrench through its cut, in the frame's axes about its origin
    samples: int
    prior: CellPrior
    friction: Friction | None = None  # of the joint whose torque it is; None: it is a load cell

    @property
    def width(self) -> int:
        """Lines that it has."""
        return 1

    def blocks(self) -> dict[str, Unknowns]:
        """Its errors as a block of unknowns: those of :class:`CellPrior`, then :data:`OF_FRICTION` if it has any."""
        friction = () if self.friction is None else self.friction[1:]
        kinds = (*CellPrior._fields, *OF_FRICTION[: len(friction)])
        sigma = np.array([*self.prior, *friction], np.float64)
        return {self.name: Unknowns(tuple(f"{kind}_{self.name}" for kind in kinds), sigma)}


def cuts_of(
    vehicle: VehicleModel, further: Sequence["Further"], free: tuple[int, ...], cyclic: Sequence[int]
) -> list[tuple[FurtherCell, CutWrench]]:
    """The load cells, each with its cut: see :class:`CutWrench`."""
    cells = [one for one in further if isinstance(one, FurtherCell)]
    return [(one, CutWrench(vehicle, one.frame, np.array(one.projection, np.float64), free, cyclic)) for one in cells]


class PosePrior(NamedTuple):
    """Prior on a tracker's errors: standard deviations; zero: exact."""

    acceleration_m_s2: float
    turn_rad: float
    place_m: float
    scale: float
    delay_s: float


class FurtherPose(NamedTuple):
    """A tracker."""

    name: str
    frame: str  # fixed in the base
    prior: PosePrior
    samples: int = 1  # a reading is that of an instant

    @property
    def width(self) -> int:
        """Lines that it has."""
        return LINES

    def blocks(self) -> dict[str, Unknowns]:
        """Its unknowns, the first of them what changes in flight."""
        p = self.prior
        each = {
            "attitude": ("wxyz", 1.0),
            "centre": ("xyz", _ANYWHERE_m),
            "velocity": ("xyz", _ANY_m_s),
            "acceleration": ("xyz", p.acceleration_m_s2),
            "turn": ("xyz", p.turn_rad),
            "place": ("xyz", p.place_m),
        }
        blocks = {
            f"{kind} {self.name}": Unknowns(tuple(f"{kind}_{axis}_{self.name}" for axis in axes), np.full(len(axes), s))
            for kind, (axes, s) in each.items()
        }
        last = {"scale": p.scale, "delay_s": p.delay_s}
        return blocks | {f"{k} {self.name}": Unknowns((f"{k}_{self.name}",), np.array([s])) for k, s in last.items()}


Further = FurtherImu | FurtherCell | FurtherPose


def instrument_of(parameter: str, further: Sequence[Further]) -> tuple[int, str]:
    """The number of a parameter's instrument (0: none of ``further``), and the parameter's name without it."""
    for device, one in enumerate(further, 1):
        if parameter.endswith(f"_{one.name}"):
            return device, parameter.removesuffix(f"_{one.name}")
    return 0, parameter.removesuffix("_imu")


class Thruster(NamedTuple):
    """A force of known direction on the base."""

    name: str
    wrench: FloatArray  # (6,) of 1 N: force and moment about the base's origin, base axes
    scale_sigma: float  # relative

    @staticmethod
    def block(thrusters: Sequence["Thruster"]) -> Unknowns:
        """Scales of some as a block of unknowns."""
        return Unknowns(
            tuple(f"scale_{one.name}" for one in thrusters), np.array([one.scale_sigma for one in thrusters])
        )

    @staticmethod
    def of(vehicle: VehicleModel, name: str, frame: str, axis: Sequence[float], scale_sigma: float) -> "Thruster":
        """Along an axis of a frame, through its origin.

        Raises:
            UnknownFrameError: a frame that the URDF does not have, or that moves with a joint.
        """
        R_BF, p_BoFo_B = vehicle.pose_in_base(frame)
        force = R_BF @ (np.asarray(axis) / np.linalg.norm(axis))
        return Thruster(name, np.concatenate([force, np.cross(p_BoFo_B, force)]), scale_sigma)


TURNING_rad_s = 0.1
"""Of a base, one sigma: so fast does a wrench that is fixed in space, as drag, change in its axes."""


class DisturbancePrior(NamedTuple):
    """What pushes the base unknown, in its axes: drag, a leak. Standard deviations about none; zero: exactly none."""

    force_N: float = 0.0  # noqa: N815 - each component, at the base's origin
    torque_N_m: float = 0.0  # noqa: N815 - each component
    memory_s: float = np.inf  # correlation time of both, as first-order Gauss-Markov processes

    def block(self) -> Unknowns:
        """Force and moment, and how they change with time, (12,)."""
        of_each = [f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz"]
        names = tuple(f"disturbance_{what}{one}" for what in ("", "drift_") for one in of_each)
        sigma = np.repeat([self.force_N, self.torque_N_m], 3)
        return Unknowns(names, np.concatenate([sigma, TURNING_rad_s * sigma]))


def left_of(processes: Sequence[tuple[int, float]], after_s: float, size: int) -> FloatArray:
    """What first-order Gauss-Markov processes leave of their values after some time, (p,); one for all else.

    Without it a force that biases of accelerometers hide would grow as long as the flight lasts.

    Args:
        processes: place in the state and correlation time of each, s.
        after_s: that time.
        size: of the state.
    """
    left = np.ones(size)
    if processes:
        at, memory_s = zip(*processes, strict=True)
        left[list(at)] = np.exp(-after_s / np.array(memory_s))
    return left


class PlacedImu(NamedTuple):
    """An IMU, and where its unknowns stand among all."""

    R_BS: FloatArray
    p_BoSo_B: FloatArray  # noqa: N815
    samples: int
    errors: slice
    place: slice


class PlacedPose(NamedTuple):
    """A tracker: its frame in the base, where its unknowns stand among all, and where what moves in the state."""

    mount: tuple[FloatArray, FloatArray]  # quaternion, place
    unknown: slice
    motion: slice
