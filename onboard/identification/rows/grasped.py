"""What an identifier says of the payload: mass, centre of mass, inertia, each with its interval or not at all.

The rows are linear in the standard parameters, the answer is not: its intervals are those of the combinations of
standard parameters that it changes with, at the estimate.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.dynamics.errors import UnknownFrameError
from onboard.dynamics.inertia import RigidBody, elements
from onboard.dynamics.payload import body_jacobian, body_of
from onboard.estimation.arrays import FloatArray
from onboard.estimation.gates import GateReason
from onboard.identification.quantities import SUPPORTED_FREEDOM, SUPPORTED_SHRINKAGE
from onboard.identification.rows.identifier import Identifier

NAMES = ("mass", "x", "y", "z", "XX", "XY", "YY", "XZ", "YZ", "ZZ")  # kg, m, kg m^2 about the centre of mass
MOST_REFUSED = 0.05  # of the rows; beyond, rows and model contradict each other
FARTHEST = 5.0  # prior sigmas that a parameter may move; beyond, the rows contradict what was known


class Grasped(NamedTuple):
    """The payload as far as the rows determine it, NaN where they do not; each array (10,), ordered as ``NAMES``."""

    value: FloatArray
    sigma: FloatArray
    low: FloatArray
    high: FloatArray
    supported: NDArray[np.bool_]
    reason: str  # why something is not supported; empty where all is

    @property
    def body(self) -> RigidBody:
        """As a body in the payload link's frame; NaN where not supported."""
        xx, xy, yy, xz, yz, zz = self.value[4:]
        return RigidBody(float(self.value[0]), self.value[1:4], np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def grasped(identifier: Identifier, level: float = 0.95) -> Grasped:
    """The payload with two-sided intervals.

    Args:
        identifier: after its rows.
        level: of the intervals.

    Raises:
        UnknownFrameError: the vehicle has no payload link.
        SignalError: the rows can never tell the payload's ten parameters, whatever the motion.
    """
    model, base = identifier.model, identifier.base
    columns = model.vehicle.payload_columns()
    if columns.stop == 0:
        raise UnknownFrameError("the vehicle has no payload link; name one in its specification")
    w = base.weights(np.eye(len(model.names))[columns])  # (10, p)
    honest = identifier.honest(level)
    standard = honest.combination(w)
    prior = np.linalg.inv(identifier.rls.prior_equations()[0])  # (p, p)
    before = np.sqrt(np.einsum("ri,ij,rj->r", w, prior, w))
    weak = (standard.sigma > SUPPORTED_SHRINKAGE * before) | (standard.degrees_of_freedom < SUPPORTED_FREEDOM)
    nothing, never = np.full(10, np.nan), np.zeros(10, bool)
    why = _contradiction(identifier, (honest.mean - base.value(model.chi)) / np.sqrt(np.diag(prior)))
    if not why and (weak[0] or standard.low[0] <= 0.0):
        why = "the data do not determine a mass apart from zero; move more, or against gravity"
    if why:
        return Grasped(nothing, nothing, nothing, nothing, never, why)
    mean = standard.mean
    found = honest.combination(body_jacobian(mean) @ w)
    half = 0.5 * (found.high - found.low)
    body = body_of(mean)
    value = np.concatenate([[body.mass_kg], body.centre_of_mass_m, elements(body.inertia_kg_m2)])
    supported = ~weak
    supported[4:] &= not weak[1:4].any()
    mask = np.where(supported, 1.0, np.nan)
    lost = ", ".join(name for name, fine in zip(NAMES, supported, strict=True) if not fine)
    reason = f"the motion does not determine {lost}" if lost else ""
    return Grasped(value * mask, found.sigma * mask, (value - half) * mask, (value + half) * mask, supported, reason)


def _contradiction(identifier: Identifier, moved: FloatArray) -> str:
    """Why rows, or rows and prior, cannot all be right; empty if they can. ``moved``: prior sigmas, (p,)."""
    refused, used = identifier.refused[GateReason.RESIDUAL], identifier.rows_used
    if refused > MOST_REFUSED * (used + refused):
        return f"{refused} of {used + refused} rows contradict the others; check the sensors against each other"
    worst = int(np.abs(moved).argmax())
    if abs(moved[worst]) > FARTHEST:
        name, size = identifier.base.names[worst], abs(moved[worst])
        return f"the rows contradict what was known: {name} is {size:.0f} prior sigmas off; check sensors and prior"
    return ""
