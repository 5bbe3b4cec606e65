"""Toy emulator: ``sample:counts`` every 5 ms of its own clock, typed from nobody's data sheet."""

import math
from typing import Literal

from hil_sim.devices.emulator import Bench, Equivalent, MeasuringEmulator, Twin
from hil_sim.devices.serial_line.serial_twin import SerialTwin
from hil_sim.faults import INPUT_KINDS, FaultyScalar
from hil_sim.sensing.sensors import EncoderSensor


class ToyAngleTwin(SerialTwin):
    """One sensor."""

    def __init__(self, analog, clock, start_ns, line, faults):
        super().__init__(line, start_ns, faults, INPUT_KINDS)
        self.produced = 0
        self._analog = FaultyScalar(analog, faults, start_ns)
        self._clock = clock

    def _power_up(self, now_ns):
        self._at("sample", now_ns, self._sample)

    def _sample(self, now_ns):
        counts = round(self._analog.value(self._seconds(now_ns)) * 500_000 / math.tau)
        self._send(b"%d:%d\n" % (self.produced, counts), now_ns)
        self.produced += 1
        self._at("sample", self._clock.time_ns(self.produced * 5_000_000), self._sample)


class ToyAngleTable(MeasuringEmulator):
    """The toy angle sensor."""

    quantities = ("joint_angle",)
    kind: Literal["toy_angle"]

    @classmethod
    def from_vehicle(cls, name, said, sheets):
        sensor = sheets.encoder(name, {"counts_per_revolution": 500_000, **said})
        return Equivalent({"measures": name, "at": said["joint"]}, {name: sensor}, {name: "crystal"})

    def build(self, bench: Bench) -> Twin:
        toy = ToyAngleTwin(bench.sensor(EncoderSensor), bench.clock, bench.start_ns, bench.line, bench.faults)
        return Twin(toy, lambda: toy.produced, (bench.name,), len)
