"""``[device.NAME]`` of a QSB."""

from collections.abc import Mapping
from typing import Any, Literal

from hil_sim.devices.emulator import Bench, Equivalent, MeasuringEmulator, Twin
from hil_sim.devices.serial_line.qsb import TICK_512_HZ, TICK_1900_US, QsbTwin
from hil_sim.scenario.sheets import Sheets
from hil_sim.sensing.sensors import EncoderSensor


class QsbTable(MeasuringEmulator):
    """A US Digital QSB. It counts from 0 at power-up.

    ``zero_count``: its count at angle zero, because it was set up and switched on there and the joint was moved since;
    without it, its count at power-up is 0 wherever the joint stands.
    """

    baud_rates = (230_400,)
    quantities = ("joint_angle",)

    kind: Literal["qsb"]
    tick: Literal["1/512 s", "1.9 ms"] = "1/512 s"
    sync_input: bool = True
    zero_count: int | None = None
    counting: Literal[1, 2, 4] = 4

    @classmethod
    def from_vehicle(cls, name: str, said: Mapping[str, Any], sheets: Sheets) -> Equivalent:
        """See ``Emulator``."""
        wired = sheets.pulse and said.get("sync_edge", "rising") != "none"
        counting = said.get("counting", 4)
        table = {"sync_input": wired, "measures": name, "at": said["joint"]}
        table |= {"zero_count": said.get("zero_count", 0), "counting": counting}
        quarters = {**said, "counts_per_revolution": said["counts_per_revolution"] * 4 // counting}
        return Equivalent(table, {name: sheets.encoder(name, quarters)}, {name: "converter"})

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        encoder = bench.sensor(EncoderSensor)
        qsb = QsbTwin(
            encoder,
            bench.clock,
            bench.start_ns,
            counts_per_revolution=encoder.counts_per_revolution,
            tick_ns=TICK_512_HZ if self.tick == "1/512 s" else TICK_1900_US,
            sync_input=self.sync_input,
            zero_count=self.zero_count,
            counting=self.counting,
            faults=bench.faults,
        )
        pin = qsb.dig_io if self.sync_input else None
        return Twin(qsb, lambda: qsb.produced, (bench.name,), _position_length, pin)


def _position_length(line: bytes) -> int:
    """Of a line of the stream of register 0E: up to its exclamation mark."""
    return line.find(b"!") + 1 if line[:4].replace(b" ", b"").startswith(b"s0E") else 0
