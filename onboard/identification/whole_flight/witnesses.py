"""Do a flight's instruments agree: the tests of its fit, and which single instrument contradicts the others.

Where the fit of all instruments fails a test, it is made once more without each of them, the first IMU too. If exactly
one of these fits passes every test, the instrument that it is without is the one that is wrong, and the answer is made
from the rest. If several do, two instruments contradict each other and nothing tells which of them is wrong; if none
does, the joints or the model may be. Both answers are refused.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.errors import ModelError
from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import EstimationError
from onboard.estimation.policy import DOUBT, MISFIT_DOUBTED, MISFIT_REFUSED, REFUSE, chance_text, of_each
from onboard.identification.corrections import contradicted, expected_sigma, too_large
from onboard.identification.quantities import Findings
from onboard.identification.whole_flight.blocks import FlightFit
from onboard.identification.whole_flight.fit import WholeFlight
from onboard.identification.whole_flight.parts import differences
from onboard.identification.whole_flight.stated import CorrectionKind, bodies_of, kinds_of

_STAGES_s = (8.0,)  # part of each segment that is fitted first: most fits without an instrument get nowhere
_NOT_AS_STATED = 1e-3, 1e-4
"""Chance at which a kind of correction is doubted: of the first IMU, of further instruments. More than the budget gives
each of thirty, as it has the flight fitted without each instrument: at 3e-4 an accelerometer that is 3 % off was not
separated from the load cell."""


class Tested(NamedTuple):
    """A fit and what its tests say."""

    flight: WholeFlight
    found: FlightFit
    kinds: tuple[CorrectionKind, ...]  # of corrections, the least likely first
    corrections: Mapping[str, float]  # of the first IMU and what else is no link's or joint's, in stated sigmas
    of_bodies: Mapping[str, float]  # of links and joints, in sigmas of what the flight tells of each
    findings: Findings

    def plus(self, against: Iterable[str] = (), doubts: Iterable[str] = ()) -> "Tested":
        """The same with more findings."""
        return self._replace(findings=self.findings.plus(against, doubts))

    @property
    def passes(self) -> bool:
        """Whether no test fails."""
        return not (self.findings.against or self.findings.doubts)


def tested(flight: WholeFlight, found: FlightFit, phase_at: Callable[[float], int]) -> Tested:
    """The tests of a fit: its parts, the residuals of each instrument, the corrections of each kind.

    Args:
        flight: that was fitted.
        found: its fit.
        phase_at: code of the phase at a time, s.
    """
    against, doubts = list[str](), list[str]()
    kinds = tuple(kinds_of(flight, found))
    of_parts = differences(found, phase_at)
    refused, doubted = (of_each(budget, len(of_parts)) for budget in (REFUSE, DOUBT))
    against += [one.text for one in of_parts if one.chance < refused]
    doubts += [one.text for one in of_parts if refused <= one.chance < doubted]
    refused = of_each(REFUSE, len(kinds))
    against += [kind.text for kind in kinds if kind.chance < refused]
    doubts += [kind.text for kind in kinds if refused <= kind.chance < _NOT_AS_STATED[kind.device > 0]]
    for instrument, misfit in found.by_instrument.items():
        if misfit > MISFIT_DOUBTED:
            said = f"residuals of the {instrument} are {misfit**0.5:.1f} times its noise"
            (against if misfit > MISFIT_REFUSED else doubts).append(said)
    bodies = bodies_of(flight, found)
    if bodies.chance < of_each(DOUBT):
        said = f"links and joints are not as stated together ({chance_text(bodies.chance)})"
        (against if bodies.chance < of_each(REFUSE) else doubts).append(said)
    corrections, of_bodies = _corrections(flight, found), _by_the_data(flight, found)
    against += [*contradicted(of_bodies), *too_large(corrections)]
    ends = tuple(f"_{one.name}" for one in flight.further)  # theirs are tested kind by kind
    own = {k: sigmas for k, sigmas in corrections.items() if k not in of_bodies and not k.endswith(ends)}
    return Tested(flight, found, kinds, own, of_bodies, Findings(tuple(against), tuple(doubts)))


def without_each(
    made: Callable[[int], WholeFlight], devices: tuple[int, ...], start: FloatArray, phase_at: Callable[[float], int]
) -> Iterator[tuple[int, Tested]]:
    """The tests of the flight without each instrument, as far as there is a fit.

    Args:
        made: the flight without one.
        devices: numbers of those that are left out, one at a time.
        start: (p,) from where it is fitted.
        phase_at: code of the phase at a time, s.
    """
    for device in devices:
        try:
            flight = made(device)
            yield device, tested(flight, flight.fit(start, _STAGES_s), phase_at)
        except (EstimationError, ModelError):
            continue


def _by_the_data(flight: WholeFlight, found: FlightFit) -> dict[str, float]:
    """Errors of joints and links in sigmas of what the flight tells of each; instruments are tested kind by kind."""
    at = flight.of_bodies
    expected = expected_sigma(flight.sigma[at] ** 2, np.diag(found.fit.covariance)[at])
    sigmas = found.fit.x[at] / np.hypot(expected, found.correction.sigma[at])
    return {found.names[k]: float(one) for k, one in zip(at, sigmas, strict=True)}


def _corrections(flight: WholeFlight, found: FlightFit) -> dict[str, float]:
    """Of all that the flight tells something of."""
    sigma, known = flight.sigma, np.sqrt(np.diag(found.fit.covariance))
    return {
        name: float(x / stated)
        for name, x, stated, left in zip(found.names[10:], found.fit.x[10:], sigma[10:], known[10:], strict=True)
        if np.isfinite(stated) and left < stated
    }
