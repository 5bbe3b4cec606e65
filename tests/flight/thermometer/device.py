"""What the flight app has to know of the thermometer: its key, rate and record; the estimator has no use for it."""

from typing import Literal

from thermometer.driver import TEMPERATURE, Thermometer

from onboard.devices.buses import SerialLineDevice


class ThermometerDevice(SerialLineDevice):
    """A thermometer that is read 20 times a second."""

    about_clock = "None: its rows are recorded as they come."
    records = TEMPERATURE
    kind: Literal["thermometer"]
    poll_period_ms: float = 10.0

    @property
    def nominal_hz(self):
        return 20.0

    def driver(self, name, open_port, clock, baud):
        return Thermometer(name, open_port, clock)
