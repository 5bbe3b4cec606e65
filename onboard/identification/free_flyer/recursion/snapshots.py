"""States that a filter was in, to go back to one, and the motion of the empty arm before a change.

They are most of a checkpoint: covariances are kept as triangles, and of older states only some.

A payload that is caught at rest shows when the arm moves, perhaps slowly. What was learned of the instruments and the
arm since then is wrong if the arm was not empty, so it is given up at the change. Once the payload is known, the last
seconds before the change tell: where they are not explained with the payload held and are without, the arm was empty.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray, IndexArray
from onboard.identification.evidence.mixture import Known
from onboard.identification.free_flyer.guesses import first_state
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, ImuPredictor
from onboard.identification.free_flyer.prediction.joint_noise import NoiseAdded
from onboard.identification.free_flyer.prediction.ticks import BATCH_TICKS, Ticks
from onboard.identification.free_flyer.recursion.solved import HeldPayload, SOLVED_AT_s
from onboard.identification.free_flyer.recursion.trials import WindowProblem
from onboard.identification.free_flyer.steps import Adds

TIERS = ((8, 1), (28, 4), (80, 16))  # (n, k): every k-th of the n newest batches is kept


def initially(predictor: ImuPredictor, payload: tuple[FloatArray, FloatArray] | None) -> Known:
    """What is known before the first tick.

    Args:
        predictor: of the instruments.
        payload: mean, (10,), and covariance, (10, 10), of the one held last; None: nothing is known of one.
    """
    mean, covariance = np.zeros(len(predictor.names)), np.diag(np.nan_to_num(predictor.sigma) ** 2)
    if payload is not None:
        mean[PAYLOAD], covariance[PAYLOAD, PAYLOAD] = payload
    for part in (mean, covariance):
        part.setflags(write=False)  # a checkpoint names it
    return mean, covariance


class Before(NamedTuple):
    """The motion before a change, and what was known at its end if nothing was held."""

    ticks: Ticks
    known: Known
    noise: NoiseAdded  # what noise of the joints had added to that

    @property
    def asked(self) -> tuple[Ticks, WindowProblem]:
        """How they are to be solved: whether what was found later was held already is not known."""
        return self.ticks, WindowProblem((HeldPayload.SAME, HeldPayload.NOTHING))

    def if_held(
        self, known: Known, now: Known, predictor: ImuPredictor, seen: Ticks, imu: int
    ) -> tuple[Known, FloatArray | None]:
        """What is known if the payload was held already, and a state to begin with; None where there is none.

        Args:
            known: at rest; that stays, and the payload is as it is now.
            now: state and covariance with the payload.
            predictor: of the instruments.
            seen: the ticks, with the readings to be used.
            imu: that gives the first rate.
        """
        mean, covariance = (part.copy() for part in known)
        mean[PAYLOAD], covariance[PAYLOAD], covariance[:, PAYLOAD] = now[0][PAYLOAD], 0.0, 0.0
        covariance[PAYLOAD, PAYLOAD] = now[1][PAYLOAD, PAYLOAD]
        start = self.known[0].copy()
        start[PAYLOAD] = now[0][PAYLOAD]
        return (mean, covariance), first_state(predictor, seen, start, imu)


class Snapshot(NamedTuple):
    """What a filter knew."""

    known: Known
    step: Adds | None  # that was believed
    noise: NoiseAdded  # what noise of the joints had added


class _Kept(NamedTuple):
    number: int  # of the batch
    state: FloatArray  # (p,)
    triangle: FloatArray  # (p (p + 1) / 2,)
    noise: NoiseAdded  # its information as the triangle of a covariance
    step: Adds | None = None

    @property
    def whole(self) -> Snapshot:
        """With matrices in place of triangles."""
        noise, p = self.noise, len(self.state)
        if noise.information.size:
            noise = noise._replace(information=_unpacked(noise.information, p))
        return Snapshot((self.state, _unpacked(self.triangle, p)), self.step, noise)


class Snapshots:
    """The newest states, and the newest ticks since the arm rested.

    Args:
        period_s: of the ticks.
        tiers: batches that can be gone back to, to itself or one shortly before it, and of how many one is kept.
    """

    def __init__(self, period_s: float, tiers: Sequence[tuple[int, int]] = TIERS) -> None:
        self._tiers, self._newest = tuple(tiers), -1
        self._kept: list[_Kept] = []
        self._fewest, self._most = (
            round(seconds / period_s) for seconds in SOLVED_AT_s[:2]
        )  # of the empty arm's motion
        self._moved: Ticks | None = None
        self._moving = 0  # batches since the arm rested

    def __len__(self) -> int:
        return len(self._kept)

    def clear(self) -> None:
        """Forget all."""
        self._kept.clear()
        self._moved = None

    def moves(self, ticks: Ticks | None) -> None:
        """Keep the ticks of a batch, the first two of which were in the one before; None: the arm rests."""
        self._moving = 0 if ticks is None else self._moving + 1
        if ticks is None or self._moved is None:
            self._moved = ticks
        else:
            self._moved = self._moved.and_then(ticks.part(slice(2, None))).part(slice(-self._most, None))

    def since_rest(self, batches: int) -> tuple[int, Before | None]:
        """Where to go back to at a change that began so many batches ago, and the motion before it, if that counts.

        What was caught at rest was held in all batches since. A longer motion than is kept would have shown it.
        """
        if self._moving >= self._tiers[-1][0] or self._moving < batches:
            return batches, None
        ticks = None if self._moved is None else self._moved.part(slice(None, -(batches + 1) * BATCH_TICKS))
        if ticks is None or len(ticks.time_s) < self._fewest:
            return self._moving + 1, None
        then = self.back(batches + 1)
        return self._moving + 1, Before(ticks, then.known, then.noise)

    def append(self, state: FloatArray, covariance: FloatArray, noise: NoiseAdded, step: Adds | None = None) -> None:
        """Keep a state, (p,), and its covariance, (p, p).

        Args:
            state: as if there were no step in flight.
            covariance: of that.
            noise: of the joints, what it has added.
            step: that is believed; forgotten where all that is kept becomes something else.
        """
        self._newest += 1
        upper = _upper(len(state))
        if noise.information.size:
            noise = noise._replace(information=noise.information.take(upper))
        self._kept.append(_Kept(self._newest, state, covariance.take(upper), noise, step))
        oldest = [one for one in self._kept if self._newest - one.number >= self._tiers[-1][0] - 1][-1:]
        self._kept = oldest + [one for one in self._kept if self._stays(self._newest - one.number, one.number)]

    def _stays(self, age: int, number: int) -> bool:
        return age < self._tiers[-1][0] - 1 and any(age < most and number % every == 0 for most, every in self._tiers)

    def become(self, of: Callable[[Known], Known]) -> None:
        """Replace every state and its covariance by what is made of them."""
        kept = []
        for one in self._kept:
            state, covariance = of(one.whole.known)
            kept.append(_Kept(one.number, state, covariance.take(_upper(len(state))), one.noise))
        self._kept = kept

    def back(self, batches: int) -> Snapshot:
        """What was known so many batches before the newest, or at the next older one; the oldest if there is none."""
        wanted = self._newest - batches
        return next((one for one in reversed(self._kept) if one.number <= wanted), self._kept[0]).whole


def _unpacked(triangle: FloatArray, p: int) -> FloatArray:
    upper = np.zeros((p, p))
    upper.flat[_upper(p)] = triangle
    return upper + np.triu(upper, 1).T


@lru_cache
def _upper(size: int) -> IndexArray:
    """Places of the upper triangle in a square matrix that is laid out by rows."""
    return np.flatnonzero(np.triu(np.ones((size, size), np.bool_)))
