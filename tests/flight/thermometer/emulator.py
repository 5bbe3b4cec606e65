"""Emulator of the thermometer: it warms by 1 mK a sample, whatever the vehicle does."""

from typing import Literal

from hil_sim.devices.emulator import Emulator, Equivalent, Twin
from hil_sim.devices.serial_line.serial_twin import SerialTwin
from hil_sim.faults import INPUT_KINDS


class ThermometerTwin(SerialTwin):
    """One sensor."""

    def __init__(self, clock, start_ns, line, faults):
        super().__init__(line, start_ns, faults, INPUT_KINDS)
        self.produced, self._clock = 0, clock

    def _power_up(self, now_ns):
        self._at("sample", now_ns, self._sample)

    def _sample(self, now_ns):
        self._send(b"%d:%d\n" % (self.produced, 293_150 + self.produced), now_ns)
        self.produced += 1
        self._at("sample", self._clock.time_ns(self.produced * 50_000_000), self._sample)


class ThermometerTable(Emulator):
    """The thermometer."""

    kind: Literal["thermometer"]

    @classmethod
    def from_vehicle(cls, name, said, sheets):
        return Equivalent({}, {}, {})

    def build(self, bench):
        twin = ThermometerTwin(bench.clock, bench.start_ns, bench.line, bench.faults)
        return Twin(twin, lambda: twin.produced, (bench.name,), len)
