"""Zero of the accelerometer, taken in flight while the vehicle coasts at rest.

In free fall an accelerometer at rest near the centre of mass reads its own offset (datasheet: up to 50 mg) and next to
nothing else. Unremoved, that offset works on the payload's first moment like a field of gravity would, and it varies
with the joint angle as the inertia torque of a sweep does. What coasting leaves (spin, nutation) stays as a small
constant, for which the rows have nuisance columns.
"""

import numpy as np
from numpy.typing import NDArray

from onboard import config
from onboard.estimation.arrays import FloatArray


class Zeroing:
    """Mean specific force over the resting phases; fixed when one of them ends and enough has been seen.

    Attributes:
        offset_m_s2: (3,) what is subtracted; None while it is not known, and nothing can be said of the base's motion.
        ticks: how many went into it.
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
            codes: (n,) phase of each tick, -1 where none is known.
            usable: (n,) whether the tick may be learned from.
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
