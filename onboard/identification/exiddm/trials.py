"""Which instrument is wrong, where a window of all is not explained or one is accused: the window without each.

Compared is by how much each fit is strained: squares of its corrections in their stated sigmas, and what its residuals
exceed chance by. The noise of the readings, which differs from fit to fit, is not part of that.
"""

from collections.abc import Sequence
from typing import NamedTuple

from onboard.identification.exiddm.window import Hypothesis, Solved

_CLEARLY = 20.0  # squares by which a fit must be less strained than any other: exp(10) times as likely


class Choice(NamedTuple):
    """What the trials of a window came to."""

    instrument: int
    found: Solved  # without it
    clear: bool  # without no other the window is explained, or much worse
    others: tuple[int, ...]  # without which the window is explained as well

    def doubt(self, names: Sequence[str]) -> str:
        """Which instruments contradict each other, if it is not clear which is wrong; else empty."""
        both = " and ".join(names[k] for k in sorted((self.instrument, *self.others)))
        return "" if self.clear else f"{both} contradict each other, and nothing tells which is wrong"


def unchanged(hypotheses: tuple[Hypothesis, ...]) -> tuple[Hypothesis, ...]:
    """Those of a payload as before, if there are any: an instrument that is wrong does not change it."""
    return tuple(one for one in hypotheses if one is not Hypothesis.NEW) or hypotheses


class Trials:
    """The fits of one window.

    Args:
        doubted: instruments without which it is to be solved.
    """

    def __init__(self, doubted: Sequence[int]) -> None:
        self._left = list(doubted)
        self._found: list[tuple[int, Solved]] = []

    def next(self) -> int | None:
        """The instrument to leave out next; None: none is left."""
        return self._left[0] if self._left else None

    def take(self, found: Solved | None) -> None:
        """The window without that instrument; None if it is not explained."""
        instrument = self._left.pop(0)
        if found is not None:
            self._found.append((instrument, found))

    @property
    def choice(self) -> Choice | None:
        """The instrument without which the fit is the least strained; None if the window is explained without none."""
        if not self._found:
            return None
        (best, found), *rest = sorted(self._found, key=lambda one: one[1].strained)
        clear = not rest or rest[0][1].strained - found.strained > _CLEARLY
        return Choice(best, found, clear, tuple(instrument for instrument, _ in rest))
