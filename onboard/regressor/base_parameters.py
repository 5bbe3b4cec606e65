"""Structural base parameters: the identifiable combinations of standard parameters of a vehicle's rows.

Recursive least squares uses these instead of the standard parameters: the columns are independent for general motion,
so a direction undetermined in flight means a lack of excitation; the matrices are small; and no prior hides a
structural rank deficiency. A Gaussian prior on the standard parameters maps to the base parameters exactly.

Method: QR with column pivoting on rows sampled over random motion gives the rank (Gautier 1991; Limparis 2.123-2.128).
The independent columns are then chosen in the customary order (rotational inertia and first moments near the base
first; ``YY``, ``MZ`` and ``M`` are regrouped, as by Gautier and Khalil 1990), and the others are expressed through
them.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq, qr

from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.errors import SignalError, UnknownFrameError
from onboard.dynamics.model.vehicle import STANDARD_GRAVITY_M_S2
from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.regressor.rows import BaseMotion, RowModel

Vector3 = tuple[float, float, float]

_KEPT_FIRST = ("ZZ", "XX", "XY", "XZ", "YZ", "MX", "MY", "bias", "Ia", "Fv", "Fc", "zero")
_OF_INSTRUMENTS = ("bias_", "zero_force_")
_TOLERANCE = 1e-9  # relative to a column's norm


@dataclass(frozen=True, slots=True)
class SampledMotion:
    """Base motions that may occur; a zero removes one, and with it the parameters that only it excites."""

    rate_rad_s: float | Vector3 = 1.0
    acceleration_rad_s2: float | Vector3 = 1.0
    specific_force_m_s2: float | Vector3 = 1.0
    constant_force_m_s2: Vector3 = (0.0, 0.0, 0.0)

    @classmethod
    def of(cls, kind: BaseKind, gravity_m_s2: Vector3 = (0.0, 0.0, -STANDARD_GRAVITY_M_S2)) -> "SampledMotion":
        """General motion of a base of this kind; gravity in base axes, for those that it is constant in."""
        x, y, z, roll, pitch, yaw = (float(k in kind.moves) for k in range(6))
        turns, (g_x, g_y, g_z) = (roll, pitch, yaw), gravity_m_s2
        return cls(turns, turns, (x, y, z), (-g_x, -g_y, -g_z) if kind.in_gravity else (0.0, 0.0, 0.0))


@dataclass(frozen=True)
class BaseParameters:
    """Map from standard to base parameters: ``beta = grouping @ chi``, ``Y chi = Y[:, independent] @ beta`` (2.128).

    Attributes:
        names: names of the base parameters; the suffix ``_R`` marks a regrouped one.
        independent: (p,) their columns in the standard regressor.
        grouping: (p, P).
        standard_names: (P,).
    """

    names: tuple[str, ...]
    independent: NDArray[np.intp]
    grouping: FloatArray
    standard_names: tuple[str, ...]

    @property
    def of_bodies(self) -> BoolArray:
        """Which are of bodies and joints, not of an instrument, (p,)."""
        return np.array([not name.startswith(_OF_INSTRUMENTS) for name in self.names], np.bool_)

    def value(self, chi: FloatArray) -> FloatArray:
        """Base parameters ``grouping @ chi``, (p,), of standard ones, (P,)."""
        return np.asarray(self.grouping @ chi, np.float64)

    def covariance(self, root: FloatArray) -> FloatArray:
        """Covariance ``G L L' G'`` of the base parameters, (p, p), of that of the standard ones, ``L L'``, (P, P)."""
        half = self.grouping @ root
        return np.asarray(half @ half.T, np.float64)

    def weights(self, functional: FloatArray) -> FloatArray:
        """A linear functional of the standard parameters, (..., P), as weights on the base parameters, (..., p).

        Raises:
            SignalError: the functional is not a combination of base parameters, so no motion can determine it.
        """
        wanted = np.atleast_2d(functional)
        found = lstsq(self.grouping.T, wanted.T)[0].T
        error = np.abs(found @ self.grouping - wanted).max()
        if error > 1e-6 * max(np.abs(wanted).max(), 1e-300):
            raise SignalError("this quantity is not a combination of base parameters; these rows cannot determine it")
        return np.asarray(found.reshape((*functional.shape[:-1], len(self.names))), np.float64)


def sampled_rows(
    model: RowModel, rng: np.random.Generator, ticks: int, motion: SampledMotion, released: bool
) -> FloatArray:
    """Rows of random motion (Limparis 2.123), (ticks x rows, P), every other tick ``released`` from the payload."""
    vehicle = model.vehicle
    low = np.array([max(joint.low, -np.pi) for joint in vehicle.joints])
    high = np.array([min(joint.high, np.pi) for joint in vehicle.joints])
    shape = (ticks, len(vehicle.joints))
    q = rng.uniform(low, high, shape)
    base = BaseMotion(
        np.asarray(motion.rate_rad_s) * rng.standard_normal((ticks, 3)),
        np.asarray(motion.acceleration_rad_s2) * rng.standard_normal((ticks, 3)),
        np.asarray(motion.specific_force_m_s2) * rng.standard_normal((ticks, 3)) + motion.constant_force_m_s2,
    )
    attached = np.arange(ticks) % 2 == 0 if released else None
    dq, ddq = rng.standard_normal(shape), rng.standard_normal(shape)
    Y = model.regressor(q, dq, ddq, base, attached)
    return Y.reshape(-1, Y.shape[2])


def base_parameters(
    model: RowModel,
    rng: np.random.Generator,
    motion: SampledMotion | None = None,
    released: bool | None = None,
    known: NDArray[np.bool_] | None = None,
) -> BaseParameters:
    """Finds the base parameters of a row model (Gautier 1991; Limparis 2.123-2.128).

    Args:
        model: the rows.
        rng: seeded, so that the names are reproducible.
        motion: base motions that may occur; default: all that the base kind allows.
        released: whether there are also rows without the payload; default: if there is a payload link.
        known: (P,) columns with exactly known parameters, left out of the base parameters.

    Raises:
        SignalError: the rows depend on no parameter.
    """
    vehicle = model.vehicle
    allowed = SampledMotion.of(vehicle.spec.base, vehicle.spec.gravity_m_s2) if motion is None else motion
    let_go = vehicle.spec.payload_link is not None if released is None else released
    W = sampled_rows(model, rng, 5 * len(model.names) + 20, allowed, let_go)
    if known is not None:
        W[:, known] = 0.0
    norms = np.sqrt(np.einsum("ij,ij->j", W, W))
    norms[norms < _TOLERANCE * norms.max()] = 0.0  # columns that are zero but for rounding
    if not (norms > 0.0).any():
        raise SignalError("no parameter moves these rows; check the frames they are measured at")
    scaled = W / np.where(norms > 0.0, norms, 1.0)
    diagonal = np.abs(np.diag(qr(scaled, mode="r", pivoting=True)[0]))
    rank = int((diagonal > _TOLERANCE * diagonal[0] * np.sqrt(scaled.shape[1])).sum())
    independent = _choose(scaled, rank, _preference(model.names))
    grouping = grouping_of(W, independent)
    names = tuple(
        model.names[column] + ("_R" if np.count_nonzero(grouping[row]) > 1 else "")
        for row, column in enumerate(independent)
    )
    for array in (independent, grouping):
        array.setflags(write=False)
    return BaseParameters(names, independent, grouping, model.names)


def grouping_of(W: FloatArray, independent: NDArray[np.intp]) -> FloatArray:
    """The map from standard to base parameters, (p, P), for given independent columns (Limparis 2.127, 2.128).

    Args:
        W: rows of general motion, (r, P).
        independent: (p,) columns that span all others.
    """
    columns = W.shape[1]
    norms = np.sqrt(np.einsum("ij,ij->j", W[:, independent], W[:, independent]))
    dependent = np.setdiff1d(np.arange(columns), independent)
    grouping = np.zeros((independent.size, columns))
    grouping[np.arange(independent.size), independent] = 1.0
    if dependent.size:  # LAPACK refuses a right side without columns
        K = lstsq(W[:, independent] / norms, W[:, dependent])[0] / norms[:, None]
        K[np.abs(K) < 1e-9] = 0.0
        grouping[:, dependent] = K
    return grouping


def _preference(names: tuple[str, ...]) -> list[int]:
    """Columns in order of preference as independent ones."""
    kinds = [name.split("_", 1)[0] for name in names]
    first = [column for column, kind in enumerate(kinds) if kind in _KEPT_FIRST]
    # Within a link, in the order of _KEPT_FIRST; links stay in their order.
    owners = [name.split("_", 1)[1] for name in names]
    order = list(dict.fromkeys(owners))
    first.sort(key=lambda c: (order.index(owners[c]), _KEPT_FIRST.index(kinds[c])))
    return first + [column for column in range(len(names)) if column not in first]


def _choose(scaled: FloatArray, rank: int, order: list[int]) -> NDArray[np.intp]:
    """The first ``rank`` columns, in the preferred order, that are independent of those before them; Gram-Schmidt."""
    basis = np.zeros((scaled.shape[0], rank))
    chosen: list[int] = []
    for column in order:
        if len(chosen) == rank:
            break
        v = scaled[:, column].copy()
        for _ in range(2):  # reorthogonalisation: twice is enough
            v -= basis @ (basis.T @ v)
        length = np.sqrt(v @ v)
        if length > 1e-7:
            basis[:, len(chosen)] = v / length
            chosen.append(column)
    return np.array(sorted(chosen), np.intp)


def named_relative_sigma(model: RowModel, links: Mapping[str, float], extras: Mapping[str, float]) -> FloatArray:
    """Prior sigmas of all columns, (P,): by link relative to the URDF, by name absolute for the extra columns.

    Args:
        model: gives the columns.
        links: relative sigma by link (:meth:`Vehicle.parameter_sigma`).
        extras: absolute sigma by column name, in the column's SI unit: every extra column (``bias_<row>``,
            ``Fv_<joint>`` ...), and any link's own (``M_body``) that is known otherwise than the rest of its link.

    Raises:
        UnknownFrameError: a name that is missing or unknown.
        SignalError: a sigma that is negative or not finite.
    """
    own = model.vehicle.parameter_sigma(dict(links))
    expected = model.names[own.size :]
    if not set(expected) <= set(extras) <= set(model.names):
        raise UnknownFrameError(
            f"give a sigma for each of {', '.join(expected) or 'no extra column'}, and else for columns of links only"
        )
    wrong = [name for name, value in extras.items() if not 0.0 <= value < np.inf]
    if wrong:
        raise SignalError(f"the sigma of {', '.join(wrong)} is negative or not finite; give zero or more")
    sigma = np.concatenate([own, np.zeros(len(expected))])
    for name, value in extras.items():
        sigma[model.names.index(name)] = value
    return sigma
