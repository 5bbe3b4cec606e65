"""An HX711 as its data sheet tells it, on its two lines, for the driver's tests: own numbers, own times."""

import os
from collections.abc import Callable

from gpiod.line import Value

DATA, CLOCK = 5, 6
US, MS = 1_000, 1_000_000


class Hx711Model:
    """A chip and libgpiod's request of its two lines. Conversion ``n`` since the first power-up reads ``values(n)``.

    Args:
        clock: Shows the time; has ``advance``.
        rate: By its pin.
        rate_error: Of its oscillator.
        call_ns: Time of a call of libgpiod.
    """

    def __init__(self, clock, rate: int = 80, rate_error: float = 0.004, call_ns: int = 2 * US) -> None:
        self.clock, self.call_ns = clock, call_ns
        self.period_ns = 1e9 / rate / (1.0 + rate_error)
        self.settling = {10: 4, 80: 8}[rate]  # conversions: 400 and 100 ms
        self.values: Callable[[int], int] = lambda number: 1000 + number
        self.fail: Callable[[int], int] = lambda number: 0  # errno of the call with this number
        self.stall: Callable[[int], int] = lambda number: 0  # ns after the call with this number
        self.held: bool | None = None  # level of DOUT whatever it does
        self.calls = self.conversions = self.resets = 0
        self.gains: list[int] = []  # of each conversion that was read
        self.shows_unsettled = False
        self.high, self.rose_ns = False, 0
        self.reset()

    def reset(self) -> None:
        self.resets += 1
        self.gain, self.unsettled, self.word, self.pulses = 128, self.settling - 1, None, 0
        self.next_ns = self.clock() + self.period_ns

    def set_value(self, line: int, value: Value) -> None:
        assert line == CLOCK
        self._call()
        high = value is Value.ACTIVE
        if high and not self.high:
            self.rose_ns = self.clock()
            self._pulse()
        elif self.high and not high and self.clock() - self.rose_ns > 60 * US:
            self.reset()
        self.high = high
        self.clock.advance(self.stall(self.calls - 1))

    def get_value(self, line: int) -> Value:
        assert line == DATA
        self._call()
        level = self._dout()
        self.clock.advance(self.stall(self.calls - 1))
        return Value.ACTIVE if level else Value.INACTIVE

    def release(self) -> None:
        raise AssertionError("the lines are not the driver's to release")

    def _call(self) -> None:
        number, self.calls = self.calls, self.calls + 1
        self.clock.advance(self.call_ns)
        if code := self.fail(number):
            raise OSError(code, os.strerror(code))
        self.run()

    def run(self) -> None:
        """Let the chip go on until now."""
        if self.high and self.clock() - self.rose_ns > 60 * US:
            return
        while self.next_ns <= self.clock():
            if self.pulses >= 25:
                gain = {25: 128, 26: 32}.get(self.pulses, 64)
                self.unsettled = self.settling if gain != self.gain else self.unsettled
                self.gain, self.pulses = gain, 0
            if not 0 < self.pulses < 25:
                settled = self.unsettled == 0
                self.unsettled = max(self.unsettled - 1, 0)
                value = self.values(self.conversions) if settled else 0x155555
                self.word = value & 0xFFFFFF if settled or self.shows_unsettled else None
            self.conversions += 1
            self.next_ns += self.period_ns

    def _pulse(self) -> None:
        self.run()
        if self.word is None and not self.pulses:
            return
        self.pulses += 1
        if self.pulses == 25:
            self.gains.append(self.gain)
            self.word = None

    def _dout(self) -> bool:
        if self.held is not None:
            return self.held
        if self.word is None or (self.high and self.clock() - self.rose_ns > 60 * US):
            return True
        return bool(self.pulses and self.word >> (24 - self.pulses) & 1)
