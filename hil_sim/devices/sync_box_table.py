"""``[device.NAME]`` of the sync box."""

from typing import Literal

from pydantic import PositiveFloat

from hil_sim.devices.emulator import Bench, Emulator, Twin
from hil_sim.devices.sync.sync_box import SyncBox


class SyncBoxTable(Emulator):
    """The box that numbers time: pulses on ``line``, which also reaches every device with ``sync_input``.

    On a CAN bus it sends SYNC too, every ``period_ms``; without ``line`` it does nothing else.
    """

    needs = "can"
    where = "the sync box"

    kind: Literal["sync_box"]
    line: str | None = None
    period_ms: PositiveFloat = 5.0
    bus: str | None = None

    @property
    def drives(self) -> str | None:
        """See ``Emulator``."""
        return self.line

    def build(self, bench: Bench) -> Twin:
        """See ``Emulator``."""
        period_ns = round(self.period_ms * 1e6)
        box = SyncBox(bench.clock, bench.start_ns, period_ns=period_ns, faults=bench.faults)
        return Twin(box, lambda: box.produced, (), drive_pin=box.connect_pin)
