"""A window of ticks, solved under one hypothesis on the payload, and what a change was by the one that explains it.

An announcement is a claim that the motion can contradict: a release, if the payload held before explains the next
window and nothing held does not; a capture, if nothing held explains the window and it determines no payload.
"""

from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from onboard.estimation.arrays import FloatArray
from onboard.estimation.policy import HALF, LEAST_WEIGHT, REFUSE, of_each, sigmas
from onboard.identification.evidence.bank import Changed
from onboard.identification.evidence.mixture import Known
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD
from onboard.identification.free_flyer.prediction.joint_noise import NoiseAdded
from onboard.identification.online import Change

WINDOWS_s = (1.0, 2.0, 4.0, 8.0)  # of a window; the longest where two IMUs contradict each other
SOLVED_AT_s = WINDOWS_s[:-1]  # times after the start or a change at which the window is solved
LONGEST_s = 32.0  # of a window that grows, or that replaces steps
EXPLAINED = of_each(REFUSE, 16)  # a window of less chance is not explained; as many windows are judged
_BEGUN = 0.02  # share of the prior sigma of the mass; a window whose sigma is smaller keeps its ticks and grows
_GROWTH, _LONGEST = 1.5, LONGEST_s / SOLVED_AT_s[-1]  # of such a window


class HeldPayload(Enum):
    """Hypothesis on the payload during a window."""

    NOTHING = "nothing held"
    SAME = "the same payload"
    NEW = "a payload of which nothing is known"


class Solved(NamedTuple):
    """Solution of a window under one hypothesis."""

    hypothesis: HeldPayload
    start: FloatArray  # (p,) at its first tick
    state: FloatArray  # (p,) at its last tick but one
    covariance: FloatArray  # (p, p) of that
    used: int  # ticks
    glitches: int
    strained: float  # squares of the deviations from the prior, and what the residuals' exceed chance by
    cost: float  # squares of residuals and of deviations from the prior; of what was left out the least it can be
    residual: FloatArray  # whitened, of the IMU that guesses are made of, (n, 6)
    kept: FloatArray  # (p, p) covariance with which a filter goes on
    steps: Changed  # inside it
    noise_added: NoiseAdded  # by the joints' samples
    known: Known  # state and its covariance without what noise adds
    evidence: float  # logarithm of the density of the readings, but for what is common to all hypotheses on the window

    @property
    def mass_sigma(self) -> float:
        """Relative, of the payload's mass; infinite where that is not positive."""
        mass, variance = self.state[PAYLOAD.start], self.covariance[PAYLOAD.start, PAYLOAD.start]
        return float(np.sqrt(variance) / mass) if mass > 0.0 else np.inf

    @property
    def tells_mass(self) -> bool:
        """The payload's mass is known so well that there is one."""
        return HALF * self.mass_sigma < 1.0

    @property
    def has_mass(self) -> bool:
        """The payload's mass may be positive; else the minimum is a wrong one."""
        sigma = float(np.sqrt(self.covariance[PAYLOAD.start, PAYLOAD.start]))
        return bool(self.state[PAYLOAD.start] > -sigmas(LEAST_WEIGHT) * sigma)

    def contradicts(self, other: "Solved") -> bool:
        """Whether it explains the window better than another hypothesis does.

        Nothing held may be right where a payload lowers the cost by no more than ten free numbers do by chance. A light
        payload adds little to the squares of a thousand readings, too little for a test of the residuals alone. Its
        mass may come out negative where the window tells little of it; a longer window follows then. That nothing is
        held has no more free numbers than that a known payload is: the likelier one counts.
        """
        if other.hypothesis is not HeldPayload.NOTHING:
            return self.evidence > other.evidence
        chance = float(chdtrc(PAYLOAD.stop - PAYLOAD.start, max(other.cost - self.cost, 0.0)))
        return chance < EXPLAINED

    def growth(self, length: float, unknown_kg: float) -> tuple[bool, float]:
        """After a window that does not determine the mass: whether its ticks are kept, and the next window's length.

        The decision must hardly depend on the estimated mass: where only windows with a large estimate were kept,
        payloads of 0.1 to 0.2 kg became one sigma heavier.

        Args:
            length: of this one, in a length at which nothing has grown.
            unknown_kg: sigma of the mass of a payload of which nothing is known.
        """
        sigma_kg = float(np.sqrt(self.covariance[PAYLOAD.start, PAYLOAD.start]))
        if sigma_kg >= _BEGUN * unknown_kg and not self.tells_mass:  # the arm is at rest
            return False, 1.0
        return True, min(_GROWTH * length, _LONGEST) if length < _LONGEST else 0.5 * _GROWTH * _LONGEST


_KINDS = {  # of a detected change, by what was held before and what explains the window after it
    (True, HeldPayload.NOTHING): "ejection",
    (True, HeldPayload.SAME): "contact",
    (True, HeldPayload.NEW): "instrument",
    (False, HeldPayload.NOTHING): "contact",
    (False, HeldPayload.NEW): "capture",
}


def kind_of(before: bool, hypothesis: HeldPayload, instrument: bool = False, *, altered: bool = False) -> str:
    """What a detected change was.

    Args:
        before: a payload was held.
        hypothesis: explains the window after it.
        instrument: an instrument was found to be wrong, and is left out of that window.
        altered: it explains it with a payload of which a part has come off or been added, if one was held.
    """
    if altered and (before or hypothesis is HeldPayload.SAME):
        return "altered"
    return "instrument" if instrument and hypothesis is not HeldPayload.NEW else _KINDS[before, hypothesis]


def after_a_change(held: bool, known: bool = True) -> tuple[HeldPayload, ...]:
    """Hypotheses in the order in which they are tried; ``known``: there is an estimate of what was held."""
    same = (HeldPayload.SAME,) if held and known else ()
    return (HeldPayload.NOTHING, *same, HeldPayload.NEW)


def at_first(held: bool, carried: bool) -> tuple[HeldPayload, ...]:
    """Hypotheses of the first window; ``carried``: what was held last is known, and ``held`` does not count."""
    if carried:
        return HeldPayload.SAME, HeldPayload.NOTHING, HeldPayload.NEW
    return (HeldPayload.NEW if held else HeldPayload.NOTHING,)


class Claim:
    """The last announcement, until it is settled.

    Attributes:
        held: what was announced; None if nothing waits to be settled.
        unseen: the joints were not known for a while before or in the window, so a change may not have been seen.
    """

    def __init__(self) -> None:
        self.held: bool | None = None
        self.unseen = False

    def make(self, held: bool, known: bool) -> tuple[HeldPayload, ...]:
        """The hypotheses to be tried after an announcement; ``known``: there is an estimate of what was held."""
        self.held = held
        if held:
            return (HeldPayload.NEW,)
        return (HeldPayload.NOTHING, HeldPayload.SAME) if known else (HeldPayload.NOTHING,)

    def otherwise(
        self, tried: tuple[HeldPayload, ...], window_s: FloatArray
    ) -> tuple[tuple[HeldPayload, ...], Change | None]:
        """The hypotheses of the window after one that those tried do not explain, and a change that was not seen.

        Args:
            tried: that it stays as it was, or that it changed.
            window_s: times of the window's ticks, (n,).
        """
        unseen, self.unseen = self.unseen, False
        if self.held:
            return (HeldPayload.NEW,), None
        if not unseen or tried not in ((HeldPayload.NOTHING,), (HeldPayload.SAME,)):
            return tried, None
        change = Change("change", float(window_s[-1]), float(window_s[0]), float("nan"))
        return after_a_change(tried == (HeldPayload.SAME,)), change

    def settle(self, hypothesis: HeldPayload, now_s: float) -> list[Change]:
        """What is to be said of the announcement when a hypothesis explains the window after it."""
        self.unseen = False
        if self.held is None or (self.held and hypothesis is HeldPayload.NEW):
            return []  # a capture may still be not determined
        rejected = []
        if self.held:
            rejected.append(Change("capture_contradicted", now_s, now_s, float("nan"), "nothing held moves alike"))
        elif hypothesis is HeldPayload.SAME:
            rejected.append(Change("release_contradicted", now_s, now_s, float("nan"), "the payload moves as before"))
        self.held = None
        return rejected
