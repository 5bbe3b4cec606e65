"""The unknowns of a prediction: names, which of them are estimated, and their place in the parameter vector.

Unknowns come in named blocks: the motion's state at the first tick (``start``), the payload's standard parameters
(``payload``), deviations of other links from the drawing (``links``), further ones of a base (``drag``, ``tilt``), the
IMU's errors (:mod:`onboard.identification.free_flyer.prediction.imu_errors`) and its place (``imu_place``), and errors
of the joints (``joints``, ``cyclic``, :mod:`onboard.dynamics.joint_errors`). An unknown with sigma zero is exact: it
stays zero and is not estimated.

Of joints that give way stiffness, damping and the bend at the first tick are unknown. Stiffness and damping are
constants, known to the sigmas that the vehicle file states. Bend and rate of it change from tick to tick
(:mod:`onboard.dynamics.compliance`); nothing is known of them where a window begins.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from onboard.dynamics.compliance import Bend, Compliance, Springs, StateColumns
from onboard.dynamics.free_flight import BasePrediction
from onboard.dynamics.joint_errors import JOINT_ERRORS
from onboard.dynamics.model.errors import SignalError, UnknownFrameError
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


_DAMPING_RATIO = 0.02  # of a joint's swing alone, unladen, where no damping is stated
_SOFTEST_Hz = 9.0  # of a joint's swing alone, unladen: rehearsed flights of softer joints gave wrong numbers
_STIFFEST_Hz = 25.0  # of the same: of 40 Hz a flight was refused for its damping, of 2 kHz no motion is found
_COLOURED = 10.0  # variance of the errors of joint accelerations over that of their noise, where joints swing
_TORQUE_N_m = 5.0  # 1 sigma of the torque that bends a joint at the start
_LARGEST = 1.0  # sigma of a bend, rad, and of its rate, rad/s


class BendAlong(NamedTuple):
    """Bends along a motion of the base, and what they add to derivatives."""

    bend: Bend
    by_all: FloatArray  # (n, 3 f + 3, p), and of the momentum that they turn
    base: BasePrediction
    told: StateColumns

    def added(self, by_motion: FloatArray) -> FloatArray:
        """What a derivative by the columns of the base's motion, (n, m, columns), adds to that by all, (n, m, p)."""
        of_both, base = self.by_all, self.base
        out = np.concatenate([by_motion[..., base.local], by_motion[..., base.of_momentum]], axis=2) @ of_both
        out[..., self.told.bends] += by_motion[..., base.at_first][..., : len(self.told.bends)]
        return np.asarray(out, np.float64)

    def carry(self, transition: FloatArray, state: FloatArray) -> None:
        """Put bends and their rates at the last tick but one into what is carried on, with their derivatives.

        Args:
            transition: of what changes, rows of the base's rate first, of the bends last, (c, p); changed.
            state: (p,); changed.
        """
        at = self.told.bends
        transition[:3] += self.added(self.base.d_rate)[-2]
        transition[-len(at) :] = self.by_all[-2, : len(at)]
        state[at] = np.concatenate([self.bend.b[-2], self.bend.db[-2]])


class FlexibleJoints:
    """The joints of a vehicle that give way.

    Args:
        vehicle: the model.
        springs: by the joints' places in the vehicle's.
        free: links whose columns the base's prediction has.
        cyclic: the joint of each function of a cyclic error.

    Attributes:
        compliance: of the joints.
        bends: where angles and rates of the bends stand in the state, (2 f,).
        swings_Hz: of each joint alone with nothing held, where it turns most.
    """

    @staticmethod
    def of(vehicle: VehicleModel, geometry: GeometryPrior, free: tuple[int, ...]) -> "FlexibleJoints | None":
        """Those that are said to be flexible; None without any."""
        springs = geometry.springs(vehicle)
        return FlexibleJoints(vehicle, springs, free, geometry.cyclic_joints(vehicle)) if springs else None

    def __init__(
        self, vehicle: VehicleModel, springs: Mapping[int, SpringPrior], free: tuple[int, ...], cyclic: list[int]
    ) -> None:
        self._cyclic = cyclic
        self.compliance = Compliance(vehicle, list(springs), free, cyclic)
        self._names, self._priors = [vehicle.joints[k].name for k in springs], tuple(springs.values())
        chi = vehicle.chi.copy()
        chi[vehicle.payload_columns()] = 0.0
        inertia = self.compliance.largest(chi)
        stiffness, damping = np.array(
            [
                (one.stiffness_N_m_rad, np.nan if one.damping_N_m_s_rad is None else one.damping_N_m_s_rad)
                for one in self._priors
            ]
        ).T
        swing = 2.0 * _DAMPING_RATIO * np.sqrt(stiffness * inertia)
        self.swings_Hz = dict(zip(self._names, np.sqrt(stiffness / inertia) / (2.0 * np.pi), strict=True))
        self._stated = Springs(stiffness, np.where(np.isnan(damping), swing, damping))
        angle = np.minimum(_TORQUE_N_m / stiffness, _LARGEST)
        self._sigma = np.concatenate([angle, np.minimum(angle * np.sqrt(stiffness / inertia), _LARGEST)])
        self.bends: IndexArray = np.zeros(0, np.intp)

    def blocks(self) -> dict[str, Unknowns]:
        """Blocks of unknowns: ``stiffness`` and ``damping``, relative, (f,) each, ``bends``, (2 f,)."""
        stiffness, damping = np.array([(one.stiffness_relative, one.damping_relative) for one in self._priors]).T
        names = {kind: tuple(f"{kind}_{name}" for name in self._names) for kind in ("stiffness", "damping")}
        bends = tuple(f"{kind}_{name}" for kind in ("bend", "bend_rate") for name in self._names)
        return {
            "stiffness": Unknowns(names["stiffness"], stiffness),
            "damping": Unknowns(names["damping"], damping),
            "bends": Unknowns(bends, self._sigma),
        }

    def placed(self, layout: UnknownLayout) -> list[int]:
        """Take in where the unknowns stand; the joint of each function of an error that varies in time."""
        self._layout = layout
        self.bends = layout.estimated("bends")
        return [*self._cyclic, *self.compliance.functions]

    @property
    def places(self) -> tuple[IndexArray, IndexArray]:
        """In the state: of the bends and their rates, of stiffness and damping."""
        return self.bends, self._layout.estimated("stiffness", "damping")

    def driven(self, joint_sigma: FloatArray, period_s: float) -> FloatArray:
        """What the noise of the joints' accelerations as they are read adds to variances of the bends' rates, (f,).

        Args:
            joint_sigma: of joint rates and accelerations, (n, 2, joints).
            period_s: between ticks.
        """
        each = joint_sigma[:, 1, self.compliance.joints]
        return np.asarray(_COLOURED * period_s**2 * (each**2).sum(axis=0), np.float64)

    def springs(self, x: FloatArray) -> Springs:
        """With the errors among all unknowns."""
        stated, at = self._stated, self._layout
        return Springs(stated.stiffness * (1.0 + x[at["stiffness"]]), stated.damping * (1.0 + x[at["damping"]]))

    def along(
        self,
        base: BasePrediction,
        bend: Bend,
        x: FloatArray,
        period_s: float,
        of_motion: list[tuple[slice | IndexArray, slice | IndexArray]],
        size: int,
    ) -> BendAlong:
        """What the bends add to derivatives.

        Args:
            base: its motion with these bends.
            bend: these.
            x: all unknowns.
            period_s: between ticks.
            of_motion: places in the state, and among the columns of the base's motion.
            size: of the state.
        """
        layout = self._layout
        told = StateColumns(of_motion, layout.estimated("stiffness"), layout.estimated("damping"), self.bends, size)
        by_all = self.compliance.derivatives(base, bend, self.springs(x), self._stated, period_s, told)
        return BendAlong(bend, by_all, base, told)


def require_stiff(vehicle: VehicleModel, geometry: GeometryPrior) -> None:
    """Check that no flexible joint is softer or stiffer than those whose answers held.

    Raises:
        SignalError: one is.
    """
    flexible = FlexibleJoints.of(vehicle, geometry, ())
    for name, swings_Hz in ({} if flexible is None else flexible.swings_Hz).items():
        if not _SOFTEST_Hz <= swings_Hz <= _STIFFEST_Hz:
            why = "such an arm gets no answer without" if swings_Hz < _SOFTEST_Hz else "it is taken for stiff then"
            raise SignalError(
                f"joint {name}: by its stiffness it swings with nothing held at {swings_Hz:.2g} Hz; "
                f"answers hold from {_SOFTEST_Hz:g} to {_STIFFEST_Hz:g} Hz, so take the stiffness out: {why}"
            )
