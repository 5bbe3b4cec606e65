"""The RTDE driver with a model of a robot controller on a scripted port."""

import math

from drivers.records import SampleStatus
from drivers.ur_rtde import RtdeChannel, RtdeConfig, UrRtde
from tests.conftest import VirtualClock
from tests.drivers.rtde_model import RtdeModel
from tests.drivers.serial_script import ScriptedSerial, SerialFlight

MS, PERIOD_S = 1_000_000, 0.008
BAD, RESET = SampleStatus.NOT_VALID, SampleStatus.AFTER_RESET
CHANNELS = (
    RtdeChannel("q1", "actual_q", 0, math.tau / 2**32, "rad"),
    RtdeChannel("q6", "actual_q", 5, -math.tau / 2**32, "rad"),
    RtdeChannel("i2", "actual_current", 1, 2.0**-32, "A"),
    RtdeChannel("fz", "ft_raw_wrench", 2, 2.0**-32, "N"),
)


class Flight(SerialFlight):
    """The driver and the model of a controller, whose clock stands at 100 s when the flight begins."""

    def __init__(self, clock=None, model=None, channels=CHANNELS, **config) -> None:
        self.model = RtdeModel() if model is None else model
        port = ScriptedSerial(self.model.receive)
        clock = VirtualClock() if clock is None else clock
        super().__init__(clock, port, UrRtde("ur", channels, port.open, clock, RtdeConfig(**config)))
        self.time_s = 100.0

    def packages(self, n, step_s=PERIOD_S, **values):
        """Time passes, a package comes at the end of each period."""
        for _ in range(n):
            self.time_s += step_s
            data = self.model.data(self.time_s, **values) if self.model.sends and self.port.is_open else b""
            self.pump(round(1e9 * step_s), data)
        return self
