"""Avia Semiconductor HX711 with a load cell, on two GPIO lines."""

from typing import ClassVar, Literal

from drivers.hx711 import OSCILLATOR, Hx711, Hx711Config
from drivers.ports import ClockedPort
from onboard.devices.bridge import BridgeDevice
from onboard.devices.buses import PairDevice
from onboard.section import Positive


class Hx711Device(PairDevice, BridgeDevice):
    """HX711, a converter for one load cell; the cell gives `rated_output_mV_V` at `rated_load_N`.

    Where `delay_ms` and `delay_sigma_ms` are not given they are those of its filter: 2 conversions, known to 0.25, at
    10 a second; 3, known to 0.58, at 80.
    Pins: bridge to E+, E-, A+ and A- (gain 32: B+, B-); SCK to the line `clock`, DT to `data`, VCC to 3.3 V.
    """

    driver_configs = (Hx711Config,)
    rate_tolerance = OSCILLATOR
    clock_tolerance = OSCILLATOR
    new_keys: ClassVar[str] = """sample_rate_hz = 80            # or 10: by the board's pin RATE (many boards: 10)
amplifier = 128                # or 64
rated_output_mV_V = 2.0        # yours: on the cell's label
rated_load_N = 50.0            # yours: at which it gives that
"""
    kind: Literal["hx711"]
    sample_rate_hz: Literal[10, 80] = 80
    amplifier: Literal[128, 64, 32] = 128
    poll_period_ms: Positive = Hx711Config.poll_period_ms

    @classmethod
    def filter_conversions(cls, rate_hz: float) -> tuple[float, float]:
        """See ``BridgeDevice``. At 80 a second it settles in eight conversions, its start among them or not."""
        return super().filter_conversions(rate_hz) if rate_hz < 80 else (3.0, 2.0 / 12**0.5)

    def settings(self, name: str) -> Hx711Config:
        """See ``BusDevice``."""
        return self._settings(Hx711Config, scale=1.0 / self.counts_per_N)

    def driver(self, name: str, port: ClockedPort) -> Hx711:
        """See ``PairDevice``."""
        return Hx711(name, port, self.settings(name))
