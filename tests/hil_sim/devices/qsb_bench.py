"""A QSB twin on a turning shaft, and readers of its lines."""

import math

from hil_sim.devices.serial_line.qsb import QsbTwin
from hil_sim.faults import FaultPlan
from tests.hil_sim.devices.serial_bench import Line
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock

COUNT = math.tau / 500_000  # rad
FREE_X4 = b"W0303"


class Bench(Line):
    """An adapter that has started, on a shaft that turns at ``counts_s`` (or as ``angle`` says)."""

    def __init__(self, counts_s=0.0, angle=None, rate_error=0.0, boot=True, **options):
        self.clock = RateClock(rate_error)
        self.rest = ""
        super().__init__(QsbTwin(Analog(angle or (lambda t: counts_s * COUNT * t)), self.clock, START_NS, **options))
        if boot:
            assert self.run(150) == b"QSB-D  0E!\r\n"

    def do(self, *commands):
        """Send commands one by one; the answers, without their line ends."""
        return [self.ask(command + b"\r\n", 3).decode().removesuffix("\r\n") for command in commands]

    def lines(self, ms):
        """The lines that ended in the next ``ms``."""
        *whole, self.rest = (self.rest + self.run(ms).decode()).split("\r\n")
        return whole

    def pulse(self, after_ms, high_ns=300_000):
        self.device.dig_io(self.now_ns + round(after_ms * MS), high_ns)


def faults(*faults):
    return FaultPlan(faults, START_NS).of("qsb")


def data_of(lines, register):
    return [int(line.split()[2], 16) for line in lines if line.startswith(f"s {register}")]


def stamp_of(lines, register):
    return [int(line.split()[3], 16) for line in lines if line.startswith(f"s {register}")]
