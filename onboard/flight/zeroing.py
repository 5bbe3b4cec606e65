"""Zero of the accelerometer, taken in flight while the vehicle coasts at rest.

In free fall an accelerometer at rest near the centre of mass reads its own offset (datasheet: up to 50 mg) and next to
nothing else. Unremoved, that offset works on the payload's first moment like a field of gravity would, and it varies
with the joint angle as the inertia torque of a sweep does. What coasting leaves (spin, nutation) stays as a small
constant, for which the rows have nuisance columns.
"""

import numpy as np
from numpy.typing import NDArray

from onboard import config

Floats = NDArray[np.float64]


class Zeroing:
    """Mean specific force over the resting phases before the first that is not; then subtracted from everything."""

    def __init__(self, settings: config.Zero | None) -> None:
        self._settings = settings
        self._sum, self._count = np.zeros(3), 0
        self.offset_m_s2: Floats | None = np.zeros(3) if settings is None else None

    def apply(self, specific_force: Floats, codes: NDArray[np.int64], usable: NDArray[np.bool_]) -> Floats:
        """Specific force (n, 3) at ticks in phases ``codes`` (n,), offset removed; NaN where it is not known yet."""
        out = specific_force.copy()
        for tick, code in enumerate(codes):
            if self.offset_m_s2 is None:
                self._learn(specific_force[tick], int(code), bool(usable[tick]))
            out[tick] = specific_force[tick] - self.offset_m_s2 if self.offset_m_s2 is not None else np.nan
        return out

    def _learn(self, specific_force: Floats, code: int, usable: bool) -> None:
        if self._settings is None:
            return
        if code in self._settings.phases:
            if usable and np.isfinite(specific_force).all():
                self._sum += specific_force
                self._count += 1
        elif code >= 0:
            enough = self._count >= self._settings.ticks
            self.offset_m_s2 = self._sum / self._count if enough else np.zeros(3)
