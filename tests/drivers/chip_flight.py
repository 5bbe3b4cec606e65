"""A chip's driver on its model, pumped when it asks for it."""

import numpy as np

from tests.drivers.batches import codes, whole

MS = 1_000_000


class ChipFlight:
    """From the driver's start on; ``rows`` are those of channel ``name``."""

    def __init__(self, clock, chip, device) -> None:
        self.clock, self.chip, self.device = clock, chip, device
        self.batches = device.start(clock())

    def fly(self, seconds):
        until_ns = self.clock() + round(seconds * 1e9)
        while self.clock() < until_ns:
            self.clock.advance(self.device.period_ns)
            self.batches += self.device.pump(self.clock())

    def rows(self):
        return whole(self.batches, self.device.name)

    def set_up_transfers(self):
        """Number of transfers until it has started."""
        while "started" not in codes(self.batches):
            self.fly(0.001)
        return len(self.chip.transfers)


class ConverterFlight(ChipFlight):
    """Of a chip whose readings are the number of its conversion and 1000; its time goes on in small steps."""

    def fly(self, seconds, step_ns=MS):
        """Returns the batches of this time."""
        until_ns, before = self.clock() + round(seconds * 1e9), len(self.batches)
        due_ns = self.clock()
        while self.clock() < until_ns:
            self.clock.advance(step_ns)
            if self.clock() >= due_ns:
                self.batches += self.device.pump(self.clock())
                due_ns = self.clock() + self.device.period_ns
        return self.batches[before:]

    def true_numbers(self):
        """Of the chip's conversions, from the first row on."""
        values = self.rows()["value_raw"] - 1000
        return values - values[0]

    def worst(self):
        """Largest error of a number."""
        return int(np.abs(self.true_numbers() - self.rows()["tick"].astype(int)).max())
