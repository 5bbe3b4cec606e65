"""Unwraps a joint's position counter and rejects impossible steps."""

ACCEPTED_AFTER = 20


class Position:
    """Tracks one position counter.

    Of the two possible steps between samples the shorter is taken, which is right up to half of its range. A step of
    more than ``largest`` is rejected and does not change the reference, so that corrupted data leave no wrap behind. A
    new position that persists (the joint moved while not sampled) is accepted after ``ACCEPTED_AFTER`` consistent
    samples. The first position is the one nearest to the joint's zero: an encoder that reads 0 there reads 2^32 - 1 one
    count below it.

    Args:
        largest: Counts of the largest step: a revolution of the joint, or less.
        zero_count: Reading at joint angle zero.
        bits: Width of the counter.

    Attributes:
        at: The last accepted position, counts; None before the first.
    """

    def __init__(self, largest: int, zero_count: int = 0, bits: int = 32) -> None:
        self.at: int | None = None
        self._zero = zero_count
        self._counts = largest
        self._turn, self._half = 1 << bits, 1 << bits - 1
        self._rejected = 0  # the last rejected position
        self._agreeing = 0  # samples in a row that agree with it

    def place(self, word: int) -> tuple[int, bool]:
        """Position with the bits ``word`` (signed or not) nearest to the last one, and whether it is accepted."""
        before = self._nearest(word, self._zero) if self.at is None else self.at
        position = self._nearest(word, before)
        if abs(position - before) > self._counts:
            agrees = self._agreeing and abs(self._nearest(word, self._rejected) - self._rejected) <= self._counts
            self._agreeing = self._agreeing + 1 if agrees else 1
            self._rejected = position
            if self._agreeing < ACCEPTED_AFTER:
                return position, False
        self._agreeing = 0
        self.at = position
        return position, True

    def follow(self, positions: list[int]) -> bool:
        """Accept unwrapped positions if no step exceeds the largest; False, and no change, otherwise."""
        before = self.at
        if before is None or self._agreeing:
            return False
        for position in positions:
            if not -self._counts <= position - before <= self._counts:
                return False
            before = position
        self.at = before
        return True

    def _nearest(self, word: int, to: int) -> int:
        return to + (word - to + self._half) % self._turn - self._half
