"""Payload from rows: mass, centre of mass, inertia about it, with intervals, where determined.

The rows are linear in the standard parameters; the intervals of the non-linear quantities are linearised at the
estimate (:func:`onboard.dynamics.model.payload.body_jacobian`). An estimate that no body has, as of a light payload
whose inertia the rows hardly tell, is moved to the most likely one that can exist; how far a quantity was moved is a
part of its sigma.
"""

from collections.abc import Sequence

import numpy as np

from onboard.dynamics.model.errors import SignalError
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import body_jacobian, body_of, numbers_of, possible_body
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.policy import HALF
from onboard.estimation.recursive.consistency import JackknifeEstimate
from onboard.identification.corrections import refused_from
from onboard.identification.quantities import BODY, BODY_UNITS, SUPPORTED_FREEDOM, SUPPORTED_SHRINKAGE, QuantityEstimate
from onboard.identification.rows.stated_errors.drawing import Unstated
from onboard.regressor.base_parameters import BaseParameters
from onboard.regressor.rows import RowModel


class GraspedPayload:
    """The payload of rows that determine all ten of its parameters.

    Args:
        model: the rows; their vehicle has a payload link.
        base: their base parameters.

    Attributes:
        names: of the ten answers: ``m_<link>``, ``c_x_<link>`` .., ``I_xx_<link>`` ..

    Raises:
        SignalError: no payload link, or rows that can never tell its ten parameters, whatever the motion.
    """

    def __init__(self, model: RowModel, base: BaseParameters) -> None:
        link, columns = model.vehicle.spec.payload_link, model.vehicle.payload_columns()
        if link is None:
            raise SignalError("the vehicle has no payload link; name it in its specification")
        self.names = tuple(f"{name}_{link}" for name in BODY)
        self._w = base.weights(np.eye(len(model.names))[columns])  # (10, p)

    def weights(self, jackknife: JackknifeEstimate) -> FloatArray:
        """Derivative of the ten quantities by the base parameters, (10, p); NaN without a positive mass."""
        mean = self._w @ jackknife.mean
        return body_jacobian(mean) @ self._w if mean[0] > 0.0 else np.full_like(self._w, np.nan)

    def body(self, jackknife: JackknifeEstimate) -> RigidBody | None:
        """The likeliest body that can exist; None where there is none, or none was found."""
        mean = self._w @ jackknife.mean
        if not mean[0] > 0.0:
            return None
        try:
            return possible_body(mean, self._w @ jackknife.covariance @ self._w.T)
        except ConvergenceError:
            return None

    def quantities(
        self,
        jackknife: JackknifeEstimate,
        prior_covariance: FloatArray,
        unstated: Unstated,
        why: str,
        saturated: float = 0.0,
    ) -> tuple[QuantityEstimate, ...]:
        """The ten with two-sided intervals, in the payload link's frame.

        Each is supported when the data and not the prior determine it, the inertia only where the centre of mass is,
        and none of them when rows contradict each other.

        Args:
            jackknife: the estimate of the base parameters.
            prior_covariance: of the base parameters before the rows, (p, p).
            unstated: what errors that no key states do to the base parameters; part of the intervals.
            why: none of them is supported; empty if they may be.
            saturated: share of the rows, left out for that.
        """
        standard = jackknife.combination(self._w)
        shrinkage = standard.sigma / np.sqrt(np.einsum("ri,ij,rj->r", self._w, prior_covariance, self._w))
        weak = (shrinkage > SUPPORTED_SHRINKAGE) | (standard.degrees_of_freedom < SUPPORTED_FREEDOM)
        if not why and (weak[0] or standard.low[0] <= 0.0):
            remedy = "move more, or against gravity"
            if saturated > 0.5:
                remedy = f"{saturated:.0%} of the readings are beyond the capacity of their cells"
            why = f"the data do not determine a mass apart from zero; {remedy}"
            if not weak[0] and standard.high[0] < 0.0:
                mass = f"its mass would be {standard.low[0]:.3g} to {standard.high[0]:.3g} kg"
                why = f"{mass}: a recording without it comes first, and signs are those of what holds the links"
        if why:
            return tuple(
                QuantityEstimate(name, unit, np.nan, np.nan, np.nan, np.nan, False, shrinkage=float(s), note=why)
                for name, unit, s in zip(self.names, BODY_UNITS, shrinkage, strict=True)
            )
        weak[4:] |= weak[1:4].any()
        along = self.weights(jackknife)
        found, estimated = jackknife.combination(along), numbers_of(body_of(standard.mean))
        possible = self.body(jackknife)
        value = estimated if possible is None else numbers_of(possible)
        weak[4:] |= possible is None
        unsaid = unstated.sigma(along)
        known = np.hypot(found.sigma, unsaid)
        half = np.hypot(0.5 * (found.high - found.low), HALF * unsaid)
        sigma = np.hypot(known, value - estimated)
        half *= sigma / known
        numbers = np.column_stack([value, sigma, value - half, value + half])
        numbers[weak] = np.nan
        said = ["not determined by the data so far" if lost else "" for lost in weak]
        each = zip(self.names, BODY_UNITS, numbers.tolist(), shrinkage.tolist(), weak, said, strict=True)
        told = (
            QuantityEstimate(name, unit, of[0], of[1], of[2], of[3], not lost, shrinkage=s, note=note)
            for name, unit, of, s, lost, note in each
        )
        return tuple(one.as_far(far) for one, far in zip(told, found.far.tolist(), strict=True))


def contradiction(names: Sequence[str], jackknife: JackknifeEstimate, prior: FloatArray, covariance: FloatArray) -> str:
    """Reason why rows and a prior that holds, (p,) and (p, p), contradict each other; empty if they do not."""
    moved = np.abs(jackknife.mean - prior) / np.sqrt(np.diag(covariance))
    worst = int(moved.argmax())
    if moved[worst] <= refused_from(len(moved)):
        return ""
    off = f"{names[worst]} is {moved[worst]:.0f} prior sigmas off"
    return f"the rows contradict what was known: {off}; check sensors and prior"


def grasped_payload(model: RowModel, base: BaseParameters) -> GraspedPayload | None:
    """The payload of these rows; None without a payload link or if the rows cannot determine all of it."""
    try:
        return GraspedPayload(model, base)
    except SignalError:
        return None
