"""Columns of the links' parameters for all rows at many ticks, by spatial algebra (Limparis 2.115, 2.132).

The wrench through a cut is the sum over the links beyond it, and a link's is linear in its ten parameters: in its own
axes, ``momentum of A + V x* momentum of V``, with V and A its twist and that twist's rate of change (Featherstone,
Rigid Body Dynamics Algorithms, 2008, chapter 2). Projected on ``g``, a row of the cut moved to the link as a twist is,

    row = sum of (g A' - (V x g) V') [i, t] M [i, t],

M the constant columns of a momentum. A combination of columns thus needs the products in brackets, 36 numbers a link,
times one matrix.

Only requested combinations of columns are computed: a :class:`Fold`, made once of a matrix ``mix``, represents ``Y @
mix``. Known parameters can thus be left out of the rows or summed into one column.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from onboard.dynamics.errors import UrdfError
from onboard.dynamics.kinematics import Chain, cross
from onboard.dynamics.spatial import MOMENTUM, force_transforms, times
from onboard.dynamics.vehicle import VehicleModel
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

    rows: list[int]
    projection: FloatArray  # (rows here, 6) on the wrench (force, moment) at the frame, in its axes
    body: int  # that the frame is fixed to
    axes: FloatArray  # (3, 3) the frame's in that body's
    origin: FloatArray  # (3,)
    coasting: bool
    links: IndexArray  # beyond

    def in_base(self, chain: Chain) -> FloatArray:
        """On the wrench about the base's origin, base axes, (n, rows here, 6)."""
        on, at = chain.axes[:, self.body], chain.origins[:, self.body]
        R = (on @ self.axes)[:, None]
        force, moment = times(R, self.projection[:, :3]), times(R, self.projection[:, 3:])
        force += cross((at + times(on, self.origin))[:, None], moment)
        return np.concatenate([force, moment], axis=-1)


class Fold(NamedTuple):
    """Prepared combination ``Y[:, links] @ mix``: one matrix per cut, with and without the payload."""

    held: tuple[FloatArray, ...]  # (36 x links beyond, c) each
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
        self._rows, self._chi, self._payload = len(rows), vehicle.chi, vehicle.payload_columns()
        groups: dict[tuple[str, bool], list[int]] = {}
        for index, row in enumerate(rows):
            groups.setdefault((row.frame, row.coasting), []).append(index)
        self._cuts = [self._cut(vehicle, rows, *key, mine) for key, mine in groups.items()]
        self.whole = self.fold(np.eye(10 * len(vehicle.links)))

    @staticmethod
    def _cut(vehicle: VehicleModel, rows: Sequence[Projected], name: str, coasting: bool, mine: list[int]) -> _Cut:
        frame, beyond = vehicle.model.frames[vehicle.frame_id(name)], vehicle.distal_links(name)
        if not beyond:
            raise UrdfError(f"nothing with mass hangs beyond {name!r}; measure elsewhere or give a link inertia")
        projection, place = np.array([rows[row].projection for row in mine]), frame.placement
        body = int(frame.parentJoint) - 1  # Pinocchio's joint 1 is the base's
        axes, origin = np.array(place.rotation), np.array(place.translation)
        return _Cut(mine, projection, body, axes, origin, coasting, np.array(beyond, np.intp))

    def fold(self, mix: FloatArray) -> Fold:
        """Prepare a combination of the columns for repeated evaluation.

        Args:
            mix: (10 x links, c).
        """
        without = mix.copy()
        without[self._payload] = 0.0
        columns = mix.shape[1]
        held, released = (
            tuple((_PRODUCTS @ part.reshape(-1, 10, columns)[cut.links]).reshape(-1, columns) for cut in self._cuts)
            for part in (mix, without)
        )
        return Fold(held, released, columns)

    def make(
        self, fold: Fold, held: BoolArray, chain: Chain, rate: FloatArray, acceleration: FloatArray, force: FloatArray
    ) -> FloatArray:
        """The columns of ``fold`` at n ticks, (n, rows, c) (Limparis 2.132).

        Args:
            fold: which.
            held: (n,) whether the payload is.
            chain: motion of links and joints relative to the base.
            rate: of the base, in its axes as what follows, (n, 3).
            acceleration: angular.
            force: specific force at the base's origin.
        """
        n, (R, p, V, A) = len(held), chain.links
        X = force_transforms(R, p)  # (n, links, 6, 6)
        turns = rate[:, None]
        moves = A.copy()  # and what the base's rate, and what is added, do to it
        moves[..., :3] += cross(turns, V[..., :3])
        moves[..., 3:] += cross(turns, V[..., 3:]) + acceleration[:, None]
        twists = V.copy()
        twists[..., 3:] += turns
        out = np.empty((n, self._rows, fold.columns))
        for cut, with_it, without in zip(self._cuts, fold.held, fold.released, strict=True):
            rows, links = len(cut.rows), cut.links
            change = moves[:, links]
            if not cut.coasting:
                change[..., :3] += force[:, None]
            seen = np.broadcast_to(cut.in_base(chain)[:, None], (n, len(links), rows, 6))
            own = np.concatenate([twists[:, links, None], change[:, :, None], seen], axis=2) @ X[:, links]
            twist, change, seen = own[:, :, :1], own[:, :, 1:2], own[:, :, 2:]
            turned = np.empty_like(seen)  # V x g
            turned[..., :3] = cross(twist[..., 3:], seen[..., :3]) + cross(twist[..., :3], seen[..., 3:])
            turned[..., 3:] = cross(twist[..., 3:], seen[..., 3:])
            products = seen[..., None] * change[..., None, :] - turned[..., None] * twist[..., None, :]
            part = products.reshape(n, len(links), rows, 36).swapaxes(1, 2).reshape(n, rows, -1)
            if held.all():
                out[:, cut.rows] = (part.reshape(n * rows, -1) @ with_it).reshape(n, rows, -1)
            else:
                for which, matrix in ((held, with_it), (~held, without)):
                    out[np.flatnonzero(which)[:, None], cut.rows] = part[which] @ matrix
        return out

    def unit_force(self, held: BoolArray, chain: Chain) -> FloatArray:
        """The rows' response at the URDF's parameters to a unit specific force along each base axis, (n, rows, 3)."""
        R, p, *_ = chain.links
        chi = np.repeat(self._chi.reshape(1, -1, 10), len(held), axis=0)
        chi.reshape(len(held), -1)[~held, self._payload] = 0.0
        mass = chi[..., :1]  # (n, links, 1)
        first = mass * p + times(R, chi[..., 1:4])
        out = np.zeros((len(held), self._rows, 3))
        for cut in self._cuts:
            if not cut.coasting:
                g = cut.in_base(chain)
                beyond = first[:, cut.links].sum(axis=1)[:, None], mass[:, cut.links].sum(axis=1)[:, None]
                out[:, cut.rows] = beyond[1] * g[..., :3] + cross(g[..., 3:], beyond[0])
        return out


_PRODUCTS = MOMENTUM.swapaxes(0, 1).reshape(36, 10)
