"""What may not be as stated of a free-flyer: the drawing of base and links, its joints, IMUs and load cells.

Of the base the mass may be wrong alone (propellant near its centre of mass), the inertia alone, both by one factor, the
centre of mass, or each of its ten parameters by itself; of a link, both by one factor, or each by itself. One factor
over all links is another arm, one over base and links a wrong unit or balance. Of a joint its place, or the zero, scale
or delay of its encoder. Of an IMU the scales of one sensor or of both, as a reference voltage or a wrong range changes
them, its housing turned, the cross-axis sensitivities of a sensor, each element of all these by itself (not
calibrated), its place or its delay. Of a load cell the scale or the delay.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.arrays import BoolArray, FloatArray, IndexArray
from onboard.estimation.policy import (
    FARTHEST_SIZE,
    LIKELY_SIZE,
    ODDS,
    ODDS_OF_ALL,
    ODDS_OF_PART,
    LIKELY_DELAY_s,
    LIKELY_PLACE_m,
)
from onboard.identification.evidence.bank import Bank, Changed, Suspect, Weighed
from onboard.identification.evidence.bodies import EACH, ways
from onboard.identification.evidence.mixture import Known
from onboard.identification.free_flyer.prediction.further import FurtherCell
from onboard.identification.free_flyer.prediction.imu_prediction import ImuPredictor
from onboard.identification.free_flyer.steps import ALTERED, Adds, JumpedJoint, Steps, named

Number = TypeVar("Number", bound=np.generic)
ALL_MASSES = "all masses"
ENCODER_ERRORS = "zero", "scale", "delay"
_OF_IMU = [
    [f"{sensor}_{kind}" for sensor in ("gyro", "accelerometer")] for kind in ("scale", "misalignment", "cross_axis")
]


class Believed(NamedTuple):
    """The step or steps in flight that are likelier than anything else."""

    which: tuple[int, ...]  # of the steps that are followed
    size: FloatArray  # (r,) in their sigmas
    root: FloatArray  # (r, r) of the covariance of that


class Rivals:
    """Weighs what a filter knows, with the newest weights kept.

    Freed is what is likely wrong alone: a prior in which everything may be is so wide in directions that no motion
    shows that steps linearised about a mean in it indicated a joint's zero, which was right, by 100 nats.

    Args:
        predictor: of the filter.

    Attributes:
        freed: numbers of the suspects that may be wrong in the priors that the filter carries.
        steps: of constants in flight, which the filter does not follow.
    """

    def __init__(self, predictor: ImuPredictor) -> None:
        self._bank, self.freed = Bank(suspects_of(predictor), predictor.sigma), tuple[int, ...]()
        self.steps, self._sigma = Steps(predictor), predictor.sigma
        encoders = {f"{kind}_{joint.name}" for kind in ENCODER_ERRORS for joint in predictor.vehicle.joints}
        self._encoders = {k for k, one in enumerate(self._bank.suspects) if one.name in encoders}
        self._of: tuple[FloatArray, FloatArray, Changed] | None = None
        self._nats = self._nats_before = 0.0  # evidence of what is free, by the last window and by what is not in it
        self._beyond = 0.0  # of that, what the linear model does not have
        self._weighed: Weighed | None = None
        self._corrected: tuple[FloatArray, Known] | None = None  # a state, and what it was before a correction

    def corrected(self, state: FloatArray, before: Known) -> None:
        """A state, (p,), is what was known with what noise of the joints has done to it taken out."""
        self._corrected = state, before

    def _carried(self, known: Known) -> Known:
        """What the filter goes on with, whose innovations the steps are of."""
        of = self._corrected
        return known if of is None or of[0] is not known[0] else of[1]

    def released(self, numbers: Iterable[int]) -> FloatArray | None:
        """Root of the information that is stated and, as these are free, not taken for granted, (p, r)."""
        return self._bank.released(free) if (free := sorted(set(numbers))) else None

    def step(self, state: FloatArray, covariance: FloatArray) -> Believed | None:
        """The step that is likelier than anything else, by the filter's state; None if none is."""
        weighed = self.weighed(state, covariance)
        which = weighed.likeliest.steps
        if not which or not weighed.contradicts:
            return None
        return Believed(which, *self.steps.told(self.steps.changed).sizes(which))

    def adds(self, state: FloatArray, covariance: FloatArray) -> Adds | None:
        """What that step adds to the filter's state and covariance."""
        if (step := self.step(state, covariance)) is None:
            return None
        D = self.steps.changed.D[:, [*step.which]]
        return Adds(tuple(self.steps.what(k).at for k in step.which), D @ step.size, D @ step.root)

    def altered(self, state: FloatArray, covariance: FloatArray) -> int | None:
        """Where nothing but a change of the payload is likely: for how many batches it has been there; else None."""
        weighed = self.weighed(state, covariance)
        (first, *_), names = weighed.likeliest.steps or (0,), weighed.names
        return self.steps.batches_since(first) if names == (ALTERED,) and not weighed.too_far else None

    def adopting(self, known: Known, step: Adds | None, initial: Known) -> tuple[Known, Known]:
        """What is known of all that comes after a step, and before the first tick.

        What stepped is from now on a constant, of which nothing better is known before than of one that is wrong.
        """
        if step is None:
            return known, initial
        state, covariance = known
        return (state + step.shift, covariance + step.root @ step.root.T), self._as_constants(step.at)(initial)

    def jumped(self, joint: JumpedJoint) -> Callable[[Known], Known]:
        """An encoder is another one; what that makes of what is known: of its errors nothing but what is stated.

        And what former jumps may have made of them.
        """
        bank, before, every, own = self._bank, self.freed, list(self._bank.suspects), list[int]()
        for other in joint.others:
            k = next(k for k, one in enumerate(every) if (one.name, one.at[0]) == (other.name, other.at[0]))
            former = every[k].along if every[k].odds == 1.0 else np.zeros((len(other.at), 0))
            every[k] = Suspect(other.name, other.at, np.column_stack([former, other.along]), 1.0)
            own.append(k)
        self._bank, self._of, at = Bank(every, self._sigma), None, joint.errors
        self.freed = now = tuple(sorted({*before, *own}))

        def of(known: Known) -> Known:
            state, covariance = (part.copy() for part in (bank.as_stated(known, before) if before else known))
            state[at], covariance[at], covariance[:, at] = 0.0, 0.0, 0.0
            covariance[at, at] = self._sigma[at] ** 2
            return self._bank.freed((state, covariance), now) if now else (state, covariance)

        return of

    def _as_constants(self, stepped: Sequence[IndexArray]) -> Callable[[Known], Known]:
        """Free constants that have stepped, by their places; what that makes of a prior."""
        places = {tuple(at.tolist()) for at in stepped}
        own = enumerate(self._bank.suspects)
        return self._also([k for k, one in own if one.along.shape[1] == 1 and (*one.at.tolist(),) in places])

    def _also(self, numbers: Iterable[int]) -> Callable[[Known], Known]:
        """Free suspects; what that makes of a prior."""
        before = self.freed
        self.freed, self._of = now, _ = tuple(sorted({*before, *numbers})), None
        return partial(self._free, before=before, now=now) if now != before else lambda known: known

    def wrong(
        self, known: Known, inside: Changed, *, changed: bool, payload: bool = True
    ) -> tuple[tuple[int, ...], tuple[int, ...], float]:
        """What is likelier than what a window was solved for, by what is known at its end.

        Args:
            known: at its end.
            inside: steps in it.
            changed: a change was detected before it, of which an error that is there all flight is no reason.
            payload: also that a part of that has come off or been added.

        Returns:
            Suspects, or steps in it; and their odds.
        """
        steps = self._bank.steps_as_stated(known, self.freed, inside) if self.freed else inside
        weighed = self._bank.weigh(self.stated(known), self.steps.of_window(steps, FARTHEST_SIZE if payload else 0.0))
        weighed = weighed.of_steps if changed else weighed
        one = weighed.likeliest
        already = bool(one.numbers) and set(one.numbers) <= set(self.freed)
        if one.suspect is None or already or not weighed.contradicts:
            return (), (), 1.0
        if not one.steps:
            return counting(weighed), (), one.suspect.odds
        # of each that counts the likeliest: which it is cannot be told
        steps_of = {each.suspect.name: each.steps for each in reversed(weighed.likely) if each.suspect and each.steps}
        return (), tuple(dict.fromkeys(k for which in steps_of.values() for k in which)), one.suspect.odds

    def stated(self, known: Known) -> Known:
        """What is known if nothing is free."""
        return self._stated(known, self.freed)

    def solved(self, known: Known, nats: float, *, at_least: bool) -> None:
        """Take in the evidence of what is free, by two solutions of a window, and not by a linear model about one.

        Args:
            known: at its end.
            nats: evidence over that of nothing being free.
            at_least: it may be more.
        """
        self._of, linear = None, self._linear(known)
        self._nats = self._nats_before + nats
        self._beyond = max(self._nats - linear, 0.0) if at_least else self._nats - linear

    def begin(self, known: Known | None) -> None:
        """A window begins with what is known, which ticks before it told; None: with what was before other ticks."""
        self._nats_before = self._nats if known is None else self._linear(known) + self._beyond

    def _concerned(self) -> BoolArray:
        """Which suspects have a constant that is free."""
        at = set(self.freed_at.tolist())
        return np.array([not at.isdisjoint(one.at.tolist()) for one in self._bank.suspects], np.bool_)

    def _linear(self, known: Known) -> float:
        return self._bank.nats(self.stated(known), self.freed) if self.freed else 0.0

    def with_free(self, known: Known, numbers: Sequence[int]) -> Known:
        """A prior if these suspects may be wrong, too."""
        return self._free(known, self.freed, tuple(sorted({*self.freed, *numbers}))) if numbers else known

    def taken(self, freed: Sequence[int], stepped: Sequence[int]) -> Callable[[Known], Known]:
        """So it was in a window: what stepped is a constant from then on; what that makes of a prior."""
        return self._as_constants([self.steps.what(k).at for k in stepped]) if stepped else self._also(freed)

    @property
    def at(self) -> IndexArray:
        """Places in the state of all that may be wrong."""
        return self._bank.at

    @property
    def spanned(self) -> IndexArray:
        """Places in the state of constants of which every error is one of a suspect."""
        return self._bank.spanned

    @property
    def freed_at(self) -> IndexArray:
        """Places in the state of what has been freed."""
        return self.places(self.freed)

    def places(self, numbers: Iterable[int]) -> IndexArray:
        """In the state, of some suspects."""
        return np.unique(np.concatenate([self._bank.at[:0], *(self._bank.suspects[k].at for k in numbers)]))

    def weighed(self, state: FloatArray, covariance: FloatArray) -> Weighed:
        """All hypotheses, by the filter's state, (p,), and its covariance, (p, p)."""
        of, steps = self._of, self.steps.changed
        if self._weighed is None or of is None or of[0] is not state or of[1] is not covariance or of[2] is not steps:
            self._of, known = (state, covariance, steps), (state, covariance)
            if self.freed:
                steps = self._bank.steps_as_stated(self._carried(known), self.freed, steps)
            alone = self.steps.told(steps).hypotheses(self.steps.suspects)
            beyond = np.where(self._concerned(), self._beyond, 0.0) if self.freed else 0.0
            self._weighed = self._bank.weigh(self.stated(known), alone, beyond)
        return self._weighed

    def freeing(
        self, state: FloatArray, covariance: FloatArray, *, held: bool = True
    ) -> Callable[[Known], Known] | None:
        """What frees all that counts in what is known, where the likeliest is wrong and not yet free; else None.

        Where nothing is ``held`` only an encoder: an arm that seems to be heavier than drawn may hold something.
        """
        weighed = self.weighed(state, covariance)
        numbers = set(weighed.likeliest.numbers)
        if not weighed.contradicts or numbers <= set(self.freed) or not (held or numbers <= self._encoders):
            return None
        before = self.freed
        self._also(counting(weighed))
        known, steps = self._carried((state, covariance)), self.steps.changed
        if before:
            known, steps = self._stated(known, before), self._bank.steps_as_stated(known, before, steps)
        self.steps.changed = self._bank.steps_freed(known, self.freed, steps)
        return partial(self._free, before=before, now=self.freed)

    def _free(self, known: Known, before: Sequence[int], now: Sequence[int]) -> Known:
        return self._bank.freed(self._stated(known, before), now)

    def _stated(self, known: Known, freed: Sequence[int]) -> Known:
        return self._bank.as_stated(known, freed) if freed else known


def counting(weighed: Weighed) -> tuple[int, ...]:
    """Numbers of all suspects that count."""
    return tuple(k for one in weighed.likely for k in one.numbers)


def suspects_of(predictor: ImuPredictor) -> list[Suspect]:
    """Of a predictor's vehicle and instruments.

    The motion tells ratios of masses alone. Where one cell is all that measures a force, a factor of all masses is a
    factor of that cell.
    """
    alone = sum(isinstance(one, FurtherCell) for one in predictor.further) + len(predictor.thrusters) == 1
    cells = _cells(predictor, alike=alone)
    return [*_bodies(predictor, alike=alone), *_joints(predictor), *_imus(predictor), *cells]


def _bodies(predictor: ImuPredictor, *, alike: bool) -> Iterator[Suspect]:
    vehicle = predictor.vehicle
    at, ways_of = dict[str, IndexArray](), dict[str, tuple[FloatArray, ...]]()
    for name, (places, half) in predictor.drawn.items():
        first = 10 * vehicle.links.index(name)
        at[name], ways_of[name] = places, ways(vehicle.chi[first : first + 10], half)
    factor = {name: each[0] for name, each in ways_of.items()}
    base = vehicle.spec.base_link
    arm = [name for name in at if name != base]
    for name in arm:
        for way in (factor[name], ways_of[name][-1]):
            yield Suspect(name, at[name], way, 0.5 * ODDS_OF_PART)
    if len(arm) > 1:
        yield Suspect("the arm", _joined(at, arm), _joined(factor, arm), ODDS_OF_PART)
    if base not in at:
        return
    yield from (Suspect(base, at[base], way, ODDS / len(ways_of[base])) for way in ways_of[base])
    if arm:
        yield Suspect(ALL_MASSES, _joined(at, at), _joined(factor, at), ODDS_OF_ALL, alike)


def _joined(of_each: Mapping[str, NDArray[Number]], names: Iterable[str]) -> NDArray[Number]:
    return np.concatenate([of_each[name] for name in names])


def _joints(predictor: ImuPredictor) -> Iterator[Suspect]:
    of_encoder = zip(ENCODER_ERRORS, (LIKELY_SIZE, LIKELY_SIZE, LIKELY_DELAY_s), strict=True)
    ways = {"place_{}": 3 * (LIKELY_PLACE_m,)} | {f"{kind}_{{}}": (size,) for kind, size in of_encoder}
    for joint in predictor.vehicle.joints:
        for what, sizes in ways.items():
            name = what.format(joint.name)
            names = [name] if len(sizes) == 1 else [what.format(f"{axis}_{joint.name}") for axis in "xyz"]
            at = np.array([k for k, one in enumerate(predictor.names) if one in names], np.intp)
            if at.size:
                yield Suspect(name, at, np.diag(sizes[: at.size]), ODDS_OF_PART / len(ways))


def _imus(predictor: ImuPredictor) -> Iterator[Suspect]:
    """Scales of its gyro, of its accelerometer, of both; its housing turned; cross-axis of each sensor; all of it."""
    wander = [at for at, _ in predictor.wandering]
    for name, own in zip(predictor.instruments, predictor.of_each[: len(predictor.imu_frames)], strict=False):
        scales, turns, cross = ([at for one in kinds if (at := named(predictor, own, one)).size] for kinds in _OF_IMU)
        ways = [(at, LIKELY_SIZE * np.ones((len(at), 1))) for at in scales]
        mounting = [at] if (at := named(predictor, own, "mounting")).size else []
        housing = mounting or (turns if len(turns) > 1 else [])
        for alike, columns in ((scales if len(scales) > 1 else [], np.ones((3, 1))), (housing, np.eye(3))):
            if alike:
                ways.append((np.concatenate(alike), LIKELY_SIZE * np.tile(columns, (len(alike), 1))))
        every = [*scales, *turns, *cross]
        for at in [*cross, *([np.concatenate(every)] if every else [])]:
            ways.append((at, EACH * np.diag(predictor.sigma[at])))
        for kind, size in (("place_", LIKELY_PLACE_m), ("delay_s", LIKELY_DELAY_s)):
            at = np.setdiff1d(named(predictor, own, kind), wander)
            ways += [(at, size * np.eye(at.size))] if at.size else []
        yield from (Suspect(name, at, along, ODDS_OF_PART / len(ways)) for at, along in ways)


def _cells(predictor: ImuPredictor, *, alike: bool) -> Iterator[Suspect]:
    for one, scale, own in zip(predictor.further, predictor.of_further, predictor.of_each[1:], strict=True):
        delay = named(predictor, own, "delay_s")
        ways = [(scale, LIKELY_SIZE, ODDS, alike), (delay, LIKELY_DELAY_s, ODDS_OF_PART, False)]
        for at, size, odds, shared in ways if isinstance(one, FurtherCell) else ():
            if at.size:
                yield Suspect(one.name, at, np.full((1, 1), size), odds, shared)
