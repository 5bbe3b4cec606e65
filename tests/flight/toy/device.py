"""Toy kind: what the flight app has to know of the toy angle sensor, in one module."""

from typing import Literal

from toy_angle.driver import COUNTS_PER_REVOLUTION, ToyAngle

from onboard.devices.base import JointDevice
from onboard.devices.buses import SerialLineDevice
from onboard.timebase.delays import Delay
from onboard.timebase.timebase import FreeChannel

PERIOD_NS = 5e6
WIRE_NS = 1e6


class ToyAngleDevice(SerialLineDevice, JointDevice):
    """A toy that measures the angle of a joint 200 times a second."""

    about_clock = "Its sample number, fitted to arrival."
    kind: Literal["toy_angle"]
    counts_per_revolution: Literal[500_000] = COUNTS_PER_REVOLUTION
    poll_period_ms: float = 10.0

    @property
    def nominal_hz(self) -> float:
        return 1e9 / PERIOD_NS

    def clocks(self, name, around):
        return {name: FreeChannel(PERIOD_NS, *(1e9 * part for part in self.delay_s))}

    def delays(self, name, around):
        return [Delay(name, "", *self.delay_s, "line on the wire, and half of `poll_period_ms`")]

    @property
    def delay_s(self):
        """From sample to arrival, and its sigma: a line waits for the next poll, and may keep step with the polls."""
        poll_s = 1e-3 * self.poll_period_ms
        return WIRE_NS * 1e-9 + 0.5 * poll_s, poll_s / 12**0.5

    def driver(self, name, open_port, clock, baud):
        return ToyAngle(name, open_port, clock)
