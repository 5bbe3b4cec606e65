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
    """Gates the ticks and keeps them."""

    def __init__(self, payload: str, joints: int, further: Sequence[Further]) -> None:
        super().__init__(payload, further)
        self.ticks: list[Ticks] = [Ticks.none(joints, len(self.row_names))]
        self.attached: list[BoolArray] = [np.zeros(0, np.bool_)]

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        """Gates new ticks and keeps them."""
        found = super().update(signals, attached, excluded)
        self.ticks.append(ticks_of(signals, np.where(found == 0, signals.measured, np.nan)))
        self.attached.append(attached)
        return found


class JumpRecorder(TickRecorder):
    """Keeps jumps of encoders, too.

    Attributes:
        jumps: of encoders, by joint.
    """

    follows_jumps = True

    def __init__(self, payload: str, joints: int, further: Sequence[Further]) -> None:
        super().__init__(payload, joints, further)
        self.jumps = list[tuple[str, EncoderJump]]()

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        """Gates new ticks and keeps them."""
        self.jumps += signals.jumps
        return super().update(signals, attached, excluded)
