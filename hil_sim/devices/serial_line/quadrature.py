"""The LS7366R quadrature counter inside a QSB: CNTR, DTR, OTR, its mode registers, its status (LS7366R data sheet).

The encoder is known by its position in quarter cycles at the instants at which it is read; between two of them it
is taken to have gone straight, and the flags that it would have raised on the way are raised then. There is no index
line, and the input filter takes no time.
"""

from typing import Final

MDR0_FACTORY: Final = 0x4F  # of the QSB: x4, modulo DTR + 1, synchronous index
DTR_FACTORY: Final = 0x1F3  # of the QSB: modulo 500

_WIDTH: Final = 1 << 32
_QUARTERS_PER_COUNT: Final = (4, 4, 2, 1)  # MDR0[1:0]: non-quadrature (A is the clock), x1, x2, x4
_FREE_RUNNING, _SINGLE_CYCLE, _RANGE_LIMIT = 0, 1, 2  # MDR0[3:2]; 3: modulo DTR + 1
_DISABLE, _COUNT_DOWN = 0x004, 0x100  # MDR1 as the QSB shows it
_CARRY, _BORROW, _COMPARE = 0x80, 0x40, 0x20
_ENABLED, _UP, _SIGN = 0x08, 0x02, 0x01


class QuadratureCounter:
    """One counter as a QSB starts it, at zero.

    Args:
        position: Of the encoder now, quarter cycles since any origin.

    Attributes:
        mdr0: Mode register 0.
        mdr1: Mode register 1, with the QSB's count-down bit 8.
        dtr: Data register, the top of the count in the modes that have one.
        otr: Output register.
        count: CNTR.
    """

    def __init__(self, position: int) -> None:
        self.mdr0 = MDR0_FACTORY
        self.mdr1 = 0
        self.dtr = DTR_FACTORY
        self.otr = 0
        self.count = 0
        self._position = position
        self._latched = 0
        self._up = True
        self._negative = False
        self._finished = False  # single cycle: since its carry or borrow

    @property
    def status(self) -> int:
        """STR: carry, borrow, compare, index, count enabled, power loss, up, sign."""
        counting = not (self.mdr1 & _DISABLE or self._finished)
        return self._latched | _ENABLED * counting | _UP * self._up | _SIGN * self._negative

    def follow(self, position: int) -> None:
        """Count up or down to where the encoder is, quarter cycles since the same origin."""
        per_count = _QUARTERS_PER_COUNT[self.mdr0 & 3]
        steps = position // per_count - self._position // per_count
        self._position = position
        if self.mdr1 & _COUNT_DOWN:
            steps = -steps
        if steps and not (self.mdr1 & _DISABLE or self._finished):
            self._up = steps > 0
            self._move(self.count + steps)

    def clear(self) -> None:
        """CNTR = 0."""
        self._set(0)

    def load(self) -> None:
        """CNTR = DTR."""
        self._set(self.dtr)

    def clear_status(self) -> None:
        """Forget the latched flags."""
        self._latched = 0

    def _set(self, count: int) -> None:
        self.count = count
        self._finished = self._negative = False

    def _move(self, target: int) -> None:
        mode = self.mdr0 >> 2 & 3
        top = _WIDTH - 1 if mode in (_FREE_RUNNING, _SINGLE_CYCLE) else self.dtr
        if min(self.count, target) <= self.dtr <= max(self.count, target):
            self._latched |= _COMPARE
        if 0 <= target <= top:
            self.count = target
            return
        self._negative = target < 0
        self._latched |= _BORROW if self._negative else _CARRY
        if mode == _RANGE_LIMIT:
            self.count = 0 if self._negative else top
        elif mode == _SINGLE_CYCLE:
            self.count = top if self._negative else 0
            self._finished = True
        else:
            self.count = target % (top + 1)
