"""Toy driver: lines ``sample:counts`` of an angle sensor to SCALAR rows; a sample that did not come is a gap."""

import math

import numpy as np

from drivers.records import SCALAR
from drivers.serial_line.device import SerialDevice

COUNTS_PER_REVOLUTION = 500_000


class ToyAngle(SerialDevice):
    """A sensor that says its sample number and its counts."""

    def __init__(self, name, open_port, clock):
        super().__init__(name, open_port, clock, 10.0, 500.0)
        self._rest = b""
        self._next = 0

    @property
    def channels(self):
        return {self.name: SCALAR}

    def _opened(self, now_ns):
        self._rest = b""

    def _receive(self, now_ns, chunk):
        *lines, self._rest = (self._rest + chunk.data).split(b"\n")
        whole = [line.split(b":") for line in lines if line.count(b":") == 1]  # the port may open within a line
        rows = np.zeros(len(whole), SCALAR)
        for row, (sample, counts) in zip(rows, whole, strict=True):
            number = int(sample)
            if number > self._next:
                self._report.gap(chunk.host_ns, self.name, self._next, number - 1, 0, "lines_lost")
            self._next = number + 1
            row["sequence"] = row["tick"] = number
            row["host_ns"] = chunk.host_ns
            row["value_raw"] = int(counts)
        rows["scale"] = math.tau / COUNTS_PER_REVOLUTION
        rows["unit"] = b"rad"
        self._report.rows(self.name, rows)
        if whole:
            self._heard(now_ns)
