"""Gates ticks that are estimated afterwards; on an air-bearing table nothing is estimated on board.

The velocity follows from the joints only from the start of the run on, so the run is estimated in one batch afterwards
(:mod:`onboard.identification.table.air_bearing`); so are runs between release and catch by hand
(:mod:`onboard.ground.identify.kinds.parabolic_log`).
"""

import numpy as np

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.gates import ReasonArray, count_refused
from onboard.identification.free_flyer.online import TickIdentifier
from onboard.identification.free_flyer.prediction.ticks import gated
from onboard.identification.online import Change
from onboard.identification.quantities import Estimate, Findings
from onboard.regressor.signals import Signals


class TableRun(TickIdentifier):
    """An :class:`onboard.identification.online.OnlineIdentifier` that gates ticks and estimates nothing."""

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        """Gates new ticks."""
        found = gated(signals, excluded)
        count_refused(self.refused, found)
        return found

    def finish(self) -> None:
        """Nothing is left to be done."""

    def estimate(self) -> Estimate:
        """An estimate without quantities."""
        nothing = np.full(len(self.parameter_names), np.nan)
        unsupported = np.zeros(len(self.parameter_names), np.bool_)
        return Estimate(
            self.parameter_names, nothing, nothing, nothing, nothing, unsupported, (), 0, dict(self.refused)
        )

    def triangle(self) -> FloatArray:
        """Zero information, (11, 11)."""
        return np.zeros((len(self.parameter_names) + 1, len(self.parameter_names) + 1))

    def findings(self) -> Findings:
        """None: nothing is answered before the run is over."""
        return Findings()

    def news(self) -> tuple[Change, ...]:
        """None."""
        return ()
