"""Instruments besides the first IMU that the recursive ExIDDM predicts: further IMUs of the base, load cells.

A load cell shows ``(1 + scale) (u - delay du/dt) + bias + drift t``, u its component of the wrench through its cut
(:mod:`onboard.dynamics.cut_wrench`): the IMU's error model (:mod:`onboard.identification.exiddm.imu_errors`) for one
axis. A clock without marks wanders, so a delay may be a random walk as well.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.identification.exiddm.imu_errors import ImuPrior, tick_mean
from onboard.identification.exiddm.parameters import Block


class FurtherImu(NamedTuple):
    """Another IMU on the base."""

    name: str
    frame: str
    samples: int  # in each tick's mean
    prior: ImuPrior
    place_m: float  # 1 sigma of each coordinate
    delay_memory_s: float = np.inf  # correlation time of its delay; infinite: constant

    @property
    def width(self) -> int:
        """Lines that it has."""
        return 6


class CellPrior(NamedTuple):
    """Prior on a cell's errors: standard deviations; zero: exact."""

    bias: float  # its unit
    drift: float  # its unit, per second
    scale: float
    delay_s: float


class FurtherCell(NamedTuple):
    """A load cell of the arm."""

    name: str
    frame: str
    projection: tuple[float, ...]  # (6,) of the wrench through its cut, in the frame's axes about its origin
    samples: int
    prior: CellPrior

    @property
    def width(self) -> int:
        """Lines that it has."""
        return 1

    def block(self) -> Block:
        """Its errors as a block of unknowns, in the order of :class:`CellPrior`."""
        names = tuple(f"{kind}_{self.name}" for kind in CellPrior._fields)
        return Block(names, np.array(self.prior, np.float64))

    @staticmethod
    def gain(errors: FloatArray) -> float:
        """Its reading per component; errors in the order of :class:`CellPrior`, (4,)."""
        return 1.0 + float(errors[2])

    def shown(self, true: FloatArray, period_s: float, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Readings of the inner ticks, (b,), and their derivatives by its errors, (b, 4).

        Args:
            true: its component at b + 2 ticks.
            period_s: between ticks.
            errors: in the order of :class:`CellPrior`, (4,).
        """
        bias, drift, scale, delay_s = errors
        change = (true[2:] - true[:-2]) / (2.0 * period_s)
        late = tick_mean(true, self.samples)[1:-1] - delay_s * change
        time_s = period_s * np.arange(1, len(true) - 1)
        by_errors = np.stack([np.ones_like(time_s), time_s, late, -(1.0 + scale) * change], axis=1)
        return (1.0 + scale) * late + bias + drift * time_s, by_errors


Further = FurtherImu | FurtherCell
