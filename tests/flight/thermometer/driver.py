"""Driver of a thermometer: lines ``sample:millikelvin`` to rows of a record that heft does not have."""

import numpy as np

from drivers.serial_line.device import SerialDevice

TEMPERATURE = np.dtype(
    [("sequence", "<u8"), ("host_ns", "<i8"), ("tick", "<u8"), ("temperature_k", "<f8"), ("humid", "u1")], align=True
)


class Thermometer(SerialDevice):
    """A sensor that says its sample number and its temperature."""

    def __init__(self, name, open_port, clock):
        super().__init__(name, open_port, clock, 10.0, 500.0)
        self._rest = b""

    @property
    def channels(self):
        return {self.name: TEMPERATURE}

    def _opened(self, now_ns):
        self._rest = b""

    def _receive(self, now_ns, chunk):
        *lines, self._rest = (self._rest + chunk.data).split(b"\n")
        rows = np.zeros(len(lines), TEMPERATURE)
        for row, line in zip(rows, lines, strict=True):
            sample, millikelvin = map(int, line.split(b":"))
            row["sequence"], row["tick"], row["temperature_k"] = sample, sample, 1e-3 * millikelvin
        rows["host_ns"] = chunk.host_ns
        self._report.rows(self.name, rows)
        if lines:
            self._heard(now_ns)
