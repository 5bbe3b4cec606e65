"""Detects a stuck inertial sensor by a run of equal samples too long for its noise.

An inertial sensor at rest shows its noise. Samples ``FORGOTTEN`` filter time constants apart are nearly independent,
and the probability that an axis gives the same count twice is at most erf(1 / (2 sqrt(2) sigma)) for a normal noise of
sigma counts. The probabilities of the six axes and of successive samples multiply: a run is stuck where the product is
below ``CHANCE``.
"""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from drivers.records import IMU, Rows, SampleStatus, Severity
from drivers.reporter import Reporter

CHANCE = 1e-12  # probability of a run per sample: once in thirty years at 1 kHz
FORGOTTEN = 3.0  # time constants of a filter
_ACCEL_AT = IMU.fields["accel_raw"][1] if IMU.fields else 0  # gyro_raw follows at once


def longest_run(sigmas: Iterable[float], bandwidth_hz: float, sample_rate_hz: float) -> int:
    """Longest run of equal samples that may occur by chance.

    Args:
        sigmas: Noise of each axis, rms, counts; a lower bound.
        bandwidth_hz: Narrowest filter bandwidth of all axes.
        sample_rate_hz: Sample rate; an upper bound.
    """
    chance = math.prod(math.erf(1.0 / (2.0 * math.sqrt(2.0) * sigma)) for sigma in sigmas)
    apart = math.ceil(FORGOTTEN / (2.0 * math.pi * bandwidth_hz) * sample_rate_hz)
    return 1 + apart * math.ceil(math.log(CHANCE) / math.log(chance))


def _heads(rows: Rows) -> NDArray[np.int64]:
    """Accel x, y, z and gyro x of each sample packed into one integer, for a fast comparison, shape (n,)."""
    return np.ndarray(len(rows), "<i8", rows, _ACCEL_AT, rows.strides)


class Repeats:
    """Marks samples of a run of equal samples NOT_VALID.

    Samples passed on before the run became too long stay unmarked. Saturated samples do not count as repeats: an axis
        at its limit shows no noise.

    Args:
        longest: Longest run that may occur by chance, samples.
        report: Receives the events.

    Attributes:
        stuck: Whether the last sample belongs to a run that is too long.
    """

    def __init__(self, longest: int, report: Reporter) -> None:
        self.stuck = False
        self._report = report
        self._run = 0  # length of the current run, samples
        self._longest = longest
        self._last: Rows | None = None  # (1,)

    def watch(self, rows: Rows, host_ns: int) -> None:
        """Mark the samples of a numbered, non-empty batch; report a run that begins or ends in it."""
        was_stuck = self.stuck
        began = self.mark(rows)
        if began is not None and not was_stuck:
            first = int(rows["sequence"][max(began, 0)]) + min(began, 0)
            text = f"samples from {first} on are bit-identical: the sensor hangs, power-cycle it"
            self._report.event(host_ns, Severity.ERROR, "stuck", text)
        if (was_stuck or began is not None) and not self.stuck:
            self._report.event(host_ns, Severity.INFO, "stuck_over", "samples differ again")

    def mark(self, rows: Rows) -> int | None:
        """Mark the samples of a non-empty batch that continues the previous one.

        Returns:
            Start of the first run that is too long, as an index into ``rows`` (negative: in an earlier batch); None if
            none.
        """
        heads = _heads(rows)
        last, self._last = self._last, rows[-1:]
        follows = last is not None and heads[0] == _heads(last)[0]
        if not follows and not (heads[1:] == heads[:-1]).any():
            self._run, self.stuck = 1, False
            return None
        words = np.concatenate((rows["accel_raw"], rows["gyro_raw"]), axis=1)  # (n, 6)
        same = np.append(False, (words[1:] == words[:-1]).all(axis=1))
        if last is not None:
            same[0] = np.array_equal(last["accel_raw"][0], words[0, :3]) and np.array_equal(
                last["gyro_raw"][0], words[0, 3:]
            )
        same &= (rows["status"] & SampleStatus.SATURATED) == 0
        places = np.arange(len(same))
        began = np.maximum.accumulate(np.where(same, -self._run, places))
        too_long = places - began >= self._longest
        self._run, self.stuck = len(same) - int(began[-1]), bool(too_long[-1])
        if not too_long.any():
            return None
        bad = np.unique(began[too_long])
        rows["status"][np.isin(began, bad)] |= np.uint8(SampleStatus.NOT_VALID)
        return int(bad[0])
