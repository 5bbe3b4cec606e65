"""Is all of a flight as stated: what may be wrong is weighed on its fit, and which instrument contradicts the others.

The hypotheses are those of the filter on board (:func:`onboard.identification.free_flyer.suspects.suspects_of`, and
steps of an instrument in flight), weighed by the same bank with mean and covariance of the fit. While one is likelier
than "as stated", what counts is free in the prior, or a step an unknown from its time on, and the flight is fitted
again; the answer is the mixture. Such an error moves a payload by more than its own correction shows: 5 % of the scale
of DYMAFLEX's accelerometer, common to its axes, move the mass by half of it and are corrected by less than one of the
stated sigmas.

Where a test fails after that, the flight is fitted once more without each instrument, the first IMU too. If exactly one
of these fits passes every test, the instrument that it is without is the one that is wrong, and the answer is made from
the rest. If several do, two instruments contradict each other and nothing tells which of them is wrong; if none does,
the joints or the model may be. Both answers are refused.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.payload import body_estimate, body_jacobian
from onboard.estimation.arrays import FloatArray
from onboard.estimation.maximum_likelihood import ROUNDS
from onboard.estimation.policy import DOUBT, LEAST_WEIGHT, REFUSE, of_each, tails
from onboard.identification.corrections import contradicted, expected_sigma, misfit_texts, too_large
from onboard.identification.evidence.bank import Bank, Weighed
from onboard.identification.free_flyer.prediction.imu_prediction import RATE
from onboard.identification.free_flyer.suspects import counting, suspects_of
from onboard.identification.quantities import Findings
from onboard.identification.whole_flight.blocks import FlightFit
from onboard.identification.whole_flight.fit import WholeFlight
from onboard.identification.whole_flight.parts import PAYLOAD, differences
from onboard.identification.whole_flight.stated import bodies_of
from onboard.identification.whole_flight.steps_inside import StepsInside


class Tested(NamedTuple):
    """A fit and what its tests say."""

    flight: WholeFlight
    found: FlightFit
    corrections: Mapping[str, float]  # of the first IMU and what else is no link's or joint's, in stated sigmas
    of_bodies: Mapping[str, float]  # of links and joints, in sigmas of what the flight tells of each
    findings: Findings
    names: tuple[str, ...] = ()  # of what may not be as stated

    def plus(self, against: Iterable[str] = (), doubts: Iterable[str] = ()) -> "Tested":
        """The same with more findings."""
        return self._replace(findings=self.findings.plus(against, doubts))

    @property
    def passes(self) -> bool:
        """Whether no test fails."""
        return not (self.findings.against or self.findings.doubts)


def fitted(
    flight: WholeFlight, start: FloatArray, stages_s: Sequence[float], phase_at: Callable[[float], int]
) -> Tested:
    """A fit in which what is likely wrong is free, and its tests.

    Args:
        flight: to be fitted; its prior is changed. With a step in it the one of the result is another.
        start: (p,) from where.
        stages_s: lengths of the parts of each segment that are fitted first.
        phase_at: code of the phase at a time, s.

    Raises:
        EstimationError, ModelError: as :meth:`WholeFlight.fit`.
    """
    found, stepped = flight.fit(start, stages_s), list[str]()
    suspects = [one._replace(at=one.at - RATE.stop) for one in suspects_of(flight.predictor)]
    freed = tuple[int, ...]()
    while True:
        bank, steps = Bank(suspects, flight.stated), StepsInside.of(flight, found)
        known, changed = (found.fit.x, found.fit.covariance), steps.changed
        if freed:
            known, changed = bank.as_stated(known, freed), bank.steps_as_stated(known, freed, changed)
        weighed = bank.weigh(known, steps.hypotheses(changed))
        one = weighed.likeliest
        settled = len(stepped) == ROUNDS if one.steps else set(one.numbers) <= set(freed)
        if settled or not weighed.contradicts:
            break
        if one.steps:
            other, when_s = steps.taken(one.steps[0])
            x, freed = found.fit.x[: flight.constants], ()
            flight, stepped = flight.with_step(other, when_s), [*stepped, other.name]
            found = flight.fit(flight.start(x))
        else:
            freed = tuple(sorted({*freed, *counting(weighed)}))
            flight.free([suspects[k] for k in freed])
            found = flight.fit(found.fit.x)
    against, _ = weighed.judged
    names = tuple(dict.fromkeys([*stepped, *weighed.names]))
    return tested(flight, found, phase_at).plus(against)._replace(found=_mixed(found, weighed), names=names)


def _mixed(found: FlightFit, weighed: Weighed) -> FlightFit:
    """The payload of a fit under all hypotheses that count."""
    mixture = weighed.mixed(partial(weighed.known, part=PAYLOAD)).wider(found.correction.part(PAYLOAD).covariance)
    chi, covariance = mixture.known
    outer = mixture.ends(body_jacobian(chi), tails(LEAST_WEIGHT))
    return found._replace(payload=body_estimate(chi, covariance), chi=chi, chi_covariance=covariance, outer=outer)


def tested(flight: WholeFlight, found: FlightFit, phase_at: Callable[[float], int]) -> Tested:
    """The tests of a fit: its parts, the residuals of each instrument, the corrections of links and joints.

    Args:
        flight: that was fitted.
        found: its fit.
        phase_at: code of the phase at a time, s.
    """
    of_parts = differences(found, phase_at)
    refused, doubted = (of_each(budget, len(of_parts)) for budget in (REFUSE, DOUBT))
    larger, large = misfit_texts(found.by_instrument.items())
    told = [(one.text(part, "the rest"), one.chance) for part, one in of_parts.items()]
    against = [text for text, chance in told if chance < refused] + larger
    doubts = [text for text, chance in told if refused <= chance < doubted] + large
    bodies, corrections, of_bodies = bodies_of(flight, found), _corrections(flight, found), _by_the_data(flight, found)
    against += [*bodies.refused(), *contradicted(of_bodies), *too_large(corrections)]
    doubts += bodies.doubted()
    ends = tuple(f"_{one.name}" for one in flight.further)  # theirs are hypotheses
    own = {k: sigmas for k, sigmas in corrections.items() if k not in of_bodies and not k.endswith(ends)}
    return Tested(flight, found, own, of_bodies, Findings(tuple(against), tuple(doubts)))


def _by_the_data(flight: WholeFlight, found: FlightFit) -> dict[str, float]:
    """Errors of joints and links in sigmas of what the flight tells of each; of instruments there are hypotheses."""
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
