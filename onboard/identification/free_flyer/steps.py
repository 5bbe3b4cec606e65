"""Steps in flight: of an IMU's scales, of a load cell's scale or zero, of the payload; beside what is wrong all flight.

Each alone, and each two, for what steps may go back.

The true state is ``x + D t``: D is how far a filter that does not know of a step of one sigma is off, t of unit normal
prior. D is the step at its time, goes through the filter's corrections and predictions, and shows in its innovations as
``G = H D`` (Willsky and Jones, A generalized likelihood ratio approach to the detection and estimation of jumps in
linear systems, 1976). With the whitened innovations e the information of t is ``J = sum G'G`` and the gradient
``d = sum G'e``; evidence, mean and covariance follow as those of every hypothesis (:mod:`..evidence.bank`). The
filter's state does not grow.

Of a window, which is solved as a whole with constants that do not change, they follow from its normal equations: with
the unknowns at its first tick, their covariance P after it, whitened derivatives H by these and G by a step, residuals
r of the solution and the transition F to its end,

    D = step - F P H'G,   J = G'G - G'H P H'G,   d = G'r

A payload that changes, as where a part comes off or propellant is used, is a step along the directions of
:func:`.bodies.changes`, all of them together: a step of several columns.

An encoder that jumps is followed by the filter. From there on its angle is read so that it goes on smoothly. If its
zero has slipped, nothing is left of that. If its scale or its delay is another one, its size follows from that of the
jump, and the zero takes off what it does there; each is as likely as a zero that has slipped.

Noise of the joints is in J and d, as it is in every gradient (:mod:`.prediction.joint_noise`): with N what it has added
to a state's information, ``D' N D`` to J, and to d what it adds to the gradient, which is taken off as it comes. The
slopes are ``K = J - D' N D``, and the information of a step that of its estimating equation, ``K V^-1 K`` with
``V = K + c D' N D`` (:meth:`Steps.told`), for each step by itself.

A time that is no longer kept, the one of the least likely hypotheses, leaves its odds to the one after it.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import ROUNDING, FloatArray, IndexArray, eigen
from onboard.estimation.policy import FARTHEST_SIZE, LEAST_WEIGHT, LIKELY_SIZE, STEPS_PER_HOUR, LIKELY_DELAY_s
from onboard.identification.evidence.bank import Changed, Hypothesis, Suspect, columns_of
from onboard.identification.evidence.bodies import CHANGES, EACH, changes
from onboard.identification.free_flyer.prediction.further import FurtherCell
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import NOISELESS, NoiseAdded
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS
from onboard.regressor.signals import EncoderJump

_EVERY = 2  # batches between times of a step: 0.25 s beside it, a step of 2 % had half of its 60 nats within a second
_TIMES = 8  # that are kept; with twelve, five flights with a step told the same


class Inside(NamedTuple):
    """Steps of one sigma each at times inside a window: of every kind at every time, the kinds of a time together."""

    at: IndexArray  # (k,) places in the state
    along: FloatArray  # (k, kinds) by what each step changes these
    every: int  # ticks from one time to the next
    times: int
    begins: int = 1  # number of the first time: none at the first tick, where one is a wrong constant, or 0
    of_payload: slice = slice(0, 0)  # of the places, those of the payload, which the last columns change

    def about(self, state: FloatArray) -> "Inside":
        """Those of the payload in this state, (p,)."""
        if not self.at[self.of_payload].size:
            return self
        along = self.along.copy()
        along[self.of_payload, -CHANGES:] = changes(state[self.at[self.of_payload]])
        return self._replace(along=along)

    @property
    def of_instruments(self) -> int:
        """Columns of the kinds that change nothing but readings; those of the payload follow."""
        return int(self.along.shape[1]) - CHANGES * bool(self.at[self.of_payload].size)

    @property
    def payload(self) -> FloatArray:
        """By what the others change the payload, (10, kinds)."""
        return self.along[self.of_payload, self.of_instruments :]

    def seen(self, rows: FloatArray) -> FloatArray:
        """What those of instruments do to readings, (..., kinds), from their times on, by derivatives of these."""
        return np.asarray(rows[..., self.at] @ self.along[:, : self.of_instruments], np.float64)

    def starts(self, first: int, ticks: int) -> tuple[IndexArray, IndexArray]:
        """Where parts of so many ticks begin between two times, and the number of each part in the window."""
        bounds = np.arange(first // self.every, (first + ticks - 1) // self.every + 1)
        return np.maximum(bounds * self.every - first, 0), np.minimum(bounds, self.times + self.begins - 1)

    def changed(self, size: int) -> FloatArray:
        """What they do to a state of so many elements, (p, m)."""
        each = np.zeros((size, self.along.shape[1]))
        each[self.at] = self.along
        return np.tile(each, self.times)

    def along_with(self, gradients: FloatArray) -> FloatArray:
        """What ticks' gradients by a state, (n, p), are along each step from its time on, (m,)."""
        first = self.every * (self.begins + np.arange(self.times))
        later = np.cumsum(gradients[::-1, self.at], axis=0)[::-1]
        return np.asarray((later[first] @ self.along).ravel(), np.float64)

    def taken(self, which: Sequence[int]) -> "StepsTaken":
        """Some of them, by their numbers in the order of :meth:`changed`."""
        at, kinds = np.asarray(which, np.intp), max(self.along.shape[1], 1)
        return StepsTaken(self.at, self.along[:, at % kinds], self.every * (self.begins + at // kinds))


class StepsTaken(NamedTuple):
    """Steps whose sizes are unknowns of a window."""

    at: IndexArray  # (k,) places in the state
    along: FloatArray  # (k, r) by what one sigma of each changes these
    first: IndexArray  # (r,) ticks of the window from which on they are there


class Adds(NamedTuple):
    """What steps add to a state that is estimated as if there were none."""

    at: tuple[IndexArray, ...]  # places of what stepped
    shift: FloatArray  # (p,)
    root: FloatArray  # (p, r) of what is added to the covariance


class OtherError(NamedTuple):
    """An error that may be another one."""

    name: str
    at: IndexArray  # (k,) its place in the state, and that of the zero where this may be wrong
    along: FloatArray  # (k,) by what these change


class JumpedJoint:
    """The joint of an encoder that has jumped.

    Args:
        predictor: of its vehicle.
        joint: its name.
        jump: of the encoder.

    Attributes:
        errors: places in the state of all errors of the encoder.
        others: what may have changed.
        cyclic: and the cyclic errors, which begin elsewhere.
    """

    def __init__(self, predictor: ImuPredictor, joint: str, jump: EncoderJump) -> None:
        names, ends = predictor.names, f"_{joint}"
        own = {name.removesuffix(ends): k for k, name in enumerate(names) if name.endswith(ends)}
        cyclic = [k for kind, k in own.items() if kind.startswith("cyclic_") and kind.endswith(("_cos", "_sin"))]
        kinds = [own[kind] for kind in ("zero", "scale", "delay") if kind in own]
        self.errors: IndexArray = np.array([*kinds, *cyclic], np.intp)
        self.others = list[OtherError]()
        zero = [own["zero"]] if "zero" in own else []
        for kind, seen, likely in (("scale", jump.angle, LIKELY_SIZE), ("delay", jump.rate, LIKELY_DELAY_s)):
            if kind in own and abs(jump.size) < FARTHEST_SIZE * likely * abs(seen):
                at = np.array([own[kind], *zero], np.intp)
                along = np.array([jump.size / seen, *[-jump.size] * len(zero)])
                self.others.append(OtherError(names[own[kind]], at, along))
        self.cyclic = [OtherError(names[k], np.array([k]), 2.0**0.5 * predictor.sigma[[k]]) for k in cyclic]

    @property
    def changed(self) -> list[OtherError]:
        """All that is an error of its own from the jump on, of unit normal prior."""
        return [*self.others, *self.cyclic]


_NOWHERE: IndexArray = np.zeros(0, np.intp)
ALTERED = "a change of the payload"
NO_STEPS = Inside(np.zeros(0, np.intp), np.zeros((0, 0)), BATCH_TICKS, 0)
NONE_TAKEN = NO_STEPS.taken(())


class Steps:
    """Of one filter.

    Args:
        predictor: of its instruments.

    Attributes:
        changed: D, d and J of each step.
        suspects: what each step is of.
    """

    def __init__(self, predictor: ImuPredictor, payload: slice = PAYLOAD) -> None:
        self._predictor, self._every_s = predictor, _EVERY * BATCH_TICKS * predictor.period_s
        self._what = tuple(steps_of(predictor, self._every_s, np.arange(len(predictor.names))[payload]))
        self._of = [one for one in self._what for _ in range(one.along.shape[1])]  # of each column
        self._at = np.unique(np.concatenate([np.zeros(0, np.intp), *(one.at for one in self._what)]))
        self._along = np.zeros((len(self._at), len(self._of)))
        for columns, one in zip(columns_of(self._what), self._what, strict=True):
            self._along[np.searchsorted(self._at, one.at)[:, None], columns] = one.along
        self._of_payload = slice(*np.searchsorted(self._at, [payload.start, payload.stop]).tolist())
        self._of_each = self.inside(0)._replace(times=1).changed(len(predictor.names))
        for part in (self._at, self._along, self._of_each):
            part.setflags(write=False)  # a checkpoint names it
        self.forget()

    def forget(self) -> None:
        """Nothing is known of any before now."""
        none = np.zeros(len(self._predictor.names))
        self.begin(Changed.none(len(none)), none)

    def inside(self, ticks: int, *, carried: bool = False) -> Inside:
        """Those that are looked for in a window of so many ticks, in the order in which :meth:`begin` takes them.

        ``carried``: ticks before it have told of the constants, so that one of its first tick may have stepped.
        """
        every = _EVERY * BATCH_TICKS
        times = max((ticks - 2) // every, 0) + carried
        return Inside(self._at, self._along, every, times, int(not carried), self._of_payload)

    def of_window(self, inside: Changed, farthest: float) -> list[Hypothesis]:
        """Those of a window, in that order.

        A payload that has changed by that many sigmas is another one, under which the window is solved anyway.
        """
        return inside.hypotheses([*self._what] * (len(inside.d) // max(len(self._of), 1)), farthest=farthest)

    def what(self, which: int) -> Suspect:
        """What one of these columns is of."""
        return self._of[which % len(self._of)]

    def begin(self, inside: Changed, state: FloatArray) -> None:
        """The filter goes on from a window with these steps, in this state, (p,)."""
        self._batches, self.changed = 0, inside
        self._noise = self._spread = np.zeros_like(inside.J)  # in that, and what its gradient scatters by
        self._stands = np.ones(len(inside.d) // max(len(self._of), 1))  # times that each time stands for
        self.suspects = [*self._what] * len(self._stands)
        self._begun = np.full(len(self._stands), -1)  # batch after which each is there; -1: in the window
        self._may_be(state)

    def told(self, changed: Changed) -> Changed:
        """What the readings tell of steps, noise of the joints taken off: see :func:`.correction_of`."""
        J, noise, d = changed.J, self._noise, np.zeros_like(changed.d)
        if not (noise.diagonal() > NOISELESS * J.diagonal()).any():
            return changed
        by, columns = np.zeros_like(J), columns_of([*self._what] * (len(d) // len(self._of)))
        for width in {len(own) for own in columns}:
            own = np.array([each for each in columns if len(each) == width])
            at = own[:, :, None], own[:, None]
            K = _positive(J[at] - noise[at], 1.0)
            told = np.linalg.solve(K + self._spread[at] + LEAST_WEIGHT * np.eye(width), K).swapaxes(1, 2)
            d[own] = (told @ changed.d[own][:, :, None])[:, :, 0]
            by[at] = _positive(told @ K, 0.5) @ _positive(J[at], -0.5)
        return changed._replace(d=d, J=by @ J @ by.T)

    @property
    def altering(self) -> tuple[int, ...]:
        """The columns of a payload that has changed at the first of the times."""
        return self.of_payload(range(len(self._of)))

    def of_payload(self, which: Iterable[int]) -> tuple[int, ...]:
        """Which of these columns are of the payload."""
        return tuple(k for k in which if self.what(k).name == ALTERED)

    def batches_since(self, which: int) -> int:
        """For how many batches one of these columns may have been there; 0: since some time in a window."""
        begun = int(self._begun[which // len(self._of)])
        return 0 if begun < 0 else self._batches - begun + _EVERY

    def step(
        self,
        told: tuple[FloatArray, FloatArray, FloatArray],
        transition: FloatArray,
        state: FloatArray,
        noise: NoiseAdded,
    ) -> None:
        """To the end of a batch; every so often, the constants may be others from there on.

        Noise of the joints has moved the filter's state, and draws it towards a lighter payload in each batch, as if
        the payload had become so.

        Args:
            state: at that end, (p,).
            told: of its lines ``L^-1 H P``, (lines, p), whitened innovations at the state without what noise of the
                joints has done, (lines,), and ``L^-1 H D``, (lines, m).
            transition: of what changes, (c, p).
            noise: of the joints, what it adds in the batch.
        """
        (D, d, J, of_each), changing = self.changed, self._predictor.changing
        W, e, seen = told
        if len(e) and noise.information.size:
            at = np.flatnonzero(noise.information.diagonal() > NOISELESS * noise.of_lines)
            information = D[at].T @ noise.information[at[:, None], at] @ D[at]
            d = d + D.T @ noise.gradient
            self._noise, self._spread = self._noise + information, self._spread + noise.scattering * information
        now, more = W.T @ seen, seen.T @ seen
        np.subtract(D, now, out=now)
        now[changing] = transition @ now
        self.changed = Changed(now, d + seen.T @ e, np.add(J, more, out=more), of_each)
        self._batches += 1
        if self._batches % _EVERY == 0:
            self._may_be(state)

    def _may_be(self, state: FloatArray) -> None:
        """From now on, too; of too many times the least likely but the newest is left to the one after it."""
        (D, d, J, _), each, kinds = self.changed, len(self._of), len(self._what)
        of_noise = self._noise, self._spread
        if not each:
            return
        logs, kept = self.changed.evidence(self.suspects)[1], np.arange(len(self._stands))
        logs = logs.max(axis=1, initial=-np.inf).reshape(-1, kinds).max(axis=1, initial=-np.inf)
        while len(kept) >= _TIMES:
            least = int(logs[kept][:-1].argmin())
            self._stands[kept[least + 1]] += self._stands[kept[least]]
            times, own = float(self._stands[kept[least + 1]]), slice(kinds * least, kinds * (least + 1))
            self.suspects[own], kept = [], np.delete(kept, least)
            self.suspects[own] = [one._replace(odds=one.odds * times) for one in self._what]
        steps, now = (each * kept[:, None] + np.arange(each)).ravel(), self.inside(0)._replace(times=1)
        new = now.about(state).changed(len(D))
        squares = np.zeros((3, len(steps) + each, len(steps) + each))
        squares[:, : len(steps), : len(steps)] = [part.take(steps, 0).take(steps, 1) for part in (J, *of_noise)]
        J, self._noise, self._spread = squares
        self.changed = Changed(np.hstack([D[:, steps], new]), np.append(d[steps], np.zeros(each)), J, self._of_each)
        self._stands = np.append(self._stands[kept], 1.0)
        self._begun = np.append(self._begun[kept], self._batches)
        self.suspects += self._what


def _positive(A: FloatArray, power: float) -> FloatArray:
    """Powers of the positive parts of symmetric matrices, (n, k, k)."""
    values, V = eigen(A)
    there = values > ROUNDING * values.max(axis=1, keepdims=True)
    there &= values > 0.0
    powers = np.power(values, power, out=np.zeros_like(values), where=there)
    return np.asarray(V * powers[:, None] @ V.swapaxes(1, 2), np.float64)


def named(predictor: ImuPredictor, own: IndexArray, kind: str) -> IndexArray:
    """Places of the errors of a kind among those of an instrument."""
    return own[[predictor.names[at].startswith(kind) for at in own]]


def steps_of(predictor: ImuPredictor, every_s: float, payload: IndexArray = _NOWHERE) -> Iterator[Suspect]:
    """Of a cell its scale or its zero; of an IMU the scale of its gyro, of its accelerometer, or both; of the payload.

    What the last changes depends on the payload.

    Args:
        predictor: of these instruments.
        every_s: for which each step stands.
        payload: its places in the state; none: it does not change.
    """
    odds = STEPS_PER_HOUR * every_s / 3600.0
    ways = list[tuple[str, IndexArray, float]]()
    for name, own in zip(predictor.instruments, predictor.of_each[: len(predictor.imu_frames)], strict=False):
        scales = [at for sensor in ("gyro", "accelerometer") if (at := named(predictor, own, f"{sensor}_scale")).size]
        both = [np.concatenate(scales)] if len(scales) > 1 else []
        ways += [(name, at, LIKELY_SIZE) for at in (*scales, *both)]
    for one in predictor.further:
        for kind in ("scale", "bias") if isinstance(one, FurtherCell) else ():
            if (name := f"{kind}_{one.name}") in predictor.names:
                at = np.array([predictor.names.index(name)])
                ways.append((one.name, at, LIKELY_SIZE if kind == "scale" else EACH * predictor.sigma[at[0]]))
    each = [(f"a step of {name}", at, np.full((len(at), 1), size)) for name, at, size in ways]
    each += [(ALTERED, payload, np.zeros((len(payload), CHANGES)))] if payload.size else []
    for name, at, along in each:
        for part in (at, along):
            part.setflags(write=False)  # a checkpoint names it
        yield Suspect(name, at, along, odds)
