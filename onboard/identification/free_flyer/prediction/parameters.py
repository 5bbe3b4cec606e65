"""The unknowns of a prediction: names, which of them are estimated, and their place in the parameter vector.

Unknowns come in named blocks: the motion's state at the first tick (``start``), the payload's standard parameters
(``payload``), deviations of other links from the drawing (``links``), further ones of a base (``drag``, ``tilt``), the
IMU's errors (:mod:`onboard.identification.free_flyer.prediction.imu_errors`) and its place (``imu_place``), and errors
of the joints (``joints``, ``cyclic``, :mod:`onboard.dynamics.joint_errors`). An unknown with sigma zero is exact: it
stays zero and is not estimated.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from onboard.dynamics.joint_errors import JOINT_ERRORS
from onboard.dynamics.model.errors import UnknownFrameError
from onboard.dynamics.model.vehicle import STANDARD, VehicleModel
from onboard.dynamics.spatial import Columns
from onboard.estimation.arrays import FloatArray, IndexArray


class Unknowns(NamedTuple):
    """A block of unknowns."""

    names: tuple[str, ...]
    sigma: FloatArray  # (k,) before the flight, about zero; zero: certain; NaN: nothing is known


class SpringPrior(NamedTuple):
    """Prior on the spring of a joint that gives way between drive and link."""

    stiffness_N_m_rad: float  # noqa: N815
    stiffness_relative: float  # standard deviation
    damping_N_m_s_rad: float | None  # noqa: N815 - None: 2 % of critical, see FlexibleJoints
    damping_relative: float  # standard deviation


class JointPrior(NamedTuple):
    """Prior on the errors of one joint: standard deviations; zero: exact."""

    place_m: float = 0.0  # of each coordinate of its place, from the drawing
    zero: float = 0.0  # of its encoder, rad or m
    scale: float = 0.0  # of its encoder, relative
    delay_s: float = 0.0  # of its encoder
    # Of each of its encoder's cyclic errors, a cosine and a sine each: periods in a radian, times 2 pi, and rms.
    cyclic: tuple[tuple[float, float], ...] = ()
    spring: SpringPrior | None = None  # None: it is stiff


class GeometryPrior(NamedTuple):
    """Prior on places of IMU and joints, and on errors of encoders; joints that are not named are exact."""

    imu_place_m: float = 0.0  # of each coordinate
    joints: Mapping[str, JointPrior] = MappingProxyType({})

    def of(self, vehicle: VehicleModel) -> list[JointPrior]:
        """Of all joints of a vehicle, in its order."""
        return [self.joints.get(joint.name, JointPrior()) for joint in vehicle.joints]

    def blocks(self, vehicle: VehicleModel) -> dict[str, Unknowns]:
        """As blocks of unknowns: ``imu_place``, (3,), ``joints``, (6 x joints,), see :data:`JOINT_ERRORS`, ``cyclic``.

        Raises:
            UnknownFrameError: a joint that the URDF does not have.
        """
        for name in self.joints:
            vehicle.joint(name)
        names, sigma = [], []
        cyclic, rms = [], []
        for joint, own in zip(vehicle.joints, self.of(vehicle), strict=True):
            names += [f"{kind}_{joint.name}" for kind in JOINT_ERRORS]
            sigma += [*[own.place_m] * 3, own.zero, own.scale, own.delay_s]
            cyclic += [f"cyclic_{k}_{wave}_{joint.name}" for k in range(len(own.cyclic)) for wave in ("cos", "sin")]
            rms += [one for _, one in own.cyclic for _ in range(2)]
        return {
            "imu_place": Unknowns(tuple(f"place_{axis}_imu" for axis in "xyz"), np.full(3, self.imu_place_m)),
            "joints": Unknowns(tuple(names), np.array(sigma, np.float64)),
            "cyclic": Unknowns(tuple(cyclic), np.array(rms, np.float64)),
        }

    def springs(self, vehicle: VehicleModel) -> dict[int, SpringPrior]:
        """Of the joints that give way, by their places in the vehicle's joints."""
        return {k: own.spring for k, own in enumerate(self.of(vehicle)) if own.spring is not None}

    def cyclic_joints(self, vehicle: VehicleModel) -> list[int]:
        """The joint of each unknown of ``cyclic``, by its place in the vehicle's joints."""
        return [index for index, own in enumerate(self.of(vehicle)) for _ in range(2 * len(own.cyclic))]

    def cyclic_slopes(self, vehicle: VehicleModel) -> FloatArray:
        """Slope of each function of ``cyclic`` by each joint's angle, over the other function of its pair, (joints, m).

        Of a cosine it is less its periods in a radian, times 2 pi; of a sine it is these.
        """
        slopes = np.zeros((len(vehicle.joints), len(of := self.cyclic_joints(vehicle))))
        slopes[of, range(len(of))] = [s * n for own in self.of(vehicle) for n, _ in own.cyclic for s in (-1.0, 1.0)]
        return slopes


EXACT_GEOMETRY = GeometryPrior()


class UnknownLayout:
    """Order of all unknowns, and of those that are estimated.

    Args:
        blocks: by name, in the order of the unknowns.

    Attributes:
        names: of the p unknowns that are estimated.
        sigma: (p,) of these before the flight; NaN where nothing is known.
        size: of all unknowns.
        every: their names.
        kept: (p,) places of what is estimated among all unknowns.
    """

    def __init__(self, blocks: Mapping[str, Unknowns]) -> None:
        ends = np.cumsum([0, *(len(block.names) for block in blocks.values())]).tolist()
        self._places = {name: slice(a, b) for name, a, b in zip(blocks, ends[:-1], ends[1:], strict=True)}
        names = [name for block in blocks.values() for name in block.names]
        sigma = np.concatenate([block.sigma for block in blocks.values()])
        self.size, self.every = len(names), tuple(names)
        self.kept: IndexArray = np.flatnonzero(sigma != 0.0)
        self.names = tuple(names[k] for k in self.kept)
        self.sigma = sigma[self.kept]

    def __getitem__(self, block: str) -> slice:
        """Slice of a block in the vector of all unknowns."""
        return self._places[block]

    def estimated(self, *blocks: str) -> IndexArray:
        """Indices of blocks in the vector of estimated unknowns."""
        inside = [(self.kept >= self[name].start) & (self.kept < self[name].stop) for name in blocks]
        return np.flatnonzero(np.logical_or.reduce(inside))

    def whole(self, x: FloatArray) -> FloatArray:
        """All unknowns from those estimated, (p,); zero where certain."""
        every = np.zeros(self.size)
        every[self.kept] = x
        return every


class UncertainLinks:
    """The payload of a vehicle, and the links with uncertain parameters.

    Args:
        vehicle: with a payload link; its standard parameters are the prior of all other links.
        covariance: of the standard parameters of links by name, (10, 10) each, positive definite (see
            :func:`onboard.dynamics.model.payload.standard_covariance`); links that are not named are certain.

    Attributes:
        indices: of the payload and of these links in ``vehicle.links``.
        drawn: names of these links.
        covariances: (10, 10) each.
        halves: their Cholesky factors.
        basis: block-diagonal of these.
        columns: of derivatives by the payload's parameters and by these factors.
        whole: each of these links itself, in the axes of its factor, (k, 10).
        names: of the links' parameters.
        inertial_names: of the directions of each covariance's Cholesky factor, one sigma long.

    Raises:
        UnknownFrameError: no payload link, or a covariance of a link that the URDF does not have or of the payload.
    """

    def __init__(self, vehicle: VehicleModel, covariance: Mapping[str, FloatArray]) -> None:
        payload = vehicle.spec.payload_link
        if payload is None:
            raise UnknownFrameError("this vehicle has no payload link; set payload_link")
        unknown = set(covariance) - (set(vehicle.links) - {payload})
        if unknown:
            raise UnknownFrameError(f"covariances are for links other than the payload; {', '.join(unknown)} is none")
        others = [k for k, link in enumerate(vehicle.links) if link in covariance]
        self._vehicle, self._payload = vehicle, vehicle.payload_columns()
        self._others = (10 * np.repeat(others, 10) + np.tile(np.arange(10), len(others))).astype(np.intp)
        self.indices = (vehicle.links.index(payload), *others)
        self.drawn = tuple(vehicle.links[k] for k in others)
        self.covariances = [covariance[name] for name in self.drawn]
        self.halves = [np.asarray(np.linalg.cholesky(block), np.float64) for block in self.covariances]
        self.basis = np.asarray(block_diag(*self.halves), np.float64) if self.halves else np.zeros((0, 0))
        self.columns = Columns(self.indices, [np.eye(10), *self.halves])
        self.whole = np.linalg.solve(self.basis, vehicle.chi[self._others]).reshape(-1, 10)
        self.names = tuple(f"{kind}_{vehicle.links[k]}" for k in others for kind in STANDARD)
        self.inertial_names = tuple(f"{vehicle.links[k]}_inertial_{n}" for k in others for n in range(10))
        self.payload_names = tuple(f"{kind}_{payload}" for kind in STANDARD)

    def chi(self, payload: FloatArray, deviations: FloatArray) -> FloatArray:
        """Standard parameters of all links, (10 x links,).

        Args:
            payload: its standard parameters, (10,).
            deviations: of the uncertain links from the drawing, (10 x uncertain links,).
        """
        chi = self._vehicle.chi.copy()
        chi[self._payload] = payload
        chi[self._others] += deviations
        return chi


class Own(NamedTuple):
    """Where the unknowns of an instrument alone stand in the state, and among all that it has."""

    errors: slice | IndexArray
    of_errors: slice | IndexArray
    place: slice | IndexArray = slice(0)
    of_place: slice | IndexArray = slice(0)


def named(layout: UnknownLayout, end: str) -> IndexArray:
    """Estimated unknowns whose names end so."""
    return np.array([at for at, known in enumerate(layout.names) if known.endswith(end)], np.intp)


def kept_of(layout: UnknownLayout, block: slice) -> tuple[slice | IndexArray, slice | IndexArray]:
    """What is estimated of a block: places in the state, and in the block."""
    at = np.flatnonzero((layout.kept >= block.start) & (layout.kept < block.stop))
    return together(at), together(layout.kept[at] - block.start)


def together(places: IndexArray) -> slice | IndexArray:
    """Places as a slice where they are one after the other: what is indexed by it is not copied."""
    if places.size and (np.diff(places) == 1).all():
        return slice(int(places[0]), int(places[-1]) + 1)
    return places
