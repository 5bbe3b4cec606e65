"""Keeps the ticks of a log that is estimated afterwards."""

from collections.abc import Sequence

import numpy as np

from onboard.estimation.arrays import BoolArray
from onboard.estimation.gates import ReasonArray
from onboard.identification.free_flyer.prediction.further import Further
from onboard.identification.free_flyer.prediction.ticks import Ticks, ticks_of
from onboard.identification.table.run import TableRun
from onboard.regressor.signals import EncoderJump, Signals


class TickRecorder(TableRun):
    """Gates the ticks and keeps them.

    Args:
        payload: link of which nothing is known.
        joints: of the vehicle.
        further: instruments.
        rows: names of its lines, if these are not those of instruments on a base.

    Attributes:
        jumps: of encoders, by joint.
    """

    def __init__(
        self, payload: str, joints: int, further: Sequence[Further] = (), rows: tuple[str, ...] | None = None
    ) -> None:
        super().__init__(payload, further)
        self.row_names = self.row_names if rows is None else rows
        self.ticks: list[Ticks] = [Ticks.none(joints, len(self.row_names))]
        self.attached: list[BoolArray] = [np.zeros(0, np.bool_)]
        self.jumps = list[tuple[str, EncoderJump]]()

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        """Gates new ticks and keeps them."""
        found = super().update(signals, attached, excluded)
        self.ticks.append(ticks_of(signals, np.where(found == 0, signals.measured, np.nan)))
        self.attached.append(attached)
        self.jumps += signals.jumps
        return found
