"""Gates: named reasons why a row is not used, vectorised over ticks.

A gate never changes a value: it returns reasons, which are combined with ``|`` and logged beside the row.
"""

from collections.abc import Mapping
from enum import IntFlag

import numpy as np
from numpy.typing import ArrayLike, NDArray

from onboard.estimation.arrays import OF_MEDIAN, BoolArray, FloatArray
from onboard.estimation.errors import RowError

ReasonArray = NDArray[np.int64]


class GateReason(IntFlag):
    """Why a row was not used; 0 is a row that was."""

    OK = 0
    SATURATED = 1  # a sample under the kernel is at the end of its range
    GAP = 2  # samples are missing under the kernel
    CONTACT = 4  # a joint is near its mechanical stop
    DRAG = 8  # an external force acts on the base
    PHASE = 16  # the mission is not in a phase to identify in, or has not settled in it
    RESIDUAL = 32  # the row contradicts the estimate
    NOT_SYNCHRONISED = 64  # a clock the row depends on is not valid
    STILL = 128  # the joint's rate is below ``still_rad_s``: its Coulomb friction is undetermined
    STUCK = 256  # a reading under the kernel repeats where it must change
    LEFT_OUT = 512  # its instrument contradicts the others
    JUMPED = 1024  # the angle of a joint has jumped since rows were used: its encoder is another one


def reasons(refused: ArrayLike, reason: GateReason) -> ReasonArray:
    """``reason`` where ``refused``, (n,) bool, is true; 0 elsewhere."""
    found: ReasonArray = np.multiply(np.asarray(refused, bool), int(reason), dtype=np.int64)
    return found


def none_refused() -> dict[GateReason, int]:
    """How many rows each reason refused, before there are any."""
    return {reason: 0 for reason in GateReason if reason is not GateReason.OK}


def count_refused(refused: dict[GateReason, int], found: ReasonArray) -> None:
    """Add the rows that each reason of ``found`` refused."""
    for reason in refused if found.any() else ():
        refused[reason] += int(np.count_nonzero(found & int(reason)))


def named_refusals(refused: Mapping[GateReason, int]) -> dict[str, int]:
    """The reasons that refused any, by name."""
    return {str(reason.name).lower(): count for reason, count in refused.items() if count}


def window_contains(times_s: ArrayLike, bad: ArrayLike, at_s: ArrayLike, width_s: float) -> BoolArray:
    """Whether a bad sample lies under the kernel of each tick.

    Args:
        times_s: sample times, (k,), increasing.
        bad: (k,) bool.
        at_s: ticks, (n,).
        width_s: full width of the kernel.

    Raises:
        RowError: lengths that differ.
    """
    times, flags, at = np.asarray(times_s, np.float64), np.asarray(bad, bool), np.asarray(at_s, np.float64)
    if times.shape != flags.shape:
        raise RowError(f"{flags.size} flags for {times.size} samples; give as many")
    total = np.concatenate([[0], np.cumsum(flags)])
    low = np.searchsorted(times, at - 0.5 * width_s, side="left")
    high = np.searchsorted(times, at + 0.5 * width_s, side="right")
    return np.asarray(total[high] > total[low], np.bool_)


def range_gate(values: ArrayLike, low: ArrayLike, high: ArrayLike, reason: GateReason) -> ReasonArray:
    """Refuses ticks with any value outside its range, or not a number.

    Args:
        values: (n,) or (n, c).
        low: scalar or (c,).
        high: scalar or (c,).
        reason: what to call it.

    Raises:
        RowError: an empty range.
    """
    v = np.asarray(values, np.float64)
    v = v[:, None] if v.ndim == 1 else v
    lower, upper = np.asarray(low, np.float64), np.asarray(high, np.float64)
    if not (lower < upper).all():
        raise RowError(f"the range {lower} to {upper} is empty; put the lower end first")
    return reasons(~((v >= lower) & (v <= upper)).all(axis=1), reason)


def magnitude_gate(vectors: ArrayLike, limit: float, reason: GateReason) -> ReasonArray:
    """Refuses ticks whose vector is longer than ``limit``, or not a number.

    Args:
        vectors: (n, 3).
        limit: in the vectors' unit.
        reason: what to call it.
    """
    v = np.asarray(vectors, np.float64)
    return reasons(~(np.einsum("ij,ij->i", v, v) <= limit * limit), reason)


def phase_gate(
    at_s: ArrayLike,
    change_s: ArrayLike,
    phases: ArrayLike,
    identify: ArrayLike,
    settle_s: float,
    half_width_s: float = 0.0,
) -> ReasonArray:
    """Refuses ticks outside the phases to identify in, and those too near a change of phase.

    Args:
        at_s: ticks, (n,).
        change_s: times of the changes known so far, (k,), increasing.
        phases: (k,) phase entered at each change. Before the first change no phase is known, and ticks are refused.
        identify: phases in which rows are wanted.
        settle_s: how long after a change rows are refused.
        half_width_s: half the kernel's width: so long before a change the kernel already reaches over it.

    Raises:
        RowError: lengths that differ, or times that do not increase.
    """
    at, change = np.asarray(at_s, np.float64), np.asarray(change_s, np.float64)
    entered = np.asarray(phases)
    if change.shape != entered.shape or (np.diff(change) < 0.0).any():
        raise RowError("phase changes need an increasing time each")
    if change.size == 0:
        return reasons(np.ones(at.shape, bool), GateReason.PHASE)
    index = np.searchsorted(change, at, side="right") - 1  # (n,)
    last = np.maximum(index, 0)
    wanted = (entered[last][:, None] == np.asarray(identify)).any(axis=1) & (index >= 0)
    since = at - change[last]
    following = np.append(change, np.inf)[index + 1] - at
    return reasons(~wanted | (since < settle_s + half_width_s) | (following < half_width_s), GateReason.PHASE)


class ResidualGate:
    """Refuses rows with too large a normalised innovation, with a limit that adapts if the estimate itself is wrong.

    The limit is ``threshold`` times the innovation's sigma, *or* times the robust spread of the recent innovations,
    refused ones included, whichever is larger. A few outliers do not move the median and are refused. If the estimate
    is wrong, most innovations are large, the median grows and the gate opens, so that the rows can correct the
    estimate.

    Args:
        threshold: in sigmas.
        memory: how many recent innovations the spread is taken from.
        huber: innovations beyond so many sigmas (or times the spread) weigh less; none do, where not given.

    Raises:
        RowError: numbers out of range.
    """

    def __init__(self, threshold: float, memory: int = 200, huber: float | None = None) -> None:
        if threshold <= 0.0 or memory < 1:
            raise RowError("the residual gate needs a positive threshold and memory")
        if huber is not None and not 0.0 < huber < threshold:
            raise RowError(f"Huber's threshold is {huber}; it must be above zero and below the gate's {threshold}")
        self.threshold = threshold
        self.huber = huber
        self._recent = np.zeros(memory)
        self._count = 0

    @property
    def spread(self) -> float:
        """Robust standard deviation of the recent normalised innovations; 1 is what it should be."""
        n = min(self._count, self._recent.size)
        return float(OF_MEDIAN * np.median(self._recent[:n])) if n else 1.0

    def check(self, innovation: FloatArray, sigma: FloatArray) -> ReasonArray:
        """Reasons for rows not yet taken in; remembers their innovations.

        Args:
            innovation: (m,).
            sigma: (m,) standard deviation of each innovation (:meth:`SquareRootRls.innovation`).

        Raises:
            RowError: numbers that are not finite, or a sigma that is not positive.
        """
        n = innovation.size
        if innovation.shape != sigma.shape or (n and not sigma.min() > 0.0):
            raise RowError("innovations need a positive sigma each")
        normalised = np.abs(innovation) / sigma
        largest = float(normalised.max(initial=0.0))
        if not largest < np.inf:
            raise RowError("innovations must be finite")
        size = self._recent.size
        first = self._count % size
        if first + n <= size:
            self._recent[first : first + n] = normalised
        else:
            self._recent[(self._count + np.arange(n)) % size] = normalised
        self._count += n
        if largest <= self.threshold:
            return np.zeros(n, np.int64)
        return reasons(normalised > self.threshold * max(1.0, self.spread), GateReason.RESIDUAL)

    def widening(self, innovation: FloatArray, sigma: FloatArray) -> FloatArray:
        """Factors on the rows' sigmas, (m,), that make a least squares weigh them as Huber does: 1 below his threshold.

        A row's pull on the estimate grows with its innovation up to the threshold and stays the same beyond.

        Args:
            innovation: (m,), as for :meth:`check`, which comes first.
            sigma: (m,).
        """
        if self.huber is None:
            return np.ones(innovation.shape)
        limit = self.huber * max(1.0, self.spread)
        return np.asarray(np.sqrt(np.maximum(np.abs(innovation) / sigma / limit, 1.0)), np.float64)
