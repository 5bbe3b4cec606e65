"""Inertial samples that repeat to the bit: a sensor that hangs, and not one that rests.

An inertial sensor at rest shows its noise. Two samples further apart than its filter remembers are as good as
independent, and no axis of them falls into one and the same count with more probability than that count holds of a
normal distribution about it, erf(1 / (2 sqrt(2) sigma)) for a noise of sigma counts. Six axes multiply, and so do
samples: a run is too long to be chance where that product is below ``CHANCE``.
"""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from drivers.records import IMU, Rows, SampleStatus, Severity
from drivers.reporter import Reporter

CHANCE = 1e-12  # of a run, from any one sample on: once in thirty years at 1 kHz
FORGOTTEN = 3.0  # time constants of a filter
_ACCEL_AT = IMU.fields["accel_raw"][1] if IMU.fields else 0  # gyro_raw follows at once


def longest_run(sigmas: Iterable[float], bandwidth_hz: float, sample_rate_hz: float) -> int:
    """How many samples in a row may be the same by chance.

    Args:
        sigmas: Noise of each axis, rms, counts: rather too little than too much.
        bandwidth_hz: Of the filter, the narrowest of all axes.
        sample_rate_hz: Rather too high than too low.
    """
    chance = math.prod(math.erf(1.0 / (2.0 * math.sqrt(2.0) * sigma)) for sigma in sigmas)
    apart = math.ceil(FORGOTTEN / (2.0 * math.pi * bandwidth_hz) * sample_rate_hz)
    return 1 + apart * math.ceil(math.log(CHANCE) / math.log(chance))


def _heads(rows: Rows) -> NDArray[np.int64]:
    """Accel x, y, z and gyro x of each sample as one number, shape (n,): where these differ, samples do."""
    return np.ndarray(len(rows), "<i8", rows, _ACCEL_AT, rows.strides)


class Repeats:
    """Watches for samples that repeat, and marks them NOT_VALID.

    Those of a run that were handed over before it was too long are not marked any more. Saturated samples are no
    repeats: an axis at its limit shows no noise.

    Args:
        longest: Samples that may be the same by chance.
        report: Where it is told.

    Attributes:
        stuck: The last sample is one of a run too long.
    """

    def __init__(self, longest: int, report: Reporter) -> None:
        self.stuck = False
        self._report = report
        self._run = 0  # samples of the run that the last sample is one of
        self._longest = longest
        self._last: Rows | None = None  # (1,)

    def watch(self, rows: Rows, host_ns: int) -> None:
        """Mark the samples of a batch, at least one, numbered, and tell what began or ended in it."""
        was_stuck = self.stuck
        began = self.mark(rows)
        if began is not None and not was_stuck:
            first = int(rows["sequence"][max(began, 0)]) + min(began, 0)
            text = f"samples from {first} on are the same to the bit: it hangs, power-cycle it"
            self._report.event(host_ns, Severity.ERROR, "stuck", text)
        if (was_stuck or began is not None) and not self.stuck:
            self._report.event(host_ns, Severity.INFO, "stuck_over", "samples differ again")

    def mark(self, rows: Rows) -> int | None:
        """Mark the samples of a batch, at least one, that follow on those of the batch before.

        Returns:
            Where the first run too long began, as an index into ``rows``, negative where that was before them; or None.
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
