"""Estimates the accelerometer's offset in flight while the vehicle coasts at rest.

In free fall an accelerometer at rest near the centre of mass reads almost only its offset (datasheet: up to 50 mg).
Uncorrected, the offset acts on the payload's first moment like gravity, with a dependence on the joint angle similar to
the inertia torque of a sweep. The remaining specific force while coasting (spin, nutation) is a small constant, for
which the rows have nuisance columns.
"""

import numpy as np
from numpy.typing import NDArray

from onboard import config
from onboard.estimation.arrays import FloatArray


class Zeroing:
    """Mean specific force over the resting phases; fixed when one of them ends and enough has been seen.

    Attributes:
        offset_m_s2: (3,) offset subtracted; None while unknown, when the base's motion is unknown too.
        ticks: number of ticks averaged.
    """

    def __init__(self, settings: config.Zero | None) -> None:
        self._settings = settings
        self._sum = np.zeros(3)
        self.ticks = 0
        self.offset_m_s2: FloatArray | None = np.zeros(3) if settings is None else None

    def apply(self, specific_force: FloatArray, codes: NDArray[np.int64], usable: NDArray[np.bool_]) -> FloatArray:
        """Specific force less its offset, (n, 3); NaN where the offset is not known yet.

        Args:
            specific_force: (n, 3), sensor axes.
            codes: (n,) phase of each tick, -1 if unknown.
            usable: (n,) whether the tick may be used.
        """
        out = np.full_like(specific_force, np.nan)
        for tick, code in enumerate(codes):
            if self.offset_m_s2 is None:
                self._learn(specific_force[tick], int(code), bool(usable[tick]))
            if self.offset_m_s2 is not None:
                out[tick] = specific_force[tick] - self.offset_m_s2
        return out

    def _learn(self, specific_force: FloatArray, code: int, usable: bool) -> None:
        assert self._settings is not None
        if code in self._settings.phases:
            if usable and np.isfinite(specific_force).all():
                self._sum += specific_force
                self.ticks += 1
        elif self.ticks >= self._settings.ticks:
            self.offset_m_s2 = self._sum / self.ticks
