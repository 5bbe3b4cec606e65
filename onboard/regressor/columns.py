"""Columns of the links' parameters for all rows, from one Pinocchio call per tick (Limparis 2.115, 2.132).

Pinocchio's joint torque regressor is linear in the ten parameters of each *joint's* body, about the joint's frame. Its
row of a joint's velocity is that joint's torque row, and its first six rows are the wrench on each body about the
base's origin, in base axes. A link is a part of its joint's body, so its columns are those of the body times a constant
matrix; and the wrench through any cut is the sum over the links beyond, moved to the cut's frame.

Only requested combinations of columns are computed: a :class:`Fold`, made once of a matrix ``mix``, represents ``Y @
mix``. Known parameters can thus be left out of the rows or summed into one column.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from onboard.dynamics.kinematics import Chain, cross
from onboard.dynamics.model.errors import UrdfError
from onboard.dynamics.model.inertia import moved_to
from onboard.dynamics.model.vehicle import FREE_FLYER_NV, VehicleModel
from onboard.dynamics.spatial import crf, force_transforms, own_inertias, times
from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray


class Projected(Protocol):
    """Row as seen by the links' columns; implemented by :class:`onboard.regressor.rows.WrenchRow`."""

    @property
    def frame(self) -> str:
        """The cut's frame."""
        ...

    @property
    def projection(self) -> tuple[float, float, float, float, float, float]:
        """Projection of the wrench (force, moment) at that frame, in its axes."""
        ...

    @property
    def coasting(self) -> bool:
        """Whether the base's specific force is left out."""
        ...


class _Cut(NamedTuple):
    """Rows through one frame."""

    frame: int
    rows: slice | NDArray[np.intp]
    velocities: (
        slice | NDArray[np.intp] | None
    )  # rows of Pinocchio's regressor that are these rows, for a joint's torque
    projection: FloatArray  # (rows here, 6); on the wrench about the base's origin where the frame is fixed in the base
    fixed: bool
    coasting: bool
    columns: BoolArray  # (10 x links,) of the links beyond
    links: IndexArray  # these
    own: FloatArray  # (rows here, 6) projection on the wrench at the frame, in its axes
    body: int  # that the frame is fixed to
    axes: FloatArray  # (3, 3) the frame's in that body's
    origin: FloatArray  # (3,)

    def in_base(self, chain: Chain) -> FloatArray:
        """The projection on the wrench about the base's origin, base axes, (n, rows here, 6)."""
        on, at = chain.axes[:, self.body], chain.origins[:, self.body]
        R = (on @ self.axes)[:, None]
        force, moment = times(R, self.own[:, :3]), times(R, self.own[:, 3:])
        force += cross((at + times(on, self.origin))[:, None], moment)
        return np.concatenate([force, moment], axis=-1)


def _as_slice(index: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Consecutive indices as a slice, for a view instead of a copy."""
    return slice(int(index[0]), int(index[-1]) + 1) if (np.diff(index) == 1).all() else index


class Fold(NamedTuple):
    """Prepared combination ``Y[:, links] @ mix``: one matrix per cut, with and without the payload."""

    held: tuple[FloatArray, ...]  # (10 x bodies, c) each
    released: tuple[FloatArray, ...]
    columns: int


def body_parameters(vehicle: VehicleModel) -> FloatArray:
    """Map from link parameters to those of the joints' bodies, ``T P T'`` per link, (10 x bodies, 10 x links)."""
    model = vehicle.model
    out = np.zeros((10 * (model.njoints - 1), 10 * len(vehicle.links)))
    for link, name in enumerate(vehicle.links):
        frame = model.frames[vehicle.frame_id(name)]
        pose, first = frame.placement.homogeneous, 10 * (int(frame.parentJoint) - 1)
        out[first : first + 10, 10 * link : 10 * link + 10] = moved_to(pose)
    return out


class WrenchColumns:
    """Columns of the links' parameters for the rows of a vehicle.

    Args:
        vehicle: the model.
        rows: the rows' cuts and projections.

    Raises:
        UnknownFrameError: a row at a frame the URDF does not have.
        UrdfError: a row with nothing beyond its cut.
    """

    def __init__(self, vehicle: VehicleModel, rows: Sequence[Projected]) -> None:
        self._model, self._data = vehicle.model, vehicle.model.createData()
        self._rows = len(rows)
        self._bodies = body_parameters(vehicle)
        self._chi, self._payload = vehicle.chi, vehicle.payload_columns()
        groups: dict[tuple[str, bool], list[int]] = {}
        for index, row in enumerate(rows):
            groups.setdefault((row.frame, row.coasting), []).append(index)
        self._cuts = [self._cut(vehicle, rows, *key, mine) for key, mine in groups.items()]
        self._coasting = sorted({cut.coasting for cut in self._cuts})
        self.whole = self.fold(np.eye(10 * len(vehicle.links)))

    def _cut(
        self, vehicle: VehicleModel, rows: Sequence[Projected], name: str, coasting: bool, mine: list[int]
    ) -> _Cut:
        index, beyond = vehicle.frame_id(name), vehicle.distal_links(name)
        if not beyond:
            raise UrdfError(f"nothing with mass hangs beyond {name!r}; measure elsewhere or give a link inertia")
        columns = np.zeros(10 * len(vehicle.links), bool)
        for link in beyond:
            columns[10 * link : 10 * link + 10] = True
        projection = own = np.array([rows[row].projection for row in mine])
        frame = self._model.frames[index]
        velocities = None
        for joint in vehicle.joints:
            axis = np.concatenate([[0.0] * 3, joint.axis] if joint.revolute else [joint.axis, [0.0] * 3])
            if joint.name == name and (projection == axis).all():
                velocities = np.full(len(mine), joint.v_index)
        fixed = int(frame.parentJoint) == 1
        if fixed:
            projection = projection @ frame.placement.toActionMatrix().T
            if (projection == np.eye(FREE_FLYER_NV)[np.abs(projection).argmax(axis=1)]).all():
                velocities = np.abs(projection).argmax(axis=1)
        places = None if velocities is None else _as_slice(velocities)
        place, body = frame.placement, int(frame.parentJoint) - 1  # Pinocchio's joint 1 is the base's
        at = body, np.array(place.rotation), np.array(place.translation)
        links = np.array(beyond, np.intp)
        return _Cut(index, _as_slice(np.array(mine)), places, projection, fixed, coasting, columns, links, own, *at)

    def fold(self, mix: FloatArray) -> Fold:
        """Prepare a combination of the columns for repeated evaluation.

        Args:
            mix: (10 x links, c).
        """
        without = mix.copy()
        without[self._payload] = 0.0
        held, released = (
            tuple(self._bodies @ (cut.columns[:, None] * part) for cut in self._cuts) for part in (mix, without)
        )
        return Fold(held, released, mix.shape[1])

    def make(self, fold: Fold, held: BoolArray, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """The columns of ``fold`` at n ticks, (n, rows, c) (Limparis 2.132).

        Args:
            fold: which.
            held: (n,) whether the payload is.
            q: Pinocchio's configurations, (n, nq), the base at the origin.
            v: velocities, (n, nv), the base's linear one zero.
            a: accelerations, (n, nv), the base's linear one its specific force.
        """
        out = np.empty((len(q), self._rows, fold.columns))
        for coasting in self._coasting:
            if coasting:
                a = a.copy()
                a[:, :3] = 0.0
            body, placements = self._regressors(q, v, a)
            for number, cut in enumerate(self._cuts):
                if cut.coasting != coasting:
                    continue
                if cut.velocities is not None:
                    part = body[:, cut.velocities]
                else:
                    G = cut.projection if cut.fixed else cut.projection @ placements[cut.frame]
                    part = G @ body[:, :FREE_FLYER_NV]
                if held.all():
                    out[:, cut.rows] = part @ fold.held[number]
                else:
                    made = part @ fold.released[number]
                    made[held] = part[held] @ fold.held[number]
                    out[:, cut.rows] = made
        return out

    def unit_force(self, held: BoolArray, chain: Chain) -> FloatArray:
        """The rows' response at the URDF's parameters to a unit specific force along each base axis, (n, rows, 3).

        The force on a link is its mass times that, and acts where its first moment is.

        Args:
            held: (n,) whether the payload is.
            chain: motion of links and joints; of the joints only the positions matter.
        """
        R, p, *_ = chain.links
        chi = np.repeat(self._chi.reshape(1, -1, 10), len(held), axis=0)
        chi.reshape(len(held), -1)[~held, self._payload] = 0.0
        mass = chi[..., :1]  # (n, links, 1)
        first = mass * p + times(R, chi[..., 1:4])
        out = np.zeros((len(held), self._rows, 3))
        for cut in self._cuts:
            if not cut.coasting:
                g = cut.in_base(chain)
                moment, of_mass = (part[:, cut.links].sum(axis=1)[:, None] for part in (first, mass))
                out[:, cut.rows] = of_mass * g[..., :3] + cross(g[..., 3:], moment)
        return out

    def readings(self, chi: FloatArray, held: BoolArray, chain: Chain, force: FloatArray) -> FloatArray:
        """What links of these parameters make the rows read on a base that stands, (n, rows) (Featherstone 2008).

        Args:
            chi: (10 x links,), of a body that may be or not.
            held: (n,) whether the payload is.
            chain: motion of links and joints.
            force: specific force of the base, (n, 3).
        """
        out = np.zeros((len(held), self._rows))
        inertias, payload = own_inertias(chi), self._payload.start // 10 if self._payload.stop else None
        for cut in self._cuts:
            R, p, V, A = (part[:, cut.links] for part in chain.links)
            X = force_transforms(R, p)
            back, own = X.swapaxes(-1, -2), inertias[cut.links]
            if not cut.coasting:
                A[..., :3] += force[:, None]
            V = times(back, V)
            on_each = times(X, times(own, times(back, A)) + times(crf(V), times(own, V)))  # (n, links, 6)
            on_each[:, cut.links == payload] *= held[:, None, None]
            out[:, cut.rows] = times(cut.in_base(chain), on_each.sum(axis=1))
        return out

    def _regressors(self, q: FloatArray, v: FloatArray, a: FloatArray) -> tuple[FloatArray, dict[int, FloatArray]]:
        """Pinocchio's regressor at each tick, (n, nv, 10 x bodies), and the moving cuts' matrices, (n, 6, 6) each."""
        model, data = self._model, self._data
        body = np.empty((len(q), model.nv, self._bodies.shape[0]))
        moving = [cut.frame for cut in self._cuts if cut.velocities is None and not cut.fixed]
        placements = {frame: np.empty((len(q), 6, 6)) for frame in moving}
        for tick in range(len(q)):
            body[tick] = pin.computeJointTorqueRegressor(model, data, q[tick], v[tick], a[tick])
            if moving:
                pin.forwardKinematics(model, data, q[tick])
                for frame in moving:
                    placements[frame][tick] = pin.updateFramePlacement(model, data, frame).toActionMatrix().T
        return body, placements
