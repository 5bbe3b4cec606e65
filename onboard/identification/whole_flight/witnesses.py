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

Errors of links and joints are tested together (:func:`onboard.identification.corrections.together`). What is wrong of
one part or one instrument is a hypothesis of its own.

Steps of instruments in a flight that was fitted as if there were none follow from its normal equations. With N and g
the information and the gradient of all blocks after a time, A what one sigma of a step changes of the constants, and P
the covariance of the fit, a step from that time on is off, and tells of itself, by

    D = -P N A,   J = A' N A - A' N P N A,   d = -A' g

as in a window of the filter (:mod:`onboard.identification.free_flyer.steps`). Of two steps the first N is that of the
blocks after the later one. Times are those between two blocks.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.payload import body_estimate, body_jacobian, numbers_of
from onboard.estimation.arrays import FloatArray
from onboard.estimation.maximum_likelihood import ROUNDS, inverse_of
from onboard.estimation.policy import DOUBT, LEAST_WEIGHT, REFUSE, of_each, tails
from onboard.identification.corrections import Together, contradicted, expected_sigma, misfit_texts, together, too_large
from onboard.identification.evidence.bank import Bank, Changed, Hypothesis, Suspect, Weighed, columns_of
from onboard.identification.free_flyer.prediction.imu_prediction import RATE
from onboard.identification.free_flyer.prediction.joint_noise import NOISE_KEY
from onboard.identification.free_flyer.steps import OtherError, steps_of
from onboard.identification.free_flyer.suspects import counting, suspects_of
from onboard.identification.quantities import Causes, Findings
from onboard.identification.whole_flight.blocks import FlightFit, total_of
from onboard.identification.whole_flight.fit import WholeFlight
from onboard.identification.whole_flight.pooled import PAYLOAD, differences


class StepsInside(NamedTuple):
    """Of every kind at every time, those of a time together."""

    times_s: FloatArray  # (t,)
    kinds: tuple[Suspect, ...]  # places as in the flight's names
    changed: Changed

    @staticmethod
    def of(flight: WholeFlight, found: FlightFit) -> "StepsInside":
        """Those of a flight by its fit."""
        middles = np.unique([block.middle_s for block in found.blocks])
        times_s = 0.5 * (middles[:-1] + middles[1:])
        every_s = float(np.diff(middles).mean()) if times_s.size else 0.0
        kinds = [one._replace(at=one.at - RATE.stop) for one in steps_of(flight.predictor, every_s)]
        along = np.zeros((len(found.names), sum(one.along.shape[1] for one in kinds)))
        for one, own in zip(kinds, columns_of(kinds), strict=True):
            along[one.at, own[0]] = one.along[:, 0]
        sums, told = np.zeros((len(middles), *along.shape)), np.zeros((len(middles), along.shape[1]))
        for block in found.blocks:
            at, changes = int(np.searchsorted(middles, block.middle_s)), along[block.columns]
            sums[at, block.columns] += block.normal.information @ changes
            told[at] -= changes.T @ block.normal.gradient
        sums, told = (part[::-1].cumsum(axis=0)[::-1][1:] for part in (sums, told))  # of the blocks after each time
        each, m = np.arange(len(times_s)), told.size
        later = np.maximum(each[:, None], each)
        NA = sums.transpose(1, 0, 2).reshape(len(along), m)
        both = np.einsum("pi,tpj->tij", along, sums)[later].transpose(0, 2, 1, 3).reshape(m, m)
        D = -found.fit.covariance @ NA
        return StepsInside(times_s, tuple(kinds), Changed(D, told.ravel(), both + NA.T @ D, 0.0 * along))

    def hypotheses(self, changed: Changed) -> list[Hypothesis]:
        """Each, and each two; ``changed``: as above, with something else free or not."""
        return changed.hypotheses([*self.kinds] * len(self.times_s))

    def taken(self, which: int) -> tuple[OtherError, tuple[float, float, float]]:
        """What one of them changes, by its number, places as in the predictor's state; its time, between two others.

        It may be at any of the ticks between these.
        """
        time, kind = divmod(which, len(self.kinds))
        one, times_s = self.kinds[kind], np.concatenate([[-np.inf], self.times_s, [np.inf]])
        first_s, at_s, last_s = times_s[time : time + 3].tolist()
        return OtherError(one.name, one.at + RATE.stop, one.along[:, 0]), (first_s, at_s, last_s)


def bodies_of(flight: WholeFlight, found: FlightFit) -> Together:
    """Errors of links, joints and thrusters together, in the directions that the flight tells of.

    Args:
        flight: that was fitted.
        found: its fit.
    """
    at, doubt = flight.of_bodies, found.correction.sigma[flight.of_bodies]
    whiten = np.linalg.cholesky(flight.prior_information[np.ix_(at, at)]).T
    left = whiten @ (found.fit.covariance[np.ix_(at, at)] - np.outer(doubt, doubt)) @ whiten.T
    return together(whiten @ found.fit.x[at], left)


def bound_of(flight: WholeFlight, found: FlightFit) -> FloatArray:
    """Cramér-Rao: the least sigmas of the payload's ten numbers at the noise and the sigmas that are stated, (10,).

    By the information of all rows that were used, at the estimate. Where something may be wrong, the sigmas of the fit
    are wider than that.

    Args:
        flight: that was fitted.
        found: its fit.

    Raises:
        SingularError: rows and stated sigmas leave a parameter undetermined.
    """
    rows = total_of(found.blocks, len(found.names)).information
    covariance = inverse_of(rows + np.diag(np.nan_to_num(1.0 / flight.stated**2)))
    D = body_jacobian(found.chi)
    return np.asarray(np.sqrt(np.diag(D @ covariance[:10, :10] @ D.T)), np.float64)


def leans_on(flight: WholeFlight, found: FlightFit) -> tuple[str, ...]:
    """The stated sigmas that each of the payload's ten numbers depends on, with the effect of one sigma.

    See :mod:`onboard.identification.quantities`.

    Args:
        flight: that was fitted.
        found: its fit.
    """
    D = np.zeros((10, found.fit.x.size))
    D[:, :10] = body_jacobian(found.chi)
    keys = [*[""] * 10, *(flight.key_of(name) for name in found.names[10:])]
    sigma = np.sqrt(np.diag(found.payload.covariance))
    size = np.abs(numbers_of(found.payload.body))
    causes = Causes(keys, flight.sigma, [NOISE_KEY])
    effects = causes.effects(D @ found.fit.covariance)
    effects[:, -1] = np.abs(D @ found.correction.sigma)
    return causes.said(effects, sigma, size)


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
