"""What every estimator that flies looks like."""

from typing import Protocol

from onboard.estimation.arrays import BoolArray, FloatArray
from onboard.estimation.gates import GateReason, ReasonArray
from onboard.identification.change import Change
from onboard.identification.quantities import Estimate
from onboard.regressor.signals import Signals


class OnlineIdentifier(Protocol):
    """Takes ticks in as they come, says at any time what is known."""

    rows_used: int
    refused: dict[GateReason, int]

    @property
    def row_names(self) -> tuple[str, ...]:
        """Of the columns of ``measured``."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Of the state."""

    @property
    def quantity_names(self) -> tuple[str, ...]:
        """Of what is reported besides."""

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        """New ticks: reasons by tick and row, (n, rows)."""

    def estimate(self, level: float = 0.95) -> Estimate:
        """State and quantities with two-sided intervals of this level."""

    def triangle(self) -> FloatArray:
        """Square-root information ``[R z]``, (s, s); zeros where there is none."""

    def news(self) -> tuple[Change, ...]:
        """What has been noticed since the last call."""
