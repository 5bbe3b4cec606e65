"""Columns of the links' parameters for all rows, by the compiled core (Limparis 2.115, 2.132).

A row is a component of the wrench through a cut: the sum over the links beyond it of what each needs to move as it
does, which is linear in its ten standard parameters.

Only requested combinations of columns are computed: a :class:`Fold`, made once of a matrix ``mix``, represents ``Y @
mix``. Known parameters can thus be left out of the rows or summed into one column.
"""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from onboard.dynamics.kinematics import Bodies, Chain
from onboard.dynamics.model.errors import UrdfError
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.dynamics.spatial import times
from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray, cross
from onboard.native import library


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

    rows: slice | NDArray[np.intp]
    coasting: bool
    links: IndexArray  # beyond
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

    held: tuple[FloatArray, ...]  # (10 x links beyond the cut, c) each
    released: tuple[FloatArray, ...]
    columns: int


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
        self._tree, self._rows = vehicle.tree.compiled, len(rows)
        self._chi, self._payload = vehicle.chi, vehicle.payload_columns()
        groups: dict[tuple[str, bool], list[int]] = {}
        for index, row in enumerate(rows):
            groups.setdefault((row.frame, row.coasting), []).append(index)
        self._cuts = [self._cut(vehicle, rows, *key, mine) for key, mine in groups.items()]
        self.whole = self.fold(np.eye(10 * len(vehicle.links)))

    def _cut(
        self, vehicle: VehicleModel, rows: Sequence[Projected], name: str, coasting: bool, mine: list[int]
    ) -> _Cut:
        index, beyond = vehicle.frame_id(name), vehicle.distal_links(name)
        if not beyond:
            raise UrdfError(f"nothing with mass hangs beyond {name!r}; measure elsewhere or give a link inertia")
        own = np.array([rows[row].projection for row in mine], np.float64)
        frame = vehicle.model.frames[index]
        place, body = frame.placement, int(frame.parentJoint) - 1  # Pinocchio's joint 1 is the base's
        at = body, np.array(place.rotation, order="C"), np.array(place.translation)
        return _Cut(_as_slice(np.array(mine)), coasting, np.array(beyond, np.int64), own, *at)

    def fold(self, mix: FloatArray) -> Fold:
        """Prepare a combination of the columns for repeated evaluation.

        Args:
            mix: (10 x links, c).
        """
        without = mix.copy()
        without[self._payload] = 0.0
        columns = mix.shape[1]
        held, released = (
            tuple(part.reshape(-1, 10, columns)[cut.links].reshape(-1, columns) for cut in self._cuts)
            for part in (mix, without)
        )
        return Fold(held, released, columns)

    def make(
        self, fold: Fold, held: BoolArray, q: FloatArray, dq: FloatArray, ddq: FloatArray, base: Sequence[FloatArray]
    ) -> FloatArray:
        """The columns of ``fold`` at n ticks, (n, rows, c) (Limparis 2.132).

        Args:
            fold: which.
            held: (n,) whether the payload is.
            q: joint positions, (n, joints).
            dq: joint rates, (n, joints).
            ddq: joint accelerations, (n, joints).
            base: its rate, angular acceleration and specific force, (n, 3) each.
        """
        n, joints = q.shape
        out = np.empty((n, self._rows, fold.columns))
        kept = [library.given(part, n, joints) for part in (q, dq, ddq)] + [library.given(part, n, 3) for part in base]
        moving, all_held = [library.address(part) for part in kept], bool(held.all())
        for cut, of_held, of_released in zip(self._cuts, fold.held, fold.released, strict=True):
            motion = [*moving[:-1], None if cut.coasting else moving[-1]]
            own = len(cut.own), library.address(cut.own), cut.body, library.address(cut.axes)
            beyond = library.address(cut.origin), len(cut.links), library.address(cut.links)
            part = np.empty((n, len(cut.own), 10 * len(cut.links)))
            library.call("heft_rows", ctypes.byref(self._tree), n, *motion, *own, *beyond, out=part)
            if all_held:
                out[:, cut.rows] = part @ of_held
            else:
                made = part @ of_released
                made[held] = part[held] @ of_held
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
        out, n, links = np.zeros((len(held), self._rows)), len(held), chain.links.p.shape[1]
        groups = np.zeros((len(self._cuts), 2, links))  # what hangs beyond each cut, and that without the payload
        for group, cut in zip(groups, self._cuts, strict=True):
            group[:, cut.links] = 1.0
        groups[:, 1, self._payload.start // 10 : self._payload.stop // 10] = 0.0
        none, thrust = np.zeros((n, 6)), np.hstack([force, np.zeros_like(force)])
        for coasting in {cut.coasting for cut in self._cuts}:
            moved = Bodies.of(chain.links, chi, none, none if coasting else thrust)
            beyond = moved.sums(groups.reshape(-1, links)).wrench.reshape(n, -1, 2, 6)
            for k, cut in enumerate(self._cuts):
                if cut.coasting == coasting:
                    on = np.where(held[:, None], beyond[:, k, 0], beyond[:, k, 1])
                    out[:, cut.rows] = times(cut.in_base(chain), on)
        return out
