"""A joint's position out of a 32-bit counter that wraps: made whole, and garbage told from motion."""

BELIEVED_AFTER = 20
_TURN, _HALF = 1 << 32, 1 << 31


class Position:
    """Follows one counter.

    The step between two samples is taken as the shorter way round, so it is right up to 2^31 counts between samples. A
    step of more than a revolution is a position that no joint reaches between two samples: it is not believed, and
    nothing is counted from it, so that garbage leaves no turn of the counter behind. A new position that stays (the
    joint was turned while nobody looked) is believed after ``BELIEVED_AFTER`` samples that agree.

    Args:
        counts_per_revolution: Counts in a revolution of the joint.

    Attributes:
        at: The last position that was believed; None before the first.
    """

    def __init__(self, counts_per_revolution: int) -> None:
        self.at: int | None = None
        self._counts = counts_per_revolution
        self._doubted = 0  # the last position not believed
        self._agreeing = 0  # samples in a row that agree with it

    def place(self, word: int) -> tuple[int, bool]:
        """The position with the 32 bits ``word``, signed or not, nearest to the one before; whether it is believed."""
        before = word if self.at is None else self.at
        position = self._nearest(word, before)
        if abs(position - before) > self._counts:
            agrees = self._agreeing and abs(self._nearest(word, self._doubted) - self._doubted) <= self._counts
            self._agreeing = self._agreeing + 1 if agrees else 1
            self._doubted = position
            if self._agreeing < BELIEVED_AFTER:
                return position, False
        self._agreeing = 0
        self.at = position
        return position, True

    def follow(self, positions: list[int]) -> bool:
        """Whether all of these, whole, follow on the last one without a step too far: then they are believed."""
        before = self.at
        if before is None or self._agreeing:
            return False
        for position in positions:
            if not -self._counts <= position - before <= self._counts:
                return False
            before = position
        self.at = before
        return True

    @staticmethod
    def _nearest(word: int, to: int) -> int:
        return to + (word - to + _HALF) % _TURN - _HALF
