"""An adapter that is read every 10 ms, as the tests of its driver fly it."""

import numpy as np

from drivers.qsb import Qsb, QsbConfig
from tests.drivers.batches import whole
from tests.drivers.qsb_model import QsbModel
from tests.drivers.serial_script import MS, ScriptedSerial, SerialFlight

S = 1_000_000_000


def turning(ns: int) -> int:
    """A joint at 1 count in 0.1 ms, from 1 s on."""
    return (ns - S) // 100_000


class Flight(SerialFlight):
    """An adapter that is read every 10 ms."""

    def __init__(self, clock, count=turning, tick_ns=1_953_125, **config) -> None:
        self.qsb = QsbModel(clock, count, tick_ns)
        port = ScriptedSerial(self.qsb.receive)
        super().__init__(clock, port, Qsb("joint", port.open, clock, QsbConfig(**config)))

    def fly(self, pumps: int, keep=lambda line: line):
        for _ in range(pumps):
            self.clock.advance(10 * MS)
            for line in self.qsb.due():
                self.port.say(keep(line))
            self.pump(0)

    def edge(self, high_ns=300_000):
        self.port.say(self.qsb.edge())
        self.clock.advance(high_ns)
        self.port.say(self.qsb.edge(rising=False))

    def rows(self):
        return whole(self.batches, "joint")


def model_counts(flight, rows):
    """What the model counted at the ticks of the rows."""
    qsb = flight.qsb
    return np.array([qsb.encoder(qsb.zero_ns + int(tick) * qsb.tick_ns) - qsb.zero_count for tick in rows["tick"]])
