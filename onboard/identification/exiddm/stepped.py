"""Filter steps since a window, replaced by a longer window that has them all, while the payload is not known well.

A step is linearised about what is known then. While that is still far off, each step gives information in directions
that no motion shows, and nothing takes it back. So the window and the steps since are solved as one window, of 8 s or
of twice the window, and again at twice that length where the mass was not known to a few percent, as of a light vehicle
that caught much.

Known limit: in a window the drift of a bias is constant, in steps it is a random walk.
"""

from onboard.identification.exiddm.ticks import Ticks
from onboard.identification.exiddm.window import Solved

_FIRST_s, _LONGEST_s = 8.0, 32.0  # a window of the steps is at least and at most so long
_WELL = 0.03  # relative sigma of the payload's mass below which steps are linearised well enough


class Stepped:
    """Ticks of a window and of the steps since.

    Args:
        ticks: of the window.
        length_s: at which they are solved again.

    Attributes:
        first: none of the steps has been replaced yet, and the window before them had not grown.
    """

    def __init__(self, ticks: Ticks, length_s: float, *, first: bool) -> None:
        self._parts, self._length_s, self.first = [ticks], length_s, first

    @staticmethod
    def since(ticks: Ticks, *, grown: bool) -> "Stepped | None":
        """Of a window, which may have grown; None if one of twice its length is too long."""
        length_s = 2.0 * float(ticks.time_s[-1] - ticks.time_s[0])
        return Stepped(ticks, max(_FIRST_s, length_s), first=not grown) if length_s < 1.01 * _LONGEST_s else None

    def add(self, ticks: Ticks) -> None:
        """The ticks of a step, which follow."""
        self._parts.append(ticks)

    @property
    def due(self) -> bool:
        """They are to be solved again."""
        return float(self._parts[-1].time_s[-1] - self._parts[0].time_s[0]) >= 0.99 * self._length_s

    @property
    def ticks(self) -> Ticks:
        """All of them."""
        self._parts = [Ticks.joined(self._parts)]
        return self._parts[0]

    def after(self, solved: Solved) -> "Stepped | None":
        """What is to be solved after the window of all is; None if steps are linearised well enough, or it was long."""
        if solved.mass_sigma < _WELL or 2.0 * self._length_s > 1.01 * _LONGEST_s:
            return None
        return Stepped(self.ticks, 2.0 * self._length_s, first=False)
