"""What an estimate by rows takes from calibrations and from the drawing, and the drawing as a witness of calibrations.

The scale of the only cell on a joint, and that of the joint's only encoder, change every inertia alike: no motion shows
them. What shows them is a link whose mass is known from the drawing.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import DOUBLINGS, HALF, MOSTLY, ODDS
from onboard.estimation.recursive.consistency import JackknifeEstimate
from onboard.identification.corrections import doubtful_from, refused_from
from onboard.identification.quantities import SUPPORTED_SHRINKAGE, Leaning, Quantity, QuantityEstimate
from onboard.identification.rows.row_blocks import RowBlocks
from onboard.identification.rows.stated_errors.considered import Considered

_SCALES = ("scale", "joint_scale", "gyro_scale", "accelerometer_scale")


def leans_on(
    considered: Sequence[Considered],
    effects: FloatArray,
    mean: float,
    sigma: float,
    leanings: Sequence[Leaning],
    parameters: FloatArray,
) -> str:
    """Calibrations and parts of the drawing that a quantity depends on and no instrument checks; empty if none.

    Args:
        considered: k considered parameters.
        effects: of one sigma of each on the quantity, (k,).
        mean: the quantity.
        sigma: of the quantity.
        leanings: on the drawing.
        parameters: base parameters, (p,).
    """
    said = []
    for cause, effect in zip(considered, np.abs(effects).tolist(), strict=True):
        stands_with_it = cause.effect in _SCALES and cause.sigma and effect > MOSTLY * cause.sigma * abs(mean)
        if stands_with_it or effect > SUPPORTED_SHRINKAGE * sigma:
            said.append(cause.stated)
    parts = [(abs(float(leaning.weights @ parameters)), leaning.cause) for leaning in leanings]
    if parts and max(parts)[0] > SUPPORTED_SHRINKAGE * sigma:
        said.append(max(parts)[1])
    return f"leans on {', '.join(dict.fromkeys(said))}" if said else ""


def answered(
    quantity: Quantity,
    numbers: FloatArray,
    fine: bool,
    effects: FloatArray,
    considered: Sequence[Considered],
    parameters: FloatArray,
) -> QuantityEstimate:
    """A quantity with what it takes from the drawing.

    Args:
        quantity: that was asked for.
        numbers: mean, sigma, low, high by rows and calibrations, and posterior over prior sigma, (5,).
        fine: whether the data determine it.
        effects: of one sigma of each considered parameter on it, (k,).
        considered: k considered parameters.
        parameters: base parameters, (p,).
    """
    mean, sigma, low, high = numbers[:4].tolist() if fine else [np.nan] * 4
    note = quantity.note if fine else "not determined by the data so far"
    drawn = float(np.hypot.reduce([one.weights @ parameters for one in quantity.leanings], initial=0.0))
    if fine:
        wide = float(np.hypot(high - mean, HALF * drawn))
        sigma, low, high = float(np.hypot(sigma, drawn)), mean - wide, mean + wide
    leans = leans_on(considered, effects, mean, sigma, quantity.leanings, parameters)
    told = quantity.name, quantity.unit, mean, sigma, low, high, fine
    shrinkage = float(numbers[4])
    return QuantityEstimate(*told, leans=leans if fine else "", shrinkage=shrinkage, note=note, drawn=drawn)


class Unstated(NamedTuple):
    """Errors that no key states, by what they do to the estimate: one sigma each."""

    steps: FloatArray  # (s, p) suspected steps of gains
    scales: FloatArray  # (h, p) scales off the drawing, of which one is wrong

    @classmethod
    def of(cls, steps: Sequence[FloatArray], scales: FloatArray) -> "Unstated":
        """Steps, (p,) each, and scales, (h, p)."""
        return cls(np.array(steps).reshape(len(steps), scales.shape[1]), scales)

    def sigma(self, weights: FloatArray) -> FloatArray:
        """Of ``weights @ chi``, (r,) of (r, p)."""
        largest = np.abs(weights @ self.scales.T).max(axis=1, initial=0.0)
        return np.asarray(np.hypot.reduce([largest, *(weights @ self.steps.T).T]), np.float64)

    def covariance(self) -> FloatArray:
        """Of the estimate, (p, p)."""
        return np.asarray(self.steps.T @ self.steps + self.scales.T @ self.scales, np.float64)


def unstated(
    quantities: Sequence[Quantity], jackknife: JackknifeEstimate, blocks: RowBlocks, body: FloatArray, prior: FloatArray
) -> FloatArray:
    """What a scale that no key states does to the estimate, (h, p): one sigma for each way in which it can be wrong.

    Where the known mass is not the drawing's, a scale of an instrument may be what is wrong: of all rows, or only of
    those without the payload, as after a jump. It is taken so large that it explains what is beyond the expected
    difference (half of an interval), and moves every inertia, which by its own rows is known much better, and every
    mass. ``h`` is zero where the drawing agrees.

    Args:
        quantities: those that the drawing knows are looked at.
        jackknife: the estimate.
        blocks: its rows.
        body: the estimate's parameters of bodies, (p,).
        prior: information on the parameters before the rows, (p, p).
    """
    found = list[FloatArray]()
    for quantity in quantities:
        if quantity.known is None:
            continue
        off = _off(quantity, jackknife)
        if off.sigmas <= HALF:
            continue
        beyond = abs(off.found - off.drawn) * np.sqrt(1.0 - (HALF / off.sigmas) ** 2)
        of_part = {part: blocks.of(*part)[0][:, :-2, :-2].sum(axis=0) for part in blocks.parts}
        every = prior + sum(of_part.values())
        unit = 1.0 / np.sqrt(np.diag(every))
        for wrong in (of_part.values(), [H for (held, _), H in of_part.items() if not held]):
            rows = np.asarray(sum(wrong, np.zeros_like(every)) @ body, np.float64)
            moved = np.linalg.solve(every * np.outer(unit, unit), rows * unit) * unit
            lever = float(quantity.weights @ moved)
            if abs(lever) > MOSTLY * abs(off.found):
                found.append(moved * beyond / lever)
    return np.array(found).reshape(len(found), body.size)


def off_drawing(quantities: Sequence[Quantity], jackknife: JackknifeEstimate) -> float:
    """Sum of squares of sigmas between what the drawing knows and what was found; zero of what is not determined.

    It is no more than what makes it likelier that an instrument's scale or the drawing is wrong, by their odds.
    """
    every = [_off(quantity, jackknife).sigmas for quantity in quantities if quantity.known is not None]
    return min(float(sum(sigmas**2 for sigmas in every if np.isfinite(sigmas))), -2.0 * float(np.log(ODDS)))


def judged_drawing(
    quantity: Quantity, jackknife: JackknifeEstimate, considered: Sequence[Considered]
) -> tuple[list[str], list[str]]:
    """Reasons to refuse all estimates, and reasons to weaken them: a mass that is not the drawing's.

    Args:
        quantity: with what is known of it.
        jackknife: the estimate.
        considered: which scales may be wrong.
    """
    if quantity.known is None:
        return [], []
    found, drawn, away = _off(quantity, jackknife)
    if away < doubtful_from(1):
        return [], []
    names = [cause.key for cause in considered if cause.effect in ("scale", "joint_scale")]
    check = f": check {', '.join(names)}" if names else ""
    said = f"{quantity.name} is {found:.3g} {quantity.unit}, drawn {drawn:.3g} ({away:.0f} sigmas off){check}"
    return ([said], []) if away > refused_from(DOUBLINGS) else ([], [said])


class _Off(NamedTuple):
    found: float
    drawn: float
    sigmas: float


def _off(quantity: Quantity, jackknife: JackknifeEstimate) -> _Off:
    """A mass that the drawing knows: found, drawn, and how far the one is from the other."""
    assert quantity.known is not None
    drawn, tolerance = quantity.known
    interval = jackknife.combination(quantity.weights)
    shape = [float(one.weights @ jackknife.mean) for one in quantity.leanings]
    found = float(interval.mean[0])
    return _Off(found, drawn, abs(found - drawn) / float(np.hypot.reduce([interval.sigma[0], tolerance, *shape])))
